"""Sheets that are spanned by a closed outline in space, and laid out flat.

The sheet is the one of least area over the outline (Pinkall and Polthier, Exp. Math. 2, 1993: solve for the inner
vertices with cotangent weights, again and again). It is laid out flat as rigidly as possible (Liu et al., Comput.
Graph. Forum 27, 2008): each triangle is turned to fit best, then the vertices are fitted to the turned triangles. What
that stretches is stated, for no sheet that is curved both ways lies flat without.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from heartcase.schemas.arrays import Float64, Int32
from heartcase.schemas.errors import SimulationError
from heartcase.simulator.patching.triangulation import crosses_itself, signed_area, triangulated

__all__ = ["FlatSheet", "flat_sheet", "resampled"]

_SPAN_ROUNDS = 8
_FLATTEN_ROUNDS = 200
_COTANGENT_LEAST = 0.05
"""Lower bound of weights, so that no triangle turns over."""
_LAYOUT_ROUNDS = 20
"""Times at most that the sheet of a winding outline is triangulated, each time as it was laid out flat before."""
_SIZE_SETTLED = 2e-3
"""Change of its area from one to the next, over the area, at which that is done."""
_APART_LEAST = 0.5
"""Over the distance between stitches: how near to itself a winding outline may come."""
_SETTLED = 1e-10
"""Movement over size at which the layout is done."""


@dataclass(frozen=True)
class FlatSheet:
    """A sheet that was cut to an outline: flat, and as it spans the outline in space; the rim's vertices come first."""

    flat_mm: Float64
    """Vertices laid out flat, mm, shape (vertex_count, 2)."""
    spanned_mm: Float64
    """Vertices where the sheet spans the outline, LPS mm, shape (vertex_count, 3)."""
    triangles: Int32
    """Counter-clockwise in the plane, shape (triangle_count, 3)."""
    rim_count: int
    """Vertices of the rim, in order."""
    stretch_least: float
    """Smallest principal stretch of any triangle from flat to spanned, at scale 1."""
    stretch_most: float
    """Largest."""
    scale: float = 1.0
    """Size of what is cut over that of the outline laid out flat."""

    @property
    def outline_mm(self) -> Float64:
        """The rim laid out flat, mm, shape (rim_count, 2)."""
        return self.flat_mm[: self.rim_count]

    @property
    def area_mm2(self) -> float:
        """Area of the sheet laid out flat, mm2."""
        return abs(signed_area(self.outline_mm))

    @property
    def perimeter_mm(self) -> float:
        """Length of its rim laid out flat, mm."""
        way = np.roll(self.outline_mm, -1, axis=0) - self.outline_mm
        return float(np.linalg.norm(way, axis=1).sum())


def resampled(outline_mm: npt.ArrayLike, spacing_mm: float) -> Float64:
    """Points at even distances, about the spacing, along a closed outline, at least six, shape (count, 3)."""
    points = np.asarray(outline_mm, dtype=np.float64)
    closed = np.concatenate([points, points[:1]])
    way = np.linalg.norm(np.diff(closed, axis=0), axis=1)
    at = np.concatenate([[0.0], np.cumsum(way)])
    count = max(round(at[-1] / spacing_mm), 6)
    wanted = np.arange(count) / count * at[-1]
    return np.stack([np.interp(wanted, at, column) for column in closed.T], axis=1)


def flat_sheet(rim_mm: npt.ArrayLike, *, scale: float = 1.0, name: str = "patch") -> FlatSheet:
    """Cut a sheet to an outline.

    Parameters
    ----------
    rim_mm
        Points of the outline, closed from the last to the first, shape (count, 3).
    scale
        Size of what is cut over that of the outline laid out flat.
    name
        Name in messages.

    Raises
    ------
    SimulationError
        The outline comes too near to itself, has no area, or is too narrow for its points; or its sheet cannot be laid
        out flat.
    """
    rim = np.asarray(rim_mm, dtype=np.float64)
    ways = np.linalg.norm(np.roll(rim, -1, axis=0) - rim, axis=1)
    spacing = float(ways.mean())
    plane = _seen_along_normal(rim, name)
    is_seen_simple = not crosses_itself(plane)
    if ways.min() < 0.05 * spacing or (not is_seen_simple and _nearest_to_itself(rim) < _APART_LEAST * spacing):
        raise SimulationError(
            "the outline crosses itself, or two of its stitches are in one place: draw a simple loop", place=name
        )
    if not is_seen_simple:
        # An outline that winds, such as a baffle's: a disc of as many points to begin with, then its own layout.
        plane = _disc(ways)
    size = np.inf
    for _ in range(1 if is_seen_simple else _LAYOUT_ROUNDS):
        start, triangles = triangulated(plane, spacing, name=name)
        spanned = _spanned(rim, start, triangles)
        flat = _laid_out(start, spanned, triangles)
        plane, before, size = flat[: len(rim)], size, abs(signed_area(flat[: len(rim)]))
        if crosses_itself(plane) or abs(size - before) < _SIZE_SETTLED * size:
            break
    stretches = _stretches(flat, spanned, triangles)
    if crosses_itself(plane) or not (stretches > 0).all():
        raise SimulationError("the sheet over this outline cannot be laid out flat: draw a flatter loop", place=name)
    flat = scale * (flat - flat.mean(axis=0))
    return FlatSheet(flat, spanned, triangles, len(rim), float(stretches.min()), float(stretches.max()), scale)


def _seen_along_normal(rim: Float64, name: str) -> Float64:
    """The outline seen along its mean normal, counter-clockwise, shape (count, 2)."""
    arms = rim - rim.mean(axis=0)
    normal = 0.5 * np.cross(arms, np.roll(arms, -1, axis=0)).sum(axis=0)
    area = float(np.linalg.norm(normal))
    if not area > 1e-6 * float((arms**2).sum()) / len(rim):
        raise SimulationError("the outline encloses no area: draw a loop", place=name)
    normal /= area
    across = np.eye(3)[np.abs(normal).argmin()]
    u = np.cross(across, normal)
    u /= np.linalg.norm(u)
    return np.stack([arms @ u, arms @ np.cross(normal, u)], axis=1)


def _disc(ways: Float64) -> Float64:
    """Points on a circle, as far apart along it as those of an outline, shape (count, 2)."""
    length = ways.sum()
    angle = 2.0 * np.pi * np.concatenate([[0.0], np.cumsum(ways)[:-1]]) / length
    disc: Float64 = length / (2.0 * np.pi) * np.stack([np.cos(angle), np.sin(angle)], axis=1)
    return disc


def _nearest_to_itself(rim: Float64) -> float:
    """Least distance, to an eighth of a side, between two sides of an outline that have no corner in common."""
    count = len(rim)
    way = np.roll(rim, -1, axis=0) - rim
    places = rim[:, None] + np.linspace(0.0, 1.0, 9)[:, None] * way[:, None]
    arm = places[None] - rim[:, None, None]
    along = np.einsum("sopx,sx->sop", arm, way) / (way**2).sum(axis=1)[:, None, None]
    away = np.linalg.norm(arm - np.clip(along, 0.0, 1.0)[..., None] * way[:, None, None], axis=3).min(axis=2)
    apart = np.abs(np.arange(count)[:, None] - np.arange(count))
    is_apart = (apart > 1) & (apart < count - 1)
    return float(away[is_apart].min())


def _cotangents(vertices: Float64, triangles: Int32) -> Float64:
    """Cotangent of the angle at each corner of each triangle, shape (triangle_count, 3)."""
    corners = vertices[triangles]
    result = np.empty(triangles.shape)
    for corner in range(3):
        a = corners[:, (corner + 1) % 3] - corners[:, corner]
        b = corners[:, (corner + 2) % 3] - corners[:, corner]
        dot = (a * b).sum(axis=1)
        double_area = np.sqrt(np.maximum((a**2).sum(axis=1) * (b**2).sum(axis=1) - dot**2, 1e-300))
        result[:, corner] = dot / double_area
    bounded: Float64 = np.maximum(result, _COTANGENT_LEAST)
    return bounded


def _laplacian(cotangents: Float64, triangles: Int32, count: int) -> Float64:
    """Matrix of the weights of all edges, shape (count, count)."""
    matrix = np.zeros((count, count))
    for corner in range(3):
        a, b = triangles[:, (corner + 1) % 3], triangles[:, (corner + 2) % 3]
        half = 0.5 * cotangents[:, corner]
        np.add.at(matrix, (a, b), -half)
        np.add.at(matrix, (b, a), -half)
        np.add.at(matrix, (a, a), half)
        np.add.at(matrix, (b, b), half)
    return matrix


def _spanned(rim: Float64, start: Float64, triangles: Int32) -> Float64:
    """The sheet of least area over an outline, from a layout in the plane to begin with, shape (vertex_count, 3)."""
    count, inner = len(start), slice(len(rim), None)
    spanned = np.zeros((count, 3))
    spanned[: len(rim)] = rim
    shape = start
    for _ in range(_SPAN_ROUNDS if count > len(rim) else 0):
        matrix = _laplacian(_cotangents(shape, triangles), triangles, count)
        spanned[inner] = np.linalg.solve(matrix[inner, inner], -matrix[inner, : len(rim)] @ rim)
        shape = spanned
    return spanned


def _in_own_plane(spanned: Float64, triangles: Int32) -> Float64:
    """Corners of each triangle in its own plane, counter-clockwise, shape (triangle_count, 3, 2)."""
    corners = spanned[triangles]
    first, second = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    length = np.linalg.norm(first, axis=1)
    along = first / length[:, None]
    x = (second * along).sum(axis=1)
    y = np.linalg.norm(second - x[:, None] * along, axis=1)
    zero = np.zeros_like(x)
    own: Float64 = np.stack([zero, zero, length, zero, x, y], axis=1).reshape(-1, 3, 2)
    return own


def _laid_out(start: Float64, spanned: Float64, triangles: Int32) -> Float64:
    """The sheet laid out flat, from a layout to begin with, shape (vertex_count, 2)."""
    own = _in_own_plane(spanned, triangles)
    cotangents = _cotangents(spanned, triangles)
    matrix = _laplacian(cotangents, triangles, len(start))
    # One vertex is held where it is: the layout can lie anywhere.
    inverse = np.linalg.inv(matrix[1:, 1:])
    flat: Float64 = start - start[0]
    size = np.ptp(start, axis=0).max()
    for _ in range(_FLATTEN_ROUNDS):
        corners = flat[triangles]
        spread = np.zeros((len(triangles), 2, 2))
        for corner in range(3):
            a, b = (corner + 1) % 3, (corner + 2) % 3
            spread += cotangents[:, corner, None, None] * np.einsum(
                "tx,ty->txy", corners[:, a] - corners[:, b], own[:, a] - own[:, b]
            )
        # The nearest rotation of the plane to each of these.
        cosine, sine = spread[:, 0, 0] + spread[:, 1, 1], spread[:, 1, 0] - spread[:, 0, 1]
        length = np.maximum(np.hypot(cosine, sine), 1e-300)
        cosine, sine = cosine / length, sine / length
        turn = np.stack([cosine, -sine, sine, cosine], axis=1).reshape(-1, 2, 2)
        right = np.zeros_like(flat)
        for corner in range(3):
            a, b = (corner + 1) % 3, (corner + 2) % 3
            way = 0.5 * cotangents[:, corner, None] * np.einsum("txy,ty->tx", turn, own[:, a] - own[:, b])
            np.add.at(right, triangles[:, a], way)
            np.subtract.at(right, triangles[:, b], way)
        later = np.zeros_like(flat)
        later[1:] = inverse @ right[1:]
        moved, flat = np.abs(later - flat).max(), later
        if moved <= _SETTLED * size:
            break
    return flat


def _stretches(flat: Float64, spanned: Float64, triangles: Int32) -> Float64:
    """Principal stretches of each triangle from flat to spanned, 0 where it is turned over, shape (count, 2)."""
    own, corners = _in_own_plane(spanned, triangles), flat[triangles]
    before = np.stack([corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]], axis=2)
    after = np.stack([own[:, 1] - own[:, 0], own[:, 2] - own[:, 0]], axis=2)
    area = np.linalg.det(before)
    whole = area > 1e-12 * (before**2).sum(axis=(1, 2))
    stretches = np.zeros((len(triangles), 2))
    stretches[whole] = np.linalg.svd(after[whole] @ np.linalg.inv(before[whole]), compute_uv=False)
    return stretches
