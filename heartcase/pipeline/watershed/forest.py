"""The minimum spanning forest of basins and markers: solved at once, or updated where something was painted.

Of a marked basin only what lies below its marked voxels (its *foot*) waits for a label from elsewhere: a voxel has the
label of the first marked voxel on its way down, or that of the foot. A foot is reached through the basin's own lowest
marked voxel, by the face under that voxel; or through a face from a neighbouring basin. Such a face ends in a foot, or
above a marked voxel, where the label is given. ``level`` is the key of the highest face on a foot's way to its marked
voxel; it is what a new way has to beat.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from heartcase.compiling.kernel import kernel
from heartcase.pipeline.data import UNMARKED
from heartcase.pipeline.watershed.descent import row_chunks, side_offsets
from heartcase.pipeline.watershed.hanging import PartedForest, solve_parted
from heartcase.pipeline.watershed.incremental import mend, unmark
from heartcase.pipeline.watershed.marks import (
    CONTESTED,
    find_lowest_marks,
    is_flat_contested,
    mark_below,
    marked_voxels,
    note_flats,
    own_key,
    reach,
)
from heartcase.pipeline.watershed.painting import (
    MARKED_BASIN,
    TILE,
    count_labels,
    count_values,
    paint_basins,
    paint_boxes,
    paint_rows,
    tiles_of,
)
from heartcase.pipeline.watershed.plateaus import divide_flat
from heartcase.pipeline.watershed.tree import NO_KEY, BasinTree
from heartcase.schemas.arrays import Bool, Int16, Int32, Int64, UInt8

__all__ = ["Box", "Forest", "load_stroke_kernels", "solve_forest"]

Box = tuple[slice, slice, slice]

NO_FLAT = -1
MOST_MENDED = 0.005
"""Share of the feet that a label is carried to, or that hang on erased markers, at most; with more, solving anew is
quicker."""
MOST_AT_ONCE = 100_000
"""Voxels in basins that changed that are painted at once where painting may be put off."""
MOST_LISTED = 300_000
"""Voxels in basins that changed up to which their tiles are looked up; with more, all are painted anew."""
WHOLE_SHARE = 0.15
"""Share of the voxels in basins that changed from which on all voxels are painted anew: rows are quicker than lists."""


@dataclass
class Forest:
    """The labels of all voxels for a set of markers. Made by :func:`solve_forest`, mended by :meth:`paint`."""

    tree: BasinTree
    """The tree of the landscape."""
    painted: UInt8
    """Label of each painted voxel, uint8, shape [z, y, x]; 255 elsewhere."""
    marks: UInt8
    """The same with contested flat minima divided."""
    foot_label: UInt8
    """Label of each basin's foot."""
    foot_level: Int64
    """Key of the highest face on each foot's way to its marked voxel; 0 where that is its lowest voxel."""
    lowest_mark: Int64
    """Flat index of each basin's lowest marked voxel; -1 without any."""
    flat_label: Int16
    """Label that marks each flat minimum: -1 none, -2 several."""
    labels: UInt8
    """Label of each voxel; in a tile that is put off, of some earlier moment."""
    puts_off: bool = False
    """Whether :meth:`paint` leaves the labels of many voxels to :meth:`settle` and :meth:`settle_boxes`, and levels to
    the stroke that needs them."""
    put_off: Bool = field(default_factory=lambda: np.zeros((0, 0, 0), np.bool_))
    """Which tiles are put off, bool, shape [z, y, x] of tiles of 32 voxels along each side."""
    stamps: Int64 = field(default_factory=lambda: np.zeros((0, 0, 0), np.int64))
    """By tile: a number that is higher, the later a label that was put off turned out to be another one."""
    _parted: PartedForest | None = None
    _table: UInt8 | None = None
    _painted_counts: Int64 | None = None

    def __post_init__(self) -> None:
        """Begin with nothing put off."""
        self.put_off = np.zeros([-(-n // TILE) for n in self.tree.height.shape], np.bool_)
        self.stamps = np.zeros(self.put_off.shape, np.int64)

    def paint(self, voxels: Int64, label: int) -> Box | None:
        """Mark voxels with a label, and mend the forest where that changes it.

        Parameters
        ----------
        voxels
            Flat indices, int64.
        label
            Label value, below 255; or 255 to take the markers away.

        Returns
        -------
        Box or None
            Box in which labels changed; None where none did.
        """
        flat_painted = self.painted.reshape(-1)
        voxels = voxels[flat_painted[voxels] != label]
        if not len(voxels):
            return None
        self.fill_levels()
        self._table = None
        if self._painted_counts is not None:
            gone = np.bincount(flat_painted[voxels], minlength=256)
            # a new array: a copy of the forest may have the old one
            self._painted_counts = self._painted_counts - gone + len(voxels) * (np.arange(256) == label)
        flat_painted[voxels] = label
        tree = self.tree
        bits, basin = tree.height.view(np.int32).ravel(), tree.basin.ravel()
        if is_flat_contested(bits, basin, tree.root, tree.flat, self.flat_label, voxels, label):
            return self.solve()
        graph = (*tree.neighbours, tree.key, *tree.ends)
        feet = (self.marks.reshape(-1), self.foot_label, self.foot_level, self.lowest_mark)
        most = int(MOST_MENDED * tree.basin_count)
        before = self.foot_label.copy()
        if label != UNMARKED:
            changed = mend(self._landscape, graph, voxels, label, *feet, most)
        else:
            changed = unmark(self._landscape, graph, tree.voxels, voxels, *feet, most)
        if len(changed):
            return self._paint_basins(changed)
        self._parted = solve_parted(tree, self._landscape, self.marks.reshape(-1), self.lowest_mark)
        self._parted.fill_labels(self.foot_label)
        if not self.puts_off:
            self.fill_levels()
            return self._paint_whole()
        is_changed = self.foot_label != before
        is_changed[basin[voxels]] = True
        return self._paint_basins(np.flatnonzero(is_changed))

    def restore(self, voxels: Int64, values: UInt8) -> Box | None:
        """Mark voxels with labels of their own, or take their markers away (255); a box around what changed."""
        box = None
        for label in sorted({*values.tolist()}, reverse=True):
            box = _around_both(box, self.paint(voxels[values == label], label))
        return box

    def solve(self) -> Box | None:
        """Work everything out anew from ``painted``; the box in which labels changed."""
        tree = self.tree
        bits, basin = tree.height.view(np.int32).ravel(), tree.basin.ravel()
        np.copyto(self.marks, self.painted)
        voxels = marked_voxels(self.marks.ravel(), row_chunks(self.marks.shape) * self.marks.shape[2])
        note_flats(bits, basin, tree.root, tree.flat, self.marks.ravel(), voxels, self.flat_label)
        if (self.flat_label == CONTESTED).any():
            self._divide_flats(voxels)
            voxels = marked_voxels(self.marks.ravel(), row_chunks(self.marks.shape) * self.marks.shape[2])
        self.lowest_mark[:] = -1
        find_lowest_marks(bits, basin, voxels, self.lowest_mark)
        higher, lower = tree.ends
        first, second = tree.basins
        _solve(
            self._landscape,
            (tree.key, higher, lower, first, second),
            self.marks.ravel(),
            self.lowest_mark,
            self.foot_label,
            self.foot_level,
        )
        self._parted = self._table = None
        return self._paint_whole()

    def label_counts(self) -> Int64:
        """Number of voxels of each label, int64, shape (256,); nothing that was put off has to be settled for it."""
        first_voxel, voxel_list = self.tree.voxels
        _, direction, _, offsets = self._landscape
        count: Int64 = count_labels(
            first_voxel, voxel_list, direction, offsets, self.marks.reshape(-1), self.lowest_mark, self.foot_label
        )
        return count

    def painted_counts(self) -> Int64:
        """Number of voxels that are painted with each label, int64, shape (256,)."""
        if self._painted_counts is None:
            self._painted_counts = count_values(self.painted.reshape(-1))
        return self._painted_counts.copy()

    def settle(self) -> None:
        """Work out all that was put off."""
        self.fill_levels()
        if self.put_off.any():
            self._paint_whole()

    def settle_boxes(self, boxes: Sequence[Box]) -> None:
        """Work out the labels in some boxes [z, y, x]; what was put off elsewhere stays so.

        Parameters
        ----------
        boxes
            What lies outside of the volume is left out. A tile is settled where one of them is all of it.
        """
        changed = np.zeros_like(self.put_off)
        boxes = [_within(box, self.labels.shape) for box in boxes]
        boxes = [box for box in boxes if self.put_off[_tiles_around(box)].any()]
        if not boxes:
            return
        bounds = np.array([[[one.start, one.stop] for one in box] for box in boxes], np.int64)
        if self._table is None:
            self._table = self.foot_label.copy()
            self._table[np.flatnonzero(self.lowest_mark >= 0)] = MARKED_BASIN
        paint_boxes(
            *_in_parts(bounds[..., 0], bounds[..., 1]),
            self._table,
            *self._landscape[1:],
            self.marks.reshape(-1),
            self.foot_label,
            self.labels,
            changed,
        )
        for box in boxes:
            if all(
                one.start % TILE == 0 and one.stop == min(one.start + TILE, n)
                for one, n in zip(box, self.labels.shape, strict=True)
            ):
                self.put_off[_tiles_around(box)] = False
        self.stamps[changed] = self.stamps.max() + 1

    @property
    def _landscape(self) -> tuple[Int32, UInt8, Int32, Int64]:
        """Bits of the heights, directions, basins and offsets of sides, flat."""
        tree = self.tree
        bits, offsets = tree.height.view(np.int32).ravel(), side_offsets(tree.height.shape)
        return bits, tree.direction.ravel(), tree.basin.ravel(), offsets

    def fill_levels(self) -> bool:
        """Work out levels that were put off; whether any were."""
        if self._parted is None:
            return False
        self._parted.fill_levels(self.foot_level)
        self._parted = None
        return True

    def _divide_flats(self, voxels: Int64) -> None:
        tree = self.tree
        bits, basin = tree.height.view(np.int32).ravel(), tree.basin.ravel()
        own = basin[voxels]
        number = np.where(bits[voxels] == bits[tree.root[own]], tree.flat[own], NO_FLAT)
        for contested in np.flatnonzero(self.flat_label == CONTESTED):
            divide_flat(
                bits,
                basin,
                tree.flat,
                self.marks.shape,
                side_offsets(self.marks.shape),
                voxels[number == contested],
                self.marks.reshape(-1),
                UNMARKED,
            )

    def _paint_basins(self, changed: Int64) -> Box | None:
        tree = self.tree
        first_voxel, voxel_list = tree.voxels
        count = int((first_voxel[changed + 1] - first_voxel[changed]).sum())
        if self.puts_off and count > MOST_AT_ONCE:
            if count > MOST_LISTED:
                self.put_off[:] = True
            else:
                tiles_of(changed, first_voxel, voxel_list, self.labels.shape, self.put_off)
            return None
        if count > WHOLE_SHARE * self.labels.size:
            return self._paint_whole()
        low, high = paint_basins(
            changed,
            first_voxel,
            voxel_list,
            tree.direction.ravel(),
            side_offsets(tree.height.shape),
            self.marks.reshape(-1),
            self.lowest_mark,
            self.foot_label,
            self.labels.reshape(-1),
            self.labels.shape,
        )
        return _as_box(low, high)

    def _paint_whole(self) -> Box | None:
        self.stamps[self.put_off] = self.stamps.max() + 1
        self.put_off[:] = False
        rows = row_chunks(self.labels.shape)
        low, high = paint_rows(
            rows,
            self.tree.direction.ravel(),
            self.tree.basin.ravel(),
            side_offsets(self.labels.shape),
            self.marks.ravel(),
            self.lowest_mark,
            self.foot_label,
            self.labels,
        )
        return _as_box(low.min(axis=0), high.max(axis=0))


def solve_forest(tree: BasinTree, markers: UInt8) -> Forest:
    """Label every voxel from markers.

    Parameters
    ----------
    tree
        The tree of the landscape.
    markers
        Label of each marked voxel, uint8, the landscape's shape; 255 elsewhere.

    Returns
    -------
    Forest
        Its labels are 255 everywhere where nothing is marked.
    """
    count = tree.basin_count
    forest = Forest(
        tree=tree,
        painted=np.array(markers, np.uint8, order="C"),
        marks=np.empty(markers.shape, np.uint8),
        foot_label=np.empty(count, np.uint8),
        foot_level=np.empty(count, np.int64),
        lowest_mark=np.empty(count, np.int64),
        flat_label=np.empty(count, np.int16),
        labels=np.full(markers.shape, UNMARKED, np.uint8),
    )
    forest.solve()
    return forest


def load_stroke_kernels() -> None:
    """Have the kernels at hand that strokes call: a first one would wait for each of them to be loaded."""
    from heartcase.pipeline.watershed.tree import build_basin_tree

    shape = (4, 4, 4)
    # every second voxel is a basin
    height = (np.indices(shape).sum(axis=0) % 2 + np.arange(64).reshape(shape) / 64).astype(np.float32)
    forest = solve_forest(build_basin_tree(height), np.full(shape, UNMARKED, np.uint8))
    forest.puts_off = True
    for voxel, label in ((0, 1), (63, 2), (63, UNMARKED)):
        forest.paint(np.array([voxel]), label)
    first_voxel, voxel_list = forest.tree.voxels
    tiles_of(np.arange(forest.tree.basin_count), first_voxel, voxel_list, shape, forest.put_off)
    forest.settle_boxes([(slice(0, 1), slice(0, 4), slice(0, 4))])
    forest.label_counts(), forest.painted_counts()
    forest.settle()


def _around_both(one: Box | None, other: Box | None) -> Box | None:
    if one is None or other is None:
        return one or other
    k, j, i = (slice(min(a.start, b.start), max(a.stop, b.stop)) for a, b in zip(one, other, strict=True))
    return k, j, i


def _within(box: Box, shape: tuple[int, ...]) -> Box:
    """The voxels that NumPy takes of it, in whole numbers and without steps; an empty one has no tiles."""
    found = [range(*one.indices(n)) for one, n in zip(box, shape, strict=True)]
    if not all(found):
        return slice(0, 0), slice(0, 0), slice(0, 0)
    k, j, i = (slice(min(one), max(one) + 1) for one in found)
    return k, j, i


def _tiles_around(box: Box) -> Box:
    k, j, i = (slice(one.start // TILE, -(-one.stop // TILE)) for one in box)
    return k, j, i


def _in_parts(low: Int64, high: Int64) -> tuple[Int64, Int64]:
    """Boxes cut across their longest way through slices or rows, so that threads have about as much to do."""
    lows, highs = [], []
    for first, last in zip(low, high, strict=True):
        axis = int((last - first)[:2].argmax())
        for start in range(int(first[axis]), int(last[axis]), TILE):
            part_first, part_last = first.copy(), last.copy()
            part_first[axis], part_last[axis] = start, min(start + TILE, int(last[axis]))
            lows.append(part_first)
            highs.append(part_last)
    return np.array(lows), np.array(highs)


def _as_box(low: Int64, high: Int64) -> Box | None:
    if low[0] > high[0]:
        return None
    (k0, j0, i0), (k1, j1, i1) = low.tolist(), high.tolist()
    return slice(k0, k1 + 1), slice(j0, j1 + 1), slice(i0, i1 + 1)


@kernel
def _solve(landscape, faces, marks, lowest_mark, foot_label, foot_level):
    """Kruskal's algorithm over the joining faces and those under the lowest marked voxels, in their common order."""
    bits, direction, _, offsets = landscape
    key, higher, lower, first, second = faces
    foot_label[:] = UNMARKED
    foot_level[:] = NO_KEY
    marked = np.flatnonzero(lowest_mark >= 0)
    own = np.empty(len(marked), np.int64)
    for n in range(len(marked)):
        own[n] = own_key(lowest_mark[marked[n]], bits, direction)
    order = np.argsort(own)
    # feet that hang together without a label form a ring; a tree has no face that joins a ring with itself
    following = np.arange(len(lowest_mark)).astype(np.int32)
    is_marked = lowest_mark >= 0
    at = 0
    for e in range(len(key) + 1):
        one = key[e] if e < len(key) else NO_KEY
        while at < len(order) and own[order[at]] < one:
            b = marked[order[at]]
            if foot_label[b] == UNMARKED:
                reach(b, own[order[at]], marks[lowest_mark[b]], following, foot_label, foot_level)
            at += 1
        if e == len(key):
            break
        a, b = first[e], second[e]
        here, there = foot_label[a], foot_label[b]
        is_foot_a = is_foot_b = True
        if is_marked[a]:
            mark = mark_below(higher[e], direction, offsets, marks)
            if mark != UNMARKED:
                here, is_foot_a = mark, False
        if is_marked[b]:
            mark = mark_below(lower[e], direction, offsets, marks)
            if mark != UNMARKED:
                there, is_foot_b = mark, False
        if here == UNMARKED and there == UNMARKED:
            following[a], following[b] = following[b], following[a]
        elif here == UNMARKED and is_foot_a:
            reach(a, one, there, following, foot_label, foot_level)
        elif there == UNMARKED and is_foot_b:
            reach(b, one, here, following, foot_label, foot_level)
