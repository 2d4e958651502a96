"""From landscape to labels, cold, beside the watersheds of other libraries given the same landscape and markers.

``raw`` also filters the scan and makes the landscape. Markers are the strokes of the phantom, with their own labels or
(``shuffled``) each with a random one, so that labels meet where there is no border; or ``scattered`` voxels with random
labels, one of 2000, so that every tie shows. Where two methods differ, both labels ought to come over passes as low.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import cc3d
import numpy as np
import SimpleITK as sitk
from skimage.segmentation import watershed

from benchmarks.phantom_inputs import PhantomInputs, phantom_inputs
from heartcase.phantom.metrics import dice
from heartcase.pipeline.data import UNMARKED, Markers
from heartcase.pipeline.image.filter_scan import filter_scan
from heartcase.pipeline.image.landscape import landscape, resolve_segment
from heartcase.pipeline.watershed.certainty import voxel_certainty
from heartcase.pipeline.watershed.forest import solve_forest
from heartcase.pipeline.watershed.segment_scan import segment_scan
from heartcase.pipeline.watershed.tree import build_basin_tree
from heartcase.schemas.arrays import Float32, UInt8
from heartcase.schemas.recipe.settings import FilterSettings, SegmentSettings


@dataclass(frozen=True)
class Inputs:
    """A landscape and markers."""

    source: PhantomInputs | None
    height: Float32
    markers: UInt8


def prepare(params: dict[str, Any]) -> Inputs:
    labels = params.pop("labels")
    if "voxels_across" in params:
        return _noise(params["voxels_across"])
    source = phantom_inputs(params)
    filtered = filter_scan(source.scan, FilterSettings())
    settings = resolve_segment(SegmentSettings(), filtered.modality)
    gradient = landscape(
        filtered.values,
        filtered.geometry.spacing_mm,
        gradient_sigma_mm=settings.gradient_sigma_mm,
        shape_sigma_mm=settings.shape_sigma_mm,
        # no peer divides what is flat, so there is nothing to compare over a floor
        noise_floor=0.0,
    ).height
    markers = source.markers.labels
    if labels == "shuffled":
        strokes = cc3d.connected_components(np.where(markers == UNMARKED, 0, markers + np.int32(1)))
        shuffled = np.random.default_rng(1).integers(0, 10, strokes.max() + 1).astype(np.uint8)
        markers = np.where(strokes > 0, shuffled[strokes], np.uint8(UNMARKED))
    elif labels == "scattered":
        random = np.random.default_rng(1)
        markers = np.full(gradient.shape, UNMARKED, np.uint8)
        markers.flat[random.choice(markers.size, markers.size // 2000, replace=False)] = random.integers(
            0, 10, markers.size // 2000
        )
    return Inputs(source, gradient, markers)


def _noise(across: int) -> Inputs:
    """A large landscape of blurred noise, made slice by slice so that making it takes no more memory than it."""
    random = np.random.default_rng(1)
    gradient = np.empty((across, across, across), np.float32)
    before = np.zeros((across, across), np.float32)
    for slice_ in gradient:
        noise = random.random((across, across), np.float32)
        before = 0.5 * before + noise + np.roll(noise, 1, 0) + np.roll(noise, 1, 1)
        slice_[:] = before
    markers = np.full(gradient.shape, UNMARKED, np.uint8)
    markers.flat[random.choice(markers.size, 20_000, replace=False)] = random.integers(0, 10, 20_000)
    return Inputs(None, gradient, markers)


def heartcase(inputs: Inputs) -> UInt8:
    return solve_forest(build_basin_tree(inputs.height), inputs.markers).labels


def heartcase_raw(inputs: Inputs) -> UInt8:
    assert inputs.source is not None
    filtered = filter_scan(inputs.source.scan, FilterSettings())
    markers = Markers(inputs.markers, filtered.geometry)
    return segment_scan(filtered, markers, SegmentSettings(), inputs.source.phantom.table).labels


def skimage(inputs: Inputs) -> UInt8:
    seeds = np.where(inputs.markers == UNMARKED, 0, inputs.markers.astype(np.int32) + 1)
    return (watershed(inputs.height, seeds, connectivity=1) - 1).astype(np.uint8)


def simpleitk(inputs: Inputs) -> UInt8:
    seeds = np.where(inputs.markers == UNMARKED, 0, inputs.markers.astype(np.int32) + 1)
    flooded = sitk.MorphologicalWatershedFromMarkers(
        sitk.GetImageFromArray(inputs.height), sitk.GetImageFromArray(seeds), markWatershedLine=False
    )
    return (sitk.GetArrayFromImage(flooded) - 1).astype(np.uint8)


REPEATS = {"heartcase": 9, "raw": 9}
METHODS = {"heartcase": heartcase, "raw": heartcase_raw, "skimage": skimage, "simpleitk": simpleitk}


def errors(inputs: Inputs, output: UInt8) -> dict[str, float]:
    """Agreement with skimage on the same landscape, and with the truth."""
    found = {"voxels [million]": output.size / 1e6}
    if inputs.source is None:
        return found
    differs = output != skimage(inputs)
    found["agreement with skimage [%]"] = 100.0 * float(1.0 - differs.mean())
    certainty = voxel_certainty(solve_forest(build_basin_tree(inputs.height), inputs.markers))
    found["voxels that differ though one label's pass is lower [1]"] = float((differs & (certainty > 0.0)).sum())
    truth, table = inputs.source.truth.labels, inputs.source.phantom.table
    found["blood pool Dice [1]"] = dice(output, truth, table.blood_values)
    return found
