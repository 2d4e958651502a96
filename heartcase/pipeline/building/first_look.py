"""Labels for a first look at the quick surface: of those that are put off only what it takes is worked out."""

from __future__ import annotations

import numpy as np

from heartcase.pipeline.building.quick_surface import (
    FIRST_SHARE,
    VOXELS,
    room_around,
    thinned_lattice,
    thinning_steps,
)
from heartcase.pipeline.data import UNMARKED, Segmentation
from heartcase.pipeline.markers.session import SegmentationSession
from heartcase.schemas.arrays import Bool, Int64
from heartcase.schemas.recipe.recipe import Recipe

__all__ = ["first_look"]

SEARCHED = 200_000
"""Voxels of the scan that are looked at to find where labels are."""


def first_look(session: SegmentationSession, recipe: Recipe) -> Segmentation:
    """Labels of about as many voxels as a first look takes, around all that is labelled.

    Where labels are is found to a few voxels; where nothing is found so, or nothing is put off, these are all labels.

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
        return session.segmentation()
    geometry = session.geometry
    size, spacing = np.array(geometry.size), np.array(geometry.spacing_mm)
    steps = thinning_steps(size, spacing, SEARCHED)
    first = np.minimum(steps // 2, size - 1)
    labels = session.thinned_labels(_every(first, size, steps))
    is_labelled: Bool = labels - np.uint8(1) < np.uint8(UNMARKED - 1)
    if not is_labelled.any():
        return session.segmentation()
    there = [np.flatnonzero(is_labelled.any(axis=tuple({0, 1, 2} - {axis}))) for axis in (2, 1, 0)]
    ends = np.array([[one[0], one[-1]] for one in there]).T * steps + first
    # what is labelled ends before the next voxel that was looked at
    corners = np.clip(ends + np.array([-steps, steps]), 0, size - 1).astype(np.float64)
    low, high = room_around(corners, geometry, recipe)
    steps = thinning_steps(high - low, spacing, FIRST_SHARE * VOXELS)
    first = low + np.minimum(steps // 2, high - low - 1)
    labels = session.thinned_labels(_every(first, high, steps))
    return Segmentation(labels, thinned_lattice(geometry, first, steps, labels.shape[::-1]), session.table)


def _every(first: Int64, behind: Int64, steps: Int64) -> tuple[slice, slice, slice]:
    """Slices [z, y, x] of every n-th voxel (i, j, k)."""
    i, j, k = (slice(int(a), int(b), int(step)) for a, b, step in zip(first, behind, steps, strict=True))
    return k, j, i
