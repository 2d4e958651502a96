"""The surface as it was before any cut: what a split asks of it is worked out once."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from heartcase.schemas.arrays import Float64, Int32, Int64
from heartcase.schemas.errors import SimulationError
from heartcase.simulator.cutting.crossings import QUANTA
from heartcase.simulator.mesh_arrangement.surface_crossings import fill_buckets
from heartcase.simulator.mesh_arrangement.surface_patches import Patches, make_patches

__all__ = ["Buckets", "UncutSurface"]

Buckets = tuple[int, Int64, Int64, Int64, Int32]
"""What :func:`heartcase.simulator.mesh_arrangement.surface_crossings.fill_buckets` fills: shift, low, size, first,
members."""

_SHIFT = QUANTA.bit_length() - 2
"""Buckets have half a cell along each edge."""
_PATCH_SHIFT = QUANTA.bit_length() + 2
"""Patches lie in blocks of eight cells along each edge."""


@dataclass(frozen=True)
class UncutSurface:
    """A closed surface at rest."""

    places: Float64
    """Places of the vertices in the frame of the nodes [cells], shape (vertex_count, 3)."""
    triangles: Int64
    """Vertex numbers, counter-clockwise from outside, shape (triangle_count, 3)."""
    vertices: Int64
    """Places in whole numbers, QUANTA to a cell, shape (vertex_count, 3)."""
    edges: Int64
    """Number of the edge from each corner to the next, shape (triangle_count, 3); each is of two triangles."""
    buckets: Buckets
    """Triangles by where they lie."""
    edge_count: int
    """Number of edges."""
    patches: Patches
    """What hangs together where nothing is cut."""

    @property
    def vertex_count(self) -> int:
        """Number of vertices."""
        return len(self.places)

    @classmethod
    def of(cls, places: npt.ArrayLike, triangles: npt.ArrayLike) -> UncutSurface:
        """Prepare a surface.

        Parameters
        ----------
        places
            Of the vertices at rest, in the frame of the nodes [cells], shape (vertex_count, 3).
        triangles
            Vertex numbers, counter-clockwise from outside, shape (triangle_count, 3).

        Raises
        ------
        SimulationError
            The surface is not closed: an edge is not passed as often one way as the other.
        """
        places = np.array(places, dtype=np.float64)
        triangles = np.array(triangles, dtype=np.int64).reshape(-1, 3)
        vertices = np.round(places * QUANTA).astype(np.int64)
        low = vertices.min(axis=0, initial=0) >> _SHIFT
        size = (vertices.max(axis=0, initial=0) >> _SHIFT) - low + 1
        first, members = np.zeros(int(size.prod()) + 1, np.int64), np.zeros(0, np.int32)
        fill_buckets(vertices, triangles, _SHIFT, low, size, first, members)
        members = np.empty(first[-1], np.int32)
        fill_buckets(vertices, triangles, _SHIFT, low, size, first, members)
        return cls(
            places,
            triangles,
            vertices,
            _paired_edges(triangles),
            (_SHIFT, low, size, first, members),
            len(triangles) * 3 // 2,
            make_patches(vertices, triangles, _PATCH_SHIFT),
        )


def _paired_edges(triangles: Int64) -> Int64:
    """Number of the edge that follows each corner; where more than two triangles meet, two by two."""
    starts, ends = triangles.ravel(), np.roll(triangles, -1, axis=1).ravel()
    key = np.minimum(starts, ends) << 32 | np.maximum(starts, ends)
    way = (starts > ends).astype(np.int64)
    order = np.lexsort((way, key))
    is_first = np.diff(2 * key[order] + way[order], prepend=-1) != 0
    begins = np.flatnonzero(is_first)
    rank = np.empty(len(key), np.int64)
    rank[order] = np.arange(len(key)) - np.repeat(begins, np.diff(np.append(begins, len(key))))
    _, edges, counts = np.unique(np.stack([key, rank], axis=1), axis=0, return_inverse=True, return_counts=True)
    if (counts != 2).any():
        raise SimulationError("the surface is not closed: only a closed one can be cut", place="surface")
    return edges.reshape(-1, 3)
