"""Places where one more stroke would change most: where to paint next, and when to stop.

At any place a stroke of another label changes a known volume (:mod:`heartcase.pipeline.watershed.subtrees`); in a flat
minimum that is marked already, a dab is tried (:mod:`heartcase.pipeline.markers.flat_places`). Where it is worth a look
is guessed: at each basin's lowest voxel, and at one voxel for each label in such a flat,

    worth = min(volume, 5 ml) * (own / other)^4 * (d_own / (d_own + d_rival))^2

with the passes ``own`` and ``other`` of :mod:`heartcase.pipeline.watershed.certainty` and the distances to the nearest
voxels painted with the voxel's label and with its rival's. Larger volumes count no more, since they hold most of a
structure, with its own strokes. Background far from the heart is not worth a look: air in a corner of the scan is as
unsure as can be, as nobody marks it. ``heartcase bench segment-confidence`` measures how many of the places are wrong.
"""

from __future__ import annotations

import heapq
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import edt
import numpy as np

from heartcase.pipeline.data import UNMARKED
from heartcase.pipeline.markers.distances import MarkerDistances, doubt
from heartcase.pipeline.markers.flat_places import (
    MOST_LOOKED_AT,
    FlatPlaces,
    changed_by_dab,
    flat_places,
    in_marked_flat,
)
from heartcase.pipeline.watershed.certainty import FootCertainty, foot_certainty
from heartcase.pipeline.watershed.descent import side_offsets
from heartcase.pipeline.watershed.forest import Forest
from heartcase.pipeline.watershed.marks import mark_below
from heartcase.pipeline.watershed.subtrees import ForestPieces, forest_pieces
from heartcase.schemas.arrays import Bool, Float32, Float64, Int64
from heartcase.schemas.geometry import Geometry
from heartcase.schemas.labels import LabelTable

__all__ = ["SURE", "RightPlace", "StrokePlace", "StrokePlaces", "still_right", "suggest_strokes"]


SURE = 0.5
"""Certainty from which on a place is not named."""
LEAST_ML = 0.02
"""Less than this is not worth a stroke."""
LARGE_ML = 5.0


@dataclass(frozen=True)
class StrokePlace:
    """A place where one more stroke would change much."""

    position_mm: tuple[float, float, float]
    """Centre of a voxel where the scan is flattest, LPS mm."""
    label: int
    """Label that the place has now."""
    rival: int
    """The other label that reaches it over the lowest pass."""
    change_ml: float
    """What a stroke of any other label there changes, ml: exactly this, where it stays within ``radius_mm``. In a flat
    minimum that is marked already: what a dab of one voxel of the rival changes; a wider one changes at least that."""
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
    choice = _Choice(forest, feet, geometry, apart_mm, right)
    found: list[StrokePlace] = []
    while len(found) <= max(count, 0) and (best := choice.best()) is not None:
        found.append(choice.take(best))
    # a flat that was tried late may be worth more than was guessed
    found.sort(key=lambda place: -place.worth_ml)
    places, rest = found[: max(count, 0)], found[max(count, 0) :]
    return StrokePlaces(tuple(places), rest[0].worth_ml if rest else 0.0)


class _Best(NamedTuple):
    """A candidate with what it really changes."""

    worth: float
    number: int
    """Of the basin among the candidates; of the flat place, counted on from them."""


class _Choice:
    """Candidates by falling worth, each only while it changes nothing that a place which was taken changes."""

    def __init__(
        self, forest: Forest, feet: FootCertainty, geometry: Geometry, apart_mm: float, right: Sequence[RightPlace]
    ) -> None:
        self._forest, self._feet, self._geometry, self._apart_mm = forest, feet, geometry, apart_mm
        self._pieces = pieces = forest_pieces(forest)
        self._distances = distances = MarkerDistances(forest, geometry)
        self._found = found = _candidates(forest, feet, pieces, geometry, distances)
        self._flats = _flat_places(forest, feet, geometry, distances, right, apart_mm)
        self._place_mm = distances.positions_mm(np.concatenate([forest.tree.root[found.basin], self._flats.voxel]))
        self._taken = np.zeros(len(pieces.level), np.bool_)
        root_mm = self._place_mm[: len(found.basin)]
        are_right = _are_right(forest, feet, pieces, found.basin, root_mm, geometry, right, apart_mm)
        self._is_open = np.concatenate([~are_right, np.ones(len(self._flats.voxel), np.bool_)])
        worth = np.concatenate([found.worth, _worth(self._flats.about_ml, self._flats.doubt)])
        # of equal worth the first basin; it is a heap, as it is in order
        self._queue = [(-float(worth[n]), n) for n in np.argsort(-worth, kind="stable").tolist()]
        self._changed: dict[int, Int64] = {}
        self._changed_before = np.zeros(0, np.bool_)
        self._copy: Forest | None = None
        at = [index for one in right if (index := _index_of(forest, one, geometry)) is not None]
        self._right_voxels = np.array([np.ravel_multi_index(index, forest.labels.shape) for index in at], np.int64)
        self._taken_mm: list[tuple[float, float, float]] = []

    def best(self) -> _Best | None:
        """The candidate that is worth most, what is changed in flats tried; None where there is none."""
        while self._queue:
            worth, number = self._queue[0]
            if not self._is_open[number] or self._meets_taken(number):
                heapq.heappop(self._queue)
            elif number < len(self._found.basin) or number in self._changed:
                return _Best(-worth, number)
            else:
                heapq.heappop(self._queue)
                self._try(number)
        return None

    def take(self, best: _Best) -> StrokePlace:
        """The place; what changes with it, and what is near it, is no choice any more."""
        forest, number, basin_count = self._forest, best.number, len(self._found.basin)
        heapq.heappop(self._queue)
        self._is_open &= ((self._place_mm - self._place_mm[number]) ** 2).sum(axis=1) >= self._apart_mm**2
        if number >= basin_count:
            flats, n, changed = self._flats, number - basin_count, self._changed[number]
            self._taken[self._pieces_of(changed)] = True
            self._note(changed)
            x, y, z = self._place_mm[number].tolist()
            self._taken_mm.append((x, y, z))
            depth_mm = _depths_mm(forest.labels.shape, changed, self._geometry)
            return StrokePlace(
                (x, y, z),
                int(flats.label[n]),
                int(flats.rival[n]),
                len(changed) * self._geometry.voxel_volume_mm3 / 1000.0,
                float(flats.certainty[n]),
                float(depth_mm[np.searchsorted(changed, flats.voxel[n])]),
                best.worth,
            )
        feet, basin = self._feet, int(self._found.basin[number])
        would = self._pieces.hanging_on(int(self._pieces.piece[basin]))
        self._taken |= would
        taken = would[self._pieces.piece]
        self._close(taken)
        changed = np.sort(_foot_voxels(forest, np.flatnonzero(taken)))
        if len(self._flats.voxel):
            self._note(changed)
        voxel, radius_mm = self._deepest(basin, changed)
        one = np.array([voxel])
        worth, (x, y, z) = best.worth, self._distances.positions_mm(one)[0].tolist()
        if voxel != forest.tree.root[basin]:
            near_rival, _ = self._distances.nearness(one, forest.foot_label[[basin]], feet.rival[[basin]])
            sure = feet.certainty[[basin]].astype(np.float64)
            worth = float(_worth(self._found.ml[[number]], doubt(sure, near_rival))[0])
            self._is_open &= ((self._place_mm - (x, y, z)) ** 2).sum(axis=1) >= self._apart_mm**2
        self._taken_mm.append((x, y, z))
        return StrokePlace(
            (x, y, z),
            int(forest.foot_label[basin]),
            int(feet.rival[basin]),
            float(self._found.ml[number]),
            float(feet.certainty[basin]),
            radius_mm,
            worth,
        )

    def _deepest(self, basin: int, changed: Int64) -> tuple[int, float]:
        """Of a flat at a basin's bottom the voxel deepest in what changes, near the heart; and how deep it is, mm.

        The lowest voxel itself where there is no flat, or where all others are too near to places that were taken.
        """
        tree = self._forest.tree
        root, shape = int(tree.root[basin]), self._forest.labels.shape
        depth_mm = _depths_mm(shape, changed, self._geometry)
        lowest = int(np.searchsorted(changed, root))
        if tree.flat[basin] < 0:
            return root, float(depth_mm[lowest])
        choice = np.flatnonzero(tree.flat_of(changed) == tree.flat[basin])
        choice = choice[:: -(-len(choice) // MOST_LOOKED_AT)]
        place_mm = self._distances.positions_mm(changed[choice])
        labels = np.full(len(choice), self._forest.foot_label[basin])
        is_good = ~self._distances.are_far_from_heart(changed[choice], labels)
        for taken_mm in self._taken_mm:
            is_good &= ((place_mm - taken_mm) ** 2).sum(axis=1) >= self._apart_mm**2
        choice = np.append(choice[is_good], lowest)
        best = int(choice[np.argmax(depth_mm[choice])])
        return int(changed[best]), float(depth_mm[best])

    def _meets_taken(self, number: int) -> bool:
        """Whether a candidate changes what a place that was taken changes."""
        if number >= len(self._found.basin):
            changed = self._changed.get(number)
            return changed is not None and len(self._changed_before) > 0 and bool(self._changed_before[changed].any())
        piece = int(self._pieces.piece[self._found.basin[number]])
        if not (self._pieces.hanging_on(piece) & self._taken).any():
            return False
        self._close(self._pieces.piece == piece)
        return True

    def _close(self, of_piece: Bool) -> None:
        """Leave out basins of some pieces, bool, shape (basins,), from now on."""
        self._is_open[: len(self._found.basin)] &= ~of_piece[self._found.basin]

    def _try(self, number: int) -> None:
        """Find out what a dab in a flat changes, and queue it with that."""
        flats, n = self._flats, number - len(self._found.basin)
        if self._copy is None:
            self._copy = self._forest.copy()
            self._copy.puts_off = False
        changed = changed_by_dab(self._copy, int(flats.voxel[n]), int(flats.rival[n]))
        if np.isin(self._right_voxels, changed).any():
            return
        ml = len(changed) * self._geometry.voxel_volume_mm3 / 1000.0
        if ml >= LEAST_ML:
            self._changed[number] = changed
            heapq.heappush(self._queue, (-float(flats.doubt[n]) * min(ml, LARGE_ML), number))

    def _pieces_of(self, voxels: Int64) -> Int64:
        """Pieces with feet among some voxels, but for those that hang on no face."""
        pieces: Int64 = np.unique(self._pieces.piece[self._forest.tree.basin.ravel()[voxels]]).astype(np.int64)
        hung: Int64 = pieces[self._pieces.level[pieces] != 0]
        return hung

    def _note(self, changed: Int64) -> None:
        if not len(self._changed_before):
            self._changed_before = np.zeros(self._forest.labels.size, np.bool_)
        self._changed_before[changed] = True


def _worth(ml: Float64, doubts: Float64) -> Float64:
    """What a look is worth, ml."""
    return np.minimum(ml, LARGE_ML) * doubts


def _flat_places(
    forest: Forest,
    feet: FootCertainty,
    geometry: Geometry,
    distances: MarkerDistances,
    right: Sequence[RightPlace],
    apart_mm: float,
) -> FlatPlaces:
    said = [
        (np.array(one.position_mm), one.label, one.rival, apart_mm)
        for one in right
        if _index_of(forest, one, geometry) is not None
    ]
    return flat_places(forest, feet, geometry, distances, least_ml=LEAST_ML, sure=SURE, but_near=said)


def still_right(forest: Forest, geometry: Geometry, right: Sequence[RightPlace]) -> tuple[RightPlace, ...]:
    """Places that were found right and still have the label that they had then."""
    return tuple(one for one in right if _index_of(forest, one, geometry) is not None)


def _index_of(forest: Forest, right: RightPlace, geometry: Geometry) -> tuple[int, ...] | None:
    """Index [z, y, x] of a place that was found right; None where it has another label now, or none."""
    index = np.rint(geometry.world_to_index(right.position_mm)[::-1]).astype(np.int64)
    shape = forest.labels.shape
    if (index < 0).any() or (index >= shape).any() or forest.labels[tuple(index)] != right.label:
        return None
    return tuple(index.tolist())


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
    for one in right:
        index = _index_of(forest, one, geometry)
        if index is None:
            continue
        at = int(forest.tree.basin[index])
        if forest.tree.height[index] == forest.tree.height.flat[forest.tree.root[at]]:
            found |= pieces.piece[basin] == pieces.piece[at]
        near = ((root_mm - one.position_mm) ** 2).sum(axis=1) < apart_mm**2
        found |= near & (forest.foot_label[basin] == one.label) & (feet.rival[basin] == one.rival)
    return found


def _candidates(
    forest: Forest, feet: FootCertainty, pieces: ForestPieces, geometry: Geometry, distances: MarkerDistances
) -> _Candidates:
    """All basins that are unsure, would change enough, and have a rival."""
    ml = pieces.flipped_count[pieces.piece].astype(np.float64) * (geometry.voxel_volume_mm3 / 1000.0)
    sure = feet.certainty.astype(np.float64)
    basin = np.flatnonzero((feet.rival != UNMARKED) & (sure < SURE) & (ml >= LEAST_ML) & ~in_marked_flat(forest))
    basin = basin[~distances.are_far_from_heart(forest.tree.root[basin], forest.foot_label[basin])]
    near_rival, _ = distances.nearness(forest.tree.root[basin], forest.foot_label[basin], feet.rival[basin])
    return _Candidates(basin, ml[basin], _worth(ml[basin], doubt(sure[basin], near_rival)))


def _depths_mm(shape: tuple[int, ...], voxels: Int64, geometry: Geometry) -> Float32:
    """Distance of each of some voxels, flat indices, from the nearest voxel that is none of them, mm."""
    index = np.stack(np.unravel_index(voxels, shape))
    # one voxel around, but none outside the volume: its border is no border of what changes
    low = np.maximum(index.min(axis=1) - 1, 0)
    high = np.minimum(index.max(axis=1) + 2, shape)
    inside = np.zeros(high - low, np.bool_)
    inside[tuple(index - low[:, None])] = True
    if inside.all():
        return np.full(len(voxels), np.linalg.norm(np.array(geometry.spacing_mm) * geometry.size), np.float32)
    depth: Float32 = edt.edt(inside, anisotropy=geometry.spacing_mm[::-1], black_border=False)
    of_each: Float32 = depth[tuple(index - low[:, None])]
    return of_each


def _foot_voxels(forest: Forest, basins: Int64) -> Int64:
    """Flat indices of the voxels of some basins' feet."""
    tree = forest.tree
    voxels, owner = tree.voxels_of(basins)
    offsets, direction, marks = side_offsets(tree.height.shape), tree.direction.ravel(), forest.marks.ravel()
    keep = np.ones(len(voxels), np.bool_)
    for n in np.flatnonzero(forest.lowest_mark[owner] >= 0):
        keep[n] = mark_below(voxels[n], direction, offsets, marks) == UNMARKED
    return voxels[keep]
