"""``heartcase segment``: give each voxel a label."""

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
    from heartcase.pipeline.markers import load_markers, load_segmentation
    from heartcase.pipeline.region import crop_scan
    from heartcase.pipeline.segment import segment_scan
    from heartcase.schemas.labels import default_label_table
    from heartcase.schemas.recipe import MarkerFile
    from heartcase.schemas.settings import SegmentSettings

    loaded = optional_recipe(recipe)
    settings = settings_of(SegmentSettings, loaded.segment if loaded else None, sets)
    table = loaded.table if loaded else default_label_table()
    directory = recipe.parent if recipe else Path()
    volume = crop_scan(read_scan_or_output(scan, choice), loaded.region if loaded else None)
    if settings.method == "labels" and settings.file is not None:
        finished = load_segmentation(
            directory / settings.file,
            settings.names,
            table,
            volume.geometry,
            convention=settings.convention,
            others=settings.others,
        )
        save_output(output, finished)
        return
    painted = None
    if settings.method == "watershed":
        files = [MarkerFile(path=str(path.resolve())) for path in markers]
        files = [*(loaded.markers if loaded else ()), *files]
        strokes = loaded.strokes if loaded else ()
        painted = load_markers(
            files, strokes, table, volume.geometry, directory, scan=volume, automatic=settings.automatic
        )
    save_output(output, segment_scan(volume, painted, settings, table))
