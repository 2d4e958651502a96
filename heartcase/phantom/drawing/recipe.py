"""The recipe that builds a case from a synthetic scan of the phantom."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from heartcase.phantom.anatomy.defects import mirrored_defect, place_defect
from heartcase.phantom.anatomy.heart import HeartPhantom
from heartcase.phantom.drawing.baffle_rings import baffle_rings
from heartcase.phantom.drawing.strokes import marker_strokes
from heartcase.phantom.drawing.surface_lines import coronary_landmarks, incision_landmark
from heartcase.schemas.labels import LabelTable, default_label_table
from heartcase.schemas.landmarks import Landmark
from heartcase.schemas.recipe.edit_settings import SeptalDefect
from heartcase.schemas.recipe.heart_form import Baffle
from heartcase.schemas.recipe.phantom_scan import PhantomScan

__all__ = ["drawn_part", "recipe_text"]

_WIDTH = 118


def recipe_text(phantom: HeartPhantom, *, name: str, scan_path: str, command: str, modality: str) -> str:
    """Commented recipe (TOML) for a scan of the phantom, with strokes for every label and all end markers.

    Parameters
    ----------
    phantom
        The heart.
    name
        Name of the case.
    scan_path
        Where the scan is, relative to the recipe.
    command
        The command that writes the scan: shown where the scan is missing.
    modality
        ``CT`` or ``MR``: a NIfTI file does not say it.
    """
    lines = [
        f"# A case from a synthetic scan of the {phantom.size} phantom: a heart of analytic shapes whose true labels",
        "# and distances are known at every point. Write the scan with:",
        f"#   {command}",
        "",
        "heartcase_recipe = 1",
        f'name = "{name}"',
        "",
        "[scan]",
        f'path = "{scan_path}"',
        f'modality = "{modality}"',
        f'origin = "{command}"',
        "",
    ]
    lines += [
        *_label_lines(phantom.table),
        *_stroke_lines(phantom),
        *_end_lines(phantom),
        *_landmark_lines((*phantom.landmarks, *coronary_landmarks(phantom))),
    ]
    return "\n".join(lines).rstrip("\n") + "\n"


def drawn_part(scan: PhantomScan) -> str:
    """What a program draws of a recipe whose scan is synthetic (TOML): markers, end markers, edits and landmarks.

    Landmarks are apex and valves, the planned incisions, and the courses of the coronary arteries. A specimen needs no
    markers; where its vessels are cut off it is held.

    Raises
    ------
    UsageError
        The heart has no place for a defect or an incision.
    """
    phantom = HeartPhantom.of_form(scan.heart)
    edits = [place_defect(one, phantom.twin.anatomy, phantom.scale) for one in scan.edited_defects]
    if scan.heart.is_mirrored:
        edits = [mirrored_defect(one) for one in edits]
    incisions = [incision_landmark(phantom, name) for name in scan.incisions]
    holes = [
        Landmark(
            name=f"{one.kind} defect",
            kind="ring",
            points_mm=(canal.position_mm,),
            axis=canal.axis,
            radius_mm=0.5 * canal.diameter_mm,
        )
        for one, canal in (
            *zip(scan.heart.defects, phantom.defects, strict=True),
            *zip(scan.edited_defects, edits, strict=True),
        )
    ]
    landmarks = (*phantom.landmarks, *holes, *incisions, *coronary_landmarks(phantom))
    lines: list[str] = []
    if scan.is_specimen:
        lines += ["# Where its vessels are cut off, the heart is held."]
        for end in phantom.ends:
            lines += ["[[pins]]", f"position_mm = {_triple(end.position_mm)}", f"radius_mm = {end.radius_mm:g}", ""]
    else:
        lines += [*_label_lines(_with_closed_ventricle(phantom.table)), *_stroke_lines(phantom), *_end_lines(phantom)]
    lines += [line for edit in edits for line in (_bored if scan.is_specimen else _defect_lines)(edit)]
    if scan.heart.baffle is not None:
        lines += _baffle_lines(phantom, scan.heart.baffle)
    return "\n".join([*lines, *_landmark_lines(landmarks)]).rstrip("\n") + "\n"


_LEFT_VENTRICLE, _LEFT_ATRIUM = "morphologically left ventricle", "morphologically left atrium"


def _label_lines(table: LabelTable) -> list[str]:
    lines: list[str] = []
    if table != default_label_table():
        lines += ["# Labels as usual, with the wall thicknesses (mm) of this heart."]
        for label in table:
            lines += ["[[labels]]", f"value = {label.value}", f'name = "{label.name}"', f'role = "{label.role.value}"']
            lines += [f'colour = "{label.colour}"']
            if label.wall_thickness_mm > 0.0:
                why = ""
                if label.name == _LEFT_VENTRICLE:
                    why = "  # only where no muscle lies beside its blood: at the mitral and the aortic valve"
                lines += [f"wall_thickness_mm = {label.wall_thickness_mm:g}{why}"]
            if label.snomed is not None:
                lines += [f'snomed = "{label.snomed}"']
            lines += [""]
    return lines


def _with_closed_ventricle(table: LabelTable) -> LabelTable:
    """A table whose left ventricle has a wall, as thin as the left atrium's.

    Beside its two valves it borders on tissue that is thinner than a voxel, which no scan shows.
    """
    thickness_mm = table[_LEFT_ATRIUM].wall_thickness_mm
    return LabelTable(
        labels=tuple(
            label.model_copy(update={"wall_thickness_mm": thickness_mm}) if label.name == _LEFT_VENTRICLE else label
            for label in table
        )
    )


def _stroke_lines(phantom: HeartPhantom) -> list[str]:
    lines = [
        "# Markers: round brush strokes along polylines, in mm (patient LPS: x left, y back, z head).",
        "# Along the middle of each cavity, in the middle of the left ventricular wall, and around the heart.",
    ]
    for stroke in marker_strokes(phantom):
        lines += ["[[strokes]]", f'label = "{stroke.label}"', f"radius_mm = {stroke.radius_mm:g}"]
        lines += [*_points(stroke.points_mm), ""]
    return lines


def _end_lines(phantom: HeartPhantom) -> list[str]:
    lines = ["# Where vessels are cut off: behind such a disc there is no vessel, and its opening gets no wall."]
    for end in phantom.ends:
        lines += ["[[ends]]", f'label = "{end.label}"', f"position_mm = {_triple(end.position_mm)}"]
        lines += [f"axis = {_triple(end.axis)}", f"radius_mm = {end.radius_mm:g}", ""]
    return lines


def _defect_lines(defect: SeptalDefect) -> list[str]:
    lines = ["[[edits]]", 'kind = "septal_defect"', f"position_mm = {_triple(defect.position_mm)}"]
    lines += [f"diameter_mm = {defect.diameter_mm:g}", f"axis = {_triple(defect.axis)}"]
    if defect.width_mm is not None and defect.long_axis is not None:
        lines += [f'shape = "{defect.shape}"', f"width_mm = {defect.width_mm:g}"]
        lines += [f"long_axis = {_triple(defect.long_axis)}"]
    return [*lines, f"length_mm = {defect.length_mm:g}", ""]


def _bored(defect: SeptalDefect) -> list[str]:
    """The same hole in a specimen, whose cavities have no names: muscle taken away along the canal."""
    axis, centre = np.array(defect.axis), np.array(defect.position_mm)
    half = 0.5 * defect.length_mm * axis
    ends = [tuple(round(float(v), 2) for v in point) for point in (centre - half, centre + half)]
    lines = ["[[edits]]", 'kind = "remove"', 'label = "myocardium"', 'into = "background"']
    return [*lines, f"radius_mm = {0.5 * defect.diameter_mm:g}", *_points(ends), ""]  # type: ignore[arg-type]


_BESIDE_BAFFLE = (
    "morphologically left ventricle",
    "morphologically right ventricle",
    "aorta",
    "morphologically left ventricular myocardium",
)
"""What the baffle is painted over near the outer wall: not the wall itself, or it would be seen through it."""
_SCAN_ERROR_MM = 2.0
"""How far from its true place a case may have the outer wall."""


def _baffle_lines(phantom: HeartPhantom, baffle: Baffle) -> list[str]:
    """The baffle's sheet, which no scan shows well, painted in rings around the tunnel."""
    lines = ["# The baffle, painted in rings around its tunnel; its leaks are left open."]
    radius = 0.5 * baffle.thickness_mm + 0.1
    taken = ["only_from = [", *_wrapped(f'"{name}"' for name in _BESIDE_BAFFLE), "]"]
    for ring, is_deep in baffle_rings(phantom, apart_mm=1.2 * radius, clear_mm=radius, deep_mm=radius + _SCAN_ERROR_MM):
        lines += ["[[edits]]", 'kind = "add"', 'label = "baffle"', *([] if is_deep else taken)]
        lines += [f"radius_mm = {radius:g}", *_points(ring), ""]
    return lines


def _landmark_lines(landmarks: Iterable[Landmark]) -> list[str]:
    lines = ["# Named places that go into the case."]
    for landmark in landmarks:
        lines += ["[[landmarks]]", f'name = "{landmark.name}"', f'kind = "{landmark.kind}"']
        if len(landmark.points_mm) == 1:
            lines += [f"points_mm = [{_triple(landmark.points_mm[0])}]"]
        else:
            lines += _points(landmark.points_mm)
        if landmark.axis is not None:
            lines += [f"axis = {_triple(landmark.axis)}"]
        if landmark.radius_mm is not None:
            lines += [f"radius_mm = {landmark.radius_mm:g}"]
        if landmark.depth_mm is not None:
            lines += [f"depth_mm = {landmark.depth_mm:g}"]
        lines += [""]
    return lines


def _points(points: Iterable[tuple[float, float, float]]) -> list[str]:
    return ["points_mm = [", *_wrapped(_triple(point) for point in points), "]"]


def _triple(point: tuple[float, float, float]) -> str:
    return "[" + ", ".join(str(float(value)) for value in point) + "]"


def _wrapped(items: Iterable[str]) -> list[str]:
    lines, line = [], ""
    for item in items:
        if line and len(line) + len(item) + 2 > _WIDTH:
            lines.append(line)
            line = ""
        line += ("  " if not line else " ") + item + ","
    return [*lines, line] if line else lines
