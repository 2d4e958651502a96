"""Kernels that paint into, and resample, label volumes."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

from heartcase.compiling.kernel import kernel
from heartcase.schemas.arrays import Float64, Int64, UInt8

__all__ = ["paint_capsule", "paint_passed_voxels", "pull_nearest"]


TOUCHING = 1.0 + 1e-9
"""A voxel centre on the brush's rim is painted, whatever the rounding."""
STANDING = 1e-12
"""Part of a voxel below which a line does not move along an axis: a quotient by less could overflow."""


@kernel
def paint_capsule(labels: UInt8, start: Float64, end: Float64, spacing: Float64, radius: float, value: int) -> int:
    """Paint the voxels whose centre is within a radius of a line segment.

    Parameters
    ----------
    labels
        uint8, shape (z, y, x); painted in place.
    start, end
        Ends of the segment as continuous indices (i, j, k), float64, shape (3,).
    spacing
        Spacing along i, j, k in mm, float64, shape (3,). The axes are at right angles, so lengths of index offsets
        times spacing are lengths in space.
    radius
        Radius in mm.
    value
        Label value.

    Returns
    -------
    int
        Number of voxels that were painted.
    """
    low = np.empty(3, np.int64)
    high = np.empty(3, np.int64)
    along = np.empty(3)
    length_squared = 0.0
    for axis in range(3):
        count = labels.shape[2 - axis]
        reach = radius * TOUCHING / spacing[axis]
        first = np.ceil(min(start[axis], end[axis]) - reach)
        last = np.floor(max(start[axis], end[axis]) + reach)
        low[axis] = int(min(max(first, 0.0), count))
        high[axis] = int(max(min(last, count - 1.0), -1.0))
        along[axis] = (end[axis] - start[axis]) * spacing[axis]
        length_squared += along[axis] * along[axis]
    painted = 0
    limit = radius * radius * TOUCHING
    for k in range(low[2], high[2] + 1):
        z = (k - start[2]) * spacing[2]
        for j in range(low[1], high[1] + 1):
            y = (j - start[1]) * spacing[1]
            for i in range(low[0], high[0] + 1):
                x = (i - start[0]) * spacing[0]
                t = 0.0
                if length_squared > 0.0:
                    t = (x * along[0] + y * along[1] + z * along[2]) / length_squared
                    t = min(max(t, 0.0), 1.0)
                dx = x - t * along[0]
                dy = y - t * along[1]
                dz = z - t * along[2]
                if dx * dx + dy * dy + dz * dz <= limit:
                    labels[k, j, i] = value
                    painted += 1
    return painted


def paint_passed_voxels(labels: UInt8, start: Float64, end: Float64, value: int) -> bool:
    """Paint the voxels that a line segment passes, without gaps across faces.

    Between two neighbouring crossings of voxel faces the line is inside one voxel: that of the middle between them
    (the crossings of Amanatides and Woo, A Fast Voxel Traversal Algorithm for Ray Tracing, 1987, all at once).

    Parameters
    ----------
    labels
        uint8, shape (z, y, x); painted in place.
    start, end
        Ends of the segment as continuous indices (i, j, k), float64, shape (3,).
    value
        Label value.

    Returns
    -------
    bool
        Whether any voxel was painted. A voxel reaches from half an index below its own to just under half above.
    """
    size = np.array(labels.shape[::-1])
    clipped = _clipped(start, end, size)
    if clipped is None:
        return False
    start, end = clipped
    crossings = [np.array([0.0, 1.0])]
    for first, last in zip(start, end, strict=True):
        if abs(last - first) > STANDING:
            faces = np.arange(np.ceil(min(first, last) - 0.5), np.floor(max(first, last) - 0.5) + 1.0) + 0.5
            crossings.append((faces - first) / (last - first))
    t = np.unique(np.clip(np.concatenate(crossings), 0.0, 1.0))
    at = np.concatenate(([0.0], 0.5 * (t[1:] + t[:-1]), [1.0]))
    index = np.floor(start + at[:, np.newaxis] * (end - start) + 0.5).astype(np.int64)
    index = index[((index >= 0) & (index < size)).all(axis=1)]
    labels[index[:, 2], index[:, 1], index[:, 0]] = value
    return bool(len(index))


def _clipped(start: Float64, end: Float64, size: Int64) -> tuple[Float64, Float64] | None:
    """The part of a segment inside the volume (Liang and Barsky, 1984); None where there is none."""
    along = end - start
    enter, leave = 0.0, 1.0
    for axis in range(3):
        low, high = -0.5 - start[axis], size[axis] - 0.5 - start[axis]
        if abs(along[axis]) <= STANDING:
            if low > 0.0 or high < 0.0:
                return None
            continue
        ends = sorted((low / along[axis], high / along[axis]))
        enter, leave = max(enter, ends[0]), min(leave, ends[1])
    if enter > leave:
        return None
    return start + enter * along, start + leave * along


def pull_nearest(values: npt.NDArray[Any], to_index: Float64, shape: tuple[int, int, int]) -> npt.NDArray[Any]:
    """Value of the nearest voxel at each point of another lattice.

    Parameters
    ----------
    values
        Volume to look in, shape (z, y, x).
    to_index
        Map from the other lattice's index (i, j, k, 1) to this volume's, float64, shape (3, 4).
    shape
        Shape (z, y, x) of the other lattice.

    Returns
    -------
    ndarray
        Shape ``shape``, type of ``values``; 0 outside. Halfway between two voxels the higher index is taken.
    """
    result = np.zeros(shape, dtype=values.dtype)
    _pull(values, to_index, result)
    return result


@kernel
def _pull(values: npt.NDArray[Any], to_index: Float64, result: npt.NDArray[Any]) -> None:
    for k in range(result.shape[0]):
        for j in range(result.shape[1]):
            x = to_index[0, 1] * j + to_index[0, 2] * k + to_index[0, 3]
            y = to_index[1, 1] * j + to_index[1, 2] * k + to_index[1, 3]
            z = to_index[2, 1] * j + to_index[2, 2] * k + to_index[2, 3]
            for i in range(result.shape[2]):
                u = np.floor(x + to_index[0, 0] * i + 0.5)
                v = np.floor(y + to_index[1, 0] * i + 0.5)
                w = np.floor(z + to_index[2, 0] * i + 0.5)
                if 0 <= u < values.shape[2] and 0 <= v < values.shape[1] and 0 <= w < values.shape[0]:
                    result[k, j, i] = values[int(w), int(v), int(u)]
