"""``heartcase studio``: a page in the browser in which a recipe's scan is painted."""

from __future__ import annotations

import webbrowser
from pathlib import Path

import click

from heartcase.schemas.errors import MissingPathError, UsageError

__all__ = ["command"]


@click.command()
@click.argument("recipe", type=click.Path(path_type=Path, readable=False))
@click.option(
    "--out",
    type=click.Path(path_type=Path, readable=False),
    default=Path(),
    help="Where the case goes, with the build's cache; here by default.",
)
@click.option(
    "--port", type=click.IntRange(0, 65535), default=0, help="Port on this machine; a free one when left out."
)
@click.option("--browser/--no-browser", default=True, help="Whether to open the page in the browser.")
def command(recipe: Path, out: Path, port: int, browser: bool) -> None:
    """Paint on RECIPE's scan in the browser, on this machine alone.

    Every stroke is saved in RECIPE when it is over, and can be taken back, also after a restart. Ctrl-C ends the
    server. Who has the printed address can use the page, and nobody else.
    """
    if not recipe.exists():
        raise MissingPathError("there is nothing at this path: check its spelling", place="RECIPE")
    if recipe.suffix.lower() != ".toml":
        raise UsageError("is no recipe: write one with  heartcase new SCAN  and open that", place="RECIPE")
    from heartcase.studio.serve import serve

    def ready(address: str) -> None:
        click.echo(f"The studio is at  {address}\nCtrl-C ends it.")
        if browser:
            webbrowser.open(address)

    serve(recipe, out=out, port=port, ready=ready)
    click.echo("The studio is closed; the recipe holds every stroke.")
