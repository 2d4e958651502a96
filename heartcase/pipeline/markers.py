"""Painted markers, from files and from strokes of the recipe, brought onto the scan's lattice."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
import numpy.typing as npt

from heartcase.pipeline.data import Markers, Segmentation
from heartcase.pipeline.formats.point_lists import MarkupList, read_point_lists
from heartcase.pipeline.formats.raw_volume import placed
from heartcase.pipeline.paint import paint_capsule, paint_passed_voxels, pull_nearest
from heartcase.pipeline.read import LabelVolume, read_labels
from heartcase.schemas.errors import MarkerError, Problem
from heartcase.schemas.geometry import Geometry
from heartcase.schemas.labels import BACKGROUND, LabelTable
from heartcase.schemas.recipe import MarkerFile
from heartcase.schemas.settings import Stroke

__all__ = ["check_markers", "load_markers", "load_segmentation", "rasterise_strokes", "resample_labels"]

UInt8 = npt.NDArray[np.uint8]
UNMARKED = Markers.UNMARKED
POINT_LIST_SUFFIXES = (".mrk.json", ".json")


def load_markers(
    recipe_markers: Sequence[MarkerFile],
    strokes: Sequence[Stroke],
    table: LabelTable,
    geometry: Geometry,
    directory: Path,
) -> Markers:
    """Gather all markers of a recipe.

    Marker files come first, in their order, then the strokes; later ones paint over earlier ones. In a label volume 0
    means that nothing is marked; a value or segment that is mapped to the background's name marks background.

    Parameters
    ----------
    recipe_markers
        Label volumes and point lists. Segment and list names are mapped through ``names``, then taken as label names,
        upper and lower case alike; a volume without segment names is mapped by value.
    strokes
        Strokes of the recipe.
    table
        Label table.
    geometry
        The scan's lattice. A label volume on another lattice gives each voxel the label at its centre.
    directory
        Where relative paths start.

    Returns
    -------
    Markers
        On ``geometry``.

    Raises
    ------
    MarkerError
        With every file that cannot be read, every name that is no label, and every marker that lies outside the scan.
    """
    labels = np.full(geometry.shape, UNMARKED, dtype=np.uint8)
    problems: list[Problem] = []
    for number, file in enumerate(recipe_markers, start=1):
        place = f"markers[{number}]"
        try:
            path = directory / file.path
            if path.name.lower().endswith(POINT_LIST_SUFFIXES):
                painted = _painted_points(path, file, table, geometry)
            else:
                painted = _painted_volume(path, file.names, table, geometry)
            np.copyto(labels, painted, where=painted != UNMARKED)
        except MarkerError as error:
            problems += placed(error, place, MarkerError).problems
    try:
        painted = rasterise_strokes(strokes, table, geometry)
        np.copyto(labels, painted, where=painted != UNMARKED)
    except MarkerError as error:
        problems += error.problems
    if problems:
        raise MarkerError(problems)
    return Markers(labels=labels, geometry=geometry)


def check_markers(markers: Markers, table: LabelTable) -> None:
    """Refuse markers that cannot make a case, before anything long is computed.

    Raises
    ------
    MarkerError
        Nothing is marked as background, or nothing that is marked is tissue or grows a wall; both at once.
    """
    marked = set(np.unique(markers.labels).tolist()) - {UNMARKED}
    problems = []
    if BACKGROUND not in marked:
        problems.append(
            Problem("markers", "nothing is marked as background: mark some of what is not heart, all around it")
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
    path: Path | str, names: Mapping[str, str], table: LabelTable, geometry: Geometry | None
) -> Segmentation:
    """Load a finished segmentation.

    Parameters
    ----------
    path
        Label volume; see :func:`heartcase.pipeline.read.read_labels`.
    names
        Segment name, or value, in the file -> label name; the same name (or value) when left out.
    table
        Label table.
    geometry
        The scan's lattice; None keeps the file's own.

    Returns
    -------
    Segmentation
        Each voxel has the label at its centre; outside the file, and where it holds 0, is background.

    Raises
    ------
    MarkerError
        The file cannot be read, holds names that are no labels, or lies outside the scan.
    """
    place = "segmentation"
    try:
        volume = read_labels(path)
        lookup = _lookup(volume, names, table)
        geometry = geometry or volume.geometry
        values = resample_labels(volume, geometry)
    except MarkerError as error:
        raise placed(error, place, MarkerError) from None
    if not values.any():
        reason = "lies outside the scan: was it made on another scan?" if volume.values.any() else "holds no label"
        raise MarkerError(f"the segmentation {reason}", place=place)
    lookup[0] = BACKGROUND
    return Segmentation(labels=lookup[values], geometry=geometry, table=table)


def resample_labels(volume: LabelVolume, geometry: Geometry) -> npt.NDArray[np.uint8] | npt.NDArray[np.uint16]:
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


def rasterise_strokes(strokes: Sequence[Stroke], table: LabelTable, geometry: Geometry) -> UInt8:
    """Paint strokes: a ball of the brush's radius swept along a polyline, in true mm.

    Parameters
    ----------
    strokes
        Painted in order, later ones over earlier ones.
    table
        Label table.
    geometry
        Lattice to paint on; oblique, anisotropic and left-handed ones are fine.

    Returns
    -------
    ndarray
        uint8, shape ``geometry.shape``: label value of each voxel whose centre is within the radius of the line, and
        of each voxel that the line itself passes (so that a thin brush leaves no gap, and radius 0 a line); 255
        elsewhere. What reaches out of the lattice is cut off.

    Raises
    ------
    MarkerError
        With every stroke whose label is not in the table or that lies wholly outside the scan.
    """
    labels = np.full(geometry.shape, UNMARKED, dtype=np.uint8)
    problems = []
    for number, stroke in enumerate(strokes, start=1):
        place = f"strokes[{number}]"
        value = _value_of(stroke.label, {}, table)
        if value is None:
            problems.append(Problem(place, f"there is no label {stroke.label!r} ({_listed(table)})"))
        elif not _paint(labels, np.array(stroke.points_mm), stroke.radius_mm, value, geometry):
            problems.append(
                Problem(place, _outside(np.array(stroke.points_mm), f"the stroke {stroke.label!r}", geometry))
            )
    if problems:
        raise MarkerError(problems)
    return labels


def _paint(labels: UInt8, points_mm: npt.NDArray[np.float64], radius_mm: float, value: int, geometry: Geometry) -> bool:
    """Paint one polyline; whether it marked anything."""
    index = geometry.world_to_index(points_mm)
    spacing = np.array(geometry.spacing_mm)
    painted = False
    for start, end in zip(index[: max(1, len(index) - 1)], index[1:] if len(index) > 1 else index, strict=True):
        if radius_mm > 0.0:
            painted |= bool(paint_capsule(labels, start, end, spacing, radius_mm, value))
        painted |= paint_passed_voxels(labels, start, end, value)
    return painted


def _painted_volume(path: Path, names: Mapping[str, str], table: LabelTable, geometry: Geometry) -> UInt8:
    volume = read_labels(path)
    lookup = _lookup(volume, names, table)
    values = resample_labels(volume, geometry)
    inside, present = set(np.unique(values).tolist()), set(np.unique(volume.values).tolist())
    if present == {0}:
        raise MarkerError("the file marks nothing: paint in it, or leave it out")
    lost = sorted(present - inside - {0})
    if lost:
        listed = ", ".join(repr(volume.names.get(value, str(value))) for value in lost)
        raise MarkerError(
            f"the markers {listed} lie outside the scan or its region of interest, or are thinner than its voxels: "
            "check that they were painted on this scan, with a brush of a voxel's width or more"
        )
    return lookup[values]


def _painted_points(path: Path, file: MarkerFile, table: LabelTable, geometry: Geometry) -> UInt8:
    labels = np.full(geometry.shape, UNMARKED, dtype=np.uint8)
    problems: dict[str, None] = {}
    for markup in read_point_lists(path):
        for title, polyline in _named_polylines(markup):
            value = next((v for name in title if (v := _value_of(name, file.names, table)) is not None), None)
            shown = next((name for name in title[:-1] if name), "(no name)")
            if value is None:
                problems[
                    f"{shown!r} is no label: rename the point or its list, or map it under names ({_listed(table)})"
                ] = None
            elif not _paint(labels, polyline, file.radius_mm, value, geometry):
                problems[_outside(polyline, f"the point or line {shown!r}", geometry)] = None
    if problems:
        raise MarkerError(Problem("", message) for message in problems)
    if (labels == UNMARKED).all():
        raise MarkerError("the file marks nothing: set points in it, or leave it out")
    return labels


def _named_polylines(markup: MarkupList) -> list[tuple[tuple[str, ...], npt.NDArray[np.float64]]]:
    """Names to try in order (the file's own last, which no message may show), and the points that belong together."""
    common = (markup.name, markup.file_stem)
    if markup.is_line:
        return [(common, markup.points_mm)]
    return [
        ((label, label.rstrip("0123456789").rstrip(" -_"), *common), point[np.newaxis])
        for label, point in zip(markup.labels, markup.points_mm, strict=True)
    ]


def _lookup(volume: LabelVolume, names: Mapping[str, str], table: LabelTable) -> UInt8:
    """Array that takes a value of the file to a label value; 0 goes to 255."""
    lookup = np.full(int(volume.values.max(initial=0)) + 1, UNMARKED, dtype=np.uint8)
    unknown = []
    for value in np.flatnonzero(np.bincount(volume.values.ravel())).tolist():
        if value == 0:
            continue
        name = volume.names.get(value)
        label = _value_of(name, names, table) if name is not None else None
        if label is None:
            label = _value_of(str(value), names, table, by_value=not volume.names)
        if label is None:
            unknown.append(f"segment {name!r}" if name is not None else f"value {value}")
        else:
            lookup[value] = label
    if unknown:
        raise MarkerError(
            f"the file holds what is no label: {', '.join(unknown)}; rename it, or map it under names "
            f"({_listed(table)})"
        )
    return lookup


def _value_of(name: str, names: Mapping[str, str], table: LabelTable, *, by_value: bool = False) -> int | None:
    """Label value of a name, mapped through ``names``; by value too where ``by_value``."""
    lowered = {" ".join(key.split()).lower(): target for key, target in names.items()}
    target = lowered.get(name.lower(), name)
    for label in table:
        if label.name.lower() == target.lower():
            return label.value
    if by_value and target.isdecimal() and int(target) in table:
        return int(target)
    return None


def _listed(table: LabelTable) -> str:
    return "labels: " + ", ".join(label.name for label in table)


def _outside(points_mm: npt.NDArray[np.float64], what: str, geometry: Geometry) -> str:
    corners = np.array([[i, j, k] for i in (0, 1) for j in (0, 1) for k in (0, 1)])
    reach = geometry.index_to_world(corners * np.array(geometry.size) - 0.5)
    bounds = ", ".join(
        f"{axis} {low:.1f} to {high:.1f}"
        for axis, low, high in zip("xyz", reach.min(axis=0), reach.max(axis=0), strict=True)
    )
    flipped = geometry.world_to_index(points_mm * (-1.0, -1.0, 1.0))
    is_flipped = bool(((flipped > -0.5) & (flipped < np.array(geometry.size) - 0.5)).all())
    remedy = "they seem to be RAS: change the sign of x and y" if is_flipped else "check its positions (LPS mm)"
    return f"{what} lies outside the scan or its region of interest, which reach over {bounds} mm: {remedy}"
