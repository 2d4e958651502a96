"""The tissue's border at full resolution: marching cubes on a refined lattice, closed where the volume ends.

Marching cubes places a vertex on a lattice edge by linear interpolation, which is wrong where the tissue field has a
kink between the two ends (in the middle of a thin wall, or of a narrow gap). So each vertex slides along its own edge
to the field's root: it is then exact, and can neither leave its cell nor turn a triangle over.
"""

from __future__ import annotations

from dataclasses import dataclass

import numba
import numpy as np
import numpy.typing as npt
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from skimage.measure import marching_cubes

from heartcase.pipeline.data import Structures
from heartcase.pipeline.fields import ownership_at_points, ownership_on_lattice
from heartcase.schemas.errors import StageError
from heartcase.schemas.geometry import Geometry

__all__ = [
    "FullMesh",
    "drop_small_shells",
    "extract",
    "extraction_lattice",
    "opposites",
    "shell_volumes",
    "smooth_creases",
]

Float32 = npt.NDArray[np.float32]
Float64 = npt.NDArray[np.float64]
Int32 = npt.NDArray[np.int32]
Bool = npt.NDArray[np.bool_]

SPACING_PER_LAYER = 0.6
POINT_CAP = 40_000_000
ROOT_MARGIN = 0.004
ROOT_STEPS = 4
CREASE_DEGREES = 35.0
CREASE_ROUNDS = 5


@dataclass(frozen=True)
class FullMesh:
    """The full-resolution surface."""

    vertices_mm: Float64
    """World mm, shape (vertex_count, 3)."""
    triangles: Int32
    """Counter-clockwise from outside the tissue, shape (triangle_count, 3)."""
    on_end: Bool
    """Whether a vertex lies on the outer face of the volume, shape (vertex_count,)."""
    lattice: Geometry
    """The lattice that marching cubes ran on, without the layer that closes it."""
    is_capped: bool
    """Whether the lattice is coarser than the thinnest wall asks for, to stay within the cap on its points."""


def extraction_lattice(structures: Structures, *, point_cap: int = POINT_CAP) -> tuple[Geometry, bool]:
    """Lattice over the same voxels, fine enough for the thinnest layer; and whether the cap made it coarser.

    Parameters
    ----------
    structures
        The fields; their lattice's outer faces are kept.
    point_cap
        Most points that the lattice may have.

    Returns
    -------
    lattice : Geometry
        Spacing at most 0.6 of the thinnest wall or patch and 1.5 of the smallest voxel edge, unless the cap forbids it.
    is_capped : bool
        Whether it does.
    """
    geometry = structures.geometry
    spacing = np.array(geometry.spacing_mm)
    wall = structures.thinnest_layer_mm
    target = 1.5 * spacing.min() if wall is None else min(1.5 * spacing.min(), SPACING_PER_LAYER * wall)
    counts = np.array(geometry.size) * np.ceil(spacing / target - 1e-9).astype(np.int64)
    is_capped = bool(np.prod(counts) > point_cap)
    extent = np.array(geometry.size) * spacing
    while np.prod(counts) > point_cap:
        target *= 1.02
        counts = np.ceil(extent / target - 1e-9).astype(np.int64)
    new_spacing = extent / counts
    first = 0.5 * new_spacing / spacing - 0.5
    lattice = Geometry.of(
        shape=tuple(int(n) for n in counts[::-1]),
        origin_mm=geometry.index_to_world(first),
        spacing_mm=new_spacing,
        direction=geometry.direction,
    )
    return lattice, is_capped


def extract(structures: Structures, *, point_cap: int = POINT_CAP) -> FullMesh:
    """Extract the closed border of the tissue.

    Marching cubes with the topologically consistent tables of Lewiner et al. (J. Graphics Tools 8, 2003), so that the
    mesh is closed and manifold; vertices slide along their lattice edges to the root of the tissue field.

    Parameters
    ----------
    structures
        The fields.
    point_cap
        Most points that the lattice may have.

    Returns
    -------
    FullMesh
        Closed: where the volume ends inside tissue, at the outer faces of its voxels, flat faces close it.

    Raises
    ------
    StageError
        There is no tissue.
    """
    lattice, is_capped = extraction_lattice(structures, point_cap=point_cap)
    field = ownership_on_lattice(structures, lattice).tissue_mm
    smallest = min(lattice.spacing_mm)
    padded = _padded(field, ROOT_MARGIN * smallest)
    if not (padded < 0.0).any():
        raise StageError("there is no tissue to show: check the markers and wall thicknesses", place="surface")
    zyx, faces, _, _ = marching_cubes(padded, 0.0, gradient_direction="ascent")
    triangles = np.ascontiguousarray(faces, dtype=np.int32)
    if not lattice.is_right_handed:
        triangles = np.ascontiguousarray(triangles[:, ::-1])
    index = zyx[:, ::-1].astype(np.float64) - 1.0
    size = np.array(lattice.size)
    on_end = ((index < -0.25) | (index > size - 0.75)).any(axis=1)
    index = _slide_to_root(structures, lattice, padded, index, on_end)
    vertices, triangles, source = split_fans(lattice.index_to_world(index), triangles)
    return FullMesh(vertices, triangles, on_end[source], lattice, is_capped)


def _padded(field: Float32, least: float) -> Float32:
    """The field with a layer around it that mirrors the border to the positive, and with no value nearer to zero."""
    padded = np.pad(field, 1, mode="edge")
    for axis in range(3):
        for end in (0, -1):
            layer = np.moveaxis(padded, axis, 0)[end]
            np.abs(layer, out=layer)
    near = np.abs(padded) < least
    padded[near] = np.where(padded[near] < 0.0, -least, least)
    return padded


def _slide_to_root(structures: Structures, lattice: Geometry, padded: Float32, index: Float64, on_end: Bool) -> Float64:
    """Move each vertex along its lattice edge to the root of the field (Illinois variant of regula falsi)."""
    nearest = np.round(index)
    offset = np.abs(index - nearest)
    axis = offset.argmax(axis=1)
    rest = np.arange(len(index))
    off_axis = offset.sum(axis=1) - offset[rest, axis]
    movable = np.flatnonzero(~on_end & (off_axis < 1e-3))
    axis = axis[movable]
    start = nearest[movable]
    rows = np.arange(len(movable))
    start[rows, axis] = np.floor(index[movable, axis])
    low = np.zeros(len(movable))
    high = np.ones(len(movable))
    corner = start.astype(np.int64) + 1
    f_low = padded[corner[:, 2], corner[:, 1], corner[:, 0]].astype(np.float64)
    corner[rows, axis] += 1
    f_high = padded[corner[:, 2], corner[:, 1], corner[:, 0]].astype(np.float64)
    parameter = f_low / (f_low - f_high)
    side = np.zeros(len(movable), np.int8)
    tolerance = 1e-4 * min(lattice.spacing_mm)
    active = rows
    for _ in range(ROOT_STEPS):
        point = start[active].copy()
        point[np.arange(len(active)), axis[active]] += parameter[active]
        value = ownership_at_points(structures, lattice.index_to_world(point)).tissue_mm.astype(np.float64)
        open_ = np.abs(value) > tolerance
        active, value = active[open_], value[open_]
        if len(active) == 0:
            break
        is_low = (value < 0.0) == (f_low[active] < 0.0)
        halve_high = is_low & (side[active] == -1)
        halve_low = ~is_low & (side[active] == 1)
        f_high[active[halve_high]] *= 0.5
        f_low[active[halve_low]] *= 0.5
        low[active[is_low]] = parameter[active[is_low]]
        f_low[active[is_low]] = value[is_low]
        high[active[~is_low]] = parameter[active[~is_low]]
        f_high[active[~is_low]] = value[~is_low]
        side[active] = np.where(is_low, -1, 1)
        a, b = low[active], high[active]
        parameter[active] = a + (b - a) * f_low[active] / (f_low[active] - f_high[active])
    moved = index.copy()
    moved[movable] = start
    moved[movable, axis] += np.clip(parameter, ROOT_MARGIN, 1.0 - ROOT_MARGIN)
    return moved


@numba.njit(cache=True, nogil=True)
def _count_fans(triangles, opposite, vertex_count):  # type: ignore[no-untyped-def]
    corner_vertex = np.empty(triangles.size, np.int32)
    corner_vertex[:] = -1
    source = np.empty(triangles.size, np.int32)
    first = np.zeros(vertex_count, np.bool_)
    count = vertex_count
    for v in range(vertex_count):
        source[v] = v
    for h in range(triangles.size):
        if corner_vertex[h] >= 0:
            continue
        v = triangles[h // 3, h % 3]
        number = v
        if first[v]:
            number = count
            source[count] = v
            count += 1
        first[v] = True
        g = h
        while corner_vertex[g] < 0:
            corner_vertex[g] = number
            o = opposite[g]
            g = o - o % 3 + (o + 1) % 3
    return corner_vertex, source[:count]


def split_fans(vertices: Float64, triangles: Int32) -> tuple[Float64, Int32, Int32]:
    """Give each fan of triangles its own vertex where several fans meet in one point.

    Parameters
    ----------
    vertices, triangles
        A closed mesh whose edges all have two triangles.

    Returns
    -------
    vertices, triangles
        The mesh with manifold vertices: new vertices follow the old, drawn 2% towards their own fan.
    source : Int32
        Old vertex of each vertex.
    """
    corner_vertex, source = _count_fans(triangles, opposites(triangles), len(vertices))
    if len(source) == len(vertices):
        return vertices, triangles, source
    split = corner_vertex.reshape(-1, 3).astype(np.int32)
    moved = vertices[source]
    shared = np.isin(source, source[len(vertices) :])
    middle = moved[split].mean(axis=1)
    total = np.zeros_like(moved)
    count = np.zeros(len(moved))
    for corner in range(3):
        np.add.at(total, split[:, corner], middle)
        np.add.at(count, split[:, corner], 1.0)
    moved[shared] += 0.02 * (total[shared] / count[shared, None] - moved[shared])
    return moved, split, source


def opposites(triangles: Int32) -> Int32:
    """Opposite half-edge of each half-edge of a closed manifold mesh.

    Half-edge ``3 t + c`` goes from corner c of triangle t to its next corner.

    Returns
    -------
    Int32
        Shape (3 * triangle_count,).

    Raises
    ------
    ValueError
        An edge has not exactly one half-edge in each direction.
    """
    tail = triangles.ravel().astype(np.int64)
    head = np.roll(triangles, -1, axis=1).ravel().astype(np.int64)
    width = int(triangles.max()) + 1
    forward = tail * width + head
    backward = head * width + tail
    order = np.argsort(forward, kind="stable")
    position = np.searchsorted(forward[order], backward)
    position[position == len(order)] = 0
    opposite = order[position]
    unique = len(forward) < 2 or bool((np.diff(forward[order]) > 0).all())
    if not unique or not np.array_equal(forward[opposite], backward):
        raise ValueError("the mesh is not closed and manifold")
    return opposite.astype(np.int32)


def shell_volumes(vertices: Float64, triangles: Int32) -> tuple[Int32, Float64]:
    """Shell (connected part of the mesh) of each triangle, and the signed volume of each shell in mm3.

    A shell with a negative volume is a bubble in the tissue, or a cavity's inner face.
    """
    tail = triangles.ravel()
    head = np.roll(triangles, -1, axis=1).ravel()
    links = coo_array((np.ones(len(tail), np.int8), (tail, head)), shape=(len(vertices), len(vertices)))
    count, part = connected_components(links, directed=False)
    shell = part[triangles[:, 0]].astype(np.int32)
    corner = vertices[triangles] - vertices.mean(axis=0)
    six = np.einsum("ij,ij->i", corner[:, 0], np.cross(corner[:, 1], corner[:, 2]))
    volumes: Float64 = np.bincount(shell, weights=six / 6.0, minlength=count).astype(np.float64)
    return shell, volumes


def drop_small_shells(mesh: FullMesh, *, volume_mm3: float, fraction: float) -> tuple[FullMesh, Float64]:
    """Leave out specks of tissue and bubbles: shells below both a volume and a fraction of the tissue.

    Parameters
    ----------
    mesh
        The mesh.
    volume_mm3
        Shells of at least this volume stay.
    fraction
        Shells of at least this fraction of the tissue's volume stay.

    Returns
    -------
    mesh : FullMesh
        Without them, in the same order.
    volumes_mm3 : Float64
        Signed volumes of the shells left out, by place in the mesh.
    """
    shell, volumes = shell_volumes(mesh.vertices_mm, mesh.triangles)
    limit = min(volume_mm3, fraction * float(volumes.sum()))
    small = np.abs(volumes) < limit
    if not small.any():
        return mesh, volumes[small]
    triangles = mesh.triangles[~small[shell]]
    used = np.unique(triangles)
    number = np.zeros(len(mesh.vertices_mm), np.int32)
    number[used] = np.arange(len(used), dtype=np.int32)
    kept = FullMesh(mesh.vertices_mm[used], number[triangles], mesh.on_end[used], mesh.lattice, mesh.is_capped)
    return kept, volumes[small]


def smooth_creases(mesh: FullMesh, still: Bool) -> tuple[FullMesh, int]:
    """Smooth the saw teeth that marching cubes leaves along creases, and nothing else.

    Taubin's smoothing, which does not shrink (A signal processing approach to fair surface design, SIGGRAPH 1995), of
    the vertices at edges sharper than 35 degrees and their neighbours. No vertex moves by more than half a cell.

    Parameters
    ----------
    mesh
        The mesh.
    still
        Vertices that stay (those of cut faces), shape (vertex_count,).

    Returns
    -------
    mesh : FullMesh
        With moved vertices.
    moved : int
        Number of vertices that were moved.
    """
    vertices, triangles = mesh.vertices_mm, mesh.triangles
    tail, head = triangles.ravel(), np.roll(triangles, -1, axis=1).ravel()
    corner = vertices[triangles]
    normal = np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0])
    normal /= np.maximum(np.linalg.norm(normal, axis=1), 1e-30)[:, None]
    bend = (np.repeat(normal, 3, axis=0) * normal[opposites(triangles) // 3]).sum(axis=1)
    edge = np.linalg.norm(vertices[head] - vertices[tail], axis=1)
    sharp = (bend < np.cos(np.radians(CREASE_DEGREES))) & (edge > 0.2 * min(mesh.lattice.spacing_mm))
    chosen = np.zeros(len(vertices), bool)
    chosen[tail[sharp]] = True
    chosen[head[chosen[tail]]] = True
    chosen &= ~(still | mesh.on_end)
    if not chosen.any():
        return mesh, 0
    used = chosen[tail]
    number = np.cumsum(chosen) - 1
    rows = number[tail[used]]
    degree = np.bincount(rows, minlength=int(chosen.sum())).astype(np.float64)
    links = coo_array((1.0 / degree[rows], (rows, head[used])), shape=(len(degree), len(vertices))).tocsr()
    start = vertices[chosen]
    vertices = vertices.copy()
    for turn in range(2 * CREASE_ROUNDS):
        factor = 0.5 if turn % 2 == 0 else -0.53
        vertices[chosen] += factor * (links @ vertices - vertices[chosen])
    way = vertices[chosen] - start
    length = np.linalg.norm(way, axis=1)
    reach = 0.5 * min(mesh.lattice.spacing_mm)
    vertices[chosen] = start + way * np.minimum(1.0, reach / np.maximum(length, 1e-12))[:, None]
    return FullMesh(vertices, triangles, mesh.on_end, mesh.lattice, mesh.is_capped), int(chosen.sum())
