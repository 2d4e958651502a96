"""The arrangement of a surface and the sheets through it: its nodes, arcs, and triangles with arcs, the facets.

Facets are first the triangles of the surface that a sheet crosses, then all triangles of the sheets. Nodes are the
vertices of the surface, then those of the sheets, then the ends of arcs.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from heartcase.schemas.arrays import Float64, Int64
from heartcase.simulator.cutting.blade_sheet import Sheet
from heartcase.simulator.cutting.crossings import QUANTA
from heartcase.simulator.mesh_arrangement.arc_kernels import (
    end_turns,
    flat_corners,
    lay_arcs,
    list_on_edges,
    order_on_edges,
    place_nodes,
)
from heartcase.simulator.mesh_arrangement.exact_ties import is_nearer
from heartcase.simulator.mesh_arrangement.facet_graphs import divide_facets
from heartcase.simulator.mesh_arrangement.merged_rows import order_rows
from heartcase.simulator.mesh_arrangement.sheet_crossings import (
    Arcs,
    SheetArcs,
    cross_points,
    cross_sheets,
    joined_arcs,
)
from heartcase.simulator.mesh_arrangement.sheet_mesh import NO_SHEETS, SheetMesh, merged_mesh
from heartcase.simulator.mesh_arrangement.surface_crossings import cross_surface, renumber_ends
from heartcase.simulator.mesh_arrangement.uncut_surface import UncutSurface

__all__ = ["NOTHING_CROSSES", "Arcs", "Arrangement", "Crossings", "Faces", "arrange", "crossings"]

_SAME = 2.0**36
"""Shares of an edge that are the same when rounded by this are in the order in which a movement puts them."""


class Faces(NamedTuple):
    """What arcs leave of the facets; see :func:`heartcase.simulator.mesh_arrangement.facet_graphs.divide_facets`."""

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
    ints: Int64
    """Whole-number places of these, shape (facet_count, 3, 3)."""
    facet_edges: Int64
    """Edge that follows each corner: of the surface, or its edge count and the number of a sheet's."""
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
    all_ends = np.concatenate([ends, between.ends])
    keys, number = np.unique(all_ends.ravel(), return_inverse=True)
    nodes = vertex_count + sheet_count + number.reshape(-1, 2)
    turns, nothing = np.empty(all_ends.shape), np.full(all_ends.shape, np.nan)
    edge_count = len(mesh.edge_vertices)
    end_turns(mesh.triangles, mesh.edges, mesh.ranks, edge_count, facets - first_sheet, all_ends, turns)
    arcs = Arcs(facets, nodes, np.concatenate([weights, between.weights]), turns, nothing)
    # Ends in a corner that both triangles of sheets have are that corner's node.
    at_corner = between.corners >= 0
    arcs.nodes[len(pairs) :][at_corner] = vertex_count + between.corners[at_corner]

    corners = np.concatenate([surface.triangles[crossed], vertex_count + mesh.triangles])
    facet_edges = np.concatenate([surface.edges[crossed], surface.edge_count + mesh.edges])
    ints = np.concatenate([surface.vertices[surface.triangles[crossed]], mesh.vertices[mesh.triangles]])
    cells = mesh.vertices / QUANTA
    places = np.concatenate([surface.places[surface.triangles[crossed]], cells[mesh.triangles]])
    on_edges = _nodes_on_edges(arcs, keys, corners, facet_edges, ints, vertex_count + sheet_count, surface.edge_count)
    arcs, point_count = cross_points(ints, corners, arcs, first_sheet, vertex_count + sheet_count + len(keys))
    arc_lists, faces = _faces(arcs, corners, ints, places, on_edges)
    node_places = np.zeros((sheet_count + len(keys) + point_count, 3))
    node_places[:sheet_count] = cells
    on_surface, surface_weights = np.full(len(node_places), -1), np.zeros((len(node_places), 3))
    place_nodes(
        (surface.places, surface.triangles),
        (cells, mesh.triangles),
        crossed,
        arcs.nodes,
        arcs.facets,
        arcs.weights,
        vertex_count,
        node_places,
        on_surface,
        surface_weights,
    )
    return Arrangement(
        crossed, corners, ints, facet_edges, arcs, arc_lists, faces, node_places, on_surface, surface_weights
    )


def _nodes_on_edges(
    arcs: Arcs, keys: Int64, corners: Int64, facet_edges: Int64, ints: Int64, first_node: int, edge_count: int
) -> tuple[Int64, Int64, Float64]:
    """Nodes on the edges of each facet, in order: where each edge's begin, the nodes, and how far along they are."""
    count = len(keys)
    edges, shares, of_facets = np.empty(count, np.int64), np.empty(count), np.empty((count, 2), np.int64)
    sides, kinds = np.empty(count, np.int64), np.empty(count, np.int64)
    order, is_tie = order_on_edges(
        keys,
        first_node,
        arcs.nodes,
        arcs.facets,
        arcs.weights,
        corners,
        facet_edges,
        ints,
        edge_count,
        _SAME,
        (edges, shares, of_facets, sides, kinds),
    )
    for place in np.flatnonzero(is_tie).tolist():
        # What has come in order so far is gone back through.
        while place >= 0 and is_tie[place]:
            node = order[place]
            facet, side = of_facets[node, 0], sides[node]
            ends, places = corners[facet, [side, (side + 1) % 3]], ints[facet, [side, (side + 1) % 3]]
            if ends[0] > ends[1]:
                ends, places = ends[::-1], places[::-1]
            both = of_facets[order[place : place + 2], 1]
            if is_nearer(places, ends, ints[both], corners[both], edge_is_of_surface=bool(kinds[node] == 0)):
                break
            order[place : place + 2] = order[[place + 1, place]]
            place -= 1
    first, room = np.empty(3 * len(corners) + 1, np.int64), 8 * count
    while True:
        nodes, along = np.empty(room, np.int64), np.empty(room)
        found = list_on_edges(corners, facet_edges, order, edges, shares, first_node, first, nodes, along)
        if found <= room:
            return first, nodes[:found], along[:found]
        room = found


def _faces(
    arcs: Arcs, corners: Int64, ints: Int64, places: Float64, on_edges: tuple[Int64, Int64, Float64]
) -> tuple[Int64, Faces]:
    facet_count, arc_count = len(corners), len(arcs.nodes)
    flat, arc_lists = np.empty((facet_count, 3, 2)), np.empty(2 * arc_count, np.int64)
    flat_corners(places, flat)
    arc_first = np.zeros(facet_count + 1, np.int64)
    ends, ways, around = np.empty((2 * arc_count, 2, 2)), np.empty((2 * arc_count, 2)), np.empty((2 * arc_count, 2))
    lay_arcs(
        arcs.facets,
        arcs.weights,
        arcs.turns,
        arcs.own_turns,
        ints,
        places,
        flat,
        arc_lists,
        arc_first,
        ends,
        ways,
        around,
    )
    edge_first, edge_nodes, edge_shares = on_edges
    half_room = 3 * facet_count + len(edge_nodes) + 8 * arc_count
    halves, joined = np.empty((half_room, 4), np.int64), np.empty((4 * arc_count, 2), np.int64)
    triangles, facet = np.empty((half_room, 3), np.int64), np.empty(half_room, np.int64)
    half_count, joined_count, face_count, triangle_count = divide_facets(
        corners,
        flat,
        edge_first,
        edge_nodes,
        edge_shares,
        arc_first,
        arcs.nodes[arc_lists // 2],
        ends,
        ways,
        around,
        halves,
        joined,
        triangles,
        facet,
    )
    return arc_lists, Faces(halves[:half_count], joined[:joined_count], triangles[:triangle_count], facet[:face_count])
