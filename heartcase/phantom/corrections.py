"""Strokes where the others would give blood to the wrong cavity: what a person adds who looks a segmentation over.

Between two cavities that are open to each other no edge is seen, so a watershed parts them about where the ways
through blood from both cavities' markers are equally long. Where that is far from the true border, a stroke is missing.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
import numpy.typing as npt
from scipy.sparse import csr_array
from scipy.sparse.csgraph import dijkstra
from scipy.spatial import cKDTree

from heartcase.phantom.heart import HeartPhantom

__all__ = ["corrective_lines"]

Bool = npt.NDArray[np.bool_]
Float64 = npt.NDArray[np.float64]
Int64 = npt.NDArray[np.int64]
Line = tuple[str, float, Float64]

STEP = 1.5
"""Spacing of the lattice on which ways are measured, mm at scale 1."""
DEEP = 2.0
"""Blood that is farther than this from another cavity's must be won clearly, mm at scale 1."""
CLEARLY = 0.6
"""Its own markers must be nearer than this part of the way to the nearest of others."""
LONGEST = 16.0
"""Length of a stroke that is added, mm at scale 1."""
MOST = 24
"""Strokes that are added, at most."""
REACH = 30.0
"""A stroke that is added counts out to this way, mm at scale 1."""
TRIED = 40
"""Ends that are tried for a stroke, the farthest first."""


def corrective_lines(phantom: HeartPhantom, drawn: Sequence[Line], radius_mm: float) -> list[Line]:
    """Find the strokes that are missing.

    Parameters
    ----------
    phantom
        The heart, not mirrored.
    drawn
        Label, radius of the brush in mm, and line of every stroke that is there, shape (n, 3), mm.
    radius_mm
        Radius of the brush that adds.

    Returns
    -------
    list of (str, float, ndarray)
        The same of those to be added, the one where most is lost first.
    """
    blood = _Blood.of(phantom)
    names = {phantom.table[name].value: name for name, _, _ in drawn if phantom.table[name].role.is_blood}
    ways = {
        value: blood.ways_from([line for label, _, line in drawn if label == name], value)
        for value, name in names.items()
    }
    clear_mm = radius_mm + 0.2
    may_start = np.zeros(len(blood.label), np.bool_)
    for value in names:
        own = blood.label == value
        may_start[own] = phantom.truth.value(blood.points_mm[own], value) < -clear_mm
    may_start &= blood.depth_mm > DEEP * phantom.scale
    added: list[Line] = []
    while len(added) < MOST:
        lost = blood.lost(ways)
        lost[~may_start] = 0.0
        worst = int(np.argmax(lost))
        if lost[worst] <= 0.0:
            break
        value = int(blood.label[worst])
        start = blood.points_mm[worst]
        others = blood.points_mm[(lost > 0.0) & (blood.label == value)]
        line = _longest_line(phantom, value, start, others, clear_mm)
        added.append((names[value], radius_mm, line))
        ways[value] = np.minimum(ways[value], blood.ways_from([line], value, limit_mm=REACH * phantom.scale))
    return added


@dataclass(frozen=True)
class _Blood:
    """A lattice of points in blood, and the ways between neighbours (26 each)."""

    points_mm: Float64
    label: Int64
    graph: csr_array
    depth_mm: Float64
    """Way to the nearest point of another cavity."""

    @classmethod
    def of(cls, phantom: HeartPhantom) -> _Blood:
        truth = phantom.truth
        step = STEP * phantom.scale
        lower, upper = truth.extent(np.eye(3))
        # In steps from the origin, so that no point hangs on the last bits of the extent.
        axes = [
            step * np.arange(np.floor(low / step), np.ceil(high / step) + 1.0)
            for low, high in zip(lower, upper, strict=True)
        ]
        points = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1)
        labels = truth.label(points)
        is_blood = np.isin(labels, truth.table.blood_values)
        number = np.where(is_blood, np.cumsum(is_blood).reshape(is_blood.shape) - 1, -1)
        one, other, length = [], [], []
        for offset in np.ndindex(3, 3, 3):
            way = np.array(offset) - 1
            if tuple(way) <= (0, 0, 0):
                continue
            from_here = tuple(
                slice(max(0, -int(w)), n - max(0, int(w))) for w, n in zip(way, number.shape, strict=True)
            )
            to_there = tuple(slice(max(0, int(w)), n - max(0, -int(w))) for w, n in zip(way, number.shape, strict=True))
            both = (number[from_here] >= 0) & (number[to_there] >= 0)
            one.append(number[from_here][both])
            other.append(number[to_there][both])
            length.append(np.full(int(both.sum()), step * float(np.linalg.norm(way))))
        first, second = np.concatenate(one), np.concatenate(other)
        count = int(is_blood.sum())
        there_and_back = (np.concatenate([first, second]), np.concatenate([second, first]))
        graph = csr_array((np.tile(np.concatenate(length), 2), there_and_back), shape=(count, count))
        label = labels[is_blood].astype(np.int64)
        at_border = np.zeros(count, np.bool_)
        differ = label[first] != label[second]
        at_border[first[differ]] = at_border[second[differ]] = True
        return cls(points[is_blood], label, graph, _ways(graph, at_border))

    def ways_from(self, lines_mm: Sequence[Float64], value: int, *, limit_mm: float = np.inf) -> Float64:
        """Way through blood from the nearest point of a cavity's lines, shape (n,); infinite beyond a limit."""
        near = np.zeros(len(self.label), np.bool_)
        own = np.flatnonzero(self.label == value)
        tree = cKDTree(self.points_mm[own])
        for line in lines_mm:
            near[own[tree.query(_dense(line))[1]]] = True
        return _ways(self.graph, near, limit_mm)

    def lost(self, ways: dict[int, Float64]) -> Float64:
        """By how much each point is nearer to another cavity's markers than it may be, mm, shape (n,); 0 where not."""
        lost = np.zeros(len(self.label))
        for value, own in ways.items():
            here = self.label == value
            rival = np.min([other[here] for key, other in ways.items() if key != value], axis=0)
            # Rounded, so that the choice between two points hangs on no last bits.
            lost[here] = np.maximum(own[here] - CLEARLY * rival, 0.0).round(3)
        return lost


def _shifted(number: Int64, way: Int64) -> Int64:
    """What has a neighbour on the other side of each step of a way."""
    part = [slice(max(0, int(step)), size + min(0, int(step))) for step, size in zip(way, number.shape, strict=True)]
    return number[tuple(part)]


def _ways(graph: csr_array, sources: Bool, limit_mm: float = np.inf) -> Float64:
    ways: Float64 = dijkstra(graph, indices=np.flatnonzero(sources), min_only=True, limit=limit_mm)
    return ways


def _dense(line_mm: Float64) -> Float64:
    """Points along a polyline, less than 1 mm apart."""
    parts = [line_mm[:1]]
    for start, end in pairwise(line_mm):
        count = int(np.ceil(np.linalg.norm(end - start))) + 1
        parts.append(start + np.linspace(0.0, 1.0, count + 1)[1:, None] * (end - start))
    return np.concatenate(parts)


def _longest_line(phantom: HeartPhantom, value: int, start: Float64, ends: Float64, clear_mm: float) -> Float64:
    """From a point to the farthest of others that a brush reaches in a straight line; else the point alone."""
    away = np.linalg.norm(ends - start, axis=1).round(3)
    ends = ends[away <= LONGEST * phantom.scale]
    away = away[away <= LONGEST * phantom.scale]
    for n in np.argsort(-away, kind="stable")[:TRIED]:
        line = np.stack([start, ends[n]])
        if away[n] > 0.0 and (phantom.truth.value(_dense(line), value) < -clear_mm).all():
            return line
    return start[None]
