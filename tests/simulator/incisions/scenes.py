"""Surfaces whose visibility and freedom are formulas."""

from __future__ import annotations

import numpy as np

AROUND = 256


def circle(radius: float, z: float = 0.0, count: int = AROUND) -> np.ndarray:
    """Points on a circle around the z axis."""
    angle = 2 * np.pi * np.arange(count) / count
    return np.stack([radius * np.cos(angle), radius * np.sin(angle), np.full(count, z)], axis=1)


def plate(hole: float, *, z: float = 0.0, outer: float = 500.0) -> tuple[np.ndarray, np.ndarray]:
    """A plate with a round hole: vertices and triangles."""
    inner, rim = circle(hole, z), circle(outer, z)
    here = np.arange(AROUND)
    after = (here + 1) % AROUND
    triangles = np.concatenate(
        [np.stack([here, here + AROUND, after], axis=1), np.stack([after, here + AROUND, after + AROUND], axis=1)]
    )
    return np.concatenate([inner, rim]), triangles


def cone_sr(half_angle: float) -> float:
    """Solid angle of a cone, half angle in rad."""
    return 2 * np.pi * (1 - np.cos(half_angle))


def random_mesh(seed: int, count: int = 200) -> tuple[np.ndarray, np.ndarray]:
    """Triangles at random, also large ones and such without an area."""
    rng = np.random.default_rng(seed)
    corners = rng.uniform(-10, 10, (count, 1, 3)) + rng.normal(size=(count, 3, 3)) * rng.choice(
        [0.3, 2.0, 8.0], (count, 1, 1)
    )
    corners[::40, 2] = corners[::40, 1]
    return corners.reshape(-1, 3), np.arange(3 * count).reshape(-1, 3)
