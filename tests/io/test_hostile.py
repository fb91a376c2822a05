"""What is no good file is refused in one sentence, within a second and 500 MB: all formats that are read.

In a process of its own, whose memory is limited; files of text have tests of their own beside.
"""

import json
import subprocess
import sys
from pathlib import Path

import pytest

from hshjax.io import FORMATS, FileFormatError, measured_format, read_material, read_measured, read_samples
from tests.io.seeds import MEASURED, OTHERS, missing, seeds

ROOT = Path(__file__).parents[2]


@pytest.fixture(scope="module")
def report(tmp_path_factory):
    file = tmp_path_factory.mktemp("hostile") / "report.json"
    command = [sys.executable, "-W", "ignore", "-m", "tests.io.hostile_process", str(file)]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr[-3000:]
    return json.loads(file.read_text())


def test_every_format_has_a_good_file():
    assert not missing()


@pytest.mark.parametrize("name", [*MEASURED, *OTHERS])
def test_bad_files_are_refused_in_a_sentence(report, name):
    assert report[name]["variants"] > 150
    assert report[name]["faults"] == []


@pytest.mark.parametrize("name", list(MEASURED))
def test_a_format_is_told_by_its_content(name, tmp_path):
    """Whatever the file is called, and no other reader claims it."""
    content, _ = seeds()[name]
    path = tmp_path / "named.wrongly"
    path.write_bytes(content)
    assert measured_format(path) == name
    assert [other for other, one in FORMATS.items() if one.sniff(content[:8192], len(content))] == [name]
    assert read_measured(path).found == read_measured(path, format=name).found
    samples, found = read_samples(path)
    assert samples.size > 0
    assert samples.channels == len(found.channel_names)


def test_what_is_none_of_them(tmp_path):
    path = tmp_path / "notes.txt"
    path.write_text("nothing measured")
    for read in (read_measured, read_material, read_samples):
        with pytest.raises(FileFormatError, match=r"expected a measured material .*MERL.*FRED.*got a file that begins"):
            read(path)
    path.write_bytes(b"")
    with pytest.raises(FileFormatError, match="an empty file"):
        read_measured(path)
    with pytest.raises(ValueError, match="format must be one of rgl"):
        read_measured(path, format="xyz")
