"""Pieces: what a sheet leaves of the tissue in each cell, and which pieces still share which nodes.

Two samples beside each other hang together where both are tissue and the sheet does not cross their link. The pieces
of a cell are what hangs together in it. Around a node, two pieces share it if they hang together across the faces of
the cells around it: otherwise each has a node of its own (virtual nodes: Molino, Bao and Fedkiw, ACM Trans. Graph. 23,
2004).

Only the sheet parts. Tissue that lies in one cell, or in two that meet at a node, without hanging together was held
together by the lattice before; it stays so wherever the space between is not crossed.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from heartcase.schemas.arrays import Int32, Int64
from heartcase.schemas.bundle.lattice import CORNER_OFFSETS, lattice_keys
from heartcase.simulator.cutting.crossings import SAMPLES
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
from heartcase.simulator.cutting.samples import TissueSamples
from heartcase.simulator.lattice.model import LatticeModel

__all__ = ["Pieces", "find_pieces"]

_STRIDES = np.array([1, SAMPLES, SAMPLES**2])
_SHIFT = 1 << 20


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


def find_pieces(model: LatticeModel, tissue: TissueSamples, links: tuple[Int64, Int64, Int64]) -> Pieces:
    """Part the tissue of a lattice that was not cut.

    Parameters
    ----------
    model
        The lattice.
    tissue
        Its samples.
    links
        Links along x, y and z that are crossed, ascending (:func:`heartcase.simulator.cutting.sheet.crossed_links`).
    """
    block = _block(model, tissue, links)
    labels = Labels(
        np.full((len(block.keys), SAMPLE_COUNT), -1, np.int32),
        np.zeros(len(block.keys), np.int64),
        np.zeros((len(block.keys), SAMPLE_COUNT), np.int32),
        np.ones(len(block.keys), np.int64),
    )
    label_all(block.is_tissue, block.is_crossed, block.is_touched, *labels)
    copies = _shared_nodes(block, labels)
    has_cell = block.cell >= 0
    order = np.flatnonzero(has_cell)[np.argsort(block.cell[has_cell])]
    counts = labels.piece_count[order]
    first = np.cumsum(labels.piece_count) - labels.piece_count
    rows = np.repeat(first[order], counts) + np.arange(counts.sum()) - np.repeat(np.cumsum(counts) - counts, counts)
    return Pieces(block.cell[order], labels.piece[order], counts, copies[rows])


def _block(model: LatticeModel, tissue: TissueSamples, links: tuple[Int64, Int64, Int64]) -> Block:
    cell_keys = lattice_keys(model.cells)
    by_key = np.argsort(cell_keys, kind="stable")
    cell_keys = cell_keys[by_key]
    lower = [_unpacked(np.unique(keys)) for keys in links]
    places = np.concatenate([np.concatenate([one, one + np.eye(3, dtype=np.int64)[a]]) for a, one in enumerate(lower)])
    places //= SAMPLES
    touched = np.unique(lattice_keys(places))
    # Places without tissue count only beside tissue.
    around = np.stack(np.meshgrid(*[[-1, 0, 1]] * 3, indexing="ij"), axis=-1).reshape(-1, 3)
    near = np.unique(lattice_keys(_unpacked(touched)[:, None] + around))
    near = near[np.isin(near, cell_keys)]
    keys = np.unique(lattice_keys(_unpacked(near)[:, None] + around)) if len(near) else near
    keys = np.intersect1d(keys, np.unique(lattice_keys(_unpacked(touched)[:, None] + around)))
    found = np.minimum(np.searchsorted(cell_keys, keys), len(cell_keys) - 1)
    cell = np.where(cell_keys[found] == keys, by_key[found], -1)

    is_tissue = np.zeros((len(keys), SAMPLE_COUNT), np.bool_)
    here = np.flatnonzero(cell >= 0)
    is_tissue[here] = tissue.of_cells(model.cells[cell[here]], model.cell_moments[cell[here]])
    is_crossed = np.zeros((len(keys), 3, SAMPLE_COUNT), np.bool_)
    for axis, samples in enumerate(lower):
        place_keys = lattice_keys(samples // SAMPLES)
        place = np.minimum(np.searchsorted(keys, place_keys), max(len(keys) - 1, 0))
        kept = keys[place] == place_keys if len(keys) else np.zeros(len(samples), np.bool_)
        is_crossed[place[kept], axis, (samples[kept] % SAMPLES) @ _STRIDES] = True
    return Block(keys, cell, is_tissue, is_crossed, np.isin(keys, touched))


def _unpacked(keys: Int64) -> Int64:
    """Index (i, j, k) of each key, shape (count, 3)."""
    mask = (1 << 21) - 1
    return np.stack([keys & mask, keys >> 21 & mask, keys >> 42 & mask], axis=-1) - _SHIFT


def _shared_nodes(block: Block, labels: Labels) -> Int64:
    """Copy of its node at each corner of each piece, shape (piece_count, 8)."""
    first_piece = np.cumsum(labels.piece_count) - labels.piece_count
    first_space = np.cumsum(labels.space_count) - labels.space_count
    uses = np.arange(8 * labels.piece_count.sum())
    uses_before = np.arange(8 * len(block.keys))
    uses_space = np.arange(8 * labels.space_count.sum())
    indices = _unpacked(block.keys)
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
    candidates = np.unique(corner_keys[block.is_touched])
    place_of_piece = np.repeat(np.arange(len(block.keys)), labels.piece_count)
    use_keys = corner_keys[place_of_piece].ravel()
    order = np.argsort(use_keys, kind="stable")
    order = order[np.isin(use_keys[order], candidates)]
    sizes, space_of_piece = piece_sizes(labels, first_piece, int(labels.piece_count.sum()))
    piece, corner = order // 8, order % 8
    place = place_of_piece[piece]
    space = uses_space[8 * (first_space[place] + space_of_piece[piece]) + corner]
    starts = np.flatnonzero(np.diff(use_keys[order], prepend=-1))
    ends = np.append(starts[1:], len(order))
    copies = np.zeros(8 * labels.piece_count.sum(), np.int64)
    number_copies(order, starts, ends, uses, uses_before[8 * place + corner], space, sizes[piece], copies)
    return copies.reshape(-1, 8)
