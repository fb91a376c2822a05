"""The `hshjax` command: look at a measured material, fit it, keep the model; solve photographs. A file a subject."""

from hshjax.cli._cache import keep_programs
from hshjax.cli._console import typer  # first: it says what is missing
from hshjax.cli._material import fit, info
from hshjax.cli._stereo import stereo

app = typer.Typer(
    no_args_is_help=True,
    add_completion=False,
    help="Compact, reciprocal reflectance: fit measured materials, find shape and materials in photographs.",
    epilog="Examples:  hshjax info leather.bsdf  ·  hshjax fit leather.bsdf --order 8 --out leather.hshjax  ·  "
    "hshjax stereo ballPNG --out ball",
)
for command in (info, fit, stereo):
    app.command()(command)


def main() -> None:
    """Entry point of the console script."""
    import jax

    # A command line owns its process, so it may choose: figures are computed in double precision.
    jax.config.update("jax_enable_x64", True)
    keep_programs()
    app()
