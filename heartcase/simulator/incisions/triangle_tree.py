"""Boxes around the triangles of a surface, in a tree: what a shaft touches is found without looking at all of them.

The triangles are sorted along a curve through space (Morton, 1966), four to a leaf, and the tree over the leaves is a
full binary one: node n has the children 2 n + 1 and 2 n + 2. It is made anew for each shape of a surface.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from heartcase.schemas.arrays import Float64, Int64
from heartcase.schemas.errors import Problem, SimulationError

__all__ = ["LEAF_TRIANGLES", "TriangleTree", "triangle_tree"]

LEAF_TRIANGLES = 4
_BITS = 10


@dataclass(frozen=True)
class TriangleTree:
    """A surface, for the kernels of :mod:`heartcase.simulator.incisions.segments`."""

    corners_mm: Float64
    """Corners of the triangles in the order of the leaves, mm, shape (triangle_count, 3, 3)."""
    boxes: Float64
    """Lowest and highest point of each node's triangles, mm, shape (node_count, 2, 3); infinite where it has none."""
    leaf_start: int
    """Number of the first leaf."""

    @property
    def arrays(self) -> tuple[Any, ...]:
        """What the kernels take."""
        return self.corners_mm, self.boxes, self.leaf_start


def triangle_tree(vertices_mm: npt.ArrayLike, triangles: npt.ArrayLike) -> TriangleTree:
    """The tree of a surface.

    Parameters
    ----------
    vertices_mm
        Vertices, mm, shape (vertex_count, 3).
    triangles
        Vertex numbers, shape (triangle_count, 3); none is fine: then nothing is touched.

    Raises
    ------
    SimulationError
        A vertex is not finite, or a number is of no vertex.
    """
    vertices = np.asarray(vertices_mm, dtype=float).reshape(-1, 3)
    corners_of = np.asarray(triangles, dtype=np.int64).reshape(-1, 3)
    problems = []
    if not np.isfinite(vertices).all():
        problems.append(Problem("vertices_mm", "every number must be finite"))
    if corners_of.size and not 0 <= corners_of.min() <= corners_of.max() < len(vertices):
        problems.append(Problem("triangles", f"numbers must be those of the {len(vertices)} vertices"))
    if problems:
        raise SimulationError(problems)
    corners = vertices[corners_of]
    corners = np.ascontiguousarray(corners[np.argsort(_places_on_curve(corners.mean(axis=1)), kind="stable")])
    leaf_count = 1
    while leaf_count * LEAF_TRIANGLES < len(corners):
        leaf_count *= 2
    boxes = np.empty((2 * leaf_count - 1, 2, 3))
    boxes[:, 0], boxes[:, 1] = np.inf, -np.inf
    start = leaf_count - 1
    firsts = np.arange(0, len(corners), LEAF_TRIANGLES)
    if len(firsts):
        boxes[start : start + len(firsts), 0] = np.minimum.reduceat(corners.min(axis=1), firsts)
        boxes[start : start + len(firsts), 1] = np.maximum.reduceat(corners.max(axis=1), firsts)
    below = leaf_count
    while below > 1:
        children = boxes[below - 1 : 2 * below - 1]
        boxes[below // 2 - 1 : below - 1, 0] = np.minimum(children[0::2, 0], children[1::2, 0])
        boxes[below // 2 - 1 : below - 1, 1] = np.maximum(children[0::2, 1], children[1::2, 1])
        below //= 2
    return TriangleTree(corners, boxes, start)


def _places_on_curve(points: Float64) -> Int64:
    """Place of each point along the curve through the box of all."""
    if not len(points):
        return np.zeros(0, np.int64)
    low = points.min(axis=0)
    size = np.maximum(np.ptp(points, axis=0).max(), 1e-300)
    steps = np.minimum((points - low) / size * (1 << _BITS), (1 << _BITS) - 1).astype(np.int64)
    place = np.zeros(len(points), np.int64)
    for bit in range(_BITS):
        for axis in range(3):
            place |= ((steps[:, axis] >> bit) & 1) << (3 * bit + axis)
    return place
