"""Septa thinner than the voxels: what stays open wrongly, what is kept of true defects, and how thick they are.

The phantom's atria, and its vessels and atria, lie 1 to 2 mm apart. Each label has a few short strokes, none of them
along a septum. A defect is marked by two strokes that run into each other through it. ``as_segmented`` grows no septa.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from heartcase.phantom.anatomy.heart import HeartPhantom
from heartcase.phantom.drawing.strokes import first_strokes
from heartcase.phantom.metrics import wall_thickness_error
from heartcase.phantom.scan.acquisition import acquire_ct, acquire_mri
from heartcase.pipeline.bundle.assembly import labels_of
from heartcase.pipeline.checks.openings import Verdict, find_openings
from heartcase.pipeline.data import Scan, Segmentation, Structures
from heartcase.pipeline.image.filter_scan import filter_scan
from heartcase.pipeline.markers.load_markers import load_markers
from heartcase.pipeline.mesh.build_surface import build_surface
from heartcase.pipeline.walls.grow_walls import grow_walls
from heartcase.pipeline.walls.septa import open_places
from heartcase.pipeline.watershed.segment_scan import segment_scan
from heartcase.schemas.recipe.edit_settings import SeptalDefect
from heartcase.schemas.recipe.heart_form import HeartForm
from heartcase.schemas.recipe.settings import (
    FilterSettings,
    SegmentSettings,
    SeptumThickness,
    Stroke,
    SurfaceSettings,
    WallsSettings,
)

SURFACE_M2 = {"infant": 0.23}
"""Body surface area of the hearts that have no fixed form of their own."""
LEFT_ATRIUM, RIGHT_ATRIUM, SUPERIOR_CAVA = 3, 4, 7
NAMES = ("morphologically left atrium", "morphologically right atrium")
THROUGH_MM = 8.0
"""How far a stroke through a defect begins from the middle of the septum."""
MARGIN_MM = 3.0
"""What lies nearer than this to where a septum ends is not measured."""


@dataclass(frozen=True)
class Inputs:
    """A segmentation by few strokes, and what is true of it."""

    phantom: HeartPhantom
    segmentation: Segmentation
    strokes: tuple[Stroke, ...]
    septum_mm: float
    defect: SeptalDefect | None


def prepare(params: dict[str, Any]) -> Inputs:
    params = {"size": "adult", "modality": "mri", "spacing_mm": 1.75, "strokes": 3, "seed": 1} | params
    phantom, defect = _phantom(params["size"], params["septum_mm"], params.get("defect_mm"))
    geometry = phantom.scan_geometry(params["spacing_mm"])
    acquire = acquire_mri if params["modality"] == "mri" else acquire_ct
    made = acquire(phantom, geometry, seed=params["seed"])
    scan = Scan(made.values, geometry, made.modality)
    plain, _ = _phantom(params["size"], None, None)
    strokes = (*first_strokes(plain, params["strokes"]), *_through(defect))
    markers = load_markers((), strokes, phantom.table, geometry, Path())
    segmentation = segment_scan(filter_scan(scan, FilterSettings()), markers, SegmentSettings(), phantom.table)
    return Inputs(phantom, segmentation, strokes, params["septum_mm"], defect)


def heartcase(inputs: Inputs) -> Structures:
    stated = SeptumThickness(between=NAMES, thickness_mm=inputs.septum_mm)
    places = open_places(inputs.strokes, (), inputs.phantom.table)
    return grow_walls(inputs.segmentation, WallsSettings(septum=(stated,)), inputs.phantom.ends, open_places=places)


def as_segmented(inputs: Inputs) -> Structures:
    return grow_walls(inputs.segmentation, WallsSettings(septa="as segmented"), inputs.phantom.ends)


METHODS = {"heartcase": heartcase, "as_segmented": as_segmented}


def errors(inputs: Inputs, output: Structures) -> dict[str, float]:
    """Openings that the heart has not, the defect against the true one, and the atrial septum's thickness."""
    openings = find_openings(output, labels_of(output), strokes=inputs.strokes)
    wrong = [one for one in openings if one.verdict is Verdict.UNEXPECTED]
    found = {
        "false openings [1]": float(len(wrong)),
        "false openings [mm²]": float(sum(one.area_mm2 for one in wrong)),
        "atrial septum open [mm²]": float(
            sum(one.area_mm2 for one in wrong if one.labels == (LEFT_ATRIUM, RIGHT_ATRIUM))
        ),
        "valves and veins open [1]": float(sum(one.verdict is Verdict.EXPECTED for one in openings)),
    }
    if inputs.defect is not None:
        kept = [one.area_mm2 for one in openings if one.verdict is Verdict.STATED]
        diameter = 2.0 * float(np.sqrt(sum(kept) / np.pi))
        found["defect's diameter, too wide by [mm]"] = diameter - inputs.defect.diameter_mm
    septa = {(one.first, one.second): one for one in output.grown_septa}
    septum = septa.get((LEFT_ATRIUM, RIGHT_ATRIUM))
    if septum is not None:
        surface = build_surface(output, SurfaceSettings(triangle_count=200_000, level_counts=()), render=False)
        beside = surface.triangle_tissue == septum.value
        # the left side as the outer surface, the right one as the inner
        sides = np.where(beside & (surface.triangle_label == septum.first), 0, 255).astype(np.uint8)
        sides[surface.triangle_label == septum.second] = septum.second
        error = wall_thickness_error(
            surface.vertices_mm,
            surface.triangles,
            sides,
            surface.triangle_tissue,
            cavity=septum.second,
            wall=septum.value,
            thickness_mm=inputs.septum_mm,
            margin_mm=MARGIN_MM,
        )
        if np.isfinite(error.mean_mm):
            found["atrial septum's thickness, mean [mm]"] = error.mean_mm
            found["atrial septum's thickness, 95% [mm]"] = error.percentile_95_mm
    return found


def _phantom(size: str, septum_mm: float | None, defect_mm: float | None) -> tuple[HeartPhantom, SeptalDefect | None]:
    kept = {"body_surface_m2": SURFACE_M2[size]} if size in SURFACE_M2 else {"size": size}
    phantom = HeartPhantom.of_form(HeartForm.model_validate(kept | {"septum_mm": septum_mm}))
    if defect_mm is None:
        return phantom, None
    defect = phantom.atrial_defect(defect_mm)
    return HeartPhantom.of_form(phantom.form, defects=[defect]), defect


def _through(defect: SeptalDefect | None) -> Iterator[Stroke]:
    """One stroke from each atrium, which meet in the middle of the hole, with a brush as wide as it."""
    if defect is None:
        return
    middle, axis = np.array(defect.position_mm), np.array(defect.axis)
    for name, side in zip(NAMES, (-1.0, 1.0), strict=True):
        points = (middle + side * THROUGH_MM * axis, middle)
        yield Stroke(
            label=name,
            radius_mm=0.5 * defect.diameter_mm,
            points_mm=tuple((float(x), float(y), float(z)) for x, y, z in points),
        )
