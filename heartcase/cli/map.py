"""``heartcase map``: tie the surface to the grid."""

from __future__ import annotations

from pathlib import Path

import click

from heartcase.cli.output import working
from heartcase.cli.stage_io import load_outputs, optional_recipe, save_output, settings_of, stage_options

__all__ = ["command"]


@click.command()
@click.argument("surface", type=click.Path(path_type=Path, readable=False))
@click.argument("grid", type=click.Path(path_type=Path, readable=False))
@click.argument("structures", type=click.Path(path_type=Path, readable=False))
@click.argument("output", type=click.Path(path_type=Path, readable=False))
@stage_options
@working("tying the surface to the grid")
def command(
    surface: Path, grid: Path, structures: Path, output: Path, recipe: Path | None, sets: tuple[str, ...]
) -> None:
    """Tie SURFACE to GRID and write OUTPUT (.safetensors).

    Both were made (by 'heartcase surface' and 'grid') from STRUCTURES, which tell where walls and gaps are.
    """
    from heartcase.pipeline.data import SimulationGrid, Structures, Surface
    from heartcase.pipeline.map import map_surface
    from heartcase.schemas.settings import MapSettings

    loaded = optional_recipe(recipe)
    settings = settings_of(MapSettings, loaded.map if loaded else None, sets)
    mesh, cells, fields = load_outputs(
        {"SURFACE": (surface, Surface), "GRID": (grid, SimulationGrid), "STRUCTURES": (structures, Structures)}
    )
    tied = map_surface(mesh, cells, fields, settings)
    save_output(output, tied)
    for warning in tied.warnings:
        click.echo(f"warning: {warning}")
