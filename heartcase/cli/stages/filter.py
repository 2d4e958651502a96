"""``heartcase filter``: smooth a scan, keeping its edges."""

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
@scan_options
@stage_options
@working("smoothing the scan")
def command(scan: Path, output: Path, choice: dict[str, Any], recipe: Path | None, sets: tuple[str, ...]) -> None:
    """Smooth SCAN by anisotropic diffusion and write OUTPUT (.nii.gz, .nrrd, .mha or .safetensors)."""
    from heartcase.pipeline.building.input_check import modality_warnings
    from heartcase.pipeline.image.filter_scan import resolve_filter
    from heartcase.pipeline.stages.stage import have

    work = stage_run(recipe, sets, stage="filter")
    volume = work.take_scan(scan, choice)
    of_modality = modality_warnings(volume) if work.recipe.filter.method is None else ()
    settings = resolve_filter(work.recipe.filter, volume)
    work.recipe = work.recipe.model_copy(update={"filter": settings})
    work.run("filter")
    save_output(output, have(work.outputs.filtered).get(), work.finished_history())
    echo_warnings((*volume.warnings, *of_modality), err=True)
