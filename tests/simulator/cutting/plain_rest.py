"""What a blade sweeps now at rest, in plain NumPy: place by place, and edges drawn in round by round."""

from __future__ import annotations

import numpy as np

from heartcase.simulator.cutting.rest_space import places_at_rest

AROUND = ((-1, 0), (1, 0), (0, -1), (0, 1), (-1, -1), (-1, 1), (1, -1), (1, 1))
HALVINGS = 4


def plain_blade_at_rest(model, displacement, points, parted=None):
    """As of :func:`heartcase.simulator.cutting.rest_space.blade_at_rest`."""
    rest, is_open = places_at_rest(model, displacement, points, parted)
    if not is_open.any():
        return rest
    meets = np.pad(~is_open, 1)
    around = np.pad(points, ((1, 1), (1, 1), (0, 0)))
    rows, columns = is_open.shape
    is_edge, inner = np.zeros_like(is_open), np.zeros_like(points)
    for row, column in AROUND:
        here = (slice(1 + row, 1 + row + rows), slice(1 + column, 1 + column + columns))
        is_beside = is_open & ~is_edge & meets[here]
        inner[is_beside] = around[here][is_beside]
        is_edge |= is_beside
    within, outside = inner[is_edge], points[is_edge]
    at_edge = rest[is_edge]
    for _ in range(HALVINGS):
        middle = (within + outside) / 2
        found, beyond = places_at_rest(model, displacement, middle, parted)
        within = np.where(beyond[:, None], within, middle)
        outside = np.where(beyond[:, None], middle, outside)
        at_edge = np.where(beyond[:, None], found, at_edge)
    rest[is_open] = np.nan
    rest[is_edge] = at_edge
    return rest


def plain_refined(poses, spacing=0.5):
    """As of :func:`heartcase.simulator.cutting.rest_space.refined`."""
    longest = [np.linalg.norm(np.diff(poses, axis=a), axis=-1).max(axis=1 - a) for a in (0, 1)]
    for axis in (0, 1):
        counts = np.maximum(np.ceil(longest[axis] / spacing), 1).astype(np.int64)
        rows = np.moveaxis(poses, axis, 0)
        whole = np.concatenate([[0], np.cumsum(counts)])
        at = np.interp(np.arange(whole[-1] + 1), whole, np.arange(len(rows)))
        before = np.minimum(at.astype(np.int64), len(rows) - 2)
        part = (at - before)[:, None, None]
        poses = np.moveaxis(rows[before] + part * (rows[before + 1] - rows[before]), 0, axis)
    return poses
