"""The tissue's border at full resolution: marching cubes on a refined lattice, closed where the volume ends.

Marching cubes as published places a vertex on a lattice edge by linear interpolation, which is wrong where the tissue
field has a kink between the two ends (in the middle of a thin wall, or of a narrow gap). So each vertex slides along
its own edge to the field's root: it is then exact, and can neither leave its cell nor turn a triangle over.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.sparse import coo_array

from heartcase.compiling.kernel import kernel
from heartcase.pipeline.data import Structures
from heartcase.pipeline.fields.reader import FieldReader
from heartcase.pipeline.mesh.extraction.marching_cubes import padded_field, triangulated_border
from heartcase.pipeline.mesh.triangles.half_edges import connected_parts, opposites, opposites_of_some
from heartcase.schemas.arrays import Bool, Float64, Int32, UInt8
from heartcase.schemas.errors import StageError
from heartcase.schemas.geometry import Geometry

__all__ = [
    "FullMesh",
    "drop_small_shells",
    "enclosed_volume_mm3",
    "extract",
    "extraction_lattice",
    "shell_volumes",
    "smooth_creases",
]


SPACING_PER_LAYER = 0.45
"""Over the thinnest wall: two cells across it, and a bit."""
MOST_PER_LAYER = 0.6
"""Up to this the voxels' own lattice is taken: at its points, what was apart in the labels is kept apart."""
POINT_CAP = 40_000_000
CREASE_DEGREES = 35.0
CREASE_ROUNDS = 5


@dataclass(frozen=True)
class FullMesh:
    """The full-resolution surface."""

    vertices_mm: Float64
    """World mm, shape (vertex_count, 3)."""
    triangles: Int32
    """Counter-clockwise from outside the tissue, shape (triangle_count, 3)."""
    void_label: UInt8
    """Label of the void beside each vertex, shape (vertex_count,)."""
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
        The voxels' own where none of their edges is above 1.5 of the smallest, or above 0.6 of the thinnest wall or
        patch. Otherwise at most 1.5 of the smallest edge, 0.45 of the wall and the voxel's own, unless the cap
        forbids it.
    is_capped : bool
        Whether it does.
    """
    geometry = structures.geometry
    spacing = np.array(geometry.spacing_mm)
    wall = structures.thinnest_layer_mm
    target = 1.5 * spacing.min()
    if wall is not None and spacing.max() > min(target, MOST_PER_LAYER * wall):
        target = min(target, SPACING_PER_LAYER * wall)
    extent = np.array(geometry.size) * spacing
    counts = np.maximum(np.ceil(extent / target - 1e-9).astype(np.int64), geometry.size)
    is_capped = bool(np.prod(counts) > point_cap)
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


def extract(structures: Structures | FieldReader, *, point_cap: int = POINT_CAP) -> FullMesh:
    """Extract the closed border of the tissue.

    Marching cubes with the cases of :mod:`heartcase.pipeline.mesh.extraction.marching_cubes_cases`, so that
    the mesh is closed and manifold; vertices slide along their lattice edges to the root of the tissue field.

    Parameters
    ----------
    structures
        The fields, or their reader.
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
    reader = FieldReader.of(structures)
    lattice, is_capped = extraction_lattice(reader.structures, point_cap=point_cap)
    index, void_label, triangles = triangulated_border(reader, lattice, padded_field(reader, lattice))
    if not len(triangles):
        raise StageError("there is no tissue to show: check the markers and wall thicknesses", place="surface")
    if not lattice.is_right_handed:
        triangles = np.ascontiguousarray(triangles[:, ::-1])
    on_end = np.asarray(((index < -0.25) | (index > np.array(lattice.size) - 0.75)).any(axis=1))
    return FullMesh(lattice.index_to_world(index), triangles, void_label, on_end, lattice, is_capped)


def shell_volumes(vertices: Float64, triangles: Int32, *, opposite: Int32 | None = None) -> tuple[Int32, Float64]:
    """Shell (connected part of the mesh) of each triangle, and the signed volume of each shell in mm3.

    A shell with a negative volume is a bubble in the tissue, or a cavity's inner face.
    """
    beside = opposites(triangles) if opposite is None else opposite
    shell, sizes = connected_parts(np.zeros(len(triangles), np.int64), beside)
    volumes = _volumes(vertices, triangles, vertices.mean(axis=0), shell, len(sizes))
    return shell, volumes


def enclosed_volume_mm3(vertices: Float64, triangles: Int32) -> float:
    """Signed volume that a closed mesh encloses, mm3: bubbles count against it."""
    whole = np.zeros(len(triangles), np.int32)
    return float(_volumes(vertices, triangles, vertices.mean(axis=0), whole, 1)[0])


@kernel
def _volumes(vertices, triangles, middle, shell, count):
    """Signed volume of each shell."""
    six = np.zeros(count)
    x, y, z = middle
    for t in range(len(triangles)):
        a, b, c = triangles[t, 0], triangles[t, 1], triangles[t, 2]
        ax, ay, az = vertices[a, 0] - x, vertices[a, 1] - y, vertices[a, 2] - z
        bx, by, bz = vertices[b, 0] - x, vertices[b, 1] - y, vertices[b, 2] - z
        cx, cy, cz = vertices[c, 0] - x, vertices[c, 1] - y, vertices[c, 2] - z
        six[shell[t]] += ax * (by * cz - bz * cy) + ay * (bz * cx - bx * cz) + az * (bx * cy - by * cx)
    return six / 6.0


def drop_small_shells(
    mesh: FullMesh, *, volume_mm3: float, fraction: float, opposite: Int32
) -> tuple[FullMesh, Float64, Int32]:
    """Leave out specks of tissue and bubbles: shells below both a volume and a fraction of the tissue.

    Parameters
    ----------
    mesh
        The mesh.
    volume_mm3
        Shells of at least this volume stay.
    fraction
        Shells of at least this fraction of the tissue's volume stay.
    opposite
        Opposite half-edges.

    Returns
    -------
    mesh : FullMesh
        Without them, in the same order; the same mesh where there are none.
    volumes_mm3 : Float64
        Signed volumes of the shells left out, by place in the mesh.
    opposite : Int32
        Opposite half-edges of what is left.
    """
    shell, volumes = shell_volumes(mesh.vertices_mm, mesh.triangles, opposite=opposite)
    limit = min(volume_mm3, fraction * float(volumes.sum()))
    small = np.abs(volumes) < limit
    if not small.any():
        return mesh, volumes[small], opposite
    stays = ~small[shell]
    triangles = mesh.triangles[stays]
    used = np.zeros(len(mesh.vertices_mm), np.bool_)
    used[triangles] = True
    number = np.cumsum(used, dtype=np.int32) - np.int32(1)
    kept = replace(
        mesh,
        vertices_mm=mesh.vertices_mm[used],
        triangles=number[triangles],
        void_label=mesh.void_label[used],
        on_end=mesh.on_end[used],
    )
    return kept, volumes[small], opposites_of_some(opposite, stays)


def smooth_creases(mesh: FullMesh, still: Bool, *, opposite: Int32 | None = None) -> tuple[FullMesh, int]:
    """Smooth the saw teeth that marching cubes leaves along creases, and nothing else.

    Taubin's smoothing, which does not shrink (A signal processing approach to fair surface design, SIGGRAPH 1995), of
    the vertices at edges sharper than 35 degrees and their neighbours. No vertex moves by more than half a cell.

    Parameters
    ----------
    mesh
        The mesh.
    still
        Vertices that stay (those of cut faces), shape (vertex_count,).
    opposite
        Opposite half-edges, where they are at hand.

    Returns
    -------
    mesh : FullMesh
        With moved vertices.
    moved : int
        Number of vertices that were moved.
    """
    vertices, triangles = mesh.vertices_mm, mesh.triangles
    tail, head = triangles.ravel(), np.roll(triangles, -1, axis=1).ravel()
    beside = opposites(triangles) if opposite is None else opposite
    chosen = _at_creases(
        vertices, triangles, beside, float(np.cos(np.radians(CREASE_DEGREES))), 0.2 * min(mesh.lattice.spacing_mm)
    )
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
    return replace(mesh, vertices_mm=vertices), int(chosen.sum())


@kernel
def _at_creases(vertices, triangles, opposite, cosine, least):
    """Vertices at an edge of at least a length whose triangles' normals are further apart than a cosine says."""
    normal = np.empty((len(triangles), 3))
    for t in range(len(triangles)):
        a, b, c = vertices[triangles[t, 0]], vertices[triangles[t, 1]], vertices[triangles[t, 2]]
        x = (b[1] - a[1]) * (c[2] - a[2]) - (b[2] - a[2]) * (c[1] - a[1])
        y = (b[2] - a[2]) * (c[0] - a[0]) - (b[0] - a[0]) * (c[2] - a[2])
        z = (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0])
        length = max(np.sqrt(x * x + y * y + z * z), 1e-30)
        normal[t, 0], normal[t, 1], normal[t, 2] = x / length, y / length, z / length
    found = np.zeros(len(vertices), np.bool_)
    for t in range(len(triangles)):
        for k in range(3):
            o = opposite[3 * t + k] // 3
            if normal[t, 0] * normal[o, 0] + normal[t, 1] * normal[o, 1] + normal[t, 2] * normal[o, 2] >= cosine:
                continue
            u, v = triangles[t, k], triangles[t, (k + 1) % 3]
            x, y, z = vertices[v, 0] - vertices[u, 0], vertices[v, 1] - vertices[u, 1], vertices[v, 2] - vertices[u, 2]
            if x * x + y * y + z * z > least * least:
                found[u] = True
    return found
