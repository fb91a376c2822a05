"""Pages that need no other file, no script and no network: templates, and pictures inside of them."""

import base64
import struct
from pathlib import Path
from typing import NamedTuple

import jinja2


class Picture(NamedTuple):
    """A PNG, shown at `scale` CSS pixels for one of its own."""

    content: bytes
    scale: float = 1.0

    @property
    def uri(self) -> str:
        return "data:image/png;base64," + base64.b64encode(self.content).decode()

    @property
    def size(self) -> tuple[int, int]:
        """Width and height [CSS pixels], from the header: the page does not jump while it loads."""
        width, height = struct.unpack(">II", self.content[16:24])
        return round(width * self.scale), round(height * self.scale)


def environment(module: str) -> jinja2.Environment:
    """Of the templates beside a module's file: what is filled in is escaped, and what is missing is an error."""
    return jinja2.Environment(
        loader=jinja2.FileSystemLoader(Path(module).parent / "templates"),
        autoescape=True,
        undefined=jinja2.StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
