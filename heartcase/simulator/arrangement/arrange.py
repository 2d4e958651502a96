"""The arrangement of a surface and the sheets through it: its nodes, arcs, and triangles with arcs, the facets.

Facets are first the triangles of the surface that a sheet crosses, then all triangles of the sheets. Nodes are the
vertices of the surface, then those of the sheets, then the ends of arcs.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from heartcase.schemas.arrays import Bool, Float64, Int64
from heartcase.simulator.arrangement.exact_ties import is_nearer
from heartcase.simulator.arrangement.facet_graphs import divide_facets
from heartcase.simulator.arrangement.merged_rows import order_rows
from heartcase.simulator.arrangement.sheet_crossings import Arcs, SheetArcs, cross_points, cross_sheets, joined_arcs
from heartcase.simulator.arrangement.sheet_mesh import NO_SHEETS, SheetMesh, merged_mesh
from heartcase.simulator.arrangement.surface_crossings import cross_surface, renumber_ends
from heartcase.simulator.arrangement.uncut_surface import UncutSurface
from heartcase.simulator.cutting.blade_sheet import Sheet
from heartcase.simulator.cutting.crossings import QUANTA

__all__ = ["NOTHING_CROSSES", "Arcs", "Arrangement", "Crossings", "Faces", "arrange", "crossings"]

_SAME = 2.0**36
"""Shares of an edge that are the same when rounded by this are in the order in which a movement puts them."""
_OF_SHEETS = np.int64(1) << 62


class Faces(NamedTuple):
    """What the arcs leave of the facets; see :func:`heartcase.simulator.arrangement.facet_graphs.divide_facets`."""

    halves: Int64
    """Node, face, following half-edge and kind of each half-edge, shape (half_count, 4)."""
    joined: Int64
    """Half-edges that start in one corner of a face, shape (count, 2)."""
    triangles: Int64
    """Half-edges of the corners of each triangle, shape (triangle_count, 3)."""
    facet: Int64
    """Facet of each face, shape (face_count,)."""


class Arrangement(NamedTuple):
    """Surface and sheets, divided by one another."""

    crossed: Int64
    """Triangle of the surface of each of the first facets, ascending."""
    corners: Int64
    """Nodes of each facet, shape (facet_count, 3)."""
    facet_edges: Int64
    """Edge that follows each corner: of the surface, or its edge count and the number of a sheet's."""
    facet_forward: Bool
    """Whether the facet goes along that edge from its lower node, shape (facet_count, 3)."""
    arcs: Arcs
    arc_lists: Int64
    """Arc of each entry of the facets' lists of arcs, to which the kinds of half-edges point, shape (2 arc_count,)."""
    faces: Faces
    places: Float64
    """Place of each node that is not a vertex of the surface, in the frame of the nodes [cells], shape (count, 3)."""
    on_surface: Int64
    """Triangle of the surface that each of these lies on, or -1, shape (count,)."""
    surface_weights: Float64
    """Their barycentric places there, shape (count, 3)."""


class Crossings(NamedTuple):
    """What crosses what: all that is needed of a cut for the next to go on from it."""

    mesh: SheetMesh
    of_surface: SheetArcs
    """Arcs of the surface and sheets, by triangles of the surface, then of sheets; without corners."""
    between: SheetArcs
    """Arcs of two triangles of sheets, by these."""


NOTHING_CROSSES = Crossings(
    NO_SHEETS,
    *(
        SheetArcs(
            np.zeros((0, 2), np.int64), np.zeros((0, 2), np.int64), np.zeros((0, 2, 2, 3)), np.zeros((0, 2), np.int64)
        )
        for _ in range(2)
    ),
)
"""Where there is no sheet."""


def crossings(surface: UncutSurface, sheets: Sequence[Sheet], before: Crossings, first: int) -> Crossings:
    """What sheets cross.

    Parameters
    ----------
    surface
        The uncut surface.
    sheets
        All sheets.
    before, first
        What the first of these cross, and how many these are.
    """
    merged = merged_mesh(before.mesh, sheets, first)
    own = _surface_arcs(surface, merged.mesh, merged.added)
    pairs, ends = before.of_surface.pairs.copy(), before.of_surface.ends.copy()
    pairs[:, 1] = merged.triangles[pairs[:, 1]]
    renumber_ends(ends, merged.triangles, merged.edges)
    pairs = np.concatenate([pairs, own.pairs])
    order = order_rows(pairs)
    of_surface = SheetArcs(
        pairs[order],
        np.concatenate([ends, own.ends])[order],
        np.concatenate([before.of_surface.weights, own.weights])[order],
        own.corners,
    )
    between = cross_sheets(surface, merged.mesh, merged.added)
    return Crossings(merged.mesh, of_surface, joined_arcs(before.between, between, merged))


def _surface_arcs(surface: UncutSurface, mesh: SheetMesh, asked: Int64) -> SheetArcs:
    """Arcs of the surface and triangles of sheets."""
    room = 64 * len(asked) + 1024
    while True:
        pairs, ends = np.empty((room, 2), np.int64), np.empty((room, 2), np.int64)
        weights = np.empty((room, 2, 2, 3))
        count = cross_surface(
            surface.vertices,
            surface.triangles,
            surface.edges,
            surface.buckets,
            mesh.vertices,
            mesh.triangles,
            mesh.edges,
            asked,
            pairs,
            ends,
            weights,
        )
        if count <= room:
            return SheetArcs(pairs[:count], ends[:count], weights[:count], np.zeros((0, 2), np.int64))
        room = count


def arrange(surface: UncutSurface, crossing: Crossings) -> Arrangement:
    """Divide a surface and sheets by one another."""
    mesh, between = crossing.mesh, crossing.between
    vertex_count, sheet_count = surface.vertex_count, len(mesh.vertices)
    pairs, ends, weights, _ = crossing.of_surface
    crossed = np.unique(pairs[:, 0])
    first_sheet = len(crossed)
    facets = np.concatenate(
        [
            np.stack([np.searchsorted(crossed, pairs[:, 0]), first_sheet + pairs[:, 1]], axis=1),
            first_sheet + between.pairs,
        ]
    )
    keys, number = np.unique(np.concatenate([ends, between.ends]).ravel(), return_inverse=True)
    nodes = vertex_count + sheet_count + number.reshape(-1, 2)
    all_ends = np.concatenate([ends, between.ends])
    turns, nothing = _turns(mesh, facets - first_sheet, all_ends), np.full(all_ends.shape, np.nan)
    arcs = Arcs(facets, nodes, np.concatenate([weights, between.weights]), turns, nothing)
    # Ends in a corner that both triangles of sheets have are that corner's node.
    at_corner = between.corners >= 0
    arcs.nodes[len(pairs) :][at_corner] = vertex_count + between.corners[at_corner]

    corners = np.concatenate([surface.triangles[crossed], vertex_count + mesh.triangles])
    edge_count = surface.edge_count
    facet_edges = np.concatenate([surface.edges[crossed], edge_count + mesh.edges])
    facet_forward = corners < np.roll(corners, -1, axis=1)
    edge_first, edge_nodes, edge_shares = _nodes_on_edges(
        surface, mesh, crossed, arcs, keys, (corners, facet_edges, facet_forward)
    )
    ints = np.concatenate([surface.vertices[surface.triangles[crossed]], mesh.vertices[mesh.triangles]])
    arcs, point_count = cross_points(ints, corners, arcs, first_sheet, vertex_count + sheet_count + len(keys))
    flat = _flat_corners(surface, mesh, crossed)
    arc_lists, faces = _faces(surface, mesh, crossed, arcs, corners, flat, (edge_first, edge_nodes, edge_shares))
    node_places = _node_places(surface, mesh, crossed, arcs, len(keys) + point_count)
    return Arrangement(crossed, corners, facet_edges, facet_forward, arcs, arc_lists, faces, *node_places)


def _turns(mesh: SheetMesh, triangles: Int64, keys: Int64) -> Float64:
    """Place of each end of each arc in the order around the sheet's edge that it is on, shape (count, 2)."""
    of_sheet = keys.ravel() >= _OF_SHEETS
    between = keys.ravel() < 0
    edge = np.where(between, -1 - keys.ravel(), keys.ravel() & ~_OF_SHEETS) >> 31
    turns = np.full(len(edge), np.nan)
    forward = mesh.triangles < np.roll(mesh.triangles, -1, axis=1)
    count = np.bincount(mesh.edges.ravel(), minlength=1)
    for which in (0, 1):
        rows = np.flatnonzero(between if which == 0 else of_sheet | between)
        of_row = triangles[rows // 2, which]
        is_side = mesh.edges[of_row] == edge[rows, None]
        rows, of_row, is_side = (each[is_side.any(axis=1)] for each in (rows, of_row, is_side))
        side = is_side.argmax(axis=1)
        # Seen from before the other facet the edge comes towards one, or goes away.
        is_towards = (rows % 2 == which) == forward[of_row, side]
        turn = 2.0 * np.pi * mesh.ranks[of_row, side] / count[edge[rows]]
        turns[rows] = np.where(is_towards, turn, -turn)
    return turns.reshape(-1, 2)


def _normals(surface: UncutSurface, mesh: SheetMesh, crossed: Int64) -> Float64:
    """Normals of all facets as their whole numbers have them, twice the area long."""
    p, q, r = np.moveaxis(
        np.concatenate([surface.vertices[surface.triangles[crossed]], mesh.vertices[mesh.triangles]]), 1, 0
    )
    return np.cross(q - p, r - p).astype(np.float64)


def _nodes_on_edges(
    surface: UncutSurface,
    mesh: SheetMesh,
    crossed: Int64,
    arcs: Arcs,
    keys: Int64,
    facets: tuple[Int64, Int64, Bool],
) -> tuple[Int64, Int64, Float64]:
    """Nodes on the edges of each facet, in order: where each edge's begin, the nodes, and how far along they are."""
    corners, facet_edges, facet_forward = facets
    edge_count = surface.edge_count
    first_node = surface.vertex_count + len(mesh.vertices)
    # One arc that ends in each node, and the facet of the two whose edge the node is on.
    at_end = arcs.nodes.ravel() - first_node
    is_end = at_end >= 0
    rows = np.full(len(keys), -1)
    rows[at_end[is_end][::-1]] = np.flatnonzero(is_end)[::-1]
    arc, end = rows // 2, rows % 2
    is_on_surface = (keys >= 0) & (keys < _OF_SHEETS)
    of_pair = (keys >= 0) & ~is_on_surface
    edge = np.where(is_on_surface, keys >> 31, edge_count + ((np.where(keys < 0, -1 - keys, keys) & ~_OF_SHEETS) >> 31))
    has_edge = facet_edges[arcs.facets[arc]] == edge[:, None, None]
    which = np.where(is_on_surface, 0, np.where(of_pair, 1, has_edge[:, 1].any(axis=1)))
    facet, other = (arcs.facets[arc, each] for each in (which, 1 - which))
    side = has_edge[np.arange(len(keys)), which].argmax(axis=1)
    share = arcs.weights[arc, end, which, (side + 1) % 3]
    share = np.where(facet_forward[facet, side], share, 1.0 - share)
    # The surface is moved against the sheets: what is in one place goes apart as the sheets' normals say.
    normals = _normals(surface, mesh, crossed)[other]
    ints = np.concatenate([surface.vertices, mesh.vertices])
    start, stop = corners[facet, side], corners[facet, (side + 1) % 3]
    way = (ints[stop] - ints[start]) * np.where(facet_forward[facet, side], 1, -1)[:, None]
    along = np.einsum("nx,nx->n", normals, way.astype(np.float64))
    moved = np.divide(normals, along[:, None], out=np.zeros_like(normals), where=along[:, None] != 0)
    moved *= np.where(is_on_surface, -1.0, np.where(of_pair, 1.0, 0.0))[:, None]
    order = np.lexsort((moved[:, 0], moved[:, 2], moved[:, 1], np.round(share * _SAME), edge))
    of_edge, at = edge[order], np.round(share[order] * _SAME)
    kind = np.where(is_on_surface, 0, np.where(of_pair, 1, 2))[order]
    is_tie = (np.diff(of_edge) == 0) & (np.diff(at) == 0) & (np.diff(kind) == 0) & (kind[1:] != 1)
    forward = facet_forward[facet, side]
    start, stop = np.where(forward, start, stop), np.where(forward, stop, start)
    for place in np.flatnonzero(is_tie).tolist():
        # What has come in order so far is gone back through.
        while place >= 0 and is_tie[place]:
            ends = np.array([start[order[place]], stop[order[place]]])
            both = corners[other[order[place : place + 2]]]
            if is_nearer(ints[ends], ends, ints[both], both, edge_is_of_surface=bool(is_on_surface[order[place]])):
                break
            order[place : place + 2] = order[[place + 1, place]]
            place -= 1
    by_edge = edge[order]
    # Each facet's three edges in turn, against their order where the facet goes backwards.
    starts = np.searchsorted(by_edge, facet_edges.ravel(), side="left")
    counts = np.searchsorted(by_edge, facet_edges.ravel(), side="right") - starts
    first = np.append(0, np.cumsum(counts))
    within = np.arange(first[-1]) - np.repeat(first[:-1], counts)
    forward = np.repeat(facet_forward.ravel(), counts)
    at = np.repeat(starts, counts) + np.where(forward, within, np.repeat(counts, counts) - 1 - within)
    shares = share[order][at]
    return first, first_node + order[at], np.where(forward, shares, 1.0 - shares)


def _flat_corners(surface: UncutSurface, mesh: SheetMesh, crossed: Int64) -> Float64:
    """Corners of all facets in their planes, first along x, shape (facet_count, 3, 2)."""
    places = np.concatenate([surface.places[surface.triangles[crossed]], _cells(mesh)[mesh.triangles]])
    p, q, r = np.moveaxis(places, 1, 0)
    length = np.linalg.norm(q - p, axis=1)
    area = np.linalg.norm(np.cross(q - p, r - p), axis=1)
    flat = np.zeros((len(places), 3, 2))
    fine = (length > 0) & (area > 0)
    flat[:, 1, 0] = np.where(fine, length, 1.0)
    safe = np.where(fine, length, 1.0)
    flat[:, 2, 0] = np.where(fine, np.einsum("fx,fx->f", q - p, r - p) / safe, 0.0)
    flat[:, 2, 1] = np.where(fine, area / safe, 1.0)
    return flat


def _cells(mesh: SheetMesh) -> Float64:
    return mesh.vertices / QUANTA


def _faces(
    surface: UncutSurface,
    mesh: SheetMesh,
    crossed: Int64,
    arcs: Arcs,
    corners: Int64,
    flat: Float64,
    on_edges: tuple[Int64, Int64, Float64],
) -> tuple[Int64, Faces]:
    facet_count, arc_count = len(corners), len(arcs.nodes)
    arc_lists = np.argsort(arcs.facets.ravel(), kind="stable")
    arc, which = arc_lists // 2, arc_lists % 2
    of_facet = arcs.facets.ravel()[arc_lists]
    arc_first = np.searchsorted(of_facet, np.arange(facet_count + 1))
    arc_places = np.einsum("aec,acx->aex", arcs.weights[arc, :, which], flat[of_facet])
    normals = _normals(surface, mesh, crossed)
    places = np.concatenate([surface.places[surface.triangles[crossed]], _cells(mesh)[mesh.triangles]])
    way = np.cross(normals[arcs.facets[:, 0]], normals[arcs.facets[:, 1]])[arc]
    first = (places[:, 1] - places[:, 0])[of_facet]
    second = np.cross(normals[of_facet], first)
    ways = np.stack([np.einsum("ax,ax->a", way, axis) / _length(axis) for axis in (first, second)], axis=1)
    is_flat = np.abs(ways).max(axis=1, initial=0.0) == 0
    ways[is_flat] = (arc_places[:, 1] - arc_places[:, 0])[is_flat]
    edge_first, edge_nodes, edge_shares = on_edges
    half_room = 3 * facet_count + len(edge_nodes) + 8 * arc_count
    halves, joined = np.empty((half_room, 4), np.int64), np.empty((4 * arc_count, 2), np.int64)
    triangles = np.empty((half_room, 3), np.int64)
    half_count, joined_count, face_count, triangle_count = divide_facets(
        corners,
        flat,
        edge_first,
        edge_nodes,
        edge_shares,
        arc_first,
        arcs.nodes[arc],
        arc_places,
        ways,
        np.where((which == 0)[:, None] & ~np.isnan(arcs.own_turns[arc]), arcs.own_turns[arc], arcs.turns[arc]),
        halves,
        joined,
        triangles,
    )
    halves = halves[:half_count]
    facet = np.empty(face_count, np.int64)
    is_outline = (halves[:, 3] < 0) & (halves[:, 3] >= -3 * facet_count)
    facet[halves[is_outline, 1]] = (-1 - halves[is_outline, 3]) // 3
    is_arc = halves[:, 3] >= 0
    facet[halves[is_arc, 1]] = of_facet[halves[is_arc, 3] // 2]
    return arc_lists, Faces(halves, joined[:joined_count], triangles[:triangle_count], facet)


def _length(vectors: Float64) -> Float64:
    length: Float64 = np.linalg.norm(vectors, axis=1)
    return np.where(length > 0, length, 1.0)


def _node_places(
    surface: UncutSurface, mesh: SheetMesh, crossed: Int64, arcs: Arcs, end_count: int
) -> tuple[Float64, Int64, Float64]:
    """Places of the sheets' vertices and of the ends of arcs, and where on the surface they lie."""
    sheet_count, first_node = len(mesh.vertices), surface.vertex_count
    places = np.concatenate([_cells(mesh), np.zeros((end_count, 3))])
    on_surface, weights = np.full(len(places), -1), np.zeros((len(places), 3))
    is_of_surface = arcs.facets[:, 0] < len(crossed)
    for end in (1, 0):
        of_sheets = arcs.nodes[~is_of_surface, end] - first_node
        triangles = mesh.triangles[arcs.facets[~is_of_surface, 0] - len(crossed)]
        kept = of_sheets >= sheet_count
        found = np.einsum("ac,acx->ax", arcs.weights[~is_of_surface, end, 0], _cells(mesh)[triangles])
        places[of_sheets[kept]] = found[kept]
    for end in (1, 0):
        nodes = arcs.nodes[is_of_surface, end] - first_node
        on_surface[nodes] = crossed[arcs.facets[is_of_surface, 0]]
        weights[nodes] = arcs.weights[is_of_surface, end, 0]
    at = np.flatnonzero(on_surface >= 0)
    places[at] = np.einsum("ac,acx->ax", weights[at], surface.places[surface.triangles[on_surface[at]]])
    return places, on_surface, weights
