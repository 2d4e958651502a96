"""Where one more stroke would change most, so that a person knows where to look and when to stop.

Every piece of the forest (:mod:`heartcase.pipeline.watershed.pieces`) is a place where a stroke of another label would
change a known volume. What it is likely to change is taken as this volume times ``(own / other) ** 2`` of its passes
(:mod:`heartcase.pipeline.watershed.certainty`). The places are given in the order of that; they lie apart, and no voxel
would be changed by two of them.
"""

from __future__ import annotations

from dataclasses import dataclass

import edt
import numpy as np
import numpy.typing as npt

from heartcase.pipeline.watershed.certainty import FootCertainty, foot_certainty
from heartcase.pipeline.watershed.descent import side_offsets
from heartcase.pipeline.watershed.forest import UNMARKED, Forest, _mark_below
from heartcase.pipeline.watershed.pieces import ForestPieces, forest_pieces
from heartcase.schemas.geometry import Geometry

__all__ = ["SURE", "StrokePlace", "StrokePlaces", "suggest_strokes"]

Bool = npt.NDArray[np.bool_]
Float32 = npt.NDArray[np.float32]
Float64 = npt.NDArray[np.float64]
Int64 = npt.NDArray[np.int64]

SURE = 0.5
"""Certainty from which on a place is not counted among those that may have to change."""
DOUBT_POWER = 2.0
"""Measured on phantoms with few strokes: of the volume of pieces with own / other below 0.3 some 3% is wrong, above 0.6
some 20%."""
LEAST_ML = 0.01
"""Less than this is not worth a stroke."""


@dataclass(frozen=True)
class StrokePlace:
    """A place where one more stroke would change much."""

    position_mm: tuple[float, float, float]
    """A voxel deep inside what would change, LPS mm."""
    label: int
    """Label that the place has now."""
    rival: int
    """The other label that reaches it over the lowest pass."""
    change_ml: float
    """What a stroke of any other label there changes, ml: exactly this, where the stroke stays within ``radius_mm``."""
    certainty: float
    """Certainty of the place, 0 to 1."""
    radius_mm: float
    """Distance to the nearest voxel that would not change: the largest brush that stays inside."""


@dataclass(frozen=True)
class StrokePlaces:
    """Where to look next, and whether it is worth it."""

    places: tuple[StrokePlace, ...]
    """By what they are likely to change, most first."""
    most_ml: float
    """The most that one stroke could change at any place with a certainty below :data:`SURE`, ml."""
    unsure_ml: float
    """All that has a certainty below :data:`SURE` and has another label than background or could become it, ml."""


def suggest_strokes(
    forest: Forest,
    geometry: Geometry,
    *,
    count: int = 5,
    apart_mm: float = 10.0,
    feet: FootCertainty | None = None,
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
        Least distance between two of them.
    feet
        The forest's :func:`heartcase.pipeline.watershed.certainty.foot_certainty`, where it is at hand.
    """
    feet = feet or foot_certainty(forest)
    pieces = forest_pieces(forest)
    sure = feet.certainty[pieces.first_foot]
    ml = pieces.flipped_count * (geometry.voxel_volume_mm3 / 1000.0)
    likely = np.where(feet.rival[pieces.first_foot] != UNMARKED, ml * (1.0 - sure.astype(float)) ** DOUBT_POWER, 0.0)
    is_unsure = (likely > 0.0) & (sure < SURE)
    places: list[StrokePlace] = []
    taken = np.zeros(len(ml), np.bool_)
    for piece in np.lexsort((pieces.level, -likely)).tolist():
        if len(places) == count or ml[piece] < LEAST_ML or likely[piece] == 0.0:
            break
        would = pieces.hanging_on(piece)
        if (would & taken).any():
            continue
        index, depth_mm = _deepest(forest, pieces, piece, would, geometry)
        position = geometry.index_to_world(index)
        if any(np.linalg.norm(position - place.position_mm) < apart_mm for place in places):
            continue
        taken |= would
        foot = pieces.first_foot[piece]
        x, y, z = position.tolist()
        places.append(
            StrokePlace(
                (x, y, z),
                int(forest.foot_label[foot]),
                int(feet.rival[foot]),
                float(ml[piece]),
                float(sure[piece]),
                depth_mm,
            )
        )
    return StrokePlaces(tuple(places), float(ml[is_unsure].max(initial=0.0)), 0.0)


def _deepest(
    forest: Forest, pieces: ForestPieces, piece: int, would: Bool, geometry: Geometry
) -> tuple[Int64, float]:
    """Index (i, j, k) of the voxel of a piece farthest from what would not change, and how far that is, mm."""
    tree = forest.tree
    voxels, owner = _foot_voxels(forest, np.flatnonzero(would[pieces.piece]))
    index = np.stack(np.unravel_index(voxels, tree.height.shape))
    low, high = index.min(axis=1), index.max(axis=1) + 1
    # one voxel around, but none outside the volume: its border is no border of what changes
    low, high = np.maximum(low - 1, 0), np.minimum(high + 1, tree.height.shape)
    inside = np.zeros(high - low, np.bool_)
    inside[tuple(index - low[:, None])] = True
    spacing = geometry.spacing_mm[::-1]
    depth = edt.edt(inside, anisotropy=spacing, black_border=False)[tuple(index - low[:, None])]
    bits = tree.height.view(np.int32).ravel()[voxels].astype(np.int64)
    own = (pieces.piece[owner] == piece) & (((bits << 32) | (voxels << 3)) < pieces.level[piece])
    # a face that is lower than the piece's leads through two of its voxels, so there is at least one
    best = np.flatnonzero(own)[np.lexsort((voxels[own], bits[own], -depth[own]))[0]]
    return index[::-1, best], float(depth[best])


def _foot_voxels(forest: Forest, basins: Int64) -> tuple[Int64, Int64]:
    """Flat indices of the voxels of some basins' feet, and the basin of each."""
    tree = forest.tree
    start, voxel_list = tree.voxels
    counts = start[basins + 1] - start[basins]
    owner = np.repeat(basins, counts)
    first = np.repeat(start[basins] - np.concatenate([[0], np.cumsum(counts)[:-1]]), counts)
    voxels = voxel_list[first + np.arange(len(owner))].astype(np.int64)
    marked = np.flatnonzero(forest.lowest_mark[owner] >= 0)
    if not len(marked):
        return voxels, owner
    offsets, direction, marks = side_offsets(tree.height.shape), tree.direction.ravel(), forest.marks.ravel()
    keep = np.ones(len(voxels), np.bool_)
    for n in marked:
        keep[n] = _mark_below(voxels[n], direction, offsets, marks) == UNMARKED
    return voxels[keep], owner[keep]
