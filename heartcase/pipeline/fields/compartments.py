"""Keeping blood compartments as they were: separate ones stay separate, joined ones stay joined.

A compartment is a 6-connected piece of all blood. :func:`bridging_voxels` guards the smoothing voxel by voxel;
:func:`compartment_changes` looks at what came out in the end, between the voxels too.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import cc3d
import numba
import numpy as np
import numpy.typing as npt
from scipy.sparse import csr_array

from heartcase.compiling.calls import copied
from heartcase.compiling.kernel import loop_kernel
from heartcase.pipeline.fields.contacts import Extent, faces_between
from heartcase.pipeline.kernels.boxes import Box, box_of
from heartcase.pipeline.kernels.topology import piece_sizes
from heartcase.schemas.arrays import Bool, UInt8, UInt32
from heartcase.schemas.geometry import Geometry

__all__ = ["Change", "bridging_voxels", "compartment_changes"]


LEAST_VOXELS = 8
"""Compartments of fewer voxels are specks."""
MOST_PIECES = 250
"""Compartments whose meetings are told apart in one place, at most."""


def bridging_voxels(labels: UInt8, smoothed: UInt8, blood_values: Sequence[int]) -> Bool:
    """Voxels that must get their old label back so that the smoothing neither joins nor splits compartments.

    A compartment is a 6-connected piece of all blood. A cluster of voxels that became blood is given back when it
    touches two compartments; one that was blood is given back when it touches two pieces of what is left.

    Parameters
    ----------
    labels
        Label values before, shape [z, y, x].
    smoothed
        Label values after.
    blood_values
        Values of blood and vessel lumen.

    Returns
    -------
    Bool
        Shape of the labels.
    """
    is_blood = np.zeros(256, np.bool_)
    is_blood[list(blood_values)] = True
    before, after = is_blood[labels], is_blood[smoothed]
    given_back = _touching_two(after & ~before, before)
    given_back |= _touching_two(before & ~after, before & after)
    return given_back


def _touching_two(changed: Bool, kept: Bool) -> Bool:
    """Clusters of changed voxels that touch at least two pieces of the kept ones."""
    where = np.argwhere(changed)
    if len(where) == 0:
        return np.zeros(changed.shape, np.bool_)
    clusters = cc3d.connected_components(changed, connectivity=6)
    pieces = np.pad(cc3d.connected_components(kept, connectivity=6), 1)
    cluster = clusters[tuple(where.T)].astype(np.int64)
    pairs = []
    for axis in range(3):
        for step in (-1, 1):
            beside = where + 1
            beside[:, axis] += step
            piece = pieces[tuple(beside.T)].astype(np.int64)
            pairs.append(np.stack([cluster, piece], axis=1)[piece > 0])
    contacts = np.unique(np.concatenate(pairs), axis=0)
    touched = np.bincount(contacts[:, 0], minlength=int(clusters.max()) + 1)
    bridging: Bool = (touched >= 2)[clusters] & changed
    return bridging


@dataclass(frozen=True)
class Change:
    """Where compartments of blood were joined, or one was split."""

    is_joined: bool
    """Joined; else split."""
    labels: tuple[int, int]
    """Labels on the two sides, the lower first; the same where it happened within one."""
    extent: Extent
    """The border on which the two sides meet, or met."""


def compartment_changes(
    labels: UInt8,
    fine: UInt8,
    blood_values: Sequence[int],
    fine_geometry: Geometry,
    *,
    least_voxels: int = LEAST_VOXELS,
) -> tuple[Change, ...]:
    """Compare the compartments of blood of a segmentation with those of what was made of it, on a finer lattice.

    Two compartments are joined where one of the finer lattice overlaps with both; one is split where it overlaps with
    two. Compartments and overlaps of less than ``least_voxels`` voxels do not count.

    Parameters
    ----------
    labels
        Label values before, shape [z, y, x].
    fine
        Label values after, on a lattice with each edge divided by the same whole number.
    blood_values
        Values of blood and vessel lumen.
    fine_geometry
        Lattice of ``fine``.
    least_voxels
        Voxels of ``labels`` from which a compartment counts.

    Returns
    -------
    tuple of Change
        One for each pair of compartments that met: first the joins, then the splits, each in the order of the volume.
    """
    factor = fine.shape[0] // labels.shape[0]
    is_blood = np.zeros(256, np.bool_)
    is_blood[list(blood_values)] = True
    least_after = least_voxels * factor**3
    before = _large_pieces(is_blood[labels], least_voxels)
    after = _large_pieces(is_blood[fine], least_after)
    overlap = _overlaps(before, after, factor) >= least_after
    changes: list[Change] = []
    for piece in np.flatnonzero(np.asarray(overlap.sum(axis=0)).ravel() > 1):
        wanted = overlap[:, [piece]].nonzero()[0]
        box = box_of(after == piece)
        own = _refined(np.where(np.isin(before, wanted), before, 0), factor, box)
        changes += _meetings(after[box] == piece, own, _refined(labels, factor, box), box, fine_geometry, True)
    for piece in np.flatnonzero(np.asarray(overlap.sum(axis=1)).ravel() > 1):
        wanted = overlap[[piece], :].nonzero()[1]
        z, y, x = (slice(factor * part.start, factor * part.stop) for part in box_of(before == piece))
        box = (z, y, x)
        own = np.where(np.isin(after[box], wanted), after[box], 0)
        changes += _meetings(_refined(before == piece, factor, box), own, fine[box], box, fine_geometry, False)
    return tuple(changes)


def _large_pieces(blood: Bool, least: int) -> UInt32:
    """Number the 6-connected pieces of at least so many voxels from 1 in the order of the volume; 0 elsewhere."""
    pieces, count = cc3d.connected_components(blood, connectivity=6, return_N=True, out_dtype=np.uint32)
    is_large = piece_sizes(pieces.ravel(), int(count)) >= least
    is_large[0] = False
    numbers = np.cumsum(is_large, dtype=np.uint32)
    numbers[~is_large] = 0
    _renumber(pieces.ravel(), numbers)
    large: UInt32 = pieces
    return large


@loop_kernel
def _renumber(pieces, numbers):
    for n in numba.prange(len(pieces)):
        pieces[n] = numbers[pieces[n]]


def _overlaps(before: UInt32, after: UInt32, factor: int) -> Any:
    """Common fine voxels of each piece before (row) and after (column), a sparse array."""
    shape = (int(before.max()) + 1, int(after.max()) + 1)
    found = np.empty(len(after), np.int64)
    _count_runs(before, after, factor, found)
    start = np.concatenate([[0], np.cumsum(found)])
    rows, columns, counts = (np.empty(int(start[-1]), kind) for kind in (np.uint32, np.uint32, np.int64))
    _list_runs(before, after, factor, start, rows, columns, counts)
    return csr_array((counts, (rows, columns)), shape=shape)


@copied
def _runs_of(coarse, fine, factor, at, rows, columns, counts):
    """List the runs of one piece before and one after along a line, from ``at`` on where there is room; the end."""
    last_row, last_column = np.uint32(0), np.uint32(0)
    for i in range(len(coarse)):
        row = coarse[i]
        for x in range(factor * i, factor * i + factor):
            column = fine[x] if row > 0 else row
            if column == 0:
                last_row = column
                continue
            if row != last_row or column != last_column:
                if at < len(rows):
                    rows[at], columns[at], counts[at] = row, column, 0
                last_row, last_column = row, column
                at += 1
            if at <= len(rows):
                counts[at - 1] += 1
    return at


@loop_kernel
def _count_runs(before, after, factor, found):
    """Count the runs in each fine plane."""
    for k in numba.prange(len(after)):
        none, no_count = np.empty(0, np.uint32), np.empty(0, np.int64)
        count = 0
        for j in range(after.shape[1]):
            count = _runs_of(before[k // factor, j // factor], after[k, j], factor, count, none, none, no_count)
        found[k] = count


@loop_kernel
def _list_runs(before, after, factor, start, rows, columns, counts):
    """Both pieces of each run, and its voxels; the runs of each plane begin at ``start``."""
    for k in numba.prange(len(after)):
        at = start[k]
        for j in range(after.shape[1]):
            at = _runs_of(before[k // factor, j // factor], after[k, j], factor, at, rows, columns, counts)


def _refined(values: npt.NDArray[Any], factor: int, box: Box) -> npt.NDArray[Any]:
    """Give each fine voxel of a box the value of the voxel that it lies in."""
    z, y, x = (np.arange(part.start, part.stop) // factor for part in box)
    return values[np.ix_(z, y, x)]


def _meetings(
    domain: Bool, own: UInt32, labels: UInt8, box: Box, geometry: Geometry, is_joined: bool
) -> Iterator[Change]:
    """Let the pieces ``own`` in a connected domain grow into all of it, and measure the borders where they meet."""
    numbers = np.unique(own[domain & (own > 0)])[:MOST_PIECES]
    table = np.zeros(int(own.max()) + 1, np.uint8)
    table[numbers] = np.arange(1, len(numbers) + 1)
    side = np.where(domain, table[own], 0).astype(np.uint8)
    side, labels = _grown(domain, side, labels)
    is_wanted = ~np.eye(256, dtype=np.bool_)
    is_wanted[0] = is_wanted[:, 0] = False
    start = (box[2].start, box[1].start, box[0].start)
    faces = faces_between(side, geometry.cropped(start, side.shape[::-1]), is_wanted)
    for pair in np.unique(faces.pairs, axis=0):
        border = faces[(faces.pairs == pair).all(axis=1)]
        beside = []
        for step in (-0.5, 0.5):
            i, j, k = np.round(border.index + step * np.eye(3)[border.axis]).astype(np.int64).T
            beside.append(labels[k, j, i])
        sides = np.sort(np.stack(beside, axis=1), axis=1)
        found, counts = np.unique(sides, axis=0, return_counts=True)
        most = found[int(counts.argmax())]
        yield Change(is_joined, (int(most[0]), int(most[1])), border.extent())


def _grown(domain: Bool, side: UInt8, labels: UInt8) -> tuple[UInt8, UInt8]:
    """Give every voxel of a domain that has no side the side and the label of the nearest one, face by face."""
    domain, side, labels = np.pad(domain, 1), np.pad(side, 1), np.pad(labels, 1)
    steps = (-1, 1, -side.shape[2], side.shape[2], -side.shape[1] * side.shape[2], side.shape[1] * side.shape[2])
    flat, names = side.ravel(), labels.ravel()
    waiting = np.flatnonzero(domain.ravel() & (flat == 0))
    while len(waiting):
        taken = np.zeros(len(waiting), np.int64)
        for step in steps:
            taken = np.where((taken == 0) & (flat[waiting + step] > 0), waiting + step, taken)
        has = taken > 0
        if not has.any():
            break
        values, called = flat[taken[has]], names[taken[has]]
        flat[waiting[has]], names[waiting[has]] = values, called
        waiting = waiting[~has]
    inner = (slice(1, -1),) * 3
    return side[inner], labels[inner]
