"""Division of flat minima that several labels mark: each voxel goes to the marked one at the least distance.

The *distance* of a marked voxel is 1. That of every other one is the least over its neighbours of the neighbour's own
and the cost of the step: the voxel's cost times that of the axis, both of the tree. Its label is that of the neighbour
that gives this distance, of several the one with the lowest index. These are shortest ways, as Dijkstra finds them
(Numerische Mathematik 1, 1959), in buckets by their lengths (Dial, Communications of the ACM 12, 1969), or, where a
stroke changes them, from it outwards (:mod:`heartcase.pipeline.watershed.flat_minima.mending`).
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from typing import Protocol

import numpy as np

from heartcase.pipeline.data import UNMARKED
from heartcase.pipeline.kernels.counting import count_values
from heartcase.pipeline.watershed.flat_minima.division_kernels import (
    CONTESTED,
    FAR,
    divide_flat,
    lowest_in_flat,
    mark_flat,
    others_in_flat,
    voxels_of_flat,
)
from heartcase.pipeline.watershed.flat_minima.mending import ALL, Mending
from heartcase.schemas.arrays import Float32, Int16, Int32, Int64, UInt8, UInt16

__all__ = ["Division", "divided_flats"]

FARTHEST = 2**31 - 2**20
"""A flat with larger distances is divided, and not mended but divided anew."""

CHUNKS = 16
SMALL_SHARE = 0.05
"""Share of all voxels up to which a flat's own are looked at one by one: they lie scattered."""

Groups = Sequence[tuple[int, Int64]]
"""Voxels, flat indices, by the label that they get: first 255, none."""
Change = tuple[Int64, UInt8]
"""Voxels, flat indices, and a label of each; 255 for none."""


class FlatTree(Protocol):
    """What a division takes of a tree of basins: see :class:`heartcase.pipeline.watershed.tree.BasinTree`."""

    @property
    def height(self) -> Float32: ...
    @property
    def basin(self) -> Int32: ...
    @property
    def root(self) -> Int64: ...
    @property
    def flat(self) -> Int32: ...
    @property
    def voxels(self) -> tuple[Int64, Int32]: ...
    @property
    def costs(self) -> tuple[UInt16, Int64]: ...
    @property
    def largest_cost(self) -> int: ...
    def flat_of(self, voxels: Int64, /) -> Int32: ...


_NOTHING: Change = np.empty(0, np.int64), np.empty(0, np.uint8)


@dataclass
class Division:
    """How the contested flat minima are divided. Every voxel of theirs has a mark."""

    tree: FlatTree
    """The tree of the landscape."""
    flat_label: Int16
    """Label that marks each flat minimum: -1 none, -2 several; made to fit what is painted."""
    distance: Int32
    """Distance of each voxel of the flats in ``counts``, int32, shape (voxels,); 0 outside of all divided flats."""
    counts: dict[int, Int64] = field(default_factory=dict)
    """Number of painted voxels of each label, int64, shape (256,), by the number of the flat."""
    far: set[int] = field(default_factory=set)
    """Flats of ``counts`` with distances that cannot be noted."""
    whole: set[int] = field(default_factory=set)
    """Flats of ``counts`` that only one label marks any more, without distances."""

    begun: list[Int64] = field(default_factory=list)
    """The first voxel of each basin of large flats that were marked just now, with the one label that they had."""

    def __post_init__(self) -> None:
        """Begin with nothing to be mended."""
        self._mendings: dict[int, Mending] = {}

    @classmethod
    def of_none(cls, tree: FlatTree, flat_label: Int16) -> Division:
        """With no flat divided yet."""
        # nobody touches what is in no contested flat, so that costs no memory
        return cls(tree, flat_label, np.zeros(tree.height.size, np.int32))

    def copy(self, flat_label: Int16) -> Division:
        """The same with arrays of its own, and the flats' labels that are given; nothing may have to be mended."""
        counts = {one: count.copy() for one, count in self.counts.items()}
        return Division(self.tree, flat_label, self.distance.copy(), counts, set(self.far), set(self.whole))

    @property
    def is_busy(self) -> bool:
        """Whether marks have still to follow from what was painted."""
        return bool(self._mendings)

    @property
    def is_done(self) -> bool:
        """Whether the marks are those that a division from the beginning gives."""
        return not (self.is_busy or self.whole)

    def redivided(
        self, painted: UInt8, marks: UInt8, voxels: Int64, before: UInt8, *, is_put_off: bool
    ) -> Iterator[Groups]:
        """What changes with strokes that lie in contested flat minima, among others.

        Parameters
        ----------
        painted
            Label of each painted voxel, the strokes' among them; 255 elsewhere; one-dimensional.
        marks
            The same from before the strokes, with contested flat minima divided. Each answer has to be written to it
            before the next is asked for.
        voxels
            Flat indices of the voxels that were painted or erased, each once.
        before
            What they were painted with before.
        is_put_off
            Whether what changes around the strokes is left to :meth:`go_on`.
        """
        number = self.tree.flat_of(voxels)
        flats = np.unique(number[number >= 0]).tolist()
        strokes = {one: (voxels[number == one], before[number == one]) for one in flats}
        counts = {
            one: self.counts[one] + _counts(painted[inside]) - _counts(was)
            for one, (inside, was) in strokes.items()
            if one in self.counts
        }
        changes: list[Change] = []
        again: dict[int, Change] = {}
        for one, count in counts.items():
            inside, was = strokes[one]
            if one not in self._mendings:
                continue
            if np.count_nonzero(count) < 2:
                # all of it gets the same mark
                del self._mendings[one]
            elif (painted[inside][was != UNMARKED] == UNMARKED).any():
                change, again[one] = self._mendings.pop(one).take_back(marks)
                changes.append(change)
        if changes:
            yield _groups(changes)
        plain = voxels[number < 0]
        changes = [(plain, painted[plain])]
        for one, stroke in strokes.items():
            if one in counts:
                change, fed = self._go_on_dividing(one, counts[one], stroke, painted, marks, is_put_off)
            elif _stays_whole(one, painted[stroke[0]], self.flat_label):
                change, fed = (stroke[0], painted[stroke[0]]), _NOTHING
            else:
                change, fed = self._begin(one, stroke, painted, marks, is_put_off)
            changes.append(change)
            change = self._fed(one, [again.get(one, _NOTHING), fed], painted, marks)
            # else these are among those that follow
            if is_put_off:
                changes.append(change)
        if not is_put_off:
            changes += self._gone_on(painted, marks, ALL)
        yield _groups(changes)

    def go_on(self, painted: UInt8, marks: UInt8, most: int = ALL) -> Groups:
        """What changes as so many voxels, at most, get their marks; with nothing left, as flats become undivided.

        Parameters
        ----------
        painted, marks
            As in :meth:`redivided`, as they are now, one-dimensional. The answer has to be written to ``marks``.
        most
            Number of voxels.
        """
        if not self.is_busy:
            return _groups([self._anew(one, painted, marks) for one in sorted(self.whole)])
        return _groups(self._gone_on(painted, marks, most))

    def _gone_on(self, painted: UInt8, marks: UInt8, most: int) -> list[Change]:
        changes = []
        # what is soon done first
        for one, mending in sorted(self._mendings.items(), key=lambda item: (item[1].waiting_count, item[0])):
            if most <= 0:
                break
            mended = mending.go_on(painted, marks, most)
            most -= mended.count
            changes.append(self._anew(one, painted, marks) if mended.is_too_far else (mended.voxels, mended.labels))
            if mended.is_too_far or not mending.is_busy:
                del self._mendings[one]
        return changes

    def _fed(self, number: int, strokes: Sequence[Change], painted: UInt8, marks: UInt8) -> Change:
        """Begin to mend a flat from voxels, with what they were painted with before: what changes at once."""
        voxels, before = _joined(strokes)
        # of several, what was painted first
        voxels, first = np.unique(voxels, return_index=True)
        is_other = painted[voxels] != before[first]
        if not is_other.any():
            return _NOTHING
        tree = self.tree
        if number not in self._mendings:
            self._mendings[number] = Mending(tree.height.shape, *tree.costs, self.distance, FARTHEST)
        return self._mendings[number].feed(voxels[is_other], before[first][is_other], painted, marks)

    def _begin(
        self, number: int, stroke: Change, painted: UInt8, marks: UInt8, is_put_off: bool
    ) -> tuple[Change, Change]:
        """Divide a flat that one label had, or none: what changes at once, and what is to be mended from."""
        inside, was = stroke
        seeds = self._painted_in(number, painted)
        count = _counts(painted[seeds])
        earlier = count - _counts(painted[inside]) + _counts(was)
        labels, label = np.flatnonzero(count), int(self.flat_label[number])
        if len(labels) == 1 and not earlier.any():
            # all that was marked with the label that is noted was erased before
            self.flat_label[number] = labels[0]
            return (inside, painted[inside]), _NOTHING
        if not (is_put_off and len(labels) > 1 and label >= 0 and earlier[label]):
            return self._anew(number, painted, marks), _NOTHING
        self.flat_label[number] = CONTESTED
        self.counts[number] = count
        return self._marked(number, label, painted, marks), _new(seeds)

    def _go_on_dividing(
        self, number: int, count: Int64, stroke: Change, painted: UInt8, marks: UInt8, is_put_off: bool
    ) -> tuple[Change, Change]:
        """The same for a divided flat that has so many painted voxels of each label now."""
        labels, before, was_whole = np.flatnonzero(count), self.counts[number], number in self.whole
        if len(labels) == 0 or (number in self.far and len(labels) > 1) or not (is_put_off or len(labels) > 1):
            return self._anew(number, painted, marks), _NOTHING
        self.counts[number] = count
        if len(labels) == 1:
            self.far.discard(number)
            self.whole.add(number)
            return self._others(number, int(labels[0]), marks), _NOTHING
        if not was_whole:
            return _NOTHING, stroke
        self.whole.remove(number)
        label = int(np.flatnonzero(before)[0])
        return self._marked(number, label, painted, marks), _new(self._painted_in(number, painted))

    def _painted_in(self, number: int, painted: UInt8) -> Int64:
        """Flat indices of a flat's painted voxels, ascending."""
        if self._is_small(number):
            every = np.sort(self._voxels_of(number))
            inside: Int64 = every[painted[every] != UNMARKED]
        else:
            every = np.flatnonzero(painted != UNMARKED)
            inside = every[self.tree.flat_of(every) == number]
        return inside

    def _marked(self, number: int, label: int, painted: UInt8, marks: UInt8) -> Change:
        """Mark a flat that has one label: what changes by that, and is not noted in :attr:`begun`."""
        if self._is_small(number):
            inside = self._voxels_of(number)
            self.distance[inside] = FAR
            # painted voxels get their own marks
            inside = inside[(marks[inside] == UNMARKED) & (painted[inside] == UNMARKED)]
            return inside, np.full(len(inside), label, np.uint8)
        basins, *landscape = self._landscape(number)
        chunks = np.linspace(0, marks.size, CHUNKS + 1).astype(np.int64)
        mark_flat(chunks, *landscape, label, marks, self.distance)
        bits, *_, level = landscape
        self.begun.append(lowest_in_flat(basins, *self.tree.voxels, bits, level))
        return _NOTHING

    def _others(self, number: int, label: int, marks: UInt8) -> Change:
        """Voxels of a flat with other marks, and the label for them."""
        if self._is_small(number):
            others = self._voxels_of(number)
            others = others[marks[others] != label]
        else:
            _, *landscape = self._landscape(number)
            others = others_in_flat(*landscape, label, marks)
        return others, np.full(len(others), label, np.uint8)

    def _is_small(self, number: int) -> bool:
        """Whether looking at a flat's voxels is quicker than looking through all."""
        first_voxel, _ = self.tree.voxels
        basins = np.flatnonzero(self.tree.flat == number)
        return bool((first_voxel[basins + 1] - first_voxel[basins]).sum() < SMALL_SHARE * self.distance.size)

    def _voxels_of(self, number: int) -> Int64:
        """Flat indices of a flat's voxels."""
        tree, bits = self.tree, self.tree.height.view(np.int32).ravel()
        voxels: Int64 = voxels_of_flat(np.flatnonzero(tree.flat == number), *tree.voxels, bits, tree.root)
        return voxels

    def _landscape(self, number: int) -> tuple[Int64, Int32, Int32, Int32, int, np.int32]:
        """A flat's basins; heights as bits and basins of all voxels, flats of all basins, its number and level."""
        tree, bits = self.tree, self.tree.height.view(np.int32).ravel()
        basins = np.flatnonzero(tree.flat == number)
        return basins, bits, tree.basin.ravel(), tree.flat, number, bits[tree.root[basins[0]]]

    def _anew(self, number: int, painted: UInt8, marks: UInt8) -> Change:
        """Divide a flat from the beginning, or leave it whole where fewer than two labels mark it: what changes."""
        self.counts.pop(number, None)
        self.far.discard(number)
        self.whole.discard(number)
        inside = self._voxels_of(number)
        before = marks[inside]
        marks[inside] = painted[inside]
        seeds = np.sort(inside[painted[inside] != UNMARKED])
        labels = np.unique(painted[seeds])
        self.flat_label[number] = CONTESTED if len(labels) > 1 else [-1, *labels.tolist()][-1]
        self.distance[inside] = 0
        if len(labels) > 1:
            self.divide(number, seeds, marks)
        after = marks[inside]
        marks[inside] = before
        return inside[after != before], after[after != before]

    def divide(self, number: int, seeds: Int64, marks: UInt8) -> None:
        """Divide a flat among its painted voxels, ascending flat indices; it has no other marks, and no distances."""
        tree, count = self.tree, _counts(marks[seeds])
        bits = tree.height.view(np.int32).ravel()
        is_known = divide_flat(
            bits, tree.height.shape, *tree.costs, tree.largest_cost, seeds, marks, self.distance, FARTHEST
        )
        self.counts[number] = count
        if not is_known:
            self.far.add(number)


def divided_flats(tree: FlatTree, marks: UInt8, flat_label: Int16, voxels: Int64) -> Division | None:
    """Divide all contested flat minima, in place; None where there is none.

    Parameters
    ----------
    tree
        The tree of the landscape.
    marks
        Label of each painted voxel; 255 elsewhere. It is painted on.
    flat_label
        Label that marks each flat minimum: -1 none, -2 several.
    voxels
        Flat indices of the marked voxels, ascending.
    """
    contested = np.flatnonzero(flat_label == CONTESTED)
    if not len(contested):
        return None
    division = Division.of_none(tree, flat_label)
    number = tree.flat_of(voxels)
    for one in contested.tolist():
        division.divide(one, voxels[number == one], marks.reshape(-1))
    return division


def _stays_whole(number: int, painted: UInt8, flat_label: Int16) -> bool:
    """Whether no more than one label marks a flat, with voxels in it painted so, or erased (255); notes the label."""
    labels = np.unique(painted[painted != UNMARKED])
    if flat_label[number] == CONTESTED or len(labels) > 1:
        return False
    if flat_label[number] == -1 and len(labels):
        flat_label[number] = labels[0]
    return not len(labels) or bool(labels[0] == flat_label[number])


def _counts(values: UInt8) -> Int64:
    """How many of each label there are, int64, shape (256,)."""
    return np.bincount(values[values != UNMARKED], minlength=256)


def _new(seeds: Int64) -> Change:
    """Painted voxels of a flat without distances: as if none of them had been painted before."""
    return seeds, np.full(len(seeds), UNMARKED, np.uint8)


def _joined(changes: Sequence[Change]) -> Change:
    """All of these in one."""
    voxels, values = zip(*changes, strict=True)
    return np.concatenate(voxels), np.concatenate(values)


def _groups(changes: Sequence[Change]) -> Groups:
    """Voxels by the label that they get."""
    voxels, values = _joined(changes)
    labels = np.flatnonzero(count_values(values))[::-1].tolist()
    return [(one, voxels if len(labels) == 1 else voxels[values == one]) for one in labels]
