"""Where sheets cross one another, and where three triangles meet in a point."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from heartcase.schemas.arrays import Float64, Int64
from heartcase.simulator.mesh_arrangement.arc_kernels import meet_in_points
from heartcase.simulator.mesh_arrangement.exact_ties import comes_first, is_in_all_three
from heartcase.simulator.mesh_arrangement.merged_rows import order_rows
from heartcase.simulator.mesh_arrangement.sheet_mesh import Merged, SheetMesh
from heartcase.simulator.mesh_arrangement.sheet_sides import cross_triangles
from heartcase.simulator.mesh_arrangement.surface_crossings import renumber_ends
from heartcase.simulator.mesh_arrangement.uncut_surface import UncutSurface

__all__ = ["Arcs", "SheetArcs", "cross_points", "cross_sheets", "joined_arcs"]

_NOT_ZERO = 1e-5
"""Distance from the edges of a triangle, in whole numbers, from which on a place is on a side of them for sure."""
_PARALLEL = 1e-6
"""Sine of the angle between planes below which they are one."""
_SAME = 1e-9
"""Share of an arc by which two points on it must be apart for their order to be sure."""


class Arcs(NamedTuple):
    """Pieces of lines along which two facets cross, from node to node."""

    facets: Int64
    """Both facets, shape (count, 2): of the surface first, or of two of sheets the lower triangle."""
    nodes: Int64
    """First and last node, shape (count, 2); they run along the cross product of both facets' normals."""
    weights: Float64
    """Barycentric places of both ends in both facets, shape (count, 2, 2, 3): end, facet, corner."""
    turns: Float64
    """Where an end is on a sheet's edge, the arc's place in the order around it in the other facet, counter-clockwise;
    else not a number, shape (count, 2)."""
    own_turns: Float64
    """The same in the first facet alone, at points where two sheets lie in one plane, shape (count, 2)."""


class SheetArcs(NamedTuple):
    """Arcs of two triangles of sheets; see :func:`heartcase.simulator.mesh_arrangement.sheet_sides.cross_triangles`."""

    pairs: Int64
    ends: Int64
    weights: Float64
    corners: Int64


def cross_sheets(surface: UncutSurface, mesh: SheetMesh, asked: Int64) -> SheetArcs:
    """Arcs of some triangles of sheets near a surface with all others, by pairs of triangles."""
    shift, low, size, _, _ = surface.buckets
    low, size = low >> 1, ((low + size - 1) >> 1) - (low >> 1) + 1
    room = 4 * len(asked) + 64
    while True:
        pairs, ends, corners = (np.empty((room, 2), np.int64) for _ in range(3))
        weights = np.empty((room, 2, 2, 3))
        count = cross_triangles(
            mesh.vertices,
            mesh.triangles,
            mesh.edges,
            asked,
            (shift + 1, low, size),
            pairs,
            ends,
            weights,
            corners,
        )
        if count <= room:
            order = order_rows(pairs[:count])
            return SheetArcs(pairs[order], ends[order], weights[order], corners[order])
        room = count


def joined_arcs(before: SheetArcs, more: SheetArcs, merged: Merged) -> SheetArcs:
    """Arcs of a mesh that others were added to, together with those of the others, by pairs of triangles."""
    pairs = np.concatenate([merged.triangles[before.pairs], more.pairs])
    ends, corners = before.ends.copy(), before.corners.copy()
    renumber_ends(ends, merged.triangles, merged.edges)
    has_corner = corners >= 0
    corners[has_corner] = merged.vertices[corners[has_corner]]
    order = order_rows(pairs)
    return SheetArcs(
        pairs[order],
        np.concatenate([ends, more.ends])[order],
        np.concatenate([before.weights, more.weights])[order],
        np.concatenate([corners, more.corners])[order],
    )


class _Points(NamedTuple):
    """Points in which three facets meet."""

    arcs: Int64
    """Arcs through each, three, shape (count, 3)."""
    places: Float64
    """In QUANTA to a cell, shape (count, 3)."""
    facets: Int64
    """The facets, one of the surface first, shape (count, 3)."""
    turns: Float64
    """Where two are in one plane, the angle from the arc of the first to that of the second in the third facet; else
    not a number, shape (count,)."""


def cross_points(corners: Int64, numbers: Int64, arcs: Arcs, surface_facets: int, first_node: int) -> tuple[Arcs, int]:
    """Divide arcs where others cross them.

    Parameters
    ----------
    corners, numbers
        Whole-number places of the corners of all facets, shape (facet_count, 3, 3), and their nodes.
    arcs
        Arcs; those that cross the surface first, each kind by its facets.
    surface_facets
        Number of facets of the surface, which come first.
    first_node
        Number of the first node that is made.

    Returns
    -------
    arcs, count
        What they are divided into, and how many nodes were made.
    """
    is_between = arcs.facets[:, 0] >= surface_facets
    between = np.flatnonzero(is_between)
    if not len(between):
        return arcs, 0
    first_between = int(between[0])
    on_surface = _candidates(arcs.facets, between, np.arange(first_between), first_of_third=True)
    of_sheets = _candidates(arcs.facets, between, between, first_of_third=False)
    points = [_points(corners, numbers, arcs, triple, surface_facets) for triple in (on_surface, of_sheets)]
    found = _Points(*(np.concatenate(both) for both in zip(*points, strict=True)))
    if not len(found.arcs):
        return arcs, 0
    arc, point = _in_order(corners, numbers, arcs, found, surface_facets)
    is_second = found.arcs[point, 2] == arc
    turn = np.where(is_second, found.turns[point], np.where(np.isnan(found.turns[point]), np.nan, 0.0))
    turn[found.arcs[point, 0] == arc] = np.nan
    return _divided(corners, arcs, arc, point, turn, found.places, first_node), len(found.arcs)


def _in_order(corners: Int64, numbers: Int64, arcs: Arcs, points: _Points, surface_facets: int) -> tuple[Int64, Int64]:
    """Arcs through points and the points on them, arc by arc in order."""
    arc, point = points.arcs.ravel(), np.repeat(np.arange(len(points.arcs)), 3)
    start, stop = (_place(corners, arcs.facets[arc, 0], arcs.weights[arc, end, 0]) for end in (0, 1))
    way = stop - start
    squared = np.einsum("nx,nx->n", way, way)
    share = np.einsum("nx,nx->n", points.places[point] - start, way) / np.where(squared > 0, squared, 1.0)
    order = np.lexsort((point, share, arc))
    arc, point, share, way = arc[order], point[order], share[order], way[order]
    is_tie = (np.diff(arc) == 0) & (np.diff(share) < _SAME)
    for at in np.flatnonzero(is_tie).tolist():
        here = at
        while here >= 0 and is_tie[here]:
            facets = points.facets[point[here : here + 2]]
            of_surface = (facets[:, 0] < surface_facets).tolist()
            if comes_first(corners[facets], numbers[facets], of_surface, way[here]):
                break
            point[here : here + 2] = point[[here + 1, here]]
            here -= 1
    return arc, point


def _candidates(facets: Int64, between: Int64, others: Int64, *, first_of_third: bool) -> Int64:
    """Arcs of two sheets with, for a third facet, the arc of each of the two with it, shape (count, 3)."""
    keys = facets[others, 0] << 31 | facets[others, 1]
    order = np.argsort(keys)
    keys = keys[order]
    # Of the surface the third facet comes first in its arcs; of three sheets it is the highest.
    column = 1 if first_of_third else 0
    by_facet = np.argsort(facets[others, column], kind="stable")
    of_facet = facets[others, column][by_facet]
    one, other = facets[between, 0], facets[between, 1]
    start, stop = (np.searchsorted(of_facet, one, side=side) for side in ("left", "right"))
    counts = stop - start
    rows = np.repeat(start, counts) + np.arange(counts.sum()) - np.repeat(np.cumsum(counts) - counts, counts)
    arc = np.repeat(between, counts)
    with_one = others[by_facet[rows]]
    third = facets[with_one, 1 - column]
    second = np.repeat(other, counts)
    wanted = third << 31 | second if first_of_third else second << 31 | third
    at = np.minimum(np.searchsorted(keys, wanted), max(len(keys) - 1, 0))
    is_there = keys[at] == wanted if len(keys) else np.zeros(len(wanted), np.bool_)
    return np.stack([arc[is_there], with_one[is_there], others[order[at[is_there]]]], axis=1)


def _points(corners: Int64, numbers: Int64, arcs: Arcs, triples: Int64, surface_facets: int) -> _Points:
    """Points where three facets meet, of candidates."""
    between, with_one = triples[:, 0], triples[:, 1]
    facets = arcs.facets
    third = np.where(facets[with_one, 0] == facets[between, 0], facets[with_one, 1], facets[with_one, 0])
    meeting = np.stack([third, facets[between, 0], facets[between, 1]], axis=1)
    place, found = np.empty((len(triples), 3)), np.empty(len(triples), np.int8)
    meet_in_points(corners, meeting, _NOT_ZERO, place, found)
    inside, turns = found == 1, np.full(len(triples), np.nan)
    for row in np.flatnonzero(found == 2).tolist():
        three = meeting[row]
        first_is_surface = bool(three[0] < surface_facets)
        inside[row], place[row], way = is_in_all_three(
            corners[three], numbers[three], first_is_surface=first_is_surface
        )
        one, other = (np.cross(q - p, r - p).astype(np.float64) for p, q, r in corners[three[1:]])
        if np.linalg.norm(np.cross(one, other)) <= _PARALLEL * np.linalg.norm(one) * np.linalg.norm(other):
            turns[row] = way * (_PARALLEL if one @ other > 0 else np.pi - _PARALLEL)
    return _Points(triples[inside], place[inside], meeting[inside], turns[inside])


def _place(corners: Int64, facets: Int64, weights: Float64) -> Float64:
    place: Float64 = np.einsum("nc,ncx->nx", weights, corners[facets].astype(np.float64))
    return place


def _divided(
    corners: Int64, arcs: Arcs, arc: Int64, point: Int64, turn: Float64, places: Float64, first_node: int
) -> Arcs:
    """Arcs from node to node along each, of arcs and points on them in order."""
    facets = arcs.facets[arc]
    inner = np.stack(
        [barycentric(corners[facets[:, each]].astype(np.float64), places[point]) for each in (0, 1)], axis=1
    )
    # Start of each arc, then its points; each goes to the next of the same arc, the last to its end.
    count = len(arcs.nodes)
    of_arc = np.concatenate([np.arange(count), arc])
    rank = np.concatenate([np.full(count, -1), np.arange(len(arc))])
    by_arc = np.lexsort((rank, of_arc))
    of_arc = of_arc[by_arc]
    nodes = np.concatenate([arcs.nodes[:, 0], first_node + point])[by_arc]
    weights = np.concatenate([arcs.weights[:, 0], inner])[by_arc]
    is_last = np.append(of_arc[1:] != of_arc[:-1], True)
    next_nodes = np.where(is_last, arcs.nodes[of_arc, 1], np.roll(nodes, -1))
    next_weights = np.where(is_last[:, None, None], arcs.weights[of_arc, 1], np.roll(weights, -1, axis=0))
    first_turns = np.concatenate([arcs.turns[:, 0], np.full(len(arc), np.nan)])[by_arc]
    last_turns = np.where(is_last, arcs.turns[of_arc, 1], np.nan)
    own = np.concatenate([arcs.own_turns[:, 0], turn])[by_arc]
    last_own = np.where(is_last, arcs.own_turns[of_arc, 1], np.roll(own, -1) + np.pi)
    return Arcs(
        arcs.facets[of_arc],
        np.stack([nodes, next_nodes], axis=1),
        np.stack([weights, next_weights], axis=1),
        np.stack([first_turns, last_turns], axis=1),
        np.stack([own, last_own], axis=1),
    )


def barycentric(triangles: Float64, places: Float64) -> Float64:
    """Barycentric places of points in the planes of triangles, shapes (count, 3, 3) and (count, 3) to (count, 3)."""
    p, u, v = triangles[:, 0], triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0]
    w = places - p
    uu, uv, vv = (np.einsum("nx,nx->n", a, b) for a, b in ((u, u), (u, v), (v, v)))
    wu, wv = np.einsum("nx,nx->n", w, u), np.einsum("nx,nx->n", w, v)
    determinant = uu * vv - uv * uv
    safe = np.where(determinant > 0, determinant, 1.0)
    second = np.where(determinant > 0, (vv * wu - uv * wv) / safe, 0.0)
    third = np.where(determinant > 0, (uu * wv - uv * wu) / safe, 0.0)
    return np.stack([1.0 - second - third, second, third], axis=1)
