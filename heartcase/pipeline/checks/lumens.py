"""The narrowest places of blood's way through the heart, before and after the outlines are smoothed.

Smoothing must not tighten a stenosis or close a defect. Narrow places are the saddles of the distance to the nearest
wall: flooding the blood from its widest places down, two of them meet at each (a merge tree; Carr, Snoeyink, Axen,
Computing contour trees in all dimensions, Computational Geometry 24, 2003). Through each saddle the plane is sought in
which the segmented voxels' lumen is smallest; in that plane the lumen of the smoothed fields is measured as well.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from heartcase.compiling.calls import copied
from heartcase.compiling.kernel import kernel
from heartcase.pipeline.kernels.feature_transform import distance_to_marked
from heartcase.pipeline.kernels.union_find import root_of
from heartcase.schemas.arrays import Bool, Float32, Float64, Int64, UInt8
from heartcase.schemas.geometry import Geometry
from heartcase.schemas.labels import LabelTable

__all__ = ["Narrowing", "narrowest_lumens"]


WIDER = 1.3
"""The way on both sides of a narrow place is at least this many times as wide."""
LEAST_DEPTH_VOXELS = 1.5
"""And its widest point there at least this far from the wall."""
LEAST_VOXELS = 30
"""And it has at least so many voxels."""
WINDOW_WIDTHS = 2.5
"""Half the edge of a plane in which a lumen is measured, over the distance to the wall; and four voxels more."""
SEARCH_STEP_VOXELS, STEP_VOXELS = 0.5, 0.2
TILTS_DEGREES = (15.0, 30.0, 45.0)
AZIMUTH_COUNT = 8
SHIFTS_VOXELS = (0.0, -1.0, 1.0, -2.0, 2.0)


@dataclass(frozen=True)
class Narrowing:
    """A place where blood passes from one wide place to another through a narrow one."""

    label: int
    """Label at the place."""
    position_mm: tuple[float, float, float]
    """The place, world mm."""
    segmented_mm: float
    """Diameter of a circle with the area of the segmented voxels' lumen, mm."""
    smoothed_mm: float
    """The same of the smoothed fields; 0 where they close it."""


def narrowest_lumens(
    labels: UInt8, distances: Mapping[int, Float32], geometry: Geometry, table: LabelTable, *, most: int = 8
) -> tuple[Narrowing, ...]:
    """Find the narrowest places of the blood's way and measure them.

    Parameters
    ----------
    labels
        Label values, shape [z, y, x].
    distances
        Label value -> smoothed signed distance, mm, negative inside, same shape.
    geometry
        Their lattice.
    table
        Which labels are blood.
    most
        How many places.

    Returns
    -------
    tuple of Narrowing
        By the diameter as segmented, the narrowest first. Chambers and vessels count as one way, so a valve or a
        septal defect can be a narrow place.
    """
    blood = np.isin(labels, np.array(table.blood_values, np.uint8))
    if not blood.any():
        return ()
    low, high = _box_of(blood)
    inner = tuple(slice(a, b) for a, b in zip(low, high, strict=True))
    spacing = np.array(geometry.spacing_mm, np.float64)[::-1]
    part = np.ascontiguousarray(blood[inner])
    depth = np.empty(part.shape, np.float32)
    distance_to_marked(~part, np.ascontiguousarray(spacing), depth)
    order = np.argsort(-depth.ravel(), kind="stable")[: int(part.sum())]
    voxel = float(spacing.mean())
    found = _saddles(depth, order, spacing, WIDER, LEAST_DEPTH_VOXELS * voxel, LEAST_VOXELS)
    found = found[np.argsort(found[:, 3], kind="stable")]
    narrow: list[Narrowing] = []
    for k, j, i, width, *way in found:
        if len(narrow) == most:
            break
        index = np.array([k, j, i], np.float64) + low
        one = _measured(blood, labels, distances, table, index, float(width), np.array(way), spacing, geometry)
        gaps = [math.dist(one.position_mm, other.position_mm) for other in narrow] if one else []
        if one is not None and all(gap > max(one.segmented_mm, 2.0 * voxel) for gap in gaps):
            narrow.append(one)
    return tuple(sorted(narrow, key=lambda one: (one.segmented_mm, one.position_mm)))


def _box_of(mask: Bool) -> tuple[Int64, Int64]:
    """Lower and upper corner (beyond) of the box of the true voxels, with a voxel around it, within the volume."""
    low, high = np.zeros(3, np.int64), np.zeros(3, np.int64)
    for axis in range(3):
        there = np.flatnonzero(mask.any(axis=tuple(a for a in range(3) if a != axis)))
        low[axis], high[axis] = max(there[0] - 1, 0), min(there[-1] + 2, mask.shape[axis])
    return low, high


@kernel
def _saddles(depth, order, spacing, wider, least, count_min):
    """Rows of voxel (k, j, i), depth and way (z, y, x, mm) from one side to the other of each significant saddle."""
    nz, ny, nx = depth.shape
    flat = depth.ravel()
    parent = np.full(flat.size, -1, np.int64)
    size = np.zeros(flat.size, np.int64)
    peak = np.zeros(flat.size, np.float32)
    rows = np.empty((64, 7))
    found = 0
    roots = np.empty(26, np.int64)
    for n in range(len(order)):
        at = order[n]
        k, j, i = at // (ny * nx), (at // nx) % ny, at % nx
        parent[at], size[at], peak[at] = at, 1, flat[at]
        root_count = 0
        for kk in range(max(k - 1, 0), min(k + 2, nz)):
            for jj in range(max(j - 1, 0), min(j + 2, ny)):
                for ii in range(max(i - 1, 0), min(i + 2, nx)):
                    other = (kk * ny + jj) * nx + ii
                    if other == at or parent[other] < 0:
                        continue
                    root = root_of(parent, other)
                    is_new = True
                    for m in range(root_count):
                        is_new = is_new and roots[m] != root
                    if is_new:
                        roots[root_count] = root
                        root_count += 1
        if root_count == 0:
            continue
        top = roots[0]
        for m in range(1, root_count):
            if peak[roots[m]] > peak[top] or (peak[roots[m]] == peak[top] and roots[m] < top):
                top = roots[m]
        for m in range(root_count):
            one = roots[m]
            if one == top:
                continue
            if peak[one] >= wider * flat[at] and peak[one] >= least and min(size[one], size[top]) >= count_min:
                if found == len(rows):
                    more = np.empty((2 * found, 7))
                    more[:found] = rows
                    rows = more
                rows[found, 0], rows[found, 1], rows[found, 2], rows[found, 3] = k, j, i, flat[at]
                _way_between(parent, one, top, k, j, i, depth.shape, spacing, flat[at], rows[found, 4:])
                found += 1
        for m in range(root_count):
            if roots[m] != top:
                parent[roots[m]] = top
                size[top] += size[roots[m]]
        parent[at] = top
        size[top] += 1
    return rows[:found].copy()


@copied
def _way_between(parent, one, other, k, j, i, shape, spacing, width, way):
    """From the middle of the voxels of one side around a saddle to the middle of those of the other, mm."""
    nz, ny, nx = shape
    sums, counts = np.zeros((2, 3)), np.zeros(2)
    reach = 2.0 * width + 2.0 * spacing.max()
    rk, rj, ri = int(reach / spacing[0]) + 1, int(reach / spacing[1]) + 1, int(reach / spacing[2]) + 1
    for kk in range(max(k - rk, 0), min(k + rk + 1, nz)):
        for jj in range(max(j - rj, 0), min(j + rj + 1, ny)):
            for ii in range(max(i - ri, 0), min(i + ri + 1, nx)):
                at = (kk * ny + jj) * nx + ii
                if parent[at] < 0:
                    continue
                root = root_of(parent, at)
                if root != one and root != other:
                    continue
                side = 0 if root == one else 1
                counts[side] += 1
                sums[side, 0] += kk * spacing[0]
                sums[side, 1] += jj * spacing[1]
                sums[side, 2] += ii * spacing[2]
    for axis in range(3):
        way[axis] = sums[1, axis] / max(counts[1], 1.0) - sums[0, axis] / max(counts[0], 1.0)


def _measured(
    blood: Bool,
    labels: UInt8,
    distances: Mapping[int, Float32],
    table: LabelTable,
    index: Float64,
    width: float,
    way: Float64,
    spacing: Float64,
    geometry: Geometry,
) -> Narrowing | None:
    """Measure the lumen at a saddle; None where no plane through it cuts the blood off all around."""
    voxel = float(spacing.mean())
    half = WINDOW_WIDTHS * width + 4.0 * voxel
    low = np.maximum(np.floor(index - (half + 3.0 * voxel) * math.sqrt(2.0) / spacing), 0).astype(np.int64)
    high = np.minimum(np.ceil(index + (half + 3.0 * voxel) * math.sqrt(2.0) / spacing) + 1, blood.shape).astype(
        np.int64
    )
    box = tuple(slice(a, b) for a, b in zip(low, high, strict=True))
    local, at = blood[box].astype(np.float32), (index - low) * spacing
    if not way.any():
        return None
    axis = way / np.linalg.norm(way)
    best: tuple[float, Float64, Float64] | None = None
    for direction in _tilted(axis):
        for shift in SHIFTS_VOXELS:
            centre = at + shift * voxel * axis
            area = _area(local - 0.5, centre, direction, half, SEARCH_STEP_VOXELS * voxel, spacing, order=0)
            if area is not None and area > 0.0 and (best is None or area < best[0] - 1e-9):
                best = area, centre, direction
    if best is None:
        return None
    _, centre, direction = best
    blood_values = set(table.blood_values)
    inside = [field[box] for value, field in distances.items() if value in blood_values]
    outside = [field[box] for value, field in distances.items() if value not in blood_values]
    if not inside or not outside:
        return None
    lead = np.min(outside, axis=0) - np.min(inside, axis=0)

    def narrowest(field: Float32, order: int) -> float:
        """Smallest area near the plane: the smoothing may move the narrowest place along."""
        shifted = [
            _area(field, centre + shift * voxel * direction, direction, half, STEP_VOXELS * voxel, spacing, order=order)
            for shift in SHIFTS_VOXELS
        ]
        return min((area for area in shifted if area is not None), default=0.0)

    area, smoothed = narrowest(local - 0.5, 0), narrowest(lead, 1)
    place = low + centre / spacing
    world = geometry.index_to_world(place[::-1])
    near = tuple(np.clip(np.rint(place), 0, np.array(blood.shape) - 1).astype(int))
    return Narrowing(
        int(labels[near] if blood[near] else labels[tuple(index.astype(int))]),
        (float(world[0]), float(world[1]), float(world[2])),
        2.0 * math.sqrt(area / math.pi),
        2.0 * math.sqrt(smoothed / math.pi),
    )


def _tilted(axis: Float64) -> list[Float64]:
    """The axis itself, and directions tilted from it."""
    side = np.cross(axis, np.eye(3)[np.abs(axis).argmin()])
    side /= np.linalg.norm(side)
    other = np.cross(axis, side)
    directions = [axis]
    for tilt in np.radians(TILTS_DEGREES):
        for azimuth in 2.0 * np.pi * np.arange(AZIMUTH_COUNT) / AZIMUTH_COUNT:
            directions.append(np.cos(tilt) * axis + np.sin(tilt) * (np.cos(azimuth) * side + np.sin(azimuth) * other))
    return directions


def _area(
    lead: Float32, centre: Float64, direction: Float64, half: float, step: float, spacing: Float64, *, order: int
) -> float | None:
    """Area of the lumen (``lead`` above 0) around a point of a plane, mm2; None where it reaches the window's edge."""
    side = np.cross(direction, np.eye(3)[np.abs(direction).argmin()])
    side /= np.linalg.norm(side)
    other = np.cross(direction, side)
    count = round(half / step)
    found = _points_inside(lead, centre / spacing, side / spacing, other / spacing, step, count, order != 0)
    return None if found < 0 else float(found) * step * step


@kernel
def _points_inside(lead, centre, side, other, step, count, is_linear):
    """Points of a plane in the region (``lead`` above 0) that is nearest to its middle; -1 where it meets the edge."""
    size = 2 * count + 1
    inside = np.zeros((size, size), np.bool_)
    nearest, at_a, at_b = np.int64(2 * size * size), -1, -1
    for a in range(size):
        for b in range(size):
            u, v = (a - count) * step, (b - count) * step
            z, y, x = (
                centre[0] + u * side[0] + v * other[0],
                centre[1] + u * side[1] + v * other[1],
                centre[2] + u * side[2] + v * other[2],
            )
            if _is_above(lead, z, y, x, is_linear):
                inside[a, b] = True
                square = (a - count) * (a - count) + (b - count) * (b - count)
                if square < nearest:
                    nearest, at_a, at_b = square, a, b
    if at_a < 0:
        return 0
    stack = np.empty((size * size, 2), np.int64)
    stack[0, 0], stack[0, 1] = at_a, at_b
    inside[at_a, at_b] = False
    top, found = 1, 0
    while top > 0:
        top -= 1
        a, b = stack[top]
        found += 1
        if a == 0 or b == 0 or a == size - 1 or b == size - 1:
            return -1
        for way in range(4):
            c, d = a + (way == 0) - (way == 1), b + (way == 2) - (way == 3)
            if inside[c, d]:
                inside[c, d] = False
                stack[top, 0], stack[top, 1] = c, d
                top += 1
    return found


@copied
def _is_above(values, z, y, x, is_linear):
    """Whether a field is above zero at a point, by its nearest value or between eight; nothing is above beyond it."""
    nz, ny, nx = values.shape
    if z < 0.0 or y < 0.0 or x < 0.0 or z > nz - 1.0 or y > ny - 1.0 or x > nx - 1.0:
        return False
    if not is_linear:
        return values[int(z + 0.5), int(y + 0.5), int(x + 0.5)] > 0.0
    k, j, i = min(int(z), max(nz - 2, 0)), min(int(y), max(ny - 2, 0)), min(int(x), max(nx - 2, 0))
    total = 0.0
    for c in range(2):
        for b in range(2):
            for a in range(2):
                weight = (z - k if c else 1.0 + k - z) * (y - j if b else 1.0 + j - y) * (x - i if a else 1.0 + i - x)
                if weight > 0.0:
                    total += weight * values[k + c, j + b, i + a]
    return total > 0.0
