"""Where vessels end, from the true labels or from a segmentation of the noisy scan, against the phantom's own ends.

``skeleton`` thins each label to a line (Lee, Kashyap, Chu, CVGIP: Graphical Models and Image Processing 56, 1994, doi
10.1006/cgip.1994.1042), as centreline tools do: its ends, the direction of its last 5 mm, and the distance from the
label's border 5 mm before the end.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import edt
import numpy as np
from scipy.ndimage import convolve
from skimage.morphology import skeletonize

from benchmarks.phantom_inputs import phantom_inputs
from heartcase.phantom.anatomy.heart import HeartPhantom
from heartcase.pipeline.data import Segmentation
from heartcase.pipeline.image.filter_scan import filter_scan
from heartcase.pipeline.vessel_ends.discs import Stumps
from heartcase.pipeline.vessel_ends.find_ends import find_ends
from heartcase.pipeline.vessel_ends.lumen_sections import angle_between
from heartcase.pipeline.walls.grow_walls import resolve_walls
from heartcase.pipeline.watershed.segment_scan import segment_scan
from heartcase.schemas.arrays import Float64
from heartcase.schemas.recipe.heart_form import HeartForm
from heartcase.schemas.recipe.settings import FilterSettings, SegmentSettings, WallsSettings

LAST_MM = 5.0
"""Stretch of the skeleton that tells a direction."""
NEAR_MM = 15.0
"""What is farther from every true end is none. A segmentation may follow a vessel beyond its end, or stop before it."""
BEYOND_VALVES = ("aorta", "pulmonary artery", "superior vena cava", "inferior vena cava", "morphologically left atrium")
"""Labels that have ends."""


@dataclass(frozen=True)
class Inputs:
    """A segmentation, and the heart that it is of."""

    phantom: HeartPhantom
    segmentation: Segmentation


@dataclass(frozen=True)
class End:
    """An end as a method tells it."""

    label: str
    position: Float64
    axis: Float64
    lumen_mm: float


def prepare(params: dict[str, Any]) -> Inputs:
    labels_from = params.pop("labels_from")
    if labels_from == "segmentation":
        source = phantom_inputs(params)
        filtered = filter_scan(source.scan, FilterSettings())
        segmentation = segment_scan(filtered, source.markers, SegmentSettings(), source.phantom.table)
        return Inputs(source.phantom, segmentation)
    spacing_mm, oblique = params.pop("spacing_mm"), params.pop("oblique", False)
    phantom = HeartPhantom.of_form(HeartForm(**params))
    geometry = phantom.scan_geometry(spacing_mm, oblique=oblique)
    indices = np.indices(geometry.shape).reshape(3, -1)[::-1].T
    labels = phantom.truth.label(geometry.index_to_world(indices)).reshape(geometry.shape)
    for label in phantom.truth.table:
        if label.wall_of is not None:
            labels[labels == label.value] = 0
    return Inputs(phantom, Segmentation(labels, geometry, phantom.table))


def heartcase(inputs: Inputs) -> list[End]:
    table, geometry = inputs.phantom.table.with_walls(), inputs.segmentation.geometry
    settings = resolve_walls(WallsSettings(), geometry, table)
    found = find_ends(inputs.segmentation, table, Stumps.of(settings, table, geometry.spacing_mm))
    return [
        End(end.label, np.array(end.position_mm), np.array(end.axis), end.lumen_radius_mm)
        for end in found.ends
        if not end.is_open
    ]


def skeleton(inputs: Inputs) -> list[End]:
    segmentation, geometry = inputs.segmentation, inputs.segmentation.geometry
    ends = []
    for name in BEYOND_VALVES:
        mask = segmentation.labels == segmentation.table[name].value
        depth = edt.edt(mask, anisotropy=geometry.spacing_mm[::-1])
        line = skeletonize(mask) > 0
        around = convolve(line.astype(np.uint8), np.ones((3, 3, 3), np.uint8), mode="constant")
        points = geometry.index_to_world(np.argwhere(line)[:, ::-1])
        for tip in np.argwhere(line & (around == 2)):
            position = geometry.index_to_world(tip[::-1])
            away = np.linalg.norm(points - position, axis=1)
            last = points[away <= LAST_MM]
            if len(last) < 2:
                continue
            axis = position - last.mean(axis=0)
            before = np.rint(geometry.world_to_index(last[np.argmax(away[away <= LAST_MM])])).astype(int)
            ends.append(End(name, position, axis, float(depth[tuple(before[::-1])])))
    return ends


METHODS = {"heartcase": heartcase, "skeleton": skeleton}


def errors(inputs: Inputs, output: list[End]) -> dict[str, float]:
    """How many of the true ends were found, how many others, and how far off those that were found are."""
    taken: dict[int, tuple[float, End]] = {}
    others = 0
    for end in output:
        distance, number = min(
            (float(np.linalg.norm(end.position - np.array(true.position_mm))), number)
            for number, true in enumerate(inputs.phantom.ends)
        )
        if distance > NEAR_MM or number in taken:
            others += 1
        if distance <= NEAR_MM and (number not in taken or distance < taken[number][0]):
            taken[number] = (distance, end)
    across, along, angles, radii = [], [], [], []
    for number, (_, end) in taken.items():
        true = inputs.phantom.ends[number]
        axis = np.array(true.axis) / np.linalg.norm(true.axis)
        offset = end.position - np.array(true.position_mm)
        along.append(abs(float(offset @ axis)))
        across.append(float(np.linalg.norm(offset - (offset @ axis) * axis)))
        angles.append(angle_between(end.axis, axis))
        radii.append(abs(end.lumen_mm - (true.radius_mm - 4.0 * inputs.phantom.scale - 1.0)))
    figures = {
        "ends found of 12 [1]": float(len(taken)),
        "ends that are none [1]": float(others),
    }
    for words, values in (
        ("across the vessel", across),
        ("along the vessel", along),
        ("lumen's radius", radii),
    ):
        figures[f"{words}, mean [mm]"] = float(np.mean(values)) if values else np.nan
        figures[f"{words}, worst [mm]"] = float(np.max(values)) if values else np.nan
    figures["axis, mean [degrees]"] = float(np.mean(angles)) if angles else np.nan
    figures["axis, worst [degrees]"] = float(np.max(angles)) if angles else np.nan
    return figures
