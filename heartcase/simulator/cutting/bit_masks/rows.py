"""Pieces as cells of a cut lattice: their samples, and the copies of nodes at their corners: kernels."""

from __future__ import annotations

import numpy as np

from heartcase.compiling.kernel import kernel
from heartcase.simulator.cutting.bit_masks.sample_bits import ones

__all__ = ["cell_of", "copy_numbers", "is_as_before", "number_pieces", "set_of", "write_samples"]


@kernel(cached=False)
def set_of(around, stemmed, cell, piece):
    """Samples of one of a cell's pieces."""
    row = around.places[cell]
    return around.tissue[cell] if row < 0 else stemmed.pieces[stemmed.first[row] + piece]


@kernel(cached=False)
def cell_of(around, first, cell_count, cell, piece):
    """Number in the cut lattice of one of a cell's pieces: the first has that of its cell, the others follow all."""
    return around.cells[cell] if piece == 0 else cell_count + first[cell] - cell + piece - 1


@kernel
def is_as_before(around, stemmed, counts, known, known_stemmed, known_counts, of_known):
    """Whether the pieces of each cell are the same as before, shape (cell_count,)."""
    result = np.zeros(len(counts), np.bool_)
    for cell in range(len(counts)):
        before = of_known[cell]
        if before < 0 or counts[cell] != known_counts[before]:
            continue
        is_same = True
        if around.places[cell] >= 0:
            for piece in range(counts[cell]):
                one, other = set_of(around, stemmed, cell, piece), set_of(known, known_stemmed, before, piece)
                for k in range(8):
                    is_same &= one[k] == other[k]
        result[cell] = is_same
    return result


@kernel
def number_pieces(around, stemmed, corners, node_count):
    """Number pieces, and the copies of each node without gaps.

    Parameters
    ----------
    around, stemmed
        The cells, and pieces of those that are touched.
    corners
        Of all cells, shape (any, 8).
    node_count
        Nodes of the lattice.

    Returns
    -------
    tuple
        Pieces of each cell (count,), copies at the corners of each piece (piece_count, 8), and how many nodes each
        became (node_count,).
    """
    cell_count = len(around.cells)
    counts = np.empty(cell_count, np.int64)
    total = 0
    for cell in range(cell_count):
        row = around.places[cell]
        counts[cell] = 1 if row < 0 else stemmed.counts[row]
        total += counts[cell]
    copies = np.empty((total, 8), np.int64)
    piece, highest = 0, 0
    for cell in range(cell_count):
        row = around.places[cell]
        for number in range(counts[cell]):
            at = around.first[cell] if row < 0 else stemmed.first[row] + number
            for corner in range(8):
                copies[piece, corner] = around.copies[at, corner] if row < 0 else stemmed.copies[at, corner]
                highest = max(highest, copies[piece, corner])
            piece += 1
    # Bits of the copies of each node that are used.
    used, piece = np.zeros((highest // 32 + 1, node_count), np.int64), 0
    for cell in range(cell_count):
        for _ in range(counts[cell]):
            for corner in range(8):
                copy = copies[piece, corner]
                used[copy // 32, corners[around.cells[cell], corner]] |= 1 << copy % 32
            piece += 1
    piece = 0
    for cell in range(cell_count):
        for _ in range(counts[cell]):
            for corner in range(8):
                node, copy, rank = corners[around.cells[cell], corner], copies[piece, corner], 0
                for word in range(copy // 32):
                    rank += ones(used[word, node])
                rank += ones(used[copy // 32, node] & ((1 << copy % 32) - 1))
                copies[piece, corner] = rank
            piece += 1
    node_copies = np.ones(node_count, np.int32)
    for cell in around.cells:
        for corner in range(8):
            node, number = corners[cell, corner], 0
            for word in range(len(used)):
                number += ones(used[word, node])
            node_copies[node] = number
    return counts, copies, node_copies


@kernel
def copy_numbers(node_copies):
    """Number of the first further copy of each node, and the node of each further copy."""
    node_count = len(node_copies)
    numbers, total = np.empty(node_count, np.int64), 0
    for node in range(node_count):
        numbers[node] = node_count + total
        total += node_copies[node] - 1
    origins, at = np.empty(total, np.int32), 0
    for node in range(node_count):
        for _ in range(node_copies[node] - 1):
            origins[at] = node
            at += 1
    return numbers, origins


@kernel
def write_samples(around, stemmed, counts, is_same, of_known, known_samples, samples):
    """Write the piece of each sample of all cells, or -1 where there is no tissue; shape (count, SAMPLES^3)."""
    for cell in range(len(counts)):
        if is_same[cell]:
            samples[cell] = known_samples[of_known[cell]]
            continue
        samples[cell] = -1
        for piece in range(counts[cell]):
            found = set_of(around, stemmed, cell, piece)
            for sample in range(512):
                if found[sample // 64] >> (sample % 64) & 1:
                    samples[cell, sample] = piece
