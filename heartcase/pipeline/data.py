"""Inputs and outputs of the stages: scan, labels, distance fields, grid, surface, mapping.

All arrays of a volume are indexed ``[z, y, x]``; points are (x, y, z) in patient LPS mm unless a name says otherwise.
"""

from __future__ import annotations

import hashlib
import math
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np

from heartcase.pipeline.warnings import CaseWarning
from heartcase.schemas.arrays import Float32, Float64, Int32, UInt8
from heartcase.schemas.geometry import Geometry
from heartcase.schemas.labels import LabelTable

__all__ = [
    "UNMARKED",
    "GridMap",
    "Markers",
    "PickingSurface",
    "Reshaping",
    "Scan",
    "Segmentation",
    "Septum",
    "SimulationGrid",
    "Structures",
    "Surface",
    "ThicknessTable",
    "VesselEnd",
]


UNMARKED = 255
"""Value of a voxel without marker, and of all that no label reaches."""
SHAPE_POINTS = {"cylinder": 2, "elliptic": 4, "slit": 4, "strokes": 1}
"""Shape of a reshaping -> least number of its points."""


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
    warnings: tuple[CaseWarning, ...] = ()
    """What was done to the scan as it was read, in plain words: slices interpolated, a tilted gantry straightened."""
    whole_sha256: str = ""
    """``values_sha256`` of the scan before its region of interest was cut out; empty where nobody worked it out."""

    @cached_property
    def values_sha256(self) -> str:
        """SHA-256 of intensities and geometry, and of nothing that a header says: what a scan is known by for years.

        Worked out once: nobody writes to the values of a scan that was made.
        Over the size (i, j, k; int64), the affine in mm to 1e-6 (float64) and the values (float32), little-endian.
        """
        digest = hashlib.sha256(np.array(self.geometry.size, "<i8").tobytes())
        digest.update((np.round(self.geometry.affine, 6) + 0.0).astype("<f8").tobytes())
        digest.update(np.ascontiguousarray(self.values, "<f4").data)
        return digest.hexdigest()


@dataclass(frozen=True)
class Markers:
    """Painted markers on the scan's lattice."""

    labels: UInt8
    """Label value of each marked voxel, shape ``geometry.shape``; UNMARKED where none is (0 is background)."""
    geometry: Geometry
    """The scan's geometry."""
    warnings: tuple[CaseWarning, ...] = field(default=(), metadata={"is_kept_when_empty": False})
    """What a file marks that may not be meant, in plain words."""


@dataclass(frozen=True)
class Segmentation:
    """One label per voxel."""

    labels: UInt8
    """Label values, shape ``geometry.shape``; 0 is background."""
    geometry: Geometry
    """The scan's geometry."""
    table: LabelTable
    """What the values stand for."""
    warnings: tuple[CaseWarning, ...] = field(default=(), metadata={"is_kept_when_empty": False})
    """What was left out of a finished segmentation, in plain words."""


class Reshaping(NamedTuple):
    """A part of space that goes from some structures to others: one edit, or the cut at a vessel's end.

    All other structures keep what they hold; their distances end where the part begins, and its own where they begin.
    """

    shape: str
    """``cylinder`` (round, flat ends); ``elliptic`` or ``slit`` (flat ends, the cross-section an ellipse or a straight
    slit with round ends); ``strokes`` (all points within the radius of a polyline)."""
    points_mm: tuple[tuple[float, float, float], ...]
    """The middles of the two flat ends, and for ``elliptic`` and ``slit`` the tips of the long and of the short half
    diameter from the point between them; the polyline. World mm."""
    radius_mm: float
    """Radius of the cylinder or of the brush; half of the long diameter."""
    sources: tuple[str, ...]
    """Names of the labels that lose what lies in the shape."""
    targets: tuple[str, ...]
    """Names of the labels that get it: each point goes to the nearest of them."""

    @property
    def thickness_mm(self) -> float:
        """Least extent of the shape, mm."""
        if self.shape == "strokes":
            return 2.0 * self.radius_mm
        low, high = self.points_mm[:2]
        middle = [0.5 * (a + b) for a, b in zip(low, high, strict=True)]
        half = self.radius_mm if self.shape == "cylinder" else math.dist(middle, self.points_mm[3])
        return min(2.0 * half, math.dist(low, high))


class VesselEnd(NamedTuple):
    """Where a vessel leaves the model."""

    label: str
    """Name of the vessel's label."""
    position_mm: tuple[float, float, float]
    """Middle of the lumen there, LPS mm."""
    axis: tuple[float, float, float]
    """Direction out of the heart, of length one."""
    radius_mm: float
    """Radius of the disc that cuts it; of the lumen where nothing cuts it."""
    lumen_radius_mm: float
    """Radius of a circle of the lumen's area there."""
    is_open: bool = False
    """Whether the volume's face cuts it, so that no disc is needed."""
    found: str = "found"
    """``stated`` in the recipe, ``moved`` from what the recipe states, or ``found`` by the search."""


class ThicknessTable(NamedTuple):
    """Thickness of one cavity's wall that varies with the place (:mod:`heartcase.pipeline.fields.wall_thickness`)."""

    cavity: int
    """Label value of the cavity."""
    kind: str
    """``centreline`` or ``positions``."""
    points_mm: tuple[tuple[float, float, float], ...]
    """World mm."""
    thickness_mm: tuple[float, ...]
    """At each point, mm; 0 for no wall."""


class Septum(NamedTuple):
    """A wall that is grown between two cavities where their outlines touch: :mod:`heartcase.pipeline.walls.septa`."""

    value: int
    """Label value of the septum."""
    first: int
    second: int
    """Label values of the cavities, the lower first."""
    thickness_mm: float
    """Thickness, half of it on either side of the contact."""


@dataclass(frozen=True)
class Structures:
    """Where every structure is, to a fraction of a voxel: what grid, surface and map read, through ``fields.py`` only.

    At any point, :mod:`heartcase.pipeline.fields.reader` gives every label a signed distance (negative inside) in four
    steps, and the lowest of them owns the point (ties: the lower value):

    1. The stored fields, interpolated. They are distances to the faces of the *bare* structures, before any wall: they
       divide space without gap or overlap, and two that touch are each other's negative near the common face.
    2. Walls. A wall label of the table (``wall_of``) that has no stored field is everything bare background within
       ``wall_thickness_mm`` of its cavity, or within what the cavity's table of thicknesses says there. It is worked
       out at the point itself, never sampled, so that a wall thinner than a voxel keeps its thickness. Where walls
       meet the nearer cavity's wins; the background gets what is left.
    3. Septa. Each of the two cavities gives up what lies within half the septum's thickness of the other one, so
       that a wall of the whole thickness stands where they touch, and of less where background parts them by less
       than that half. It is worked out at the point as well, and ends where a third structure begins.
    4. The reshapings, in order, worked out at the point as well, so that edits are as sharp as their shapes.

    A structure with a stored field whose label is not of the last kinds is just that field, so structures that
    hold one plain field per label (walls too) are read as they are.
    """

    distance_mm: dict[int, Float32]
    """Label value -> signed distance in mm, negative inside, float32, shape ``geometry.shape``. Always holds the
    background (0). Grown walls and devices that only a reshaping made are not here: see ``values``."""
    geometry: Geometry
    """The lattice of the fields: the scan's, cropped to the region of interest."""
    table: LabelTable
    """Label table with the grown walls and devices."""
    band_mm: float
    """Distance up to which the fields are exact; beyond it they are at least that, and a distance between voxels."""
    fixed_planes: tuple[tuple[tuple[float, float, float], tuple[float, float, float], float], ...] = ()
    """End markers: (point, outward axis, radius) in mm; tissue cells that such a disc cuts are held fixed."""
    reshapings: tuple[Reshaping, ...] = ()
    """Cuts at vessel ends and edits, in order. One that names a label which the table does not have is left out."""
    warnings: tuple[CaseWarning, ...] = ()
    """What went amiss, in plain words: structures that the smoothing shrank or lost, vessel ends that stay closed,
    compartments of blood that were joined or split, walls with a gap."""
    thickness_tables: tuple[ThicknessTable, ...] = field(default=(), metadata={"is_kept_when_empty": False})
    """Thickness of the walls that are not equally thick all over; one for each of their cavities."""
    septa: tuple[Septum, ...] = field(default=(), metadata={"is_kept_when_empty": False})
    """Walls between cavities that were grown and not seen, by ascending cavities."""
    has_voxel_steps: bool = field(default=False, metadata={"is_kept_when_empty": False})
    """Whether the fields came from labels, whose voxels leave small steps in them: normals are smoothed then."""
    vessel_ends: tuple[VesselEnd, ...] = field(default=(), metadata={"is_kept_when_empty": False})
    """The vessels' ends: cut by a disc, or, where they were sought, open at a face of the volume."""
    quality: dict[str, Any] = field(default_factory=dict, metadata={"is_kept_when_empty": False})
    """What the smoothing of the outlines did: volumes and narrowest lumens before and after, for the report."""

    @cached_property
    def worked_out(self) -> dict[str, Any]:
        """Room for what readers work out of the structures, kept as long as they are; part of no file."""
        return {}

    def __post_init__(self) -> None:
        object.__setattr__(self, "reshapings", tuple(Reshaping(*one) for one in self.reshapings))
        # The kernels look at these points unasked.
        for one in self.reshapings:
            if len(one.points_mm) < SHAPE_POINTS.get(one.shape, len(one.points_mm) + 1):
                raise TypeError(f"a reshaping of shape {one.shape!r} with {len(one.points_mm)} points is none")
        object.__setattr__(self, "vessel_ends", tuple(VesselEnd(*one) for one in self.vessel_ends))
        object.__setattr__(self, "thickness_tables", tuple(ThicknessTable(*one) for one in self.thickness_tables))
        object.__setattr__(self, "septa", tuple(Septum(*one) for one in self.septa))

    @property
    def grown_septa(self) -> tuple[Septum, ...]:
        """The septa whose two cavities are there."""
        return tuple(one for one in self.septa if one.first in self.distance_mm and one.second in self.distance_mm)

    @property
    def grown_walls(self) -> dict[int, tuple[int, float]]:
        """Wall value -> (cavity value, greatest thickness in mm) of the walls that are worked out at the point."""
        varying = {one.cavity: max(one.thickness_mm) for one in self.thickness_tables}
        return {
            label.value: (label.wall_of, varying.get(label.wall_of, self.table[label.wall_of].wall_thickness_mm))
            for label in self.table
            if label.wall_of is not None
            and label.value not in self.distance_mm
            and label.wall_of in self.distance_mm
            and self.table[label.wall_of].wall_thickness_mm > 0.0
        }

    @property
    def values(self) -> tuple[int, ...]:
        """Values of all labels that may own a point: stored, grown and made by reshapings; ascending."""
        there = set(self.distance_mm) | set(self.grown_walls) | {one.value for one in self.grown_septa}
        names = {label.name: label.value for label in self.table}
        for one in self.reshapings:
            if all(name in names and names[name] in there for name in one.sources):
                there |= {names[name] for name in one.targets if name in names}
        return tuple(sorted(there))

    def _adds_tissue(self, one: Reshaping) -> bool:
        return any(label.name in one.targets and label.role.is_tissue for label in self.table)

    @property
    def thinnest_layer_mm(self) -> float | None:
        """Thickness of the thinnest grown wall or patch, mm: sample finer than this; None where there is none."""
        least = {one.cavity: min(t for t in one.thickness_mm if t > 0.0) for one in self.thickness_tables}
        layers = [least.get(cavity, thickness) for cavity, thickness in self.grown_walls.values()]
        layers += [one.thickness_mm for one in self.grown_septa]
        layers += [one.thickness_mm for one in self.reshapings if self._adds_tissue(one)]
        return min(layers, default=None)


@dataclass(frozen=True)
class SimulationGrid:
    """Cubic cells of tissue, in the order of :mod:`heartcase.schemas.bundle.format` (k, then j, then i)."""

    geometry: Geometry
    """Right-handed lattice of the cells, parallel to the scan's axes: ``origin_mm`` is the CENTRE of cell (0, 0, 0)."""
    cells: Int32
    """Index (i, j, k) of each tissue cell, shape (cell_count, 3), sorted by k, j, i."""
    cell_coverage: Float32
    """Fraction of the cell that is tissue, shape (cell_count,), in (0, 1]."""
    cell_moments: Float32
    """Means of x, y, z, xx, yy, zz, yz, xz, xy over the cell's tissue, from the cell's centre along the grid's axes, in
    cell edges, shape (cell_count, 9)."""
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
    warnings: tuple[CaseWarning, ...] = ()
    """What could not be repaired, in plain words with positions in mm."""

    def node_positions_mm(self) -> Float64:
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
    triangle_kind: UInt8
    """:class:`~heartcase.schemas.bundle.surface_kinds.SurfaceKind` of each triangle, shape (triangle_count,)."""
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
    warnings: tuple[CaseWarning, ...] = ()
    """What is wrong with the mesh, in plain words."""
    levels: tuple[Surface, ...] = field(default=(), metadata={"is_kept_when_empty": False, "of_its_own_kind": True})
    """Coarser levels of detail, from fine to coarse; they have no levels of their own."""


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
    warnings: tuple[CaseWarning, ...] = ()
    """Vertices that had no face of their own label, and the like."""
    levels: tuple[GridMap, ...] = field(default=(), metadata={"is_kept_when_empty": False, "of_its_own_kind": True})
    """How the surface's coarser levels of detail follow the grid."""


@dataclass(frozen=True)
class PickingSurface:
    """The coarse surface of thesis 10.2.4 and 11.2.2: one vertex per boundary node of the grid."""

    nodes: Int32
    """Node number of each vertex, ascending, shape (picking_vertex_count,)."""
    triangles: Int32
    """Vertex numbers into ``nodes``, counter-clockwise from outside the tissue, shape (2 * face_count, 3)."""
    triangle_label: UInt8
    """Label of the void beside each triangle, shape (2 * face_count,)."""
