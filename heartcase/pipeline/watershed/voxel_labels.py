"""The labels of all voxels, and of the feet that they follow from: worked out, or put off until somebody asks.

A voxel has the label of the first marked voxel on its way down, or that of its basin's foot. So its label can be looked
up alone, whenever it is needed. Where the labels of many voxels may have changed, the tiles that hold them are noted,
and their labels are worked out later: those first that are seen first. Where few basins are marked, the feet wait too:
what they have is looked up in a parted forest (:mod:`heartcase.pipeline.watershed.hanging`) until it is written out.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from heartcase.pipeline.kernels.counting import count_values
from heartcase.pipeline.watershed.boxes import Box, as_box, in_parts, tiles_around, voxels_in, within
from heartcase.pipeline.watershed.descent import row_chunks, side_offsets
from heartcase.pipeline.watershed.hanging import Filling, PartedForest, solve_parted
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
from heartcase.pipeline.watershed.tree import BasinTree
from heartcase.schemas.arrays import Bool, Int32, Int64, UInt8

__all__ = ["Feet", "VoxelLabels"]

MOST_AT_ONCE = 100_000
"""Voxels in basins that changed that are painted at once where painting may be put off."""
MOST_LISTED = 300_000
"""Voxels in basins that changed up to which their tiles are looked up; with more, all are painted anew."""
MOST_ONE_BY_ONE = 50_000
"""Voxels of boxes up to which the labels of these alone are looked up; with more, a table of all basins is worth it."""
WHOLE_SHARE = 0.15
"""Share of the voxels in basins that changed from which on all voxels are painted anew: rows are quicker than lists."""


@dataclass
class Feet:
    """The feet of all basins for a set of marks.

    Who changes the marks calls :meth:`forget`, and then mends labels and levels in place, or calls :meth:`put_off`.
    """

    tree: BasinTree
    """The tree of the landscape."""
    marks: UInt8
    """Label of each marked voxel, with contested flat minima divided, uint8, shape [z, y, x]; 255 elsewhere."""
    lowest_mark: Int64
    """Flat index of each basin's lowest marked voxel, int64, shape (basins,); -1 without any."""
    label: UInt8
    """Label of each foot, uint8, shape (basins,); of earlier marks where they are put off."""
    level: Int64
    """Key of the highest face on each foot's way to its marked voxel, int64, shape (basins,); 0 where that is its
    lowest voxel; of earlier marks where they are put off."""
    is_put_off: bool = False
    """Whether labels and levels are of earlier marks: those of now follow from what is parted."""
    _parted: PartedForest | None = None
    _filling: Filling | None = None
    _label_now: UInt8 | None = None
    _table: UInt8 | None = None
    _marked: Int64 | None = None

    def copy(self) -> Feet:
        """The same with arrays of its own; they have to be worked out."""
        names = ("marks", "lowest_mark", "label", "level")
        return replace(self, **{name: getattr(self, name).copy() for name in names})

    def forget(self, basins: Int64 | None) -> None:
        """Forget what followed from marks that are others now, or are about to be.

        Parameters
        ----------
        basins
            The basins that get marks or lose some, int64; None has all basins looked through once it matters.
        """
        self._forget()
        self._marked = None if basins is None else np.union1d(self.maybe_marked(), basins)

    def put_off(self) -> None:
        """Leave labels and levels that follow from other marks to whoever asks for them."""
        self._forget()
        self.is_put_off = True

    def _forget(self) -> None:
        self._parted = self._filling = self._label_now = self._table = None

    def fill(self) -> None:
        """Work out all labels and levels that were put off."""
        while self.fill_some(self.tree.basin_count):
            pass

    def fill_some(self, most: int) -> bool:
        """Work out so many of the labels and levels that were put off; whether there were any."""
        if not self.is_put_off:
            return False
        if self._filling is None:
            self._filling = Filling(self._solution())
        if self._filling.go_on(most):
            self.label, self.level = self._filling.foot_label, self._filling.foot_level
            self.is_put_off = False
            self._parted = self._filling = self._label_now = None
        return True

    def maybe_marked(self) -> Int64:
        """Basins that may be marked, int64, ascending: no others are."""
        if self._marked is None:
            self._marked = np.flatnonzero(self.lowest_mark >= 0)
        return self._marked

    def _marked_basins(self) -> Int64:
        known = self.maybe_marked()
        return known[self.lowest_mark[known] >= 0]

    @property
    def landscape(self) -> tuple[Int32, UInt8, Int32, Int64]:
        """Bits of the heights, int32, directions, uint8, basins, int32, and offsets of sides, int64, all flat."""
        tree = self.tree
        bits, offsets = tree.height.view(np.int32).ravel(), side_offsets(tree.height.shape)
        return bits, tree.direction.ravel(), tree.basin.ravel(), offsets

    @property
    def way_down(self) -> tuple[Int32, UInt8, Int32, Int64]:
        """The same for what only asks for labels: ways down end at flat minima."""
        bits, _, basin, offsets = self.landscape
        return bits, self.tree.ways.ravel(), basin, offsets

    def _solution(self) -> PartedForest:
        """The forest of these marks."""
        if self._parted is None:
            marks = self.marks.reshape(-1)
            self._parted = solve_parted(self.tree, self.landscape, marks, self.lowest_mark, self._marked_basins())
        return self._parted

    def label_now(self) -> UInt8:
        """Label of each foot, uint8, shape (basins,), of these marks."""
        if not self.is_put_off:
            return self.label
        if self._label_now is None:
            self._label_now = np.empty(self.tree.basin_count, np.uint8)
            self._solution().fill_labels(self._label_now)
        return self._label_now

    def table(self) -> UInt8:
        """The same, with ``MARKED_BASIN`` where a basin is marked: there it depends on the voxel."""
        if self._table is None:
            self._table = self.label_now().copy()
            self._table[self._marked_basins()] = MARKED_BASIN
        return self._table

    def tables_for_few(self) -> tuple[Int32, Int32, UInt8]:
        """What :func:`paint_sight` takes as ``feet``: quicker at hand than the label of every foot."""
        if not self.is_put_off:
            none = np.empty(0, np.int32)
            return none, none, self.label
        solved = self._solution()
        return solved.hanging.place, solved.group, solved.label

    def label_counts(self) -> Int64:
        """Number of voxels that have each label by these marks, int64, shape (256,)."""
        marks = self.marks.reshape(-1)
        if self.is_put_off:
            return self._solution().label_counts(self.tree, self.way_down, marks)
        _, ways, _, offsets = self.way_down
        return count_labels(*self.tree.voxels, ways, offsets, marks, self.lowest_mark, self.label)


class VoxelLabels:
    """The labels of all voxels, and in which tiles they are put off.

    Parameters
    ----------
    feet
        What they follow from. Who changes it paints the basins that changed, or puts all off.
    labels
        Label of each voxel, uint8, shape [z, y, x]: painted in place.
    """

    def __init__(self, feet: Feet, labels: UInt8) -> None:
        self._feet = feet
        self.labels = labels
        """Label of each voxel, uint8, shape [z, y, x]; in a tile that is put off, of some earlier moment."""
        self.put_off: Bool = np.zeros([-(-n // TILE) for n in labels.shape], np.bool_)
        """Which tiles are put off, bool, shape [z, y, x] of tiles of 32 voxels along each side."""
        self.stamps: Int64 = np.zeros(self.put_off.shape, np.int64)
        """By tile, int64: higher, the later it was that a label which was put off turned out to be another one."""
        self.put_off_times = 0
        """How often labels were put off so far."""

    def copy(self, feet: Feet) -> VoxelLabels:
        """The same for a copy of the feet, with an array of its own; all labels have to be worked out."""
        copied = VoxelLabels(feet, self.labels.copy())
        copied.put_off_times = self.put_off_times
        return copied

    @property
    def is_settled(self) -> bool:
        """Whether all labels are worked out."""
        return not (self._feet.is_put_off or self.put_off.any())

    def put_off_all(self) -> None:
        """Leave all labels to whoever asks for them."""
        self.put_off[:] = True
        self.put_off_times += 1

    def label_counts(self) -> Int64:
        """Number of voxels of each label, int64, shape (256,); labels stay put off."""
        if not self.is_settled:
            return self._feet.label_counts()
        found: Int64 = count_values(self.labels.reshape(-1))
        return found

    def settle(self) -> None:
        """Work out all labels that were put off, and those of all feet."""
        self._feet.fill()
        if self.put_off.any():
            self.paint_whole()

    def settle_boxes(self, boxes: Sequence[Box]) -> None:
        """Work out the labels in some boxes [z, y, x]; what was put off elsewhere stays so.

        Parameters
        ----------
        boxes
            What lies outside of the volume is left out. A tile is settled where one of them is all of it.
        """
        inside = (within(box, self.labels.shape) for box in boxes)
        boxes = [box for box in inside if self.put_off[tiles_around(box)].any()]
        if not boxes:
            return
        bounds = np.array([[[one.start, one.stop] for one in box] for box in boxes], np.int64)
        low, high = bounds[..., 0], bounds[..., 1]
        if (high - low).prod(axis=1).sum() <= MOST_ONE_BY_ONE:
            self.settle_voxels(voxels_in(low, high, self.labels.shape))
        else:
            self._paint_boxes(low, high)
        for box in boxes:
            if all(
                one.start % TILE == 0 and one.stop == min(one.start + TILE, n)
                for one, n in zip(box, self.labels.shape, strict=True)
            ):
                self.put_off[tiles_around(box)] = False

    def settle_sight(self, sight: Sight) -> None:
        """Work out the labels that a plane shows; no tile is settled by that."""
        if self.put_off[sight.tiles].any():
            self.settle_voxels(sight.voxel, sight.basin)

    def settle_voxels(self, voxels: Int64, basins: Int32 | None = None) -> None:
        """Work out the labels of some voxels, without a table of all basins; no tile is settled by that.

        Parameters
        ----------
        voxels
            Flat indices, int64.
        basins
            Basin of each, int32; looked up when left out.
        """
        feet, changed = self._feet, np.zeros_like(self.put_off)
        if basins is None:
            basins = feet.tree.basin.ravel()[voxels]
        paint_sight(
            voxels,
            basins,
            feet.tables_for_few(),
            feet.way_down,
            feet.marks.reshape(-1),
            feet.lowest_mark,
            self.labels.reshape(-1),
            self.labels.shape,
            changed,
        )
        self._stamp(changed)

    def paint_basins(self, basins: Int64, *, puts_off: bool, most_at_once: int | None = None) -> Box | None:
        """Paint basins that changed, or put that off.

        Parameters
        ----------
        basins
            Their numbers, int64, each once.
        puts_off
            Whether it is put off where they hold many voxels. Where not, the feet have to be worked out.
        most_at_once
            Number of voxels that are painted all the same; 100,000 when left out.

        Returns
        -------
        Box or None
            Box in which labels changed; None where none did so far.
        """
        feet = self._feet
        tree = feet.tree
        first_voxel, voxel_list = tree.voxels
        count = int((first_voxel[basins + 1] - first_voxel[basins]).sum())
        if puts_off and count > (MOST_AT_ONCE if most_at_once is None else most_at_once):
            self.put_off_times += 1
            if count > MOST_LISTED:
                self.put_off[:] = True
            else:
                tiles_of(basins, first_voxel, voxel_list, self.labels.shape, self.put_off)
            return None
        if count > WHOLE_SHARE * self.labels.size:
            return self.paint_whole()
        low, high = paint_basins(
            basins,
            first_voxel,
            voxel_list,
            tree.ways.ravel(),
            side_offsets(tree.height.shape),
            feet.marks.reshape(-1),
            feet.lowest_mark,
            feet.label,
            self.labels.reshape(-1),
            self.labels.shape,
        )
        return as_box(low, high)

    def paint_whole(self) -> Box | None:
        """Paint all voxels, from feet that are worked out; the box in which labels changed."""
        feet, tree = self._feet, self._feet.tree
        self._stamp(self.put_off)
        self.put_off[:] = False
        rows = row_chunks(self.labels.shape)
        low, high = paint_rows(
            rows,
            tree.ways.ravel(),
            tree.basin.ravel(),
            side_offsets(self.labels.shape),
            feet.marks.ravel(),
            feet.lowest_mark,
            feet.label,
            self.labels,
        )
        return as_box(low.min(axis=0), high.max(axis=0))

    def _paint_boxes(self, low: Int64, high: Int64) -> None:
        """Paint all voxels of boxes, from ``low`` to ``high`` - 1 (z, y, x), side by side."""
        feet, changed = self._feet, np.zeros_like(self.put_off)
        way_down, marks = feet.way_down[1:], feet.marks.reshape(-1)
        paint_boxes(*in_parts(low, high), feet.table(), *way_down, marks, feet.label_now(), self.labels, changed)
        self._stamp(changed)

    def _stamp(self, tiles: Bool) -> None:
        """Note that labels in some tiles turned out to be others just now."""
        self.stamps[tiles] = self.stamps.max() + 1
