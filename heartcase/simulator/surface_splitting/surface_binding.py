"""Tying a split surface to a cut lattice: each vertex to nodes of its own side alone.

A vertex that was there keeps its three nodes: copies of these that the tissue has which the vertex sees past the
sheets. Where all of that tissue is beyond a sheet it is tied anew. A new vertex of a lip follows the nodes of a corner
of the triangle that it lies on, if both lips can; else, as all other new ones, a face of its own cell. What a vertex
belongs to is asked of a point a little inside the tissue behind it. Both, and those of which a node has a copy, move
with all corners of a cell (:mod:`heartcase.simulator.surface.cell_vertices`): the one that they lie in, where it has a
node of that which they are tied to or they see it, else that; the nodes say of which side they are.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from heartcase.schemas.arrays import Bool, Float64, Int32, Int64
from heartcase.schemas.bundle.lattice import CORNER_OFFSETS, lattice_keys
from heartcase.simulator.cutting.parted_lattice import PartedLattice
from heartcase.simulator.cutting.pieces import Pieces
from heartcase.simulator.lattice.model import LatticeModel
from heartcase.simulator.mesh_arrangement.merged_rows import number_rows
from heartcase.simulator.mesh_arrangement.sheet_mesh import SheetMesh
from heartcase.simulator.mesh_arrangement.surface_crossings import fill_buckets
from heartcase.simulator.surface_splitting.gluing import number_parts
from heartcase.simulator.surface_splitting.hiding_sheets import SheetBuckets, lay_planes
from heartcase.simulator.surface_splitting.lips_and_walls import SplitMesh
from heartcase.simulator.surface_splitting.near_sheets import (
    add_ways_near,
    add_ways_to_middles,
    copies_of,
    list_around,
    near_cells,
    order_by_reach,
)
from heartcase.simulator.surface_splitting.seen_pieces import (
    NOTHING_SEEN,
    Answers,
    CellsByIndex,
    PieceCells,
    index_answers,
    mark_changes,
    nearest_halves,
    see_pieces,
)

__all__ = ["LatticeCells", "Seen", "TiedSurface", "Ties", "closest_weights", "tie_cells", "tie_split"]

_INSIDE = 2.0**-9
"""How far inside the tissue a vertex is asked what it belongs to [cells]."""
_ASIDE = 2.0**-9
"""How far off towards its triangles, and a quarter of that inside [cells]: more than places are rounded by."""
_PLACES = 2.0**22
"""Vertices whose places are the same when rounded by this are of one lip [1 / cell]."""
_FACE_CORNERS = np.array([(0, 4, 6, 2), (1, 3, 7, 5), (0, 1, 5, 4), (2, 6, 7, 3), (0, 2, 3, 1), (4, 5, 7, 6)])
"""Corners of a cell's faces, counter-clockwise from outside."""
_HALF_FACES = np.stack([_FACE_CORNERS[:, [0, 1, 2]], _FACE_CORNERS[:, [0, 2, 3]]], axis=1).reshape(-1, 3)


@dataclass(frozen=True)
class LatticeCells:
    """Cells of an uncut lattice, by where they are."""

    by_index: CellsByIndex
    middles: Float64
    """Middle of the tissue of each [cells], shape (cell_count, 3)."""
    low: Int64
    """Lowest index (i, j, k) of a cell."""
    high: Int64
    """Highest index of a cell."""

    @classmethod
    def of(cls, model: LatticeModel) -> LatticeCells:
        """Those of a lattice."""
        middles = model.cells.astype(np.float64) + 0.5 + model.cell_moments[:, :3].astype(np.float64)
        low, high = (model.cells.min(axis=0).astype(np.int64), model.cells.max(axis=0).astype(np.int64))
        numbers = np.full(tuple(high - low + 1), -1, np.int32)
        numbers[tuple((model.cells - low).T)] = np.arange(model.cell_count)
        return cls(CellsByIndex(low, numbers), middles, low, high)


@dataclass(frozen=True)
class TiedSurface:
    """What an uncut surface follows."""

    cells: LatticeCells
    """Cells of the uncut lattice."""
    triangle_nodes: Int32
    """Nodes that the vertices follow, shape (vertex_count, 3)."""
    cells_of_ties: Int64
    """Cells that have these (:func:`tie_cells`), shape (vertex_count, 2)."""
    box_cells: Int32
    """Number of the cell that each vertex lies in, in a box two cells around all cells, or -1, (vertex_count,)."""
    around: tuple[Int64, Int64, Int32]
    """Triangles, and those around each vertex: where each begins, and these, ascending."""

    @classmethod
    def of(cls, model: LatticeModel, triangle_nodes: Int32, places: Float64, triangles: Int64) -> TiedSurface:
        """What a surface follows.

        Parameters
        ----------
        model
            The uncut lattice.
        triangle_nodes
            Nodes that the vertices follow, shape (vertex_count, 3).
        places, triangles
            Rest places of the vertices [cells], shape (vertex_count, 3), and vertex numbers.
        """
        cells = LatticeCells.of(model)
        shape = cells.high - cells.low + 5
        index = np.floor(places).astype(np.int64) - cells.low + 2
        is_in = ((index >= 0) & (index < shape)).all(axis=1)
        box_cells = np.full(len(places), -1, np.int32)
        box_cells[is_in] = np.ravel_multi_index(tuple(index[is_in].T), tuple(shape))
        first, members = np.zeros(len(places) + 1, np.int64), np.empty(triangles.size, np.int32)
        list_around(triangles, first, members)
        return cls(cells, triangle_nodes, tie_cells(model, triangle_nodes), box_cells, (triangles, first, members))


@dataclass(frozen=True)
class Ties:
    """Which nodes the vertices of a split surface follow."""

    changed: Int64
    """Vertices that were there and follow other nodes than before, ascending, shape (changed_count,)."""
    is_tied_anew: Bool
    """Which of these do not follow copies of the nodes that they did, shape (changed_count,)."""
    nodes: Int32
    """Nodes of the cut lattice of these, and of all new vertices, shape (changed_count + new_count, 3)."""
    cells: Int32
    """Cell of the cut lattice whose corners these nodes are, shape (changed_count + new_count,)."""
    own: Int32
    """Cell that each lies in, or that of its tissue that is nearest, shape (changed_count + new_count,)."""
    sees_own: Bool
    """Whether it sees that past the sheets, shape (changed_count + new_count,)."""


def tie_cells(model: LatticeModel, triangle_nodes: Int32) -> Int64:
    """Both cells that have three nodes of a face, or -1, shape (count, 2).

    Parameters
    ----------
    model
        The lattice.
    triangle_nodes
        Nodes of the triangles, halves of cells' faces, shape (count, 3).
    """
    corners = model.node_index[triangle_nodes].astype(np.int64)
    low, high = corners.min(axis=1), corners.max(axis=1)
    # Cells behind and before the plane of the three: its axis is the one along which they do not differ.
    cells = np.stack([high - 1, low], axis=1)
    return _cells_at(model, cells)


def _cells_at(model: LatticeModel, places: Int64) -> Int64:
    """Cell at each index (i, j, k), or -1."""
    keys = lattice_keys(model.cells)
    order = np.argsort(keys, kind="stable") if (np.diff(keys) < 0).any() else np.arange(len(keys))
    wanted = lattice_keys(places)
    at = np.minimum(np.searchsorted(keys[order], wanted), len(keys) - 1)
    found: Int64 = np.where(keys[order][at] == wanted, order[at], -1)
    return found


def closest_weights(points: Float64, corners: Float64) -> Float64:
    """Barycentric weights of the places in triangles that are closest to points, shape (count, 3).

    Parameters
    ----------
    points
        Shape (count, 3).
    corners
        Of the triangles, shape (count, 3, 3).
    """
    p, u, v = corners[:, 0], corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    w = points - p
    uu, uv, vv = (np.einsum("nx,nx->n", a, b) for a, b in ((u, u), (u, v), (v, v)))
    wu, wv = np.einsum("nx,nx->n", w, u), np.einsum("nx,nx->n", w, v)
    determinant = uu * vv - uv * uv
    inner = np.stack([(vv * wu - uv * wv) / determinant, (uu * wv - uv * wu) / determinant], axis=1)
    # On the three edges, and inside where that is inside: the closest of all.
    first, second = np.clip(wu / uu, 0, 1), np.clip(wv / vv, 0, 1)
    along = np.clip((wv - wu + uu - uv) / (uu + vv - 2 * uv), 0, 1)
    nothing = np.zeros_like(first)
    places = np.stack(
        [
            np.stack([first, nothing], axis=1),
            np.stack([nothing, second], axis=1),
            np.stack([1 - along, along], axis=1),
        ],
        axis=1,
    )
    away = w[:, None] - places[..., :1] * u[:, None] - places[..., 1:] * v[:, None]
    nearest = np.einsum("ncx,ncx->nc", away, away).argmin(axis=1)
    is_inside = (inner >= 0).all(axis=1) & (inner.sum(axis=1) <= 1)
    two = np.where(is_inside[:, None], inner, places[np.arange(len(w)), nearest])
    return np.concatenate([1.0 - two.sum(axis=1, keepdims=True), two], axis=1)


class Seen(NamedTuple):
    """What was seen when a surface was split, so that a split that goes on from it need not look again."""

    pieces: Pieces
    """What was cut of the cells."""
    sheet_count: int
    """How many sheets cut them."""
    answers: Answers


class _Sight:
    """What points see of a cut lattice."""

    def __init__(
        self,
        cells: LatticeCells,
        model: LatticeModel,
        parted: PartedLattice,
        mesh: SheetMesh,
        pairs: Int64,
        before: Seen | None,
    ) -> None:
        pieces = parted.pieces
        self._cells, self._pairs, self._pieces = cells, pairs, pieces
        self._model, self._asked = model, list[Answers]()
        self._sheet_count = int(mesh.sheet.max(initial=-1)) + 1
        rows = np.full(model.cell_count, -1)
        rows[pieces.cells] = np.arange(len(pieces.cells))
        self._tissue = PieceCells(model.cells, cells.middles, rows, pieces.samples)
        shift = 12
        reached = mesh.vertices[mesh.triangles.ravel()] if len(mesh.triangles) else np.zeros((1, 3), np.int64)
        low = np.maximum((reached.min(axis=0)) >> shift, cells.low - 3)
        high = np.minimum((reached.max(axis=0)) >> shift, cells.high + 3)
        size = np.maximum(high - low + 1, 1)
        first, members = np.zeros(int(size.prod()) + 1, np.int64), np.zeros(0, np.int32)
        fill_buckets(mesh.vertices, mesh.triangles, shift, low, size, first, members)
        members = np.empty(first[-1], np.int32)
        fill_buckets(mesh.vertices, mesh.triangles, shift, low, size, first, members)
        planes, boxes = np.empty((len(mesh.triangles), 13)), np.empty((len(mesh.triangles), 2, 3), np.int64)
        lay_planes(mesh.vertices, mesh.triangles, planes, boxes)
        self._buckets = SheetBuckets(low, size, first, members, planes, boxes)
        self._known, self._table = NOTHING_SEEN, np.zeros(0, np.int32)
        self._changes = np.zeros(0, np.bool_), cells.low, np.zeros((0, 0, 0), np.bool_)
        if before is not None:
            self._look_up(mesh, before)

    def _look_up(self, mesh: SheetMesh, before: Seen) -> None:
        self._known = before.answers
        self._table = np.empty(1 << (2 * len(self._known.codes) + 1).bit_length(), np.int32)
        index_answers(self._known, self._table)
        low, size = self._cells.low - 3, tuple(self._cells.high - self._cells.low + 7)
        self._changes = np.zeros(self._model.cell_count, np.bool_), low, np.zeros(size, np.bool_)
        was, now = ((each.cells, each.samples) for each in (before.pieces, self._pieces))
        mark_changes(mesh.vertices, mesh.triangles, mesh.sheet, before.sheet_count, was, now, *self._changes)

    def of(self, points: Float64, codes: Int64) -> Int64:
        """Cell of the cut lattice that each point sees of the two that a vertex is tied to, or -1, shape (count,)."""
        return self._looked(points, codes)[0]

    def own(self, points: Float64) -> tuple[Int64, Bool]:
        """Cell of the cut lattice that each point belongs to: its own, or one around it, shape (count,).

        The nearest of these if it sees none; second whether it sees it.
        """
        return self._looked(points, np.full(len(points), -1))

    def _looked(self, points: Float64, codes: Int64) -> tuple[Int64, Bool]:
        bits = points.view(np.int64)
        cells, pieces = np.empty(len(points), np.int64), np.empty(len(points), np.int64)
        see_pieces(
            points,
            bits,
            codes,
            self._pairs,
            self._cells.by_index,
            self._tissue,
            self._buckets,
            self._known,
            self._table,
            self._changes,
            cells,
            pieces,
        )
        self._asked.append(Answers(bits, codes, cells, pieces))
        rows = self._tissue.rows[cells]
        is_seen, pieces = pieces >= 0, np.maximum(pieces, 0)
        number = self._pieces.first[rows] + pieces if len(self._pieces.cells) else pieces
        # The first piece keeps the number of its cell; the others follow all cells.
        later = self._model.cell_count + number - (rows + 1)
        found: Int64 = np.where((cells >= 0) & (pieces > 0), later, cells)
        return found, is_seen

    @property
    def seen(self) -> Seen:
        """All that was asked."""
        answers = Answers(*(np.concatenate(each) for each in zip(*self._asked, strict=True)))
        return Seen(self._pieces, self._sheet_count, answers)


def tie_split(
    model: LatticeModel,
    parted: PartedLattice,
    mesh: SheetMesh,
    split: SplitMesh,
    tied: TiedSurface,
    outward: tuple[Float64, Float64],
    before: Seen | None = None,
) -> tuple[Ties, Seen]:
    """Find nodes for vertices of a split surface.

    Parameters
    ----------
    model, parted
        The lattice before and after the cut.
    mesh
        What cut it.
    split
        The surface, split.
    tied
        What the uncut surface follows.
    outward
        Direction out of the tissue at each vertex of the uncut surface, and at each new one, shape (count, 3).
    before
        What was seen when the first of these sheets had been swept: the same is found without it.
    """
    triangle_nodes, cells_of_ties = tied.triangle_nodes, tied.cells_of_ties
    sight = _Sight(tied.cells, model, parted, mesh, cells_of_ties, before)
    old_count, count = split.old_count, split.vertex_count
    near = _near_sheets(model, parted, tied)
    aside = _towards_own_triangles(split, tied, near) - 0.25 * outward[0][near]
    points = split.uncut_places[near] + _ASIDE * aside
    seen = sight.of(points, near)
    lost = seen < 0
    nodes = _corners_of(parted, np.where(lost, 0, seen), triangle_nodes[near])
    own, _ = sight.own(points[lost])
    seen[lost] = own
    nodes[lost] = _half_faces(parted, own, split.uncut_places[near[lost]])
    is_changed = lost | (nodes != triangle_nodes[near]).any(axis=1)
    changed = near[is_changed]
    own_of_changed = sight.own(points[is_changed])

    # New vertices: those that are one, once.
    main = np.flatnonzero(split.new_weld == np.arange(old_count, count))
    places = split.new_places[main]
    points = places - _INSIDE * outward[1][main]
    main_own = sight.own(points)
    main_cells = main_own[0].copy()
    main_nodes = np.full((len(main), 3), -1, np.int32)
    place = number_rows(np.round(places * _PLACES).astype(np.int64))
    on = split.new_on_triangle[main]
    is_open = on >= 0
    by_reach = _corners_by_reach(model, split, triangle_nodes, main)
    for rank in range(3):
        rows = np.flatnonzero(is_open)
        if not len(rows):
            break
        corner = split.uncut_triangles[on[rows], by_reach[rows, rank]]
        found = sight.of(points[rows], corner)
        missing = np.bincount(place[rows], found < 0, minlength=int(place.max(initial=-1)) + 1) > 0
        fits = ~missing[place[rows]]
        rows, found, corner = rows[fits], found[fits], corner[fits]
        main_cells[rows], is_open[rows] = found, False
        main_nodes[rows] = _corners_of(parted, found, triangle_nodes[corner])
    rows = np.flatnonzero(main_nodes[:, 0] < 0)
    main_nodes[rows] = _half_faces(parted, main_cells[rows], places[rows])
    at = np.searchsorted(main, split.new_weld - old_count)
    ties = Ties(
        changed,
        lost[is_changed],
        np.concatenate([nodes[is_changed], main_nodes[at]]).astype(np.int32),
        np.concatenate([seen[is_changed], main_cells[at]]).astype(np.int32),
        np.concatenate([own_of_changed[0], main_own[0][at]]).astype(np.int32),
        np.concatenate([own_of_changed[1], main_own[1][at]]),
    )
    ties = _with_their_parts(parted, split, triangle_nodes, ties)
    # Tied anew to copies of the nodes that it had, a vertex keeps its place among them.
    is_same = (parted.node_origin[ties.nodes[: len(ties.changed)]] == triangle_nodes[ties.changed]).all(axis=1)
    return replace(ties, is_tied_anew=ties.is_tied_anew & ~is_same), sight.seen


def _towards_own_triangles(split: SplitMesh, tied: TiedSurface, vertices: Int64) -> Float64:
    """Unit vectors from old vertices to the middle of their triangles, shape (count, 3): off a sheet that they lie on.

    On which side of it a vertex is, no place tells, but the triangles that it has.
    """
    row = np.full(split.vertex_count, -1, np.int32)
    row[vertices] = np.arange(len(vertices))
    total = np.zeros((len(vertices), 3))
    places = split.uncut_places, split.new_places
    if split.crossed is None:
        add_ways_to_middles(split.triangles, *places, row, total)
    else:
        added = split.triangles[len(split.triangles) - len(split.facing) :]
        add_ways_near(vertices, tied.around, split.crossed, added, *places, row, total)
    length = np.linalg.norm(total, axis=1, keepdims=True)
    towards: Float64 = np.divide(total, length, out=np.zeros_like(total), where=length > 0)
    return towards


def _with_their_parts(parted: PartedLattice, split: SplitMesh, triangle_nodes: Int32, ties: Ties) -> Ties:
    """Where a cut sets something free: vertices that follow what another part of the surface does are tied anew.

    Tissue too thin for a sample of its own is seen nowhere, and what is nearest to it may be beyond a gap.
    """
    if split.triangle_part.max(initial=0) == 0:
        return ties
    model, old_count, count = parted.model, split.old_count, split.vertex_count
    of_cell = number_parts(model.cell_corners, model.node_count)
    if of_cell.max() == 0:
        return ties
    of_node = np.zeros(model.node_count, np.int64)
    of_node[model.cell_corners] = of_cell[:, None]
    rows = np.concatenate([ties.changed, np.arange(old_count, count)])
    nodes = np.concatenate([triangle_nodes[:, 0], np.zeros(count - old_count, np.int32)])
    nodes[rows] = ties.nodes[:, 0]
    follows = of_node[nodes]
    surface_part = np.full(count, -1)
    surface_part[split.triangles] = split.triangle_part[:, None]
    used = np.flatnonzero(surface_part >= 0)
    part_count = int(of_cell.max()) + 1
    votes = np.bincount(surface_part[used] * part_count + follows[used], minlength=part_count)
    full = np.append(votes, np.zeros(-len(votes) % part_count, votes.dtype))
    most = full.reshape(-1, part_count).argmax(axis=1)
    wanted = np.append(most, -1)[surface_part]
    # What no other part of the surface follows is of this one, if only by a bridge that has no sample.
    wrong = np.flatnonzero((surface_part >= 0) & (follows != wanted) & np.isin(follows, most))
    if not len(wrong):
        return ties
    middles, places = model.cells + 0.5, split.places_of(wrong)
    cells = np.empty(len(wrong), np.int64)
    for part in np.unique(wanted[wrong]).tolist():
        of_part = np.flatnonzero(of_cell == part)
        mine = np.flatnonzero(wanted[wrong] == part)
        for row in mine.tolist():
            away = middles[of_part] - places[row]
            cells[row] = of_part[np.einsum("nx,nx->n", away, away).argmin()]
    halves = _half_faces(parted, cells, places)
    at_row = np.full(count, -1)
    at_row[rows] = np.arange(len(rows))
    added = wrong[at_row[wrong] < 0]
    changed = np.sort(np.concatenate([ties.changed, added]))
    is_anew = np.isin(changed, ties.changed[ties.is_tied_anew]) | np.isin(changed, wrong)
    all_nodes, all_cells = np.zeros((count, 3), np.int32), np.zeros((count, 2), np.int32)
    all_nodes[rows], all_cells[rows] = ties.nodes, np.stack([ties.cells, ties.own], axis=1)
    all_nodes[wrong], all_cells[wrong] = halves, cells[:, None]
    sees_own = np.zeros(count, np.bool_)
    sees_own[rows] = ties.sees_own
    rows = np.concatenate([changed, np.arange(old_count, count)])
    tied, own = np.ascontiguousarray(all_cells[rows].T)
    return Ties(changed, is_anew, all_nodes[rows], tied, own, sees_own[rows])


def _corners_by_reach(model: LatticeModel, split: SplitMesh, triangle_nodes: Int32, vertices: Int64) -> Int64:
    """Corners of the triangle that each new vertex lies on, that first whose nodes are nearest, shape (count, 3)."""
    corners = split.uncut_triangles[split.new_on_triangle[vertices]]
    order = np.empty((len(vertices), 3), np.int64)
    # Both lips of a cut choose alike.
    order_by_reach(split.new_places[vertices], corners, triangle_nodes, model.node_index, _PLACES, order)
    return order


def _near_sheets(model: LatticeModel, parted: PartedLattice, tied: TiedSurface) -> Int64:
    """Vertices of the uncut surface in cells that a sheet comes to, or beside these."""
    cells = tied.cells
    found = np.empty(len(tied.box_cells), np.int64)
    indices = model.cells[parted.pieces.cells] - (cells.low - 2)
    return found[: near_cells(indices, cells.high - cells.low + 5, tied.box_cells, found)].copy()


def _corners_of(parted: PartedLattice, cells: Int64, nodes: Int32) -> Int32:
    """Corners of cells of the cut lattice that are, or are copies of, nodes, shape (count, 3)."""
    found = np.empty((len(cells), 3), np.int32)
    copies_of(parted.model.cell_corners, parted.node_origin, cells, nodes, found)
    return found


def _half_faces(parted: PartedLattice, cells: Int64, points: Float64) -> Int32:
    """Nodes of the half of a face of each cell that is nearest to a point, shape (count, 3)."""
    nodes = np.empty((len(cells), 3), np.int32)
    model = parted.model
    nearest_halves(points, cells, model.cells, model.cell_corners, _HALF_FACES, CORNER_OFFSETS, nodes)
    return nodes
