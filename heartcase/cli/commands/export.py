"""``heartcase export``: write parts of a case in the formats of other programs."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import asdict, dataclass, field
from hashlib import sha256
from pathlib import Path
from typing import TYPE_CHECKING

import click

from heartcase.cli.shared.output import echo_json, file_size, working
from heartcase.schemas.bundle.format import LEVEL_MAX, CaseManifest, FileRole
from heartcase.schemas.errors import BundleError, Problem, UsageError
from heartcase.schemas.files import atomic_write
from heartcase.simulator.surface.write_surface import SURFACE_FORMATS

if TYPE_CHECKING:
    from heartcase.pipeline.data import Segmentation
    from heartcase.pipeline.exports.models import TaggedMesh
    from heartcase.pipeline.formats.dicom.source import SourceSeries
    from heartcase.schemas.bundle.reader import OpenBundle

__all__ = ["MODELS", "WRITERS", "command"]


@dataclass(frozen=True)
class _Export:
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


def _seg_nrrd(export: _Export) -> bytes:
    from heartcase.pipeline.formats.write_images import segmentation_nrrd_bytes

    labels = export.labels()
    source = export.source(labels)
    return segmentation_nrrd_bytes(labels, case_id=export.case_id, offset=source.offset if source else (0, 0, 0))


def _dicom_seg(export: _Export) -> bytes:
    from heartcase.pipeline.formats.labels.write_dicom_seg import dicom_seg_bytes

    labels = export.labels()
    return dicom_seg_bytes(labels, case_id=export.case_id, source=export.source(labels))


def _values(suffix: str) -> Callable[[_Export], bytes]:
    def write(export: _Export) -> bytes:
        from heartcase.pipeline.formats.write_images import label_values_bytes

        return label_values_bytes(export.labels(), suffix)

    return write


WRITERS: dict[str, Callable[[_Export], bytes]] = {
    ".seg.nrrd": _seg_nrrd,
    ".dcm": _dicom_seg,
    ".nii.gz": _values(".nii.gz"),
    ".nrrd": _values(".nrrd"),
}
"""Ending of the file name -> what makes the file's content; the first that fits counts."""

_WITH_SCAN = (".seg.nrrd", ".dcm")

MODELS: dict[str, tuple[str, ...]] = {
    "hollow": (".stl", ".ply", ".3mf", ".glb", ".vtu", ".vtk"),
    "solid": (".stl", ".ply", ".3mf", ".vtu", ".vtk"),
    "vessels": (".stl", ".ply", ".3mf", ".vtu", ".vtk"),
    "cells": (".inp", ".msh", ".vtu", ".vtk"),
}
"""Model -> endings that can hold it; where --model is left out, the first model that an ending holds is written."""

_PRINTED = (".stl", ".ply", ".3mf")

MIN_THICKNESS_MM = 1.0
"""Two lines of the usual 0.4 mm nozzle and a margin; a wall that nothing supports asks as much of resin and powder."""


RECORDED_FORMATS = (".glb", ".html", ".gif", ".mp4")
"""What a recording can be shown as."""
PAGE = ".html"
"""A page for a browser, which needs no server."""
FRAMES_PER_SECOND = 15.0
"""Frames in a second of a recording's simulated time."""
ERROR_MM = 0.05
"""How far a vertex of a GLB in motion may be off."""


@dataclass(frozen=True)
class _Made:
    """A file that is ready to be written."""

    content: bytes
    what: str
    """What it holds, in words."""
    facts: dict[str, object] = field(default_factory=dict)
    """What --json adds."""
    warnings: tuple[str, ...] = ()


def _printed(export: _Export, model: str, suffix: str, min_thickness_mm: float) -> _Made:
    """A model for a printer, checked."""
    from heartcase.pipeline.exports.print_check import check_for_printing
    from heartcase.pipeline.exports.print_files import ply_bytes, three_mf_bytes

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
    return _Made(content, what, {"print_check": asdict(check)}, (*mesh.warnings, *check.warnings))


def _called(model: str) -> str:
    """A model in words."""
    return "the vessels" if model == "vessels" else f"the {model} model"


def _view(export: _Export) -> _Made:
    """The case's own GLB, as it is."""
    role = FileRole.RENDER.at(export.level)
    content = export.bundle.path(role).read_bytes()
    entry = export.manifest.file(role)
    if entry is None or sha256(content).hexdigest() != entry.sha256:
        raise BundleError(f"the part {role.value!r} is damaged: build the case again", place="CASE")
    return _Made(content, "the surface with its normal map")


def _for_meshio(export: _Export, model: str, suffix: str) -> _Made:
    """A model or the grid in a format that meshio writes."""
    from heartcase.pipeline.exports.meshio_files import grid_hexahedra, hexahedra_bytes, surface_bytes

    if model == "cells":
        cells = grid_hexahedra(export.bundle)
        return _Made(hexahedra_bytes(cells, suffix), f"{len(cells.hexahedra):,} hexahedra")
    mesh = export.surface(model)
    return _Made(surface_bytes(mesh, suffix), f"the surface of {_called(model)}", warnings=mesh.warnings)


def _page(case: Path, level: int) -> _Made:
    """The case for a browser."""
    from heartcase.simulator.load import load_case
    from heartcase.studio.offline.web_page import web_page

    loaded = load_case(case, needs=("surface", "structures", "cell_labels"), level=level)
    return _Made(web_page(loaded), "the case as a page")


def _recorded(
    case: Path, recording: Path, suffix: str, level: int, rate: float | None, error_mm: float | None
) -> _Made:
    """A recording in motion."""
    from heartcase.cli.shared.recorded_film import animation_of

    rate = FRAMES_PER_SECOND if rate is None else rate
    error_mm = ERROR_MM if error_mm is None else error_mm
    made = animation_of(recording, case, suffix, level=level, frames_per_second=rate, error_mm=error_mm)
    return _Made(made.content, made.what, made.facts)


def _suffix_of(name: str, recording: Path | None) -> str:
    """The ending of a file name that says its format.

    Raises
    ------
    UsageError
        It says none.
    """
    endings = [*WRITERS, *dict.fromkeys(ending for held in MODELS.values() for ending in held), PAGE]
    if recording is not None:
        endings = [*RECORDED_FORMATS]
    for ending in endings:
        if name.lower().endswith(ending):
            return ending
    raise UsageError(f"the file must end in one of: {', '.join(endings)}", place="--out")


def _problems(
    suffix: str,
    model: str | None,
    scan: Path | None,
    series: str | None,
    min_thickness_mm: float | None,
    level: int,
) -> list[Problem]:
    """Options that do not go with the ending or with each other."""
    problems = []
    if series is not None and scan is None:
        problems.append(Problem("--series", "says which series of --scan: give that too, or leave it out"))
    if level and (model or "hollow" if suffix in (*MODELS["hollow"], PAGE) else None) != "hollow":
        problems.append(Problem("--level", "only the hollow model has levels of detail: leave it out"))
    if scan is not None and suffix not in _WITH_SCAN:
        problems.append(Problem("--scan", f"serves only for {' and '.join(_WITH_SCAN)}: leave it out"))
    if model is not None and suffix == PAGE:
        problems.append(Problem("--model", "a page shows the hollow model: leave it out"))
    elif model is not None and suffix not in MODELS[model]:
        held = [name for name, endings in MODELS.items() if suffix in endings]
        holds = ", ".join(held) if held else "labels, and no model: leave it out"
        problems.append(Problem("--model", f"{suffix} holds {holds}; {model} is written as {', '.join(MODELS[model])}"))
    if min_thickness_mm is not None and suffix not in _PRINTED:
        problems.append(Problem("--min-thickness-mm", f"serves only for {', '.join(_PRINTED)}: leave it out"))
    return problems


def _motion_problems(
    suffix: str, model: str | None, recording: Path | None, rate: float | None, error_mm: float | None
) -> list[Problem]:
    """Options that do not go with showing a recording."""
    problems = []
    if recording is not None and model is not None:
        problems.append(Problem("--model", "a recording shows the hollow model: leave it out"))
    if recording is None and rate is not None:
        problems.append(Problem("--frames-per-second", "serves only with --recording: leave it out"))
    if error_mm is not None and (recording is None or suffix != ".glb"):
        problems.append(Problem("--error-mm", "serves only with --recording and .glb: leave it out"))
    if any(number is not None and math.isnan(number) for number in (rate, error_mm)):
        problems.append(Problem("--frames-per-second, --error-mm", "must be numbers"))
    return problems


@click.command()
@click.argument("case", type=click.Path(path_type=Path, readable=False))
@click.option(
    "-o",
    "--out",
    "output",
    type=click.Path(path_type=Path, readable=False),
    required=True,
    help="The file to write. Labels: .seg.nrrd or .dcm (DICOM SEG) with names, colours and codes; .nii.gz or .nrrd "
    "with the label values alone. For printing: .stl, .ply, .3mf. To look at: .glb, or .html, a page "
    "that any browser opens without a server. For ParaView: .vtu, .vtk. "
    "For finite elements: .inp (Abaqus), .msh (Gmsh 2.2).",
)
@click.option(
    "--model",
    type=click.Choice(list(MODELS)),
    help="hollow: the tissue, with open chambers. solid: the blood, as a cast. vessels: landmarks that are vessels, "
    "such as coronary arteries, as tubes. cells: the simulation grid as hexahedra. Left out, it is hollow, and cells "
    "for .inp and .msh.",
)
@click.option(
    "--min-thickness-mm",
    type=click.FloatRange(0.01, 20.0),
    help="The thinnest that the printer prints; where the model is thinner, a warning says how much of it and where. "
    f"{MIN_THICKNESS_MM:g} mm when left out: two lines of the usual 0.4 mm nozzle, and a margin.",
)
@click.option(
    "--level",
    type=click.IntRange(0, LEVEL_MAX),
    default=0,
    help="Level of detail of the hollow model; 0 is the finest.",
)
@click.option(
    "--scan",
    type=click.Path(path_type=Path, readable=False),
    help="The DICOM folder that the case was made from, so that the labels open on it; a scan with other values is "
    "refused. A .dcm then holds the scan's own study, series, image and frame of reference UIDs, which lead back to "
    "the patient.",
)
@click.option(
    "--series",
    help="Which series of --scan, where the same scan is there twice: by its number or code in 'heartcase info'.",
)
@click.option(
    "--recording",
    type=click.Path(path_type=Path, readable=False),
    help="A recording of CASE to show in motion, as .glb, .html, .gif or .mp4.",
)
@click.option(
    "--frames-per-second",
    type=click.FloatRange(0.1, 120.0),
    help=f"With --recording: frames in a second of simulated time; {FRAMES_PER_SECOND:g} when left out.",
)
@click.option(
    "--error-mm",
    type=click.FloatRange(1e-4, 10.0),
    help=f"With --recording and .glb: how far a vertex may be off in a frame, mm; {ERROR_MM:g} when left out. "
    "The less, the larger the file.",
)
@click.option("--json", "as_json", is_flag=True, help="Print one JSON object about the file.")
@working("exporting")
def command(
    case: Path,
    output: Path,
    model: str | None,
    min_thickness_mm: float | None,
    level: int,
    scan: Path | None,
    series: str | None,
    recording: Path | None,
    frames_per_second: float | None,
    error_mm: float | None,
    as_json: bool,
) -> None:
    """Write the labels of CASE, a model to print, a mesh, or a recording in motion, for another program.

    The ending of the file says what is written; positions are patient LPS in mm. A model that is not closed is refused;
    all else that may disturb its print is a warning.

    Nothing of the patient is in the file: the case's made-up identifier takes the place of name and number, and dates
    are empty or fixed. Only with --scan are UIDs of the scan written.
    """
    from heartcase.schemas.bundle.reader import open_bundle

    suffix = _suffix_of(output.name, recording)
    problems = _motion_problems(suffix, model, recording, frames_per_second, error_mm)
    problems += _problems(suffix, model, scan, series, min_thickness_mm, 0 if recording else level)
    if problems:
        raise UsageError(problems)
    export = _Export(case, open_bundle(case), scan, series, level)
    if level:
        export.bundle.surface_role(level, place="--level")
    if recording is not None:
        made = _recorded(case, recording, suffix, level, frames_per_second, error_mm)
    elif suffix == PAGE:
        made = _page(case, level)
    elif suffix in WRITERS:
        made = _Made(WRITERS[suffix](export), "the labels")
    else:
        model = model or next(name for name, endings in MODELS.items() if suffix in endings)
        if suffix in _PRINTED:
            made = _printed(export, model, suffix, min_thickness_mm or MIN_THICKNESS_MM)
        elif suffix == ".glb":
            made = _view(export)
        else:
            made = _for_meshio(export, model, suffix)
    try:
        atomic_write(output, made.content)
    except OSError as error:
        reason = (error.strerror or "the system gives no reason").lower()
        raise UsageError(
            f"cannot be written: {reason}; give a file in a folder that is there and may be written", place="--out"
        ) from None
    for warning in made.warnings:
        click.echo(f"warning: {warning}", err=True)
    if as_json:
        named = {} if model is None else {"model": model}
        facts = {"format": suffix, "bytes": len(made.content)} | named | made.facts
        echo_json(facts | ({"warnings": made.warnings} if model else {}))
    else:
        click.echo(f"wrote {made.what} to {output.name}, {file_size(len(made.content))}")
