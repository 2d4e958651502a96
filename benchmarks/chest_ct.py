"""Watershed of a real CT from the strokes of its recipe; the pulmonary artery against a label made by others."""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.segment import METHODS, Inputs
from heartcase.phantom.metrics import dice
from heartcase.pipeline.data import UNMARKED, Scan, Segmentation
from heartcase.pipeline.formats.read_scan import read_labels, read_scan
from heartcase.pipeline.image.filter_scan import filter_scan
from heartcase.pipeline.image.gradient import gradient_magnitude
from heartcase.pipeline.image.region import crop_scan
from heartcase.pipeline.markers.load_markers import load_markers
from heartcase.schemas.errors import UsageError
from heartcase.schemas.recipe.recipe import load_recipe

__all__ = ["METHODS", "errors", "prepare"]

RECIPE = Path(__file__).parents[1] / "sample_cases" / "chest_ct.toml"


def prepare(params: dict[str, Any]) -> Inputs:
    recipe = load_recipe(RECIPE)
    path = RECIPE.parent / recipe.scan.path
    if not path.exists():
        raise UsageError(f"the scan is not there: {recipe.scan.origin}", place="segment-chest-ct")
    scan = dataclasses.replace(read_scan(path), modality=recipe.scan.modality)
    filtered = filter_scan(crop_scan(scan, recipe.region), recipe.filter)
    given = read_labels(path.with_name("pulmonary_artery.nii.gz"))
    # The label goes through the same crop as the scan, so that both end where the region ends.
    artery = crop_scan(Scan((given.values > 0).astype(np.float32), given.geometry), recipe.region).values > 0.5
    true_labels = np.where(artery, np.uint8(recipe.table["pulmonary artery"].value), np.uint8(0))
    gradient = gradient_magnitude(filtered.values, filtered.geometry.spacing_mm)
    markers = load_markers((), recipe.strokes, recipe.table, filtered.geometry, RECIPE.parent)
    return Inputs(filtered, gradient, markers, recipe.table, true_labels, None)


def errors(inputs: Inputs, output: Segmentation) -> dict[str, float]:
    """Dice of the pulmonary artery in the region of interest."""
    artery = output.table["pulmonary artery"].value
    return {
        "pulmonary artery Dice [1]": dice(output.labels, inputs.true_labels, artery),
        "voxels of the region marked [%]": 100.0 * float((inputs.markers.labels != UNMARKED).mean()),
    }
