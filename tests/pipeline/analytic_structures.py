"""Structures made from analytic distance functions, for tests of grid and map."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import numpy.typing as npt
from skimage import measure

from heartcase.pipeline.data import Structures, Surface
from heartcase.pipeline.fields.reader import ownership_at_points, ownership_on_lattice
from heartcase.schemas.arrays import Float64
from heartcase.schemas.bundle.surface_kinds import SurfaceKind
from heartcase.schemas.geometry import Geometry
from heartcase.schemas.labels import Label, LabelTable, Role

Points = Float64
Distance = Callable[[Points], Points]

LEFT, RIGHT, WALL = 1, 2, 3

TABLE = LabelTable(
    labels=(
        Label(value=LEFT, name="left", role=Role.BLOOD),
        Label(value=RIGHT, name="right", role=Role.BLOOD),
        Label(value=WALL, name="wall", role=Role.WALL),
    )
)


def ball(radius: float, center: npt.ArrayLike = (0.0, 0.0, 0.0)) -> Distance:
    return lambda p: np.linalg.norm(p - np.asarray(center), axis=-1) - radius


def slab(low: float, high: float, normal: npt.ArrayLike = (0.0, 0.0, 1.0)) -> Distance:
    n = np.asarray(normal, dtype=float) / np.linalg.norm(normal)
    return lambda p: np.maximum(low - p @ n, p @ n - high)


def box(half: npt.ArrayLike, center: npt.ArrayLike = (0.0, 0.0, 0.0)) -> Distance:
    def distance(p: Points) -> Points:
        q = np.abs(p - np.asarray(center)) - np.asarray(half)
        return np.linalg.norm(np.maximum(q, 0.0), axis=-1) + np.minimum(q.max(axis=-1), 0.0)

    return distance


def cylinder(radius: float, axis: npt.ArrayLike, center: npt.ArrayLike = (0.0, 0.0, 0.0)) -> Distance:
    n = np.asarray(axis, dtype=float) / np.linalg.norm(axis)

    def distance(p: Points) -> Points:
        q = p - np.asarray(center)
        return np.linalg.norm(q - (q @ n)[..., None] * n, axis=-1) - radius

    return distance


def torus(major: float, minor: float) -> Distance:
    return lambda p: np.hypot(np.hypot(p[..., 0], p[..., 1]) - major, p[..., 2]) - minor


def union(*shapes: Distance) -> Distance:
    return lambda p: np.minimum.reduce([shape(p) for shape in shapes])


def common(*shapes: Distance) -> Distance:
    return lambda p: np.maximum.reduce([shape(p) for shape in shapes])


def without(shape: Distance, hole: Distance) -> Distance:
    return lambda p: np.maximum(shape(p), -hole(p))


def lattice(
    half_mm: float,
    spacing: npt.ArrayLike = (1.0, 1.0, 1.0),
    *,
    direction: npt.ArrayLike | None = None,
    shift: npt.ArrayLike = (0.0, 0.0, 0.0),
) -> Geometry:
    """A lattice centred on the origin (moved by ``shift`` mm), at least ``half_mm`` wide to every side."""
    spacing = np.asarray(spacing, dtype=float)
    matrix = np.eye(3) if direction is None else np.asarray(direction, dtype=float)
    size = np.ceil(2.0 * half_mm / spacing).astype(int) + 1
    origin = np.asarray(shift) - matrix @ (spacing * (size - 1) / 2.0)
    return Geometry.of(shape=tuple(size[::-1]), origin_mm=origin, spacing_mm=spacing, direction=matrix)


def structures(shapes: dict[int, Distance], geometry: Geometry, table: LabelTable = TABLE) -> Structures:
    """Fields of the shapes, which must not overlap.

    The background (label 0) is what is left, unless it is given: where two shapes touch it must be.
    """
    k, j, i = np.indices(geometry.shape)
    points = geometry.index_to_world(np.stack((i, j, k), axis=-1))
    fields = {value: shape(points).astype(np.float32) for value, shape in shapes.items()}
    if 0 not in fields:
        fields[0] = -np.minimum.reduce(list(fields.values()))
    return Structures(fields, geometry, table, band_mm=1e3)


def rotation(axis: npt.ArrayLike, degrees: float) -> Points:
    x, y, z = np.asarray(axis, dtype=float) / np.linalg.norm(axis)
    angle = np.radians(degrees)
    cross = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    return np.eye(3) + np.sin(angle) * cross + (1.0 - np.cos(angle)) * cross @ cross


def surface_of(made: Structures) -> Surface:
    """Marching cubes of the tissue field with the labels of the voids beside it, without atlas."""
    owner = ownership_on_lattice(made, made.geometry)
    # A field that is exactly zero at a voxel makes triangles without area.
    tissue = np.where(np.abs(owner.tissue_mm) < 1e-3, np.float32(1e-3), owner.tissue_mm)
    corners, triangles, _, _ = measure.marching_cubes(np.pad(tissue, 1, constant_values=1.0), 0.0)
    vertices = made.geometry.index_to_world(corners[:, ::-1] - 1.0)
    points = vertices[triangles]
    normal = np.cross(points[:, 1] - points[:, 0], points[:, 2] - points[:, 0])
    if np.einsum("tx,tx->", points[:, 0], normal) < 0.0:
        triangles, normal = triangles[:, ::-1], -normal
    normals = np.zeros_like(vertices)
    for corner in range(3):
        np.add.at(normals, triangles[:, corner], normal)
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    # On the border itself two voids may be equally near.
    label = ownership_at_points(made, vertices + 0.02 * normals).void_label
    triangles = np.ascontiguousarray(triangles, dtype=np.int32)
    return Surface(
        vertices_mm=vertices.astype(np.float32),
        triangles=triangles,
        triangle_label=label[triangles].min(axis=1),
        triangle_tissue=np.full(len(triangles), WALL, np.uint8),
        triangle_is_cut=np.zeros(len(triangles), np.uint8),
        triangle_kind=np.full(len(triangles), SurfaceKind.ENDOCARDIUM, np.uint8),
        normals=normals.astype(np.float32),
        vertex_label=label,
        table=made.table,
        render_to_welded=np.zeros(0, np.int32),
        render_triangles=np.zeros((0, 3), np.int32),
        render_uv=np.zeros((0, 2), np.float32),
        render_tangents=np.zeros((0, 4), np.float32),
        normal_map=np.zeros((0, 0, 3), np.uint8),
    )
