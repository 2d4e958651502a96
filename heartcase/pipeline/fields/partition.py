"""Partition of the space between voxels among labels: into groups of labels first, then into labels.

Each label's mask is blurred, and the highest owns the point. Where two labels of one group (two chambers, two muscles)
meet at the border of another, as at a valve's ring or in the middle of a defect's canal, either alone is lower than
both are together, and the third would bulge in between them, by an eighth of a voxel or so. There each lends the other
its height. It does so only where the two touch: on the two sides of a thin wall, heights that are added would break it.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numba
import numpy as np

from heartcase.compiling.kernel import kernel, loop_kernel
from heartcase.pipeline.kernels.boxes import Box
from heartcase.schemas.arrays import Float32, UInt8

__all__ = ["Box", "Part", "Touch", "divide", "find_touches", "heights_of_groups", "leads_of"]


TOUCH_GAIN = 4.0
"""The blurred faces between two labels, times this and up to one, say how much each lends the other: all of it at the
rim of the faces and, for a blur of 0.8 voxel, half of it 0.8 voxel beyond and hardly any from two voxels on."""
TOUCH_MARGIN = 4
"""Voxels around the faces between two labels within which they lend each other anything."""


@dataclass(frozen=True)
class Part:
    """A label's array within its box."""

    box: Box
    values: Float32


@dataclass(frozen=True)
class Touch:
    """Where two labels of one group touch."""

    labels: tuple[int, int]
    """Numbers of the two."""
    box: Box
    weight: Float32
    """How much each lends the other, 0 to 1, in the box."""


def find_touches(
    labels: UInt8,
    values: Sequence[int],
    boxes: Sequence[Box],
    group: Sequence[int],
    blur: Callable[[Float32], Float32],
) -> tuple[Touch, ...]:
    """Find where labels of one group touch, and how much they lend each other around it.

    Parameters
    ----------
    labels
        Label values, shape [z, y, x].
    values, boxes
        Value of each label, and its box.
    group
        Number of its group.
    blur
        The blur of the masks.
    """
    number = np.full(256, 255, np.uint8)
    number[list(values)] = np.arange(len(values), dtype=np.uint8)
    of_group = np.zeros(256, np.int64)
    of_group[: len(group)] = group
    faces_box = np.zeros((len(values), len(values), 6), np.int64)
    _find_faces(labels, number, of_group, faces_box)
    touches = []
    for one in range(len(values)):
        for other in range(one + 1, len(values)):
            low, high = faces_box[one, other, :3], faces_box[one, other, 3:]
            if not high.any():
                continue
            both = boxes[one], boxes[other]
            low = np.maximum(low - TOUCH_MARGIN, np.max([[side.start for side in box] for box in both], axis=0))
            high = np.minimum(high + TOUCH_MARGIN, np.min([[side.stop for side in box] for box in both], axis=0))
            box = (slice(low[0], high[0]), slice(low[1], high[1]), slice(low[2], high[2]))
            faces = _beside_faces(np.ascontiguousarray(labels[box]), values[one], values[other])
            weight = np.minimum(np.float32(TOUCH_GAIN) * blur(faces), np.float32(1.0))
            touches.append(Touch((one, other), box, weight))
    return tuple(touches)


@kernel
def _find_faces(labels, number, group, boxes):
    """Box of the voxels beside the faces between each two labels of one group: lowest, and beyond the highest."""
    nz, ny, nx = labels.shape
    for k in range(nz):
        for j in range(ny):
            for i in range(nx):
                a = number[labels[k, j, i]]
                for axis in range(3):
                    kk, jj, ii = k + (axis == 0), j + (axis == 1), i + (axis == 2)
                    if kk == nz or jj == ny or ii == nx:
                        continue
                    b = number[labels[kk, jj, ii]]
                    if a == b or group[a] != group[b]:
                        continue
                    box = boxes[min(a, b), max(a, b)]
                    if box[3] == 0:
                        box[0], box[1], box[2] = k, j, i
                    box[0], box[1], box[2] = min(box[0], k), min(box[1], j), min(box[2], i)
                    box[3], box[4], box[5] = max(box[3], kk + 1), max(box[4], jj + 1), max(box[5], ii + 1)


@kernel
def _beside_faces(labels, one, other):
    """1 in the voxels beside a face between two labels."""
    nz, ny, nx = labels.shape
    beside = np.zeros(labels.shape, np.float32)
    for k in range(nz):
        for j in range(ny):
            for i in range(nx):
                a = labels[k, j, i]
                if a != one and a != other:
                    continue
                for axis in range(3):
                    kk, jj, ii = k + (axis == 0), j + (axis == 1), i + (axis == 2)
                    if kk < nz and jj < ny and ii < nx:
                        b = labels[kk, jj, ii]
                        if b != a and b in (one, other):
                            beside[k, j, i] = 1.0
                            beside[kk, jj, ii] = 1.0
    return beside


def heights_of_groups(
    blurred: Sequence[Part], group: Sequence[int], touches: Sequence[Touch], shape: tuple[int, ...]
) -> list[Float32]:
    """Height of each group: of the highest of its labels, with what the others lend it.

    Parameters
    ----------
    blurred
        Blurred mask of each label.
    group
        Number of its group.
    touches
        From :func:`find_touches`.
    shape
        Of the volume.
    """
    heights = [np.zeros(shape, np.float32) for _ in range(max(group) + 1)]
    for number, part in enumerate(blurred):
        _raise(heights[group[number]][part.box], part.values)
    for number, part in enumerate(blurred):
        mine = [touch for touch in touches if number in touch.labels]
        if not mine:
            continue
        total = part.values.copy()
        for touch in mine:
            other = blurred[sum(touch.labels) - number]
            total[_inside(touch.box, part.box)] += touch.weight * other.values[_inside(touch.box, other.box)]
        _raise(heights[group[number]][part.box], total)
    return heights


def _inside(box: Box, outer: Box) -> Box:
    """A box as it lies within another one."""
    a, b, c = (slice(one.start - of.start, one.stop - of.start) for one, of in zip(box, outer, strict=True))
    return a, b, c


def _raise(heights: Float32, values: Float32) -> None:
    np.maximum(heights, values, out=heights)


def leads_of(heights: Sequence[Float32]) -> list[Float32]:
    """By how much the highest other one is above each; below zero where it is the highest itself."""
    highest, second = (np.full(heights[0].shape, -np.inf, np.float32) for _ in range(2))
    for one in heights:
        _two_highest(highest.ravel(), second.ravel(), one.ravel())
    leads = [np.empty_like(one) for one in heights]
    for one, lead in zip(heights, leads, strict=True):
        _behind(one.ravel(), highest.ravel(), second.ravel(), lead.ravel())
    return leads


@loop_kernel
def _two_highest(highest, second, values):
    for n in numba.prange(len(values)):
        if values[n] > highest[n]:
            second[n] = highest[n]
            highest[n] = values[n]
        elif values[n] > second[n]:
            second[n] = values[n]


@loop_kernel
def _behind(values, highest, second, lead):
    for n in numba.prange(len(values)):
        lead[n] = (second[n] if values[n] == highest[n] else highest[n]) - values[n]


def divide(group_mm: Sequence[Float32], inner_mm: Sequence[Part | None], group: Sequence[int]) -> UInt8:
    """Let the lowest group own each voxel, and of it the lowest label (ties: the first).

    Parameters
    ----------
    group_mm
        Distance of each group, mm, negative inside, shape of the volume.
    inner_mm
        Distance of each label to the others of its group; None where it is alone in it.
    group
        Number of each label's group.

    Returns
    -------
    UInt8
        Number of the label that owns each voxel.
    """
    lowest = group_mm[0].copy()
    owner_group = np.zeros(lowest.shape, np.uint8)
    for number, values in enumerate(group_mm[1:], start=1):
        better = values < lowest
        np.copyto(lowest, values, where=better)
        owner_group[better] = number
    owner = np.empty(lowest.shape, np.uint8)
    for number in range(len(group_mm)):
        members = [label for label, one in enumerate(group) if one == number]
        mine = owner_group == number
        if len(members) == 1:
            owner[mine] = members[0]
            continue
        best = np.full(lowest.shape, np.inf, np.float32)
        first = np.full(lowest.shape, members[0], np.uint8)
        for label in members:
            part = inner_mm[label]
            if part is None:
                continue
            better = part.values < best[part.box]
            np.copyto(best[part.box], part.values, where=better)
            first[part.box][better] = label
        owner[mine] = first[mine]
    return owner
