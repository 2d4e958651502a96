"""Triangles of a closed outline in the plane: Delaunay, with points inside as far apart as those of the outline.

Points inside lie on a grid of equilateral triangles. All is triangulated by adding one point after the other (Bowyer,
Comput. J. 24, 1981; Watson, Comput. J. 24, 1981), and what lies outside the outline is left out.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from heartcase.schemas.arrays import Bool, Float64, Int32
from heartcase.schemas.errors import SimulationError

__all__ = ["crosses_itself", "is_inside", "signed_area", "triangulated"]

_NOTHING = 1e-9
"""Twice the area of a triangle that is none, over the square of the outline's size."""
_NUDGE = 1e-5
"""How far points are moved before they are triangulated [spacings]."""
_RIM_GAP = 0.6
"""Least distance of a point inside from the outline [spacings]."""


def signed_area(outline: Float64) -> float:
    """Area inside a closed outline, above zero where it is counter-clockwise, shape (count, 2)."""
    x, y = outline.T
    return float(0.5 * (x * np.roll(y, -1) - np.roll(x, -1) * y).sum())


def is_inside(points: Float64, outline: Float64) -> Bool:
    """Whether points lie inside a closed outline, by crossings of a ray; shapes (any, 2) and (count, 2)."""
    start, end = outline, np.roll(outline, -1, axis=0)
    spans = (start[:, 1] > points[:, None, 1]) != (end[:, 1] > points[:, None, 1])
    rise = np.where(end[:, 1] == start[:, 1], 1.0, end[:, 1] - start[:, 1])
    at = start[:, 0] + (points[:, None, 1] - start[:, 1]) / rise * (end[:, 0] - start[:, 0])
    inside: Bool = (spans & (points[:, None, 0] < at)).sum(axis=1) % 2 == 1
    return inside


def crosses_itself(outline: Float64) -> bool:
    """Whether two edges of a closed outline that do not follow each other cross."""
    start, end = outline, np.roll(outline, -1, axis=0)
    count = len(outline)

    def side(a: Float64, b: Float64, c: Float64) -> Float64:
        turn: Float64 = (b[..., 0] - a[..., 0]) * (c[..., 1] - a[..., 1]) - (b[..., 1] - a[..., 1]) * (
            c[..., 0] - a[..., 0]
        )
        return turn

    one, other = np.triu_indices(count, 2)
    apart = (other - one) % count != count - 1
    one, other = one[apart], other[apart]
    a, b, c, d = start[one], end[one], start[other], end[other]
    least = _NOTHING * np.ptp(outline, axis=0).max() ** 2

    def between(p: Float64, q: Float64) -> Bool:
        parted: Bool = ((p > least) & (q < -least)) | ((p < -least) & (q > least))
        return parted

    meets = between(side(a, b, c), side(a, b, d)) & between(side(c, d, a), side(c, d, b))
    return bool(meets.any())


def triangulated(outline: npt.ArrayLike, spacing: float, *, name: str = "patch") -> tuple[Float64, Int32]:
    """Vertices and triangles of what a closed outline encloses; the outline's points come first.

    Parameters
    ----------
    outline
        Counter-clockwise, no two points the same, shape (count, 2).
    spacing
        Distance between points inside, about that between those of the outline.
    name
        Name in messages.

    Returns
    -------
    vertices
        Shape (vertex_count, 2).
    triangles
        Counter-clockwise, shape (triangle_count, 3).

    Raises
    ------
    SimulationError
        The outline is so narrow somewhere that its points make no sheet.
    """
    rim = np.asarray(outline, dtype=np.float64)
    vertices = np.concatenate([rim, _points_inside(rim, spacing)])
    # Four points of one circle, or three of one line, have no one triangulation: none are left so.
    number = np.arange(len(vertices))
    moved = vertices + _NUDGE * spacing * np.stack([np.sin(12.9898 * number + 1), np.sin(78.233 * number + 2)], axis=1)
    triangles = _delaunay(moved)
    inside = is_inside(moved[triangles].mean(axis=1), moved[: len(rim)])
    triangles = triangles[inside]
    # All of the area, each edge of the outline once, and no vertex left over: then it is a disc.
    edges = np.sort(triangles[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2), axis=1)
    pairs, uses = np.unique(edges, axis=0, return_counts=True)
    number = np.arange(len(rim))
    wanted = np.sort(np.stack([number, (number + 1) % len(rim)], axis=1), axis=1)
    wanted = wanted[np.lexsort((wanted[:, 1], wanted[:, 0]))]
    if not np.array_equal(pairs[uses == 1], wanted) or len(np.unique(triangles)) < len(vertices):
        raise SimulationError(
            "the outline is too narrow somewhere for so few stitches: give a smaller spacing_mm, or a rounder outline",
            place=name,
        )
    return vertices, triangles


def _points_inside(rim: Float64, spacing: float) -> Float64:
    """Points of a grid of equilateral triangles inside an outline, not too near to it."""
    low, high = rim.min(axis=0), rim.max(axis=0)
    height = np.sqrt(0.75) * spacing
    middle = (low + high) / 2
    count = np.ceil((high - low) / 2 / (spacing, height)).astype(np.int64) + 1
    column, row = np.meshgrid(np.arange(-count[0], count[0] + 1), np.arange(-count[1], count[1] + 1))
    points = np.stack([spacing * (column + 0.5 * (row % 2)), height * row], axis=-1).reshape(-1, 2) + middle
    points = points[is_inside(points, rim)]
    along = np.roll(rim, -1, axis=0) - rim
    part = np.einsum("psx,sx->ps", points[:, None] - rim, along) / (along**2).sum(axis=1)
    nearest = rim + np.clip(part, 0.0, 1.0)[..., None] * along
    far = np.linalg.norm(points[:, None] - nearest, axis=2).min(axis=1)
    kept: Float64 = points[far >= _RIM_GAP * spacing]
    return kept


def _delaunay(points: Float64) -> Int32:
    """Delaunay triangles of points, counter-clockwise, shape (count, 3)."""
    count = len(points)
    middle, size = points.mean(axis=0), 1e3 * np.ptp(points, axis=0).max()
    around = middle + size * np.array([(-1.0, -1.0), (1.0, -1.0), (0.0, 1.0)])
    places = np.concatenate([points, around])
    triangles = np.array([(count, count + 1, count + 2)])
    for number in range(count):
        bad = _is_in_circle(places[triangles], places[number])
        edges = triangles[bad][:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2)
        # What lies between two bad triangles goes; a fan over the rest comes.
        there = {tuple(edge) for edge in edges.tolist()}
        hull = np.array([edge for edge in edges.tolist() if (edge[1], edge[0]) not in there])
        fan = np.column_stack([hull, np.full(len(hull), number)])
        triangles = np.concatenate([triangles[~bad], fan])
    own = (triangles < count).all(axis=1)
    found: Int32 = triangles[own].astype(np.int32)
    return found


def _is_in_circle(corners: Float64, point: Float64) -> Bool:
    """Whether a point lies inside the circles through counter-clockwise triangles, shape (count, 3, 2)."""
    d = corners - point
    square = (d**2).sum(axis=2)
    a, b, c = d[:, 0], d[:, 1], d[:, 2]
    inside: Bool = (
        square[:, 0] * (b[:, 0] * c[:, 1] - c[:, 0] * b[:, 1])
        - square[:, 1] * (a[:, 0] * c[:, 1] - c[:, 0] * a[:, 1])
        + square[:, 2] * (a[:, 0] * b[:, 1] - b[:, 0] * a[:, 1])
    ) > 0
    return inside
