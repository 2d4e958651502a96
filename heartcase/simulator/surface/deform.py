"""The visible surface: how it follows the nodes (thesis 9.3.2 and 9.3.3).

Each vertex of an uncut surface hangs on a triangle of nodes: a reference point on the triangle plus an offset in its
basis (T, N, B). The basis is the triangle's own (eq. 9.6), or one whose normal is interpolated from the approximate
normals of the three nodes (eq. 9.3 and 9.8), so that the surface bends smoothly from triangle to triangle. All bases
are normalised, which the thesis leaves out. Along cuts vertices follow the corners of a cell instead
(:mod:`heartcase.simulator.surface.cell_vertices`). What is stored and computed are displacements from rest, so that the
surface at rest is the bundle's to the last bit.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Any, Literal, get_args

import numpy as np

from heartcase.schemas.arrays import Bool, Float, Float32, Float64, Int32, Int64, UInt8
from heartcase.schemas.errors import HeartcaseError, SimulationError
from heartcase.simulator.lattice.model import DIRECTIONS, LatticeModel
from heartcase.simulator.surface.cell_vertices import NO_CELL_VERTICES, CellVertices
from heartcase.simulator.surface.cpu_kernels import (
    EVERYTHING,
    deform_in_cells,
    deform_vertices,
    move_at_rest,
    node_normals,
    place_nodes,
)

__all__ = [
    "Curvature",
    "DeformedSurface",
    "PickingModel",
    "SurfaceModel",
    "check_curvature",
    "deform",
    "deform_picking",
    "make_picking",
    "make_surface",
]


Curvature = Literal["flagged", "all", "none"]

BASIS_MIN = 0.1
"""Shortest interpolated normal, and its shortest part across T, that still makes a basis."""


@dataclass(frozen=True)
class NodeNormals:
    """The springs from which approximate normals are made (eq. 9.3), for the nodes that need one."""

    nodes: Int32
    """Nodes with a normal, ascending, shape (normal_count,)."""
    first: Int32
    """Where each node's neighbours start in ``neighbours``, shape (normal_count + 1,)."""
    neighbours: Int32
    """Nodes at the other end of the springs, shape (neighbour_count,)."""
    offset: Float32
    """Vector from each neighbour to the node at rest [cells], shape (neighbour_count, 3)."""

    @property
    def springs(self) -> tuple[Any, ...]:
        """What the kernels take."""
        return self.nodes, self.first, self.neighbours, self.offset


@dataclass(frozen=True)
class SurfaceModel:
    """Constant arrays of the surface, in grid units and axes."""

    triangles: Int32
    """Vertex numbers, counter-clockwise from outside, shape (triangle_count, 3); empty when not loaded."""
    rest_mm: Float32
    """Rest positions of the vertices, LPS mm, shape (vertex_count, 3)."""
    triangle_nodes: Int32
    """Nodes of each vertex's triangle, shape (vertex_count, 3)."""
    weights: Float32
    """Weights of the reference point, sum one, shape (vertex_count, 3)."""
    edges: Float32
    """Vectors from the triangle's first node to its second and third at rest [cells], shape (vertex_count, 2, 3)."""
    curvature: UInt8
    """1 where the interpolated basis is used, shape (vertex_count,)."""
    offset: Float32
    """Offset along the vertex's basis (T, N, B) [cells], shape (vertex_count, 3)."""
    normal: Float32
    """Normal along the vertex's basis, shape (vertex_count, 3)."""
    normals_of: NodeNormals
    """What the interpolated bases need."""
    normal_number: Int32
    """Where each corner of the triangles is in ``normals_of``, shape (vertex_count, 3); 0 where it is not needed."""
    rest_turn: Float32
    """Offset in grid axes at rest [cells], shape (vertex_count, 3)."""
    render_to_welded: Int32
    """Vertex of each render vertex, shape (render_vertex_count,); empty when not loaded."""
    tangent: Float32
    """Tangent along the vertex's basis and handedness, shape (render_vertex_count, 4); empty when not loaded."""
    render_first: Int32
    """Where each vertex's render vertices start in ``render_vertices``, shape (vertex_count + 1,)."""
    render_vertices: Int32
    """Render vertices, vertex by vertex, shape (render_vertex_count,)."""
    in_cells: CellVertices = field(default=NO_CELL_VERTICES)
    """Vertices that follow the corners of a cell instead of their triangle: along cuts."""

    @property
    def hung(self) -> tuple[Any, ...]:
        """What the kernels take to place vertices."""
        return (
            self.triangle_nodes,
            self.weights,
            self.edges,
            self.curvature,
            self.offset,
            self.normal,
            self.normal_number,
            self.rest_mm,
            self.rest_turn,
        )

    @property
    def drawn(self) -> tuple[Any, ...]:
        """What the kernels take to turn tangents."""
        return self.render_first, self.render_vertices, self.tangent

    @property
    def vertex_count(self) -> int:
        """Number of vertices."""
        return len(self.weights)


@dataclass(frozen=True)
class PickingModel:
    """The coarse surface with one vertex per boundary node (thesis 9.3.2, 10.2.4)."""

    nodes: Int32
    """Node of each vertex, shape (picking_vertex_count,)."""
    triangles: Int32
    """Vertex numbers, counter-clockwise from outside, shape (picking_triangle_count, 3)."""
    rest_mm: Float64
    """Rest positions of the vertices, LPS mm, shape (picking_vertex_count, 3)."""
    normals_of: NodeNormals
    """What the approximate normals need."""

    @property
    def vertex_count(self) -> int:
        """Number of vertices."""
        return len(self.nodes)


@dataclass(frozen=True)
class DeformedSurface:
    """A surface at one time, LPS mm; not to be changed."""

    vertices_mm: Float32
    """Positions, LPS mm, shape (vertex_count, 3)."""
    normals: Float32
    """Unit normals, shape (vertex_count, 3)."""
    tangents: Float32 | None = None
    """Unit tangent and handedness of each render vertex, shape (render_vertex_count, 4), where they were loaded."""


def check_curvature(mode: str, place: str, error: type[HeartcaseError]) -> None:
    """Refuse, with an ``error`` at a ``place``, what is none of :data:`Curvature`."""
    if mode not in get_args(Curvature):
        raise error(f"must be one of {', '.join(get_args(Curvature))} (found {mode!r})", place=place)


def make_surface(
    model: LatticeModel,
    *,
    triangle_nodes: Int32,
    weights: Float32,
    offset_mm: Float32,
    normal: Float32,
    curvature: UInt8,
    mode: Curvature = "flagged",
    triangles: Int32 | None = None,
    render_to_welded: Int32 | None = None,
    tangent: Float32 | None = None,
) -> SurfaceModel:
    """Prepare a surface for deformation.

    Parameters
    ----------
    model
        The lattice that the surface follows.
    triangle_nodes, weights, offset_mm, normal, curvature, tangent, render_to_welded, triangles
        As in the bundle: offset, normal and tangent along the (T, N, B) of the triangle at rest.
    mode
        Where the interpolated basis is used: where ``curvature`` is 1, everywhere that the nodes' normals define one,
        or nowhere.

    Returns
    -------
    SurfaceModel
        Offset, normal and tangent of the vertices with an interpolated basis are along that basis at rest.

    Raises
    ------
    SimulationError
        There is no such mode.
    """
    check_curvature(mode, "mode", SimulationError)
    vertex_count = len(weights)
    corners = model.node_index[triangle_nodes].astype(np.float64)
    edges = corners[:, 1:] - corners[:, :1]
    basis = triangle_basis(edges)
    still = np.zeros((model.node_count, 3), np.float32)
    wanted = {"flagged": curvature != 0, "all": np.ones(vertex_count, bool), "none": np.zeros(vertex_count, bool)}[mode]
    normals_of = gather_springs(model, np.unique(triangle_nodes[wanted]))
    at = np.flatnonzero(wanted)
    number = np.zeros((vertex_count, 3), np.int32)
    number[at] = np.searchsorted(normals_of.nodes, triangle_nodes[at])
    curved, defined = interpolated_basis(edges[at], weights[at], _normals_now(normals_of, still)[number[at]])
    wanted[at[~defined]] = False
    at, curved = at[defined], curved[defined]
    offset = np.asarray(offset_mm, np.float64) / model.cell_mm
    rest_mm = np.einsum("vi,vix->vx", weights.astype(np.float64), model.rest_positions_mm()[triangle_nodes])
    rest_mm += model.to_mm(np.einsum("vb,vbx->vx", offset, basis))
    turn = np.einsum("vab,vcb->vac", curved, basis[at])
    offset[at] = np.einsum("vab,vb->va", turn, offset[at])
    bent_normal = np.array(normal, np.float32)
    bent_normal[at] = np.einsum("vab,vb->va", turn, normal[at].astype(np.float64))

    welded = np.zeros(0, np.int32) if render_to_welded is None or tangent is None else render_to_welded
    turned = np.zeros((0, 4), np.float32)
    if render_to_welded is not None and tangent is not None:
        turned = np.array(tangent, dtype=np.float32)
        is_bent = wanted[welded]
        turn_of = turn[np.searchsorted(at, welded[is_bent])]
        turned[is_bent, :3] = np.einsum("vab,vb->va", turn_of, tangent[is_bent, :3].astype(np.float64))
    surface = SurfaceModel(
        triangles=np.zeros((0, 3), np.int32) if triangles is None else np.asarray(triangles, np.int32),
        rest_mm=rest_mm.astype(np.float32),
        triangle_nodes=np.array(triangle_nodes, np.int32),
        weights=np.array(weights, np.float32),
        edges=edges.astype(np.float32),
        curvature=wanted.astype(np.uint8),
        offset=offset.astype(np.float32),
        normal=bent_normal,
        normals_of=normals_of,
        normal_number=number,
        rest_turn=np.zeros((vertex_count, 3), np.float32),
        render_to_welded=np.array(welded, np.int32),
        tangent=turned,
        render_first=np.append(0, np.cumsum(np.bincount(welded, minlength=vertex_count))).astype(np.int32),
        render_vertices=np.argsort(welded, kind="stable").astype(np.int32),
    )
    rest_turn = np.empty((vertex_count, 3), np.float32)
    move_at_rest(
        surface.triangle_nodes,
        surface.weights,
        surface.edges,
        surface.curvature,
        surface.offset,
        surface.normal_number,
        _normals_now(normals_of, still),
        still,
        rest_turn,
    )
    return replace(surface, rest_turn=rest_turn)


def make_picking(model: LatticeModel, nodes: Int32, triangles: Int32) -> PickingModel:
    """Prepare the one-to-one surface; ``nodes`` and ``triangles`` as in the bundle.

    Parameters
    ----------
    model
        The lattice.
    nodes
        Node of each vertex, int32, shape (vertex_count,), as in the bundle.
    triangles
        Vertices of each triangle, int32, shape (triangle_count, 3), as in the bundle.
    """
    nodes = np.array(nodes, np.int32)
    return PickingModel(
        nodes=nodes,
        triangles=np.array(triangles, np.int32),
        rest_mm=model.rest_positions_mm()[nodes],
        normals_of=gather_springs(model, nodes),
    )


def deform(model: LatticeModel, surface: SurfaceModel, displacement: Float32) -> DeformedSurface:
    """The surface over displaced nodes (eq. 9.9).

    Parameters
    ----------
    displacement
        Displacement of the nodes [cells, grid axes], float32, shape (node_count, 3).
    """
    return _deform_all(model, surface, displacement)


def deform_picking(model: LatticeModel, picking: PickingModel, displacement: Float32) -> DeformedSurface:
    """The one-to-one surface: vertices at the nodes, normals from their springs (thesis 9.3.2).

    Parameters
    ----------
    displacement
        As of :func:`deform`.
    """
    return _deform_all(model, picking, displacement)


def empty_frame(surface: SurfaceModel | PickingModel) -> DeformedSurface:
    """Room for a deformed surface."""
    vertices_mm, normals = (np.empty((surface.vertex_count, 3), np.float32) for _ in range(2))
    tangent = surface.tangent if isinstance(surface, SurfaceModel) else ()
    return DeformedSurface(vertices_mm, normals, np.empty((len(tangent), 4), np.float32) if len(tangent) else None)


def empty_normals(springs: NodeNormals) -> Float32:
    """Room for approximate normals; (1, 3) of zeros where none is wanted, so that it can be indexed."""
    return np.zeros((max(len(springs.nodes), 1), 3), np.float32)


def write_vertices(
    model: LatticeModel,
    surface: SurfaceModel | PickingModel,
    node_normal: Float32,
    displacement: Float32,
    frame: DeformedSurface,
    marks: UInt8 = EVERYTHING,
    *,
    together: bool = False,
) -> None:
    """Write the vertices of a frame, or only those of which a node or a normal changed.

    Parameters
    ----------
    node_normal, displacement
        The nodes' approximate normals, as many as ``normals_of`` has, and displacement [cells], grid axes, float32.
    frame
        Written.
    marks, together
        As of :func:`heartcase.simulator.surface.cpu_kernels.deform_vertices`.
    """
    direction = np.ascontiguousarray(model.geometry.direction_matrix.T, np.float64)
    if isinstance(surface, PickingModel):
        axes = direction * model.cell_mm, direction
        written = frame.vertices_mm, frame.normals
        picked = surface.nodes, surface.rest_mm, axes, node_normal, displacement, written
        place_nodes(*picked, marks, together=together)
        return
    unit = direction.astype(np.float32)
    turning = unit * np.float32(model.cell_mm), unit
    tangents = np.zeros((0, 4), np.float32) if frame.tangents is None else frame.tangents
    room = frame.vertices_mm, frame.normals, tangents
    drawn = surface.drawn
    deform_vertices(surface.hung, drawn, turning, node_normal, displacement, room, marks, together=together)
    if len(surface.in_cells.vertices):
        hung = surface.triangle_nodes, surface.curvature, surface.rest_mm
        cells = surface.in_cells.arrays
        deform_in_cells(cells, hung, drawn, turning, displacement, room, marks, together=together)


def ways_of_nodes(model: LatticeModel) -> Int64:
    """Ways of each node's springs, as bits: 2 d where one goes along direction d, 2 d + 1 against it; (node_count,)."""
    ways = np.zeros(model.node_count, np.int64)
    for end in (0, 1):
        np.bitwise_or.at(ways, model.spring_nodes[:, end], 1 << 2 * model.spring_direction.astype(np.int64) + end)
    return ways


def gather_springs(model: LatticeModel, nodes: Int32) -> NodeNormals:
    """The springs of some nodes, node by node; those to several copies of one place count together as any other."""
    number = np.full(model.node_count, -1)
    number[nodes] = np.arange(len(nodes))
    is_near = number >= 0
    near = np.flatnonzero(is_near[model.spring_nodes[:, 0]] | is_near[model.spring_nodes[:, 1]])
    ends = np.concatenate([model.spring_nodes[near], model.spring_nodes[near, ::-1]])
    offset = DIRECTIONS[model.spring_direction[near]]
    offset = np.concatenate([-offset, offset])
    kept = np.flatnonzero(number[ends[:, 0]] >= 0)
    kept = kept[np.argsort(ends[kept, 0].astype(np.int64) * model.node_count + ends[kept, 1])]
    direction = 2 * model.spring_direction[near].astype(np.int64)
    ways = np.concatenate([direction, direction + 1])
    asked = number[ends[kept, 0]]
    _, way_of, copy_count = np.unique(asked * 256 + ways[kept], return_inverse=True, return_counts=True)
    together = np.ones(len(nodes), np.int64)
    np.lcm.at(together, asked, copy_count[way_of])
    kept = np.repeat(kept, together[asked] // copy_count[way_of])
    first = np.searchsorted(ends[kept, 0], nodes, side="left")
    return NodeNormals(
        nodes=np.asarray(nodes, np.int32),
        first=np.append(first, len(kept)).astype(np.int32),
        neighbours=np.ascontiguousarray(ends[kept, 1], np.int32),
        offset=np.ascontiguousarray(offset[kept], np.float32),
    )


def triangle_basis(edges: Float64) -> Float64:
    """Eq. 9.6, normalised: rows T, N, B from the edges to the second and third node; (..., 2, 3) to (..., 3, 3).

    Raises
    ------
    SimulationError
        A triangle has no area.
    """
    T = _unit(edges[..., 0, :])
    N = np.cross(T, edges[..., 1, :])
    if len(N) and np.linalg.norm(N, axis=-1).min() < 1e-6:
        raise SimulationError("a surface vertex is tied to three nodes on one line: build the case again", place="map")
    N = _unit(N)
    return np.stack([T, N, np.cross(N, T)], axis=-2)


def interpolated_basis(edges: Float64, weights: Float, normals: Float) -> tuple[Float64, Bool]:
    """Eq. 9.8, normalised.

    Parameters
    ----------
    edges
        Edges to the second and third node, shape (vertex_count, 2, 3).
    weights
        Weights of the three nodes, shape (vertex_count, 3).
    normals
        Approximate normals of the three nodes, shape (vertex_count, 3, 3).

    Returns
    -------
    basis, defined
        Rows T, N, B, shape (vertex_count, 3, 3), and where the normals are good enough to define them.
    """
    T = _unit(edges[:, 0])
    N = np.einsum("vi,vix->vx", weights.astype(np.float64), normals.astype(np.float64))
    across = np.cross(_unit(N), T)
    defined = (np.linalg.norm(N, axis=1) > BASIS_MIN) & (np.linalg.norm(across, axis=1) > BASIS_MIN)
    N, B = _unit(N), _unit(across)
    return np.stack([np.cross(B, N), N, B], axis=1), defined


def rest_normals(springs: NodeNormals) -> Float32:
    """Approximate normals of the nodes at rest, shape (normal_count, 3), one row of zeros where there are none."""
    most = max(springs.nodes.max(initial=-1), springs.neighbours.max(initial=-1))
    return _normals_now(springs, np.zeros((int(most) + 1, 3), np.float32))


def _normals_now(springs: NodeNormals, displacement: Float32) -> Float32:
    normals = empty_normals(springs)
    node_normals(springs.springs, displacement, normals)
    return normals


def _deform_all(model: LatticeModel, surface: SurfaceModel | PickingModel, displacement: Float32) -> DeformedSurface:
    displacement = np.ascontiguousarray(displacement, np.float32)
    frame = empty_frame(surface)
    write_vertices(model, surface, _normals_now(surface.normals_of, displacement), displacement, frame)
    return frame


def _unit(vectors: Float64) -> Float64:
    length = np.linalg.norm(vectors, axis=-1, keepdims=True)
    unit: Float64 = np.divide(vectors, length, out=np.zeros_like(vectors), where=length > 0)
    return unit
