"""From distance fields to grid, surface and mapping; beside it the same surface from stock parts."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import fast_simplification
import numpy as np
from skimage.measure import marching_cubes

from benchmarks.phantom_inputs import PhantomInputs, bare_truth, phantom_inputs
from heartcase.phantom.metrics import SurfaceError, closest_distance_mm
from heartcase.pipeline.cells.build_grid import build_grid
from heartcase.pipeline.cells.map_surface import map_surface
from heartcase.pipeline.data import GridMap, Segmentation, SimulationGrid, Structures, Surface
from heartcase.pipeline.fields.reader import ownership_on_lattice
from heartcase.pipeline.mesh.build_surface import build_surface
from heartcase.pipeline.walls.grow_walls import grow_walls
from heartcase.schemas.recipe.settings import GridSettings, MapSettings, SurfaceSettings, WallsSettings


@dataclass(frozen=True)
class Inputs:
    """Distance fields of the phantom's true labels, and which stage to run."""

    source: PhantomInputs
    structures: Structures
    stage: str
    grid: SimulationGrid | None
    surface: Surface | None
    settings: SurfaceSettings


def prepare(params: dict[str, Any]) -> Inputs:
    stage = params.pop("stage")
    settings = SurfaceSettings(triangle_count=params.pop("triangle_count", 80_000), level_counts=())
    source = phantom_inputs(params)
    labels = Segmentation(bare_truth(source), source.truth.geometry, source.phantom.table)
    structures = grow_walls(labels, WallsSettings(), source.phantom.ends)
    grid = build_grid(structures, GridSettings()) if stage == "map" else None
    surface = build_surface(structures, settings) if stage == "map" else None
    return Inputs(source, structures, stage, grid, surface, settings)


def heartcase(inputs: Inputs) -> SimulationGrid | Surface | GridMap:
    if inputs.stage == "grid":
        return build_grid(inputs.structures, GridSettings())
    if inputs.stage == "surface":
        return build_surface(inputs.structures, inputs.settings)
    assert inputs.surface is not None
    assert inputs.grid is not None
    return map_surface(inputs.surface, inputs.grid, inputs.structures, MapSettings())


@dataclass(frozen=True)
class StockSurface:
    """A mesh without tags, atlas or normal map."""

    vertices_mm: Any
    triangles: Any


def stock(inputs: Inputs) -> StockSurface:
    """Marching cubes of scikit-image on the tissue field, decimated by fast-simplification: no tags, no normal map."""
    lattice = inputs.structures.geometry
    field = ownership_on_lattice(inputs.structures, lattice).tissue_mm
    field = np.pad(field, 1, constant_values=1.0)
    vertices, triangles, _, _ = marching_cubes(field, 0.0)
    vertices = lattice.index_to_world(vertices[:, ::-1] - 1.0)
    points, faces = fast_simplification.simplify(
        vertices.astype(np.float32), triangles, target_count=inputs.settings.triangle_count
    )
    return StockSurface(points, faces)


METHODS = {"heartcase": heartcase, "stock": stock}


def errors(inputs: Inputs, output: Any) -> dict[str, float]:
    """What a user of the stage's output would notice."""
    if isinstance(output, SimulationGrid):
        quality = output.quality
        return {
            "volume error [%]": quality["volume_error_percent"],
            "nodes [1]": float(len(output.nodes)),
            "warnings [1]": float(len(output.warnings)),
        }
    if isinstance(output, GridMap):
        return {"warnings [1]": float(len(output.warnings))}
    truth = inputs.source.phantom.truth
    there = np.abs(truth.tissue_distance(output.vertices_mm, tolerance_mm=0.02))
    samples = truth.surface_points()
    back = closest_distance_mm(samples, output.vertices_mm, output.triangles)
    both = SurfaceError.of(np.concatenate([there, back]))
    return {
        "distance to true surface, mean [mm]": both.mean_mm,
        "distance to true surface, 99% [mm]": float(np.percentile(np.concatenate([there, back]), 99)),
        "triangles [1]": float(len(output.triangles)),
    }
