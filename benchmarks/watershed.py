"""From gradient to labels, cold, beside the watersheds of other libraries given the same gradient and markers.

``raw`` also filters the scan and takes the gradient. ``consistent`` markers are the strokes of the phantom; those with
``random`` labels make a label meet others everywhere, also where there is no border, so that every tie shows.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt
import SimpleITK as sitk
from phantom_inputs import PhantomInputs, phantom_inputs
from skimage.segmentation import watershed

from heartcase.phantom.metrics import dice
from heartcase.pipeline.data import Markers
from heartcase.pipeline.filter import filter_scan
from heartcase.pipeline.gradient import gradient_magnitude
from heartcase.pipeline.segment import segment_scan
from heartcase.pipeline.watershed.forest import solve_forest
from heartcase.pipeline.watershed.tree import build_basin_tree
from heartcase.schemas.settings import FilterSettings, SegmentSettings

UInt8 = npt.NDArray[np.uint8]


@dataclass(frozen=True)
class Inputs:
    """A gradient and markers."""

    source: PhantomInputs | None
    gradient: npt.NDArray[np.float32]
    markers: UInt8


def prepare(params: dict[str, Any]) -> Inputs:
    labels = params.pop("labels")
    if "voxels_across" in params:
        return _noise(params["voxels_across"])
    source = phantom_inputs(params)
    filtered = filter_scan(source.scan, FilterSettings())
    gradient = gradient_magnitude(filtered.values, filtered.geometry.spacing_mm)
    markers = source.markers.labels
    if labels == "random":
        random = np.random.default_rng(1)
        markers = np.full(gradient.shape, Markers.UNMARKED, np.uint8)
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
    markers = np.full(gradient.shape, Markers.UNMARKED, np.uint8)
    markers.flat[random.choice(markers.size, 20_000, replace=False)] = random.integers(0, 10, 20_000)
    return Inputs(None, gradient, markers)


def heartcase(inputs: Inputs) -> UInt8:
    return solve_forest(build_basin_tree(inputs.gradient), inputs.markers).labels


def heartcase_raw(inputs: Inputs) -> UInt8:
    assert inputs.source is not None
    filtered = filter_scan(inputs.source.scan, FilterSettings())
    markers = Markers(inputs.markers, filtered.geometry)
    return segment_scan(filtered, markers, SegmentSettings(), inputs.source.phantom.table).labels


def skimage(inputs: Inputs) -> UInt8:
    seeds = np.where(inputs.markers == Markers.UNMARKED, 0, inputs.markers.astype(np.int32) + 1)
    return (watershed(inputs.gradient, seeds, connectivity=1) - 1).astype(np.uint8)


def simpleitk(inputs: Inputs) -> UInt8:
    seeds = np.where(inputs.markers == Markers.UNMARKED, 0, inputs.markers.astype(np.int32) + 1)
    flooded = sitk.MorphologicalWatershedFromMarkers(
        sitk.GetImageFromArray(inputs.gradient), sitk.GetImageFromArray(seeds), markWatershedLine=False
    )
    return (sitk.GetArrayFromImage(flooded) - 1).astype(np.uint8)


METHODS = {"heartcase": heartcase, "raw": heartcase_raw, "skimage": skimage, "simpleitk": simpleitk}


def errors(inputs: Inputs, output: UInt8) -> dict[str, float]:
    """Agreement with skimage on the same gradient, and with the truth."""
    found = {"voxels [million]": output.size / 1e6}
    if inputs.source is None:
        return found
    found["agreement with skimage [%]"] = 100.0 * float((output == skimage(inputs)).mean())
    truth, table = inputs.source.truth.labels, inputs.source.phantom.table
    found["blood pool Dice [1]"] = dice(output, truth, table.blood_values)
    return found
