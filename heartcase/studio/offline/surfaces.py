"""A level of detail of a case's surface, and which structure each of its triangles shows."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from heartcase.schemas.arrays import Float32, Int32, UInt8
from heartcase.schemas.bundle.reader import OpenBundle
from heartcase.schemas.bundle.surface_kinds import SurfaceKind
from heartcase.schemas.labels import BACKGROUND

__all__ = ["RIM", "SurfaceArrays", "middle_level", "surface_of"]

RIM = 255
"""Number of the structure that rims of defects are; label values end at 250."""


@dataclass(frozen=True)
class SurfaceArrays:
    """One level of detail of a case's surface."""

    vertices_mm: Float32
    """LPS mm, shape (vertex_count, 3)."""
    normals: Float32
    """Unit normals out of the tissue, shape (vertex_count, 3)."""
    triangles: Int32
    """Vertex numbers, shape (triangle_count, 3)."""
    void: UInt8
    """Label before each triangle, shape (triangle_count,)."""
    tissue: UInt8
    """Label behind each triangle, shape (triangle_count,)."""
    kind: UInt8 | None
    """:class:`~heartcase.schemas.bundle.surface_kinds.SurfaceKind` of each triangle; None in versions 1.0 and 1.1."""

    @property
    def structures(self) -> UInt8:
        """The cavity before each triangle, outside the tissue behind it; devices and rims of defects by themselves."""
        found = np.where(self.void == BACKGROUND, self.tissue, self.void).astype(np.uint8)
        if self.kind is not None:
            found = np.where(self.kind == SurfaceKind.DEVICE, self.tissue, found)
            found = np.where(self.kind == SurfaceKind.DEFECT_RIM, RIM, found)
        return found.astype(np.uint8)


def middle_level(bundle: OpenBundle) -> int:
    """The level of detail for a page that is sent over a network: the middle one, or the nearest that there is."""
    return min(bundle.levels, key=lambda level: (abs(level - 1), level))


def surface_of(bundle: OpenBundle, level: int) -> SurfaceArrays:
    """Read a level of detail.

    Raises
    ------
    BundleError
        Its values are not sound.
    """
    role = bundle.surface_role(level)
    names = ["vertices", "normals", "triangles", "triangle_label", "triangle_tissue"]
    has_kind = "triangle_kind" in bundle.headers[role].arrays
    arrays = bundle.arrays(role, [*names, "triangle_kind"] if has_kind else names)
    vertices, normals, triangles, void, tissue = (arrays[name] for name in names)
    return SurfaceArrays(vertices, normals, triangles, void, tissue, arrays.get("triangle_kind"))
