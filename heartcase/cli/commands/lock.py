"""``heartcase lock``: a recipe with every setting written down."""

from __future__ import annotations

from pathlib import Path

import click

from heartcase.cli.shared.output import working
from heartcase.cli.shared.output_path import OutputPath
from heartcase.schemas.bundle.placing import refuse_inside_case
from heartcase.schemas.errors import UsageError
from heartcase.schemas.files import atomic_write
from heartcase.schemas.recipe.recipe import load_recipe

__all__ = ["command"]

SUFFIX = ".lock.toml"


@click.command()
@click.argument("recipe", type=click.Path(path_type=Path, readable=False))
@click.option("--out", type=OutputPath(), help="The locked recipe; NAME.lock.toml beside RECIPE.")
@click.option("--force", is_flag=True, help="Replace a file that is there.")
@working("reading the scan")
def command(recipe: Path, out: Path | None, force: bool) -> None:
    """Write RECIPE with every setting stated, so that no default of a later heartcase changes the case silently.

    The scan and the marker files must be there: settings that depend on them are worked out, and their hashes are
    kept. Build the locked recipe like any other.
    """
    from heartcase.pipeline.building.lock import lock_recipe, recipe_text

    out = out or recipe.with_name(f"{recipe.name.removesuffix('.toml').removesuffix('.lock')}{SUFFIX}")
    refuse_inside_case(out, place="--out")
    loaded = load_recipe(recipe)
    if out.exists() and not force:
        raise UsageError("there is already a file of this name: choose another --out, or give --force", place="--out")
    if not out.absolute().parent.is_dir():
        raise UsageError("the folder does not exist: make it first", place="--out")
    locked = lock_recipe(loaded, directory=recipe.parent, out=out.parent)
    try:
        atomic_write(out, recipe_text(locked).encode())
    except OSError as error:
        raise UsageError(f"cannot be written: {error.strerror}", place="--out") from None
    click.echo(f"wrote {out}: keep it with the case; build it with  heartcase build {out}")
