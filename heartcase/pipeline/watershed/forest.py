"""The minimum spanning forest of basins and markers: solved at once, or updated where something was painted.

Of a marked basin only what lies below its marked voxels (its *foot*) waits for a label from elsewhere: a voxel has the
label of the first marked voxel on its way down, or that of the foot. A foot is reached through the basin's own lowest
marked voxel, by the face under that voxel; or through a face from a neighbouring basin. Such a face ends in a foot, or
above a marked voxel, where the label is given. ``level`` is the key of the highest face on a foot's way to its marked
voxel; it is what a new way has to beat.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from heartcase.compiling.kernel import kernel
from heartcase.pipeline.data import UNMARKED
from heartcase.pipeline.kernels.counting import count_values
from heartcase.pipeline.watershed.boxes import Box, around_both, as_box, in_parts, tiles_around, voxels_in, within
from heartcase.pipeline.watershed.descent import ROOT, row_chunks, side_offsets
from heartcase.pipeline.watershed.flat_minima.division import Division, Groups, divided_flats
from heartcase.pipeline.watershed.flat_minima.mending import ALL
from heartcase.pipeline.watershed.hanging import Filling, PartedForest, solve_parted
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
from heartcase.pipeline.watershed.painting import (
    MARKED_BASIN,
    TILE,
    count_labels,
    paint_basins,
    paint_boxes,
    paint_rows,
    tiles_of,
)
from heartcase.pipeline.watershed.sight import Sight, paint_sight
from heartcase.pipeline.watershed.tree import NO_KEY, BasinTree
from heartcase.schemas.arrays import Bool, Int16, Int32, Int64, UInt8

__all__ = ["Box", "Forest", "solve_forest"]

NO_FLAT = -1
MOST_MENDED = 0.005
"""Share of the feet that a label is carried to, or that hang on erased markers, at most; with more, solving anew is
quicker."""
MENDED_FOR_MARKED = 0.1
"""Feet that may be mended besides for each marked basin: with many of these solving anew takes longer."""
MOST_ERASED = 100_000
"""Voxels that lose their marks up to which what hung on them is looked up; with more, all is solved anew."""
MOST_AT_ONCE = 100_000
"""Voxels in basins that changed that are painted at once where painting may be put off."""
MOST_LISTED = 300_000
"""Voxels in basins that changed up to which their tiles are looked up; with more, all are painted anew."""
MOST_ONE_BY_ONE = 50_000
"""Voxels of boxes up to which the labels of these alone are looked up; with more, a table of all basins is worth it."""
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
    """Whether :meth:`paint` leaves the labels of many voxels to :meth:`settle` and the like, and where few basins are
    marked also those of the feet."""
    put_off: Bool = field(default_factory=lambda: np.zeros((0, 0, 0), np.bool_))
    """Which tiles are put off, bool, shape [z, y, x] of tiles of 32 voxels along each side."""
    stamps: Int64 = field(default_factory=lambda: np.zeros((0, 0, 0), np.int64))
    """By tile: a number that is higher, the later a label that was put off turned out to be another one."""
    put_off_times: int = 0
    """How often labels were put off so far."""
    _division: Division | None = None
    """How contested flat minima are divided; None while none was."""
    _is_behind: bool = False
    """Whether labels and levels of feet are of earlier markers: those of now follow from what is parted."""
    _parted: PartedForest | None = None
    _filling: Filling | None = None
    _feet_now: UInt8 | None = None
    _table: UInt8 | None = None
    _marked: Int64 | None = None
    _painted_counts: Int64 | None = None

    def __post_init__(self) -> None:
        """Begin with nothing put off."""
        self.put_off = np.zeros([-(-n // TILE) for n in self.tree.height.shape], np.bool_)
        self.stamps = np.zeros(self.put_off.shape, np.int64)

    def copy(self) -> Forest:
        """The same forest, with all worked out and arrays of its own; both have one tree."""
        self.fill()
        self.settle()
        names = ("painted", "marks", "foot_label", "foot_level", "lowest_mark", "flat_label", "labels")
        copies = {name: getattr(self, name).copy() for name in names}
        division = self._division and self._division.copy(copies["flat_label"])
        return replace(self, _division=division, **copies)

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
            bits, direction, basin, _ = self._landscape
            here = basin[lowest]
            self.lowest_mark[here] = lowest
            # as own_key says
            key = (bits[lowest].astype(np.int64) << 32) | (lowest << 3)
            self.foot_level[here] = np.where(direction[lowest] == ROOT, 0, key)
            self._forget()
            self._marked = None
        begun.clear()

    def _mark(self, groups: Groups, most_at_once: int | None = None) -> Box | None:
        """Give voxels marks, label by label (255: none), and mend the forest; the box in which labels changed."""
        if not groups:
            return None
        self._forget()
        tree = self.tree
        basin = tree.basin.ravel()
        is_touched = np.zeros(tree.basin_count, np.bool_)
        for _, voxels in groups:
            is_touched[basin[voxels]] = True
        touched = np.flatnonzero(is_touched)
        self._marked = np.union1d(self._known_marked(), touched) if self._may_fall_behind else None
        is_quick = self._is_quick
        if is_quick and self._is_behind:
            self._note(groups)
            self.fall_behind()
            return None
        self._fill_feet()
        graph = (*tree.neighbours, tree.key, *tree.ends)
        feet = (self.marks.reshape(-1), self.foot_label, self.foot_level, self.lowest_mark)
        worth = MOST_MENDED * tree.basin_count + MENDED_FOR_MARKED * np.count_nonzero(self.lowest_mark >= 0)
        most = min(int(worth), MOST_CARRIED if is_quick else tree.basin_count)
        before = None if is_quick else self.foot_label.copy()
        changed: list[Int64] = []
        for number, (label, voxels) in enumerate(groups):
            if label != UNMARKED:
                found = mend(self._landscape, graph, voxels, label, *feet, most)
            elif len(voxels) > MOST_ERASED:
                self._note([(label, voxels)])
                found = np.empty(0, np.int64)
            else:
                found = unmark(self._landscape, graph, tree.voxels, voxels, *feet, most)
            if not len(found):
                self._note(groups[number + 1 :])
                break
            changed.append(found)
        else:
            every = changed[0] if len(changed) == 1 else np.unique(np.concatenate(changed))
            return self._paint_basins(every, most_at_once)
        if before is None:
            self.fall_behind()
            return None
        self._is_behind = True
        self._fill_feet()
        if not self.puts_off:
            return self._paint_whole()
        is_changed = self.foot_label != before
        is_changed[touched] = True
        return self._paint_basins(np.flatnonzero(is_changed), most_at_once)

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
        self._forget()
        self._marked = None
        if self._is_quick:
            self.fall_behind()
            return None
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
        self._is_behind = False
        return self._paint_whole()

    @property
    def is_labelled(self) -> bool:
        """Whether anything is marked: then every voxel has a label."""
        return bool((self.lowest_mark >= 0).any())

    def label_counts(self) -> Int64:
        """Number of voxels of each label, int64, shape (256,); flats are divided for it, and labels stay put off."""
        self.finish_dividing()
        if self.is_settled:
            found: Int64 = count_values(self.labels.reshape(-1))
            return found
        if self._is_behind:
            return self._solution().label_counts(self.tree, self._way_down, self.marks.reshape(-1))
        _, ways, _, offsets = self._way_down
        return count_labels(*self.tree.voxels, ways, offsets, self.marks.reshape(-1), self.lowest_mark, self.foot_label)

    def painted_counts(self) -> Int64:
        """Number of voxels that are painted with each label, int64, shape (256,)."""
        if self._painted_counts is None:
            self._painted_counts = count_values(self.painted.reshape(-1))
        return self._painted_counts.copy()

    def settle(self) -> None:
        """Work out all labels that were put off."""
        self.finish_dividing()
        self._fill_feet()
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
        inside = (within(box, self.labels.shape) for box in boxes)
        boxes = [box for box in inside if self.put_off[tiles_around(box)].any()]
        if not boxes:
            return
        bounds = np.array([[[one.start, one.stop] for one in box] for box in boxes], np.int64)
        low, high = bounds[..., 0], bounds[..., 1]
        if (high - low).prod(axis=1).sum() <= MOST_ONE_BY_ONE:
            self.settle_voxels(voxels_in(low, high, self.labels.shape))
        else:
            self._paint_boxes(low, high, changed)
        for box in boxes:
            if all(
                one.start % TILE == 0 and one.stop == min(one.start + TILE, n)
                for one, n in zip(box, self.labels.shape, strict=True)
            ):
                self.put_off[tiles_around(box)] = False
        self.stamps[changed] = self.stamps.max() + 1

    def settle_sight(self, sight: Sight) -> None:
        """Work out the labels that a plane shows; no tile is settled by that."""
        if self.put_off[sight.tiles].any():
            self.settle_voxels(sight.voxel, sight.basin)

    def settle_voxels(self, voxels: Int64, basins: Int32 | None = None) -> None:
        """Work out the labels of voxels, flat indices, whose basins may be known; no tile is settled by that."""
        changed = np.zeros_like(self.put_off)
        self._paint_voxels(voxels, self.tree.basin.ravel()[voxels] if basins is None else basins, changed)
        self.stamps[changed] = self.stamps.max() + 1

    @property
    def _landscape(self) -> tuple[Int32, UInt8, Int32, Int64]:
        """Bits of the heights, directions, basins and offsets of sides, flat."""
        tree = self.tree
        bits, offsets = tree.height.view(np.int32).ravel(), side_offsets(tree.height.shape)
        return bits, tree.direction.ravel(), tree.basin.ravel(), offsets

    @property
    def _way_down(self) -> tuple[Int32, UInt8, Int32, Int64]:
        """The same for what only asks for labels: ways down end at flat minima."""
        bits, _, basin, offsets = self._landscape
        return bits, self.tree.ways.ravel(), basin, offsets

    @property
    def is_settled(self) -> bool:
        """Whether all labels are worked out."""
        return not (self.is_dividing or self._is_behind or self.put_off.any())

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
        self._fill_feet()

    def fill_some(self, most: int = FILLED_AT_ONCE) -> bool:
        """Work out some of the marks or of so many feet that were put off; whether there were any."""
        if self.is_dividing:
            # who asks is told by the tiles that are put off
            self._divide(DIVIDED_IN_PAUSES, most_painted=-1)
            return True
        return self._fill_some_feet(most)

    def _divide(self, most: int, most_painted: int | None = None) -> Box | None:
        """Divide flat minima on by so many voxels; the box in which labels changed."""
        if self._division is None:
            return None
        groups = self._division.go_on(self.painted.reshape(-1), self.marks.reshape(-1), most)
        return self._mark(groups, most_painted)

    def _fill_feet(self) -> None:
        while self._fill_some_feet(self.tree.basin_count):
            pass

    def _fill_some_feet(self, most: int) -> bool:
        if not self._is_behind:
            return False
        if self._filling is None:
            self._filling = Filling(self._solution())
        if self._filling.go_on(most):
            self.foot_label, self.foot_level = self._filling.foot_label, self._filling.foot_level
            self._is_behind = False
            self._parted = self._filling = self._feet_now = None
        return True

    @property
    def _may_fall_behind(self) -> bool:
        return self.puts_off and self.tree.basin_count >= BEHIND_FROM

    @property
    def _is_quick(self) -> bool:
        """Whether solving anew is quick, and passes over all basins are put off."""
        return self._may_fall_behind and len(self._known_marked()) <= FEW_MARKED * self.tree.basin_count

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
        self._forget()
        self._is_behind = True
        self.put_off[:] = True
        self.put_off_times += 1

    def _forget(self) -> None:
        """Forget what followed from markers that are others now."""
        self._parted = self._filling = self._feet_now = self._table = None

    def _known_marked(self) -> Int64:
        """Basins that may be marked, ascending: no others are."""
        if self._marked is None:
            self._marked = np.flatnonzero(self.lowest_mark >= 0)
        return self._marked

    def _marked_basins(self) -> Int64:
        known = self._known_marked()
        return known[self.lowest_mark[known] >= 0]

    def _solution(self) -> PartedForest:
        """The forest of these markers."""
        if self._parted is None:
            marks = self.marks.reshape(-1)
            self._parted = solve_parted(self.tree, self._landscape, marks, self.lowest_mark, self._marked_basins())
        return self._parted

    def _feet(self) -> UInt8:
        """Label of each basin's foot."""
        if not self._is_behind:
            return self.foot_label
        if self._feet_now is None:
            self._feet_now = np.empty(self.tree.basin_count, np.uint8)
            self._solution().fill_labels(self._feet_now)
        return self._feet_now

    def _paint_basins(self, changed: Int64, most_at_once: int | None) -> Box | None:
        """Paint basins that changed, or put that off where they hold more voxels; the box in which labels changed."""
        tree = self.tree
        first_voxel, voxel_list = tree.voxels
        count = int((first_voxel[changed + 1] - first_voxel[changed]).sum())
        if self.puts_off and count > (MOST_AT_ONCE if most_at_once is None else most_at_once):
            self.put_off_times += 1
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
            tree.ways.ravel(),
            side_offsets(tree.height.shape),
            self.marks.reshape(-1),
            self.lowest_mark,
            self.foot_label,
            self.labels.reshape(-1),
            self.labels.shape,
        )
        return as_box(low, high)

    def _paint_voxels(self, voxels: Int64, basins: Int32, changed: Bool) -> None:
        """Label some voxels of these basins; notes tiles in which that changed any. No table of all basins is made."""
        none = np.empty(0, np.int32)
        solved = self._solution() if self._is_behind else None
        feet = (solved.hanging.place, solved.group, solved.label) if solved else (none, none, self.foot_label)
        marks, labels = self.marks.reshape(-1), self.labels.reshape(-1)
        paint_sight(voxels, basins, feet, self._way_down, marks, self.lowest_mark, labels, self.labels.shape, changed)

    def _paint_boxes(self, low: Int64, high: Int64, changed: Bool) -> None:
        """The same for all voxels of boxes, side by side."""
        feet = self._feet()
        if self._table is None:
            self._table = feet.copy()
            self._table[self._marked_basins()] = MARKED_BASIN
        way_down, marks = self._way_down[1:], self.marks.reshape(-1)
        paint_boxes(*in_parts(low, high), self._table, *way_down, marks, feet, self.labels, changed)

    def _paint_whole(self) -> Box | None:
        self.stamps[self.put_off] = self.stamps.max() + 1
        self.put_off[:] = False
        rows = row_chunks(self.labels.shape)
        low, high = paint_rows(
            rows,
            self.tree.ways.ravel(),
            self.tree.basin.ravel(),
            side_offsets(self.labels.shape),
            self.marks.ravel(),
            self.lowest_mark,
            self.foot_label,
            self.labels,
        )
        return as_box(low.min(axis=0), high.max(axis=0))


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
