"""``heartcase map``: tie the surface to the grid."""

from __future__ import annotations

from pathlib import Path

import click

from heartcase.cli.shared.output import working
from heartcase.cli.shared.output_path import OutputPath
from heartcase.cli.shared.stage_io import save_output, stage_options
from heartcase.cli.stages.run import node_of, stage_run

__all__ = ["command"]


@click.command()
@click.argument("surface", type=click.Path(path_type=Path, readable=False))
@click.argument("grid", type=click.Path(path_type=Path, readable=False))
@click.argument("structures", type=click.Path(path_type=Path, readable=False))
@click.argument("output", type=OutputPath())
@stage_options
@working("tying the surface to the grid")
def command(
    surface: Path, grid: Path, structures: Path, output: Path, recipe: Path | None, sets: tuple[str, ...]
) -> None:
    """Tie SURFACE to GRID and write OUTPUT (.safetensors).

    Both were made (by 'heartcase surface' and 'grid') from STRUCTURES, which tell where walls and gaps are.
    """
    from heartcase.pipeline.data import SimulationGrid, Structures, Surface
    from heartcase.pipeline.stages.stage import have

    work = stage_run(recipe, sets, stage="map")
    mesh, cells, fields = work.take(
        {"SURFACE": (surface, Surface), "GRID": (grid, SimulationGrid), "STRUCTURES": (structures, Structures)}
    )
    outputs = work.outputs
    outputs.surface, outputs.grid, outputs.structures = node_of(mesh), node_of(cells), node_of(fields)
    work.run("map")
    tied = have(outputs.grid_map).get()
    save_output(output, tied, work.finished_history())
    for warning in tied.warnings:
        click.echo(f"warning: {warning}")
