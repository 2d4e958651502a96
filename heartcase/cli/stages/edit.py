"""``heartcase edit``: septal defects and sculpting."""

from __future__ import annotations

from pathlib import Path

import click

from heartcase.cli.shared.output import echo_warnings, working
from heartcase.cli.shared.output_path import OutputPath
from heartcase.cli.shared.stage_io import save_output
from heartcase.cli.stages.run import node_of, stage_run

__all__ = ["command"]


@click.command()
@click.argument("structures", type=click.Path(path_type=Path, readable=False))
@click.argument("output", type=OutputPath())
@click.option(
    "--recipe",
    type=click.Path(path_type=Path, readable=False),
    required=True,
    help="Recipe whose edits are carried out.",
)
@working("editing")
def command(structures: Path, output: Path, recipe: Path) -> None:
    """Carry out a recipe's edits on STRUCTURES (from 'heartcase walls') and write OUTPUT (.safetensors)."""
    from heartcase.pipeline.data import Structures
    from heartcase.pipeline.edits.apply_edits import with_edit_names
    from heartcase.pipeline.stages.stage import have

    work = stage_run(recipe)
    (grown,) = work.take({"STRUCTURES": (structures, Structures)})
    work.outputs.grown = node_of(grown)
    work.run("edit")
    edited = have(work.outputs.structures).get()
    save_output(output, edited, work.finished_history())
    told = set(grown.warnings)
    echo_warnings(line for line in with_edit_names(edited.warnings, work.recipe.edits) if line not in told)
