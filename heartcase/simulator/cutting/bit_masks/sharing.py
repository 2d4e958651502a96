"""Which pieces share which nodes, node by node, and the stems' part in it: kernels."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from heartcase.compiling.kernel import kernel
from heartcase.schemas.arrays import Int32, Int64
from heartcase.simulator.cutting.bit_masks.sample_bits import count, first_sample, is_any, meets_across
from heartcase.simulator.cutting.bit_masks.touched import next_places
from heartcase.simulator.lattice.disjoint_sets import join_two, root_of

__all__ = ["Around", "Stemmed", "share_nodes", "with_stems"]


class Around(NamedTuple):
    """Cells at the places that are touched, and at those beside them."""

    cells: Int64
    """Ascending, shape (count,)."""
    tissue: Int64
    """Samples of each, shape (count, 8)."""
    places: Int64
    """Row of each among the places that are touched, or -1, shape (count,)."""
    first: Int64
    """First of each in ``copies``, and the last end, shape (count + 1,)."""
    copies: Int32
    """Copy of its node at each corner of each piece, as they were numbered without stems, shape (any, 8)."""


class Stemmed(NamedTuple):
    """Pieces with stems."""

    first: Int64
    """First of each touched place's pieces, of which there is room for one more than without stems, (count,)."""
    counts: Int64
    """How many it has, shape (count,)."""
    pieces: Int64
    """Sets of tissue, shape (any, 8)."""
    copies: Int32
    """Copy of its node at each corner of each, shape (any, 8)."""


@kernel(cached=False)
def _join_around(places, around, rows, cells, first, first_space, uses, before, spaces):
    """Join what hangs together of the pieces, places and parts of space at the eight places around a node."""
    nothing, everything = np.zeros(8, np.int64), np.full(8, -1, np.int64)
    for slot in range(8):
        row = rows[slot]
        for axis in range(3):
            if slot >> axis & 1:
                continue
            there = slot | 1 << axis
            other = rows[there]
            closed = nothing if row < 0 else places.closed[row, axis]
            has_both = cells[slot] >= 0 and cells[there] >= 0
            if has_both and meets_across(around.tissue[cells[slot]], around.tissue[cells[there]], nothing, axis):
                join_two(before, slot, there)
                for a in range(first[slot], first[slot + 1]):
                    one = around.tissue[cells[slot]]
                    if row >= 0:
                        one = places.pieces[places.first_piece[row] + a - first[slot]]
                    for b in range(first[there], first[there + 1]):
                        two = around.tissue[cells[there]]
                        if other >= 0:
                            two = places.pieces[places.first_piece[other] + b - first[there]]
                        if meets_across(one, two, closed, axis):
                            join_two(uses, a, b)
            for a in range(first_space[slot], first_space[slot + 1]):
                one = everything if row < 0 else places.spaces[places.first_space[row] + a - first_space[slot]]
                for b in range(first_space[there], first_space[there + 1]):
                    two = everything
                    if other >= 0:
                        two = places.spaces[places.first_space[other] + b - first_space[there]]
                    if meets_across(one, two, closed, axis):
                        join_two(spaces, a, b)


@kernel(cached=False)
def _space_of(places, row, first_space, piece):
    """Part of space that the first sample of a piece lies in."""
    if row < 0:
        return first_space
    sample = first_sample(piece)
    start = places.first_space[row]
    for number in range(start, places.first_space[row + 1]):
        if places.spaces[number, sample // 64] >> (sample % 64) & 1:
            return first_space + number - start
    return first_space


@kernel(cached=False)
def _number(uses, before, space, sizes, copies):
    """Number the copies that the uses of a node need.

    In each part of space, what never hung together with the largest is held by it: of what hung together before, the
    largest that is left alone.
    """
    number = len(uses)
    total, main, own = np.zeros(number, np.int64), np.empty(number, np.int64), np.empty(number, np.int64)
    for a in range(number):
        for c in range(number):
            if uses[c] == uses[a]:
                total[a] += sizes[c]
    for a in range(number):
        main[a] = own[a] = -1
        for b in range(number):
            if space[b] != space[a]:
                continue
            if main[a] < 0 or total[b] > total[main[a]]:
                main[a] = b
            if before[b] == before[a] and (own[a] < 0 or total[b] > total[own[a]]):
                own[a] = b
    set_of = uses.copy()
    for a in range(number):
        if before[main[a]] == before[a] or set_of[own[a]] != set_of[a]:
            continue
        low, high = min(uses[main[a]], uses[a]), max(uses[main[a]], uses[a])
        for c in range(number):
            if uses[c] == high:
                uses[c] = low
    highest = 0
    for a in range(number):
        copies[a] = -1
        for b in range(a):
            if uses[b] == uses[a]:
                copies[a] = copies[b]
                break
        if copies[a] < 0:
            copies[a] = highest
            highest += 1


@kernel
def share_nodes(places, known, of_known, is_changed, around, near, near_rows, near_cells):
    """Copies at the corners of pieces; at nodes of no place that changed they are taken over.

    Parameters
    ----------
    places
        All that are touched (:class:`heartcase.simulator.cutting.bit_masks.labelling.Places`).
    known, of_known
        Cells around them before (:class:`Around`), and the row among these of each cell now, or -1, shape (count,).
    is_changed
        Whether a place changed, shape (place_count,).
    around
        The cells now; of ``first`` and ``copies`` nothing is asked.
    near
        Keys of the places that changed and of all around them, ascending, shape (near_count,).
    near_rows, near_cells
        Row of each among the places that are touched, and among the cells; or -1; the same.

    Returns
    -------
    tuple
        ``first`` and ``copies`` of :class:`Around`.
    """
    cell_count = len(around.cells)
    first_piece = np.zeros(cell_count + 1, np.int64)
    for cell in range(cell_count):
        row = around.places[cell]
        pieces = 1 if row < 0 else places.first_piece[row + 1] - places.first_piece[row]
        first_piece[cell + 1] = first_piece[cell] + pieces
    copies = np.zeros((first_piece[cell_count], 8), np.int32)
    for cell in range(cell_count):
        row, before = around.places[cell], of_known[cell]
        if before >= 0 and not (row >= 0 and is_changed[row]):
            start = known.first[before]
            for number in range(first_piece[cell], first_piece[cell + 1]):
                copies[number] = known.copies[start + number - first_piece[cell]]

    there = next_places(near)
    at, rows, cells = np.empty(8, np.int64), np.empty(8, np.int64), np.empty(8, np.int64)
    first, first_space = np.zeros(9, np.int64), np.zeros(9, np.int64)
    for base in range(len(near)):
        # A node that is a corner of a place that changed has all places around it among those near.
        at[0] = base
        is_whole = True
        for slot in range(1, 8):
            axis = 2 if slot >= 4 else 1 if slot >= 2 else 0
            at[slot] = there[at[slot ^ 1 << axis], axis]
            if at[slot] < 0:
                is_whole = False
                break
        if not is_whole:
            continue
        has_changed, has_tissue = False, False
        for slot in range(8):
            row, cell = near_rows[at[slot]], near_cells[at[slot]]
            rows[slot], cells[slot] = row, cell
            has_changed |= row >= 0 and is_changed[row]
            has_tissue |= cell >= 0
            pieces, spaces = 1 if cell >= 0 else 0, 1
            if row >= 0:
                pieces = places.first_piece[row + 1] - places.first_piece[row]
                spaces = places.first_space[row + 1] - places.first_space[row]
            first[slot + 1], first_space[slot + 1] = first[slot] + pieces, first_space[slot] + spaces
        if not (has_changed and has_tissue):
            continue
        uses, before, joined = np.arange(first[8]), np.arange(8), np.arange(first_space[8])
        _join_around(places, around, rows, cells, first, first_space, uses, before, joined)
        sets, held = np.empty(first[8], np.int64), np.empty(first[8], np.int64)
        space, sizes = np.empty(first[8], np.int64), np.empty(first[8], np.int64)
        for slot in range(8):
            for use in range(first[slot], first[slot + 1]):
                piece = around.tissue[cells[slot]]
                if rows[slot] >= 0:
                    piece = places.pieces[places.first_piece[rows[slot]] + use - first[slot]]
                sets[use], held[use] = root_of(uses, use), root_of(before, slot)
                sizes[use] = count(piece)
                space[use] = root_of(joined, _space_of(places, rows[slot], first_space[slot], piece))
        numbers = np.empty(first[8], np.int64)
        _number(sets, held, space, sizes, numbers)
        for slot in range(8):
            for use in range(first[slot], first[slot + 1]):
                copies[first_piece[cells[slot]] + use - first[slot], 7 ^ slot] = numbers[use]
    return first_piece, copies


@kernel(cached=False)
def _give(stemmed, place, stem, at_corners, tissue, nearest, takes_sides):
    """Give a place's tissue to a stem, with given copies at its corners or those of the sides that they lie on."""
    start, number = stemmed.first[place], stemmed.counts[place]
    if takes_sides:
        for corner in range(8):
            sample = 0
            for rank in range(512):
                sample = nearest[corner, rank]
                if tissue[sample // 64] >> (sample % 64) & 1:
                    break
            for piece in range(start, start + number):
                if stemmed.pieces[piece, sample // 64] >> (sample % 64) & 1:
                    at_corners[corner] = stemmed.copies[piece, corner]
    kept = start
    for piece in range(start, start + number):
        for k in range(8):
            stemmed.pieces[piece, k] &= ~stem[k]
        if is_any(stemmed.pieces[piece]):
            stemmed.pieces[kept] = stemmed.pieces[piece]
            stemmed.copies[kept] = stemmed.copies[piece]
            kept += 1
    stemmed.pieces[kept] = stem
    stemmed.copies[kept] = at_corners
    stemmed.counts[place] = kept + 1 - start


@kernel
def with_stems(places, around, next_place, nearest):
    """Pieces of the places that are touched, and copies at their corners, with stems (:class:`Stemmed`).

    Parameters
    ----------
    places, around
        All, and the cells around.
    next_place
        The next place along each axis among all, or -1, shape (count, 3).
    nearest
        Samples of a cell from each corner on, shape (8, SAMPLES^3).
    """
    place_count = len(places.keys)
    first, counts = np.empty(place_count, np.int64), np.empty(place_count, np.int64)
    total = 0
    for place in range(place_count):
        first[place], counts[place] = total, places.first_piece[place + 1] - places.first_piece[place]
        total += counts[place] + 1
    stemmed = Stemmed(first, counts, np.empty((total, 8), np.int64), np.empty((total, 8), np.int32))
    for place in range(place_count):
        for piece in range(counts[place]):
            stemmed.pieces[first[place] + piece] = places.pieces[places.first_piece[place] + piece]
            stemmed.copies[first[place] + piece] = around.copies[around.first[places.cells[place]] + piece]
    at_corners = np.empty(8, np.int32)
    for place in range(place_count):
        if is_any(places.stems[place, 0]):
            tissue = around.tissue[places.cells[place]]
            _give(stemmed, place, places.stems[place, 0], at_corners, tissue, nearest, True)
    # Where a sheet ends on the face between two cells, tissue of the further one holds on to the nearer.
    for axis in range(3):
        for place in range(place_count):
            stem, there = places.stems[place, 1 + axis], next_place[place, axis]
            if there < 0 or stemmed.counts[there] != 1 or not is_any(stem):
                continue
            for corner in range(8):
                is_near = corner >> axis & 1 == 0
                nearer = stemmed.copies[first[place], corner | 1 << axis]
                at_corners[corner] = nearer if is_near else stemmed.copies[first[there], corner]
            _give(stemmed, there, stem, at_corners, stem, nearest, False)
    return stemmed
