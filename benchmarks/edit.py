"""A septal defect in the true heart: made and evaluated on the scan's lattice, against the phantom with that hole.

``stock`` paints the canal into the label volume, voxel by voxel at their centres, as a general editor does. Diameters
and place are measured in the plane across the canal's middle, on points 0.05 mm apart: that of a circle of the hole's
area, and for a hole that is not round its extents along its two axes. Half a voxel is the bound.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from benchmarks.phantom_inputs import PhantomInputs, bare_truth, phantom_inputs
from heartcase.phantom.anatomy.heart import HeartPhantom
from heartcase.pipeline.data import Segmentation, Structures
from heartcase.pipeline.edits.apply_edits import apply_edits
from heartcase.pipeline.fields.reader import ownership_at_points, ownership_on_lattice
from heartcase.pipeline.walls.grow_walls import grow_walls
from heartcase.schemas.arrays import Bool, Float64, UInt8
from heartcase.schemas.recipe.edit_settings import SeptalDefect
from heartcase.schemas.recipe.settings import WallsSettings

STEP_MM = 0.05


@dataclass(frozen=True)
class Inputs:
    """The heart with walls, and the hole to make."""

    source: PhantomInputs
    structures: Structures
    defect: SeptalDefect
    labels: UInt8
    """True labels at the voxels, what is painted on by ``stock``."""


@dataclass(frozen=True)
class Edited:
    """What came out: structures, or voxels."""

    structures: Structures | None
    voxels: Bool
    """Tissue at the voxels."""


def prepare(params: dict[str, Any]) -> Inputs:
    septum, diameter = params.pop("septum"), params.pop("diameter_mm")
    shape = {key: params.pop(key) for key in ("shape", "width_mm", "long_axis") if key in params}
    source = phantom_inputs(params)
    heart = source.phantom
    defect = heart.ventricular_defect(diameter) if septum == "ventricular" else heart.atrial_defect(diameter)
    defect = SeptalDefect.model_validate(defect.model_dump() | shape)
    segmentation = Segmentation(bare_truth(source), source.truth.geometry, heart.table)
    return Inputs(source, grow_walls(segmentation, WallsSettings(), heart.ends), defect, source.truth.labels)


def heartcase(inputs: Inputs) -> Edited:
    edited = apply_edits(inputs.structures, (inputs.defect,))
    return Edited(edited, ownership_on_lattice(edited, inputs.structures.geometry).tissue_mm < 0.0)


def stock(inputs: Inputs) -> Edited:
    geometry = inputs.source.truth.geometry
    points = geometry.index_to_world(np.indices(geometry.shape).reshape(3, -1)[::-1].T)
    gap = points - np.array(inputs.defect.position_mm)
    axis = np.array(inputs.defect.axis) / np.linalg.norm(inputs.defect.axis)
    axial = gap @ axis
    side, up = _plane(inputs.defect)
    canal = _in_section(inputs.defect, gap @ side, gap @ up) & (np.abs(axial) < 0.5 * inputs.defect.length_mm)
    tissue = np.isin(inputs.labels, inputs.source.truth.table.tissue_values)
    return Edited(None, tissue & ~canal.reshape(geometry.shape))


METHODS = {"heartcase": heartcase, "stock": stock}


def errors(inputs: Inputs, output: Edited) -> dict[str, float]:
    """Diameter and place of the hole in the plane across its middle, and the tissue that differs from the truth."""
    defect = inputs.defect
    middle = np.array(defect.position_mm)
    side, up = _plane(defect)
    half = 0.5 * defect.diameter_mm + 2.0
    along = np.arange(-half, half + 0.5 * STEP_MM, STEP_MM)
    u, v = np.meshgrid(along, along)
    points = (middle + u[..., None] * side + v[..., None] * up).reshape(-1, 3)
    truth = HeartPhantom.of_size(inputs.source.phantom.size, defects=[defect]).truth
    true_tissue = np.isin(truth.label(points), truth.table.tissue_values)
    tissue = _tissue(inputs, output, points)
    hole, true_hole = (~found & (np.hypot(u, v).ravel() < half) for found in (tissue, true_tissue))
    centre, true_centre = (np.stack([u.ravel()[h], v.ravel()[h]]).mean(axis=1) for h in (hole, true_hole))
    found = {
        "diameter error [mm]": abs(_diameter(hole) - _diameter(true_hole)),
        "position error [mm]": float(np.linalg.norm(centre - true_centre)),
        "tissue differing in the plane [%]": 100.0 * float((tissue != true_tissue).mean()),
    }
    if defect.width_mm is not None:
        for name, along in (("long", u.ravel()), ("short", v.ravel())):
            found[f"{name} diameter error [mm]"] = abs(float(np.ptp(along[hole]) - np.ptp(along[true_hole])))
    return found


def _plane(defect: SeptalDefect) -> tuple[Float64, Float64]:
    """Unit vectors along the long and the short diameter."""
    axis = np.array(defect.axis) / np.linalg.norm(defect.axis)
    long = np.eye(3)[np.argmin(np.abs(axis))] if defect.long_axis is None else np.array(defect.long_axis)
    side = long - (long @ axis) * axis
    side /= np.linalg.norm(side)
    return side, np.cross(axis, side)


def _in_section(defect: SeptalDefect, u: Float64, v: Float64) -> Bool:
    long, short = 0.5 * defect.diameter_mm, 0.5 * (defect.width_mm or defect.diameter_mm)
    if defect.shape == "slit":
        return np.asarray(np.hypot(np.maximum(np.abs(u) - (long - short), 0.0), v) < short)
    return np.asarray((u / long) ** 2 + (v / short) ** 2 < 1.0)


def _tissue(inputs: Inputs, output: Edited, points: Float64) -> Bool:
    if output.structures is not None:
        return np.asarray(ownership_at_points(output.structures, points).tissue_mm < 0.0)
    index = np.rint(inputs.source.truth.geometry.world_to_index(points)).astype(int)
    return np.asarray(output.voxels[index[:, 2], index[:, 1], index[:, 0]])


def _diameter(hole: Bool) -> float:
    return 2.0 * float(np.sqrt(hole.sum() * STEP_MM**2 / np.pi))
