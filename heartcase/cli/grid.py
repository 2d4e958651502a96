"""``heartcase grid``: down-sample the tissue to simulation cells."""

from __future__ import annotations

from pathlib import Path

import click

from heartcase.cli.output import working
from heartcase.cli.stage_io import optional_recipe, save_output, settings_of, stage_options

__all__ = ["command"]


@click.command()
@click.argument("structures", type=click.Path(path_type=Path, readable=False))
@click.argument("output", type=click.Path(path_type=Path, readable=False))
@stage_options
@working("making the grid")
def command(structures: Path, output: Path, recipe: Path | None, sets: tuple[str, ...]) -> None:
    """Make the simulation grid of STRUCTURES (from 'heartcase walls' or 'edit') and write OUTPUT (.safetensors)."""
    from heartcase.pipeline.artifacts import load_artifact
    from heartcase.pipeline.data import Structures
    from heartcase.pipeline.grid import build_grid
    from heartcase.schemas.settings import GridSettings

    loaded = optional_recipe(recipe)
    settings = settings_of(GridSettings, loaded.grid if loaded else None, sets)
    grid = build_grid(load_artifact(structures, Structures), settings, pins=loaded.pins if loaded else ())
    save_output(output, grid)
    for warning in grid.warnings:
        click.echo(f"warning: {warning}")
    click.echo(f"{len(grid.nodes):,} nodes, {len(grid.cells):,} cells of {grid.geometry.spacing_mm[0]:.2f} mm")
