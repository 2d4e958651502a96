"""What the samples of touched places hang together in, and which tissue a sheet's continuation gives away: kernels."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from heartcase.compiling.kernel import kernel
from heartcase.schemas.arrays import Int64
from heartcase.simulator.cutting.bit_masks.sample_bits import (
    NOT_LAST_COLUMN,
    NOT_LAST_ROW,
    components,
    count,
    first_sample,
    is_on_last,
    lowest,
)

__all__ = ["Places", "find_stems", "label_places"]


class Places(NamedTuple):
    """Places of cells that a crossed link begins or ends in, by their keys; sets of samples as bits."""

    keys: Int64
    """Ascending, shape (count,)."""
    cells: Int64
    """Row of each among the cells around, -1 where there is no cell, shape (count,)."""
    crossed: Int64
    """Links from samples along each axis that sheets cross, shape (count, 3, 8)."""
    beyond: Int64
    """Those that their continuations cross, the same."""
    closed: Int64
    """Those that do not hold: crossed by either, where it counts, the same."""
    first_piece: Int64
    """First of each in ``pieces``, and the last end, shape (count + 1,)."""
    pieces: Int64
    """Sets of tissue, without stems, shape (any, 8)."""
    first_space: Int64
    """The same of ``spaces``."""
    spaces: Int64
    """Parts of space, shape (any, 8)."""
    stems: Int64
    """Tissue that goes to a stem: of the place's own, and of the next place along each axis, shape (count, 4, 8)."""


@kernel(cached=False)
def close(crossed, beyond, closed):
    """Write the links of a place that do not hold; between two cells a continuation counts where the sheet came to."""
    for axis in range(3):
        is_kept = is_on_last(crossed[axis], axis)
        for k in range(8):
            further = beyond[axis, k] & ~crossed[axis, k]
            if not is_kept:
                further &= NOT_LAST_COLUMN if axis == 0 else NOT_LAST_ROW if axis == 1 else (-1 if k < 7 else 0)
            closed[axis, k] = crossed[axis, k] | further


@kernel(cached=False)
def _with_room(rows, used):
    """The same rows with room for 512 more."""
    if used + 512 <= len(rows):
        return rows
    larger = np.empty((2 * len(rows) + 512, 8), np.int64)
    larger[:used] = rows[:used]
    return larger


@kernel(cached=False)
def _holding(sets, wholes, spaces, set_count, whole_count, space_count, holder):
    """Let each set of a place's tissue know the one that it is held by, or itself.

    In each part of space, what never hung together with the largest piece is held by it: of what hung together before,
    the largest that is left alone, or it would hold together again what was parted.
    """
    size = np.empty(set_count, np.int64)
    whole, space = np.empty(set_count, np.int64), np.empty(set_count, np.int64)
    for number in range(set_count):
        first = first_sample(sets[number])
        size[number], holder[number] = count(sets[number]), number
        for other in range(whole_count):
            if wholes[other, first // 64] >> (first % 64) & 1:
                whole[number] = other
        for other in range(space_count):
            if spaces[other, first // 64] >> (first % 64) & 1:
                space[number] = other
    for number in range(set_count):
        main, is_largest = number, True
        for other in range(set_count):
            if space[other] != space[number]:
                continue
            if size[other] > size[main] or (size[other] == size[main] and other < main):
                main = other
            if whole[other] == whole[number] and (
                size[other] > size[number] or (size[other] == size[number] and other < number)
            ):
                is_largest = False
        if whole[main] == whole[number] or not is_largest:
            continue
        one, other = main, number
        while holder[one] != one:
            one = holder[one]
        while holder[other] != other:
            other = holder[other]
        holder[max(one, other)] = min(one, other)


@kernel
def label_places(known, of_known, is_changed, tissue, crossed, beyond, cells):
    """What hangs together in places; of those that did not change it is taken over.

    Parameters
    ----------
    known
        Places before (:class:`Places`).
    of_known
        Place among these of each, or -1, shape (count,).
    is_changed
        Whether a link was crossed in or to it, shape (count,).
    tissue
        Of the cells around, shape (cell_count, 8).
    crossed, beyond, cells
        As of :class:`Places`.

    Returns
    -------
    tuple
        ``closed``, ``first_piece``, ``pieces``, ``first_space`` and ``spaces`` of :class:`Places`.
    """
    place_count = len(of_known)
    closed = np.empty((place_count, 3, 8), np.int64)
    first_piece, first_space = np.zeros(place_count + 1, np.int64), np.zeros(place_count + 1, np.int64)
    pieces = np.empty((len(known.pieces) + 8 * place_count + 512, 8), np.int64)
    spaces = np.empty((len(known.spaces) + 8 * place_count + 512, 8), np.int64)
    wholes, sets, links = np.empty((512, 8), np.int64), np.empty((512, 8), np.int64), np.empty((3, 8), np.int64)
    holder, everything = np.empty(512, np.int64), np.full(8, -1, np.int64)
    piece, space = 0, 0
    for place in range(place_count):
        pieces, spaces = _with_room(pieces, piece), _with_room(spaces, space)
        if not is_changed[place]:
            before = of_known[place]
            closed[place] = known.closed[before]
            for number in range(known.first_piece[before], known.first_piece[before + 1]):
                pieces[piece] = known.pieces[number]
                piece += 1
            for number in range(known.first_space[before], known.first_space[before + 1]):
                spaces[space] = known.spaces[number]
                space += 1
        else:
            close(crossed[place], beyond[place], closed[place])
            space_count = components(everything, links, closed[place], True, spaces[space : space + 512])
            if cells[place] >= 0:
                own = tissue[cells[place]]
                whole_count = components(own, links, closed[place], False, wholes)
                set_count = components(own, links, closed[place], True, sets)
                _holding(sets, wholes, spaces[space:], set_count, whole_count, space_count, holder)
                start = piece
                for number in range(set_count):
                    root = number
                    while holder[root] != root:
                        root = holder[root]
                    if root == number:
                        pieces[piece] = sets[number]
                        # Where those that join it find it.
                        wholes[number, 0] = piece
                        piece += 1
                    else:
                        pieces[wholes[root, 0]] |= sets[number]
                assert piece > start
            space += space_count
        first_piece[place + 1], first_space[place + 1] = piece, space
    return closed, first_piece, pieces[:piece].copy(), first_space, spaces[:space].copy()


@kernel(cached=False)
def _write_away(links, only_axis, is_on_face, shift, squares):
    """Write the least square of the distance from each sample to the middles of some links, in 16ths of an edge."""
    squares[:] = 1 << 20
    along_x = np.empty(8, np.int32)
    for axis in range(3):
        if only_axis >= 0 and axis != only_axis:
            continue
        for k in range(8):
            left = links[axis, k]
            if is_on_face:
                if axis == 2 and k < 7:
                    continue
                left &= ~NOT_LAST_COLUMN if axis == 0 else ~NOT_LAST_ROW if axis == 1 else -1
            while left != 0:
                at = lowest(left)
                left &= left - 1
                x, y, z = 2 * (at % 8) - 7, 2 * (at // 8) - 7, 2 * k - 7
                if axis == 0:
                    x += 1 - shift
                elif axis == 1:
                    y += 1 - shift
                else:
                    z += 1 - shift
                for i in range(8):
                    along_x[i] = np.int32((2 * i - 7 - x) ** 2)
                for row in range(64):
                    rest = np.int32((2 * (row % 8) - 7 - y) ** 2 + (2 * (row // 8) - 7 - z) ** 2)
                    line = squares[8 * row : 8 * row + 8]
                    for i in range(8):
                        line[i] = min(line[i], np.int32(along_x[i] + rest))


@kernel(cached=False)
def _nearer(tissue, from_stem, from_cut, stem):
    """Write which tissue is nearer to one than to the other."""
    for k in range(8):
        bits = np.int64(0)
        for at in range(64):
            bits |= np.int64(from_stem[64 * k + at] < from_cut[64 * k + at]) << at
        stem[k] = bits & tissue[k]


@kernel
def find_stems(known, of_known, is_changed, tissue, crossed, closed, cells, first_piece, next_place):
    """Tissue that goes to stems, as of :class:`Places`; of places that did not change it is taken over.

    ``next_place`` has the next place along each axis among all, or -1; the rest is as of :func:`label_places`.
    """
    stems = np.zeros((len(of_known), 4, 8), np.int64)
    from_cut, from_stem = np.empty(512, np.int32), np.empty(512, np.int32)
    at_stem = np.empty((3, 8), np.int64)
    for place in range(len(of_known)):
        if not is_changed[place]:
            stems[place] = known.stems[of_known[place]]
            continue
        piece_count = first_piece[place + 1] - first_piece[place]
        if piece_count == 0:
            continue
        is_inside = False
        for axis in range(3):
            for k in range(8):
                at_stem[axis, k] = closed[place, axis, k] & ~crossed[place, axis, k]
                inner = NOT_LAST_COLUMN if axis == 0 else NOT_LAST_ROW if axis == 1 else (-1 if k < 7 else 0)
                is_inside |= at_stem[axis, k] & inner != 0
        if piece_count > 1:
            if is_inside:
                _write_away(crossed[place], -1, False, 0, from_cut)
                _write_away(at_stem, -1, False, 0, from_stem)
                _nearer(tissue[cells[place]], from_stem, from_cut, stems[place, 0])
            continue
        for axis in range(3):
            there = next_place[place, axis]
            if there < 0 or cells[there] < 0 or not is_on_last(at_stem[axis], axis):
                continue
            _write_away(crossed[place], axis, True, 16, from_cut)
            _write_away(at_stem, axis, True, 16, from_stem)
            _nearer(tissue[cells[there]], from_stem, from_cut, stems[place, 1 + axis])
    return stems
