"""Distances in mm from voxels to markers and to the heart."""

from __future__ import annotations

import numpy as np
from scipy.spatial import cKDTree

from heartcase.pipeline.data import UNMARKED
from heartcase.pipeline.watershed.forest import Forest
from heartcase.schemas.arrays import Bool, Float64, Int64, UInt8
from heartcase.schemas.geometry import Geometry
from heartcase.schemas.labels import BACKGROUND

__all__ = ["far_from_heart", "nearness", "positions_mm"]

FAR_MM = 20.0
"""Background further than this from the heart is far."""
MOST_MARKED = 20_000
"""Marked voxels of the heart that are looked at, evenly spread over all."""


def positions_mm(voxels: Int64, geometry: Geometry) -> Float64:
    """Centres of voxels, given by their flat indices, LPS mm, shape (..., 3)."""
    return geometry.index_to_world(np.stack(np.unravel_index(voxels, geometry.shape)[::-1], axis=-1))


def nearness(voxels: Int64, own: UInt8, rival: UInt8, painted: UInt8, geometry: Geometry) -> tuple[Float64, Float64]:
    """How near voxels are to the markers of a rival, and how far from their own.

    Parameters
    ----------
    voxels
        Flat indices, int64.
    own, rival
        Two labels for each, which are both painted somewhere.
    painted
        Label of each painted voxel, uint8; 255 elsewhere.
    geometry
        Its lattice.

    Returns
    -------
    nearness
        d_own / (d_own + d_rival) with the distances to the nearest voxels painted with either, float64, 0 to 1.
    own_mm
        d_own, mm.
    """
    place_mm, flat_painted = positions_mm(voxels, geometry), painted.ravel()
    own_mm, rival_mm = np.empty(len(voxels)), np.empty(len(voxels))
    for label in np.union1d(own, rival).tolist():
        tree = cKDTree(positions_mm(np.flatnonzero(flat_painted == label), geometry))
        for wanted, distance in ((own, own_mm), (rival, rival_mm)):
            distance[wanted == label] = tree.query(place_mm[wanted == label])[0]
    return own_mm / np.maximum(own_mm + rival_mm, np.finfo(float).tiny), own_mm


def far_from_heart(forest: Forest, voxels: Int64, labels: UInt8, geometry: Geometry) -> Bool:
    """Which voxels are background, and far from the lowest voxel of every basin of the heart and from what marks it.

    Parameters
    ----------
    forest
        A solved forest.
    voxels, labels
        Flat indices, and the label of each.
    geometry
        The forest's lattice.
    """
    far: Bool = labels == BACKGROUND
    if far.any():
        basins = np.flatnonzero((forest.foot_label != BACKGROUND) & (forest.foot_label != UNMARKED))
        marks = forest.marks.ravel()
        # in a contested flat a label may have many voxels, and the foot of no basin
        marked = np.flatnonzero((marks != BACKGROUND) & (marks != UNMARKED))
        heart = np.concatenate([forest.tree.root[basins], marked[:: max(len(marked) // MOST_MARKED, 1)]])
        tree = cKDTree(positions_mm(heart, geometry))
        away_mm = tree.query(positions_mm(voxels[far], geometry), distance_upper_bound=FAR_MM)[0]
        far[far] = ~np.isfinite(away_mm)
    return far
