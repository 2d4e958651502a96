"""The recipe that builds a case from a synthetic scan of the phantom."""

from __future__ import annotations

from collections.abc import Iterable

from heartcase.phantom.heart import HeartPhantom
from heartcase.phantom.strokes import marker_strokes
from heartcase.schemas.labels import default_label_table

__all__ = ["recipe_text"]

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
    if phantom.table != default_label_table():
        lines += ["# Labels as usual, with the wall thicknesses (mm) of this heart."]
        for label in phantom.table:
            lines += ["[[labels]]", f"value = {label.value}", f'name = "{label.name}"', f'role = "{label.role.value}"']
            lines += [f'colour = "{label.colour}"']
            if label.wall_thickness_mm > 0.0:
                lines += [f"wall_thickness_mm = {label.wall_thickness_mm:g}"]
            if label.snomed is not None:
                lines += [f'snomed = "{label.snomed}"']
            lines += [""]
    lines += [
        "# Markers: round brush strokes along polylines, in mm (patient LPS: x left, y back, z head).",
        "# Along the middle of each cavity, in the middle of the left ventricular wall, and around the heart.",
    ]
    for stroke in marker_strokes(phantom):
        lines += ["[[strokes]]", f'label = "{stroke.label}"', f"radius_mm = {stroke.radius_mm:g}"]
        lines += ["points_mm = [", *_wrapped(_triple(point) for point in stroke.points_mm), "]", ""]
    lines += ["# Where vessels are cut off: behind such a disc there is no vessel, and its opening gets no wall."]
    for end in phantom.ends:
        lines += ["[[ends]]", f'label = "{end.label}"', f"position_mm = {_triple(end.position_mm)}"]
        lines += [f"axis = {_triple(end.axis)}", f"radius_mm = {end.radius_mm:g}", ""]
    lines += ["# Named places that go into the case."]
    for landmark in phantom.landmarks:
        lines += ["[[landmarks]]", f'name = "{landmark.name}"', f'kind = "{landmark.kind}"']
        lines += [f"points_mm = [{_triple(landmark.points_mm[0])}]", ""]
    return "\n".join(lines).rstrip("\n") + "\n"


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
