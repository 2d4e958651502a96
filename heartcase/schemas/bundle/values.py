"""Whether the figures of a case's manifest and the arrays of its grid agree, and state what the format states."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any

import numpy as np
import numpy.typing as npt

from heartcase.schemas.arrays import Float64
from heartcase.schemas.bundle.coordinates import Coordinates
from heartcase.schemas.bundle.format import CaseManifest, FileRole
from heartcase.schemas.bundle.lattice import cell_nodes, lattice_keys, step_sizes
from heartcase.schemas.bundle.manifest import stated
from heartcase.schemas.errors import BundleError, Problem
from heartcase.schemas.geometry import SPACING_LIMITS_MM, Geometry

__all__ = ["Arrays", "Parts", "figure_problems", "grid_problems"]

Arrays = dict[str, npt.NDArray[Any]]
"""The sound arrays of one part, by name."""
Parts = Mapping[FileRole, Arrays]
"""The sound arrays of a case."""

LANDMARK_FAR_MM = 1e5
FIGURE_TOLERANCE = 1e-5
"""Relative: cells hold float32, figures are worked out in float64."""
PARALLEL_TOLERANCE = 1e-6


def figure_problems(manifest: CaseManifest) -> Iterable[Problem]:
    """What the manifest states at odds with itself or with the format."""
    spacing, cell_mm = stated(manifest, "grid_geometry.spacing_mm"), stated(manifest, "simulation.cell_mm")
    grid, scan = (_direction(manifest, name) for name in ("grid_geometry", "scan_geometry"))
    if grid is not None and np.linalg.det(grid) <= 0.0:
        yield Problem("grid_geometry.direction", "must be right-handed")
    if grid is not None and scan is not None and np.abs(np.abs(grid.T @ scan) - np.eye(3)).max() > PARALLEL_TOLERANCE:
        yield Problem("grid_geometry.direction", "is not along the scan's axes, scan_geometry.direction")
    if spacing is not None and cell_mm is not None:
        edges = np.array(spacing)
        if np.ptp(edges) > 1e-6 * edges[0] or abs(edges[0] - cell_mm) > 1e-6 * edges[0]:
            yield Problem("grid_geometry.spacing_mm", "must be the cell's edge, simulation.cell_mm, along every axis")
    step_s, limit_s = (stated(manifest, f"simulation.step_{name}_s") for name in ("default", "limit"))
    if step_s is not None and limit_s is not None and step_s > limit_s:
        yield Problem("simulation.step_default_s", "is beyond simulation.step_limit_s")
    for number, landmark in enumerate(stated(manifest, "landmarks") or (), start=1):
        points = getattr(landmark, "points_mm", None)
        if points is not None and np.abs(points).max() > LANDMARK_FAR_MM:
            yield Problem(f"landmarks[{number}]", "lies more than 100 m away")
    names = [getattr(landmark, "name", None) for landmark in stated(manifest, "landmarks") or ()]
    for number, name in enumerate(names, start=1):
        if name is not None and name in names[: number - 1]:
            yield Problem(f"landmarks[{number}]", "has the name of one before it")
    labels = [material.label for material in stated(manifest, "materials") or () if hasattr(material, "label")]
    twice = sorted({label for label in labels if labels.count(label) > 1})
    if twice:
        yield Problem("materials", f"the labels {twice} have more than one")
    names = [getattr(frame, "name", None) for frame in stated(manifest, "coordinates.frames") or ()]
    ours = sorted(frame.name for frame in Coordinates().frames)
    if stated(manifest, "coordinates.frames") is not None and None not in names and sorted(map(str, names)) != ours:
        yield Problem("coordinates.frames", f"must be {', '.join(ours)}, each once")


def _direction(manifest: CaseManifest, name: str) -> Float64 | None:
    rows = stated(manifest, f"{name}.direction")
    return None if rows is None else np.array(rows)


def grid_problems(manifest: CaseManifest, parts: Parts) -> Iterable[Problem]:
    """Cells, nodes and held nodes against each other, the geometry, the materials and the figures."""
    grid = parts.get(FileRole.GRID, {})
    yield from _lattice_problems(manifest, grid)
    yield from _material_problems(manifest, grid)
    yield from _size_problems(manifest, grid)
    fixed = grid.get("fixed")
    if fixed is None:
        return
    count, figure = int(np.count_nonzero(fixed)), stated(manifest, "simulation.fixed_node_count")
    if figure is not None and count != figure:
        yield Problem("simulation.fixed_node_count", f"says {figure}, but {count} nodes are held")
    if fixed.all():
        yield Problem("grid.fixed", "every node is held: nothing can move")


def _lattice_problems(manifest: CaseManifest, grid: Arrays) -> Iterable[Problem]:
    cells, size = grid.get("cells"), stated(manifest, "grid_geometry.size")
    if cells is None:
        return
    if (np.diff(lattice_keys(cells)) <= 0).any():
        yield Problem("grid.cells", "must ascend by k, j, i without repeats")
    try:
        are_corners = "nodes" not in grid or np.array_equal(cell_nodes(cells)[0], grid["nodes"])
    except BundleError as error:
        yield Problem("grid.cells", error.problems[0].message)
    else:
        if not are_corners:
            yield Problem("grid.nodes", "are not the corners of the cells, in order")
    if len(cells) and ((cells < 0).any() or (size is not None and (cells >= np.array(size)).any())):
        yield Problem("grid.cells", "lie outside grid_geometry.size")
    geometry, scan = stated(manifest, "grid_geometry"), stated(manifest, "scan_geometry")
    if isinstance(geometry, Geometry) and isinstance(scan, Geometry) and len(cells):
        centres = scan.world_to_index(geometry.index_to_world(cells))
        # Cells are counted from the scan's corner, so the last ones may reach over its far side.
        reach = 0.5 + geometry.spacing_mm[0] / np.array(scan.spacing_mm)
        if (centres < -reach).any() or (centres > np.array(scan.size) - 1.0 + reach).any():
            yield Problem("scan_geometry", "the cells lie outside the scan: it is mirrored, turned or another one")


def _material_problems(manifest: CaseManifest, grid: Arrays) -> Iterable[Problem]:
    materials = stated(manifest, "materials")
    if materials is None or "cell_label" not in grid:
        return
    known = {material.label: material for material in materials if hasattr(material, "label")}
    used = sorted(set(np.unique(grid["cell_label"]).tolist()))
    if missing := [label for label in used if label not in known]:
        yield Problem("materials", f"the labels {missing} of the grid have none")
    for array, key in (("cell_stiffness", "youngs_modulus_kpa"), ("cell_density", "density_kg_m3")):
        if array not in grid:
            continue
        wrong = []
        for label in used:
            value = getattr(known.get(label), key, None)
            values = grid[array][grid["cell_label"] == label].astype(np.float64)
            if value is not None and (np.abs(values - value) > FIGURE_TOLERANCE * value).any():
                wrong.append(label)
        if wrong:
            yield Problem(f"grid.{array}", f"of the labels {wrong} is not {key} of their materials")


def _size_problems(manifest: CaseManifest, grid: Arrays) -> Iterable[Problem]:
    """Steps and volume are worked out from the cells: docs/bundle.md, springs, masses, steps."""
    cell_mm = stated(manifest, "simulation.cell_mm")
    if cell_mm is None or not SPACING_LIMITS_MM[0] <= cell_mm <= SPACING_LIMITS_MM[1]:
        return
    expected: dict[str, float] = {}
    if {"cell_stiffness", "cell_density"} <= set(grid) and len(grid["cell_stiffness"]):
        modulus_pa, density = (grid[name].astype(np.float64) for name in ("cell_stiffness", "cell_density"))
        default, limit = step_sizes(float((modulus_pa * 1e3 / density).max()), cell_mm)
        expected |= {"step_limit_s": limit, "step_default_s": default}
        expected["steps_per_second"] = 1.0 / expected["step_default_s"]
    if "cell_coverage" in grid:
        expected["tissue_volume_ml"] = float(grid["cell_coverage"].sum(dtype=np.float64)) * cell_mm**3 * 1e-3
    for name, value in expected.items():
        figure = stated(manifest, f"simulation.{name}")
        if figure is not None and abs(figure - value) > FIGURE_TOLERANCE * value:
            yield Problem(f"simulation.{name}", f"says {figure:.6g}, but the cells give {value:.6g}")
