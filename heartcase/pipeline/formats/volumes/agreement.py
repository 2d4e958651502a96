"""One tolerance for what a header says twice or in rounded digits: how far it moves a corner of the volume.

A cosine that is off by 0.001 means nothing on a small image and a voxel on a large one, so no part of a header has a
tolerance of its own: what counts is where the volume's voxels lie. sform and qform, axes that are not quite at right
angles, and slices that are not quite evenly spaced are all judged by :data:`AGREEMENT_MM`, and by what the digits that
are written can hold.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise, product

import numpy as np

from heartcase.schemas.arrays import Float64, Int64

__all__ = ["AGREEMENT_MM", "corner_distance_mm", "corners_of", "even_line", "right_angled"]

AGREEMENT_MM = 0.1
"""How far a corner of the volume, or a slice, may lie from where another reading of the header has it, mm."""
EXACT_MM = 0.01
"""Slices within this of the line from the first to the last are taken to lie on it, mm: two written decimals."""


def corners_of(size: Sequence[int]) -> Float64:
    """Indices (i, j, k) of the eight outermost voxels of a volume with ``size`` voxels along i, j, k; shape (8, 3)."""
    corners: Float64 = np.array(list(product((0.0, 1.0), repeat=3))) * (np.array(size) - 1.0)
    return corners


def corner_distance_mm(first: Float64, second: Float64, size: Sequence[int]) -> float:
    """How far two maps from index to space, each (4, 4), put a corner of a volume apart at most, mm."""
    corners = corners_of(size)
    difference = corners @ (first - second)[:3, :3].T + (first - second)[:3, 3]
    return float(np.linalg.norm(difference, axis=1).max())


def right_angled(affine: Float64, size: Sequence[int]) -> Float64:
    """The map with axes at right angles that lies nearest to a sheared one.

    The directions are the orthogonal factor of the polar decomposition of the unit columns, which is the nearest
    orthogonal matrix to them (Higham, "Computing the polar decomposition", SIAM J. Sci. Stat. Comput. 7, 1986); each
    spacing is the length of its column, and the middle of the volume stays where it is.

    Parameters
    ----------
    affine
        Map from index (i, j, k, 1) to mm, shape (4, 4), its columns not zero.
    size
        Number of voxels along i, j, k.

    Returns
    -------
    ndarray
        The map, shape (4, 4), left-handed where the given one is.
    """
    spacing = np.linalg.norm(affine[:3, :3], axis=0)
    left, _, right = np.linalg.svd(affine[:3, :3] / spacing)
    found = affine.copy()
    found[:3, :3] = (left @ right) * spacing
    middle = (np.array(size) - 1.0) / 2.0
    found[:3, 3] += (affine[:3, :3] - found[:3, :3]) @ middle
    return found


def even_line(along: Float64, places: Int64) -> tuple[float, float, float]:
    """The evenly spaced places that lie nearest to given positions.

    That from the first position to the last, where all lie within :data:`EXACT_MM` of it; else the one whose largest
    distance from a position is least (Chebyshev's line), which holds for rounded positions whatever is rounded up.

    Parameters
    ----------
    along
        Positions along the stack, ascending, mm, shape (n,), n at least 2.
    places
        Which place on the line each has, ascending, from 0, shape (n,).

    Returns
    -------
    start
        Position of place 0, mm.
    spacing
        Distance between neighbouring places, mm.
    distance
        Largest distance of a position from its place, mm.
    """
    start, spacing = float(along[0]), float((along[-1] - along[0]) / places[-1])
    distance = float(np.abs(along - start - spacing * places).max())
    if distance <= EXACT_MM or len(along) < 3:
        return start, spacing, distance
    # The best line runs midway between an edge of the upper hull and a point of the lower one, or the other way about.
    best = (distance, spacing, start)
    for hull in (_hull(along, places, 1.0), _hull(along, places, -1.0)):
        for one, other in pairwise(hull):
            slope = (along[other] - along[one]) / (places[other] - places[one])
            rest = along - slope * places
            best = min(best, (float(np.ptp(rest)) / 2.0, float(slope), float(rest.min() + rest.max()) / 2.0))
    return best[2], best[1], best[0]


def _hull(along: Float64, places: Int64, sign: float) -> list[int]:
    """Indices of the points of the upper (1) or lower (-1) convex hull, by Andrew's monotone chain."""
    hull: list[int] = []
    for index in range(len(along)):
        while len(hull) > 1:
            one, other = hull[-2], hull[-1]
            turn = (places[other] - places[one]) * (along[index] - along[one]) - (along[other] - along[one]) * (
                places[index] - places[one]
            )
            if sign * turn < 0.0:
                break
            hull.pop()
        hull.append(index)
    return hull
