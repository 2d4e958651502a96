"""``heartcase segment``: give each voxel a label."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import click

from heartcase.cli.shared.output import echo_warnings, working
from heartcase.cli.shared.output_path import OutputPath
from heartcase.cli.shared.stage_io import save_output, scan_options, stage_options
from heartcase.cli.stages.run import stage_run

__all__ = ["command"]


@click.command()
@click.argument("scan", type=click.Path(path_type=Path, readable=False))
@click.argument("output", type=OutputPath())
@click.option(
    "--markers", multiple=True, type=click.Path(path_type=Path, readable=False), help="Marker file; repeatable."
)
@scan_options
@stage_options
@working("segmenting")
def command(
    scan: Path,
    output: Path,
    markers: tuple[Path, ...],
    choice: dict[str, Any],
    recipe: Path | None,
    sets: tuple[str, ...],
) -> None:
    """Segment SCAN (best filtered first) and write the labels to OUTPUT (.nii.gz, .nrrd, .seg.nrrd, .safetensors).

    Markers and strokes come from the recipe, from --markers, or both; the labels are the recipe's, or those of a heart
    with four chambers.
    """
    from heartcase.pipeline.building.input_check import modality_warnings
    from heartcase.pipeline.bundle.assembly import told_of_outlines
    from heartcase.pipeline.image.landscape import resolve_segment
    from heartcase.pipeline.markers.placeholders import placeholder_problems
    from heartcase.pipeline.stages.stage import have
    from heartcase.pipeline.warnings import worst_first
    from heartcase.schemas.errors import RecipeError
    from heartcase.schemas.recipe.recipe import MarkerFile

    work = stage_run(recipe, sets, stage="segment")
    volume = work.take_scan(scan, choice)
    files = [MarkerFile(path=str(path.resolve())) for path in markers]
    given = work.recipe.segment
    is_left_open = given.method == "watershed" and None in (given.shape_sigma_mm, given.noise_floor)
    settings = resolve_segment(given, volume.modality)
    work.recipe = work.recipe.model_copy(update={"markers": (*work.recipe.markers, *files), "segment": settings})
    examples = placeholder_problems(work.recipe, work.outputs.whole)
    if examples:
        raise RecipeError(examples)
    work.outputs.filtered = work.outputs.scan
    work.run("markers")
    work.run("segment")
    found = have(work.outputs.segmentation).get()
    painted = work.outputs.markers.get() if work.outputs.markers else None
    work.told |= told_of_outlines(work.recipe, found, painted, volume)
    save_output(output, found, work.finished_history())
    of_modality = modality_warnings(volume) if is_left_open else ()
    echo_warnings(worst_first(*work.told.values(), of_modality))
