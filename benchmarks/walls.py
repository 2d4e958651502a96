"""Distance fields and grown walls, from a segmentation of the noisy scan or from the true labels.

The thickness is measured between the wall's outer and the cavity's own surface, each extracted for itself, and compared
with the true one. ``stock`` dilates the cavities' voxels by a distance transform, at least by one voxel, as general
editors do. ``level_set`` draws both surfaces as level sets of the distance transform of the cavity's voxels.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import edt
import numpy as np
from scipy.ndimage import map_coordinates
from scipy.spatial import cKDTree
from skimage.measure import marching_cubes

from benchmarks.phantom_inputs import PhantomInputs, bare_truth, phantom_inputs
from heartcase.phantom.metrics import SurfaceError, closest_distance_mm, wall_thickness_errors
from heartcase.pipeline.data import Segmentation, Structures
from heartcase.pipeline.image.filter_scan import filter_scan
from heartcase.pipeline.mesh.build_surface import build_surface
from heartcase.pipeline.walls.grow_walls import grow_walls
from heartcase.pipeline.watershed.segment_scan import segment_scan
from heartcase.schemas.arrays import Bool, Float32, Float64, Int32, UInt8
from heartcase.schemas.labels import LabelTable
from heartcase.schemas.recipe.settings import FilterSettings, SegmentSettings, SurfaceSettings, WallsSettings

MARGIN_MM = 2.0
"""What lies nearer than this to where a wall ends or meets another is not measured."""


@dataclass(frozen=True)
class Inputs:
    """Cavities and myocardium, no grown walls."""

    source: PhantomInputs
    segmentation: Segmentation


@dataclass(frozen=True)
class Voxels:
    """Walls as voxels."""

    labels: UInt8
    table: LabelTable


@dataclass(frozen=True)
class Levels:
    """Signed distances whose level sets are the surfaces."""

    inner_mm: dict[int, Float32]
    """Cavity -> signed distance to its surface."""
    myocardium_mm: Float32
    """Signed distance to what is segmented beside the walled cavities."""
    table: LabelTable


def prepare(params: dict[str, Any]) -> Inputs:
    labels_from, wall_mm = params.pop("labels_from"), params.pop("wall_mm", None)
    source = phantom_inputs(params)
    if wall_mm is not None:
        labels = (
            label.model_copy(update={"wall_thickness_mm": wall_mm}) if label.wall_thickness_mm > 0.0 else label
            for label in source.phantom.table
        )
        source = replace(source, phantom=replace(source.phantom, table=LabelTable(labels=tuple(labels))))
    if labels_from == "segmentation":
        filtered = filter_scan(source.scan, FilterSettings())
        return Inputs(source, segment_scan(filtered, source.markers, SegmentSettings(), source.phantom.table))
    return Inputs(source, Segmentation(bare_truth(source), source.truth.geometry, source.phantom.table))


def heartcase(inputs: Inputs) -> Structures:
    return grow_walls(inputs.segmentation, WallsSettings(), inputs.source.phantom.ends)


def stock(inputs: Inputs) -> Voxels:
    labels, geometry = inputs.segmentation.labels, inputs.segmentation.geometry
    table = inputs.segmentation.table.with_walls()
    half = 0.5 * float(np.mean(geometry.spacing_mm))
    nearest = np.full(labels.shape, np.inf, np.float32)
    found = labels.copy()
    for cavity, thickness in _walled(table).items():
        distance = edt.edt(labels != cavity, anisotropy=geometry.spacing_mm[::-1], parallel=2)
        reach = max(thickness + half, *geometry.spacing_mm)
        wall = (labels == 0) & (distance <= reach) & (distance < nearest)
        found[wall] = table.wall_value(cavity)
        nearest[wall] = distance[wall]
    return Voxels(found, table)


def level_set(inputs: Inputs) -> Levels:
    labels, geometry = inputs.segmentation.labels, inputs.segmentation.geometry
    table = inputs.segmentation.table.with_walls()
    walled = _walled(table)
    rest = np.isin(labels, [0, *walled], invert=True)
    inner = {cavity: _signed(labels == cavity, geometry.spacing_mm) for cavity in walled}
    return Levels(inner, _signed(rest, geometry.spacing_mm), table)


METHODS = {"heartcase": heartcase, "stock": stock, "level_set": level_set}


def errors(inputs: Inputs, output: Structures | Voxels | Levels) -> dict[str, float]:
    """Thickness of each wall between its inner and its outer surface, against the true thickness."""
    if isinstance(output, Structures):
        surface = build_surface(output, SurfaceSettings(triangle_count=200_000, level_counts=()), render=False)
        mesh = (surface.vertices_mm, surface.triangles, surface.triangle_label, surface.triangle_tissue)
        walls = wall_thickness_errors(*mesh, output.table, margin_mm=MARGIN_MM)
    elif isinstance(output, Voxels):
        walls = wall_thickness_errors(*_voxel_mesh(inputs, output), output.table, margin_mm=MARGIN_MM)
    else:
        walls = _level_errors(inputs, output)
    found = {}
    for name, error in walls.items():
        found[f"{name} thickness, mean [mm]"] = error.mean_mm
        found[f"{name} thickness, 95% [mm]"] = error.percentile_95_mm
    means = [error.mean_mm for error in walls.values()]
    worst = max(error.percentile_95_mm for error in walls.values())
    return {"all walls, mean [mm]": float(np.mean(means)), "all walls, worst 95% [mm]": worst} | found


def _walled(table: LabelTable) -> dict[int, float]:
    return {label.value: label.wall_thickness_mm for label in table if label.wall_thickness_mm > 0.0}


def _signed(mask: Bool, spacing_mm: tuple[float, ...]) -> Float32:
    """Distance between voxel centres across the border, less the half voxel to it; negative inside."""
    half = 0.5 * float(np.mean(spacing_mm))
    out = edt.edt(~mask, anisotropy=spacing_mm[::-1], parallel=2)
    within = edt.edt(mask, anisotropy=spacing_mm[::-1], parallel=2)
    return np.where(mask, half - within, out - half).astype(np.float32)


def _voxel_mesh(inputs: Inputs, output: Voxels) -> tuple[Float64, Int32, UInt8, UInt8]:
    """Marching cubes on the tissue's voxels, each triangle with the labels of the voxels on its sides."""
    tissue = np.isin(output.labels, output.table.tissue_values).astype(np.float32)
    zyx, triangles, _, _ = marching_cubes(tissue, 0.5)
    corners = zyx[triangles]
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normal /= np.maximum(np.linalg.norm(normal, axis=1), 1e-12)[:, None]
    middle = corners.mean(axis=1)
    ahead = map_coordinates(tissue, (middle + 0.4 * normal).T, order=1)
    behind = map_coordinates(tissue, (middle - 0.4 * normal).T, order=1)
    out = np.where((ahead < behind)[:, None], normal, -normal)
    sides = []
    for step in (0.7, -0.7):
        index = np.clip(np.rint(middle + step * out).astype(int), 0, np.array(tissue.shape) - 1)
        sides.append(output.labels[tuple(index.T)])
    vertices = inputs.segmentation.geometry.index_to_world(zyx[:, ::-1])
    return vertices, triangles.astype(np.int32), sides[0], sides[1]


def _level_errors(inputs: Inputs, output: Levels) -> dict[str, SurfaceError]:
    """Distance from the outer level set to the inner one, away from where another structure's surface is the outer."""
    geometry = inputs.segmentation.geometry
    walled = _walled(output.table)
    fields = np.stack([*(output.inner_mm[cavity] - walled[cavity] for cavity in walled), output.myocardium_mm])
    zyx, _, _, _ = marching_cubes(fields.min(axis=0), 0.0)
    there = np.array([map_coordinates(field, zyx.T, order=1) for field in fields])
    owner = there.argmin(axis=0)
    outer = geometry.index_to_world(zyx[:, ::-1])
    ends = np.array([end.position_mm for end in inputs.source.phantom.ends])
    reach = np.array([end.radius_mm for end in inputs.source.phantom.ends]) + MARGIN_MM
    at_end = (np.linalg.norm(outer[:, None] - ends, axis=2) < reach).any(axis=1)
    found = {}
    for number, (cavity, thickness) in enumerate(walled.items()):
        zyx, triangles, _, _ = marching_cubes(output.inner_mm[cavity], 0.0)
        inner = geometry.index_to_world(zyx[:, ::-1])
        others = outer[owner != number]
        points = outer[(owner == number) & ~at_end]
        points = points[cKDTree(others).query(points)[0] > MARGIN_MM]
        name = output.table[output.table.wall_value(cavity) or 0].name
        found[name] = SurfaceError.of(closest_distance_mm(points, inner, triangles) - thickness)
    return found
