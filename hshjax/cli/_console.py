"""What the commands of `hshjax` share: where they print, and how they end."""

import sys

try:
    import typer
    from rich.console import Console
    from rich.text import Text
except ModuleNotFoundError as missing:
    sys.exit(f"the hshjax command needs {missing.name}: pip install 'hshjax[experiments]'")

# No markup: paths and what files say of themselves may hold brackets.
console = Console(highlight=False, markup=False)
complaints = Console(highlight=False, markup=False, stderr=True)


def failure(message: str) -> Exception:
    """Prints a message; raise what is returned, which ends the command with status 2."""
    complaints.print(Text("error:", style="bold red"), message, soft_wrap=True)
    return typer.Exit(2)
