"""Certainty of a watershed's labels: the pass that a label came over against the lowest one of any other label.

The *pass* of a label to a voxel is the lowest height that a way of neighbouring voxels from the voxel to one marked
with the label must climb to, both ends included (a minimax path). A voxel's label is one whose pass is lowest; ``own``
is that pass, ``other`` the lowest pass of all other labels, and

    certainty = 1 - own / other

0 where another label comes over a pass as low (also where ``other`` is 0), 1 where there is no other label. It is free
of scale: a landscape twice as high has the same certainties. A painted voxel has certainty 1; one that got its mark
when a contested flat minimum was divided (:mod:`heartcase.pipeline.watershed.flat_minima.division`) has 0.

All ways count, also those across marked voxels: a stroke lifts the certainty of what hangs on it, but is no dam.

For the lowest voxel of a basin both passes follow from the tree of basins and the lowest marks in each, and any voxel
``v`` of the basin has the passes ``max(height at v, pass to the lowest voxel)``, since the steepest descent leads from
the one to the other. So a scan's certainties cost one pass of Kruskal's algorithm over the basins (Cousty, Bertrand,
Najman and Couprie 2009 show that minimum spanning trees keep minimax paths).
"""

from __future__ import annotations

from dataclasses import dataclass

import numba
import numpy as np

from heartcase.compiling.calls import copied
from heartcase.compiling.kernel import kernel, loop_kernel
from heartcase.pipeline.data import UNMARKED
from heartcase.pipeline.kernels.union_find import root_of
from heartcase.pipeline.watershed.descent import row_chunks, side_offsets
from heartcase.pipeline.watershed.forest import Forest
from heartcase.pipeline.watershed.marks import mark_below
from heartcase.schemas.arrays import Float32, UInt8

__all__ = ["FootCertainty", "foot_certainty", "voxel_certainty"]


NOBODY = -1
INFINITE_BITS = np.int32(0x7F800000)


@dataclass(frozen=True)
class FootCertainty:
    """How sure the label of each basin's foot is."""

    own: Float32
    """Pass of the foot's label to the basin's lowest voxel, float32, shape (basins,); infinite where nothing is
    marked."""
    other: Float32
    """Lowest pass of any other label, float32; infinite where there is none."""
    rival: UInt8
    """The label that has this pass, uint8; of several the one beyond the pass. 255 where there is none."""

    @property
    def certainty(self) -> Float32:
        """Certainty of each foot's lowest voxel, float32, 0 to 1; 0 where nothing is marked."""
        sure = np.zeros(len(self.own), np.float32)
        np.divide(self.own, self.other, out=sure, where=np.isfinite(self.own) & (self.other > 0.0))
        return np.where(np.isfinite(self.own) & (self.other > 0.0), np.float32(1.0) - sure, np.float32(0.0))


def foot_certainty(forest: Forest) -> FootCertainty:
    """Passes of each foot's own label and of its rival.

    Parameters
    ----------
    forest
        A solved forest.
    """
    tree = forest.tree
    bits, basin = tree.height.view(np.int32).ravel(), tree.basin.ravel()
    lowest_rival = np.full(tree.basin_count, NOBODY, np.int64)
    marks = forest.marks.ravel()
    _find_lowest_rivals(bits, basin, marks, np.flatnonzero(marks != UNMARKED), forest.lowest_mark, lowest_rival)
    higher, lower = tree.ends
    own = np.maximum((forest.foot_level >> 32).astype(np.int32), bits[tree.root])
    own[forest.foot_label == UNMARKED] = INFINITE_BITS
    other, rival = _find_others(
        (bits, marks, forest.labels.ravel()),
        (tree.key, higher, lower, *tree.basins),
        forest.lowest_mark,
        lowest_rival,
        forest.foot_label,
    )
    return FootCertainty(own.view(np.float32), other.view(np.float32), rival)


def voxel_certainty(forest: Forest, feet: FootCertainty | None = None) -> Float32:
    """Certainty of every voxel.

    Parameters
    ----------
    forest
        A solved forest.
    feet
        Its :func:`foot_certainty`, where it is at hand.

    Returns
    -------
    ndarray
        float32, the landscape's shape, 0 to 1.
    """
    feet = feet or foot_certainty(forest)
    tree = forest.tree
    certainty = np.empty(tree.height.shape, np.float32)
    _fill_voxels(
        row_chunks(certainty.shape) * tree.height.shape[2],
        (tree.height.ravel(), tree.direction.ravel(), tree.basin.ravel(), side_offsets(certainty.shape)),
        (forest.painted.ravel(), forest.marks.ravel()),
        forest.lowest_mark,
        forest.foot_label,
        feet.own,
        feet.other,
        certainty.reshape(-1),
    )
    return certainty


@kernel
def _find_lowest_rivals(bits, basin, marks, voxels, lowest_mark, lowest_rival):
    """Each basin's lowest voxel that is marked with another label than its lowest marked voxel."""
    for v in voxels:
        b = basin[v]
        if marks[v] == marks[lowest_mark[b]]:
            continue
        old = lowest_rival[b]
        if old < 0 or bits[v] < bits[old]:
            lowest_rival[b] = v


@copied
def _give(foot, height, rivals, following, foot_label, other, rival):
    """Give a height to a ring of feet, and the first label that is not their own."""
    at = foot
    while True:
        other[at] = height
        for label in rivals:
            if label != UNMARKED and label != foot_label[at]:
                rival[at] = label
                break
        at = following[at]
        if at == foot:
            return


@kernel
def _find_others(landscape, faces, lowest_mark, lowest_rival, foot_label):
    """Join basins in the order of the faces; feet get a height when theirs is the first join that brings another label.

    A piece of joined basins knows up to two of its labels: with two, none of its feet waits any more.
    """
    bits, marks, labels = landscape
    key, higher, lower, first, second = faces
    count = len(foot_label)
    other = np.full(count, INFINITE_BITS, np.int32)
    rival = np.full(count, UNMARKED, np.uint8)
    parent = np.arange(count)
    # feet that wait form a ring for each piece
    following = np.arange(count)
    waiting = np.arange(count)
    one_label = np.full(count, UNMARKED, np.uint8)
    two_label = np.full(count, UNMARKED, np.uint8)
    mark = np.concatenate((lowest_mark[lowest_mark >= 0], lowest_rival[lowest_rival >= 0]))
    owner = np.concatenate((np.flatnonzero(lowest_mark >= 0), np.flatnonzero(lowest_rival >= 0)))
    order = np.argsort(bits[mark], kind="mergesort")
    at = 0
    for e in range(len(key) + 1):
        height = np.int32(key[e] >> 32) if e < len(key) else INFINITE_BITS
        while at < len(order) and bits[mark[order[at]]] <= height:
            v = mark[order[at]]
            a = root_of(parent, owner[order[at]])
            at += 1
            if one_label[a] == UNMARKED:
                one_label[a] = marks[v]
            elif one_label[a] != marks[v] and two_label[a] == UNMARKED:
                _give(waiting[a], bits[v], (marks[v], one_label[a]), following, foot_label, other, rival)
                two_label[a] = marks[v]
                waiting[a] = NOBODY
        if e == len(key):
            break
        a = root_of(parent, first[e])
        b = root_of(parent, second[e])
        one = one_label[a] if one_label[a] != UNMARKED else one_label[b]
        two = two_label[a] if two_label[a] != UNMARKED else two_label[b]
        if two == UNMARKED and one_label[b] != UNMARKED and one_label[b] != one:
            two = one_label[b]
        if two == UNMARKED:
            following[waiting[a]], following[waiting[b]] = following[waiting[b]], following[waiting[a]]
        else:
            if two == one:
                # the pair of b holds a's only label second
                two = one_label[b]
            if waiting[a] != NOBODY:
                beyond = (labels[lower[e]], one_label[b], two_label[b], one_label[a])
                _give(waiting[a], height, beyond, following, foot_label, other, rival)
            if waiting[b] != NOBODY:
                beyond = (labels[higher[e]], one_label[a], two_label[a], one_label[b])
                _give(waiting[b], height, beyond, following, foot_label, other, rival)
            waiting[a] = NOBODY
        parent[b] = a
        one_label[a] = one
        two_label[a] = two
    return other, rival


@loop_kernel
def _fill_voxels(chunks, landscape, marks, lowest_mark, foot_label, own, other, certainty):
    height, direction, basin, offsets = landscape
    painted, marks = marks
    for c in numba.prange(len(chunks) - 1):
        for v in range(chunks[c], chunks[c + 1]):
            if painted[v] != UNMARKED:
                certainty[v] = 1.0
                continue
            b = basin[v]
            low, high = own[b], other[b]
            if lowest_mark[b] >= 0:
                mark = mark_below(v, direction, offsets, marks)
                if mark != UNMARKED:
                    # past the mark below it the way leads on down to the foot, whatever label that has
                    low = height[v]
                    high = high if mark == foot_label[b] else low
            low, high = max(low, height[v]), max(high, height[v])
            if low == np.inf or high == 0.0:
                certainty[v] = 0.0
            else:
                certainty[v] = np.float32(1.0) - low / high if high < np.inf else np.float32(1.0)
