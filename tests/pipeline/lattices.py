"""Lattices of every kind, and points on them, for the tests of distances, walls and edits."""

import numpy as np

from heartcase.schemas.geometry import Geometry


def _rotation() -> np.ndarray:
    q, _ = np.linalg.qr(np.array([[2.0, 0.3, -0.4], [0.5, 1.7, 0.6], [-0.2, 0.4, 1.9]]))
    return q * np.sign(np.linalg.det(q))


LATTICES = {
    "even": ((1.75, 1.75, 1.75), np.eye(3)),
    "flat": ((1.0, 1.0, 3.0), np.eye(3)),
    "oblique": ((1.4, 1.75, 2.0), _rotation()),
    "left-handed": ((1.5, 1.5, 2.0), _rotation() * np.array([1.0, 1.0, -1.0])),
}
"""Name -> spacing (i, j, k) and direction."""


def lattice(kind: str, extent_mm: float) -> Geometry:
    """A lattice of a kind around the world's origin, about ``extent_mm`` along each axis, off centre."""
    spacing, direction = LATTICES[kind]
    size = np.ceil(extent_mm / np.array(spacing)).astype(int)
    centre = direction @ (0.5 * (size - 1) * np.array(spacing))
    return Geometry.of(
        shape=tuple(size[::-1]),
        origin_mm=np.array([0.31, -0.47, 0.22]) - centre,
        spacing_mm=spacing,
        direction=direction,
    )


def points_of(geometry: Geometry) -> np.ndarray:
    """World position of every voxel, shape (z, y, x, 3)."""
    k, j, i = np.meshgrid(*(np.arange(n) for n in geometry.shape), indexing="ij")
    return geometry.index_to_world(np.stack([i, j, k], axis=-1))


def directions(count: int, *, seed: int = 1) -> np.ndarray:
    """Unit vectors all around, shape (count, 3)."""
    vectors = np.random.default_rng(seed).normal(size=(count, 3))
    return vectors / np.linalg.norm(vectors, axis=1)[:, None]
