"""The minimum spanning forest of a tree of basins and markers: solved at once, or mended where something was painted.

Of a marked basin only what lies below its marked voxels (its *foot*) waits for a label from elsewhere: a voxel has the
label of the first marked voxel on its way down, or that of the foot. A foot is reached through the basin's own lowest
marked voxel, by the face under that voxel; or through a face from a neighbouring basin. Such a face ends in a foot, or
above a marked voxel, where the label is given. ``level`` is the key of the highest face on a foot's way to its marked
voxel; it is what a new way has to beat.
"""

from __future__ import annotations

from dataclasses import dataclass

import numba
import numpy as np
import numpy.typing as npt

from heartcase.pipeline.watershed.descent import ROOT, row_chunks, side_offsets
from heartcase.pipeline.watershed.plateaus import divide_flat
from heartcase.pipeline.watershed.tree import NO_KEY, BasinTree

__all__ = ["UNMARKED", "Box", "Forest", "solve_forest"]

Int64 = npt.NDArray[np.int64]
UInt8 = npt.NDArray[np.uint8]
Box = tuple[slice, slice, slice]

UNMARKED = 255
"""Value of a voxel without marker, and of a foot that no label reaches."""
MARKED_BASIN = 254
"""In the table of the feet's labels: look at the voxel itself."""
NO_FLAT = -1
CONTESTED = -2
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
    flat_label: npt.NDArray[np.int16]
    """Label that marks each flat minimum: -1 none, -2 several."""
    labels: UInt8
    """Label of each voxel."""

    def paint(self, voxels: Int64, label: int) -> Box | None:
        """Mark voxels with a label, and mend the forest where that changes it.

        Parameters
        ----------
        voxels
            Flat indices, int64.
        label
            Label value, below 255; or 255 to take the markers away, which solves everything anew.

        Returns
        -------
        Box or None
            Box in which labels changed; None where none did.
        """
        flat_painted = self.painted.reshape(-1)
        voxels = voxels[flat_painted[voxels] != label]
        if not len(voxels):
            return None
        flat_painted[voxels] = label
        tree = self.tree
        bits, basin = tree.height.view(np.int32).ravel(), tree.basin.ravel()
        if label == UNMARKED or _is_flat_contested(bits, basin, tree.root, tree.flat, self.flat_label, voxels, label):
            return self.solve()
        start, faces = tree.neighbours
        first_voxel, voxel_list = tree.voxels
        changed = _mend(
            (bits, tree.direction.ravel(), basin, side_offsets(tree.height.shape)),
            (start, faces, tree.key, *tree.ends),
            voxels,
            label,
            self.marks.reshape(-1),
            self.foot_label,
            self.foot_level,
            self.lowest_mark,
        )
        if (first_voxel[changed + 1] - first_voxel[changed]).sum() > WHOLE_SHARE * self.labels.size:
            return self._paint_whole()
        low, high = _paint_basins(
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

    def restore(self, voxels: Int64, values: UInt8) -> Box | None:
        """Mark voxels with labels of their own, or take their markers away (255); the box in which labels changed."""
        found = np.unique(values)
        if len(found) == 1:
            return self.paint(voxels, int(found[0]))
        self.painted.reshape(-1)[voxels] = values
        return self.solve()

    def solve(self) -> Box | None:
        """Work everything out anew from ``painted``; the box in which labels changed."""
        tree = self.tree
        bits, basin = tree.height.view(np.int32).ravel(), tree.basin.ravel()
        np.copyto(self.marks, self.painted)
        voxels = _marked_voxels(self.marks.ravel(), row_chunks(self.marks.shape) * self.marks.shape[2])
        _note_flats(bits, basin, tree.root, tree.flat, self.marks.ravel(), voxels, self.flat_label)
        if (self.flat_label == CONTESTED).any():
            self._divide_flats(voxels)
            voxels = _marked_voxels(self.marks.ravel(), row_chunks(self.marks.shape) * self.marks.shape[2])
        self.lowest_mark[:] = -1
        _find_lowest_marks(bits, basin, voxels, self.lowest_mark)
        higher, lower = tree.ends
        first, second = tree.basins
        _solve(
            (bits, tree.direction.ravel(), basin, side_offsets(tree.height.shape)),
            (tree.key, higher, lower, first, second),
            self.marks.ravel(),
            self.lowest_mark,
            self.foot_label,
            self.foot_level,
        )
        return self._paint_whole()

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

    def _paint_whole(self) -> Box | None:
        rows = row_chunks(self.labels.shape)
        low, high = _paint_rows(
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


def _as_box(low: Int64, high: Int64) -> Box | None:
    if low[0] > high[0]:
        return None
    (k0, j0, i0), (k1, j1, i1) = low.tolist(), high.tolist()
    return slice(k0, k1 + 1), slice(j0, j1 + 1), slice(i0, i1 + 1)


@numba.njit(cache=True, nogil=True, parallel=True)
def _marked_voxels(marks, chunks):  # type: ignore[no-untyped-def]
    """Flat indices of the marked voxels, ascending."""
    count = np.zeros(len(chunks), np.int64)
    for c in numba.prange(len(chunks) - 1):
        found = 0
        for v in range(chunks[c], chunks[c + 1]):
            found += marks[v] != UNMARKED
        count[c + 1] = found
    first = np.cumsum(count)
    voxels = np.empty(first[-1], np.int64)
    for c in numba.prange(len(chunks) - 1):
        at = first[c]
        for v in range(chunks[c], chunks[c + 1]):
            if marks[v] != UNMARKED:
                voxels[at] = v
                at += 1
    return voxels


@numba.njit(cache=True, nogil=True)
def _note_flats(bits, basin, root, flat, marks, voxels, flat_label):  # type: ignore[no-untyped-def]
    """Which label marks each flat minimum, or that several do."""
    flat_label[:] = -1
    for v in voxels:
        b = basin[v]
        number = flat[b]
        if number >= 0 and bits[v] == bits[root[b]]:
            if flat_label[number] == -1:
                flat_label[number] = marks[v]
            elif flat_label[number] != marks[v]:
                flat_label[number] = CONTESTED


@numba.njit(cache=True, nogil=True)
def _is_flat_contested(bits, basin, root, flat, flat_label, voxels, label):  # type: ignore[no-untyped-def]
    """Whether voxels to be marked with a label lie in a flat minimum with another one; notes the label where not."""
    for v in voxels:
        number = flat[basin[v]]
        if number >= 0 and bits[v] == bits[root[basin[v]]]:
            if flat_label[number] == -1:
                flat_label[number] = label
            elif flat_label[number] != label:
                return True
    return False


@numba.njit(cache=True, nogil=True)
def _find_lowest_marks(bits, basin, voxels, lowest):  # type: ignore[no-untyped-def]
    for v in voxels:
        old = lowest[basin[v]]
        if old < 0 or bits[v] < bits[old] or (bits[v] == bits[old] and v < old):
            lowest[basin[v]] = v


@numba.njit(cache=True, nogil=True)
def _mark_below(v, direction, offsets, marks):  # type: ignore[no-untyped-def]
    """Label of the first marked voxel on the way down from a voxel, itself included; 255 where it ends in the foot."""
    while marks[v] == UNMARKED and direction[v] != ROOT:
        v += offsets[direction[v]]
    return marks[v]


@numba.njit(cache=True, nogil=True)
def _own_key(v, bits, direction):  # type: ignore[no-untyped-def]
    """Key of the face under a marked voxel, through which it reaches the foot; 0 where it is in the foot."""
    if direction[v] == ROOT:
        return np.int64(0)
    return (np.int64(bits[v]) << 32) | (np.int64(v) << 3)


@numba.njit(cache=True, nogil=True)
def _reach(foot, level, label, following, foot_label, foot_level):  # type: ignore[no-untyped-def]
    """Give a label to all feet that hang together with one and have none."""
    at = foot
    while foot_label[at] == UNMARKED:
        foot_label[at] = label
        foot_level[at] = level
        at = following[at]


@numba.njit(cache=True, nogil=True)
def _solve(landscape, faces, marks, lowest_mark, foot_label, foot_level):  # type: ignore[no-untyped-def]
    """Kruskal's algorithm over the joining faces and those under the lowest marked voxels, in their common order."""
    bits, direction, _, offsets = landscape
    key, higher, lower, first, second = faces
    foot_label[:] = UNMARKED
    foot_level[:] = NO_KEY
    marked = np.flatnonzero(lowest_mark >= 0)
    own = np.empty(len(marked), np.int64)
    for n in range(len(marked)):
        own[n] = _own_key(lowest_mark[marked[n]], bits, direction)
    order = np.argsort(own)
    # feet that hang together without a label form a ring; a tree has no face that joins a ring with itself
    following = np.arange(len(lowest_mark))
    at = 0
    for e in range(len(key) + 1):
        one = key[e] if e < len(key) else NO_KEY
        while at < len(order) and own[order[at]] < one:
            b = marked[order[at]]
            if foot_label[b] == UNMARKED:
                _reach(b, own[order[at]], marks[lowest_mark[b]], following, foot_label, foot_level)
            at += 1
        if e == len(key):
            break
        a, b = first[e], second[e]
        here, there = foot_label[a], foot_label[b]
        is_foot_a = is_foot_b = True
        if lowest_mark[a] >= 0:
            mark = _mark_below(higher[e], direction, offsets, marks)
            if mark != UNMARKED:
                here, is_foot_a = mark, False
        if lowest_mark[b] >= 0:
            mark = _mark_below(lower[e], direction, offsets, marks)
            if mark != UNMARKED:
                there, is_foot_b = mark, False
        if here == UNMARKED and there == UNMARKED:
            following[a], following[b] = following[b], following[a]
        elif here == UNMARKED and is_foot_a:
            _reach(a, one, there, following, foot_label, foot_level)
        elif there == UNMARKED and is_foot_b:
            _reach(b, one, here, following, foot_label, foot_level)


@numba.njit(cache=True, nogil=True)
def _mend(landscape, graph, voxels, label, marks, foot_label, foot_level, lowest_mark):  # type: ignore[no-untyped-def]
    """Mark voxels, and carry the label as far as its way is lower than what was there; the basins to paint anew."""
    bits, direction, basin, offsets = landscape
    start, faces, key, higher, lower = graph
    count = len(lowest_mark)
    touched = np.empty(len(voxels), np.int64)
    touched_count = 0
    is_changed = np.zeros(count, np.bool_)
    for v in voxels:
        marks[v] = label
        b = basin[v]
        if not is_changed[b]:
            is_changed[b] = True
            touched[touched_count] = b
            touched_count += 1
        old = lowest_mark[b]
        if old < 0 or bits[v] < bits[old] or (bits[v] == bits[old] and v < old):
            lowest_mark[b] = v
    touched = np.sort(touched[:touched_count])
    changed = [np.int64(b) for b in touched]
    # first every marked foot itself: then no way that leads over a voxel marked now is the best one of its foot
    for b in touched:
        mark = lowest_mark[b]
        _carry(
            b,
            _own_key(mark, bits, direction),
            marks[mark],
            landscape,
            graph,
            marks,
            foot_label,
            foot_level,
            lowest_mark,
            is_changed,
            changed,
        )
    for b in touched:
        for n in range(start[b], start[b + 1]):
            one = key[faces[n]]
            here, there = higher[faces[n]], lower[faces[n]]
            if basin[here] != b:
                here, there = there, here
            mark = _mark_below(here, direction, offsets, marks)
            if mark != UNMARKED and _mark_below(there, direction, offsets, marks) == UNMARKED:
                _carry(
                    basin[there],
                    one,
                    mark,
                    landscape,
                    graph,
                    marks,
                    foot_label,
                    foot_level,
                    lowest_mark,
                    is_changed,
                    changed,
                )
    # in the order of the volume, for the memory's sake
    return np.sort(np.array(changed))


@numba.njit(cache=True, nogil=True)
def _carry(foot, level, label, landscape, graph, marks, foot_label, foot_level, lowest_mark, is_changed, changed):  # type: ignore[no-untyped-def]
    """Offer a label to a foot by a way as high as ``level``, and on to all feet that have a higher way now.

    Where the way is the one that a foot has already, only its label is new.
    """
    _, direction, basin, offsets = landscape
    start, faces, key, higher, lower = graph
    if not (level < foot_level[foot] or (level == foot_level[foot] and label != foot_label[foot])):
        return
    stack = [(np.int64(foot), np.int64(level))]
    while len(stack) > 0:
        b, level = stack.pop()
        # a tree has one way only to each foot, so nothing better can have come meanwhile
        if foot_label[b] != label and not is_changed[b]:
            is_changed[b] = True
            changed.append(b)
        foot_label[b] = label
        foot_level[b] = level
        for n in range(start[b], start[b + 1]):
            one = key[faces[n]]
            here, there = higher[faces[n]], lower[faces[n]]
            if basin[here] != b:
                here, there = there, here
            other = basin[there]
            beyond = max(level, one)
            if not (beyond < foot_level[other] or (beyond == foot_level[other] and label != foot_label[other])):
                continue
            if lowest_mark[b] >= 0 and _mark_below(here, direction, offsets, marks) != UNMARKED:
                continue
            if lowest_mark[other] >= 0 and _mark_below(there, direction, offsets, marks) != UNMARKED:
                continue
            stack.append((np.int64(other), beyond))


@numba.njit(cache=True, nogil=True)
def _paint_basins(changed, first_voxel, voxel_list, direction, offsets, marks, lowest_mark, foot_label, labels, shape):  # type: ignore[no-untyped-def]
    """Label the voxels of some basins anew; lowest and highest (z, y, x) at which that changed something."""
    nz, ny, nx = shape
    low_k, low_j, low_i = np.int64(nz), np.int64(ny), np.int64(nx)
    high_k, high_j, high_i = np.int64(-1), np.int64(-1), np.int64(-1)
    # exact for any index below 2^29, and much quicker than a division of integers
    per_slice, per_row = 1.0 / (nx * ny), 1.0 / nx
    for b in changed:
        is_marked = lowest_mark[b] >= 0
        foot = foot_label[b]
        for n in range(first_voxel[b], first_voxel[b + 1]):
            v = np.int64(voxel_list[n])
            label = foot
            if is_marked:
                mark = _mark_below(v, direction, offsets, marks)
                if mark != UNMARKED:
                    label = mark
            if labels[v] != label:
                labels[v] = label
                k = np.int64((v + 0.5) * per_slice)
                rest = v - k * (nx * ny)
                j = np.int64((rest + 0.5) * per_row)
                i = rest - j * nx
                low_k, low_j, low_i = min(low_k, k), min(low_j, j), min(low_i, i)
                high_k, high_j, high_i = max(high_k, k), max(high_j, j), max(high_i, i)
    return np.array([low_k, low_j, low_i]), np.array([high_k, high_j, high_i])


@numba.njit(cache=True, nogil=True)
def _paint_row(row, begin, basin, table, direction, offsets, marks, foot_label):  # type: ignore[no-untyped-def]
    """Label a row; the first and the last place at which that changed something."""
    first = len(row)
    last = -1
    for i in range(len(row)):
        v = begin + i
        label = table[basin[v]]
        if label == MARKED_BASIN:
            mark = _mark_below(v, direction, offsets, marks)
            label = mark if mark != UNMARKED else foot_label[basin[v]]
        if row[i] != label:
            row[i] = label
            first = min(first, i)
            last = i
    return first, last


@numba.njit(cache=True, nogil=True, parallel=True)
def _paint_rows(rows, direction, basin, offsets, marks, lowest_mark, foot_label, labels):  # type: ignore[no-untyped-def]
    """Label all voxels; for each chunk of rows the lowest and highest (z, y, x) at which that changed something."""
    nz, ny, nx = labels.shape
    low = np.empty((len(rows) - 1, 3), np.int64)
    high = np.full((len(rows) - 1, 3), -1, np.int64)
    table = np.where(lowest_mark >= 0, np.uint8(MARKED_BASIN), foot_label)
    for c in numba.prange(len(rows) - 1):
        low[c, 0], low[c, 1], low[c, 2] = nz, ny, nx
        for line in range(rows[c], rows[c + 1]):
            k = line // ny
            j = line - k * ny
            first, last = _paint_row(labels[k, j], line * nx, basin, table, direction, offsets, marks, foot_label)
            if last >= 0:
                low[c, 0], low[c, 1], low[c, 2] = min(low[c, 0], k), min(low[c, 1], j), min(low[c, 2], first)
                high[c, 0], high[c, 1], high[c, 2] = max(high[c, 0], k), max(high[c, 1], j), max(high[c, 2], last)
    return low, high
