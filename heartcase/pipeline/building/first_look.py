"""Labels for a first look at the quick surface: of those that are put off only what it takes is worked out."""

from __future__ import annotations

import numpy as np

from heartcase.pipeline.building.quick_surface import (
    FIRST_SHARE,
    VOXELS,
    Thinned,
    room_around,
    thinned_lattice,
    thinning_steps,
)
from heartcase.pipeline.building.thin_lumens import thin_lumens
from heartcase.pipeline.data import UNMARKED, Segmentation
from heartcase.pipeline.markers.session import SegmentationSession
from heartcase.pipeline.watershed.painting import TILE
from heartcase.schemas.arrays import Bool, Int64, UInt8
from heartcase.schemas.recipe.recipe import Recipe

__all__ = ["first_look"]

SEARCHED = 200_000
"""Voxels of the scan that are looked at to find where labels are."""


def first_look(session: SegmentationSession, recipe: Recipe) -> Thinned:
    """Labels of about as many voxels as a first look takes, around all that is labelled.

    Where labels are is found to a few voxels; where nothing is found so, or nothing is put off, these are all labels.
    Between the voxels that are taken, thin lumens are found where nothing is put off.

    Parameters
    ----------
    session
        The labels as they are painted now.
    recipe
        Walls, ends and edits.

    Raises
    ------
    MarkerError
        Nothing is marked.
    """
    if not (session.is_dividing or session.put_off_tiles.any()):
        return Thinned(session.segmentation())
    geometry = session.geometry
    size, spacing = np.array(geometry.size), np.array(geometry.spacing_mm)
    steps = thinning_steps(size, spacing, SEARCHED)
    first = np.minimum(steps // 2, size - 1)
    labels = session.thinned_labels(_every(first, size, steps))
    is_labelled: Bool = labels - np.uint8(1) < np.uint8(UNMARKED - 1)
    if not is_labelled.any():
        return Thinned(session.segmentation())
    there = [np.flatnonzero(is_labelled.any(axis=tuple({0, 1, 2} - {axis}))) for axis in (2, 1, 0)]
    ends = np.array([[one[0], one[-1]] for one in there]).T * steps + first
    # what is labelled ends before the next voxel that was looked at
    corners = np.clip(ends + np.array([-steps, steps]), 0, size - 1).astype(np.float64)
    low, high = room_around(corners, geometry, recipe)
    steps = thinning_steps(high - low, spacing, FIRST_SHARE * VOXELS)
    inside = np.minimum(steps // 2, high - low - 1)
    first = low + inside
    labels = session.thinned_labels(_every(first, high, steps))
    lattice = thinned_lattice(geometry, first, steps, labels.shape[::-1])
    put_off = session.put_off_tiles
    if put_off.all():
        return Thinned(Segmentation(labels, lattice, session.table))
    [known] = session.labels_so_far([_every(low, high, np.ones(3, np.int64))])
    _fill_tiles(known, put_off, low, labels, steps, inside)
    labels, is_thin = thin_lumens(known, labels, steps, inside, session.table)
    return Thinned(Segmentation(labels, lattice, session.table), is_thin)


def _fill_tiles(known: UInt8, put_off: Bool, low: Int64, labels: UInt8, steps: Int64, first: Int64) -> None:
    """Give all voxels of tiles that are put off, in a box from ``low`` on, the label of the voxel taken near them."""
    start = low[::-1]
    nearest = [
        np.clip((np.arange(n) - one + step // 2) // step, 0, size - 1)
        for n, one, step, size in zip(known.shape, first[::-1], steps[::-1], labels.shape, strict=True)
    ]
    for tile in np.argwhere(put_off):
        begin, end = np.maximum(TILE * tile - start, 0), np.minimum(TILE * (tile + 1) - start, known.shape)
        if (begin < end).all():
            k, j, i = (slice(int(a), int(b)) for a, b in zip(begin, end, strict=True))
            known[k, j, i] = labels[np.ix_(nearest[0][k], nearest[1][j], nearest[2][i])]


def _every(first: Int64, behind: Int64, steps: Int64) -> tuple[slice, slice, slice]:
    """Slices [z, y, x] of every n-th voxel (i, j, k)."""
    i, j, k = (slice(int(a), int(b), int(step)) for a, b, step in zip(first, behind, steps, strict=True))
    return k, j, i
