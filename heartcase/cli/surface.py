"""``heartcase surface``: the visible surface and its normal map."""

from __future__ import annotations

from pathlib import Path

import click

from heartcase.cli.output import working
from heartcase.cli.stage_io import optional_recipe, save_output, settings_of, stage_options

__all__ = ["command"]


@click.command()
@click.argument("structures", type=click.Path(path_type=Path, readable=False))
@click.argument("output", type=click.Path(path_type=Path, readable=False))
@click.option(
    "--glb", type=click.Path(path_type=Path, readable=False), help="Also write the surface as GLB for any viewer."
)
@stage_options
@working("making the surface")
def command(structures: Path, output: Path, glb: Path | None, recipe: Path | None, sets: tuple[str, ...]) -> None:
    """Extract the surface of STRUCTURES (from 'heartcase walls' or 'edit') and write OUTPUT (.safetensors)."""
    from heartcase.pipeline.artifacts import load_artifact
    from heartcase.pipeline.data import Structures
    from heartcase.pipeline.mesh.glb import glb_bytes
    from heartcase.pipeline.surface import build_surface
    from heartcase.schemas.files import atomic_write
    from heartcase.schemas.settings import SurfaceSettings

    loaded = optional_recipe(recipe)
    settings = settings_of(SurfaceSettings, loaded.surface if loaded else None, sets)
    surface = build_surface(load_artifact(structures, Structures), settings)
    save_output(output, surface)
    if glb is not None:
        atomic_write(glb, glb_bytes(surface))
    for warning in surface.warnings:
        click.echo(f"warning: {warning}")
    click.echo(f"{len(surface.triangles):,} triangles, {len(surface.vertices_mm):,} vertices")
