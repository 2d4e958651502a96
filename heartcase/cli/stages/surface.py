"""``heartcase surface``: the visible surface and its normal map."""

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
@click.option("--glb", type=OutputPath(), help="Also write the surface as GLB for any viewer.")
@stage_options
@working("making the surface")
def command(structures: Path, output: Path, glb: Path | None, recipe: Path | None, sets: tuple[str, ...]) -> None:
    """Extract the surface of STRUCTURES (from 'heartcase walls' or 'edit') and write OUTPUT (.safetensors)."""
    from heartcase.pipeline.bundle.glb import glb_bytes
    from heartcase.pipeline.data import Structures
    from heartcase.pipeline.stages.stage import have
    from heartcase.schemas.files import atomic_write

    work = stage_run(recipe, sets, stage="surface")
    work.outputs.structures = node_of(work.take({"STRUCTURES": (structures, Structures)})[0])
    work.run("surface")
    made = have(work.outputs.surface).get()
    save_output(output, made, work.finished_history())
    if glb is not None:
        atomic_write(glb, glb_bytes(made))
    for warning in made.warnings:
        click.echo(f"warning: {warning}")
    click.echo(f"{len(made.triangles):,} triangles, {len(made.vertices_mm):,} vertices")
