"""How far the mapped surface is from the trilinear embedding of the same vertices, in cells, as the grid is deformed.

The whole heart is turned, stretched, bent and twisted along each axis of the grid. The trilinear embedding interpolates
between the corners of the cell that holds a vertex, or of the nearest one. ``flat`` takes the basis of the triangle,
``curved`` the interpolated one wherever it is defined, ``per_vertex`` what the map's flags say.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.spatial import cKDTree

from benchmarks.geometry import prepare as prepare_geometry
from heartcase.pipeline.cells.map_surface import map_surface
from heartcase.pipeline.data import GridMap, SimulationGrid, Surface
from heartcase.schemas.arrays import Float32, Float64, Int32
from heartcase.schemas.bundle.lattice import CORNER_OFFSETS, cell_nodes
from heartcase.schemas.recipe.settings import MapSettings
from heartcase.simulator.lattice.model import LatticeModel, make_model
from heartcase.simulator.surface.deform import Curvature, SurfaceModel, deform, make_surface

RADIUS = 60.0
"""Radius of the bent middle plane, and cells for a twist by one radian."""
STRETCH = 0.2
POISSON = 0.25
TURN = 1.3
"""Radians of the rigid turn."""
_NEAR_CELLS = 16


@dataclass(frozen=True)
class Inputs:
    """A mapped surface, and the same lattice moved in several ways."""

    surface: Surface
    grid: SimulationGrid
    mapped: GridMap
    model: LatticeModel
    motions: dict[str, list[Float32]]
    """Name -> displacements of the nodes [cells], one for each axis."""
    wanted: dict[str, list[Float64]]
    """Name -> displacements of the vertices in the trilinear embedding [cells]."""


def prepare(params: dict[str, Any]) -> Inputs:
    made = prepare_geometry(params | {"stage": "map"})
    assert made.grid is not None
    assert made.surface is not None
    grid, surface = made.grid, made.surface
    model = make_model(grid.cells, coverage=grid.cell_coverage, fixed=grid.fixed, geometry=grid.geometry)
    centre = grid.nodes.mean(axis=0)
    motions: dict[str, list[Float32]] = {}
    for name, move in _MOTIONS.items():
        for axis in range(3):
            # Each motion is along its first axis.
            at = np.roll(grid.nodes - centre, -axis, axis=1)
            moved = np.roll(move(at) - at, axis, axis=1)
            motions.setdefault(name, []).append(moved.astype(np.float32))
    nodes, weights = _embedding(grid, surface.vertices_mm.astype(np.float64))
    wanted = {
        name: [np.einsum("vc,vcx->vx", weights, one[nodes].astype(np.float64)) for one in moved]
        for name, moved in motions.items()
    }
    mapped = map_surface(surface, grid, made.structures, MapSettings())
    return Inputs(surface, grid, mapped, model, motions, wanted)


def _turned(p: Float64) -> Float64:
    c, s = np.cos(TURN), np.sin(TURN)
    turned = np.stack((c * p[:, 0] - s * p[:, 1], s * p[:, 0] + c * p[:, 1], p[:, 2]), axis=1)
    return turned + np.array([3.0, -5.0, 2.0])


def _stretched(p: Float64) -> Float64:
    return p * (1.0 + STRETCH, 1.0 - POISSON * STRETCH, 1.0 - POISSON * STRETCH)


def _bent(p: Float64) -> Float64:
    angle, height = p[:, 0] / RADIUS, RADIUS - p[:, 2]
    return np.stack((height * np.sin(angle), p[:, 1], RADIUS - height * np.cos(angle)), axis=1)


def _twisted(p: Float64) -> Float64:
    c, s = np.cos(p[:, 0] / RADIUS), np.sin(p[:, 0] / RADIUS)
    return np.stack((p[:, 0], c * p[:, 1] - s * p[:, 2], s * p[:, 1] + c * p[:, 2]), axis=1)


_MOTIONS: dict[str, Callable[[Float64], Float64]] = {
    "rigid": _turned,
    "stretch": _stretched,
    "bend": _bent,
    "twist": _twisted,
}


def _embedding(grid: SimulationGrid, vertices_mm: Float64) -> tuple[Int32, Float64]:
    """Nodes of the cell that holds each vertex or is nearest to it, and their trilinear weights, shape (n, 8)."""
    place = grid.geometry.world_to_index(vertices_mm)
    near = cKDTree(grid.cells).query(place, k=min(_NEAR_CELLS, len(grid.cells)), workers=1)[1]
    beyond = np.maximum(np.abs(place[:, None] - grid.cells[near]) - 0.5, 0.0)
    cell = near[np.arange(len(place)), np.linalg.norm(beyond, axis=2).argmin(axis=1)]
    part = place - grid.cells[cell] + 0.5
    weights = [np.prod(np.where(corner, part, 1.0 - part), axis=1) for corner in CORNER_OFFSETS]
    return cell_nodes(grid.cells)[1][cell], np.stack(weights, axis=1)


@dataclass(frozen=True)
class Output:
    """Displacements of the vertices, LPS mm, as :class:`Inputs` has them for the nodes."""

    moved_mm: dict[str, list[Float32]]
    curved_share: float


def _method(mode: Curvature) -> Callable[[Inputs], Output]:
    def run(inputs: Inputs) -> Output:
        surface = _surface(inputs, mode)
        moved = {
            name: [deform(inputs.model, surface, one).vertices_mm - surface.rest_mm for one in ways]
            for name, ways in inputs.motions.items()
        }
        return Output(moved, float(np.mean(surface.curvature)))

    return run


def _surface(inputs: Inputs, mode: Curvature) -> SurfaceModel:
    mapped = inputs.mapped
    return make_surface(
        inputs.model,
        triangle_nodes=mapped.triangle_nodes,
        weights=mapped.weights,
        offset_mm=mapped.offset_mm,
        normal=mapped.normal,
        curvature=mapped.curvature,
        mode=mode,
    )


METHODS = {"flat": _method("none"), "curved": _method("all"), "per_vertex": _method("flagged")}


def errors(inputs: Inputs, output: Output) -> dict[str, float]:
    """Distance of the mapped vertices from the embedded ones, over the three axes together."""
    found = {}
    to_cells = inputs.grid.geometry.direction_matrix / inputs.grid.geometry.spacing_mm[0]
    for name, ways in output.moved_mm.items():
        pairs = zip(ways, inputs.wanted[name], strict=True)
        error = np.concatenate([np.linalg.norm(moved @ to_cells - wanted, axis=1) for moved, wanted in pairs])
        found[f"{name}, RMS [cells]"] = float(np.sqrt(np.mean(error**2)))
        found[f"{name}, 95% [cells]"] = float(np.percentile(error, 95))
        found[f"{name}, max [cells]"] = float(error.max())
    return found | {"vertices with the interpolated basis [%]": 100.0 * output.curved_share}
