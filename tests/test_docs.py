"""The pages: their Python runs as it stands, and their relative links lead somewhere."""

import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

from tests.helpers import slow_unless

ROOT = Path(__file__).parents[1]
PAGES = [ROOT / "README.md", ROOT / "CONTRIBUTING.md", ROOT / "CHANGELOG.md", *sorted((ROOT / "docs").glob("*.md"))]
RUN = [
    ROOT / "README.md",
    *(
        ROOT / "docs" / f"{page}.md"
        for page in (
            "fit_a_material",
            "fit_by_gradients",
            "fit_parameters",
            "light_a_surface",
            "natural_light",
            "photographs",
            "photometric_stereo",
            "refine_jointly",
            "render_elsewhere",
            "scaling",
            "shape_from_shading",
            "use_as_a_layer",
        )
    ),
]

LONG = (
    "fit_by_gradients", "fit_parameters", "light_a_surface", "natural_light", "photometric_stereo", "refine_jointly",
    "render_elsewhere", "shape_from_shading",
)  # fmt: skip
"""They compile whole fits or images, in a process of their own."""

FENCE = re.compile(r"^```(?P<info>[^\n]*)\n(?P<body>.*?)^```$", re.MULTILINE | re.DOTALL)
LINK = re.compile(r"\[[^\]]*\]\((?P<target>[^()\s]+)\)")


def python_blocks(page: Path) -> str:
    """The blocks of a page whose info string is `python`, each on its own line: a traceback names the page's."""
    text = page.read_text(encoding="utf-8")
    source = ""
    for fence in FENCE.finditer(text):
        if fence["info"] == "python":
            line = text.count("\n", 0, fence.start("body"))
            source += "\n" * (line - source.count("\n")) + fence["body"]
    return source


def anchors(page: Path) -> set[str]:
    """What the headings of a page are called in links."""
    text = FENCE.sub("", page.read_text(encoding="utf-8"))
    headings = re.findall(r"^#+ +(.*)$", text, re.MULTILINE)
    return {re.sub(r"[^\w\- ]", "", heading.strip().lower()).replace(" ", "-") for heading in headings}


def broken_links(page: Path) -> list[str]:
    """Relative links of a page to a file, or to a heading of a page, that do not exist."""
    broken = []
    for link in LINK.finditer(FENCE.sub("", page.read_text(encoding="utf-8"))):
        path, _, anchor = link["target"].partition("#")
        if re.match(r"[a-z]+:", path):  # another site
            continue
        target = page.parent / path if path else page
        if not target.exists() or (anchor and anchor not in anchors(target)):
            broken.append(link["target"])
    return broken


@pytest.mark.skipif(os.environ.get("HSHJAX_TEST_DTYPE") == "float32", reason="pages run once, in a reader's defaults")
@pytest.mark.parametrize("page", [slow_unless(page.stem not in LONG, page, id=page.stem) for page in RUN])
def test_python_of_a_page_runs(page, tmp_path):
    source = python_blocks(page)
    assert source.strip(), "a page without Python does not belong in this list"
    # A fresh process, as a reader has it: no test configuration of jax, no shape checks, files go to a new folder.
    script = tmp_path / page.with_suffix(".py").name
    script.write_text(source, encoding="utf-8")
    environment = os.environ | {"PYTHONPATH": str(ROOT)}
    done = subprocess.run(
        [sys.executable, "-W", "error", script], cwd=tmp_path, env=environment, capture_output=True, text=True
    )
    assert done.returncode == 0, done.stderr


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.stem)
def test_relative_links_lead_somewhere(page):
    assert broken_links(page) == []


def test_a_broken_link_is_found(tmp_path):
    page = tmp_path / "page.md"
    page.write_text(
        "# A *title*, here\n[a](page.md) [b](#a-title-here) [c](https://x.org/y) [d](gone.md) [e](page.md#gone)\n"
        "```\n[f](inside-a-block.md)\n```\n![g](gone.png)\n",
        encoding="utf-8",
    )
    assert broken_links(page) == ["gone.md", "page.md#gone", "gone.png"]


def test_only_blocks_marked_python_are_run(tmp_path):
    page = tmp_path / "page.md"
    page.write_text("```sh\nls\n```\n\n```python\na = 1\n```\n```python no-run\nb\n```\n", encoding="utf-8")
    assert python_blocks(page) == "\n" * 5 + "a = 1\n"
