"""``heartcase filter``: smooth a scan, keeping its edges."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import click

from heartcase.cli.output import working
from heartcase.cli.stage_io import (
    optional_recipe,
    read_scan_or_output,
    save_output,
    scan_options,
    settings_of,
    stage_options,
)

__all__ = ["command"]


@click.command()
@click.argument("scan", type=click.Path(path_type=Path, readable=False))
@click.argument("output", type=click.Path(path_type=Path, readable=False))
@scan_options
@stage_options
@working("smoothing the scan")
def command(scan: Path, output: Path, choice: dict[str, Any], recipe: Path | None, sets: tuple[str, ...]) -> None:
    """Smooth SCAN by anisotropic diffusion and write OUTPUT (.nii.gz, .nrrd, .mha or .safetensors)."""
    from heartcase.pipeline.filter import filter_scan
    from heartcase.pipeline.region import crop_scan
    from heartcase.pipeline.stages import with_modality
    from heartcase.schemas.settings import FilterSettings

    loaded = optional_recipe(recipe)
    settings = settings_of(FilterSettings, loaded.filter if loaded else None, sets)
    volume = crop_scan(read_scan_or_output(scan, choice), loaded.region if loaded else None)
    if loaded:
        volume = with_modality(volume, loaded)
    save_output(output, filter_scan(volume, settings))
