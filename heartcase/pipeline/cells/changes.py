"""Changes of topology between two sets of voxels, located: Betti numbers alone can agree where the sets differ.

One set is changed into the other voxel by voxel, as long as a voxel is *simple*: adding or taking it away changes no
piece, tunnel or hollow (Bertrand and Malandain, "A new characterization of three-dimensional simple points", Pattern
Recognition Letters 15, 1994). What cannot be changed so is where the topology differs: where nothing is left, the two
sets are alike. Voxels near the border go first, so that what is left of a closed hole lies in its middle.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import sparse
from scipy.ndimage import find_objects
from scipy.sparse import csgraph

from heartcase.compiling.calls import copied
from heartcase.compiling.kernel import kernel
from heartcase.pipeline.kernels.topology import Connectivity, betti_numbers, components
from heartcase.schemas.arrays import Bool, Float32, UInt32

__all__ = ["Change", "topology_changes"]


_LOOKED_AT = 500
"""Groups beyond which none is looked at again: what differs in so many places differs indeed."""

# Neighbour (z, y, x) of a voxel has bit 9 (z + 1) + 3 (y + 1) + x + 1.
_CENTRE = 1 << 13
_ALL = (1 << 27) - 1
_FACES = 1 << 4 | 1 << 10 | 1 << 12 | 1 << 14 | 1 << 16 | 1 << 22
_CORNERS = 1 << 0 | 1 << 2 | 1 << 6 | 1 << 8 | 1 << 18 | 1 << 20 | 1 << 24 | 1 << 26
_LOW_X = sum(1 << n for n in range(0, 27, 3))
_LOW_Y = sum(0b111 << n for n in range(0, 27, 9))
_LOW_Z = 0b111111111


@dataclass(frozen=True)
class Change:
    """A place where two sets differ in topology."""

    place: tuple[int, int, int]
    """Voxel (z, y, x) in its middle."""
    size: int
    """Voxels that had to change there although they are not simple."""


def topology_changes(
    before: Bool, after: Bool, depth: Float32, connectivity: Connectivity, *, reach: int = 1
) -> list[Change]:
    """Find the places where one set cannot be deformed into another.

    Parameters
    ----------
    before, after
        The sets, same shape with three axes; what lies beyond the arrays is not part of them.
    depth
        Distance of each voxel to the border of ``before``, or anything that grows with it; voxels of little depth are
        changed first.
    connectivity
        6 or 26; the complement has the other one.
    reach
        Voxels within which a hole that is lost in one place and gained in another is the same hole, moved: places that
        near are looked at together, and left out where the Betti numbers around them agree. They are all kept where
        nothing else would be left although the sets' own Betti numbers differ.

    Returns
    -------
    list of Change
        Connected groups of voxels that are left, the largest first (ties: in raster order). Without any, both sets
        have the same Betti numbers.
    """
    now = np.pad(before, 1).view(np.uint8)
    differs = np.zeros(now.shape, np.uint8)
    differs[1:-1, 1:-1, 1:-1] = before != after
    at = np.flatnonzero(differs)
    if len(at) == 0:
        return []
    order = at[np.argsort(np.abs(depth[before != after]), kind="stable")]
    steps = np.array([(z * now.shape[1] + y) * now.shape[2] + x for z, y, x in np.ndindex(3, 3, 3)])
    _deform(now.reshape(-1), differs.reshape(-1), order, steps - steps[13], connectivity == 6)
    left = differs[1:-1, 1:-1, 1:-1].view(np.bool_)
    labels, count = components(left, 26)
    if count == 0:
        return []
    is_real = _differ_around(now[1:-1, 1:-1, 1:-1].view(np.bool_), after, labels, connectivity, reach)
    if not is_real.any() and betti_numbers(before, connectivity) != betti_numbers(after, connectivity):
        is_real[:] = True
    return [one for n, one in _groups(left, labels, count) if is_real[n]]


def _differ_around(now: Bool, after: Bool, labels: UInt32, connectivity: Connectivity, reach: int) -> Bool:
    """For each group of voxels that are left, whether the topology around it and the groups near it is another."""
    boxes = [box for box in find_objects(labels.astype(np.int32)) if box is not None]
    low = np.array([[part.start - reach for part in box] for box in boxes])
    high = np.array([[part.stop + reach for part in box] for box in boxes])
    is_real = np.ones(len(boxes), np.bool_)
    if len(boxes) > _LOOKED_AT:
        return is_real
    touches = ((low[:, None] < high[None]) & (low[None] < high[:, None])).all(axis=2)
    together = csgraph.connected_components(sparse.csr_matrix(np.asarray(touches, np.int8)), directed=False)[1]
    for number in range(int(together.max()) + 1):
        mine = together == number
        first, last = low[mine].min(axis=0), high[mine].max(axis=0)
        for more in (0, reach):
            # A window's own border may cut what differs in shape only: what differs does so in every window.
            window = tuple(slice(max(int(a) - more, 0), int(b) + more) for a, b in zip(first, last, strict=True))
            is_real[mine] &= betti_numbers(now[window], connectivity) != betti_numbers(after[window], connectivity)
    return is_real


def _groups(left: Bool, labels: UInt32, count: int) -> list[tuple[int, Change]]:
    """Number and middle of each group of voxels, the largest first (ties: in raster order)."""
    places = np.argwhere(left)
    group = labels[left].astype(np.int64) - 1
    size = np.bincount(group, minlength=count)
    mean = np.stack([np.bincount(group, places[:, axis], count) for axis in range(3)], axis=1) / size[:, None]
    away = ((places - mean[group]) ** 2).sum(axis=1)
    by_group = np.lexsort((np.arange(len(group)), away, group))
    middle = places[by_group[np.searchsorted(group[by_group], np.arange(count))]]
    first = np.lexsort((np.arange(count), -size))
    return [
        (int(n), Change((int(z), int(y), int(x)), int(size[n])))
        for n, (z, y, x) in zip(first, middle[first], strict=True)
    ]


@copied
def _beside(mask):
    """A set of neighbours and all that share a face with one of them."""
    wide = mask | (mask & ~_LOW_X) >> 1 | (mask << 1) & ~_LOW_X
    wide |= (mask & ~_LOW_Y) >> 3 | (mask << 3) & ~_LOW_Y
    return (wide | (mask & ~_LOW_Z) >> 9 | (mask << 9) & ~_LOW_Z) & _ALL


@copied
def _around(mask):
    """A set of neighbours and all that share a corner with one of them."""
    mask |= (mask & ~_LOW_X) >> 1 | (mask << 1) & ~_LOW_X & _ALL
    mask |= (mask & ~_LOW_Y) >> 3 | (mask << 3) & ~_LOW_Y & _ALL
    return (mask | (mask & ~_LOW_Z) >> 9 | (mask << 9) & ~_LOW_Z) & _ALL


@kernel
def _is_simple(inside):
    """Whether a voxel of a 26-connected set is simple, from the set's neighbours of it."""
    inside &= ~_CENTRE
    outside = _ALL & ~inside & ~_CENTRE & ~_CORNERS
    faces = outside & _FACES
    if inside == 0 or faces == 0:
        return False
    grown = inside & -inside
    last = 0
    while grown != last:
        last = grown
        grown = _around(grown) & inside
    if grown != inside:
        return False
    grown = faces & -faces
    last = 0
    while grown != last:
        last = grown
        grown = _beside(grown) & outside
    return faces & ~grown == 0


@kernel
def _deform(now, differs, order, steps, is_six):
    """Change what differs as long as it is simple; ``now`` and ``differs`` are flat, with a rim of one voxel."""
    count = len(order)
    queue = order.copy()
    is_queued = differs.copy()
    first, waiting = 0, count
    while waiting > 0:
        at = queue[first]
        first = (first + 1) % count
        waiting -= 1
        is_queued[at] = 0
        inside = np.int64(0)
        for n in range(27):
            inside |= np.int64(now[at + steps[n]]) << n
        if not _is_simple(_ALL & ~inside if is_six else inside):
            continue
        now[at] ^= 1
        differs[at] = 0
        for n in range(27):
            other = at + steps[n]
            if differs[other] and not is_queued[other]:
                is_queued[other] = 1
                queue[(first + waiting) % count] = other
                waiting += 1
