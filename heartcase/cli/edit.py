"""``heartcase edit``: septal defects and sculpting."""

from __future__ import annotations

from pathlib import Path

import click

from heartcase.cli.output import working
from heartcase.cli.stage_io import save_output

__all__ = ["command"]


@click.command()
@click.argument("structures", type=click.Path(path_type=Path, readable=False))
@click.argument("output", type=click.Path(path_type=Path, readable=False))
@click.option(
    "--recipe",
    type=click.Path(path_type=Path, readable=False),
    required=True,
    help="Recipe whose edits are carried out.",
)
@working("editing")
def command(structures: Path, output: Path, recipe: Path) -> None:
    """Carry out a recipe's edits on STRUCTURES (from 'heartcase walls') and write OUTPUT (.safetensors)."""
    from heartcase.pipeline.artifacts import load_artifact
    from heartcase.pipeline.data import Structures
    from heartcase.pipeline.edit import apply_edits
    from heartcase.schemas.recipe import load_recipe

    edits = load_recipe(recipe).edits
    save_output(output, apply_edits(load_artifact(structures, Structures), edits))
