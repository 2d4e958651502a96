"""Pieces: what a sheet leaves of the tissue in each cell, and which pieces still share which nodes.

Two samples beside each other hang together where both are tissue and the sheet does not cross their link. The pieces
of a cell are what hangs together in it. Around a node, two pieces share it if they hang together across the faces of
the cells around it: otherwise each has a node of its own (virtual nodes: Molino, Bao and Fedkiw, ACM Trans. Graph. 23,
2004).

Where a sheet ends inside a cell, its continuation says which tissue of the cell lies on which side. What lies beside
the sheet goes with its side; what lies beside the continuation is a cell of its own that joins both sides, the stem. So
a cut that goes a little further opens a little more. (A cell that stays whole until the sheet has left it is up to two
fifths too stiff in a bar cut half through, of six cells.)

Only the sheet parts. Tissue that lies in one cell, or in two that meet at a node, without hanging together was held
together by the lattice before. It stays so wherever the space between is not crossed, with one alone of the pieces that
a sheet has parted.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from heartcase.schemas.arrays import Bool, Float64, Int32, Int64
from heartcase.schemas.bundle.lattice import CORNER_OFFSETS, distinct_keys, lattice_keys
from heartcase.simulator.cutting.blade_sheet import Links, key_indices, touched_places
from heartcase.simulator.cutting.crossings import SAMPLES
from heartcase.simulator.cutting.parting_kernels import nearest_of_each
from heartcase.simulator.cutting.piece_kernels import (
    SAMPLE_COUNT,
    Block,
    Labels,
    flatten,
    join_across_faces,
    label_all,
    number_copies,
    piece_sizes,
)
from heartcase.simulator.cutting.tissue_samples import SAMPLE_PLACES, TissueSamples
from heartcase.simulator.lattice.model import LatticeModel

__all__ = ["Pieces", "find_pieces"]

_STRIDES = np.array([1, SAMPLES, SAMPLES**2])
_LINK_PLACES: Float64 = SAMPLE_PLACES + np.eye(3)[:, None] / 2 / SAMPLES
"""Middles of the links from each sample of a cell along each axis, from its centre, shape (3, SAMPLES^3, 3)."""
_NO_LINKS: Links = (np.zeros(0, np.int64), np.zeros(0, np.int64), np.zeros(0, np.int64))


@dataclass(frozen=True)
class Pieces:
    """The pieces of the cells around a sheet."""

    cells: Int64
    """Cells that were looked at, ascending, shape (count,)."""
    samples: Int32
    """Piece of each sample of these, from 0 in each cell, -1 where there is no tissue, shape (count, SAMPLES^3)."""
    counts: Int64
    """Pieces in each, shape (count,)."""
    copies: Int64
    """Number of the copy of each corner's node that a piece has, 0 for the node itself, shape (piece_count, 8)."""

    @property
    def first(self) -> Int64:
        """First piece of each cell in ``copies``, shape (count,)."""
        return np.cumsum(self.counts) - self.counts


def find_pieces(model: LatticeModel, tissue: TissueSamples, links: Links, beyond: Links = _NO_LINKS) -> Pieces:
    """Part the tissue of a lattice that was not cut.

    Parameters
    ----------
    model
        The lattice.
    tissue
        Its samples.
    links
        Links along x, y and z that are crossed, ascending
        (:func:`heartcase.simulator.cutting.blade_sheet.crossed_links`).
    beyond
        Links that their continuations cross in the cells that each sheet comes to.
    """
    block, is_beyond = _block(model, tissue, links, beyond)
    is_cut = block.is_crossed.copy()
    block.is_crossed[:] |= is_beyond
    labels = Labels(
        np.full((len(block.keys), SAMPLE_COUNT), -1, np.int32),
        np.zeros(len(block.keys), np.int64),
        np.zeros((len(block.keys), SAMPLE_COUNT), np.int32),
        np.ones(len(block.keys), np.int64),
    )
    label_all(block.is_tissue, block.is_crossed, block.is_touched, *labels)
    copies = _shared_nodes(block, labels)
    copies = _with_stems(block, labels, is_cut, is_beyond, copies)
    has_cell = block.cell >= 0
    order = np.flatnonzero(has_cell)[np.argsort(block.cell[has_cell])]
    counts = labels.piece_count[order]
    first = np.cumsum(labels.piece_count) - labels.piece_count
    rows = np.repeat(first[order], counts) + np.arange(counts.sum()) - np.repeat(np.cumsum(counts) - counts, counts)
    corners = model.cell_corners[np.repeat(block.cell[order], counts)].astype(np.int64)
    return Pieces(block.cell[order], labels.piece[order], counts, _renumbered(corners, copies[rows]))


def _block(model: LatticeModel, tissue: TissueSamples, links: Links, beyond: Links) -> tuple[Block, Bool]:
    """The places around a sheet, and where its continuation counts, shape (count, 3, SAMPLES^3)."""
    cell_keys, by_key = model.cells_in_order
    touched = touched_places(links)
    # Places without tissue count only beside tissue.
    around = np.stack(np.meshgrid(*[[-1, 0, 1]] * 3, indexing="ij"), axis=-1).reshape(-1, 3)
    beside = distinct_keys(lattice_keys(key_indices(touched)[:, None] + around))
    found = np.minimum(np.searchsorted(cell_keys, beside), len(cell_keys) - 1)
    has_cell = cell_keys[found] == beside
    near = distinct_keys(lattice_keys(key_indices(beside[has_cell])[:, None] + around))
    kept = _is_among(beside, near)
    keys, cell = beside[kept], np.where(has_cell, by_key[found], -1)[kept]

    is_tissue = np.zeros((len(keys), SAMPLE_COUNT), np.bool_)
    here = np.flatnonzero(cell >= 0)
    is_tissue[here] = tissue.of_cells(model.cells[cell[here]], model.cell_moments[cell[here]])
    block = Block(keys, cell, is_tissue, _marked(keys, links), _is_among(keys, touched))
    is_beyond = _marked(keys, beyond) & ~block.is_crossed & block.is_touched[:, None, None]
    for axis in range(3):
        # Between two cells it counts where the sheet has come to.
        on_face = np.arange(SAMPLE_COUNT) // _STRIDES[axis] % SAMPLES == SAMPLES - 1
        next_keys = lattice_keys(key_indices(keys) + np.eye(3, dtype=np.int64)[axis])
        is_kept = block.is_crossed[:, axis, on_face].any(axis=1) & _is_among(next_keys, touched)
        is_beyond[np.ix_(~is_kept, np.array([axis]), on_face)] = False
    return block, is_beyond


def _is_among(keys: Int64, listed: Int64) -> Bool:
    """Which keys are listed, in ascending order."""
    if not len(listed):
        return np.zeros(len(keys), np.bool_)
    among: Bool = listed[np.minimum(np.searchsorted(listed, keys), len(listed) - 1)] == keys
    return among


def _marked(keys: Int64, links: Links) -> Bool:
    """Links from each sample of some places that are listed, shape (count, 3, SAMPLES^3)."""
    marks = np.zeros((len(keys), 3, SAMPLE_COUNT), np.bool_)
    for axis, listed in enumerate(links if len(keys) else ()):
        samples = key_indices(listed)
        place_keys = lattice_keys(samples // SAMPLES)
        place = np.minimum(np.searchsorted(keys, place_keys), len(keys) - 1)
        kept = keys[place] == place_keys
        marks[place[kept], axis, (samples[kept] % SAMPLES) @ _STRIDES] = True
    return marks


def _with_stems(block: Block, labels: Labels, is_cut: Bool, is_beyond: Bool, copies: Int64) -> Int64:
    """Give tissue beside a sheet's continuation a piece of its own; its corners are those of the sides they lie on.

    Pieces and counts of the labels are changed; the copies of all pieces' corners are returned.
    """
    end = np.cumsum(labels.piece_count)
    first = end - labels.piece_count
    changed: dict[int, Int64] = {}

    def rows_of(place: int) -> Int64:
        return changed.get(place, copies[first[place] : end[place]])

    was_whole = labels.piece_count == 1
    on_face = [np.arange(SAMPLE_COUNT) // stride % SAMPLES == SAMPLES - 1 for stride in _STRIDES]
    inside = ~np.array(on_face)
    is_parted = (labels.piece_count > 1) & (is_beyond & inside).any(axis=(1, 2))
    for place in map(int, np.flatnonzero(is_parted)):
        at_cut = _places_of(is_cut[place])
        at_stem = _places_of(is_beyond[place])
        changed[place] = _with_stem(labels, place, at_cut, at_stem, rows_of(place), None)
    # Where a sheet ends on the face between two cells, tissue of the further one holds on to the nearer.
    for axis in range(3):
        next_keys = lattice_keys(key_indices(block.keys) + np.eye(3, dtype=np.int64)[axis])
        for place in map(int, np.flatnonzero(is_beyond[:, axis, on_face[axis]].any(axis=1) & was_whole)):
            there = int(np.searchsorted(block.keys, next_keys[place]))
            if labels.piece_count[there] != 1:
                continue
            on = np.zeros((3, SAMPLE_COUNT), np.bool_)
            on[axis] = on_face[axis]
            shift = np.eye(3)[axis]
            at_cut, at_stem = (_places_of(marks[place] & on) - shift for marks in (is_cut, is_beyond))
            corners = np.arange(8)
            near = corners >> axis & 1 == 0
            stem = np.where(near, rows_of(place)[0][corners | 1 << axis], rows_of(there)[0])
            changed[there] = _with_stem(labels, there, at_cut, at_stem, rows_of(there), stem)
    parts, done = [], 0
    for place in sorted(changed):
        parts += [copies[done : first[place]], changed[place]]
        done = end[place]
    return np.concatenate([*parts, copies[done:]])


def _places_of(marks: Bool) -> Float64:
    """Middles of a cell's links that are marked, from its centre, shape (count, 3)."""
    return np.concatenate([_LINK_PLACES[axis][marks[axis]] for axis in range(3)])


def _with_stem(labels: Labels, place: int, at_cut: Float64, at_stem: Float64, rows: Int64, stem: Int64 | None) -> Int64:
    """Split the stem, with given copies at its corners or those of the sides they lie on, from a cell's pieces."""
    piece = labels.piece[place]
    tissue = piece >= 0
    away_from_cut, away_from_stem = np.empty((2, SAMPLE_COUNT))
    nearest_of_each(SAMPLE_PLACES, at_cut, away_from_cut)
    nearest_of_each(SAMPLE_PLACES, at_stem, away_from_stem)
    is_stem = tissue & (away_from_stem < away_from_cut)
    if not is_stem.any():
        return rows
    if stem is None:
        away = ((CORNER_OFFSETS - 0.5)[:, None] - SAMPLE_PLACES) ** 2
        side = piece[np.where(tissue, away.sum(axis=2), np.inf).argmin(axis=1)]
        stem = rows[side, np.arange(8)]
    kept = np.unique(piece[tissue & ~is_stem])
    number = np.full(len(rows), -1)
    number[kept] = np.arange(len(kept))
    labels.piece[place] = np.where(is_stem, len(kept), number[piece])
    labels.piece[place][~tissue] = -1
    labels.piece_count[place] = len(kept) + 1
    return np.concatenate([rows[kept], stem[None]])


def _renumbered(corners: Int64, copies: Int64) -> Int64:
    """Copies of each node numbered without gaps, where some are not used any more."""
    most = int(copies.max(initial=0)) + 1
    used, number = np.unique(corners * most + copies, return_inverse=True)
    node = used // most
    without_gaps: Int64 = (np.arange(len(used)) - np.searchsorted(node, node))[number.reshape(copies.shape)]
    return without_gaps


def _shared_nodes(block: Block, labels: Labels) -> Int64:
    """Copy of its node at each corner of each piece, shape (piece_count, 8)."""
    first_piece = np.cumsum(labels.piece_count) - labels.piece_count
    first_space = np.cumsum(labels.space_count) - labels.space_count
    uses = np.arange(8 * labels.piece_count.sum())
    uses_before = np.arange(8 * len(block.keys))
    uses_space = np.arange(8 * labels.space_count.sum())
    indices = key_indices(block.keys)
    for axis in range(3):
        next_keys = lattice_keys(indices + np.eye(3, dtype=np.int64)[axis])
        found = np.minimum(np.searchsorted(block.keys, next_keys), len(block.keys) - 1)
        here = np.flatnonzero(block.keys[found] == next_keys)
        pairs = np.stack([here, found[here]], axis=1)
        join_across_faces(pairs, axis, block, labels, first_piece, first_space, uses, uses_before, uses_space)
    for parents in (uses, uses_before, uses_space):
        flatten(parents)

    # Corners of cells that were touched, node by node; only there may nodes be copied.
    corner_keys = lattice_keys(indices[:, None, :] + CORNER_OFFSETS)
    candidates = distinct_keys(corner_keys[block.is_touched])
    place_of_piece = np.repeat(np.arange(len(block.keys)), labels.piece_count)
    use_keys = corner_keys[place_of_piece].ravel()
    order = np.argsort(use_keys, kind="stable")
    order = order[_is_among(use_keys[order], candidates)]
    sizes, space_of_piece = piece_sizes(labels, first_piece, int(labels.piece_count.sum()))
    piece, corner = order // 8, order % 8
    place = place_of_piece[piece]
    space = uses_space[8 * (first_space[place] + space_of_piece[piece]) + corner]
    starts = np.flatnonzero(np.diff(use_keys[order], prepend=-1))
    ends = np.append(starts[1:], len(order))
    copies = np.zeros(8 * labels.piece_count.sum(), np.int64)
    number_copies(order, starts, ends, uses, uses_before[8 * place + corner], space, sizes[piece], copies)
    return copies.reshape(-1, 8)
