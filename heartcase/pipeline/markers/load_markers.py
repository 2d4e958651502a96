"""Painted markers, from files and from strokes of the recipe, brought onto the scan's lattice.

What a file calls its segments and points may be a patient's name: messages call them by their place in the file.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from heartcase.pipeline.data import UNMARKED, Markers, Scan, Segmentation
from heartcase.pipeline.formats.labels.point_lists import MarkupList, read_point_lists
from heartcase.pipeline.formats.labels.stl_parts import holds_parts, read_parts
from heartcase.pipeline.formats.read_scan import LabelVolume, read_labels
from heartcase.pipeline.formats.volumes.raw_volume import placed
from heartcase.pipeline.markers.marker_help import AutomaticMarkers, label_cores
from heartcase.pipeline.markers.naming import Naming, called, label_lookup, left_out, listed, rank_by_label, value_of
from heartcase.pipeline.markers.overlaps import file_over_file, overlap_warnings
from heartcase.pipeline.markers.paint import pull_nearest
from heartcase.pipeline.markers.strokes import Clipping, paint_strokes, rasterise_strokes, stroke_voxels, without_erased
from heartcase.pipeline.warnings import CaseWarning, note
from heartcase.schemas.arrays import Float64, UInt8, UInt16
from heartcase.schemas.errors import MarkerError, Problem
from heartcase.schemas.geometry import Geometry
from heartcase.schemas.labels import BACKGROUND, LabelTable
from heartcase.schemas.recipe.recipe import MarkerFile
from heartcase.schemas.recipe.settings import Stroke

__all__ = [
    "StatedMarkers",
    "check_markers",
    "load_markers",
    "load_segmentation",
    "rasterise_strokes",
    "resample_labels",
    "stated_markers",
    "stroke_voxels",
]

POINT_LIST_SUFFIXES = (".mrk.json", ".json")


def load_markers(
    recipe_markers: Sequence[MarkerFile],
    strokes: Sequence[Stroke],
    table: LabelTable,
    geometry: Geometry,
    directory: Path,
    *,
    scan: Scan | None = None,
    automatic: Collection[str] = (),
    whole: Geometry | None = None,
) -> Markers:
    """Gather all markers of a recipe.

    Marker files come first, in their order, then the strokes; later ones paint over earlier ones. In a label volume 0
    means that nothing is marked; a value or segment that is mapped to the background's name marks background. Of a file
    with ``core_mm`` the cores are taken, see :func:`heartcase.pipeline.markers.marker_help.label_cores`.

    Parameters
    ----------
    recipe_markers
        Label volumes, folders of parts (.stl) and point lists. A segment, part or list is found by ``names``, then by
        the label or synonym that it is named like, then by its SNOMED CT code; a volume without segments by ``names``
        and ``convention``, or, where neither is given, by the values of the table.
    strokes
        Strokes of the recipe.
    table
        Label table.
    geometry
        The scan's lattice. A label volume on another lattice gives each voxel the label at its centre.
    directory
        Where relative paths start.
    scan, automatic
        The scan, and which background the program marks on it under all of these: see
        :class:`heartcase.pipeline.markers.marker_help.AutomaticMarkers`.
    whole
        Lattice of the whole scan, where ``geometry`` is that of its region of interest: what is marked outside the
        region but in the scan is cut off, with a warning.

    Returns
    -------
    Markers
        On ``geometry``. Warnings say what was cut off, and what overlaps in marker files.

    Raises
    ------
    MarkerError
        With every file that cannot be read, every name that is no label, and every marker that lies outside the scan.
    """
    stated = stated_markers(recipe_markers, strokes, table, geometry, directory, whole=whole)
    if automatic and scan is not None:
        return replace(AutomaticMarkers(scan, automatic, stated.labels).markers, warnings=stated.warnings)
    return Markers(labels=without_erased(stated.labels), geometry=geometry, warnings=stated.warnings)


@dataclass(frozen=True)
class StatedMarkers:
    """What marker files and strokes say, before the program marks anything."""

    labels: UInt8
    """Of each voxel, shape [z, y, x]: a label, 255 where nothing is said, or
    :data:`heartcase.pipeline.markers.marker_help.ERASED` where an eraser passed last."""
    warnings: tuple[CaseWarning, ...]
    """What a file marks that may not be meant, in plain words."""


def stated_markers(
    recipe_markers: Sequence[MarkerFile],
    strokes: Sequence[Stroke],
    table: LabelTable,
    geometry: Geometry,
    directory: Path,
    *,
    whole: Geometry | None = None,
) -> StatedMarkers:
    """What marker files and strokes say of each voxel; arguments and errors are those of :func:`load_markers`."""
    warnings: list[CaseWarning] = []
    labels = np.full(geometry.shape, UNMARKED, dtype=np.uint8)
    problems: list[Problem] = []
    for number, file in enumerate(recipe_markers, start=1):
        place = f"markers[{number}]"
        try:
            path = directory / file.path
            if path.name.lower().endswith(POINT_LIST_SUFFIXES):
                if file.core_mm is not None:
                    raise MarkerError("points have no core: leave core_mm out, radius_mm is the dab around each point")
                painted, told = _painted_points(path, file, table, geometry, place, whole)
            else:
                painted, told = _painted_volume(path, file, table, geometry, place, whole)
            warnings += [*told, *file_over_file(labels, painted, table, geometry, place)]
            np.copyto(labels, painted, where=painted != UNMARKED)
            if file.background:
                warnings += _taken_for_background(painted, place, table)
        except MarkerError as error:
            problems += placed(error, place, MarkerError).problems
    try:
        warnings += paint_strokes(labels, strokes, table, Clipping(geometry, whole))
    except MarkerError as error:
        problems += error.problems
    if problems:
        raise MarkerError(problems)
    return StatedMarkers(labels, tuple(warnings))


def _taken_for_background(painted: UInt8, place: str, table: LabelTable) -> list[CaseWarning]:
    """A warning where a draft that marks background knows nothing of some structures: it takes them for background."""
    present = set(np.unique(painted).tolist())
    absent = [label.name for label in table if label.value not in present and label.value != BACKGROUND]
    if not absent:
        return []
    return [
        CaseWarning(
            f"{place} holds no {', '.join(absent)}, and with background = true it marks as background what it holds no "
            "label for: where this heart has one of these, paint it, also over the middle of it"
        )
    ]


def check_markers(markers: Markers, table: LabelTable, *, automatic: Collection[str] = ()) -> None:
    """Refuse markers that cannot make a case, before anything long is computed.

    Parameters
    ----------
    markers
        All markers.
    table
        Label table.
    automatic
        Which background the program was to mark: then the words say why it did not.

    Raises
    ------
    MarkerError
        Nothing is marked as background, or nothing that is marked is tissue or grows a wall; both at once.
    """
    marked = set(np.unique(markers.labels).tolist()) - {UNMARKED}
    problems = []
    if automatic and not marked - {BACKGROUND}:
        message = "nothing of the heart is marked, so the program cannot tell what is not heart: mark the heart first"
        problems.append(Problem("segment.automatic", message))
    if BACKGROUND not in marked:
        why = ", and the program found nothing that is surely not heart" if automatic else ""
        problems.append(
            Problem("markers", f"nothing is marked as background{why}: mark some of what is not heart, all around it")
        )
    if not any(table[value].role.is_tissue or table[value].wall_thickness_mm > 0.0 for value in marked):
        unmarked = ", ".join(label.name for label in table if label.value not in marked)
        problems.append(
            Problem(
                "markers",
                "no marked label is tissue or grows a wall: mark the myocardium, or give a marked cavity a "
                f"wall_thickness_mm (without a marker so far: {unmarked})",
            )
        )
    if problems:
        raise MarkerError(problems)


def load_segmentation(
    path: Path | str,
    names: Mapping[str, str],
    table: LabelTable,
    geometry: Geometry | None,
    *,
    convention: str | None = None,
    others: str = "refuse",
    order: Sequence[str] = (),
) -> Segmentation:
    """Load a finished segmentation, which is taken as it is.

    Parameters
    ----------
    path
        Label volume or DICOM SEG, see :func:`heartcase.pipeline.formats.read_scan.read_labels`; or folder of closed
        .stl parts, see :func:`heartcase.pipeline.formats.labels.stl_parts.read_parts`.
    names
        Name of a segment or part, or value, in the file -> label name. What is not in here is found by the label or
        synonym that it is named like, then by its SNOMED CT code. In a file without segments by ``convention``, or,
        where neither is given, by its value in the table.
    table
        Label table.
    geometry
        The scan's lattice; None keeps the file's own, which parts do not have.
    convention
        Key of :data:`heartcase.schemas.terms.CONVENTIONS`: what the values of a file without segments stand for.
    others
        What is no label: ``refuse`` the file, or ``ignore`` it.
    order
        Label names from the lowest to the topmost, where segments or parts overlap; the others lie below, in the file's
        order.

    Returns
    -------
    Segmentation
        Each voxel has the label at its centre; outside the file, and where it holds 0, is background. A segment named
        like a wall that will be grown is left out. ``warnings`` says so, and what overlaps.

    Raises
    ------
    MarkerError
        The file cannot be read, holds names that are no labels, or it or one of its structures lies outside the scan.
    """
    place = "segmentation"
    try:
        naming = Naming(names, convention, others, leaves_out_walls=True, order=order)
        volume = _finished(Path(path), geometry, naming, table)
        lookup = label_lookup(volume, naming, table)
        geometry = geometry or volume.geometry
        values = resample_labels(volume, geometry)
    except MarkerError as error:
        raise placed(error, place, MarkerError) from None
    if not values.any():
        reason = "lies outside the scan: was it made on another scan?" if volume.marks_anything else "holds no label"
        raise MarkerError(f"the segmentation {reason}", place=place)
    lost = [value for value in _lost(volume, values) if lookup.values[value] not in (UNMARKED, BACKGROUND)]
    if lost:
        raise MarkerError(
            f"{called(volume, lost)} would vanish: they lie outside the scan or its region of interest, others cover "
            'them, or they are thinner than its voxels. Correct them, or map them to "background" under names',
            place=place,
        )
    labels = np.where(lookup.values == UNMARKED, BACKGROUND, lookup.values).astype(np.uint8)[values]
    overlaps = overlap_warnings(volume, lookup.values, table, place)
    warnings = (*volume.warnings, *overlaps, *_walls_left_out(lookup.walls))
    return Segmentation(labels=labels, geometry=geometry, table=table, warnings=warnings)


def _walls_left_out(walls: Sequence[str]) -> tuple[CaseWarning, ...]:
    if not walls:
        return ()
    which = f"the {walls[0]} is" if len(walls) == 1 else f"{', '.join(walls)} are"
    return (
        note(
            f"{which} not taken from the finished segmentation but grown again: what was painted there is not used; "
            "to change a wall, change its cavity, or wall_thickness_mm of its label"
        ),
    )


def _finished(path: Path, geometry: Geometry | None, naming: Naming, table: LabelTable) -> LabelVolume:
    choice = left_out(naming, table), rank_by_label(naming, table)
    if not holds_parts(path):
        return read_labels(path, geometry, *choice)
    if geometry is None:
        raise MarkerError("surfaces have no voxels of their own: give the scan that they were made on")
    return read_parts(path, geometry, *choice)


def resample_labels(volume: LabelVolume, geometry: Geometry) -> UInt8 | UInt16:
    """Label values on another lattice, by nearest neighbour: each voxel gets the value at its centre.

    Parameters
    ----------
    volume
        Label volume on its own lattice.
    geometry
        The wanted lattice.

    Returns
    -------
    ndarray
        Shape ``geometry.shape``, of the volume's type; 0 outside the volume. A centre halfway between two voxels
        takes the one with the higher index.
    """
    if volume.geometry.matches(geometry):
        return volume.values
    to_index = np.linalg.inv(volume.geometry.affine) @ geometry.affine
    return pull_nearest(volume.values, np.ascontiguousarray(to_index[:3]), geometry.shape)


def _painted_volume(
    path: Path, file: MarkerFile, table: LabelTable, geometry: Geometry, place: str, whole: Geometry | None
) -> tuple[UInt8, tuple[CaseWarning, ...]]:
    naming = Naming(file.names, file.convention, file.others, order=file.order)
    volume = _finished(path, geometry, naming, table)
    lookup = label_lookup(volume, naming, table).values
    values = resample_labels(volume, geometry)
    if not volume.marks_anything:
        raise MarkerError("the file marks nothing: paint in it, or leave it out")
    lost = [value for value in _lost(volume, values) if lookup[value] != UNMARKED]
    told = [*volume.warnings, *overlap_warnings(volume, lookup, table, place)]
    if lost and whole is not None and not whole.matches(geometry):
        in_scan = set(np.unique(resample_labels(volume, whole)).tolist())
        cut_off = [value for value in lost if value in in_scan]
        lost = [value for value in lost if value not in in_scan]
        if cut_off:
            told.append(
                CaseWarning(
                    f"{place}: {called(volume, cut_off)} lie outside the region of interest and are left out",
                    has_stated_grade=True,
                )
            )
    if lost:
        raise MarkerError(
            f"{called(volume, lost)} lie outside the scan or its region of interest, or are thinner than its voxels: "
            "check that they were painted on this scan, with a brush of a voxel's width or more"
        )
    draft = lookup[values]
    if file.core_mm is None:
        return draft, tuple(told)
    if file.background:
        # beyond the file's own border it says nothing
        says_something = resample_labels(replace(volume, values=np.ones_like(volume.values)), geometry) != 0
        draft[says_something & (values == 0)] = BACKGROUND
    return label_cores(draft, geometry, file.core_mm), tuple(told)


def _lost(volume: LabelVolume, values: UInt8 | UInt16) -> list[int]:
    """Values that the file marks something with, and that are not among those on the scan's lattice."""
    marked = {*np.unique(volume.values).tolist(), *volume.vanished}
    return sorted(marked - set(np.unique(values).tolist()) - {0})


def _painted_points(
    path: Path, file: MarkerFile, table: LabelTable, geometry: Geometry, place: str, whole: Geometry | None
) -> tuple[UInt8, tuple[CaseWarning, ...]]:
    labels = np.full(geometry.shape, UNMARKED, dtype=np.uint8)
    problems: dict[str, None] = {}
    clipping = Clipping(geometry, whole, "mark")
    for markup in read_point_lists(path):
        for line_called, title, polyline in _named_polylines(markup):
            value = next((v for name in title if (v := value_of(name, file.names, table)) is not None), None)
            if value is None:
                if file.others == "refuse":
                    problems[
                        f"the name of {line_called} is no label: rename it or its list, or map it under names "
                        f"({listed(table)})"
                    ] = None
                continue
            voxels = clipping.take(line_called, line_called, polyline, file.radius_mm)
            labels.reshape(-1)[voxels] = value
    refused = [*(Problem("", message) for message in problems), *clipping.problems("")]
    if refused:
        raise MarkerError(refused)
    if not clipping.count:
        raise MarkerError("the file marks nothing: set points in it, or leave it out")
    return labels, clipping.warnings(place)


def _named_polylines(markup: MarkupList) -> list[tuple[str, tuple[str, ...], Float64]]:
    """What messages call it, names to try in order (which no message may show), and the points that belong together."""
    common = (markup.name, markup.file_stem)
    if markup.is_line:
        return [(f"line {markup.number} of the file", common, markup.points_mm)]
    return [
        (
            f"point {number} of list {markup.number}",
            (label, label.rstrip("0123456789").rstrip(" -_"), *common),
            point[np.newaxis],
        )
        for number, label, point in zip(markup.numbers, markup.labels, markup.points_mm, strict=True)
    ]
