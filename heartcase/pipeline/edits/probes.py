"""Sample points inside the shape of an edit, on a lattice that is fine against the shape and the voxels."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass

import cc3d
import numpy as np

from heartcase.pipeline.data import Reshaping, Structures
from heartcase.pipeline.fields.reader import ownership_at_points
from heartcase.pipeline.fields.shapes import frame_of, section_distance
from heartcase.schemas.arrays import Bool, Float64

__all__ = ["Found", "joins_cavities", "look", "overlap"]


PROBES_ACROSS = 24
"""Points across a canal at which it is asked what it meets."""
PROBE_STEP_MM = 0.25
"""Distance of those points along it."""
MOST_PROBES_ALONG = 400


@dataclass(frozen=True)
class Found:
    """What lies inside a shape."""

    labels: frozenset[int]
    """Labels of the points."""
    is_inside_volume: bool
    """Whether any point lies within the volume."""


def look(structures: Structures, one: Reshaping) -> Found:
    """Who owns the points inside a shape; what it takes from whom does not matter."""
    probes = _probes(one)
    index = structures.geometry.world_to_index(probes)
    size = np.array(structures.geometry.size)
    inside = np.all((index >= -0.5) & (index <= size - 0.5), axis=1)
    if not inside.any():
        return Found(frozenset(), False)
    owner = ownership_at_points(structures, probes[inside])
    labels = np.where(owner.tissue_mm < 0.0, owner.tissue_label, owner.void_label)
    return Found(frozenset(int(value) for value in np.unique(labels)), True)


def joins_cavities(structures: Structures, one: Reshaping, cavities: Sequence[int]) -> bool:
    """Whether one piece of the blood inside a canal belongs to two cavities."""
    probes, in_section = _canal_lattice(one)
    owner = ownership_at_points(structures, probes.reshape(-1, 3))
    label = np.where(owner.tissue_mm < 0.0, owner.tissue_label, owner.void_label).reshape(probes.shape[:3])
    pieces = cc3d.connected_components(np.isin(label, cavities) & in_section, connectivity=6)
    met = np.unique(np.stack([pieces[pieces > 0], label[pieces > 0]]), axis=1)
    return bool(np.bincount(met[0].astype(np.int64), minlength=1).max() > 1)


def overlap(one: Reshaping, other: Reshaping) -> bool:
    """Whether a point of one shape lies in the other."""
    return bool(_inside(other, _probes(one)).any() or _inside(one, _probes(other)).any())


def _probes(one: Reshaping) -> Float64:
    if one.shape == "strokes":
        return _probes_in_strokes(np.array(one.points_mm), one.radius_mm)
    probes, in_section = _canal_lattice(one)
    inside: Float64 = probes[:, in_section].reshape(-1, 3)
    return inside


def _inside(one: Reshaping, points: Float64) -> Bool:
    if one.shape == "strokes":
        line = np.array(one.points_mm)
        away = np.full(len(points), np.inf)
        for first, last in itertools.pairwise(line if len(line) > 1 else np.repeat(line, 2, axis=0)):
            way = last - first
            t = np.clip((points - first) @ way / max(float(way @ way), 1e-12), 0.0, 1.0)
            away = np.minimum(away, np.linalg.norm(points - first - t[:, None] * way, axis=1))
        return away < one.radius_mm
    unit, side, up, *_ = frame_of(one)
    low, high = np.array(one.points_mm[0]), np.array(one.points_mm[1])
    gap = points - 0.5 * (low + high)
    inside: Bool = np.abs(gap @ unit) < 0.5 * np.linalg.norm(high - low)
    return inside & (section_distance(one, gap @ side, gap @ up) < 0.0)


def _canal_lattice(one: Reshaping) -> tuple[Float64, Bool]:
    """Points in rows along a canal and across its sections, shape (n, m, m, 3), and which are in the section."""
    ends = np.array(one.points_mm[:2])
    length = float(np.linalg.norm(ends[1] - ends[0]))
    unit, side, up, long, short = frame_of(one)
    across = (np.arange(PROBES_ACROSS) + 0.5) / PROBES_ACROSS * 2.0 - 1.0
    u, v = np.meshgrid(across * long, across * short)
    flat = u[..., None] * side + v[..., None] * up
    count = int(np.clip(np.ceil(length / PROBE_STEP_MM), PROBES_ACROSS, MOST_PROBES_ALONG))
    along = (np.arange(count) + 0.5) * (length / count)
    probes: Float64 = ends[0] + along[:, None, None, None] * unit + flat
    return probes, section_distance(one, u, v) <= 0.0


def _probes_in_strokes(line: Float64, radius_mm: float) -> Float64:
    step = 0.5 * radius_mm
    pieces = [line[:1]]
    for first, last in itertools.pairwise(line):
        count = max(1, int(np.ceil(np.linalg.norm(last - first) / step)))
        pieces.append(first + np.linspace(0.0, 1.0, count + 1)[1:, None] * (last - first))
    middles = np.concatenate(pieces)
    across = (np.arange(9) - 4.0) / 4.0
    ball = np.stack(np.meshgrid(across, across, across, indexing="ij"), axis=-1).reshape(-1, 3)
    ball = radius_mm * ball[np.linalg.norm(ball, axis=1) <= 1.0]
    probes: Float64 = (middles[:, None] + ball).reshape(-1, 3)
    return probes
