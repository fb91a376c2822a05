"""Every hostile variant of every seed, in a process of limited memory: `python -m tests.io.hostile_process FILE`.

FILE gets one JSON object: by seed, the number of variants, and what went wrong, a line each.
"""

import json
import os
import resource
import struct
import sys
import tempfile
import traceback
import zlib
from collections.abc import Iterator
from itertools import chain
from pathlib import Path

import jax

from tests.io.hostile import hostile_variants, outcome
from tests.io.hostile_binary import SPARSE, blind_variants
from tests.io.seeds import seeds, zip_bomb

MEMORY = 500 * 2**20
"""Bytes of addresses beyond those of the libraries."""

BOMB = 600 * 2**20


def bombs(name: str, content: bytes) -> Iterator[tuple[str, bytes]]:
    """Files that would become many times as large as they are."""
    if name == "npz":
        yield "a bomb", zip_bomb(BOMB)
    if name == "mat, compressed":
        packer, zeros = zlib.compressobj(1), bytes(2**20)
        parts = [packer.compress(struct.pack("<II", 14, BOMB))]
        parts += [packer.compress(zeros) for _ in range(BOMB // len(zeros))]
        body = b"".join(parts) + packer.flush()
        yield "a bomb", content[:128] + struct.pack("<II", 15, len(body)) + body
    if name == "png":
        for columns, rows in ((30000, 30000), (2**31 - 1, 1), (2**31 - 1, 2**31 - 1)):
            head = b"IHDR" + struct.pack(">II", columns, rows) + content[24:29]
            checked = head + struct.pack(">I", zlib.crc32(head))
            yield f"{columns} x {rows} pixels", content[:12] + checked + content[33:]
    if name == "exr":
        mark = b"dataWindow\0box2i\0"
        at, far = content.index(mark) + len(mark) + 4, 2**31 - 1
        for window in ((0, 0, 29999, 29999), (0, 0, far, 0), (-far - 1, -far - 1, far, far), (5, 5, 0, 0)):
            yield f"dataWindow {window}", content[:at] + struct.pack("<4i", *window) + content[at + 16 :]


def limit_memory() -> None:
    """From here on, `MEMORY` more than there is now: what needs more is a MemoryError."""
    with open("/proc/self/statm") as status:
        pages = int(status.read().split()[0])
    _, hard = resource.getrlimit(resource.RLIMIT_AS)
    resource.setrlimit(resource.RLIMIT_AS, (pages * resource.getpagesize() + MEMORY, hard))


def wrong(read, path: Path, *, refused: bool = False) -> str | None:
    """What a reader does with a file that it must not do, by `outcome`; None if nothing."""
    try:
        found = outcome(read, path)
    except KeyboardInterrupt:
        raise
    except OSError as error:
        if path.is_file():
            return f"an OSError of a file that is there: {error}"
        found = error
    except BaseException as error:
        place = traceback.extract_tb(error.__traceback__)[-1]
        return f"{type(error).__name__}: {error} at {place.filename}, line {place.lineno}: {place.line}"
    return "it was read" if refused and not isinstance(found, Exception) else None


def main() -> None:
    jax.config.update("jax_enable_x64", True)
    report: dict[str, dict] = {}
    with tempfile.TemporaryDirectory() as folder:
        path, found = Path(folder) / "file", seeds()
        for content, readers in found.values():  # good ones: everything is imported, and compiled what is
            path.write_bytes(content)
            for read in readers:
                read(path)
        limit_memory()
        for name, (content, readers) in found.items():
            count, faults = 0, []
            large = len(content) > 2**20  # all variants at once must fit into the limit, too
            variants = hostile_variants(content, flips=8 if large else 64).items()
            for what, changed in chain(variants, blind_variants(content)):
                path.write_bytes(changed)
                for read in readers:
                    count += 1
                    fault = wrong(read, path, refused=what == "empty")
                    if fault:
                        faults.append(f"{what}: {fault}")
            for head in (content, content[:64], b""):
                path.write_bytes(head)
                os.truncate(path, SPARSE)
                for read in readers:
                    count += 1
                    fault = wrong(read, path, refused=head != content)  # some formats allow bytes at the end
                    if fault:
                        faults.append(f"{len(head)} bytes in 5 GB: {fault}")
            report[name] = {"variants": count, "faults": faults}
            path.unlink()
            path.mkdir()
            for read in readers:
                fault = wrong(read, path, refused=True)
                if fault:
                    faults.append(f"a directory: {fault}")
            path.rmdir()
        for name, (content, readers) in found.items():
            for what, changed in bombs(name, content):
                path.write_bytes(changed)
                del changed
                for read in readers:
                    report[name]["variants"] += 1
                    fault = wrong(read, path, refused=True)
                    if fault:
                        report[name]["faults"].append(f"{what}: {fault}")
    Path(sys.argv[1]).write_text(json.dumps(report))  # libraries print on standard output


if __name__ == "__main__":
    main()
