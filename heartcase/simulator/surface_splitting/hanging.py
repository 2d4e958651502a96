"""The arrays by which a split surface hangs on the lattice: its new vertices, and those that follow other nodes now."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from heartcase.schemas.arrays import Bool, Float32, Float64, Int32, Int64
from heartcase.simulator.cutting.parted_lattice import PartedLattice
from heartcase.simulator.lattice.model import DIRECTIONS, LatticeModel
from heartcase.simulator.surface.cell_vertices import CellVertices
from heartcase.simulator.surface.cpu_kernels import move_at_rest
from heartcase.simulator.surface.deform import (
    NodeNormals,
    SurfaceModel,
    interpolated_basis,
    rest_normals,
    triangle_basis,
)
from heartcase.simulator.surface_splitting.cuttable_surface import CuttableSurface
from heartcase.simulator.surface_splitting.hanging_kernels import find_bent, gather_near, hang_on, write_offsets
from heartcase.simulator.surface_splitting.lips_and_walls import SplitMesh
from heartcase.simulator.surface_splitting.surface_binding import Ties

__all__ = ["hung_surface"]


def hung_surface(
    cuttable: CuttableSurface, parted: PartedLattice, split: SplitMesh, ties: Ties, new_normals: Float64
) -> tuple[SurfaceModel, Bool]:
    """The surface with its new vertices, and which of the others follow their nodes otherwise than before.

    Parameters
    ----------
    cuttable, parted
        The uncut surface, and the cut lattice.
    split, ties
        The surface, split, and what its vertices follow.
    new_normals
        Unit normals of the new vertices, grid axes, shape (new_count, 3).
    """
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
        in_cells=_in_cells(cuttable, parted, split, ties, arrays["edges"], new_normals),
        **arrays,
        **_drawn(before, arrays["normal"][new]),
    )
    is_other = np.zeros(old_count, np.bool_)
    is_other[ties.changed] = is_other[touched] = True
    return hung, is_other


def _in_cells(
    cuttable: CuttableSurface,
    parted: PartedLattice,
    split: SplitMesh,
    ties: Ties,
    edges_now: Float32,
    new_normals: Float64,
) -> CellVertices:
    """New vertices, and those that follow other nodes than before, in their cells."""
    rows = np.concatenate([ties.changed, np.arange(split.old_count, split.vertex_count)])
    basis = np.zeros((0, 3, 3))
    if len(cuttable.surface.render_to_welded):
        # Tangents are kept along the basis that a vertex had before it was tied anew.
        before, bent = cuttable.surface, np.flatnonzero(cuttable.surface.curvature[ties.changed])
        edges = np.concatenate([before.edges[ties.changed], edges_now[split.old_count :]]).astype(np.float64)
        basis, vertices = triangle_basis(edges), ties.changed[bent]
        normals = cuttable.rest_normals[before.normal_number[vertices]]
        basis[bent] = interpolated_basis(edges[bent], before.weights[vertices], normals)[0]
    normal = np.concatenate([cuttable.normals[ties.changed], new_normals])
    places = split.places_of(rows)
    return CellVertices.of(parted.model, rows, _nearer(parted.model, ties, places), places, normal, basis)


def _nearer(model: LatticeModel, ties: Ties, places: Float64) -> Int32:
    """The cell that each vertex follows: that which it lies in, where it is of the side that it is tied to.

    So it is where the vertex sees both, and where they have a node in common. The nearer a cell is, the less of what it
    does has to be carried on beyond it.
    """
    beyond = [places - np.clip(places, model.cells[cells], model.cells[cells] + 1) for cells in (ties.cells, ties.own)]
    tied, own = (np.einsum("nx,nx->n", one, one) for one in beyond)
    corners = model.cell_corners
    is_joined = (corners[ties.cells][:, :, None] == corners[ties.own][:, None]).any(axis=(1, 2))
    found: Int32 = np.where((is_joined | ties.sees_own) & (own < tied), ties.own, ties.cells)
    return found


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
