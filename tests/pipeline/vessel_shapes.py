"""Labelled vessels of known centreline and radius, for the tests of their ends."""

from __future__ import annotations

import itertools

import numpy as np
from scipy.spatial import cKDTree

from heartcase.pipeline.data import Segmentation
from heartcase.pipeline.vessel_ends.discs import Stumps
from heartcase.schemas.geometry import Geometry
from heartcase.schemas.labels import Label, LabelTable, Role
from tests.pipeline.lattices import points_of

WALL_MM = 1.5
TABLE = LabelTable(
    labels=(
        Label(value=1, name="right atrium", role=Role.BLOOD, wall_thickness_mm=WALL_MM),
        Label(value=2, name="superior vena cava", role=Role.VESSEL_LUMEN, wall_thickness_mm=WALL_MM),
        Label(value=3, name="left atrium", role=Role.BLOOD, wall_thickness_mm=WALL_MM),
        Label(value=4, name="left ventricle", role=Role.BLOOD, wall_thickness_mm=WALL_MM),
        Label(value=5, name="aorta", role=Role.VESSEL_LUMEN, wall_thickness_mm=WALL_MM),
    )
)
STUMPS = Stumps(WALL_MM + 6.0, {})


def line(*points: tuple[float, float, float], step_mm: float = 0.25) -> np.ndarray:
    """Points of a polyline, shape (n, 3), mm."""
    corners = np.array(points, dtype=float)
    parts = []
    for one, other in itertools.pairwise(corners):
        count = max(2, int(np.ceil(np.linalg.norm(other - one) / step_mm)))
        parts.append(one + np.linspace(0.0, 1.0, count)[:, None] * (other - one))
    return np.concatenate(parts)


def arc(radius_mm: float, degrees: float, side: np.ndarray, axis: np.ndarray) -> np.ndarray:
    """Points of an arc that begins at the origin along ``axis`` and bends to ``side``."""
    angle = np.radians(np.linspace(0.0, degrees, int(degrees) * 2))[:, None]
    return radius_mm * (np.sin(angle) * axis + (1.0 - np.cos(angle)) * side)


def tube(geometry: Geometry, points: np.ndarray, radius_mm: float, *, is_round: bool = False) -> np.ndarray:
    """Mask of a tube around a line; its far end is flat where it is not round."""
    where = points_of(geometry)
    inside = (cKDTree(points).query(where.reshape(-1, 3))[0] <= radius_mm).reshape(geometry.shape)
    if not is_round:
        out = points[-1] - points[-2]
        inside &= ~(((where - points[-1]) @ out > 0.0) & (np.linalg.norm(where - points[-1], axis=-1) < 2 * radius_mm))
    return inside


def ball(geometry: Geometry, middle, radius_mm: float) -> np.ndarray:
    """Mask of a ball."""
    return np.linalg.norm(points_of(geometry) - np.array(middle), axis=-1) <= radius_mm


def segmented(geometry: Geometry, *parts: tuple[int, np.ndarray]) -> Segmentation:
    """Labels from masks; earlier ones go before later ones."""
    labels = np.zeros(geometry.shape, np.uint8)
    for value, mask in parts:
        labels[mask & (labels == 0)] = value
    return Segmentation(labels, geometry, TABLE)
