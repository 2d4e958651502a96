"""Sets of samples and corners that hang together: kernels of :mod:`heartcase.simulator.cutting.pieces`."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from heartcase.compiling.kernel import kernel
from heartcase.schemas.arrays import Bool, Int32, Int64
from heartcase.simulator.cutting.crossings import SAMPLES
from heartcase.simulator.lattice.disjoint_sets import join_two, root_of

__all__ = [
    "SAMPLE_COUNT",
    "Block",
    "Labels",
    "flatten",
    "join_across_faces",
    "label_all",
    "number_copies",
    "piece_sizes",
]

SAMPLE_COUNT = SAMPLES**3
"""Samples of a cell."""


class Block(NamedTuple):
    """Places of cells around a sheet, in the order of their keys."""

    keys: Int64
    """Shape (count,)."""
    cell: Int64
    """Cell at each place, -1 where there is none."""
    is_tissue: Bool
    """Shape (count, SAMPLES^3)."""
    is_crossed: Bool
    """Links from each sample along each axis, shape (count, 3, SAMPLES^3)."""
    is_touched: Bool
    """Whether a link from or to a sample of a place is crossed, shape (count,)."""


class Labels(NamedTuple):
    """What hangs together within each place."""

    piece: Int32
    """Piece of each sample, -1 where none, shape (count, SAMPLES^3)."""
    piece_count: Int64
    """Shape (count,)."""
    space: Int32
    """Part of space of each sample, shape (count, SAMPLES^3)."""
    space_count: Int64
    """Shape (count,)."""


@kernel
def flatten(parents):
    """Let each member know its set."""
    for one in range(len(parents)):
        parents[one] = root_of(parents, one)


@kernel
def label_all(is_tissue, is_crossed, is_touched, piece, piece_count, space, space_count):
    """Write pieces and parts of space of each place."""
    whole, parted, around = (
        np.empty(SAMPLE_COUNT, np.int64),
        np.empty(SAMPLE_COUNT, np.int64),
        np.empty(SAMPLE_COUNT, np.int64),
    )
    size, largest = np.empty(SAMPLE_COUNT, np.int64), np.empty(SAMPLE_COUNT, np.int64)
    for place in range(len(is_tissue)):
        tissue = is_tissue[place]
        if not is_touched[place]:
            piece[place] = np.where(tissue, 0, -1)
            piece_count[place] = 1 if tissue.any() else 0
            continue
        for sample in range(SAMPLE_COUNT):
            whole[sample] = parted[sample] = around[sample] = sample
        stride = 1
        for axis in range(3):
            for sample in range(SAMPLE_COUNT):
                if sample // stride % SAMPLES == SAMPLES - 1:
                    continue
                there = sample + stride
                both = tissue[sample] and tissue[there]
                if both:
                    join_two(whole, sample, there)
                if is_crossed[place, axis, sample]:
                    continue
                join_two(around, sample, there)
                if both:
                    join_two(parted, sample, there)
            stride *= SAMPLES
        flatten(whole)
        flatten(parted)
        flatten(around)
        # In each part of space, what never hung together with the largest piece is held by it: of what hung together
        # before, the largest that is left alone, or it would hold together again what was parted.
        size[:] = 0
        for sample in range(SAMPLE_COUNT):
            if tissue[sample]:
                size[parted[sample]] += 1
        largest[:] = -1
        for sample in range(SAMPLE_COUNT):
            if size[sample] > 0:
                part = around[sample]
                if largest[part] < 0 or size[sample] > size[largest[part]]:
                    largest[part] = sample
        for sample in range(SAMPLE_COUNT):
            if size[sample] == 0:
                continue
            main = largest[around[sample]]
            if whole[main] != whole[sample] and _is_largest(sample, size, around, whole):
                join_two(parted, main, sample)
        piece_count[place] = _number(parted, tissue, piece[place])
        space_count[place] = _number(around, np.ones(SAMPLE_COUNT, np.bool_), space[place])


@kernel(cached=False)
def _is_largest(one, size, around, whole):
    """Whether a piece is the largest, the first of equals, in its part of space of those that were one with it."""
    for other in range(SAMPLE_COUNT):
        is_rival = around[other] == around[one] and whole[other] == whole[one]
        if is_rival and (size[other] > size[one] or (size[other] == size[one] and other < one)):
            return False
    return True


@kernel(cached=False)
def _number(parents, is_counted, number):
    """Number sets by their first member, and count them."""
    count = 0
    for sample in range(SAMPLE_COUNT):
        if is_counted[sample]:
            root = root_of(parents, sample)
            if root == sample:
                number[sample] = count
                count += 1
            else:
                number[sample] = number[root]
    return count


@kernel
def join_across_faces(pairs, axis, block, labels, first_piece, first_space, uses, uses_before, uses_space):
    """Join what corners of two cells beside each other share, where samples on both sides hang together."""
    stride = SAMPLES**axis
    across = (SAMPLES - 1) * stride
    for number in range(len(pairs)):
        one, other = pairs[number]
        for sample in range(SAMPLE_COUNT):
            if sample // stride % SAMPLES != SAMPLES - 1:
                continue
            there = sample - across
            both = block.is_tissue[one, sample] and block.is_tissue[other, there]
            is_crossed = block.is_crossed[one, axis, sample]
            for corner in range(8):
                if corner >> axis & 1 == 0:
                    continue
                beyond = corner ^ (1 << axis)
                if both:
                    join_two(uses_before, 8 * one + corner, 8 * other + beyond)
                if is_crossed:
                    continue
                here = 8 * (first_space[one] + labels.space[one, sample]) + corner
                join_two(uses_space, here, 8 * (first_space[other] + labels.space[other, there]) + beyond)
                if both:
                    here = 8 * (first_piece[one] + labels.piece[one, sample]) + corner
                    join_two(uses, here, 8 * (first_piece[other] + labels.piece[other, there]) + beyond)


@kernel
def piece_sizes(labels, first_piece, piece_count):
    """Samples of each piece, and the part of space that its first lies in."""
    sizes, space = np.zeros(piece_count, np.int64), np.zeros(piece_count, np.int64)
    for place in range(len(first_piece)):
        for sample in range(SAMPLE_COUNT):
            if labels.piece[place, sample] >= 0:
                piece = first_piece[place] + labels.piece[place, sample]
                if sizes[piece] == 0:
                    space[piece] = labels.space[place, sample]
                sizes[piece] += 1
    return sizes, space


@kernel
def number_copies(order, starts, ends, uses, before, space, sizes, copies):
    """Number the copies that the uses of each node need.

    In each part of space, what never hung together with the largest is held by it: of what hung together before, the
    largest that is left alone.
    """
    for node in range(len(starts)):
        first, end = starts[node], ends[node]
        count = end - first
        total, main, own = np.zeros(count, np.int64), np.empty(count, np.int64), np.empty(count, np.int64)
        for a in range(count):
            for c in range(count):
                if uses[order[first + c]] == uses[order[first + a]]:
                    total[a] += sizes[first + c]
        for a in range(count):
            # The largest set in the same part of space, and of those that it hung together with; the lowest of equals.
            main[a] = own[a] = -1
            for b in range(count):
                if space[first + b] != space[first + a]:
                    continue
                if main[a] < 0 or total[b] > total[main[a]]:
                    main[a] = b
                if before[first + b] == before[first + a] and (own[a] < 0 or total[b] > total[own[a]]):
                    own[a] = b
        set_of = np.empty(count, np.int64)
        for a in range(count):
            set_of[a] = uses[order[first + a]]
        for a in range(count):
            if before[first + main[a]] == before[first + a] or set_of[own[a]] != set_of[a]:
                continue
            low, high = uses[order[first + main[a]]], uses[order[first + a]]
            low, high = min(low, high), max(low, high)
            for c in range(first, end):
                if uses[order[c]] == high:
                    uses[order[c]] = low
        count = 0
        for a in range(first, end):
            number = -1
            for b in range(first, a):
                if uses[order[b]] == uses[order[a]]:
                    number = copies[order[b]]
            if number < 0:
                number = count
                count += 1
            copies[order[a]] = number
