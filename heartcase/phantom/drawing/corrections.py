"""Strokes where a watershed would give voxels to the wrong structure: what a person adds who looks a segmentation over.

Between two cavities that are open to each other no edge is seen, nor between the left ventricle's muscle and a wall
that it runs into. There a watershed parts the two about where the ways from both their markers are equally long. Where
that is far from the true border, a stroke is missing.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from scipy.sparse import csr_array
from scipy.sparse.csgraph import dijkstra
from scipy.spatial import cKDTree

from heartcase.phantom.anatomy.heart import HeartPhantom
from heartcase.phantom.anatomy.regions import MYOCARDIUM
from heartcase.schemas.arrays import Bool, Float64, Int64

__all__ = ["corrective_lines", "wall_lines"]

Line = tuple[str, float, Float64]

BLOOD_STEP, TISSUE_STEP = 1.5, 1.0
"""Spacing of the lattices on which ways are measured, mm at scale 1."""
DEEP = 2.0
"""What is farther than this from another structure must be won clearly, mm at scale 1."""
CLEARLY = 0.6
"""Its own markers must be nearer than this part of the way to the nearest of others."""
LONGEST = 16.0
"""Length of a stroke that is added, mm at scale 1."""
MOST_IN_BLOOD, MOST_IN_TISSUE = 24, 60
"""Strokes that are added, at most."""
REACH = 30.0
"""A stroke that is added counts out to this way, mm at scale 1."""
TRIED = 40
"""Ends that are tried for a stroke, the farthest first."""
WALL_CLEAR_MM = 0.3
"""How far the line of a stroke in a wall keeps from the wall's border: it is as thin as a line."""


def corrective_lines(phantom: HeartPhantom, drawn: Sequence[Line], radius_mm: float) -> list[Line]:
    """Find the strokes that are missing in blood.

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
    names = {phantom.table[name].value: name for name, _, _ in drawn if phantom.table[name].role.is_blood}
    lattice = _Lattice.of(phantom, BLOOD_STEP * phantom.scale, {value: value for value in names})
    return _missing(phantom, lattice, names, drawn, radius_mm, radius_mm + 0.2, MOST_IN_BLOOD)


def wall_lines(phantom: HeartPhantom, drawn: Sequence[Line]) -> list[Line]:
    """Find the strokes that are missing in tissue, between the left ventricle's muscle and the walls of cavities.

    As :func:`corrective_lines`, but the strokes are lines without a width. Walls are marked as background, since they
    are grown into it later; without that the muscle's basin runs along them.
    """
    table = phantom.truth.table
    walls = {value: 0 for value in table.tissue_values if table[value].wall_of is not None}
    lattice = _Lattice.of(phantom, TISSUE_STEP * phantom.scale, {MYOCARDIUM: MYOCARDIUM} | walls)
    names = {MYOCARDIUM: "left ventricular myocardium", 0: "background"}
    return _missing(phantom, lattice, names, drawn, 0.0, WALL_CLEAR_MM, MOST_IN_TISSUE)


@dataclass(frozen=True)
class _Lattice:
    """Points of some structures on a lattice, and the ways between neighbours (26 each)."""

    points_mm: Float64
    label: Int64
    """The structure of each, a value of the truth."""
    group: Int64
    """What it is marked as."""
    graph: csr_array
    depth_mm: Float64
    """Way to the nearest point of another group."""
    step_mm: float

    @classmethod
    def of(cls, phantom: HeartPhantom, step_mm: float, groups: dict[int, int]) -> _Lattice:
        """All points of the structures that are keys of ``groups``; its values are what they are marked as."""
        truth = phantom.truth
        lower, upper = truth.extent(np.eye(3))
        # In steps from the origin, so that no point hangs on the last bits of the extent.
        axes = [
            step_mm * np.arange(np.floor(low / step_mm), np.ceil(high / step_mm) + 1.0)
            for low, high in zip(lower, upper, strict=True)
        ]
        points = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1)
        labels = truth.label(points)
        is_in = np.isin(labels, list(groups))
        number: Int64 = np.where(is_in, np.cumsum(is_in).reshape(is_in.shape) - 1, -1)
        one, other, length = [], [], []
        for offset in np.ndindex(3, 3, 3):
            way = np.array(offset) - 1
            if tuple(way) <= (0, 0, 0):
                continue
            here, there = _shifted(number, -way), _shifted(number, way)
            both = (here >= 0) & (there >= 0)
            one.append(here[both])
            other.append(there[both])
            length.append(np.full(int(both.sum()), step_mm * float(np.linalg.norm(way))))
        first, second = np.concatenate(one), np.concatenate(other)
        count = int(is_in.sum())
        there_and_back = (np.concatenate([first, second]), np.concatenate([second, first]))
        graph = csr_array((np.tile(np.concatenate(length), 2), there_and_back), shape=(count, count))
        label = labels[is_in].astype(np.int64)
        group = np.array([groups.get(value, 0) for value in range(256)])[label]
        at_border = np.zeros(count, np.bool_)
        differ = group[first] != group[second]
        at_border[first[differ]] = at_border[second[differ]] = True
        return cls(points[is_in], label, group, graph, _ways(graph, at_border), step_mm)

    def ways_from(self, lines: Sequence[Line], value: int, *, limit_mm: float = np.inf) -> Float64:
        """Way from the nearest of a group's points that its strokes mark, shape (n,); infinite beyond a limit."""
        marked = np.zeros(len(self.label), np.bool_)
        own = np.flatnonzero(self.group == value)
        tree = cKDTree(self.points_mm[own])
        for _, radius, line in lines:
            found = tree.query(_dense(line), distance_upper_bound=radius + self.step_mm)
            away, near = np.asarray(found[0]), np.asarray(found[1])
            marked[own[near[np.isfinite(away)]]] = True
        return _ways(self.graph, marked, limit_mm)

    def lost(self, ways: dict[int, Float64]) -> Float64:
        """By how much each point is nearer to another group's markers than it may be, mm, shape (n,); 0 where not."""
        lost = np.zeros(len(self.label))
        for value, own in ways.items():
            here = self.group == value
            rival = np.min([other[here] for key, other in ways.items() if key != value], axis=0)
            # What no rival reaches is not lost; what its own markers do not reach is lost, by a finite amount that
            # can be compared. Rounded, so that no choice hangs on the last bits.
            gap = np.where(np.isfinite(rival), np.minimum(own[here], 2.0 * rival + 1.0) - CLEARLY * rival, 0.0)
            lost[here] = np.maximum(gap, 0.0).round(3)
        return lost


def _missing(
    phantom: HeartPhantom,
    lattice: _Lattice,
    names: dict[int, str],
    drawn: Sequence[Line],
    radius_mm: float,
    clear_mm: float,
    most: int,
) -> list[Line]:
    """Add strokes one by one, each where most is lost; ``clear_mm`` is how far a line keeps from the border."""
    ways = {
        value: lattice.ways_from([line for line in drawn if line[0] == name], value) for value, name in names.items()
    }
    may_start = np.zeros(len(lattice.label), np.bool_)
    for label in np.unique(lattice.label):
        own = lattice.label == label
        may_start[own] = phantom.truth.value(lattice.points_mm[own], int(label)) < -clear_mm
    may_start &= lattice.depth_mm > DEEP * phantom.scale
    added: list[Line] = []
    while len(added) < most:
        lost = lattice.lost(ways)
        lost[~may_start] = 0.0
        worst = int(np.argmax(lost))
        if lost[worst] <= 0.0:
            break
        label, value = int(lattice.label[worst]), int(lattice.group[worst])
        ends = lattice.points_mm[(lost > 0.0) & (lattice.label == label)]
        line = (names[value], radius_mm, _longest_line(phantom, label, lattice.points_mm[worst], ends, clear_mm))
        added.append(line)
        ways[value] = np.minimum(ways[value], lattice.ways_from([line], value, limit_mm=REACH * phantom.scale))
    return added


def _shifted(number: Int64, way: Int64) -> Int64:
    """What has a neighbour on the other side of each step of a way."""
    part = [slice(max(0, int(step)), size + min(0, int(step))) for step, size in zip(way, number.shape, strict=True)]
    shifted: Int64 = number[tuple(part)]
    return shifted


def _ways(graph: csr_array, sources: Bool, limit_mm: float = np.inf) -> Float64:
    if not sources.any():
        return np.full(len(sources), np.inf)
    ways: Float64 = dijkstra(graph, indices=np.flatnonzero(sources), min_only=True, limit=limit_mm)
    return ways


def _dense(line_mm: Float64) -> Float64:
    """Points along a polyline, its corners among them, less than 1 mm apart."""
    parts = [line_mm[:1]]
    for start, end in pairwise(line_mm):
        count = int(np.ceil(np.linalg.norm(end - start))) + 1
        parts.append(start + np.linspace(0.0, 1.0, count + 1)[1:, None] * (end - start))
    return np.concatenate(parts)


def _longest_line(phantom: HeartPhantom, label: int, start: Float64, ends: Float64, clear_mm: float) -> Float64:
    """From a point to the farthest of others that a brush reaches in a straight line; else the point alone."""
    away = np.linalg.norm(ends - start, axis=1).round(3)
    ends = ends[away <= LONGEST * phantom.scale]
    away = away[away <= LONGEST * phantom.scale]
    for n in np.argsort(-away, kind="stable")[:TRIED]:
        line = np.stack([start, ends[n]])
        if away[n] > 0.0 and (phantom.truth.value(_dense(line), label) < -clear_mm).all():
            return line
    return start[None]
