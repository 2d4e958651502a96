"""What can be written of a case for other programs: labels, models, a page, a recording in motion; ready, not written.

Readers and writers of formats are imported where one is asked for: most of them take long to load.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, field
from hashlib import sha256
from pathlib import Path
from typing import TYPE_CHECKING

from heartcase.schemas.bundle.format import CaseManifest, FileRole
from heartcase.schemas.errors import BundleError, UsageError
from heartcase.simulator.surface.write_surface import SURFACE_FORMATS

if TYPE_CHECKING:
    from heartcase.pipeline.data import Segmentation
    from heartcase.pipeline.exports.models import TaggedMesh
    from heartcase.pipeline.formats.dicom.source import SourceSeries
    from heartcase.schemas.bundle.reader import OpenBundle

__all__ = [
    "ENDINGS",
    "ERROR_MM",
    "FRAMES_PER_SECOND",
    "MIN_THICKNESS_MM",
    "MODELS",
    "PAGE",
    "PRINTED",
    "RECORDED_FORMATS",
    "SITE",
    "TOUR_PLACES",
    "WITH_SCAN",
    "WRITERS",
    "CaseExport",
    "ExportedFile",
    "model_file",
    "page_file",
    "recorded_file",
]


@dataclass(frozen=True)
class CaseExport:
    """What the writers take."""

    case: Path
    bundle: OpenBundle
    scan: Path | None
    series: str | None
    level: int = 0

    @property
    def manifest(self) -> CaseManifest:
        """What the case says of itself."""
        return self.bundle.manifest

    @property
    def case_id(self) -> str:
        """The case's made-up identifier; of older cases, which have none, a part of the scan's hash."""
        return self.manifest.case_id or f"CASE-{self.manifest.scan_sha256[:12].upper()}"

    def labels(self) -> Segmentation:
        """The case's labels, grown walls included."""
        import numpy as np

        from heartcase.pipeline.data import Segmentation
        from heartcase.pipeline.formats.read_scan import read_labels

        entry = self.manifest.file(FileRole.LABELS)
        if entry is None:
            raise UsageError("the case was made without labels: add 'labels' to parts, and build again", place="CASE")
        volume = read_labels(self.case / entry.name)
        unknown = set(np.unique(volume.values).tolist()) - set(self.manifest.labels.values)
        if unknown or volume.values.dtype != np.uint8:
            raise BundleError("the labels hold values that are not in the case's table: build it again", place="CASE")
        return Segmentation(volume.values.astype(np.uint8), volume.geometry, self.manifest.labels)

    def source(self, labels: Segmentation) -> SourceSeries | None:
        """The DICOM series that the case was made from, where the user gives it."""
        from heartcase.pipeline.formats.dicom.source import find_source

        if self.scan is None:
            return None
        if not labels.geometry.matches(self.manifest.scan_geometry):
            raise BundleError("the labels do not lie on the lattice of the case's scan: build it again", place="CASE")
        return find_source(self.scan, self.manifest, series=self.series)

    def surface(self, model: str) -> TaggedMesh:
        """The hollow model, the solid one, or the vessels."""
        from heartcase.pipeline.exports.models import hollow_model, solid_model, vessels_model, walls_smoothing_mm

        if model == "hollow":
            return hollow_model(self.bundle, level=self.level)
        if model == "vessels":
            return vessels_model(self.bundle)
        return solid_model(self.labels(), smoothing_mm=walls_smoothing_mm(self.bundle))


def _seg_nrrd(export: CaseExport) -> bytes:
    from heartcase.pipeline.formats.write_images import segmentation_nrrd_bytes

    labels = export.labels()
    source = export.source(labels)
    return segmentation_nrrd_bytes(labels, case_id=export.case_id, offset=source.offset if source else (0, 0, 0))


def _dicom_seg(export: CaseExport) -> bytes:
    from heartcase.pipeline.formats.labels.write_dicom_seg import dicom_seg_bytes

    labels = export.labels()
    return dicom_seg_bytes(labels, case_id=export.case_id, source=export.source(labels))


def _values(suffix: str) -> Callable[[CaseExport], bytes]:
    def write(export: CaseExport) -> bytes:
        from heartcase.pipeline.formats.write_images import label_values_bytes

        return label_values_bytes(export.labels(), suffix)

    return write


WRITERS: dict[str, Callable[[CaseExport], bytes]] = {
    ".seg.nrrd": _seg_nrrd,
    ".dcm": _dicom_seg,
    ".nii.gz": _values(".nii.gz"),
    ".nrrd": _values(".nrrd"),
}
"""Ending of the file name -> what makes the file's content; the first that fits counts."""

WITH_SCAN = (".seg.nrrd", ".dcm")

MODELS: dict[str, tuple[str, ...]] = {
    "hollow": (".stl", ".ply", ".3mf", ".glb", ".vtu", ".vtk"),
    "solid": (".stl", ".ply", ".3mf", ".vtu", ".vtk"),
    "vessels": (".stl", ".ply", ".3mf", ".vtu", ".vtk"),
    "cells": (".inp", ".msh", ".vtu", ".vtk"),
}
"""Model -> endings that can hold it; where --model is left out, the first model that an ending holds is written."""

PRINTED = (".stl", ".ply", ".3mf")

MIN_THICKNESS_MM = 1.0
"""Two lines of the usual 0.4 mm nozzle and a margin; a wall that nothing supports asks as much of resin and powder."""


RECORDED_FORMATS = (".glb", ".html", ".gif", ".mp4")
"""What a recording can be shown as."""
PAGE = ".html"
"""A page for a browser, which needs no server."""
SITE = ""
"""A folder of pages."""
FRAMES_PER_SECOND = 15.0
"""Frames in a second of a recording's simulated time."""
ERROR_MM = 0.05
"""How far a vertex of a GLB in motion may be off."""


@dataclass(frozen=True)
class ExportedFile:
    """A file that is ready to be written."""

    content: bytes
    what: str
    """What it holds, in words."""
    facts: dict[str, object] = field(default_factory=dict)
    """What --json adds."""
    warnings: tuple[str, ...] = ()
    more: tuple[str, ...] = ()
    """Lines to say after that it was written."""


def _printed(export: CaseExport, model: str, suffix: str, min_thickness_mm: float) -> ExportedFile:
    """A model for a printer, checked."""
    from heartcase.pipeline.exports.ply_and_3mf import ply_bytes, three_mf_bytes
    from heartcase.pipeline.exports.print_check import check_for_printing

    what = _called(model)
    mesh = export.surface(model)
    check = check_for_printing(mesh, min_thickness_mm=min_thickness_mm)
    if suffix == ".ply":
        content = ply_bytes(mesh, case_id=export.case_id)
    elif suffix == ".3mf":
        content = three_mf_bytes(mesh, title=f"{what.removeprefix('the ')} of case {export.case_id}")
    else:
        comment = f"SPACE=LPS; patient LPS, mm; case {export.case_id}"
        content = SURFACE_FORMATS[suffix](mesh.vertices_mm, mesh.normals, mesh.triangles, mesh.colours, comment)
    return ExportedFile(content, what, {"print_check": asdict(check)}, (*mesh.warnings, *check.warnings))


def _called(model: str) -> str:
    """A model in words."""
    return "the vessels" if model == "vessels" else f"the {model} model"


def _view(export: CaseExport) -> ExportedFile:
    """The case's own GLB, as it is."""
    role = FileRole.RENDER.at(export.level)
    content = export.bundle.path(role).read_bytes()
    entry = export.manifest.file(role)
    if entry is None or sha256(content).hexdigest() != entry.sha256:
        raise BundleError(f"the part {role.value!r} is damaged: build the case again", place="CASE")
    return ExportedFile(content, "the surface with its normal map")


def _for_meshio(export: CaseExport, model: str, suffix: str) -> ExportedFile:
    """A model or the grid in a format that meshio writes."""
    from heartcase.pipeline.exports.meshio_files import grid_hexahedra, hexahedra_bytes, surface_bytes

    if model == "cells":
        cells = grid_hexahedra(export.bundle)
        return ExportedFile(hexahedra_bytes(cells, suffix), f"{len(cells.hexahedra):,} hexahedra")
    mesh = export.surface(model)
    return ExportedFile(surface_bytes(mesh, suffix), f"the surface of {_called(model)}", warnings=mesh.warnings)


TOUR_PLACES = "they are found beside the case, and in the folder above it where a recipe of the case's name lies"
"""Where guided tours may stand."""


def model_file(export: CaseExport, model: str, suffix: str, min_thickness_mm: float) -> ExportedFile:
    """A model in the format of an ending that can hold it."""
    if suffix in PRINTED:
        return _printed(export, model, suffix, min_thickness_mm)
    if suffix == ".glb":
        return _view(export)
    return _for_meshio(export, model, suffix)


def page_file(
    export: CaseExport, recordings: Sequence[Path], rate: float | None, *, tours: bool, is_partial: bool
) -> ExportedFile:
    """The case for a browser."""
    from heartcase.studio.offline.exported import page_of

    rate = FRAMES_PER_SECOND if rate is None else rate
    made = page_of(
        export.case, recordings, level=export.level, frames_per_second=rate, tours=tours, is_partial=is_partial
    )
    words = {0: "", 1: " with its recording"}.get(len(recordings), f" with {len(recordings)} recordings")
    facts: dict[str, object] = {"frames_per_second": rate} if recordings else {}
    said: tuple[str, ...] = ()
    if tours:
        facts["tours"] = made.tours
        said = (
            f"guided tours in it: {'; '.join(made.tours)}" if made.tours else f"no guided tour is in it: {TOUR_PLACES}",
        )
    warnings = tuple(map(str, made.warnings))
    return ExportedFile(made.content, f"the case as a page{words}", facts, warnings, said)


def recorded_file(
    case: Path,
    recording: Path,
    suffix: str,
    level: int,
    rate: float | None,
    error_mm: float | None,
    *,
    is_partial: bool,
) -> ExportedFile:
    """A recording in motion."""
    from heartcase.cli.shared.recorded_film import animation_of

    rate = FRAMES_PER_SECOND if rate is None else rate
    error_mm = ERROR_MM if error_mm is None else error_mm
    made = animation_of(
        recording, case, suffix, level=level, frames_per_second=rate, error_mm=error_mm, is_partial=is_partial
    )
    return ExportedFile(made.content, made.what, made.facts, made.warnings)


ENDINGS = (*WRITERS, *dict.fromkeys(ending for held in MODELS.values() for ending in held), PAGE)
"""Endings of all that is written of a case at rest."""
