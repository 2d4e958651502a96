"""Places where one more stroke would change most: where to paint next, and when to stop.

At any place a stroke of another label changes a known volume (:mod:`heartcase.pipeline.watershed.subtrees`). Where it
is worth a look is guessed: at each basin's lowest voxel

    worth = min(volume, 5 ml) * (own / other)^4 * (d_own / (d_own + d_rival))^2

with the passes ``own`` and ``other`` of :mod:`heartcase.pipeline.watershed.certainty` and the distances to the nearest
voxels marked with the voxel's label and with its rival's. Larger volumes count no more, since they hold most of a
structure, with its own strokes. Background far from the heart is not worth a look: air in a corner of the scan is as
unsure as can be, as nobody marks it. ``heartcase bench segment-confidence`` measures how many of the places are wrong.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import edt
import numpy as np
from scipy.spatial import cKDTree

from heartcase.pipeline.data import UNMARKED
from heartcase.pipeline.watershed.certainty import FootCertainty, foot_certainty
from heartcase.pipeline.watershed.descent import side_offsets
from heartcase.pipeline.watershed.forest import Forest
from heartcase.pipeline.watershed.marks import mark_below
from heartcase.pipeline.watershed.subtrees import ForestPieces, forest_pieces
from heartcase.schemas.arrays import Bool, Float64, Int64
from heartcase.schemas.geometry import Geometry
from heartcase.schemas.labels import BACKGROUND, LabelTable

__all__ = ["DISTANCE_POWER", "DOUBT_POWER", "SURE", "RightPlace", "StrokePlace", "StrokePlaces", "suggest_strokes"]


SURE = 0.5
"""Certainty from which on a place is not named."""
LEAST_ML = 0.02
"""Less than this is not worth a stroke."""
LARGE_ML = 5.0
FAR_MM = 20.0
"""Background further than this from everything that is labelled as heart is not named."""
DOUBT_POWER = 4
DISTANCE_POWER = 2


@dataclass(frozen=True)
class StrokePlace:
    """A place where one more stroke would change much."""

    position_mm: tuple[float, float, float]
    """A voxel where the scan is flattest, LPS mm."""
    label: int
    """Label that the place has now."""
    rival: int
    """The other label that reaches it over the lowest pass."""
    change_ml: float
    """What a stroke of any other label there changes, ml: exactly this, where it stays within ``radius_mm``."""
    certainty: float
    """Certainty of the place, 0 to 1."""
    radius_mm: float
    """Distance to the nearest voxel that would not change: a narrower brush stays inside."""
    worth_ml: float
    """What a look is worth: ``change_ml``, at most 5 ml, times 1 - ``confidence``."""

    @property
    def confidence(self) -> float:
        """Confidence of the place, 0 to 1, as :mod:`heartcase.pipeline.markers.confidence` has it for the report."""
        return 1.0 - self.worth_ml / min(self.change_ml, LARGE_ML)


class RightPlace(NamedTuple):
    """A place that somebody looked at and found right as it is."""

    position_mm: tuple[float, float, float]
    """That of the place when it was named, LPS mm."""
    label: int
    """Label that it had, and has rightly."""
    rival: int
    """The other label that it might have had."""


@dataclass(frozen=True)
class StrokePlaces:
    """Where to look next, and whether it is worth it."""

    places: tuple[StrokePlace, ...]
    """The most worth a look first."""
    rest_ml: float
    """Worth of the best place that is not among them, ml: when the places are right, little more is to be gained."""

    def as_json(self, table: LabelTable) -> dict[str, Any]:
        """What other programs read: plain data, with the labels' names."""
        return {
            "places": [
                {
                    "position_mm": list(place.position_mm),
                    "label": table[place.label].name,
                    "rival": table[place.rival].name,
                    "change_ml": place.change_ml,
                    "certainty": place.certainty,
                    "confidence": place.confidence,
                    "radius_mm": place.radius_mm,
                    "worth_ml": place.worth_ml,
                }
                for place in self.places
            ],
            "rest_ml": self.rest_ml,
        }


@dataclass(frozen=True)
class _Candidates:
    """Basins with a lowest voxel that a stroke could be set on."""

    basin: Int64
    ml: Float64
    worth: Float64


def suggest_strokes(
    forest: Forest,
    geometry: Geometry,
    *,
    count: int = 5,
    apart_mm: float = 10.0,
    feet: FootCertainty | None = None,
    right: Sequence[RightPlace] = (),
) -> StrokePlaces:
    """Find the places where one more stroke would change most.

    Parameters
    ----------
    forest
        A solved forest.
    geometry
        Its lattice.
    count
        Number of places, at most.
    apart_mm
        Least distance between two of them. No voxel would be changed at two of them.
    feet
        The forest's :func:`heartcase.pipeline.watershed.certainty.foot_certainty`, where it is at hand.
    right
        Places that were found right. While such a voxel has its label, what would change with it is not named, and no
        place of the same two labels less than ``apart_mm`` from it.
    """
    feet = feet or foot_certainty(forest)
    pieces = forest_pieces(forest)
    found = _candidates(forest, feet, pieces, geometry)
    root_mm = _positions_mm(forest.tree.root[found.basin], geometry)
    places: list[StrokePlace] = []
    taken = np.zeros(len(pieces.level), np.bool_)
    open_to_choice = ~_are_right(forest, feet, pieces, found.basin, root_mm, geometry, right, apart_mm)
    for n in np.lexsort((found.basin, -found.worth)).tolist():
        if len(places) == count:
            break
        if not open_to_choice[n]:
            continue
        basin = int(found.basin[n])
        would = pieces.hanging_on(int(pieces.piece[basin]))
        if (would & taken).any():
            open_to_choice[pieces.piece[found.basin] == pieces.piece[basin]] = False
            continue
        taken |= would
        open_to_choice &= ~would[pieces.piece[found.basin]]
        open_to_choice &= ((root_mm - root_mm[n]) ** 2).sum(axis=1) >= apart_mm**2
        x, y, z = root_mm[n].tolist()
        places.append(
            StrokePlace(
                (x, y, z),
                int(forest.foot_label[basin]),
                int(feet.rival[basin]),
                float(found.ml[n]),
                float(feet.certainty[basin]),
                _depth_mm(forest, np.flatnonzero(would[pieces.piece]), int(forest.tree.root[basin]), geometry),
                float(found.worth[n]),
            )
        )
    return StrokePlaces(tuple(places), float(found.worth[open_to_choice].max(initial=0.0)))


def _are_right(
    forest: Forest,
    feet: FootCertainty,
    pieces: ForestPieces,
    basin: Int64,
    root_mm: Float64,
    geometry: Geometry,
    right: Sequence[RightPlace],
    apart_mm: float,
) -> Bool:
    """Which basins somebody found right."""
    found = np.zeros(len(basin), np.bool_)
    shape = forest.labels.shape
    for one in right:
        index = np.rint(geometry.world_to_index(one.position_mm)[::-1]).astype(np.int64)
        if (index < 0).any() or (index >= shape).any() or forest.labels[tuple(index)] != one.label:
            continue
        same = pieces.piece[basin[forest.tree.root[basin] == np.ravel_multi_index(tuple(index), shape)]]
        found |= np.isin(pieces.piece[basin], same)
        near = ((root_mm - one.position_mm) ** 2).sum(axis=1) < apart_mm**2
        found |= near & (forest.foot_label[basin] == one.label) & (feet.rival[basin] == one.rival)
    return found


def _candidates(forest: Forest, feet: FootCertainty, pieces: ForestPieces, geometry: Geometry) -> _Candidates:
    """All basins that are unsure, would change enough, and have a rival."""
    ml = pieces.flipped_count[pieces.piece].astype(np.float64) * (geometry.voxel_volume_mm3 / 1000.0)
    sure = feet.certainty.astype(np.float64)
    basin = np.flatnonzero((feet.rival != UNMARKED) & (sure < SURE) & (ml >= LEAST_ML))
    basin = basin[~_far_from_heart(forest, basin, geometry)]
    root_mm = _positions_mm(forest.tree.root[basin], geometry)
    own_mm, rival_mm = np.empty(len(basin)), np.empty(len(basin))
    marks = forest.marks.ravel()
    own, rival = forest.foot_label[basin], feet.rival[basin]
    for label in np.union1d(own, rival).tolist():
        tree = cKDTree(_positions_mm(np.flatnonzero(marks == label), geometry))
        for wanted, distance in ((own, own_mm), (rival, rival_mm)):
            distance[wanted == label] = tree.query(root_mm[wanted == label])[0]
    nearness = own_mm / np.maximum(own_mm + rival_mm, np.finfo(float).tiny)
    doubt = (1.0 - sure[basin]) ** DOUBT_POWER
    worth = np.minimum(ml[basin], LARGE_ML) * doubt * nearness**DISTANCE_POWER
    return _Candidates(basin, ml[basin], worth)


def _far_from_heart(forest: Forest, basin: Int64, geometry: Geometry) -> Bool:
    """Which basins are background whose lowest voxel is far from that of every basin of the heart."""
    far: Bool = forest.foot_label[basin] == BACKGROUND
    heart = np.flatnonzero((forest.foot_label != BACKGROUND) & (forest.foot_label != UNMARKED))
    if far.any():
        tree = cKDTree(_positions_mm(forest.tree.root[heart], geometry))
        away_mm = tree.query(_positions_mm(forest.tree.root[basin[far]], geometry), distance_upper_bound=FAR_MM)[0]
        far[far] = ~np.isfinite(away_mm)
    return far


def _positions_mm(voxels: Int64, geometry: Geometry) -> Float64:
    return geometry.index_to_world(np.stack(np.unravel_index(voxels, geometry.shape)[::-1], axis=-1))


def _depth_mm(forest: Forest, basins: Int64, voxel: int, geometry: Geometry) -> float:
    """Distance of a voxel from the nearest one that is in none of some basins' feet, mm."""
    shape = forest.tree.height.shape
    index = np.stack(np.unravel_index(_foot_voxels(forest, basins), shape))
    # one voxel around, but none outside the volume: its border is no border of what changes
    low = np.maximum(index.min(axis=1) - 1, 0)
    high = np.minimum(index.max(axis=1) + 2, shape)
    inside = np.zeros(high - low, np.bool_)
    inside[tuple(index - low[:, None])] = True
    if inside.all():
        return float(np.linalg.norm(np.array(geometry.spacing_mm) * geometry.size))
    depth = edt.edt(inside, anisotropy=geometry.spacing_mm[::-1], black_border=False)
    return float(depth[tuple(np.array(np.unravel_index(voxel, shape)) - low)])


def _foot_voxels(forest: Forest, basins: Int64) -> Int64:
    """Flat indices of the voxels of some basins' feet."""
    tree = forest.tree
    start, voxel_list = tree.voxels
    counts = start[basins + 1] - start[basins]
    owner = np.repeat(basins, counts)
    first = np.repeat(start[basins] - np.concatenate([[0], np.cumsum(counts)[:-1]]), counts)
    voxels = voxel_list[first + np.arange(len(owner))].astype(np.int64)
    offsets, direction, marks = side_offsets(tree.height.shape), tree.direction.ravel(), forest.marks.ravel()
    keep = np.ones(len(voxels), np.bool_)
    for n in np.flatnonzero(forest.lowest_mark[owner] >= 0):
        keep[n] = mark_below(voxels[n], direction, offsets, marks) == UNMARKED
    return voxels[keep]
