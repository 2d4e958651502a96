"""How a surface and sheets divide one another, in plain NumPy: the oracle of the kernels that do."""

from __future__ import annotations

from unittest import mock

import numpy as np

from heartcase.simulator.cutting.crossings import QUANTA
from heartcase.simulator.mesh_arrangement import sheet_crossings
from heartcase.simulator.mesh_arrangement.exact_ties import is_in_all_three, is_nearer
from heartcase.simulator.mesh_arrangement.facet_graphs import divide_facets
from heartcase.simulator.mesh_arrangement.sheet_crossings import Arcs, _Points
from heartcase.simulator.mesh_arrangement.sheet_mesh import SheetMesh

_SAME = 2.0**36
_OF_SHEETS = np.int64(1) << 62
_NOT_ZERO = 1e-5
_PARALLEL = 1e-6


def plain_mesh(sheets):
    """Join sheets to one mesh."""
    corners = np.concatenate([np.zeros((0, 3, 3), np.int64), *(sheet.triangles for sheet in sheets)])
    flat = np.concatenate([np.zeros((0, 3, 2)), *(sheet.laid_out() for sheet in sheets)])
    sheet = np.repeat(np.arange(len(sheets)), [len(each.triangles) for each in sheets])
    vertices, number = np.unique(corners.reshape(-1, 3), axis=0, return_inverse=True)
    triangles = number.reshape(-1, 3)
    ordered = np.sort(triangles, axis=1)
    has_three = np.asarray((np.diff(ordered, axis=1) > 0).all(axis=1))
    _, once = np.unique(ordered, axis=0, return_index=True)
    # By their vertices, so that it does not matter in which order and in how many parts they were swept.
    kept = once[has_three[once]]
    triangles = triangles[kept].astype(np.int64)
    pairs = np.sort(np.stack([triangles, np.roll(triangles, -1, axis=1)], axis=2).reshape(-1, 2), axis=1)
    edge_vertices, edges = np.unique(pairs, axis=0, return_inverse=True)
    return SheetMesh(
        vertices.astype(np.int64),
        triangles,
        edges.reshape(-1, 3).astype(np.int64),
        edge_vertices.reshape(-1, 2).astype(np.int64),
        None,
        flat[kept],
        sheet[kept].astype(np.int64),
    )


def plain_arrangement(surface, crossing):
    """Divide a surface and sheets by one another."""
    mesh, between = crossing.mesh, crossing.between
    pairs, ends, weights, _ = crossing.of_surface
    vertex_count, sheet_count = surface.vertex_count, len(mesh.vertices)
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
    edge_count = int(surface.edges.max(initial=-1)) + 1
    facet_edges = np.concatenate([surface.edges[crossed], edge_count + mesh.edges])
    facet_forward = corners < np.roll(corners, -1, axis=1)
    edge_first, edge_nodes, edge_shares = _nodes_on_edges(
        surface, mesh, crossed, arcs, keys, (corners, facet_edges, facet_forward)
    )
    ints = np.concatenate([surface.vertices[surface.triangles[crossed]], mesh.vertices[mesh.triangles]])
    with mock.patch.object(sheet_crossings, "_points", _points):
        made_from = vertex_count + sheet_count + len(keys)
        arcs, point_count = sheet_crossings.cross_points(ints, corners, arcs, first_sheet, made_from)
    flat = _flat_corners(surface, mesh, crossed)
    arc_lists, faces = _faces(surface, mesh, crossed, arcs, corners, flat, (edge_first, edge_nodes, edge_shares))
    node_places = _node_places(surface, mesh, crossed, arcs, len(keys) + point_count)
    return crossed, corners, arcs, arc_lists, faces, node_places


def _turns(mesh, triangles, keys):
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


def _normals(surface, mesh, crossed):
    """Normals of all facets as their whole numbers have them, twice the area long."""
    p, q, r = np.moveaxis(
        np.concatenate([surface.vertices[surface.triangles[crossed]], mesh.vertices[mesh.triangles]]), 1, 0
    )
    return np.cross(q - p, r - p).astype(np.float64)


def _nodes_on_edges(surface, mesh, crossed, arcs, keys, facets):
    """Nodes on the edges of each facet, in order: where each edge's begin, the nodes, and how far along they are."""
    corners, facet_edges, facet_forward = facets
    edge_count = int(surface.edges.max(initial=-1)) + 1
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


def _flat_corners(surface, mesh, crossed):
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


def _cells(mesh):
    return mesh.vertices / QUANTA


def _faces(surface, mesh, crossed, arcs, corners, flat, on_edges):
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
        np.empty(half_room, np.int64),
    )
    halves = halves[:half_count]
    facet = np.empty(face_count, np.int64)
    is_outline = (halves[:, 3] < 0) & (halves[:, 3] >= -3 * facet_count)
    facet[halves[is_outline, 1]] = (-1 - halves[is_outline, 3]) // 3
    is_arc = halves[:, 3] >= 0
    facet[halves[is_arc, 1]] = of_facet[halves[is_arc, 3] // 2]
    return arc_lists, (halves, joined[:joined_count], triangles[:triangle_count], facet)


def _length(vectors):
    length = np.linalg.norm(vectors, axis=1)
    return np.where(length > 0, length, 1.0)


def _node_places(surface, mesh, crossed, arcs, end_count):
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


def _points(corners, numbers, arcs, triples, surface_facets):
    """Points where three facets meet, of candidates."""
    between, with_one = triples[:, 0], triples[:, 1]
    facets = arcs.facets
    third = np.where(facets[with_one, 0] == facets[between, 0], facets[with_one, 1], facets[with_one, 0])
    meeting = np.stack([third, facets[between, 0], facets[between, 1]], axis=1)
    p, q, r = np.moveaxis(corners[meeting].astype(np.float64), 2, 0)
    normals = np.cross(q - p, r - p)
    crosses = np.cross(np.roll(normals, -1, axis=1), np.roll(normals, -2, axis=1))
    scale = np.einsum("nx,nx->n", normals[:, 0], crosses[:, 0])
    safe = np.where(scale != 0, scale, 1.0)
    # From a corner of the third, so that numbers stay small.
    origin = p[:, :1]
    offsets = np.einsum("nfx,nfx->nf", normals, p - origin)
    place = np.einsum("nf,nfx->nx", offsets, crosses) / safe[:, None]
    heights = np.empty((len(triples), 3, 3))
    for n, (one, other) in enumerate(((p, q), (q, r), (r, p))):
        inward = np.cross(normals, other - one)
        size = np.linalg.norm(inward, axis=2)
        inward /= np.where(size > 0, size, 1.0)[..., None]
        heights[:, :, n] = np.einsum("nfx,nfx->nf", inward, place[:, None] - (one - origin))
    sizes = np.abs(scale) / np.maximum(np.prod(np.linalg.norm(normals, axis=2), axis=1), 1e-300)
    is_sure = (np.abs(heights) > _NOT_ZERO / np.maximum(sizes, 1e-300)[:, None, None]).all(axis=(1, 2)) & (scale != 0)
    is_sure |= (heights < -_NOT_ZERO / np.maximum(sizes, 1e-300)[:, None, None]).any(axis=(1, 2)) & (scale != 0)
    inside = is_sure & (heights > 0).all(axis=(1, 2))
    place += origin[:, 0]
    turns = np.full(len(triples), np.nan)
    for row in np.flatnonzero(~is_sure).tolist():
        three = meeting[row]
        first_is_surface = bool(three[0] < surface_facets)
        inside[row], place[row], way = is_in_all_three(
            corners[three], numbers[three], first_is_surface=first_is_surface
        )
        one, other = normals[row, 1], normals[row, 2]
        if np.linalg.norm(np.cross(one, other)) <= _PARALLEL * np.linalg.norm(one) * np.linalg.norm(other):
            turns[row] = way * (_PARALLEL if one @ other > 0 else np.pi - _PARALLEL)
    return _Points(triples[inside], place[inside], meeting[inside], turns[inside])
