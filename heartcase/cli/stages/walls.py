"""``heartcase walls``: distance fields of the structures, and grown walls."""

from __future__ import annotations

from pathlib import Path

import click

from heartcase.cli.shared.output import echo_warnings, working
from heartcase.cli.shared.output_path import OutputPath
from heartcase.cli.shared.stage_io import save_output, stage_options
from heartcase.cli.stages.run import node_of, stage_run

__all__ = ["command"]


@click.command()
@click.argument("labels", type=click.Path(path_type=Path, readable=False))
@click.argument("output", type=OutputPath())
@stage_options
@working("growing the walls")
def command(labels: Path, output: Path, recipe: Path | None, sets: tuple[str, ...]) -> None:
    """Grow the walls of LABELS (from 'heartcase segment', .safetensors; or any label volume) into OUTPUT."""
    from heartcase.pipeline.bundle.assembly import told_of_ends, told_of_outlines
    from heartcase.pipeline.data import Segmentation
    from heartcase.pipeline.markers.load_markers import load_segmentation
    from heartcase.pipeline.stages.stage import have
    from heartcase.pipeline.walls.grow_walls import resolve_walls
    from heartcase.pipeline.warnings import CaseWarning, worst_first

    work = stage_run(recipe, sets, stage="walls")
    if labels.suffix == ".safetensors":
        (segmentation,) = work.take({"LABELS": (labels, Segmentation)})
    else:
        naming = work.recipe.segment
        segmentation = load_segmentation(
            labels,
            naming.names,
            work.recipe.table,
            None,
            convention=naming.convention,
            others=naming.others,
            order=naming.order,
        )
        work.told |= told_of_outlines(work.recipe, segmentation, None, None)
        if naming.method != "labels":
            unknown = "the labels came from an image file, which holds nothing of what was told when they were made"
            work.told["unknown"] = (CaseWarning(unknown, has_stated_grade=True),)
    settings = resolve_walls(work.recipe.walls, segmentation.geometry, segmentation.table)
    work.recipe = work.recipe.model_copy(update={"walls": settings})
    work.outputs.segmentation = node_of(segmentation)
    work.run("walls")
    grown = have(work.outputs.grown).get()
    work.told |= told_of_ends(work.recipe, segmentation, grown)
    save_output(output, grown, work.finished_history())
    echo_warnings(worst_first(*work.told.values(), grown.warnings))
