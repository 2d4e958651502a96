"""Places in flat minima that are marked, and what one more dab there would take: found by painting it on a copy.

Elsewhere that is known (:mod:`heartcase.pipeline.watershed.subtrees`). A flat minimum that several labels mark goes to
each by steps, so a dab takes what is nearer to it than to all other markers, and what hangs on that. Blood in a CT lies
in such flats (:mod:`heartcase.pipeline.image.landscape`). In each of them one place is looked for in what each label
has, the one with the most

    (own / other)^4 * nearness^2 * volume of a ball of half the distance to the label's nearest marker

the first two as in :mod:`heartcase.pipeline.markers.suggest`, the third for what the dab will about take.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from heartcase.pipeline.data import UNMARKED
from heartcase.pipeline.markers.distances import MarkerDistances, doubt
from heartcase.pipeline.watershed.certainty import FootCertainty
from heartcase.pipeline.watershed.forest import Forest
from heartcase.schemas.arrays import Bool, Float64, Int64, UInt8
from heartcase.schemas.geometry import Geometry

__all__ = ["MOST_LOOKED_AT", "FlatPlaces", "changed_by_dab", "flat_places", "in_marked_flat"]

MOST_LOOKED_AT = 4096
"""Voxels of a flat minimum that are looked at, evenly spread over it."""


@dataclass(frozen=True)
class FlatPlaces:
    """One place for each label in each marked flat minimum, by ascending number of the flat and label."""

    voxel: Int64
    """Flat indices, int64, shape (places,)."""
    label: UInt8
    """Label that each has, uint8."""
    rival: UInt8
    """The other label that reaches it over the lowest pass, uint8."""
    certainty: Float64
    """Certainty of each, 0 to 1."""
    doubt: Float64
    """1 - confidence of each, 0 to 1."""
    about_ml: Float64
    """What a dab would about take, ml: no bound."""


def in_marked_flat(forest: Forest) -> Bool:
    """Whether the lowest voxel of each basin lies in a flat minimum that is painted on, bool, shape (basins,)."""
    tree = forest.tree
    is_marked = np.zeros(tree.basin_count + 1, np.bool_)
    is_marked[tree.flat_of(np.flatnonzero(forest.painted.ravel() != UNMARKED))] = True
    # the last one stands for no flat
    is_marked[-1] = False
    found: Bool = is_marked[tree.flat]
    return found


def flat_places(
    forest: Forest,
    feet: FootCertainty,
    geometry: Geometry,
    distances: MarkerDistances,
    *,
    least_ml: float,
    sure: float,
    but_near: Sequence[tuple[Float64, int, int, float]] = (),
) -> FlatPlaces:
    """Find the places.

    Parameters
    ----------
    forest
        A solved forest.
    feet
        Its :func:`heartcase.pipeline.watershed.certainty.foot_certainty`.
    geometry
        Its lattice.
    distances
        Those to its markers.
    least_ml
        Flat minima smaller than this are left out, ml.
    sure
        Certainty from which on a voxel is left out.
    but_near
        Position (LPS mm), label, rival and distance (mm): nearer to it no place of these two labels is named.
    """
    voxel = _sample(forest, least_ml / (geometry.voxel_volume_mm3 / 1000.0))
    tree = forest.tree
    basin = tree.basin.ravel()[voxel]
    label, foot = forest.labels.ravel()[voxel], forest.foot_label[basin]
    is_foot = label == foot
    rival = np.where(feet.rival[basin] == label, foot, feet.rival[basin])
    height, other = tree.height.ravel()[voxel].astype(np.float64), feet.other[basin].astype(np.float64)
    part = np.ones(len(voxel))
    np.divide(height, other, out=part, where=is_foot & np.isfinite(other) & (other > 0.0))
    certainty = 1.0 - np.minimum(part, 1.0)
    keep = (rival != UNMARKED) & (label != UNMARKED) & (certainty < sure)
    keep &= forest.painted.ravel()[voxel] == UNMARKED
    keep[keep] = ~distances.are_far_from_heart(voxel[keep], label[keep])
    for position_mm, one, two, away_mm in but_near:
        same = keep & (label == one) & (rival == two)
        near = ((distances.positions_mm(voxel[same]) - position_mm) ** 2).sum(axis=1) < away_mm**2
        keep[same] = ~near
    voxel, label, rival, certainty, basin = (each[keep] for each in (voxel, label, rival, certainty, basin))
    near_rival, own_mm = distances.nearness(voxel, label, rival)
    doubts = doubt(certainty, near_rival)
    about_ml = 4.0 / 3.0 * math.pi * (0.5 * own_mm) ** 3 / 1000.0
    cell = tree.flat[basin].astype(np.int64) * 256 + label
    order = np.lexsort((voxel, -doubts * about_ml, cell))
    best = order[np.concatenate([[True], np.diff(cell[order]) > 0])] if len(order) else order
    return FlatPlaces(voxel[best], label[best], rival[best], certainty[best], doubts[best], about_ml[best])


def changed_by_dab(copy: Forest, voxel: int, label: int) -> Int64:
    """Flat indices of the voxels that change when one voxel is painted, ascending.

    Parameters
    ----------
    copy
        A copy of a forest; it is painted on, and is afterwards as it was.
    voxel
        Flat index of a voxel that is not painted.
    label
        Label that it gets.
    """
    before = copy.labels.copy()
    box = copy.paint(np.array([voxel]), label)
    changed = np.zeros(0, np.int64) if box is None else _differing(before, copy.labels, box)
    copy.paint(np.array([voxel]), UNMARKED)
    return changed


def _differing(before: UInt8, after: UInt8, box: tuple[slice, ...]) -> Int64:
    index = np.argwhere(before[box] != after[box]) + [one.start for one in box]
    found: Int64 = np.ravel_multi_index(tuple(index.T), before.shape)
    return found


def _sample(forest: Forest, least_count: float) -> Int64:
    """Voxels of the marked flat minima that are large enough, each flat's evenly spread."""
    tree = forest.tree
    voxel, _ = tree.voxels_of(np.flatnonzero(in_marked_flat(forest)))
    number = tree.flat_of(voxel)
    voxel, number = voxel[number >= 0], number[number >= 0]
    order = np.lexsort((voxel, number))
    voxel, number = voxel[order], number[order]
    _, first_place, size = np.unique(number, return_index=True, return_counts=True)
    place, of_flat = np.arange(len(voxel)) - np.repeat(first_place, size), np.repeat(size, size)
    step = -(-of_flat // MOST_LOOKED_AT)
    sample: Int64 = voxel[(of_flat >= least_count) & (place % np.maximum(step, 1) == 0)]
    return sample
