"""Telling apart reconstructions whose headers are alike, by measured sharpness and noise.

The name of a reconstruction kernel is a text of the header and is shown nowhere. What it does can be measured: the same
slices in the middle of each stack are read, and compared at the same pixels.
"""

from __future__ import annotations

import re
from collections import defaultdict
from collections.abc import Hashable, Sequence

import numpy as np
from scipy import ndimage

from heartcase.pipeline.formats.dicom.phases import StackGroup
from heartcase.pipeline.formats.dicom.pixels import fill_padding, read_pixels
from heartcase.pipeline.formats.dicom.stack import Stack, find_stack
from heartcase.pipeline.formats.volumes.raw_volume import geometry_from_affine
from heartcase.schemas.arrays import Bool, Float, Float32, Float64
from heartcase.schemas.errors import ScanError

__all__ = ["edge_strength", "measured_words", "noise_level"]


SLICES = 3
"""How many slices in the middle of a stack are read."""
SAME_PART = 0.02
"""Edges are as sharp, and noise is as strong, where they differ by less than this part."""
EDGES = 99.0
"""Percentile of the gradient from which on a pixel is an edge."""
SOFT_TISSUE_HU = (0.0, 100.0)
KERNEL_MM = 10.0
"""Width of the square in which the deviation is taken: in smaller ones noise that neighbours share seems less."""
FEWEST_PIXELS = 200
LARGEST_IMAGE = 2**24
"""Pixels of an image that is read for the sake of a list."""


def measured_words(groups: Sequence[StackGroup], descriptions: Sequence[str]) -> list[str]:
    """What is measured of each group that is described like another one at the same place.

    Parameters
    ----------
    groups
        All that the folder holds.
    descriptions
        How each is described.

    Returns
    -------
    list of str
        Words to put behind the description; empty where there is nothing to tell apart, or it cannot be read.
    """
    words = [""] * len(groups)
    alike: dict[Hashable, list[int]] = defaultdict(list)
    for number, (group, description) in enumerate(zip(groups, descriptions, strict=True)):
        if len(group.stacks) == 1 and group.modality in ("CT", "MR", "unknown"):
            stack = group.stacks[0]
            times = stack.echo_time_ms, stack.trigger_time_ms, stack.cardiac_phase_percent
            alike[(re.sub(r", \d+ of \d+$", "", description), times)].append(number)
    for numbers in alike.values():
        if len(numbers) > 1:
            try:
                found = _compared([groups[number] for number in numbers])
            except ScanError:
                continue
            for number, text in zip(numbers, found, strict=True):
                words[number] = text
    return words


def noise_level(values: Float32, *, pixel_mm: float, is_ct: bool) -> float:
    """Standard deviation that is most frequent in small squares: the noise in tissue of one kind.

    As the global noise level of Christianson et al., "Automated technique to measure noise in clinical CT
    examinations", AJR 205, 2015: the deviation in small squares, over soft tissue, and the peak of its histogram.

    Parameters
    ----------
    values
        Slices, shape (n, rows, columns).
    pixel_mm
        Size of a pixel, mm.
    is_ct
        Whether the values are HU, so that soft tissue can be told by them; else all that is not flat counts.

    Returns
    -------
    float
        In the unit of the values; 0 where everything is flat.
    """
    width = max(3, 2 * round(0.5 * KERNEL_MM / pixel_mm) + 1)
    shape = (1, width, width)
    planes = values.astype(np.float64)
    mean = ndimage.uniform_filter(planes, shape, mode="nearest")
    variance = ndimage.uniform_filter(planes**2, shape, mode="nearest") - mean**2
    deviation = np.sqrt(np.maximum(variance, 0.0) * width**2 / (width**2 - 1))
    is_tissue = deviation > 1e-6 * max(float(np.ptp(planes)), 1e-9)
    if is_ct:
        is_soft = is_tissue & (mean > SOFT_TISSUE_HU[0]) & (mean < SOFT_TISSUE_HU[1])
        is_tissue = is_soft if is_soft.sum() >= FEWEST_PIXELS else is_tissue
    found = deviation[is_tissue]
    if not found.size:
        return 0.0
    # edges make the upper end long: the peak is looked for below the median, in bins that hold many squares each
    upper = 2.0 * float(np.median(found))
    counts, edges = np.histogram(found, bins=50, range=(0.0, upper))
    smooth = ndimage.uniform_filter1d(counts.astype(np.float64), 5, mode="constant")
    peak = int(smooth.argmax())
    return float(edges[peak] + edges[peak + 1]) / 2.0


def edge_strength(values: Float32, is_edge: Bool) -> float:
    """Mean gradient at the pixels that are edges, in units of the values per pixel."""
    return float(_gradient(values)[is_edge].mean())


def _gradient(values: Float) -> Float64:
    along_rows, along_columns = np.gradient(values.astype(np.float64), axis=(1, 2))
    gradient: Float64 = np.hypot(along_rows, along_columns)
    return gradient


def _compared(groups: Sequence[StackGroup]) -> list[str]:
    stacks = [find_stack(group.stacks[0].slices) for group in groups]
    if any(_place_of(stack) != _place_of(stacks[0]) for stack in stacks):
        return [""] * len(groups)
    volumes = [_middle(stack) for stack in stacks]
    gradient = _gradient(np.mean(volumes, axis=0))
    is_edge = gradient >= np.percentile(gradient, EDGES)
    is_ct = groups[0].modality == "CT"
    pixel_mm = float(np.linalg.norm(stacks[0].affine[:3, 0]))
    edges = np.array([edge_strength(volume, is_edge) for volume in volumes])
    noise = np.array([noise_level(volume, pixel_mm=pixel_mm, is_ct=is_ct) for volume in volumes])
    clearness = edges / np.maximum(noise, 1e-9 * max(float(edges.max()), 1e-9))
    best = int(clearness.argmax())
    is_clear = clearness[best] > (1.0 + SAME_PART) * np.delete(clearness, best).max()
    unit = "HU" if is_ct else "(arbitrary unit)"
    words = []
    for number in range(len(groups)):
        others = np.delete(edges, number)
        sharpness = _sharpness(edges[number], others)
        suits = ", suits segmentation better: its edges stand out more from its noise" if is_clear else ""
        words.append(f", {sharpness}, noise {noise[number]:.3g} {unit}{suits if number == best else ''}")
    return words


def _sharpness(own: float, others: Float64) -> str:
    several = others.size > 1
    if own > (1.0 + SAME_PART) * others.max():
        return "sharpest" if several else "sharper"
    if (1.0 + SAME_PART) * own < others.min():
        return "smoothest" if several else "smoother"
    return "of middle sharpness" if several else "as sharp"


def _place_of(stack: Stack) -> Hashable:
    rows, columns = stack.slices[0].shape
    geometry = geometry_from_affine(stack.affine, (stack.places[-1] + 1, rows, columns))
    return geometry.size, tuple(np.round(geometry.affine, 2).ravel().tolist())


def _middle(stack: Stack) -> Float32:
    rows, columns = stack.slices[0].shape
    if rows * columns > LARGEST_IMAGE:
        raise ScanError("the images are larger than any that a list should read")
    first = max(0, (len(stack.slices) - SLICES) // 2)
    return fill_padding(read_pixels(stack.slices[first : first + SLICES]))
