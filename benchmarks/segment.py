"""Marker-based watershed from a synthetic scan: ours beside SimpleITK's, given the same gradient and markers."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import SimpleITK as sitk

from benchmarks.phantom_inputs import phantom_inputs
from heartcase.phantom.anatomy.truth import Truth
from heartcase.phantom.metrics import dice, surface_error
from heartcase.pipeline.bundle.assembly import labels_of
from heartcase.pipeline.data import UNMARKED, Markers, Scan, Segmentation
from heartcase.pipeline.image.filter_scan import filter_scan
from heartcase.pipeline.image.gradient import gradient_magnitude
from heartcase.pipeline.walls.grow_walls import grow_walls
from heartcase.pipeline.watershed.segment_scan import segment_scan
from heartcase.schemas.labels import LabelTable
from heartcase.schemas.recipe.settings import EndMarker, FilterSettings, SegmentSettings, WallsSettings


@dataclass(frozen=True)
class Inputs:
    """A filtered scan, its gradient, the markers, and the true labels on the same lattice."""

    filtered: Scan
    gradient: Any
    markers: Markers
    table: LabelTable
    true_labels: Any
    truth: Truth | None
    ends: tuple[EndMarker, ...] = ()


def prepare(params: dict[str, Any]) -> Inputs:
    source = phantom_inputs(params)
    filtered = filter_scan(source.scan, FilterSettings())
    gradient = gradient_magnitude(filtered.values, filtered.geometry.spacing_mm)
    phantom = source.phantom
    return Inputs(filtered, gradient, source.markers, phantom.table, source.truth.labels, phantom.truth, phantom.ends)


def heartcase(inputs: Inputs) -> Segmentation:
    return segment_scan(inputs.filtered, inputs.markers, SegmentSettings(), inputs.table)


def simpleitk(inputs: Inputs) -> Segmentation:
    painted = inputs.markers.labels.astype(np.int32) + 1
    painted[painted == UNMARKED + 1] = 0
    flooded = sitk.MorphologicalWatershedFromMarkers(
        sitk.GetImageFromArray(inputs.gradient), sitk.GetImageFromArray(painted), markWatershedLine=False
    )
    labels = (sitk.GetArrayFromImage(flooded) - 1).astype(np.uint8)
    return Segmentation(labels, inputs.filtered.geometry, inputs.table)


METHODS = {"heartcase": heartcase, "simpleitk": simpleitk}


def errors(inputs: Inputs, output: Segmentation) -> dict[str, float]:
    """Dice and surface distance of every structure, after the end discs have cut the vessels where the truth ends."""
    assert inputs.truth is not None
    finished = labels_of(grow_walls(output, WallsSettings(), inputs.ends))
    truth, table = inputs.true_labels, output.table
    found: dict[str, float] = {"blood pool Dice [1]": dice(finished.labels, truth, table.blood_values)}
    for label in table:
        if label.value == 0:
            continue
        distance = surface_error(finished.labels, finished.geometry, inputs.truth, label.value)
        found[f"{label.name} Dice [1]"] = dice(finished.labels, truth, label.value)
        found[f"{label.name} mean distance [mm]"] = distance.mean_mm
        found[f"{label.name} 95% distance [mm]"] = distance.percentile_95_mm
    found["voxels marked [%]"] = 100.0 * float((inputs.markers.labels != UNMARKED).mean())
    return found
