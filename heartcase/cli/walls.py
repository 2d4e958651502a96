"""``heartcase walls``: distance fields of the structures, and grown walls."""

from __future__ import annotations

from pathlib import Path

import click

from heartcase.cli.output import working
from heartcase.cli.stage_io import optional_recipe, save_output, settings_of, stage_options

__all__ = ["command"]


@click.command()
@click.argument("labels", type=click.Path(path_type=Path, readable=False))
@click.argument("output", type=click.Path(path_type=Path, readable=False))
@stage_options
@working("growing the walls")
def command(labels: Path, output: Path, recipe: Path | None, sets: tuple[str, ...]) -> None:
    """Grow the walls of LABELS (from 'heartcase segment', .safetensors; or any label volume) into OUTPUT."""
    from heartcase.pipeline.artifacts import load_artifact
    from heartcase.pipeline.data import Segmentation
    from heartcase.pipeline.markers import load_segmentation
    from heartcase.pipeline.septa import open_places
    from heartcase.pipeline.walls import grow_walls
    from heartcase.schemas.labels import default_label_table
    from heartcase.schemas.settings import SegmentSettings, WallsSettings

    loaded = optional_recipe(recipe)
    settings = settings_of(WallsSettings, loaded.walls if loaded else None, sets)
    if labels.suffix == ".safetensors":
        segmentation = load_artifact(labels, Segmentation)
    else:
        table = loaded.table if loaded else default_label_table()
        naming = loaded.segment if loaded else SegmentSettings()
        segmentation = load_segmentation(
            labels, naming.names, table, None, convention=naming.convention, others=naming.others
        )
    places = open_places(loaded.strokes, loaded.landmarks, loaded.table) if loaded else ()
    save_output(output, grow_walls(segmentation, settings, loaded.ends if loaded else (), open_places=places))
