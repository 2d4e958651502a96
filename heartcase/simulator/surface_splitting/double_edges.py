"""Edges that have both ends in common with another: each gets a vertex in its middle.

Beside the corner of a sheet that ends inside the tissue, say, two vertices of the incision's tip are joined by an edge
of one wall and by another of the other wall. The surface is closed all the same; but then an edge would not be known
by its ends.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from heartcase.schemas.arrays import Bool, Int64
from heartcase.simulator.surface_splitting.gluing import has_double_edges, join_sets

__all__ = ["Corners", "separate_fans", "without_double_edges"]


class Corners(NamedTuple):
    """Triangles by their corners."""

    triangles: Int64
    """Corner numbers, shape (triangle_count, 3)."""
    kept: Int64
    """Triangle that each is, or is a part of, shape (triangle_count,)."""
    vertices: Int64
    """Vertex of each corner, those that were made at the end, shape (corner_count,)."""
    middles: Int64
    """Corners at the ends of the edge that each of the added corners halves, shape (added_count, 2)."""
    middle_triangles: Int64
    """One triangle at that edge; one of the surface if there is one, shape (added_count,)."""
    is_unsure: bool
    """Whether triangles may touch in a vertex alone, which :func:`separate_fans` mends."""


def without_double_edges(triangles: Int64, vertices: Int64, following: Int64, partner: Int64, is_wall: Bool) -> Corners:
    """Halve edges of triangles that share both their vertices with others.

    Parameters
    ----------
    triangles
        Corner numbers, shape (triangle_count, 3): half-edges, plus their number in the second copy.
    vertices
        Vertex of each corner, shape (corner_count,).
    following, partner
        The half-edge that follows each in its face, shape (half_count,), and the one, with its copy, that each is glued
        to, shape (2 half_count,).
    is_wall
        Which triangles are walls, shape (triangle_count,).
    """
    kept = np.arange(len(triangles))
    first_added, all_vertices = len(vertices), vertices
    vertex_count = int(vertices.max(initial=-1)) + 1
    middles: list[tuple[int, int]] = []
    is_unsure = False
    at: list[int] = []
    added: list[int] = []
    while has_double_edges(triangles, all_vertices):
        starts, ends = triangles.ravel(), np.roll(triangles, -1, axis=1).ravel()
        one, other = all_vertices[starts], all_vertices[ends]
        keys = np.minimum(one, other) << 32 | np.maximum(one, other)
        order = np.argsort(keys, kind="stable")
        ordered = keys[order]
        alike = np.flatnonzero(ordered[2:] == ordered[:-2])
        rows = order[np.unique(alike[:, None] + np.arange(3))]
        by_name: dict[tuple[int, ...], list[int]] = {}
        for row, start, end in zip(rows.tolist(), starts[rows].tolist(), ends[rows].tolist(), strict=True):
            name = _name(start, end, all_vertices, middles, following, partner)
            by_name.setdefault((int(keys[row]), *name), []).append(row)
        for name, alike_rows in list(by_name.items()):
            if len(alike_rows) > 2:
                # One name for more than one edge: any two that run against each other will do.
                is_unsure = True
                ways = [[row for row in alike_rows if (one[row] < other[row]) == way] for way in (True, False)]
                del by_name[name]
                for number, both in enumerate(zip(*ways, strict=False)):
                    by_name[(*name, number)] = list(both)
        # One of each kind stays whole: one that the surface around has too, if there is one.
        edges = sorted(by_name.items(), key=lambda item: (item[0][0], len(item[1]), item[0]))
        halved: dict[int, tuple[int, int]] = {}
        before = None
        for (key, *_), pair in edges:
            is_first, before = key != before, key
            if is_first or len(pair) == 1 or any(row // 3 in halved for row in pair):
                continue
            of = min(pair, key=lambda row: (is_wall[kept[row // 3]], row))
            corner = first_added + len(middles)
            middles.append((int(triangles[of // 3, of % 3]), int(triangles[of // 3, (of + 1) % 3])))
            at.append(int(kept[of // 3]))
            added.append(vertex_count + len(added))
            for row in pair:
                halved[row // 3] = (row % 3, corner)
        if not halved:
            break
        triangles, kept = _halved(triangles, kept, halved)
        all_vertices = np.concatenate([vertices, np.array(added, np.int64)])
    return Corners(
        triangles,
        kept,
        all_vertices,
        np.array(middles, np.int64).reshape(-1, 2),
        np.array(at, np.int64),
        is_unsure,
    )


def separate_fans(vertices: Int64, first_new: int) -> Int64:
    """Give each circle of triangles around a new vertex a vertex of its own, shape (triangle_count, 3).

    Parameters
    ----------
    vertices
        Of the triangles, shape (triangle_count, 3).
    first_new
        Number of the first new vertex.
    """
    starts, ends = vertices.ravel(), np.roll(vertices, -1, axis=1).ravel()
    corner = np.arange(vertices.size)
    after = np.roll(corner.reshape(-1, 3), -1, axis=1).ravel()
    order = np.argsort(starts << 32 | ends, kind="stable")
    keys, wanted = (starts << 32 | ends)[order], ends << 32 | starts
    at = np.minimum(np.searchsorted(keys, wanted), len(keys) - 1)
    found = np.flatnonzero(keys[at] == wanted)
    parents = np.arange(vertices.size)
    join_sets(parents, np.stack([corner[found], after[order[at[found]]]], axis=1))
    # The fan with the first corner keeps the vertex's number.
    fans, first = np.unique(np.stack([starts, parents], axis=1), axis=0, return_index=True)
    is_more = (np.diff(fans[:, 0], prepend=-1) == 0) & (fans[:, 0] >= first_new)
    named = fans[:, 0].copy()
    named[is_more] = starts.max(initial=-1) + 1 + np.arange(is_more.sum())
    of_fan = np.empty(vertices.size, np.int64)
    of_fan[parents[first]] = named
    return of_fan[parents].reshape(-1, 3)


def _name(
    start: int, end: int, vertices: Int64, middles: list[tuple[int, int]], following: Int64, partner: Int64
) -> tuple[int, ...]:
    """The same name for both sides of an edge."""
    first_added, half_count = len(vertices) - len(middles), len(following)
    low, high = min(start, end), max(start, end)
    if high >= first_added:
        # Half of an edge has the same middle on both sides; other edges are within one triangle.
        is_half = vertices[low] in vertices[list(middles[high - first_added])]
        return (high, -1, int(vertices[low])) if is_half else (high, low)
    copy = half_count * (start // half_count)
    a, b = start - copy, end - copy
    if following[a] == b or following[b] == a:
        half = (a if following[a] == b else b) + copy
        return -1, min(half, int(partner[half]))
    return low, high


def _halved(triangles: Int64, kept: Int64, halved: dict[int, tuple[int, int]]) -> tuple[Int64, Int64]:
    triangles = triangles.copy()
    more = []
    for triangle, (side, corner) in halved.items():
        a, b, c = np.roll(triangles[triangle], -side)
        triangles[triangle] = a, corner, c
        more.append((corner, b, c))
    numbers = np.array(list(halved), np.int64)
    return np.concatenate([triangles, np.array(more, np.int64).reshape(-1, 3)]), np.concatenate([kept, kept[numbers]])
