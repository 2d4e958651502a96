"""The read stage: the scan, and its region of interest cut out."""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import Any

from heartcase.pipeline.data import Scan
from heartcase.pipeline.stages.stage import Stage, Work
from heartcase.schemas.errors import ScanError
from heartcase.schemas.recipe.recipe import Recipe
from heartcase.schemas.recipe.settings import resolved

__all__ = ["STAGE", "region_of_scan", "whole_scan", "with_modality"]


def whole_scan(recipe: Recipe, directory: Path) -> Scan:
    """Read a recipe's scan, all of it.

    Raises
    ------
    ScanError
        There is no scan, or it cannot be read.
    """
    from heartcase.pipeline.formats.read_scan import read_scan

    path = directory / recipe.scan.path
    if not path.exists():
        where = f" Where it comes from: {recipe.scan.origin}" if recipe.scan.origin else ""
        raise ScanError(
            f"there is no scan: check the spelling (it is relative to the recipe), or put the scan there.{where}",
            place="scan.path",
        )
    scan = with_modality(read_scan(path, **recipe.scan.choice), recipe)
    return dataclasses.replace(scan, whole_sha256=scan.values_sha256)


def region_of_scan(recipe: Recipe, directory: Path) -> Scan:
    """Read a recipe's scan and cut its region of interest out.

    Raises
    ------
    ScanError
        There is no scan, or it cannot be read.
    """
    from heartcase.pipeline.image.region import crop_scan

    return crop_scan(whole_scan(recipe, directory), recipe.region)


def with_modality(scan: Scan, recipe: Recipe) -> Scan:
    """The scan with its kind: the file's own word counts, the recipe's where the file says nothing."""
    if scan.modality != "unknown" or recipe.scan.modality is None:
        return scan
    return dataclasses.replace(scan, modality=recipe.scan.modality)


def _settings(work: Work) -> dict[str, Any]:
    # the end of a series UID may identify the patient, so it is in no record
    choice = {name: value for name, value in work.recipe.scan.choice.items() if name != "series"}
    return choice | {"region": resolved(work.recipe.region) if work.recipe.region else None}


def _compute(work: Work) -> Scan:
    from heartcase.pipeline.image.region import crop_scan

    whole = whole_scan(work.recipe, work.directory)
    work.outputs.whole = whole.geometry
    return crop_scan(whole, work.recipe.region)


STAGE = Stage(
    name="read",
    version=3,
    title="reading the scan",
    deed="read the scan",
    subject="",
    output="scan",
    kind=Scan,
    settings=_settings,
    compute=_compute,
    is_kept=lambda _: False,
)
