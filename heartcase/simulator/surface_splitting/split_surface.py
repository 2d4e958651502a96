"""The visible surface of a cut lattice: split along the sheets, tied to it, with all that the kernels need to move it.

All follows from the uncut surface and the list of sheets: taking the last one back gives the same bytes.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from heartcase.schemas.arrays import Bool, Float32, Float64, Int32, Int64
from heartcase.simulator.cutting.blade_sheet import Sheet
from heartcase.simulator.cutting.parted_lattice import PartedLattice
from heartcase.simulator.cutting.tissue_samples import TissueSamples
from heartcase.simulator.lattice.model import DIRECTIONS, LatticeModel
from heartcase.simulator.mesh_arrangement.arrange import NOTHING_CROSSES, Crossings, crossings
from heartcase.simulator.mesh_arrangement.uncut_surface import UncutSurface
from heartcase.simulator.surface.cpu_kernels import move_at_rest
from heartcase.simulator.surface.deform import (
    NodeNormals,
    SurfaceModel,
    deform,
    interpolated_basis,
    rest_normals,
    triangle_basis,
    ways_of_nodes,
)
from heartcase.simulator.surface_splitting.facing_kernels import corner_angles, sum_directions
from heartcase.simulator.surface_splitting.hanging_kernels import find_bent, gather_near, hang_on, write_offsets
from heartcase.simulator.surface_splitting.lips_and_walls import SplitMesh, split_mesh
from heartcase.simulator.surface_splitting.surface_binding import (
    Seen,
    TiedSurface,
    Ties,
    tie_split,
)

__all__ = ["CuttableSurface", "SplitSurface", "split_surface"]

_ONE_PLACE = 1e-6
"""Vertices that are nearer to one another are in one place [cells]."""


@dataclass(frozen=True)
class CuttableSurface:
    """A surface over a lattice, before any cut: what every split of it starts from."""

    model: LatticeModel
    """The uncut lattice."""
    surface: SurfaceModel
    """The uncut surface, with triangles."""
    mesh: UncutSurface
    """The same at rest, in the frame of the nodes."""
    normals: Float64
    """Unit normals at rest, grid axes, shape (vertex_count, 3)."""
    curved: Int64
    """Vertices with an interpolated basis, ascending."""
    rest_normals: Float32
    """Approximate normals at rest of the nodes that these need, shape (at least 1, 3)."""
    lowest_neighbours: Int32
    """Lowest node that a spring joins to each node, or itself, shape (node_count,)."""
    ways: Int64
    """Ways of the springs of each node: see :func:`heartcase.simulator.surface.deform.ways_of_nodes`."""
    tied: TiedSurface
    """What its vertices follow."""

    @classmethod
    def of(cls, model: LatticeModel, surface: SurfaceModel) -> CuttableSurface:
        """Prepare a surface.

        Raises
        ------
        SimulationError
            The surface is not closed.
        """
        still = deform(model, surface, np.zeros((model.node_count, 3), np.float32))
        places = model.geometry.world_to_index(surface.rest_mm.astype(np.float64)) + 0.5
        normals = still.normals.astype(np.float64) @ model.geometry.direction_matrix
        mesh = UncutSurface.of(places, surface.triangles)
        tied = TiedSurface.of(model, surface.triangle_nodes, mesh.places, mesh.triangles)
        curved, at_rest = np.flatnonzero(surface.curvature), rest_normals(surface.normals_of)
        lowest = np.arange(model.node_count, dtype=np.int32)
        np.minimum.at(lowest, model.spring_nodes[:, 1], model.spring_nodes[:, 0])
        return cls(model, surface, mesh, normals, curved, at_rest, lowest, ways_of_nodes(model), tied)

    def samples(self) -> TissueSamples:
        """Samples of the tissue inside the surface."""
        return TissueSamples.inside(self.mesh.places, self.mesh.triangles)


@dataclass(frozen=True)
class SplitWork:
    """What was found when a surface was split."""

    cuttable: CuttableSurface | None
    """The uncut surface."""
    sheets: tuple[Sheet, ...]
    """What it was split along."""
    crossings: Crossings
    seen: Seen | None
    other: Int64
    """Vertices of the uncut surface that follow their nodes otherwise than there."""

    def is_begun(self, cuttable: CuttableSurface, sheets: tuple[Sheet, ...]) -> bool:
        """Whether a split along some sheets goes on from this one."""
        is_of_same = self.cuttable is cuttable and len(self.sheets) <= len(sheets)
        return is_of_same and all(one is other for one, other in zip(self.sheets, sheets, strict=False))


_NO_WORK = SplitWork(None, (), NOTHING_CROSSES, None, np.zeros(0, np.int64))


@dataclass(frozen=True)
class SplitSurface:
    """A surface that was split. Vertices of the uncut surface keep their numbers; new ones follow.

    At a lip the surface and the cut face each have a vertex, which move as one, so that the edge between them is sharp.
    """

    surface: SurfaceModel
    """It, over the cut lattice."""
    weld: Int32
    """Lowest vertex that is one with each, shape (vertex_count,): the surface is closed and manifold over these."""
    triangle_origin: Int32
    """Triangle of the uncut surface that each is a part of, or -1 for cut faces, shape (triangle_count,)."""
    triangle_sheet: Int32
    """Sheet that made each cut face, or -1, shape (triangle_count,)."""
    triangle_part: Int32
    """Number of what each triangle hangs together with, shape (triangle_count,)."""
    vertex_cells: Int32
    """Cell of the cut lattice whose corners a vertex follows, where it is new or follows other nodes than before; else
    -1, shape (vertex_count,)."""
    on_triangle: Int32
    """Triangle of the uncut surface on which each new vertex of a lip lies, else -1, shape (vertex_count,)."""
    on_weights: Float32
    """Barycentric place there, shape (vertex_count, 3)."""
    uv_mm: Float32
    """Texture coordinates of cut faces: places on the sheet laid out flat, mm; else 0, shape (vertex_count, 2)."""

    work: SplitWork | None = field(default=None, repr=False, compare=False)
    """What was found for it, from which a split with more sheets goes on."""

    @property
    def triangle_is_cut_face(self) -> Bool:
        """Whether a triangle is a new wall, shape (triangle_count,)."""
        return self.triangle_origin < 0

    def carried(self, values: Any, cut_face: Any) -> Any:
        """What the triangles of the uncut surface have, such as label, kind or colour, for those of this one.

        Parameters
        ----------
        values
            One for each triangle of the uncut surface, shape (uncut_triangle_count, ...).
        cut_face
            That of cut faces.
        """
        values = np.asarray(values)
        found = values[self.triangle_origin]
        found[self.triangle_is_cut_face] = np.asarray(cut_face).astype(values.dtype)
        return found


def split_surface(
    cuttable: CuttableSurface, parted: PartedLattice, sheets: Sequence[Sheet], before: SplitSurface | None = None
) -> SplitSurface:
    """Split a surface along sheets and tie it to the lattice that they cut.

    Parameters
    ----------
    cuttable
        The uncut surface.
    parted
        The cut lattice (:func:`heartcase.simulator.cutting.parted_lattice.part` with the same sheets).
    sheets
        What the blade swept, at rest.
    before
        The surface split along the first of these sheets, from which it goes on: the same bytes, and sooner.
    """
    sheets = tuple(sheets)
    work = None if before is None else before.work
    if work is None or not work.is_begun(cuttable, sheets):
        work = _NO_WORK
    crossing = crossings(cuttable.mesh, sheets, work.crossings, len(work.sheets))
    mesh = crossing.mesh
    split = split_mesh(cuttable.mesh, crossing)
    outward, normals = _directions(cuttable, split)
    ties, seen = tie_split(
        cuttable.model,
        parted,
        mesh,
        split,
        cuttable.tied,
        (cuttable.normals, outward),
        work.seen,
    )
    surface, is_other = _hung(cuttable, parted, split, ties, normals)
    count, old_count = split.vertex_count, split.old_count
    cells, weld = np.full(count, -1, np.int32), np.arange(count, dtype=np.int32)
    cells[ties.changed] = ties.cells[: len(ties.changed)]
    cells[old_count:] = ties.cells[len(ties.changed) :]
    weld[old_count:] = split.new_weld
    on_triangle, on_weights = np.full(count, -1, np.int32), np.zeros((count, 3), np.float32)
    on_triangle[old_count:], on_weights[old_count:] = split.new_on_triangle, split.new_on_weights
    uv_mm = np.zeros((count, 2), np.float32)
    uv_mm[old_count:] = split.new_flat * cuttable.model.cell_mm
    return SplitSurface(
        surface=surface,
        weld=weld,
        triangle_origin=split.triangle_origin,
        triangle_sheet=split.triangle_sheet,
        triangle_part=split.triangle_part,
        vertex_cells=cells,
        on_triangle=on_triangle,
        on_weights=on_weights,
        uv_mm=uv_mm,
        work=SplitWork(cuttable, sheets, crossing, seen, np.flatnonzero(is_other)),
    )


def _directions(cuttable: CuttableSurface, split: SplitMesh) -> tuple[Float64, Float64]:
    """Direction out of the tissue at each new vertex, and its normal; unit vectors, grid axes."""
    first_row, new_count = len(split.triangles) - len(split.facing), len(split.new_places)
    triangles, shape = split.triangles[first_row:], (len(split.facing), 3)
    sines, cosines, is_short = np.empty(shape), np.empty(shape), np.empty(shape, np.bool_)
    corner_angles(triangles, split.uncut_places, split.new_places, _ONE_PLACE, sines, cosines, is_short)
    # By the angle at the corner: how a side is divided into triangles does not count.
    angles = np.arctan2(sines, cosines)
    angles += 0.3  # a side that is too thin counts, too
    outward, normals = np.empty((new_count, 3)), np.empty((new_count, 3))
    sum_directions(
        triangles,
        split.facing,
        angles,
        is_short,
        split.triangle_origin[first_row:] >= 0,
        split.new_weld,
        (split.new_on_triangle, split.new_on_weights),
        (cuttable.normals, cuttable.mesh.triangles),
        outward,
        normals,
    )
    return outward, normals


def _hung(
    cuttable: CuttableSurface, parted: PartedLattice, split: SplitMesh, ties: Ties, new_normals: Float64
) -> tuple[SurfaceModel, Bool]:
    """The surface with its new vertices, and which of the others follow their nodes otherwise than before."""
    before, model = cuttable.surface, parted.model
    old_count, count = before.vertex_count, split.vertex_count
    new = np.arange(old_count, count)
    rows = np.concatenate([ties.changed, new])

    def grown(values: Any) -> Any:
        room = np.empty((count, *values.shape[1:]), values.dtype)
        room[:old_count], room[old_count:] = values, 0
        return room

    arrays: dict[str, Any] = {
        name: grown(getattr(before, name))
        for name in (
            "rest_mm",
            "triangle_nodes",
            "weights",
            "edges",
            "curvature",
            "offset",
            "normal",
            "normal_number",
            "rest_turn",
        )
    }
    arrays["triangle_nodes"][rows] = ties.nodes
    arrays["rest_mm"][new] = model.geometry.index_to_world(split.new_places - 0.5).astype(np.float32)
    normals_of, at_rest, touched, is_bent_anew = _node_normals(cuttable, parted, arrays, ties)

    tied_anew = np.concatenate([ties.changed[ties.is_tied_anew], new])
    arrays["curvature"][tied_anew] = 0
    arrays["normal_number"][tied_anew] = 0
    redone = np.concatenate([tied_anew, is_bent_anew])
    nodes, places = arrays["triangle_nodes"][redone], split.places_of(redone)
    edges, basis = np.empty((len(redone), 2, 3), np.float32), np.empty((len(redone), 3, 3))
    weights, curvature = arrays["weights"][redone], arrays["curvature"][redone]
    if hang_on(places, nodes, model.node_index, len(tied_anew), weights, edges, basis) < 1e-6:
        corners = model.node_index[nodes].astype(np.float64)
        triangle_basis(corners[:, 1:] - corners[:, :1])
    bent = np.flatnonzero(curvature)
    numbers = arrays["normal_number"][redone]
    if len(bent):
        curved, defined = interpolated_basis(edges[bent].astype(np.float64), weights[bent], at_rest[numbers[bent]])
        basis[bent[defined]] = curved[defined]
        curvature[bent[~defined]] = 0
    is_old = redone < old_count
    facing = np.empty((len(redone), 3))
    facing[is_old], facing[~is_old] = cuttable.normals[redone[is_old]], new_normals[redone[~is_old] - old_count]
    offset, normal, turn = (np.empty((len(redone), 3), np.float32) for _ in range(3))
    write_offsets(places, nodes, model.node_index, weights, basis, facing, offset, normal)
    still = np.zeros((model.node_count, 3), np.float32)
    move_at_rest(nodes, weights, edges, curvature, offset, numbers, at_rest, still, turn)
    redone_arrays = (weights, edges, curvature, offset, normal, turn)
    names = ("weights", "edges", "curvature", "offset", "normal", "rest_turn")
    for name, values in zip(names, redone_arrays, strict=True):
        arrays[name][redone] = values
    hung = replace(
        before,
        triangles=split.triangles,
        normals_of=normals_of,
        **arrays,
        **_drawn(before, arrays["normal"][new]),
    )
    is_other = np.zeros(old_count, np.bool_)
    is_other[ties.changed] = is_other[touched] = True
    return hung, is_other


def _node_normals(
    cuttable: CuttableSurface, parted: PartedLattice, arrays: dict[str, Any], ties: Ties
) -> tuple[NodeNormals, Float32, Int64, Int64]:
    """Springs for approximate normals, these at rest, bent vertices with others, and those where one at rest changed.

    The numbers of the normals of each vertex are written.
    """
    before, model = cuttable.surface, parted.model
    old, old_at_rest, nothing = before.normals_of, cuttable.rest_normals, np.zeros(0, np.int64)
    # Of the cells that sheets come to the first piece keeps the number, and the others follow.
    is_around = np.zeros(model.node_count, np.bool_)
    is_around[model.cell_corners[parted.pieces.cells]] = True
    is_around[model.cell_corners[cuttable.model.cell_count :]] = True
    is_near = np.zeros(model.node_count, np.bool_)
    touched = np.empty(len(cuttable.curved), np.int64)
    all_nodes = arrays["triangle_nodes"]
    count = find_bent(cuttable.curved, ties.changed, ties.is_tied_anew, all_nodes, is_around, is_near, touched)
    if not count:
        return old, old_at_rest, nothing, nothing
    touched = touched[:count].copy()
    nodes, around = all_nodes[touched], np.flatnonzero(is_near)
    added = _gathered(cuttable, parted, around)
    first = np.concatenate([old.first, old.first[-1] + added.first[1:]]).astype(np.int32)
    joined = NodeNormals(
        np.concatenate([old.nodes, added.nodes]),
        first,
        np.concatenate([old.neighbours, added.neighbours]),
        np.concatenate([old.offset, added.offset]),
    )
    at_rest = np.concatenate([old_at_rest[: len(old.nodes)], rest_normals(added)])
    number_of = np.empty(model.node_count, np.int32)
    number_of[around] = len(old.nodes) + np.arange(len(around))
    was = before.normal_number[touched]
    numbers = np.where(is_around[nodes], number_of[nodes], was)
    arrays["normal_number"][touched] = numbers
    is_same = (at_rest[numbers] == at_rest[was]).all(axis=(1, 2))
    return joined, at_rest, touched, touched[~is_same]


def _gathered(cuttable: CuttableSurface, parted: PartedLattice, nodes: Int64) -> NodeNormals:
    """The springs of some nodes, as ``gather_springs`` has them; but of opposite ways of which one was cut none."""
    model, first, room = parted.model, np.empty(len(nodes) + 1, np.int32), 24 * len(nodes)
    while True:
        neighbours, offset = np.empty(room, np.int32), np.empty((room, 3), np.float32)
        count = gather_near(
            model.spring_nodes,
            model.spring_direction,
            DIRECTIONS,
            parted.node_origin,
            cuttable.lowest_neighbours,
            cuttable.ways,
            nodes,
            first,
            neighbours,
            offset,
        )
        if count <= room:
            return NodeNormals(nodes.astype(np.int32), first, neighbours[:count].copy(), offset[:count].copy())
        room = count


def _drawn(before: SurfaceModel, normal: Float32) -> dict[str, Any]:
    """Render vertices and their tangents, where they were loaded: one for each new vertex, across its normal."""
    if not len(before.render_to_welded):
        return {"render_first": np.zeros(before.vertex_count + len(normal) + 1, np.int32)}
    across = np.zeros((len(normal), 4), np.float32)
    across[np.arange(len(normal)), np.abs(normal).argmin(axis=1)] = 1.0
    along = _unit(across[:, :3] - normal * np.einsum("nx,nx->n", across[:, :3], normal)[:, None])
    across[:, :3], across[:, 3] = along, 1.0
    welded = np.concatenate([before.render_to_welded, before.vertex_count + np.arange(len(normal))]).astype(np.int32)
    counts = np.bincount(welded, minlength=before.vertex_count + len(normal))
    return {
        "render_to_welded": welded,
        "tangent": np.concatenate([before.tangent, across]),
        "render_first": np.append(0, np.cumsum(counts)).astype(np.int32),
        "render_vertices": np.argsort(welded, kind="stable").astype(np.int32),
    }


def _unit(vectors: Any) -> Any:
    vectors = np.asarray(vectors, np.result_type(vectors, np.float32))
    length = np.linalg.norm(vectors, axis=-1, keepdims=True)
    return np.divide(vectors, length, out=np.zeros_like(vectors), where=length > 0)
