"""What goes in and out of the stages: volumes, distance fields, grid, surface, mapping.

All arrays of a volume are indexed ``[z, y, x]``; points are (x, y, z) in patient LPS mm unless a name says otherwise.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np
import numpy.typing as npt

from heartcase.schemas.geometry import Geometry
from heartcase.schemas.labels import LabelTable

__all__ = [
    "GridMap",
    "Markers",
    "PickingSurface",
    "Scan",
    "Segmentation",
    "SimulationGrid",
    "Structures",
    "Surface",
]

Float32 = npt.NDArray[np.float32]
Int32 = npt.NDArray[np.int32]
UInt8 = npt.NDArray[np.uint8]


@dataclass(frozen=True)
class Scan:
    """A scalar scan. Holds no patient identity."""

    values: Float32
    """Intensities, float32, shape ``geometry.shape``; Hounsfield units for CT, arbitrary for MRI."""
    geometry: Geometry
    """Where the voxel centres lie."""
    modality: str = "unknown"
    """``CT``, ``MR`` or ``unknown``."""
    acquisition: dict[str, Any] = field(default_factory=dict)
    """Physics of the acquisition that may be kept (field strength, tube voltage, ...): plain numbers and words."""


@dataclass(frozen=True)
class Markers:
    """Painted markers on the scan's lattice."""

    labels: UInt8
    """Label value of each marked voxel, shape ``geometry.shape``; 255 where nothing is marked (0 is background)."""
    geometry: Geometry
    """The scan's geometry."""

    UNMARKED = 255


@dataclass(frozen=True)
class Segmentation:
    """One label per voxel."""

    labels: UInt8
    """Label values, shape ``geometry.shape``; 0 is background."""
    geometry: Geometry
    """The scan's geometry."""
    table: LabelTable
    """What the values stand for."""


@dataclass(frozen=True)
class Structures:
    """One signed-distance field per structure, background included: all that grid, surface and map read.

    A point belongs to the structure whose field, interpolated there, is the lowest (ties: the lower value). Fields
    of two structures that touch are each other's negative near the common face, so nothing gapes between them.
    Beyond ``band_mm`` a field is only known to be at least that far.
    """

    distance_mm: dict[int, Float32]
    """Label value -> signed distance in mm, negative inside, float32, shape ``geometry.shape``."""
    geometry: Geometry
    """The lattice of the fields: the scan's, cropped to the region of interest."""
    table: LabelTable
    """Label table with the grown walls and devices."""
    band_mm: float
    """Distance up to which the fields are exact."""
    fixed_planes: tuple[tuple[tuple[float, float, float], tuple[float, float, float], float], ...] = ()
    """End markers: (point, outward axis, radius) in mm; tissue cells that such a disc cuts are held fixed."""


@dataclass(frozen=True)
class SimulationGrid:
    """Cubic cells of tissue, in the order of :mod:`heartcase.schemas.bundle` (k, then j, then i)."""

    geometry: Geometry
    """Right-handed lattice of the cells, parallel to the scan's axes: ``origin_mm`` is the CENTRE of cell (0, 0, 0)."""
    cells: Int32
    """Index (i, j, k) of each tissue cell, shape (cell_count, 3), sorted by k, j, i."""
    cell_coverage: Float32
    """Fraction of the cell that is tissue, shape (cell_count,), in (0, 1]."""
    cell_label: UInt8
    """Tissue label that fills most of the cell, shape (cell_count,)."""
    nodes: Int32
    """Corner (i, j, k) of each node, shape (node_count, 3), sorted by k, j, i; corner (0, 0, 0) is half a cell
    before the centre of cell (0, 0, 0)."""
    fixed: UInt8
    """1 where a node is held, shape (node_count,)."""
    faces: Int32
    """Node numbers of each boundary face, counter-clockwise seen from the void, shape (face_count, 4)."""
    face_label: UInt8
    """Label of the void beside each face (0 outside, else a cavity), shape (face_count,)."""
    face_cell: Int32
    """Number of the tissue cell that each face belongs to, shape (face_count,)."""
    table: LabelTable
    """Label table."""
    quality: dict[str, Any] = field(default_factory=dict)
    """Figures for the report: counts, volume error, Betti numbers before and after, repairs, thickness in cells."""
    warnings: tuple[str, ...] = ()
    """What could not be repaired, in plain words with positions in mm."""

    def node_positions_mm(self) -> npt.NDArray[np.float64]:
        """Rest positions of the nodes in world mm, shape (node_count, 3), float64."""
        return self.geometry.index_to_world(self.nodes - 0.5)


@dataclass(frozen=True)
class Surface:
    """The visible surface: a welded triangle mesh with tags, and what a renderer needs beside it.

    *Render vertices* are the welded vertices repeated along the seams of the UV atlas.
    """

    vertices_mm: Float32
    """Welded vertices, world mm, shape (vertex_count, 3)."""
    triangles: Int32
    """Welded vertex numbers, counter-clockwise from outside the tissue, shape (triangle_count, 3)."""
    triangle_label: UInt8
    """Label of the void beside each triangle: which cavity, or 0 for outside, shape (triangle_count,)."""
    triangle_tissue: UInt8
    """Label of the tissue behind each triangle, shape (triangle_count,)."""
    triangle_is_cut: UInt8
    """1 where the triangle closes tissue that the region of interest or an end marker cuts."""
    normals: Float32
    """Unit vertex normals of the true surface, out of the tissue, shape (vertex_count, 3)."""
    vertex_label: UInt8
    """Label of the void at each welded vertex (the lowest label of its triangles), shape (vertex_count,)."""
    table: LabelTable
    """Label table."""
    render_to_welded: Int32
    """Welded vertex of each render vertex, shape (render_vertex_count,)."""
    render_triangles: Int32
    """Render vertex numbers, same order as ``triangles``, shape (triangle_count, 3)."""
    render_uv: Float32
    """Texture coordinates of the render vertices, glTF convention (v down), shape (render_vertex_count, 2);
    all zero when there is no atlas."""
    render_tangents: Float32
    """Tangent (x, y, z, handedness) of the render vertices in world mm space, shape (render_vertex_count, 4)."""
    normal_map: UInt8
    """Tangent-space normal map, shape (size, size, 3), 8 bit; shape (0, 0, 3) when there is none."""
    quality: dict[str, Any] = field(default_factory=dict)
    """Figures for the report."""
    warnings: tuple[str, ...] = ()
    """What is wrong with the mesh, in plain words."""


@dataclass(frozen=True)
class GridMap:
    """How the surface follows the grid: the triangle basis of thesis 9.3.3, per welded vertex."""

    triangle_nodes: Int32
    """The three node numbers of each vertex's triangle, shape (vertex_count, 3)."""
    weights: Float32
    """Weights of the reference point, sum one, shape (vertex_count, 3)."""
    offset_mm: Float32
    """Offset from the reference point along (T, N, B) of the rest triangle, shape (vertex_count, 3)."""
    normal: Float32
    """Vertex normal along (T, N, B), shape (vertex_count, 3)."""
    curvature: UInt8
    """1 where the interpolated basis (eq. 9.8) is to be used, shape (vertex_count,). The simulator derives the offset
    in that basis from the rest position, so it is not stored."""
    tangent: Float32
    """Tangent of each RENDER vertex along (T, N, B) of its welded vertex's triangle, and its handedness, shape
    (render_vertex_count, 4)."""
    nearest_node: Int32
    """Nearest node of each vertex for the one-to-one mapping of thesis 9.3.2, shape (vertex_count,)."""
    quality: dict[str, Any] = field(default_factory=dict)
    """Figures for the report."""
    warnings: tuple[str, ...] = ()
    """Vertices that had no face of their own label, and the like."""


@dataclass(frozen=True)
class PickingSurface:
    """The coarse surface of thesis 10.2.4 and 11.2.2: one vertex per boundary node of the grid."""

    nodes: Int32
    """Node number of each vertex, ascending, shape (picking_vertex_count,)."""
    triangles: Int32
    """Vertex numbers into ``nodes``, counter-clockwise from outside the tissue, shape (2 * face_count, 3)."""
    triangle_label: UInt8
    """Label of the void beside each triangle, shape (2 * face_count,)."""
