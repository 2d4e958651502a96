"""Moving an end marker that a person set a little off its vessel onto it, where it is clear which vessel is meant.

The disc is moved along its axis, to the middle of the lumen, and turned across it, by no more than its radius and 45
degrees. Where that finds no place, an end that the search finds (:mod:`heartcase.pipeline.vessel_ends.find_ends`)
within the same reach takes its place. Where two vessels, or two ends, are about as near, nothing is moved.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from heartcase.pipeline.data import Segmentation, VesselEnd
from heartcase.pipeline.vessel_ends.discs import Stumps, end_marker, is_clean, radii_for
from heartcase.pipeline.vessel_ends.lumen_sections import Lumen, Section, across, angle_between
from heartcase.pipeline.warning_words import sentence
from heartcase.schemas.arrays import Float64
from heartcase.schemas.labels import Label
from heartcase.schemas.recipe.settings import EndMarker

__all__ = ["advice_for", "moved_words", "snapped_end"]


TURN_DEGREES = 45.0
"""A disc is turned by no more than this."""
CLEARLY_NEARER = 2.0
"""Another lumen, or end, may be meant as well where it is no farther than so many times the nearest one."""
WIDTH_CHANGE = 2.2
"""A lumen whose section changes by more than this over 0.4 radii towards the heart is a chamber there."""
LEAST_ROUNDNESS = 0.3
REACH, WIDE_REACH = 2.0, 3.5
"""How far a section may reach, in radii of the marker; and where none is so small, as of a marker off its middle."""
WIDEST = 1.5
"""A lumen in the wider reach may have so many times the marker's radius: one much wider is not what it means."""
ADVICE_MM = 60.0
"""Ends that are farther away are not proposed in the place of one that was refused."""


def snapped_end(
    segmentation: Segmentation, label: Label, end: EndMarker, stumps: Stumps, found: Sequence[VesselEnd]
) -> EndMarker | None:
    """The end marker moved onto the vessel that is meant.

    Parameters
    ----------
    segmentation
        Labels.
    label
        The vessel's label.
    end
        A marker that does not cut it.
    stumps
        What cuts leave behind their discs.
    found
        Ends of the label that the search finds.

    Returns
    -------
    EndMarker or None
        It cuts the vessel and nothing else of the label; None where there is no such place within the marker's radius
        and 45 degrees, or where it is not clear which vessel is meant.
    """
    lumen = Lumen.of(segmentation.labels == label.value, segmentation.geometry)
    position, axis = np.array(end.position_mm), np.array(end.axis) / np.linalg.norm(end.axis)
    step = 0.5 * max(segmentation.geometry.spacing_mm)
    count = int(end.radius_mm / step)
    if not _is_ambiguous(lumen.section(position, axis, REACH * end.radius_mm), step):
        for number in sorted(range(-count, count + 1), key=lambda n: (abs(n), n)):
            at = position + number * step * axis
            section = across(lumen, at, axis, REACH * end.radius_mm)
            if section is None:
                section = across(lumen, at, axis, WIDE_REACH * end.radius_mm)
                if section is not None and section.radius_mm > WIDEST * end.radius_mm:
                    continue
            if section is None or not _fits(lumen, section, end):
                continue
            for radius in _radii(section, end, stumps.wall_mm(label), stumps, 2.0 * step):
                moved = _marker(end, section, radius)
                if is_clean(segmentation, moved, label, stumps):
                    return moved
    return _nearest_end(end, found)


def _is_ambiguous(section: Section | None, step_mm: float) -> bool:
    return section is not None and section.rival_mm <= CLEARLY_NEARER * section.away_mm + step_mm


def _fits(lumen: Lumen, section: Section, end: EndMarker) -> bool:
    """Whether a section lies within the marker's reach, and the lumen is a tube there."""
    if np.linalg.norm(section.middle - np.array(end.position_mm)) > end.radius_mm:
        return False
    if angle_between(section.axis, np.array(end.axis)) > TURN_DEGREES or section.roundness < LEAST_ROUNDNESS:
        return False
    at = section.middle - 0.4 * section.radius_mm * section.axis
    before = lumen.section(at, section.axis, 4.0 * section.radius_mm)
    if before is None or not before.is_whole:
        return False
    ratio = before.area_mm2 / section.area_mm2
    return bool(1.0 / WIDTH_CHANGE <= ratio <= WIDTH_CHANGE)


def _radii(section: Section, end: EndMarker, wall_mm: float, stumps: Stumps, voxel_mm: float) -> tuple[float, ...]:
    """Radii to try: the marker's own where the lumen and its wall are inside, then those for the lumen."""
    wanted = radii_for(section.extent_mm, wall_mm, stumps, voxel_mm)
    return (*([end.radius_mm] if end.radius_mm >= wanted[-1] else []), *wanted)


def _marker(end: EndMarker, section: Section, radius_mm: float) -> EndMarker:
    x, y, z = (round(float(v), 1) + 0.0 for v in section.middle)
    a, b, c = (round(float(v), 3) + 0.0 for v in section.axis)
    return EndMarker(label=end.label, position_mm=(x, y, z), axis=(a, b, c), radius_mm=round(float(radius_mm), 1))


def _nearest_end(end: EndMarker, found: Sequence[VesselEnd]) -> EndMarker | None:
    """The end that is within the marker's reach, unless another one is about as near."""
    position, axis = np.array(end.position_mm), np.array(end.axis)
    near = sorted(
        (float(np.linalg.norm(np.array(one.position_mm) - position)), number)
        for number, one in enumerate(found)
        if not one.is_open and angle_between(np.array(one.axis), axis) <= TURN_DEGREES
    )
    if not near or near[0][0] > end.radius_mm:
        return None
    if len(near) > 1 and near[1][0] <= CLEARLY_NEARER * near[0][0]:
        return None
    return end_marker(found[near[0][1]]).model_copy(update={"label": end.label})


def moved_words(end: EndMarker, moved: EndMarker) -> str:
    """What was done to a marker, with the numbers that it has now."""
    away = float(np.linalg.norm(np.subtract(moved.position_mm, end.position_mm)))
    turn = angle_between(np.array(moved.axis), np.array(end.axis))
    return sentence(
        "end-moved",
        mm=f"{away:.1f}",
        degrees=f"{turn:.0f}",
        radius=f"{moved.radius_mm:g}" if moved.radius_mm != end.radius_mm else None,
        numbers=_numbers(moved),
    )


def advice_for(segmentation: Segmentation, label: Label, end: EndMarker, found: Sequence[VesselEnd]) -> str:
    """What to do about a marker that does not cut its vessel: the nearest lumen, and the numbers that would do.

    Parameters
    ----------
    segmentation
        Labels; there is some of the label.
    label
        The vessel's label.
    end
        The marker.
    found
        Ends of the label that the search finds.
    """
    index = np.argwhere(segmentation.labels == label.value)
    points = segmentation.geometry.index_to_world(index[:, ::-1])
    away = np.linalg.norm(points - np.array(end.position_mm), axis=1)
    nearest = int(away.argmin())
    spacing = max(segmentation.geometry.spacing_mm)
    where = (
        "position_mm lies in its lumen"
        if away[nearest] <= spacing
        else f"its nearest lumen is {away[nearest]:.1f} mm from position_mm, at {_point(points[nearest])} mm"
    )
    ends = sorted(
        (float(np.linalg.norm(np.subtract(one.position_mm, end.position_mm))), number)
        for number, one in enumerate(found)
    )
    if not ends or ends[0][0] > ADVICE_MM:
        return (
            f"{where}; no end of it was found within {ADVICE_MM:.0f} mm: move the marker onto the vessel, with the "
            "axis along it and radius_mm more than its outer radius, or add a stroke to the vessel"
        )
    distance, number = ends[0]
    one = found[number]
    if one.is_open:
        return (
            f"{where}; the end nearest to it, {distance:.1f} mm away at {_point(one.position_mm)} mm, is open at the "
            "face of the scan or region already: remove this end marker, if that is the one you mean"
        )
    return f"{where}; this end of it, {distance:.1f} mm away, would do: {_numbers(end_marker(one))}"


def _numbers(end: EndMarker) -> str:
    position, axis = (", ".join(f"{v:g}" for v in vector) for vector in (end.position_mm, end.axis))
    return f"position_mm = [{position}], axis = [{axis}], radius_mm = {end.radius_mm:g}"


def _point(point: Sequence[float] | Float64) -> str:
    return "(" + ", ".join(f"{v:.1f}" for v in point) + ")"
