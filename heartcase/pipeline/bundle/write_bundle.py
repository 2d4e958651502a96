"""Writing a case bundle: data files named by their content, the manifest last.

A crash at any moment leaves the case that was there before, or the new one: ``case.json`` is replaced in one step, and
files of the old case are removed only after that.
"""

from __future__ import annotations

import contextlib
import hashlib
import json
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from heartcase import __version__
from heartcase.pipeline.bundle.aligned import AlignedFile, aligned_safetensors
from heartcase.pipeline.data import GridMap, PickingSurface, SimulationGrid, Surface
from heartcase.pipeline.image.scan_part import ScanPart
from heartcase.pipeline.warnings import CaseWarning
from heartcase.schemas.about import About
from heartcase.schemas.bundle.format import (
    ARRAYS,
    FORMAT_VERSION,
    LEVEL_MAX,
    MANIFEST_NAME,
    VERSION_WITHOUT_SEPTA,
    ArrayEntry,
    CaseManifest,
    FileEntry,
    FileRole,
    Material,
    SimulationFigures,
    StageRecord,
)
from heartcase.schemas.bundle.lattice import step_sizes
from heartcase.schemas.bundle.placing import refuse_inside_case
from heartcase.schemas.bundle.reader import read_manifest
from heartcase.schemas.errors import BundleError
from heartcase.schemas.files import LOCK_NAME, TEMPORARY_PREFIX, atomic_write, exclusive, remove_leftovers
from heartcase.schemas.geometry import Geometry
from heartcase.schemas.labels import LabelTable
from heartcase.schemas.landmarks import Landmark
from heartcase.schemas.recipe.settings import MaterialsSettings

__all__ = [
    "BundleContent",
    "BundleParts",
    "BundleRecord",
    "BundleSource",
    "assemble_bundle",
    "check_place",
    "check_replacement",
    "resolve_materials",
    "simulation_figures",
    "write_bundle",
]

_SUFFIX = {FileRole.RENDER.at(level): ".glb" for level in range(LEVEL_MAX + 1)} | {FileRole.LABELS: ".seg.nrrd"}
_DATA_FILE = re.compile(rf"({'|'.join(FileRole)})-[0-9a-f]{{16}}(\.safetensors|\.glb|\.seg\.nrrd)")
"""Names that :func:`assemble_bundle` gives: nothing else in a case's directory is ever removed."""


@dataclass(frozen=True)
class BundleContent:
    """A case in memory, ready to be written."""

    manifest: CaseManifest
    """The manifest, with an entry for each file."""
    files: dict[str, bytes]
    """File name -> content."""

    @property
    def manifest_bytes(self) -> bytes:
        """``case.json`` as it is written."""
        return json.dumps(self.manifest.model_dump(mode="json"), indent=1, sort_keys=True).encode() + b"\n"

    @property
    def sha256(self) -> str:
        """The bundle hash: SHA-256 of ``case.json``, which lists the hash of every other file."""
        return hashlib.sha256(self.manifest_bytes).hexdigest()


def resolve_materials(settings: MaterialsSettings, table: LabelTable) -> tuple[Material, ...]:
    """Elastic constants of every tissue label, by ascending value."""
    exceptions = {label.value: values for name, values in settings.labels.items() if (label := table.find(name))}
    return tuple(
        Material(
            label=label.value,
            youngs_modulus_kpa=exceptions.get(label.value, settings).youngs_modulus_kpa,
            density_kg_m3=exceptions.get(label.value, settings).density_kg_m3,
        )
        for label in table
        if label.role.is_tissue
    )


def simulation_figures(grid: SimulationGrid, materials: Sequence[Material]) -> SimulationFigures:
    """Counts and step sizes of a case."""
    cell_mm = grid.geometry.spacing_mm[0]
    used = set(np.unique(grid.cell_label).tolist())
    ratio = max(m.youngs_modulus_kpa * 1e3 / m.density_kg_m3 for m in materials if m.label in used)
    step_default, step_limit = step_sizes(ratio, cell_mm)
    return SimulationFigures(
        node_count=len(grid.nodes),
        cell_count=len(grid.cells),
        fixed_node_count=int(grid.fixed.sum()),
        cell_mm=cell_mm,
        step_default_s=step_default,
        step_limit_s=step_limit,
        steps_per_second=1.0 / step_default,
        tissue_volume_ml=float(grid.cell_coverage.sum(dtype=np.float64)) * grid.geometry.voxel_volume_mm3 * 1e-3,
    )


@dataclass(frozen=True)
class BundleParts:
    """The parts of a case. Those that are None are left out, and levels of detail beyond the format's."""

    grid: SimulationGrid
    """The simulation grid, and the table of the labels."""
    surface: Surface | None = None
    """The visible surface, with its levels of detail."""
    grid_map: GridMap | None = None
    """What ties it to the grid, with the same levels."""
    picking: PickingSurface | None = None
    """The surface of the grid itself."""
    glbs: Sequence[bytes] = ()
    """Whole GLB files, one for each level of detail, from fine to coarse; none where nobody wants them."""
    labels_nrrd: bytes | None = None
    """A whole file of the labels."""
    scan: ScanPart | None = None
    """The scan's values."""


@dataclass(frozen=True)
class BundleSource:
    """The scan that a case was made from, without identity."""

    geometry: Geometry
    """Where the voxel centres lie."""
    sha256: str
    """Of the values, as :attr:`heartcase.pipeline.data.Scan.values_sha256`."""
    modality: str = "unknown"
    """``MR``, ``CT`` or ``unknown``."""
    acquisition: Mapping[str, Any] = field(default_factory=dict)
    """Physics of the acquisition."""


@dataclass(frozen=True)
class BundleRecord:
    """What the manifest says of a case beside its parts; as in :class:`CaseManifest`."""

    name: str
    """Name of the case."""
    case_id: str | None = None
    """Made-up identifier of the case."""
    stages: Sequence[StageRecord] = ()
    """Provenance, in the order of the stages."""
    landmarks: Sequence[Landmark] = ()
    """Named points of the anatomy."""
    about: About | None = None
    """Diagnoses, and for whom the case is meant."""
    quality: Mapping[str, Any] = field(default_factory=dict)
    """Figures that the stages measured."""
    warnings: Sequence[CaseWarning] = ()
    """The worst first."""


def assemble_bundle(
    parts: BundleParts, materials: Sequence[Material], source: BundleSource, record: BundleRecord
) -> BundleContent:
    """Put a case together in memory.

    Parameters
    ----------
    parts
        What the case holds.
    materials
        Elastic constants of every tissue label.
    source
        Where it comes from.
    record
        What is said of it.

    Raises
    ------
    BundleError
        An array has not the type or shape that the format states, or a value is not finite.
    """
    arrays = _arrays_of(parts, materials)
    aligned = {role: _checked_file(role, named) for role, named in arrays.items()}
    contents = {role: file.content for role, file in aligned.items()}
    contents |= {FileRole.RENDER.at(level): glb for level, glb in enumerate(parts.glbs[: LEVEL_MAX + 1])}
    if parts.labels_nrrd is not None:
        contents[FileRole.LABELS] = parts.labels_nrrd
    files: dict[str, bytes] = {}
    entries = []
    for role, content in contents.items():
        digest = hashlib.sha256(content).hexdigest()
        file_name = f"{role.value}-{digest[:16]}{_SUFFIX.get(role, '.safetensors')}"
        files[file_name] = content
        listed = _listed(role, arrays[role], aligned[role]) if role in aligned else ()
        entries.append(FileEntry(role=role, name=file_name, size=len(content), sha256=digest, arrays=listed))
    has_septa = any(label.septum_of is not None for label in parts.grid.table)
    manifest = CaseManifest(
        format_version=FORMAT_VERSION if has_septa else VERSION_WITHOUT_SEPTA,
        name=record.name,
        case_id=record.case_id,
        scan_geometry=source.geometry,
        scan_values=parts.scan.values if parts.scan else None,
        grid_geometry=parts.grid.geometry,
        labels=parts.grid.table,
        materials=tuple(materials),
        landmarks=tuple(record.landmarks),
        about=record.about,
        simulation=simulation_figures(parts.grid, materials),
        software_version=__version__,
        scan_sha256=source.sha256,
        modality=source.modality,
        acquisition=dict(source.acquisition),
        stages=tuple(record.stages),
        quality=dict(record.quality),
        warnings=tuple(warning.text for warning in record.warnings),
        warning_grades=tuple(warning.grade for warning in record.warnings),
        files=tuple(entries),
    )
    return BundleContent(manifest, files)


def _arrays_of(parts: BundleParts, materials: Sequence[Material]) -> dict[FileRole, dict[str, npt.NDArray[Any]]]:
    """The arrays of each file that holds some, by the names that the format gives them."""
    grid, surface, grid_map = parts.grid, parts.surface, parts.grid_map
    constants = {material.label: material for material in materials}
    stiffness = np.zeros(256, np.float32)
    density = np.zeros(256, np.float32)
    for label, material in constants.items():
        stiffness[label] = material.youngs_modulus_kpa
        density[label] = material.density_kg_m3
    arrays: dict[FileRole, dict[str, npt.NDArray[Any]]] = {
        FileRole.GRID: {
            "cells": grid.cells,
            "cell_coverage": grid.cell_coverage,
            "cell_moments": grid.cell_moments,
            "cell_label": grid.cell_label,
            "cell_stiffness": stiffness[grid.cell_label],
            "cell_density": density[grid.cell_label],
            "nodes": grid.nodes,
            "fixed": grid.fixed,
        }
    }
    for level, one in enumerate((surface, *surface.levels)[: LEVEL_MAX + 1] if surface else ()):
        names = ("normals", "triangles", "triangle_label", "triangle_tissue", "triangle_is_cut", "triangle_kind")
        part = {item: getattr(one, item) for item in (*names, "vertex_label", "render_to_welded")}
        arrays[FileRole.SURFACE.at(level)] = part | {"vertices": one.vertices_mm}
    for level, tie in enumerate((grid_map, *grid_map.levels)[: LEVEL_MAX + 1] if grid_map else ()):
        names = ("triangle_nodes", "weights", "normal", "curvature", "tangent", "nearest_node")
        part = {item: getattr(tie, item) for item in names}
        arrays[FileRole.MAPPING.at(level)] = part | {"offset": tie.offset_mm}
    if parts.picking is not None:
        arrays[FileRole.PICKING] = {
            item: getattr(parts.picking, item) for item in ("nodes", "triangles", "triangle_label")
        }
    if parts.scan is not None:
        arrays[FileRole.SCAN] = {"intensity": parts.scan.intensity}
    return arrays


def _checked_file(role: FileRole, arrays: Mapping[str, npt.NDArray[Any]]) -> AlignedFile:
    counts: dict[str, int] = {}
    checked: dict[str, npt.NDArray[Any]] = {}
    for spec in ARRAYS[role]:
        array = arrays[spec.name]
        fits = array.dtype == spec.dtype and array.ndim == len(spec.shape)
        for size, want in zip(array.shape, spec.shape, strict=False):
            fits &= size == (counts.setdefault(want, size) if isinstance(want, str) else want)
        if not fits:
            found = f"{array.dtype} {list(array.shape)}"
            raise BundleError(f"is {found}, not {spec.dtype} {list(spec.shape)}", place=f"{role.value}.{spec.name}")
        if array.dtype.kind == "f" and not np.isfinite(array).all():
            raise BundleError("holds values that are not finite numbers", place=f"{role.value}.{spec.name}")
        checked[spec.name] = array
    return aligned_safetensors(checked)


def _listed(role: FileRole, arrays: Mapping[str, npt.NDArray[Any]], file: AlignedFile) -> tuple[ArrayEntry, ...]:
    return tuple(
        ArrayEntry(
            name=spec.name,
            dtype=spec.dtype,
            shape=arrays[spec.name].shape,
            offset=file.offsets[spec.name],
            unit=spec.unit,
            meaning=spec.meaning,
        )
        for spec in ARRAYS[role]
    )


def write_bundle(directory: Path | str, content: BundleContent) -> bool:
    """Write a case over whatever case is there; returns whether anything changed.

    Raises
    ------
    BundleError
        The directory holds something else than a case, or cannot be written to.
    """
    directory = Path(directory)
    check_place(directory)
    manifest = content.manifest_bytes
    try:
        directory.mkdir(parents=True, exist_ok=True)
        with exclusive(directory):
            remove_leftovers(directory)
            changed = False
            for name, data in content.files.items():
                if not _holds(directory / name, data):
                    atomic_write(directory / name, data)
                    changed = True
            if not _holds(directory / MANIFEST_NAME, manifest):
                atomic_write(directory / MANIFEST_NAME, manifest)
                changed = True
            keep = {*content.files, MANIFEST_NAME, LOCK_NAME}
            for stale in sorted(directory.iterdir()):
                if stale.name not in keep and _DATA_FILE.fullmatch(stale.name) and stale.is_file():
                    with contextlib.suppress(OSError):
                        stale.unlink()
    except OSError as error:
        raise BundleError(f"cannot be written: {error.strerror}", place="output") from None
    return changed


def check_place(directory: Path | str) -> None:
    """Refuse a place where something else than a case is.

    Raises
    ------
    BundleError
        The case's name is taken by a file, or by a directory that holds other things.
    UsageError
        It lies in another case.
    """
    directory = Path(directory)
    refuse_inside_case(directory, place="output", is_case=True)
    if directory.exists() and (not directory.is_dir() or not _is_ours(directory)):
        raise BundleError("there is something else in this place: choose another name or directory", place="output")


def check_replacement(directory: Path | str, case_id: str | None) -> None:
    """Refuse to replace another case: two scans may have been given one name.

    Raises
    ------
    BundleError
        The case that is there has another identifier.
    """
    try:
        there = read_manifest(Path(directory)).case_id
    except BundleError:
        return
    if there is not None and there != case_id:
        raise BundleError(
            f"another case of this name is there ({there}), made from another scan: give this one another name or "
            "--out, or replace that one with --replace",
            place="output",
        )


def _is_ours(directory: Path) -> bool:
    """A directory that is empty, or holds only what this module writes."""
    return all(
        path.name in (MANIFEST_NAME, LOCK_NAME)
        or path.name.startswith(TEMPORARY_PREFIX)
        or _DATA_FILE.fullmatch(path.name)
        for path in directory.iterdir()
    )


def _holds(path: Path, data: bytes) -> bool:
    try:
        return not path.is_symlink() and path.stat().st_size == len(data) and path.read_bytes() == data
    except OSError:
        return False
