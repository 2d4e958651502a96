"""The format of a case bundle: its manifest and the arrays of each of its files.

A case is a directory ``NAME.case/`` whose ``case.json`` lists every other file by role, size and SHA-256. Bulk arrays
are safetensors: little-endian, C order, each at a multiple of 64 bytes from the start of its file. This module only
describes; :mod:`heartcase.schemas.bundle.reader` opens.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from enum import StrEnum
from typing import Annotated, Any

from pydantic import Field, ValidationInfo, field_validator

from heartcase.schemas.about import About
from heartcase.schemas.base import CaseId, Model, Name, Vector3
from heartcase.schemas.bundle.coordinates import Coordinates
from heartcase.schemas.geometry import Geometry
from heartcase.schemas.labels import LabelTable
from heartcase.schemas.landmarks import Landmark

__all__ = [
    "ALIGNMENT",
    "ARRAYS",
    "FORMAT_NAME",
    "FORMAT_VERSION",
    "LEVELS",
    "LEVEL_MAX",
    "MANIFEST_NAME",
    "VERSION_WITHOUT_SEPTA",
    "ArrayEntry",
    "ArraySpec",
    "CaseManifest",
    "FileEntry",
    "FileRole",
    "Material",
    "ScanValues",
    "SimulationFigures",
    "StageRecord",
    "WarningGrade",
]

FORMAT_NAME = "heartcase-bundle"
FORMAT_VERSION = "1.5"
"""The newest version that is read and written."""
VERSION_WITHOUT_SEPTA = "1.4"
"""What a case without grown septa is written as: it has nothing that 1.5 added, and keeps its bytes."""
MANIFEST_NAME = "case.json"

ALIGNMENT = 64
"""Bytes: every array starts at a multiple of it, so a mapped file can be handed to vector units and to the GPU."""


_Line = Annotated[str, Field(max_length=2000, pattern=r"^[^\x00-\x1f\x7f-\x9f]*$")]
"""A line of text without control characters: it may be shown in a terminal."""


class FileRole(StrEnum):
    """What a file of the bundle is for. A scene reads only the roles that it needs."""

    GRID = "grid"
    SURFACE = "surface"
    MAPPING = "mapping"
    PICKING = "picking"
    RENDER = "render"
    LABELS = "labels"
    SCAN = "scan"
    SURFACE_1 = "surface_1"
    MAPPING_1 = "mapping_1"
    RENDER_1 = "render_1"
    SURFACE_2 = "surface_2"
    MAPPING_2 = "mapping_2"
    RENDER_2 = "render_2"

    @property
    def level(self) -> int:
        """Level of detail: 0 is the finest, and what does not come in levels."""
        return LEVELS.get(self, (self, 0))[1]

    @property
    def finest(self) -> FileRole:
        """The role of the same kind at level 0."""
        return LEVELS.get(self, (self, 0))[0]

    def at(self, level: int) -> FileRole:
        """The role of the same kind at another level of detail; what does not come in levels is itself.

        Raises
        ------
        ValueError
            The format has no such level: there are 0 to :data:`LEVEL_MAX`.
        """
        if not 0 <= level <= LEVEL_MAX:
            raise ValueError(f"there is no level of detail {level}")
        return next((role for role, place in LEVELS.items() if place == (self.finest, level)), self.finest)


LEVELS: dict[FileRole, tuple[FileRole, int]] = {
    FileRole.SURFACE_1: (FileRole.SURFACE, 1),
    FileRole.MAPPING_1: (FileRole.MAPPING, 1),
    FileRole.RENDER_1: (FileRole.RENDER, 1),
    FileRole.SURFACE_2: (FileRole.SURFACE, 2),
    FileRole.MAPPING_2: (FileRole.MAPPING, 2),
    FileRole.RENDER_2: (FileRole.RENDER, 2),
}
"""Coarser levels of detail: role -> the role of the finest level, and the number of the level."""

LEVEL_MAX = 2
"""Coarsest level of detail that the format has."""


@dataclass(frozen=True)
class ArraySpec:
    """One array of a safetensors file."""

    name: str
    """Key in the file."""
    dtype: str
    """numpy dtype name."""
    shape: tuple[str | int, ...]
    """Counts by name, or numbers."""
    unit: str
    """SI unit or mm; ``1`` for pure numbers."""
    meaning: str
    """One line."""
    since: str = "1.0"
    """Version of the format that has it first."""

    def is_in(self, version: str | None) -> bool:
        """Whether every case of a version has it; where the version is not known, whether those of any have."""
        return _numbers(self.since) <= _numbers(version or "1.0")

    def at(self, level: int) -> ArraySpec:
        """The same array at a coarser level of detail, with counts of its own."""
        shape = tuple(f"{n}_{level}" if isinstance(n, str) and n != "node_count" else n for n in self.shape)
        return replace(self, shape=shape)


def _numbers(version: str) -> tuple[int, ...]:
    return tuple(int(part) for part in version.split("."))


ARRAYS: dict[FileRole, tuple[ArraySpec, ...]] = {
    FileRole.GRID: (
        ArraySpec("cells", "int32", ("cell_count", 3), "1", "index (i, j, k) of each tissue cell, by k, j, i"),
        ArraySpec("cell_coverage", "float32", ("cell_count",), "1", "fraction of the cell that is tissue"),
        ArraySpec("cell_label", "uint8", ("cell_count",), "1", "tissue label that fills most of the cell"),
        ArraySpec("cell_stiffness", "float32", ("cell_count",), "kPa", "Young's modulus of the tissue"),
        ArraySpec("cell_density", "float32", ("cell_count",), "kg/m3", "density of the tissue"),
        ArraySpec(
            "cell_moments",
            "float32",
            ("cell_count", 9),
            "1",
            "means of x, y, z, xx, yy, zz, yz, xz, xy over the cell's tissue, in edges from its centre along i, j, k",
            since="1.3",
        ),
        ArraySpec("nodes", "int32", ("node_count", 3), "1", "corner (i, j, k) of each node, by k, j, i"),
        ArraySpec("fixed", "uint8", ("node_count",), "1", "1 where a node is held"),
    ),
    FileRole.SURFACE: (
        ArraySpec("vertices", "float32", ("vertex_count", 3), "mm", "welded vertices (x, y, z), patient LPS"),
        ArraySpec("normals", "float32", ("vertex_count", 3), "1", "unit normals out of the tissue"),
        ArraySpec("triangles", "int32", ("triangle_count", 3), "1", "vertex numbers, counter-clockwise from outside"),
        ArraySpec("triangle_label", "uint8", ("triangle_count",), "1", "label of the void beside the triangle"),
        ArraySpec("triangle_tissue", "uint8", ("triangle_count",), "1", "label of the tissue behind it"),
        ArraySpec("triangle_is_cut", "uint8", ("triangle_count",), "1", "1 on faces where the tissue was cut off"),
        ArraySpec("vertex_label", "uint8", ("vertex_count",), "1", "label of the void at the vertex"),
        ArraySpec("render_to_welded", "int32", ("render_vertex_count",), "1", "welded vertex of each GLB vertex"),
        ArraySpec("triangle_kind", "uint8", ("triangle_count",), "1", "1 endocardium to 7 cut face", since="1.2"),
    ),
    FileRole.MAPPING: (
        ArraySpec("triangle_nodes", "int32", ("vertex_count", 3), "1", "nodes of the vertex's triangle"),
        ArraySpec("weights", "float32", ("vertex_count", 3), "1", "weights of the reference point, sum one"),
        ArraySpec("offset", "float32", ("vertex_count", 3), "mm", "offset along (T, N, B) of the triangle"),
        ArraySpec("normal", "float32", ("vertex_count", 3), "1", "normal along (T, N, B)"),
        ArraySpec("curvature", "uint8", ("vertex_count",), "1", "1: use the interpolated basis"),
        ArraySpec("tangent", "float32", ("render_vertex_count", 4), "1", "tangent along (T, N, B), handedness"),
        ArraySpec("nearest_node", "int32", ("vertex_count",), "1", "nearest node, for one-to-one mapping"),
    ),
    FileRole.PICKING: (
        ArraySpec("nodes", "int32", ("picking_vertex_count",), "1", "node number of each picking vertex"),
        ArraySpec("triangles", "int32", ("picking_triangle_count", 3), "1", "picking vertex numbers"),
        ArraySpec("triangle_label", "uint8", ("picking_triangle_count",), "1", "label of the void beside it"),
    ),
    FileRole.SCAN: (
        ArraySpec(
            "intensity",
            "int16",
            ("scan_k", "scan_j", "scan_i"),
            "1",
            "filtered scan on scan_geometry, [k][j][i]; intensity = slope * value + intercept of scan_values",
        ),
    ),
}
ARRAYS |= {
    role: tuple(spec.at(n) for spec in ARRAYS[role.finest]) for role, (finest, n) in LEVELS.items() if finest in ARRAYS
}
"""The arrays of each safetensors role. Node and vertex numbers are checked to lie in range on opening."""


class Material(Model):
    """Elastic constants of one tissue label."""

    label: int
    """Tissue label value."""
    youngs_modulus_kpa: Annotated[float, Field(gt=0.0, le=1e6)]
    """Young's modulus, kPa."""
    density_kg_m3: Annotated[float, Field(gt=0.0, le=2e4)]
    """Density, kg/m3."""


class ArrayEntry(Model):
    """One array of a safetensors file: what a reader needs to take it without reading the file's own header."""

    name: Annotated[str, Field(pattern=r"^[a-z][a-z0-9_]{0,63}$")]
    """Key in the file."""
    dtype: Annotated[str, Field(pattern=r"^[a-z]+[0-9]*$")]
    """``int32``, ``float32``, ``uint8`` or ``int16``; little-endian."""
    shape: tuple[Annotated[int, Field(ge=0)], ...]
    """Numbers of elements, slowest index first (C order)."""
    offset: Annotated[int, Field(ge=0, multiple_of=ALIGNMENT)]
    """Bytes from the start of the file to the first element."""
    unit: _Line
    """SI unit or mm; ``1`` for pure numbers."""
    meaning: _Line
    """One line."""


class FileEntry(Model):
    """One file of the bundle."""

    role: FileRole
    """What it is for."""
    name: Annotated[str, Field(pattern=r"^[a-z0-9][a-z0-9_.-]{0,127}$")]
    """File name inside the bundle's directory; never a path."""
    size: Annotated[int, Field(ge=0)]
    """Bytes."""
    sha256: Annotated[str, Field(pattern=r"^[0-9a-f]{64}$")]
    """SHA-256 of the content."""
    arrays: tuple[ArrayEntry, ...] = ()
    """For safetensors, all arrays but padding, by ascending offset; empty in version 1.0."""


class ScanValues(Model):
    """How the numbers of the scan part become intensities: ``intensity = slope * number + intercept``."""

    slope: Annotated[float, Field(gt=0.0)]
    """Intensity of one step of the stored numbers."""
    intercept: float
    """Intensity of a stored zero."""
    unit: _Line
    """``HU`` for CT, ``1`` where intensities have no unit (MR)."""
    error_max: Annotated[float, Field(ge=0.0)]
    """Largest difference to the filtered scan that the rounding made."""


class WarningGrade(StrEnum):
    """How much a warning matters, the worst first."""

    ANATOMY = "anatomy"
    """The anatomy may be wrong: the model may differ from the heart there."""
    LOOK = "look"
    """Something that may be right or wrong, and that a look at the slices decides."""
    NOTE = "note"
    """For information: nothing need be done."""

    @property
    def rank(self) -> int:
        """Place from the worst, which is 0."""
        return list(WarningGrade).index(self)


class StageRecord(Model):
    """How a stage came to its output."""

    stage: str
    """Name of the stage."""
    version: Annotated[int, Field(ge=1)]
    """Version of the stage's algorithm."""
    settings: dict[str, Any]
    """Its resolved settings."""
    output_sha256: Annotated[str, Field(pattern=r"^[0-9a-f]{64}$")]
    """Hash of its output."""


class SimulationFigures(Model):
    """What a simulator wants to know before it reads any array."""

    node_count: Annotated[int, Field(ge=1)]
    """Nodes of the cell lattice."""
    cell_count: Annotated[int, Field(ge=1)]
    """Tissue cells."""
    fixed_node_count: Annotated[int, Field(ge=0)]
    """Nodes that are held."""
    cell_mm: Annotated[float, Field(gt=0.0)]
    """Edge of a cell, mm."""
    step_default_s: Annotated[float, Field(gt=0.0)]
    """Default time step: 0.8 x 2 / sqrt(24 k/m) of the stiffest-to-mass cell, in s."""
    step_limit_s: Annotated[float, Field(gt=0.0)]
    """Largest time step that is stable at rest for every shape: 2 / sqrt(20 k/m), in s."""
    steps_per_second: Annotated[float, Field(gt=0.0)]
    """Steps that one second of real time takes at the default."""
    tissue_volume_ml: Annotated[float, Field(ge=0.0)]
    """Volume of the tissue by coverage, ml."""


class CaseManifest(Model):
    """``case.json``: the only thing that makes the files beside it a case."""

    format: str = FORMAT_NAME
    """Always ``heartcase-bundle``."""
    format_version: Annotated[str, Field(pattern=r"^[0-9]+\.[0-9]+$")] = FORMAT_VERSION
    """Readers refuse an unknown major version."""
    required_extensions: tuple[str, ...] = ()
    """Readers refuse a case that requires an extension they do not know."""
    name: Name
    """Name of the case."""
    case_id: CaseId | None = None
    """Made-up identifier of the case, on every output; who it belongs to is kept elsewhere."""
    notice: _Line = "Not a medical device. For teaching, research and planning beside approved means only."
    """Always shown with the case."""
    scan_geometry: Geometry
    """Lattice of the scan's region of interest; the scan part is on it."""
    scan_values: ScanValues | None = None
    """How to read the scan part, where there is one."""
    coordinates: Coordinates = Coordinates()
    """What the axes mean, and how to go to the axes of other programs."""
    grid_geometry: Geometry
    """Lattice of the simulation cells: origin is the centre of cell (0, 0, 0); right-handed."""
    gltf_from_lps: tuple[Vector3, Vector3, Vector3] = ((0.001, 0, 0), (0, 0, 0.001), (0, -0.001, 0))
    """Rows of the matrix from LPS mm to the GLB's metres, Y up: (x, z, -y) / 1000."""
    labels: LabelTable
    """What label values stand for."""
    materials: tuple[Material, ...]
    """Elastic constants per tissue label."""
    landmarks: tuple[Landmark, ...] = ()
    """Named points, rings and lines in mm."""
    about: About | None = None
    """What the case teaches, its origin and licence, where the recipe says so."""
    simulation: SimulationFigures
    """Counts and step sizes."""
    software_version: _Line
    """Version of heartcase that wrote the case."""
    scan_sha256: Annotated[str, Field(pattern=r"^[0-9a-f]{64}$")]
    """Hash of the scan's intensities and geometry (no header)."""
    modality: _Line
    """CT, MR or unknown."""
    acquisition: dict[str, Any] = {}
    """Physics of the acquisition, without identity."""
    stages: tuple[StageRecord, ...]
    """Provenance of every stage, in order."""
    quality: dict[str, Any] = {}
    """Quality figures per stage."""
    warnings: tuple[_Line, ...] = ()
    """What a user must know, worst first."""
    warning_grades: tuple[WarningGrade, ...] = ()
    """How much each warning matters, in their order; empty in cases before 1.4: then each is worth a look."""
    files: tuple[FileEntry, ...]
    """Every file of the bundle but this one."""

    @field_validator("warning_grades")
    @classmethod
    def _has_one_for_each_warning(cls, grades: tuple[WarningGrade, ...], info: ValidationInfo) -> Any:
        warnings = info.data.get("warnings")
        if grades and warnings is not None and len(grades) != len(warnings):
            raise ValueError(f"there are {len(grades)} grades of {len(warnings)} warnings: give one for each, or none")
        return grades

    def file(self, role: FileRole) -> FileEntry | None:
        """The file with this role, or None when the case was made without it."""
        return next((entry for entry in self.files if entry.role is role), None)
