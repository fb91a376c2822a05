"""Options that several commands share."""

from pathlib import Path
from typing import Annotated, Literal

from hshjax.cli._console import typer

File = Annotated[
    Path,
    typer.Argument(help="A measured material in any format that is read, or a model that `hshjax fit` saved."),
]
Json = Annotated[bool, typer.Option("--json", help="Print the figures as JSON, and nothing else, on standard output.")]
Force = Annotated[bool, typer.Option("--force", help="Replace files that are there.")]
Negatives = Annotated[
    Literal["keep", "clip", "mask"],
    typer.Option(help="Negative values of a measured file: keep as measured, make 0, or leave out."),
]
