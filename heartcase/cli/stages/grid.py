"""``heartcase grid``: down-sample the tissue to simulation cells."""

from __future__ import annotations

from pathlib import Path

import click

from heartcase.cli.shared.output import working
from heartcase.cli.shared.output_path import OutputPath
from heartcase.cli.shared.stage_io import save_output, stage_options
from heartcase.cli.stages.run import node_of, stage_run

__all__ = ["command"]


@click.command()
@click.argument("structures", type=click.Path(path_type=Path, readable=False))
@click.argument("output", type=OutputPath())
@stage_options
@working("making the grid")
def command(structures: Path, output: Path, recipe: Path | None, sets: tuple[str, ...]) -> None:
    """Make the simulation grid of STRUCTURES (from 'heartcase walls' or 'edit') and write OUTPUT (.safetensors)."""
    from heartcase.pipeline.cells.build_grid import resolve_grid
    from heartcase.pipeline.data import Structures
    from heartcase.pipeline.stages.stage import have

    work = stage_run(recipe, sets, stage="grid")
    work.outputs.structures = node_of(work.take({"STRUCTURES": (structures, Structures)})[0])
    work.recipe = work.recipe.model_copy(update={"grid": resolve_grid(work.recipe.grid)})
    work.run("grid")
    grid = have(work.outputs.grid).get()
    save_output(output, grid, work.finished_history())
    for warning in grid.warnings:
        click.echo(f"warning: {warning}")
    click.echo(f"{len(grid.nodes):,} nodes, {len(grid.cells):,} cells of {grid.geometry.spacing_mm[0]:.2f} mm")
