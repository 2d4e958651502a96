"""The commented starter recipe for a scan."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any

from heartcase.pipeline.bundle.case_id import made_up_case_id
from heartcase.pipeline.formats.read_scan import read_scan
from heartcase.pipeline.markers.placeholders import StarterPlaces
from heartcase.pipeline.warnings import CaseWarning
from heartcase.schemas.errors import UsageError
from heartcase.schemas.files import atomic_write
from heartcase.schemas.labels import LabelTable, default_label_table
from heartcase.schemas.recipe.recipe import parse_recipe
from heartcase.schemas.toml import toml_string, toml_value

__all__ = ["starter_recipe", "write_recipe"]


def write_recipe(
    scan: Path,
    out: Path,
    *,
    name: str | None = None,
    choice: dict[str, Any] | None = None,
    force: bool = False,
    with_examples: bool = True,
) -> tuple[CaseWarning, ...]:
    """Read a scan and write a commented recipe for it; what is to be known of the scan.

    Parameters
    ----------
    scan
        A scan's file, or a folder of DICOM files.
    out
        The recipe's file.
    name
        Name of the case; made up when left out.
    choice
        What chooses among images, as of ``[scan]``.
    force
        Replace a recipe that is there.
    with_examples
        Write two example strokes, which are to be moved.

    Raises
    ------
    HeartcaseError
        There is a recipe already, or the scan cannot be read.
    """
    if out.exists() and not force:
        raise UsageError("there is already a recipe: choose another --out, or give --force", place=str(out))
    choice = choice or {}
    volume = read_scan(scan, **choice)
    relative = Path(os.path.relpath(scan.resolve(), out.resolve().parent)).as_posix()
    places = StarterPlaces.of(volume.geometry)
    text = starter_recipe(
        name=f"case-{made_up_case_id('', volume.values_sha256)[3:7].lower()}" if name is None else name,
        scan_path=relative,
        choice=choice,
        center_mm=places.center_mm,
        extent_mm=places.extent_mm,
        modality=volume.modality,
        with_examples=with_examples,
    )
    parse_recipe(text, needs_markers=with_examples)
    atomic_write(out, text.encode())
    return volume.warnings


def _label_lines(table: LabelTable) -> str:
    lines = []
    for label in table:
        if label.value == 0:
            continue
        lines += [
            "[[labels]]",
            f"value = {label.value}",
            f"name = {toml_string(label.name)}",
            f"role = {toml_string(label.role.value)}",
            f"colour = {toml_string(label.colour)}",
        ]
        if label.wall_thickness_mm:
            lines.append(f"wall_thickness_mm = {label.wall_thickness_mm}")
        if label.snomed:
            lines.append(f"snomed = {toml_string(label.snomed)}")
        lines.append("")
    return "\n".join(lines)


def starter_recipe(
    *,
    name: str,
    scan_path: str,
    choice: dict[str, Any],
    center_mm: tuple[float, ...],
    extent_mm: tuple[float, ...],
    modality: str,
    with_examples: bool = True,
) -> str:
    """Text of a commented recipe for a scan with this centre and extent (mm, LPS), read with this choice."""
    parts = (
        _scan_part(name, scan_path, choice, center_mm, extent_mm, modality),
        _marker_part(center_mm, extent_mm, with_examples),
        _anatomy_part(center_mm),
        _wall_part(center_mm),
        _model_part(center_mm),
        "# The labels. wall_thickness_mm grows a wall around a cavity whose own wall the scan does not show.\n",
        _label_lines(default_label_table()),
    )
    return "".join(parts)


def _scan_part(
    name: str,
    scan_path: str,
    choice: dict[str, Any],
    center_mm: tuple[float, ...],
    extent_mm: tuple[float, ...],
    modality: str,
) -> str:
    """What the case is called, what it holds, and which scan it is made from."""
    choice_lines = "".join(f"{key} = {toml_value(value)}\n" for key, value in choice.items())
    modality_line = "" if modality in ("CT", "MR") else '# modality = "MR"   # or "CT": the file does not say it\n'
    return f"""\
# A heartcase recipe: with the scan it says everything that makes the case.
# Build it with   heartcase build THIS_FILE     Check it with   heartcase validate THIS_FILE
# Paint on it in a viewer with   heartcase paint THIS_FILE     Where to paint more says   heartcase suggest THIS_FILE
# Points are in patient space: x to the left, y to the back, z to the head (LPS), in mm.

heartcase_recipe = 1
name = {toml_string(name)}   # never the patient's name: it is on every output
# What the case holds beside the simulation grid. What the scene does not need is not made.
parts = ["surface", "render", "picking", "labels"]

[scan]   # modality: {modality}
path = {toml_string(scan_path)}   # relative to this file; write folders with /
{choice_lines}{modality_line}
# The heart alone makes a smaller and faster case. The box lies along the scan's own axes.
# The whole scan: center_mm = {list(center_mm)}, size_mm = {list(extent_mm)}
# [region]
# center_mm = {list(center_mm)}
# size_mm = {[min(v, 150.0) for v in extent_mm]}

"""


def _marker_part(center_mm: tuple[float, ...], extent_mm: tuple[float, ...], with_examples: bool) -> str:
    """How the scan is smoothed and segmented, and the markers."""
    examples = f"""\
# These two are examples and stand for nothing in the scan: they are refused until you move or remove them.
[[strokes]]
label = "left ventricle"
radius_mm = 2.0
points_mm = [{list(center_mm)}]     # an example: this is only the middle of the scan

[[strokes]]
label = "background"
radius_mm = 2.0
points_mm = [{[round(center_mm[0] - 0.45 * extent_mm[0], 1), *center_mm[1:]]}]     # an example

"""
    if not with_examples:
        examples = "\n"
    return f"""\
[filter]
iterations = 5          # more smooths more
# conductance = 1.0     # lower keeps weaker edges; left out, it follows from the scan's own noise

[segment]
method = "watershed"    # or "threshold" (specimens), or "labels" (a finished segmentation: file = "...")
# automatic = ["background", "lung"]     # the program marks what is surely not heart, under your markers

# Markers. Paint them in 3D Slicer or ITK-SNAP and name the file here ...
# [[markers]]
# path = "markers.seg.nrrd"       # segments named like the labels below; or .nii.gz, .nrrd, .mrk.json
# names = {{ "Segment_1" = "left ventricle", "Segment_2" = "background" }}     # where the names differ
# names = {{ "1" = "left ventricle", "10" = "background" }}      # a .nii.gz has numbers; 0 means: not marked

# ... or start from a draft (a network's labels, another tool's): only what lies deep inside its structures counts ...
# [[markers]]
# path = "draft.nii.gz"
# convention = "totalsegmentator-heartchambers"     # what its values stand for; or names, as above
# core_mm = 3.0           # how deep
# background = true       # where the draft holds 0 is background, as far from every structure

# ... or write strokes: a round brush along a line. Mark every structure, and what is not heart as background.
{examples}# An eraser: it takes away what was marked there before.
# [[strokes]]
# erase = true
# radius_mm = 2.0
# points_mm = [{list(center_mm)}]

"""


def _anatomy_part(center_mm: tuple[float, ...]) -> str:
    """Ends of vessels, edits and landmarks."""
    return f"""\
# NEEDED for every vessel that ends inside the scan: where it is cut open. Without it the vessel becomes a closed sac.
# The program finds the ends when [walls] below says find_ends = true; look at them in the report. Or let
#   heartcase suggest THIS_FILE --ends --write
# write them here, to be changed, or write your own. The axis points out of the heart; the tissue at the cut is held.
# [[ends]]
# label = "aorta"
# position_mm = {list(center_mm)}
# axis = [0.0, 0.0, 1.0]
# radius_mm = 20.0

# A hole to make, a hole to close:
# [[edits]]
# kind = "septal_defect"          # or "close_defect", "add", "remove"
# position_mm = {list(center_mm)}
# diameter_mm = 8.0
# axis = [1.0, 0.0, 0.0]

# Named places. With apex and the middles of both valves the report's cuts are exact; scripts of the simulator grab a
# place by its name; a ring named "ventricular septal defect" tells that a hole is the patient's own.
# [[landmarks]]
# name = "apex"           # the tip of the left ventricle, on its outside
# kind = "point"          # or "ring", "polyline"
# points_mm = [{list(center_mm)}]
# [[landmarks]]
# name = "mitral valve"   # and "tricuspid valve"
# kind = "point"
# points_mm = [{list(center_mm)}]

"""


def _wall_part(center_mm: tuple[float, ...]) -> str:
    """Walls that the scan does not show."""
    return f"""\
# Where the outlines of two cavities touch that a heart does not join (the atria, an artery and an atrium, ...), a wall
# is grown between them. A hole that the patient has there must be told: by a landmark named "... defect", by a stroke
# of each of the two that run into each other in it, or by an edit septal_defect.
[walls]
septa = "grown"          # or "as segmented": no such wall
# find_ends = true       # find where vessels end, and cut them open there
# connected = [["right atrium", "left atrium"]]     # these two are one: no wall between them

# [[walls.septum]]        # how thick, where it should not follow from the size of the heart
# between = ["aorta", "left atrium"]
# thickness_mm = 1.5

# A wall that is not equally thick everywhere, instead of the one wall_thickness_mm of its label:
# [[walls.thickness]]
# label = "aorta"
# kind = "centreline"     # or "positions"
# points_mm = [{list(center_mm)}, {[*center_mm[:2], round(center_mm[2] + 20.0, 1)]}]
# thickness_mm = [2.0, 1.5]

"""


def _model_part(center_mm: tuple[float, ...]) -> str:
    """The simulation grid, the surface, the materials and what is held."""
    return f"""\
[grid]
node_count = 30000       # or cell_mm = 2.5

[surface]
triangle_count = 80000
normal_map_size = 1024

[materials]
youngs_modulus_kpa = 30.0
density_kg_m3 = 1060.0

# Tissue to be held fixed beside that. What the edge of the scan or an end cuts is held anyway; something must be held.
# [[pins]]
# position_mm = {list(center_mm)}
# radius_mm = 10.0

"""
