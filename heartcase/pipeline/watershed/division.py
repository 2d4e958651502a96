"""Division of flat minima that several labels mark: half way, by steps (a first-in first-out flood), and its mending.

A marked voxel is at step 1, and every other one a step more than its nearest neighbour. Its label is that of its
neighbour one step nearer, of several the one with the lowest index. So what a stroke changes is found from it outwards,
in the order of the steps, and all else in the flat stays: a stroke in a million flat voxels costs what it changes.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np

from heartcase.compiling.calls import copied
from heartcase.compiling.kernel import kernel
from heartcase.pipeline.data import UNMARKED
from heartcase.pipeline.watershed.marks import CONTESTED
from heartcase.schemas.arrays import Int16, Int64, UInt8, UInt16

if TYPE_CHECKING:
    from heartcase.pipeline.watershed.tree import BasinTree

__all__ = ["Division", "divided_flats", "redivided"]

FAR = 65535
"""Step of a voxel that no marked one reaches yet."""
MOST_STEPS = 65_000
"""A flat with more steps is divided, and not mended but divided anew."""


@dataclass
class Division:
    """How the contested flat minima are divided."""

    step: UInt16
    """Step of each voxel of the flats in ``counts``, uint16, shape (voxels,); anything elsewhere."""
    counts: dict[int, Int64] = field(default_factory=dict)
    """Number of marked voxels of each label, int64, shape (256,), by the number of the flat."""

    def copy(self) -> Division:
        """The same with arrays of its own."""
        return Division(self.step.copy(), dict(self.counts))


def divided_flats(tree: BasinTree, marks: UInt8, flat_label: Int16, voxels: Int64) -> Division | None:
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
    # nobody touches what is in no contested flat, so it costs no memory
    division = Division(np.zeros(marks.size, np.uint16))
    number = tree.flat_of(voxels)
    for one in contested.tolist():
        _divide(tree, one, voxels[number == one], marks.reshape(-1), division)
    return division


def redivided(
    tree: BasinTree,
    painted: UInt8,
    marks: UInt8,
    flat_label: Int16,
    strokes: Sequence[tuple[int, Int64]],
    division: Division,
) -> list[tuple[int, Int64]]:
    """Voxels whose marks change with strokes that lie in contested flat minima, by their label: first 255, none.

    Parameters
    ----------
    tree
        The tree of the landscape.
    painted
        Label of each painted voxel, the strokes' among them; 255 elsewhere.
    marks
        The same from before the strokes, with contested flat minima divided; it is so again afterwards.
    flat_label
        Label that marks each flat minimum: -1 none, -2 several; made to fit the strokes.
    strokes
        Label, 255 for none, and flat indices of the voxels that have it now, each voxel once.
    division
        How the flat minima are divided; made to fit the strokes.
    """
    marked, seeded = marks.reshape(-1), painted.reshape(-1)
    voxels = np.concatenate([one for _, one in strokes])
    number = tree.flat_of(voxels)
    changed, values = [voxels[number < 0]], [seeded[voxels[number < 0]]]
    for one in np.unique(number[number >= 0]).tolist():
        inside = np.sort(voxels[number == one])
        if _stays_whole(one, seeded[inside], flat_label):
            changed.append(inside)
            values.append(seeded[inside])
            continue
        found = _mended(tree, one, inside, seeded, marked, division) or _anew(
            tree, one, seeded, marked, flat_label, division
        )
        changed.append(found[0])
        values.append(found[1])
    everywhere, value = np.concatenate(changed), np.concatenate(values)
    return [(one, everywhere[value == one]) for one in sorted({*value.tolist()}, reverse=True)]


def _stays_whole(number: int, painted: UInt8, flat_label: Int16) -> bool:
    """Whether no more than one label marks a flat, with voxels in it painted so, or erased (255); notes the label."""
    labels = np.unique(painted[painted != UNMARKED])
    if flat_label[number] == CONTESTED or len(labels) > 1:
        return False
    if flat_label[number] == -1 and len(labels):
        flat_label[number] = labels[0]
    return not len(labels) or bool(labels[0] == flat_label[number])


def _mended(
    tree: BasinTree, number: int, voxels: Int64, painted: UInt8, marks: UInt8, division: Division
) -> tuple[Int64, UInt8] | None:
    """Voxels of a flat whose marks change, and their labels; None where it has to be divided anew."""
    counts = division.counts.pop(number, None)
    if counts is None:
        return None
    was_painted = voxels[division.step[voxels] == 1]
    now = painted[voxels]
    counts = counts - np.bincount(marks[was_painted], minlength=256)
    counts += np.bincount(now[now != UNMARKED], minlength=256)
    if np.count_nonzero(counts) < 2:
        return None
    changed, values, is_known = _mend_flat(tree.height.shape, voxels, painted, marks, division.step)
    if not is_known:
        return None
    division.counts[number] = counts
    return changed, values


def _anew(
    tree: BasinTree, number: int, painted: UInt8, marks: UInt8, flat_label: Int16, division: Division
) -> tuple[Int64, UInt8]:
    """The same, found by dividing all of it."""
    bits = tree.height.view(np.int32).ravel()
    inside = _voxels_of_flat(np.flatnonzero(tree.flat == number), *tree.voxels, bits, tree.root)
    before = marks[inside]
    marks[inside] = painted[inside]
    seeds = np.sort(inside[painted[inside] != UNMARKED])
    labels = np.unique(painted[seeds])
    flat_label[number] = CONTESTED if len(labels) > 1 else [-1, *labels.tolist()][-1]
    if len(labels) > 1:
        _divide(tree, number, seeds, marks, division)
    after = marks[inside]
    marks[inside] = before
    return inside[after != before], after[after != before]


def _divide(tree: BasinTree, number: int, seeds: Int64, marks: UInt8, division: Division) -> None:
    """Divide one flat among its marked voxels, ascending flat indices; ``marks`` holds no others in it."""
    bits, counts = tree.height.view(np.int32).ravel(), np.bincount(marks[seeds], minlength=256)
    if _divide_flat(bits, tree.height.shape, seeds, marks, division.step):
        division.counts[number] = counts


@copied
def _near(v, per_slice, per_row, shape, found):
    """Neighbours of a voxel in the volume, by ascending index, into ``found``; how many there are."""
    nz, ny, nx = shape
    # exact for any index below 2^29, and much quicker than a division of integers
    k = np.int64((v + 0.5) * per_slice)
    rest = v - k * (nx * ny)
    j = np.int64((rest + 0.5) * per_row)
    i = rest - j * nx
    count = 0
    if k > 0:
        found[count] = v - nx * ny
        count += 1
    if j > 0:
        found[count] = v - nx
        count += 1
    if i > 0:
        found[count] = v - 1
        count += 1
    if i < nx - 1:
        found[count] = v + 1
        count += 1
    if j < ny - 1:
        found[count] = v + nx
        count += 1
    if k < nz - 1:
        found[count] = v + nx * ny
        count += 1
    return count


@kernel
def _divide_flat(bits, shape, voxels, marks, step):
    """Divide a flat minimum among its marked voxels, in place; whether the steps of all its voxels could be noted.

    Parameters
    ----------
    bits, marks, step
        Heights as bits, labels and steps of all voxels, one-dimensional; the last two are written to.
    shape
        Of the volume: (z, y, x).
    voxels
        Flat indices of the marked voxels of the flat, ascending.
    """
    per_slice, per_row = 1.0 / (shape[1] * shape[2]), 1.0 / shape[2]
    shore = voxels
    level = bits[shore[0]]
    near = np.empty(6, np.int64)
    step[shore] = np.uint16(1)
    now = 1
    while len(shore) > 0:
        now += 1
        reached = np.empty(6 * len(shore), np.int64)
        count = 0
        # in ascending order, so that of neighbours equally near the one with the lowest index gives its label
        for v in shore:
            for n in range(_near(v, per_slice, per_row, shape, near)):
                u = near[n]
                # a neighbour as high is of the same flat
                if bits[u] == level and marks[u] == UNMARKED:
                    marks[u] = marks[v]
                    step[u] = np.uint16(min(now, MOST_STEPS))
                    reached[count] = u
                    count += 1
        shore = np.sort(reached[:count])
    return now < MOST_STEPS


@kernel
def _mend_flat(shape, voxels, painted, marks, step):
    """Voxels of a divided flat whose labels change, the labels, and whether the steps are those of now.

    No two flat minima lie side by side: so a neighbour with a step is of the same one.

    Parameters
    ----------
    shape
        Of the volume: (z, y, x).
    voxels
        Flat indices of the voxels that were painted or erased.
    painted
        Labels of the painted voxels as they are now; 255 elsewhere.
    marks, step
        Labels and steps from before; the steps become those of now, the labels stay.
    """
    per_slice, per_row = 1.0 / (shape[1] * shape[2]), 1.0 / shape[2]
    near, beyond = np.empty(6, np.int64), np.empty(6, np.int64)
    # what may get another label: voxels, and their steps
    waiting = [np.int64(0) for _ in range(0)]
    waiting_step = [np.int64(0) for _ in range(0)]
    shore = [np.int64(0) for _ in range(0)]
    for v in voxels:
        if painted[v] != UNMARKED:
            waiting.append(v)
            waiting_step.append(np.int64(1))
        elif step[v] == 1:
            step[v] = np.uint16(FAR)
            shore.append(v)
    # those that nothing leads to any more, outwards
    gone = [np.int64(0) for _ in range(0)]
    now = 1
    while len(shore) > 0:
        further = [np.int64(0) for _ in range(0)]
        for v in shore:
            gone.append(v)
            for n in range(_near(v, per_slice, per_row, shape, near)):
                u = near[n]
                if step[u] != now + 1:
                    continue
                is_led_to = False
                for m in range(_near(u, per_slice, per_row, shape, beyond)):
                    is_led_to = is_led_to or step[beyond[m]] == now
                if is_led_to:
                    waiting.append(u)
                    waiting_step.append(np.int64(now + 1))
                else:
                    step[u] = np.uint16(FAR)
                    further.append(u)
        shore = further
        now += 1
    for v in gone:
        nearest = np.int64(FAR)
        for n in range(_near(v, per_slice, per_row, shape, near)):
            if 0 < step[near[n]] < nearest:
                nearest = np.int64(step[near[n]])
        if nearest < FAR:
            waiting.append(v)
            waiting_step.append(np.int64(nearest + 1))
    order = np.argsort(np.array(waiting_step), kind="mergesort")
    changed = [np.int64(0) for _ in range(0)]
    before = [np.uint8(0) for _ in range(0)]
    # of each voxel of a layer, whether its step is new
    layer = [np.int64(0) for _ in range(0)]
    is_new = [False for _ in range(0)]
    at, now = 0, 1
    while at < len(order) or len(layer) > 0:
        if len(layer) == 0:
            now = waiting_step[order[at]]
        if now >= MOST_STEPS:
            break
        while at < len(order) and waiting_step[order[at]] == now:
            v = waiting[order[at]]
            at += 1
            if step[v] >= now:
                layer.append(v)
                is_new.append(step[v] > now)
                step[v] = np.uint16(now)
        next_layer = [np.int64(0) for _ in range(0)]
        next_new = [False for _ in range(0)]
        for one in range(len(layer)):
            v = layer[one]
            count = _near(v, per_slice, per_row, shape, near)
            label = painted[v]
            if now > 1:
                for n in range(count):
                    if step[near[n]] == now - 1:
                        label = marks[near[n]]
                        break
            is_other = label != marks[v]
            if is_other:
                changed.append(v)
                before.append(marks[v])
                marks[v] = label
            if not (is_other or is_new[one]):
                continue
            for n in range(count):
                u = near[n]
                if step[u] > now:
                    if step[u] > now + 1:
                        step[u] = np.uint16(now + 1)
                        next_layer.append(u)
                        next_new.append(True)
                    elif step[u] == now + 1:
                        next_layer.append(u)
                        next_new.append(False)
        layer, is_new = next_layer, next_new
        now += 1
    found = np.array(changed)
    values = marks[found]
    for n in range(len(found)):
        marks[found[n]] = before[n]
    return found, values, at == len(order) and len(layer) == 0


@kernel
def _voxels_of_flat(basins, first_voxel, voxel_list, bits, root):
    """Flat indices of the voxels of a flat minimum: those at the bottom of its basins.

    Parameters
    ----------
    basins
        Numbers of its basins.
    first_voxel, voxel_list
        The voxels of each basin.
    bits
        Heights as bits, one-dimensional.
    root
        Flat index of each basin's lowest voxel.
    """
    count = 0
    for b in basins:
        count += first_voxel[b + 1] - first_voxel[b]
    found = np.empty(count, np.int64)
    count = 0
    for b in basins:
        level = bits[root[b]]
        for n in range(first_voxel[b], first_voxel[b + 1]):
            if bits[voxel_list[n]] == level:
                found[count] = voxel_list[n]
                count += 1
    return found[:count]
