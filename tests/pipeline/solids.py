"""Solids with known surfaces, as structures: what the tests of surface, atlas, normal map and GLB are built on."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import numpy.typing as npt

from heartcase.pipeline.data import Structures
from heartcase.schemas.arrays import Float64
from heartcase.schemas.geometry import Geometry
from heartcase.schemas.labels import Label, LabelTable, Role

Distance = Callable[[Float64], Float64]

AXES = np.eye(3)
OBLIQUE = np.array([[0.8, -0.36, 0.48], [0.6, 0.48, -0.64], [0.0, 0.8, 0.6]])
LEFT_HANDED = np.diag([1.0, 1.0, -1.0])


def lattice(
    spacing: float | tuple[float, float, float],
    half_width: float,
    *,
    direction: npt.ArrayLike = AXES,
    centre: tuple[float, float, float] = (0.13, -0.31, 0.27),
) -> Geometry:
    """A lattice around a centre that reaches at least ``half_width`` mm along each of its axes."""
    steps = np.broadcast_to(np.asarray(spacing, float), 3)
    size = np.ceil(2.0 * half_width / steps).astype(int)
    matrix = np.asarray(direction, float)
    origin = np.array(centre) - matrix @ (steps * (size - 1) / 2.0)
    return Geometry.of(shape=tuple(size[::-1]), origin_mm=origin, spacing_mm=steps, direction=matrix)


def points(geometry: Geometry) -> Float64:
    """World points of a lattice, shape (z, y, x, 3)."""
    k, j, i = np.meshgrid(*[np.arange(n) for n in geometry.shape], indexing="ij")
    return geometry.index_to_world(np.stack([i, j, k], axis=-1))


def walled(cavity: Distance, wall_mm: float, geometry: Geometry, **more: object) -> Structures:
    """A cavity (label 1) with a grown wall (label 2)."""
    table = LabelTable(
        labels=(
            Label(value=1, name="cavity", role=Role.BLOOD, wall_thickness_mm=wall_mm, colour="#d04030"),
            Label(value=2, name="cavity wall", role=Role.MYOCARDIUM, wall_of=1),
        )
    )
    distance = cavity(points(geometry)).astype(np.float32)
    return Structures({0: -distance, 1: distance}, geometry, table, 20.0, **more)  # type: ignore[arg-type]


def solid(tissue: Distance, geometry: Geometry) -> Structures:
    """A body of muscle (label 1) in the background."""
    table = LabelTable(labels=(Label(value=1, name="muscle", role=Role.MYOCARDIUM),))
    distance = tissue(points(geometry)).astype(np.float32)
    return Structures({0: -distance, 1: distance}, geometry, table, 20.0)


def sphere(radius: float) -> Distance:
    return lambda p: np.linalg.norm(p, axis=-1) - radius


def torus(major: float, minor: float) -> Distance:
    return lambda p: np.hypot(np.hypot(p[..., 0], p[..., 1]) - major, p[..., 2]) - minor


def tube(radius: float) -> Distance:
    """Endless along z."""
    return lambda p: np.hypot(p[..., 0], p[..., 1]) - radius


def helix(major: float, pitch: float, minor: float) -> Distance:
    """A tube wound around z: near enough its distance where the pitch is small."""

    def distance(p: Float64) -> Float64:
        turn = np.arctan2(p[..., 1], p[..., 0]) / (2.0 * np.pi)
        height = p[..., 2] / pitch - turn
        height -= np.round(height)
        body = np.hypot(np.hypot(p[..., 0], p[..., 1]) - major, height * pitch) - minor
        return np.maximum(body, np.abs(p[..., 2]) - 2.0 * pitch)

    return distance


def bumps(p: Float64) -> Float64:
    """A sphere of 20 mm with bumps of 0.35 mm, about 4 mm apart; zero on its surface."""
    r = np.linalg.norm(p, axis=-1)
    x, y, z = np.moveaxis(p / np.maximum(r, 1e-9)[..., None], -1, 0)
    return r - 20.0 - 0.35 * np.sin(16.0 * x) * np.sin(16.0 * y + 1.0) * np.sin(16.0 * z + 2.0)


def bump_normals(p: Float64) -> Float64:
    """True normals of :func:`bumps` at points drawn along the radius to its surface."""
    unit = p / np.linalg.norm(p, axis=-1)[..., None]
    at = unit * (np.linalg.norm(p, axis=-1) - bumps(p))[..., None]
    gradient = np.stack(
        [(bumps(at + 1e-4 * e) - bumps(at - 1e-4 * e)) / 2e-4 for e in np.eye(3)],
        axis=-1,
    )
    return gradient / np.linalg.norm(gradient, axis=-1)[..., None]
