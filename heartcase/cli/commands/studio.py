"""``heartcase studio``: a page in the browser in which a scan is painted."""

from __future__ import annotations

import webbrowser
from pathlib import Path
from typing import Any

import click

from heartcase.cli.commands.info import kind_of
from heartcase.cli.shared.output import working
from heartcase.cli.shared.output_path import OutputPath
from heartcase.cli.shared.stage_io import scan_options
from heartcase.schemas.errors import UsageError
from heartcase.schemas.recipe.recipe import parse_recipe, read_recipe_text

__all__ = ["command"]

_LEFT = ("", "; the recipe holds every stroke", "; the recipes hold every stroke")
"""What is so when none, one or more recipes were open."""


@click.command()
@click.argument("path", required=False, type=click.Path(path_type=Path, readable=False))
@click.option(
    "--out",
    type=OutputPath(is_folder=True),
    help="Where the case of PATH goes, with the build's cache and what can be taken back; by default where it went "
    "when the recipe was open last, else beside the recipe, as for what is chosen on the start page.",
)
@click.option(
    "--recipe",
    type=OutputPath(),
    help="For a scan: the recipe that is written for it; case.toml. For a folder of DICOM files, too.",
)
@scan_options
@click.option(
    "--port", type=click.IntRange(0, 65535), default=0, help="Port on this machine; a free one when left out."
)
@click.option("--browser/--no-browser", default=True, help="Whether to open the page in the browser.")
def command(
    path: Path | None, out: Path | None, recipe: Path | None, port: int, browser: bool, choice: dict[str, Any]
) -> None:
    """Make a case in the browser, on this machine alone: paint on a scan, build, operate.

    PATH is a recipe, a case, or a scan, for which a recipe is written first. Without it, and for a folder, a start page
    opens: recent work, sample cases, and the series of a DICOM folder to choose from. Where --recipe or an option that
    chooses is given, a folder is read as a scan at once. Every stroke is saved in the recipe when it is over, and can
    be taken back, also after a restart. Ctrl-C ends the server. Who has the printed address can use the pages, and
    nobody else.
    """
    from heartcase.studio.serving.serve import serve

    opening = {} if path is None else _opening(path, recipe, choice)
    written = None if opening.get("recipe") == path else opening.get("recipe")
    if written is not None and out is None:
        # another recipe may have had its name, and have been built elsewhere
        out = written.resolve().parent

    def ready(address: str) -> None:
        click.echo(f"The studio is at  {address}\nCtrl-C ends it.")
        if browser:
            webbrowser.open(address)

    def noted(note: str) -> None:
        if written is None:
            click.echo(f"note: {note}", err=True)

    left = serve(**opening, out=out, port=port, ready=ready, noted=noted)
    click.echo(f"The studio is closed{_LEFT[min(left.recipe_count, 2)]}.")
    for recording in left.recordings:
        click.echo(f"Recorded: {recording}")
    if left.case_count and not left.recordings:
        click.echo("No recording was written.")


def _opening(path: Path, recipe: Path | None, choice: dict[str, Any]) -> dict[str, Path]:
    """What the page shows first."""
    kind = kind_of(path)
    if kind == "recording":
        raise UsageError("is a recording: the studio opens a scan, a recipe or a case", place="PATH")
    if kind == "case":
        return {"case": path}
    if kind == "recipe":
        if choice:
            raise UsageError("a recipe says itself which images are read: change its [scan]", place=next(iter(choice)))
        # What is wrong in it is said here, and not on the page alone.
        parse_recipe(read_recipe_text(path), needs_markers=False)
        return {"recipe": path}
    if path.is_dir() and recipe is None and not choice:
        return {"folder": path}
    recipe = recipe or Path("case.toml")
    _write_recipe(path, recipe, choice)
    return {"recipe": recipe}


def _write_recipe(scan: Path, recipe: Path, choice: dict[str, Any]) -> None:
    from heartcase.pipeline.building.starter_recipe import write_recipe

    if recipe.exists():
        raise UsageError("there is already a recipe: open it, or choose another --recipe", place=str(recipe))
    with working("reading the scan"):
        warnings = write_recipe(scan, recipe, choice=choice, with_examples=False)
    for warning in warnings:
        click.echo(f"note: {warning}", err=True)
    click.echo(f"wrote {recipe}: it holds what you do")
