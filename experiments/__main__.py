"""The command: `python -m experiments CONFIG.toml ... [key.sub=value ...]`."""

import os
from pathlib import Path
from typing import Annotated

# Figures go to files; a display, where there is one, stays out of it. Read when matplotlib is imported.
os.environ["MPLBACKEND"] = "agg"

import typer
from rich.console import Console
from rich.table import Table

from experiments import config as configs, recipes
from experiments.progress import Voice

app = typer.Typer(add_completion=False, pretty_exceptions_enable=False, rich_markup_mode=None)


def _help() -> str:
    width = max((len(name) for name in recipes.available()), default=0)
    listing = "\n".join(f"  {name:{width}}  {recipes.summary(name)}" for name in recipes.available())
    return f"""Run studies, each described by a TOML file, and write a report about each.

\b
Examples:
  python -m experiments configs/quickstart.toml
  python -m experiments configs/quickstart.toml seed=1 name=second
  python -m experiments configs/smoke/*.toml --runs runs/smoke
  python -m experiments --describe {next(iter(recipes.available()), "NAME")}

\b
Recipes:
{listing}

A run lives in RUNS/<name>-<hash of its resolved config>/ and ends in report.html. A finished run is skipped; an
interrupted one (Ctrl-C is fine) continues where it was when the same command is given again.

An override key.sub=value changes one value of every config given. Values are TOML; a bare word is a string. The key
recipe="..." of a file chooses the recipe; --describe shows the keys of one. Paths "$HSHJAX_DATA/..." lie in the folder
of measured data that this environment variable names."""


@app.command(help=_help())
def main(
    arguments: Annotated[
        list[str] | None, typer.Argument(metavar="CONFIG.toml | KEY=VALUE", show_default=False)
    ] = None,
    runs: Annotated[Path, typer.Option(help="Folder of the runs.")] = Path("runs"),
    force: Annotated[bool, typer.Option("--force", help="Do a run again from its beginning.")] = False,
    keep_stages: Annotated[
        bool, typer.Option("--keep-stages", help="Resume even if the code has changed since the interruption.")
    ] = False,
    devices: Annotated[
        int | None, typer.Option(min=1, help="Devices of JAX for all configs, as the key devices=N of each.")
    ] = None,
    list_recipes: Annotated[bool, typer.Option("--list", help="List the recipes.")] = False,
    describe: Annotated[str | None, typer.Option(metavar="RECIPE", help="Show the keys of a recipe.")] = None,
) -> None:
    if list_recipes:
        for name in recipes.available():
            typer.echo(f"{name}: {recipes.summary(name)}")
        return
    try:
        if describe is not None:
            _describe(describe)
            return
        files = [Path(argument) for argument in arguments or [] if not configs.is_override(argument)]
        overrides = [argument for argument in arguments or [] if configs.is_override(argument)]
        overrides += [] if devices is None else [f"devices={devices}"]
        if not files:
            raise configs.ConfigError("no config given; try: python -m experiments --help")
        # All are read before the first is run: a typing error in the last one shows at once.
        resolved = [configs.load(path, overrides) for path in files]
    except configs.ConfigError as error:
        typer.echo(f"error: {error}".replace("\n", "\nerror: "), err=True)
        raise typer.Exit(2) from None
    from experiments import runner  # jax only now: --help and errors need not wait for it

    voice = Voice()
    try:
        runner.start(max(config.devices for config in resolved))
    except ValueError as error:
        typer.echo(f"error: {error}", err=True)
        raise typer.Exit(2) from None
    for config in resolved:
        try:
            report = runner.run(config, runs, voice, force=force, keep_stages=keep_stages)
        except KeyboardInterrupt:
            folder = runner.folder_of(config, runs)
            typer.echo(f"interrupted: {folder}; the same command continues it", err=True)
            raise typer.Exit(130) from None
        typer.echo(f"report: {report}")


def _describe(name: str) -> None:
    """Prints summary and keys of a recipe."""
    if name not in recipes.available():
        raise configs.ConfigError(f"unknown recipe {name!r}; recipes: {', '.join(recipes.available())}")
    table = Table(box=None, pad_edge=False)
    for column in ("key", "type", "default", ""):
        table.add_column(column)
    for row in configs.describe(recipes.load(name).Config):
        table.add_row(*row)
    console = Console(highlight=False, markup=False)
    console.print(recipes.summary(name))
    console.print(table)


if __name__ == "__main__":
    app(prog_name="python -m experiments")
