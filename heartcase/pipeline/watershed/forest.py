"""The minimum spanning forest of basins and markers: solved at once, or updated where something was painted.

Of a marked basin only what lies below its marked voxels (its *foot*) waits for a label from elsewhere: a voxel has the
label of the first marked voxel on its way down, or that of the foot. A foot is reached through the basin's own lowest
marked voxel, by the face under that voxel; or through a face from a neighbouring basin. Such a face ends in a foot, or
above a marked voxel, where the label is given. ``level`` is the key of the highest face on a foot's way to its marked
voxel; it is what a new way has to beat. What all voxels get by that is worked out, or put off, by
:mod:`heartcase.pipeline.watershed.voxel_labels`.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from heartcase.compiling.kernel import kernel
from heartcase.pipeline.data import UNMARKED
from heartcase.pipeline.kernels.counting import count_values
from heartcase.pipeline.watershed.boxes import Box, around_both
from heartcase.pipeline.watershed.descent import ROOT
from heartcase.pipeline.watershed.flat_minima.division import Division, Groups, divided_flats
from heartcase.pipeline.watershed.flat_minima.mending import ALL
from heartcase.pipeline.watershed.incremental import mend, unmark
from heartcase.pipeline.watershed.marks import (
    find_lowest_marks,
    is_flat_contested,
    mark_below,
    marked_voxels,
    note_erased,
    note_flats,
    note_marked,
    own_key,
    reach,
)
from heartcase.pipeline.watershed.sight import Sight
from heartcase.pipeline.watershed.tree import NO_KEY, BasinTree
from heartcase.pipeline.watershed.voxel_labels import Feet, VoxelLabels
from heartcase.schemas.arrays import Bool, Int16, Int64, UInt8

__all__ = ["Box", "Forest", "solve_forest"]

MOST_MENDED = 0.005
"""Share of the feet that a label is carried to, or that hang on erased markers, at most; with more, solving anew is
quicker."""
MENDED_FOR_MARKED = 0.1
"""Feet that may be mended besides for each marked basin: with many of these solving anew takes longer."""
MOST_ERASED = 100_000
"""Voxels that lose their marks up to which what hung on them is looked up; with more, all is solved anew."""
FEW_MARKED = 0.02
"""Share of the basins that are marked up to which solving anew is a matter of few ms, whatever is changed."""
MOST_CARRIED = 2_000
"""Feet that a label is carried to, or that hang on erased markers, at most where it is; with more it is quicker."""
BEHIND_FROM = 50_000
"""Basins from which on passes over all of them are put off, too."""
LARGE_FLAT = 300_000
"""Voxels in the basins of a flat minimum from which on memory is got for its division before it is needed."""
DIVIDED_AT_ONCE = 3_000
"""Voxels of contested flat minima that get their marks with a stroke where that is put off."""
DIVIDED_IN_PAUSES = 8_000
"""The same, in one piece, while nothing is painted."""
FILLED_AT_ONCE = 400_000
"""Feet that are worked out in one piece where they were put off."""


@dataclass
class Forest:
    """The labels of all voxels for a set of markers. Made by :func:`solve_forest`, mended by :meth:`paint`."""

    tree: BasinTree
    """The tree of the landscape."""
    painted: UInt8
    """Label of each painted voxel, uint8, shape [z, y, x]; 255 elsewhere."""
    flat_label: Int16
    """Label that marks each flat minimum, int16, by its number: -1 none, -2 several."""
    _feet: Feet
    _voxels: VoxelLabels
    puts_off: bool = False
    """Whether :meth:`paint` leaves the labels of many voxels to :meth:`settle` and the like, and where few basins are
    marked also those of the feet."""
    _division: Division | None = None
    """How contested flat minima are divided; None while none was."""
    _painted_counts: Int64 | None = None

    def copy(self) -> Forest:
        """The same forest, with all worked out and arrays of its own; both have one tree."""
        self.fill()
        self.settle()
        flat_label, feet = self.flat_label.copy(), self._feet.copy()
        return replace(
            self,
            painted=self.painted.copy(),
            flat_label=flat_label,
            _feet=feet,
            _voxels=self._voxels.copy(feet),
            _division=self._division and self._division.copy(flat_label),
        )

    @property
    def marks(self) -> UInt8:
        """The same as ``painted``, with contested flat minima divided, uint8, shape [z, y, x]."""
        return self._feet.marks

    @property
    def lowest_mark(self) -> Int64:
        """Flat index of each basin's lowest marked voxel, int64, shape (basins,); -1 without any."""
        return self._feet.lowest_mark

    @property
    def foot_label(self) -> UInt8:
        """Label of each basin's foot, uint8, shape (basins,); after :meth:`fill`, of now."""
        return self._feet.label

    @property
    def foot_level(self) -> Int64:
        """Key of the highest face on each foot's way to its marked voxel, int64, shape (basins,), as for the labels."""
        return self._feet.level

    @property
    def labels(self) -> UInt8:
        """Label of each voxel, uint8, shape [z, y, x]; in a tile that is put off, of some earlier moment."""
        return self._voxels.labels

    @property
    def put_off(self) -> Bool:
        """Which tiles are put off, bool, shape [z, y, x] of tiles of 32 voxels along each side."""
        return self._voxels.put_off

    @property
    def stamps(self) -> Int64:
        """By tile, int64: higher, the later it was that a label which was put off turned out to be another one."""
        return self._voxels.stamps

    @property
    def put_off_times(self) -> int:
        """How often labels were put off so far."""
        return self._voxels.put_off_times

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
        return self._paint([(label, voxels)])

    def restore(self, voxels: Int64, values: UInt8) -> Box | None:
        """Mark voxels, each there once, with labels of their own, or take their markers away (255).

        Returns
        -------
        Box or None
            A box around the labels that changed.
        """
        return self._paint([(label, voxels[values == label]) for label in sorted({*values.tolist()}, reverse=True)])

    def _paint(self, strokes: Sequence[tuple[int, Int64]]) -> Box | None:
        """Mark voxels, label by label (255: none), each of them once; the box in which labels changed."""
        flat_painted = self.painted.reshape(-1)
        strokes = [(label, voxels[flat_painted[voxels] != label]) for label, voxels in strokes]
        strokes = [(label, voxels) for label, voxels in strokes if len(voxels)]
        if not strokes:
            return None
        before = [flat_painted[voxels] for _, voxels in strokes]
        for label, voxels in strokes:
            if self._painted_counts is not None:
                gone = np.bincount(flat_painted[voxels], minlength=256)
                # a new array: a copy of the forest may have the old one
                self._painted_counts = self._painted_counts - gone + len(voxels) * (np.arange(256) == label)
            flat_painted[voxels] = label
        tree = self.tree
        flats = tree.height.view(np.int32).ravel(), tree.basin.ravel(), tree.root, tree.flat, self.flat_label
        if not any(is_flat_contested(*flats, voxels, label) for label, voxels in strokes):
            return self._mark(strokes)
        if self._division is None:
            self._division = Division.of_none(tree, self.flat_label)
        box = None
        voxels, was = np.concatenate([one for _, one in strokes]), np.concatenate(before)
        marked = self.marks.reshape(-1)
        for groups in self._division.redivided(flat_painted, marked, voxels, was, is_put_off=self.puts_off):
            self._note_begun(self._division.begun)
            box = around_both(box, self._mark(groups))
        if self._division.is_busy:
            box = around_both(box, self._divide(DIVIDED_AT_ONCE))
        return box

    def _note_begun(self, begun: list[Int64]) -> None:
        """Note lowest marks of flat minima that have their one label everywhere: no label changes by them.

        All basins of such a flat have its label at their feet, and no way to another foot leads through a lower key.
        """
        for lowest in begun:
            bits, direction, basin, _ = self._feet.landscape
            here = basin[lowest]
            self.lowest_mark[here] = lowest
            # as own_key says
            key = (bits[lowest].astype(np.int64) << 32) | (lowest << 3)
            self.foot_level[here] = np.where(direction[lowest] == ROOT, 0, key)
            self._feet.forget(None)
        begun.clear()

    def _mark(self, groups: Groups, most_at_once: int | None = None) -> Box | None:
        """Give voxels marks, label by label (255: none), and mend the forest; the box in which labels changed."""
        if not groups:
            return None
        tree, feet = self.tree, self._feet
        basin = tree.basin.ravel()
        is_touched = np.zeros(tree.basin_count, np.bool_)
        for _, voxels in groups:
            is_touched[basin[voxels]] = True
        touched = np.flatnonzero(is_touched)
        feet.forget(touched if self._may_fall_behind else None)
        is_quick = self._is_quick
        if is_quick and feet.is_put_off:
            self._note(groups)
            self.fall_behind()
            return None
        feet.fill()
        graph = (*tree.neighbours, tree.key, *tree.ends)
        arrays = (feet.marks.reshape(-1), feet.label, feet.level, feet.lowest_mark)
        worth = MOST_MENDED * tree.basin_count + MENDED_FOR_MARKED * np.count_nonzero(feet.lowest_mark >= 0)
        most = min(int(worth), MOST_CARRIED if is_quick else tree.basin_count)
        before = None if is_quick else feet.label.copy()
        changed: list[Int64] = []
        for number, (label, voxels) in enumerate(groups):
            if label != UNMARKED:
                found = mend(feet.landscape, graph, voxels, label, *arrays, most)
            elif len(voxels) > MOST_ERASED:
                self._note([(label, voxels)])
                found = np.empty(0, np.int64)
            else:
                found = unmark(feet.landscape, graph, tree.voxels, voxels, *arrays, most)
            if not len(found):
                self._note(groups[number + 1 :])
                break
            changed.append(found)
        else:
            every = changed[0] if len(changed) == 1 else np.unique(np.concatenate(changed))
            return self._voxels.paint_basins(every, puts_off=self.puts_off, most_at_once=most_at_once)
        if before is None:
            self.fall_behind()
            return None
        feet.put_off()
        feet.fill()
        if not self.puts_off:
            return self._voxels.paint_whole()
        is_changed = feet.label != before
        is_changed[touched] = True
        return self._voxels.paint_basins(np.flatnonzero(is_changed), puts_off=True, most_at_once=most_at_once)

    def _note(self, groups: Groups) -> None:
        """Give voxels marks, and leave the forest as it is."""
        tree, marks = self.tree, self.marks.reshape(-1)
        bits, basin = tree.height.view(np.int32).ravel(), tree.basin.ravel()
        for label, voxels in groups:
            if label != UNMARKED:
                note_marked(bits, basin, voxels, label, marks, self.lowest_mark)
            else:
                note_erased(bits, basin, tree.voxels, voxels, marks, self.lowest_mark)

    def solve(self) -> Box | None:
        """Work everything out anew from ``painted``; the box in which labels changed."""
        tree = self.tree
        bits, basin = tree.height.view(np.int32).ravel(), tree.basin.ravel()
        np.copyto(self.marks, self.painted)
        voxels = marked_voxels(self.marks)
        note_flats(bits, basin, tree.root, tree.flat, self.marks.ravel(), voxels, self.flat_label)
        self._division = divided_flats(tree, self.marks, self.flat_label, voxels)
        if self._division:
            voxels = marked_voxels(self.marks)
        self.lowest_mark[:] = -1
        find_lowest_marks(bits, basin, voxels, self.lowest_mark)
        self._feet.forget(None)
        if self._is_quick:
            self.fall_behind()
            return None
        higher, lower = tree.ends
        first, second = tree.basins
        _solve(
            self._feet.landscape,
            (tree.key, higher, lower, first, second),
            self.marks.ravel(),
            self.lowest_mark,
            self.foot_label,
            self.foot_level,
        )
        self._feet.is_put_off = False
        return self._voxels.paint_whole()

    @property
    def is_labelled(self) -> bool:
        """Whether anything is marked: then every voxel has a label."""
        return bool((self.lowest_mark >= 0).any())

    def label_counts(self) -> Int64:
        """Number of voxels of each label, int64, shape (256,); flats are divided for it, and labels stay put off."""
        self.finish_dividing()
        return self._voxels.label_counts()

    def painted_counts(self) -> Int64:
        """Number of voxels that are painted with each label, int64, shape (256,)."""
        if self._painted_counts is None:
            self._painted_counts = count_values(self.painted.reshape(-1))
        return self._painted_counts.copy()

    def settle(self) -> None:
        """Work out all labels that were put off."""
        self.finish_dividing()
        self._voxels.settle()

    def settle_boxes(self, boxes: Sequence[Box]) -> None:
        """Work out the labels in some boxes [z, y, x], as :meth:`VoxelLabels.settle_boxes` does."""
        self._voxels.settle_boxes(boxes)

    def settle_sight(self, sight: Sight) -> None:
        """Work out the labels that a plane shows; no tile is settled by that."""
        self._voxels.settle_sight(sight)

    def settle_voxels(self, voxels: Int64) -> None:
        """Work out the labels of voxels, flat indices, int64; no tile is settled by that."""
        self._voxels.settle_voxels(voxels)

    @property
    def is_settled(self) -> bool:
        """Whether all labels are worked out."""
        return self._voxels.is_settled and not self.is_dividing

    @property
    def is_dividing(self) -> bool:
        """Whether flat minima are still being divided: labels in them are of before where they are not yet."""
        return self._division is not None and self._division.is_busy

    def finish_dividing(self) -> None:
        """Divide all contested flat minima to the end; labels that change by that are put off."""
        while self.is_dividing:
            self._divide(ALL, most_painted=-1)

    def fill(self) -> None:
        """Work out all marks, and the labels and levels of all feet, where they were put off: as :meth:`solve` does."""
        while self._division is not None and not self._division.is_done:
            self._divide(ALL, most_painted=-1)
        self._feet.fill()

    def fill_some(self, most: int = FILLED_AT_ONCE) -> bool:
        """Work out some of the marks or of so many feet that were put off; whether there were any."""
        if self.is_dividing:
            # who asks is told by the tiles that are put off
            self._divide(DIVIDED_IN_PAUSES, most_painted=-1)
            return True
        return self._feet.fill_some(most)

    def _divide(self, most: int, most_painted: int | None = None) -> Box | None:
        """Divide flat minima on by so many voxels; the box in which labels changed."""
        if self._division is None:
            return None
        groups = self._division.go_on(self.painted.reshape(-1), self.marks.reshape(-1), most)
        return self._mark(groups, most_painted)

    @property
    def _may_fall_behind(self) -> bool:
        return self.puts_off and self.tree.basin_count >= BEHIND_FROM

    @property
    def _is_quick(self) -> bool:
        """Whether solving anew is quick, and passes over all basins are put off."""
        return self._may_fall_behind and len(self._feet.maybe_marked()) <= FEW_MARKED * self.tree.basin_count

    def get_ready(self) -> None:
        """Have the memory at hand that dividing a large flat minimum takes."""
        flat, first_voxel = self.tree.flat, self.tree.voxels[0]
        sizes = np.bincount(flat + 1, weights=np.diff(first_voxel))[1:]
        if self._division is None and sizes.max(initial=0) > LARGE_FLAT:
            self._division = Division.of_none(self.tree, self.flat_label)
            # written to, or the first stroke would wait until the memory is there
            self._division.distance.fill(0)

    def fall_behind(self) -> None:
        """Leave all that follows from the markers to whoever asks for it."""
        self._feet.put_off()
        self._voxels.put_off_all()


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
    feet = Feet(
        tree=tree,
        marks=np.empty(markers.shape, np.uint8),
        lowest_mark=np.empty(count, np.int64),
        label=np.empty(count, np.uint8),
        level=np.empty(count, np.int64),
    )
    forest = Forest(
        tree=tree,
        painted=np.array(markers, np.uint8, order="C"),
        flat_label=np.empty(count, np.int16),
        _feet=feet,
        _voxels=VoxelLabels(feet, np.full(markers.shape, UNMARKED, np.uint8)),
    )
    forest.solve()
    return forest


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
