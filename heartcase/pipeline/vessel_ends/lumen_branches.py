"""Branches of a lumen: the distance of each voxel from the inflow, and the arms in which the lumen ends.

The way is the distance within the lumen, by fast marching (Sethian, PNAS 93, 1996, doi 10.1073/pnas.93.4.1591). A
branch is what hangs together above a height of that way, down to where it meets another branch: the leaves of the merge
tree of the way's superlevel sets (Carr, Snoeyink, Axen, Computational Geometry 24, 2003, doi
10.1016/S0925-7721(02)00093-7). What is shorter than it is wide is a bump and belongs to the branch that it lies on.
"""

from __future__ import annotations

import heapq
from dataclasses import dataclass

import cc3d
import edt
import numpy as np

from heartcase.compiling.kernel import kernel
from heartcase.pipeline.kernels.union_find import root_of
from heartcase.schemas.arrays import Bool, Float64, Int64

__all__ = ["Branch", "find_branches", "way_within"]


BUMP_VOXELS = 1.25
"""What rises less than this above its saddle, in edges of the longest side of a voxel, is a step of the voxels."""
BUMP_SHARE = 0.5
"""A branch rises by more than this times the radius of the largest ball in it."""


@dataclass(frozen=True)
class Branch:
    """An arm of a lumen: from its tip, or from where others join, to where it joins another arm itself."""

    index: Int64
    """Voxels (z, y, x) of the arm and of all arms that join it, the farthest first, shape (n, 3)."""
    way_mm: Float64
    """Way from the source to each, mm, descending, shape (n,)."""
    top_mm: float
    """Way to the arm's tip, or to where the first others join."""
    foot_mm: float
    """Way to where it joins another arm; 0 for the arm that begins at the source."""
    arms: tuple[Branch, ...] = ()
    """The arms that join here; none for one with a tip."""

    @property
    def leaves(self) -> tuple[Branch, ...]:
        """The arms with a tip among this one and all that join it."""
        return tuple(leaf for arm in self.arms for leaf in arm.leaves) or (self,)


def way_within(mask: Bool, spacing_mm: tuple[float, float, float], sources: Bool) -> Float64:
    """Length of the shortest way from the sources to each voxel that stays in the mask.

    Parameters
    ----------
    mask
        Shape (z, y, x).
    spacing_mm
        Along i, j, k.
    sources
        Where the way is 0; what lies outside the mask does not count. Shape (z, y, x).

    Returns
    -------
    Float64
        mm, shape (z, y, x); infinite off the mask and in pieces of it without a source.
    """
    padded = np.pad(mask, 1)
    starts = np.flatnonzero(np.pad(sources, 1) & padded)
    way = np.full(padded.size, np.inf)
    _, height, width = padded.shape
    _march(padded.ravel(), starts, np.array([height * width, width, 1]), np.array(spacing_mm[::-1]), way)
    inner = way.reshape(padded.shape)[1:-1, 1:-1, 1:-1]
    return np.ascontiguousarray(inner)


@kernel
def _march(mask, starts, steps, spacing, way):
    """Fast marching to first order; ties go to the voxel that comes first."""
    is_done = np.zeros(len(mask), np.bool_)
    queue = [(0.0, np.int64(starts[n])) for n in range(len(starts))]
    for n in range(len(starts)):
        way[starts[n]] = 0.0
    heapq.heapify(queue)
    lowest, step_mm = np.empty(3), np.empty(3)
    while len(queue) > 0:
        _, here = heapq.heappop(queue)
        if is_done[here]:
            continue
        is_done[here] = True
        for axis in range(3):
            for sign in (-1, 1):
                there = here + sign * steps[axis]
                if not mask[there] or is_done[there]:
                    continue
                new = _arrival(there, is_done, way, steps, spacing, lowest, step_mm)
                if new < way[there]:
                    way[there] = new
                    heapq.heappush(queue, (new, there))


@kernel
def _arrival(voxel, is_done, way, steps, spacing, lowest, step_mm):
    """The way at a voxel from those of its neighbours that are done: |gradient| = 1, upwind."""
    count = 0
    for axis in range(3):
        best = np.inf
        for sign in (-1, 1):
            beside = voxel + sign * steps[axis]
            if is_done[beside] and way[beside] < best:
                best = way[beside]
        if best < np.inf:
            place = count
            while place > 0 and lowest[place - 1] > best:
                lowest[place], step_mm[place] = lowest[place - 1], step_mm[place - 1]
                place -= 1
            lowest[place], step_mm[place] = best, spacing[axis]
            count += 1
    found = lowest[0] + step_mm[0]
    a, b, c = 0.0, 0.0, -1.0
    for n in range(count):
        if lowest[n] >= found:
            break
        weight = 1.0 / (step_mm[n] * step_mm[n])
        a += weight
        b -= 2.0 * weight * lowest[n]
        c += weight * lowest[n] * lowest[n]
        root = b * b - 4.0 * a * c
        if root >= 0.0:
            found = (-b + np.sqrt(root)) / (2.0 * a)
    return found


def find_branches(mask: Bool, spacing_mm: tuple[float, float, float], sources: Bool) -> tuple[Branch, ...]:
    """Take a lumen apart into the arms in which the way from the sources ends.

    Parameters
    ----------
    mask
        The lumen, shape (z, y, x). Pieces without a source have no branch.
    spacing_mm
        Along i, j, k.
    sources
        Where the blood comes in, shape (z, y, x).

    Returns
    -------
    tuple of Branch
        For each piece of the lumen the arm that begins at its sources; all others hang on them.
    """
    way = np.pad(way_within(mask, spacing_mm, sources), 1, constant_values=np.inf)
    width = np.pad(edt.edt(mask, anisotropy=spacing_mm[::-1], black_border=False), 1)
    flat = way.ravel()
    reached = np.flatnonzero(np.isfinite(flat))
    if len(reached) == 0:
        return ()
    order = reached[np.lexsort((reached, -flat[reached]))]
    around = np.array(
        [
            (a * way.shape[1] + b) * way.shape[2] + c
            for a in (-1, 0, 1)
            for b in (-1, 0, 1)
            for c in (-1, 0, 1)
            if (a, b, c) != (0, 0, 0)
        ]
    )
    least = BUMP_VOXELS * max(spacing_mm)
    kept, lost, level, last = _merge(order, flat, width.ravel().astype(np.float64), around, least, BUMP_SHARE)

    def branch(tip: int, top: float, foot: float, arms: tuple[Branch, ...]) -> Branch:
        """What hangs together above the foot and holds the tip."""
        pieces = cc3d.connected_components(np.isfinite(way) & (way > foot), connectivity=26).ravel()
        voxels = order[pieces[order] == pieces[tip]]
        index = np.stack(np.unravel_index(voxels, way.shape), axis=1) - 1
        return Branch(index.astype(np.int64), flat[voxels], top, foot, arms)

    growing: dict[int, tuple[float, tuple[Branch, ...]]] = {}
    for one, other, meeting in zip(kept.tolist(), lost.tolist(), level.tolist(), strict=True):
        joined: list[Branch] = []
        for tip in (one, other):
            top, arms = growing.pop(tip, (float(flat[tip]), ()))
            # two meetings within a voxel are one
            is_near = bool(arms) and top - meeting <= max(spacing_mm)
            joined += arms if is_near else [branch(tip, top, meeting, arms)]
        growing[one] = (meeting, tuple(joined))
    roots = []
    for tip in last.tolist():
        top, arms = growing.pop(tip, (float(flat[tip]), ()))
        roots.append(branch(tip, top, -1.0, arms))
    return tuple(roots)


@kernel
def _merge(order, way, width, around, least_mm, share):
    """Where branches meet: the tips of the one that lives on and of the other, the way there; and the tips at the end.

    ``order``: voxels by descending way. Branches that are bumps meet unseen.
    """
    parent = np.full(len(way), -1, np.int64)
    peak = np.zeros(len(way), np.int64)
    widest = np.zeros(len(way))
    kept = [np.int64(0) for _ in range(0)]
    lost = [np.int64(0) for _ in range(0)]
    level = [0.0 for _ in range(0)]
    for voxel in order:
        parent[voxel] = voxel
        peak[voxel] = voxel
        widest[voxel] = width[voxel]
        for step in around:
            beside = voxel + step
            if parent[beside] < 0:
                continue
            one, other = root_of(parent, voxel), root_of(parent, beside)
            if one == other:
                continue
            # the higher peak lives on; of two that are as high the one that comes first
            one_peak, other_peak = peak[one], peak[other]
            is_lower = way[one_peak] < way[other_peak]
            if way[one_peak] == way[other_peak]:
                is_lower = one_peak > other_peak
            if is_lower:
                one, other = other, one
            if way[peak[other]] - way[voxel] >= max(least_mm, share * widest[other]):
                kept.append(peak[one])
                lost.append(peak[other])
                level.append(way[voxel])
            parent[other] = one
            widest[one] = max(widest[one], widest[other])
    last = [np.int64(0) for _ in range(0)]
    seen = np.zeros(len(way), np.bool_)
    for n in range(len(order)):
        root = root_of(parent, order[n])
        if not seen[root]:
            seen[root] = True
            last.append(peak[root])
    return np.array(kept), np.array(lost), np.array(level), np.array(last)
