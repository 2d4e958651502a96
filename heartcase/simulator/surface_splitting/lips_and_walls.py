"""Splitting a surface along the sheets themselves: lips, and the walls of the incision between them.

Surface and sheets divide one another into faces (:mod:`heartcase.simulator.mesh_arrangement.arrange`). A face of a
sheet inside the tissue becomes two walls, one for the tissue on each side, and what bounds the same tissue is glued
edge by edge. So the split surface is closed and manifold whatever the sheets are, both lips are one curve, and where a
sheet ends inside the tissue its two walls meet. Arrangements of meshes are split likewise by Zhou, Grinspun, Zorin and
Jacobson (ACM Trans. Graph. 35, 2016); here only the order around nodes and edges is used, not the faces' geometry.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from heartcase.schemas.arrays import Bool, Float64, Int32, Int64
from heartcase.simulator.cutting.crossings import QUANTA
from heartcase.simulator.mesh_arrangement.arrange import Arrangement, Crossings, arrange
from heartcase.simulator.mesh_arrangement.sheet_crossings import barycentric
from heartcase.simulator.mesh_arrangement.sheet_mesh import SheetMesh
from heartcase.simulator.mesh_arrangement.surface_crossings import is_inside
from heartcase.simulator.mesh_arrangement.surface_patches import number_split_parts
from heartcase.simulator.mesh_arrangement.uncut_surface import UncutSurface
from heartcase.simulator.surface_splitting.double_edges import Corners, separate_fans, without_double_edges
from heartcase.simulator.surface_splitting.facing_kernels import face_ways, lay_out
from heartcase.simulator.surface_splitting.gluing import (
    glue_around,
    join_sets,
    join_triangles,
    list_outlines,
    measure_parts,
)

__all__ = ["SplitMesh", "split_mesh"]

_NO_THICKNESS = 1e-9
"""Parts of the surface that are thinner hold no tissue [cells]."""
_AROUND_ARC = np.array(
    [
        # Of two sheets: the first and the second in turn, all in a circle.
        [[(2, 1, 0, 0), (0, 0, 1, 0)], [(1, 1, 0, 0), (3, 0, 1, 0)]],
        # Of the surface: the part before the sheet, the wall, the part behind; a wall in the void has itself alone.
        [[(2, 0, 0, 0), (0, 0, 0, 0)], [(0, 0, 1, 1), (1, 1, 0, 0)]],
    ]
)
"""Of half-edges along arcs of two sheets or of the surface, in the arc's first or second facet, forwards or backwards:
rank in the order around the arc, copy that looks back and that looks ahead in it, and whether they are alone."""


@dataclass(frozen=True)
class SplitMesh:
    """A surface that was split.

    Vertices of the uncut surface keep their numbers; those of the lips follow, then those of the walls. At a lip the
    surface and the wall have a vertex each, so that the edge is sharp; ``weld`` joins them.
    """

    triangles: Int32
    """Vertex numbers, counter-clockwise from outside, shape (triangle_count, 3)."""
    triangle_origin: Int32
    """Triangle of the uncut surface that each is, or is a part of, or -1 for walls, shape (triangle_count,)."""
    triangle_sheet: Int32
    """Sheet that each wall is made by, or -1, shape (triangle_count,)."""
    uncut_places: Float64
    """Rest places of the vertices that were there, in the frame of the nodes [cells], shape (old_count, 3)."""
    new_places: Float64
    """The same of those that were made, shape (new_count, 3)."""
    new_weld: Int32
    """Lowest vertex that is one with each of these, shape (new_count,)."""
    new_on_triangle: Int32
    """Triangle of the uncut surface on which each of these lies if it is of a lip, else -1, shape (new_count,)."""
    new_on_weights: Float64
    """Barycentric place there, shape (new_count, 3)."""
    new_flat: Float64
    """Place of each wall's vertex on its sheet laid out flat [cells], else 0, shape (new_count, 2)."""
    uncut_triangles: Int64
    """Triangles of the uncut surface, shape (uncut_triangle_count, 3)."""
    facing: Float64
    """Unit normals of the last triangles, those that are not whole ones of the uncut surface, shape (count, 3)."""
    triangle_part: Int32
    """Number of what each triangle hangs together with, shape (triangle_count,); all that is not cut free has one."""
    crossed: Int64 | None
    """Triangles of the uncut surface that are not there any more, ascending; None where there are more than those that
    sheets cross."""

    @property
    def old_count(self) -> int:
        """Number of vertices that were there."""
        return len(self.uncut_places)

    @property
    def vertex_count(self) -> int:
        """Number of vertices."""
        return len(self.uncut_places) + len(self.new_places)

    @property
    def places(self) -> Float64:
        """Rest places of all vertices, in the frame of the nodes [cells], shape (vertex_count, 3)."""
        return np.concatenate([self.uncut_places, self.new_places])

    @property
    def weld(self) -> Int32:
        """Lowest vertex that is one with each, shape (vertex_count,)."""
        return np.concatenate([np.arange(self.old_count, dtype=np.int32), self.new_weld])

    @property
    def on_triangle(self) -> Int32:
        """Triangle of the uncut surface on which each vertex of a lip lies, else -1, shape (vertex_count,)."""
        return np.concatenate([np.full(self.old_count, -1, np.int32), self.new_on_triangle])

    @property
    def on_weights(self) -> Float64:
        """Barycentric place there, shape (vertex_count, 3)."""
        return np.concatenate([np.zeros((self.old_count, 3)), self.new_on_weights])

    @property
    def flat(self) -> Float64:
        """Place of each wall's vertex on its sheet laid out flat [cells], else 0, shape (vertex_count, 2)."""
        return np.concatenate([np.zeros((self.old_count, 2)), self.new_flat])

    @property
    def triangle_is_wall(self) -> Bool:
        """Whether a triangle is a cut face, shape (triangle_count,)."""
        return self.triangle_origin < 0

    def places_of(self, vertices: Int64) -> Float64:
        """Rest places of some vertices, shape (count, 3)."""
        is_new = vertices >= self.old_count
        found = self.uncut_places[np.where(is_new, 0, vertices)]
        found[is_new] = self.new_places[vertices[is_new] - self.old_count]
        return found


def split_mesh(surface: UncutSurface, crossing: Crossings) -> SplitMesh:
    """Split a surface along all sheets at once."""
    mesh = crossing.mesh
    parts = arrange(surface, crossing)
    sides = _half_edges(parts)
    face_is_wall = _faces_inside(surface, mesh, parts, sides)
    classes, partner = _glued(mesh, parts, sides, face_is_wall)
    return _written(surface, mesh, parts, face_is_wall, classes, partner)


class _HalfEdges(NamedTuple):
    """Half-edges of an arrangement by what they run along."""

    of_arcs: Int64
    """Those along arcs, ascending."""
    arc: Int64
    """The arc of each of these."""
    which: Int64
    """In which of its facets each is."""
    arc_backwards: Bool
    """Whether each runs backwards."""
    of_outlines: Int64
    """Those along the facets' edges, ascending."""
    piece: Int64
    """The piece of an edge that each of these is, numbered edge by edge, as far as there are any."""
    outline_backwards: Bool
    """Whether each runs backwards."""


def _half_edges(parts: Arrangement) -> _HalfEdges:
    kind = parts.faces.halves[:, 3]
    halves = np.flatnonzero(kind >= 0)
    entry = parts.arc_lists[kind[halves] // 2]
    outlines, pieces = np.empty(len(kind), np.int64), np.empty(len(kind), np.int64)
    is_backwards = np.empty(len(kind), np.bool_)
    count = list_outlines(parts.faces.halves, parts.corners, parts.facet_edges, outlines, pieces, is_backwards)
    outlines, pieces, is_backwards = outlines[:count], pieces[:count], is_backwards[:count]
    return _HalfEdges(halves, entry // 2, entry % 2, kind[halves] % 2 == 1, outlines, pieces, is_backwards)


def _faces_inside(surface: UncutSurface, mesh: SheetMesh, parts: Arrangement, sides: _HalfEdges) -> Bool:
    """Which faces of sheets lie in the tissue; faces of the surface do not."""
    halves, face_facet = parts.faces.halves, parts.faces.facet
    surface_facets = len(parts.crossed)
    is_of_sheet = face_facet >= surface_facets
    arc_halves, arc, which, is_backwards, outline, piece, _ = sides
    is_crossing = parts.arcs.facets[arc, 0] < surface_facets
    voting = is_crossing & (which == 1)
    faces = halves[arc_halves[voting], 1]
    votes = np.bincount(faces, np.where(is_backwards[voting], 1.0, -1.0), minlength=len(face_facet))

    # What hangs together on the sheets without crossing the surface lies on one side of it.
    own = is_of_sheet[halves[outline, 1]]
    keys = np.concatenate([2 * piece[own], 2 * arc[~is_crossing] + 1])
    members = np.concatenate([halves[outline[own], 1], halves[arc_halves[~is_crossing], 1]])
    order = np.argsort(keys, kind="stable")
    keys, members = keys[order], members[order]
    together = np.flatnonzero(keys[1:] == keys[:-1])
    parents = np.arange(len(face_facet))
    join_sets(parents, np.stack([members[together], members[together + 1]], axis=1))
    of_set = np.bincount(parents, votes, minlength=len(face_facet))[parents]
    decided = np.where(votes != 0, votes, of_set)
    is_in = decided > 0
    has_vote = np.bincount(parents, np.bincount(faces, minlength=len(face_facet)) > 0, minlength=len(face_facet)) > 0
    for one in np.unique(parents[is_of_sheet & ~has_vote[parents]]):
        triangle = face_facet[one] - surface_facets
        point = mesh.vertices[mesh.triangles[triangle, 0]]
        is_in[parents == one] = is_inside(surface.vertices, surface.triangles, surface.buckets, point)
    inside: Bool = is_in & is_of_sheet
    return inside


def _glued(mesh: SheetMesh, parts: Arrangement, sides: _HalfEdges, face_is_wall: Bool) -> tuple[Int64, Int64]:
    """Set of each corner: of copy 0 of the half-edges, then of copy 1; and what each half-edge is glued to.

    Both of shape (2 half_count,).
    """
    halves = parts.faces.halves
    half_count, surface_facets = len(halves), len(parts.crossed)
    is_of_sheet = parts.faces.facet[halves[:, 1]] >= surface_facets
    is_there = ~is_of_sheet | face_is_wall[halves[:, 1]]
    arc_halves, arc, which, arc_backwards, outline, piece, backwards = sides
    crosses_surface = parts.arcs.facets[arc, 0] < surface_facets
    of_sheet = is_of_sheet[outline]

    rank, looks_back, looks_ahead, is_loose = _AROUND_ARC[
        crosses_surface.astype(np.int64), which, arc_backwards.astype(np.int64)
    ].T
    arc_count = len(parts.arcs.nodes)
    group = np.concatenate([is_loose * arc_count + arc, 2 * arc_count + piece])
    rows = np.concatenate([arc_halves, outline])
    ranks = np.concatenate([rank, _ranks(mesh, parts, outline)])
    runs_back = np.concatenate([arc_backwards, backwards])
    back = np.concatenate([looks_back, of_sheet & backwards])
    ahead = np.concatenate([looks_ahead, of_sheet & ~backwards])
    circle = np.concatenate([~crosses_surface | (is_loose == 1), of_sheet])
    kept = np.flatnonzero(is_there[rows])
    order = kept[np.lexsort((ranks[kept], group[kept]))]
    starts = np.flatnonzero(np.diff(group[order], prepend=-1) != 0)
    parents, partner = np.arange(2 * half_count), np.arange(2 * half_count)
    joined = parts.faces.joined
    # The second of each pair is a bridge, and every two bridges are both sides of one.
    bridges = joined[:, 1].reshape(-1, 2)
    partner[bridges], partner[bridges + half_count] = bridges[:, ::-1], bridges[:, ::-1] + half_count
    join_sets(parents, np.concatenate([joined, joined + half_count]))
    glue_around(
        np.append(starts, len(order)),
        circle[order][starts],
        rows[order],
        runs_back[order],
        np.stack([back, ahead], axis=1)[order],
        halves[:, 2],
        parents,
        partner,
    )
    join_sets(parents, np.zeros((0, 2), np.int64))
    return parents, partner


def _ranks(mesh: SheetMesh, parts: Arrangement, outline: Int64) -> Int64:
    """Place of each half-edge of an outline in the order around its edge; 0 for those of the surface."""
    side = -1 - parts.faces.halves[outline, 3] - 3 * len(parts.crossed)
    ranks = np.append(mesh.ranks.ravel(), 0)
    return ranks[np.where(side >= 0, side, len(ranks) - 1)]


def _written(
    surface: UncutSurface, mesh: SheetMesh, parts: Arrangement, face_is_wall: Bool, classes: Int64, partner: Int64
) -> SplitMesh:
    faces, vertex_count, surface_facets = parts.faces, surface.vertex_count, len(parts.crossed)
    half_count = len(faces.halves)
    of_triangle = faces.halves[faces.triangles[:, 0], 1]
    facet = faces.facet[of_triangle]
    is_surface, is_wall = facet < surface_facets, face_is_wall[of_triangle]
    pieces, walls = faces.triangles[is_surface], faces.triangles[is_wall]
    facets = np.concatenate([facet[is_surface], facet[is_wall], facet[is_wall]])
    is_wall = np.repeat([False, True], [len(pieces), 2 * len(walls)])
    # Corners at vertices of the uncut surface are these, all others by set.
    nodes = np.concatenate([faces.halves[:, 0]] * 2)
    named = np.where(nodes < vertex_count, nodes, vertex_count + classes)
    # A triangle of which two corners are one vertex is left out: its two other edges are one.
    by_corner = np.concatenate([pieces, walls, walls[:, ::-1] + half_count])
    has_three = (named[by_corner] != named[np.roll(by_corner, -1, axis=1)]).all(axis=1)
    by_corner, facets, is_wall = by_corner[has_three], facets[has_three], is_wall[has_three]
    wall_side = 2 * faces.halves[by_corner[:, 0] % max(half_count, 1), 1] + by_corner[:, 0] // max(half_count, 1)
    corners = without_double_edges(
        by_corner,
        named,
        faces.halves[:, 2],
        partner,
        is_wall,
    )
    points = _points(surface, parts, nodes, corners, facets[corners.middle_triangles])
    facets, is_wall, wall_side = facets[corners.kept], is_wall[corners.kept], wall_side[corners.kept]

    # Surface and wall have a vertex each where they meet.
    vertices = corners.vertices[corners.triangles]
    if corners.is_unsure or not has_three.all():
        vertices = separate_fans(vertices, vertex_count)
    is_new = vertices >= vertex_count
    key = 2 * vertices + is_wall[:, None]
    used, first, number = np.unique(key[is_new], return_index=True, return_inverse=True)
    main = np.searchsorted(used, used - used % 2)
    is_twin = used[main] == used - 1 if len(used) else np.zeros(0, np.bool_)
    # Lips first, then what walls have of their own, then their twins of lips.
    order = np.lexsort((used, is_twin, used % 2))
    place = vertex_count + np.argsort(order)
    triangles = vertices.copy()
    triangles[is_new] = place[number]

    rows = np.flatnonzero(is_new.ravel())[first[order]]
    point, sample = points.number[corners.triangles.ravel()[rows]], rows // 3
    flat = np.zeros((len(used), 2))
    on_wall = is_wall[sample]
    laid = np.empty((int(on_wall.sum()), 2))
    of_triangle = facets[sample[on_wall]] - surface_facets
    lay_out(mesh.vertices / QUANTA, mesh.triangles, mesh.flat, points.places[point[on_wall]], of_triangle, laid)
    flat[on_wall] = laid
    origin, sheet = np.full(len(facets), -1, np.int32), np.full(len(facets), -1, np.int32)
    origin[~is_wall] = parts.crossed[facets[~is_wall]]
    sheet[is_wall] = mesh.sheet[facets[is_wall] - surface_facets]
    weld = np.arange(vertex_count, vertex_count + len(used))
    weld[place[is_twin] - vertex_count] = place[main[is_twin]]
    count = len(surface.triangles) - len(parts.crossed) + len(triangles)
    all_triangles, all_origin = np.empty((count, 3), np.int32), np.empty(count, np.int32)
    all_sheet, part = np.empty(count, np.int32), np.empty(count, np.int32)
    join_triangles(surface.triangles, parts.crossed, triangles, origin, sheet, all_triangles, all_origin, all_sheet)
    part_count = number_split_parts(
        surface.triangles, surface.patches, parts.crossed, triangles, weld, vertex_count, part
    )
    facing = np.empty((len(facets), 3))
    face_ways(parts.ints, facets, is_wall & (wall_side % 2 == 1), facing)
    split = SplitMesh(
        triangles=all_triangles,
        triangle_origin=all_origin,
        triangle_sheet=all_sheet,
        uncut_places=surface.places,
        new_places=points.places[point],
        new_weld=weld.astype(np.int32),
        new_on_triangle=points.on_triangle[point].astype(np.int32),
        new_on_weights=points.on_weights[point],
        new_flat=flat,
        uncut_triangles=surface.triangles,
        facing=facing,
        triangle_part=part,
        crossed=parts.crossed,
    )
    return split if part_count <= 1 else _without_dust(split, np.where(is_wall, wall_side, -1), part_count)


def _without_dust(split: SplitMesh, wall_side: Int64, part_count: int) -> SplitMesh:
    """Leave out parts that hold no tissue: what two sheets in one place have between them.

    A cut inside the tissue has no volume either, but both sides of its walls.
    """
    triangle_part = split.triangle_part
    volumes, areas = np.zeros(part_count), np.zeros(part_count)
    measure_parts(split.places, split.triangles, triangle_part, volumes, areas)
    is_dust = np.abs(volumes) <= _NO_THICKNESS * areas
    walls = np.flatnonzero(wall_side >= 0)
    part_of_wall = triangle_part[len(triangle_part) - len(wall_side) :][walls]
    sides = np.unique(np.stack([part_of_wall, wall_side[walls]], axis=1), axis=0)
    has_both = (np.diff(sides[:, 0]) == 0) & (np.diff(sides[:, 1] // 2) == 0)
    is_dust[sides[1:, 0][has_both]] = False
    if not is_dust.any():
        return split
    kept = ~is_dust[triangle_part]
    part = (np.cumsum(~is_dust) - 1)[triangle_part[kept]].astype(np.int32)
    return replace(
        split,
        triangles=split.triangles[kept],
        triangle_origin=split.triangle_origin[kept],
        triangle_sheet=split.triangle_sheet[kept],
        facing=split.facing[kept[len(kept) - len(split.facing) :]],
        triangle_part=part,
        crossed=None,
    )


class _Points(NamedTuple):
    """Where new vertices may lie."""

    number: Int64
    """Point of each corner, shape (corner_count,); none for those of the uncut surface."""
    places: Float64
    on_triangle: Int64
    on_weights: Float64


def _points(surface: UncutSurface, parts: Arrangement, nodes: Int64, corners: Corners, facet: Int64) -> _Points:
    """Nodes, and the middles of double edges of some facets."""
    first_node = surface.vertex_count
    first_middle = len(nodes)
    places = np.zeros((len(corners.middles), 3))

    def place_of(at: int) -> Float64:
        # A middle may be one of an edge to an earlier middle.
        node = nodes[at] if at < first_middle else 0
        of_nodes = surface.places[node] if node < first_node else parts.places[node - first_node]
        found: Float64 = of_nodes if at < first_middle else places[at - first_middle]
        return found

    for n, (one, other) in enumerate(corners.middles.tolist()):
        places[n] = (place_of(one) + place_of(other)) / 2
    on_surface = facet < len(parts.crossed)
    on_triangle = np.full(len(places), -1)
    on_triangle[on_surface] = parts.crossed[facet[on_surface]]
    weights = np.zeros((len(places), 3))
    triangles = surface.places[surface.triangles[on_triangle[on_surface]]]
    weights[on_surface] = barycentric(triangles, places[on_surface])
    number = np.concatenate([nodes - first_node, len(parts.places) + np.arange(len(places))])
    return _Points(
        number,
        np.concatenate([parts.places, places]),
        np.concatenate([parts.on_surface, on_triangle]),
        np.concatenate([parts.surface_weights, weights]),
    )
