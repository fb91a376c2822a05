"""The `hshjax` command: look at a measured material, fit it, keep, convert and render it; solve photographs. A file a
subject; the work itself is done by functions of the library."""

import sys

from hshjax.cli._cache import keep_programs
from hshjax.cli._compare import compare
from hshjax.cli._console import INTERRUPTED, typer  # first: it says what is missing
from hshjax.cli._convert import convert
from hshjax.cli._fit import fit
from hshjax.cli._info import info
from hshjax.cli._render import render
from hshjax.cli._stereo import stereo

app = typer.Typer(
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
    help="Compact, reciprocal reflectance: fit measured materials, find shape and materials in photographs.",
    epilog="Examples:  hshjax info leather.bsdf  ·  hshjax fit leather.bsdf --order 8 --out leather  ·  "
    "hshjax render leather.hshjax --out leather.png  ·  hshjax stereo ballPNG --out ball.  "
    "Exit codes: 0 done, 1 bad input, 2 bad usage, 130 interrupted.",
)
for command in (info, fit, compare, convert, render, stereo):
    app.command()(command)


def main() -> None:
    """Entry point of the console script."""
    try:
        import jax

        # A command line owns its process, so it may choose: figures are computed in double precision.
        jax.config.update("jax_enable_x64", True)
        keep_programs()
        app()
    except KeyboardInterrupt:  # before a command has begun
        sys.exit(INTERRUPTED)
