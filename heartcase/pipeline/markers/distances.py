"""Distances in mm from voxels to markers and to the heart, and how doubtful a label is by them."""

from __future__ import annotations

from typing import TypeVar

import numpy as np
from scipy.spatial import cKDTree

from heartcase.pipeline.data import UNMARKED
from heartcase.pipeline.watershed.forest import Forest
from heartcase.schemas.arrays import Bool, Float32, Float64, Int64, UInt8
from heartcase.schemas.geometry import Geometry
from heartcase.schemas.labels import BACKGROUND

__all__ = ["MarkerDistances", "doubt"]

DOUBT_POWER = 4
DISTANCE_POWER = 2

FAR_MM = 20.0
"""Background further than this from the heart is far."""
MOST_MARKED = 20_000
"""Marked voxels of the heart that are looked at, evenly spread over all."""


FloatOrArray = TypeVar("FloatOrArray", float, Float32, Float64)


def doubt(certainty: FloatOrArray, nearness: FloatOrArray) -> FloatOrArray:
    """1 - confidence: (1 - certainty)^4 * nearness^2.

    Parameters
    ----------
    certainty
        As of :mod:`heartcase.pipeline.watershed.certainty`, 0 to 1.
    nearness
        As of :meth:`MarkerDistances.nearness`, 0 to 1.
    """
    return (1.0 - certainty) ** DOUBT_POWER * nearness**DISTANCE_POWER


class MarkerDistances:
    """Distances to what is painted in a solved forest; each spatial index is made once, when it is first asked for.

    Parameters
    ----------
    forest
        A solved forest; it is not painted on meanwhile.
    geometry
        Its lattice.
    """

    def __init__(self, forest: Forest, geometry: Geometry) -> None:
        self._forest = forest
        self._geometry = geometry
        self._painted: dict[int, cKDTree] = {}
        self._heart: cKDTree | None = None

    def positions_mm(self, voxels: Int64) -> Float64:
        """Centres of voxels, given by their flat indices, LPS mm, shape (..., 3)."""
        index = np.stack(np.unravel_index(voxels, self._geometry.shape)[::-1], axis=-1)
        return self._geometry.index_to_world(index)

    def nearness(self, voxels: Int64, own: UInt8, rival: UInt8) -> tuple[Float64, Float64]:
        """How near voxels are to the markers of a rival, and how far from their own.

        Parameters
        ----------
        voxels
            Flat indices, int64.
        own, rival
            Two labels for each, which are both painted somewhere.

        Returns
        -------
        nearness
            d_own / (d_own + d_rival) with the distances to the nearest voxels painted with either, float64, 0 to 1.
        own_mm
            d_own, mm.
        """
        place_mm = self.positions_mm(voxels)
        own_mm, rival_mm = np.empty(len(voxels)), np.empty(len(voxels))
        for label in np.union1d(own, rival).tolist():
            for wanted, distance in ((own, own_mm), (rival, rival_mm)):
                distance[wanted == label] = self._of_label(label).query(place_mm[wanted == label])[0]
        return own_mm / np.maximum(own_mm + rival_mm, np.finfo(float).tiny), own_mm

    def are_far_from_heart(self, voxels: Int64, labels: UInt8) -> Bool:
        """Which voxels are background, far from what marks the heart and from the lowest voxels of its basins.

        Parameters
        ----------
        voxels, labels
            Flat indices, and the label of each.
        """
        far: Bool = labels == BACKGROUND
        if far.any():
            away_mm = self._of_heart().query(self.positions_mm(voxels[far]), distance_upper_bound=FAR_MM)[0]
            far[far] = ~np.isfinite(away_mm)
        return far

    def _of_label(self, label: int) -> cKDTree:
        if label not in self._painted:
            painted = np.flatnonzero(self._forest.painted.ravel() == label)
            self._painted[label] = cKDTree(self.positions_mm(painted))
        return self._painted[label]

    def _of_heart(self) -> cKDTree:
        if self._heart is None:
            foot, marks = self._forest.foot_label, self._forest.marks.ravel()
            root = self._forest.tree.root[(foot != BACKGROUND) & (foot != UNMARKED)]
            # in a contested flat a label may have many voxels, and the foot of no basin
            marked = np.flatnonzero((marks != BACKGROUND) & (marks != UNMARKED))
            heart = np.concatenate([root, marked[:: max(len(marked) // MOST_MARKED, 1)]])
            self._heart = cKDTree(self.positions_mm(heart))
        return self._heart
