"""What every reader must find in the golden case: where its nodes and its surface are after some steps, in float64.

The steps are those of the NumPy reference, with spring stiffnesses and masses added up in float64 instead of float32.
The surface is the formulas of docs/bundle.md, word for word.
"""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from heartcase.schemas.arrays import Float64, Int32
from heartcase.schemas.bundle.format import FileRole
from heartcase.schemas.bundle.lattice import CELL_DIAGONALS, CELL_EDGES
from heartcase.schemas.bundle.reader import OpenBundle, open_bundle
from heartcase.simulator.dynamics.integrate import Verlet, verlet_step
from heartcase.simulator.lattice.model import LatticeModel
from heartcase.simulator.load import load_case
from tests.golden.shape import LANDMARKS

__all__ = ["DAMPING_PER_S", "GRAVITY_M_S2", "STEPS", "TOLERANCE_MM", "chirality", "expected", "start_displacement_mm"]


DAMPING_PER_S = 40.0
GRAVITY_M_S2 = (2.0, 9.0, -3.0)
STEPS = (1, 100)
TOLERANCE_MM = {"float64": 1e-7, "float32": 1e-3}
"""Measured: 5e-10 mm in float64, the rounding of expected.json; in float32 7e-7 mm with displacements in cells, 8e-5 mm
with positions in m. The least of the slips in test_golden.py moves something by 5e-2 mm."""

DECIMALS = 9


def start_displacement_mm(nodes: Int32) -> dict[int, tuple[float, float, float]]:
    """Node number -> where it starts from its rest position, LPS mm: the hook and the long arm's tip are pulled."""
    pulled = {int(n): (1.25, -0.75, 0.5) for n in np.flatnonzero(nodes[:, 2] >= 3)}
    return pulled | {int(n): (-0.5, 1.0, 0.75) for n in np.flatnonzero(nodes[:, 0] == 6)}


def chirality(points: npt.ArrayLike) -> float:
    """Signed volume of the tetrahedron of four points: det(b - a, c - a, d - a) / 6."""
    a, b, c, d = np.asarray(points, dtype=float)
    return float(np.linalg.det([b - a, c - a, d - a]) / 6)


def expected(case: Path) -> dict[str, Any]:
    """The content of expected.json."""
    bundle = open_bundle(case)
    manifest = bundle.manifest
    points = {landmark.name: landmark.points_mm[0] for landmark in manifest.landmarks}
    lps = np.array([points[name] for name in LANDMARKS])
    grid = bundle.arrays(FileRole.GRID)
    start = start_displacement_mm(grid["nodes"])
    paths = nodes_over_time(bundle, start)
    return {
        "format": "heartcase-golden",
        "case": case.name,
        "made_with": "python -m tests.golden.make --write",
        "step_s": manifest.simulation.step_default_s,
        "damping_per_s": DAMPING_PER_S,
        "gravity_m_s2": list(GRAVITY_M_S2),
        "start": {"displacement_mm": [[n, list(d)] for n, d in sorted(start.items())], "velocity": "zero"},
        "checks": {
            "landmarks": list(LANDMARKS),
            "chirality_lps_mm3": round(chirality(lps), 6),
            "chirality_gltf_m3": round(chirality(lps @ np.array(manifest.gltf_from_lps).T), 15),
            "chirality_frames": {
                frame.name: round(chirality(lps @ np.array(frame.from_lps_mm).T), 15)
                for frame in manifest.coordinates.frames
            },
            "enclosed_mm3": round(enclosed(bundle.arrays(FileRole.SURFACE)), 3),
            "scan": _scan_samples(bundle),
            "counts": dict(sorted(bundle.counts.items())),
            "sha256": {entry.role.value: entry.sha256 for entry in manifest.files},
            "mass_g": round(float(exact_lattice(bundle).mass_kg * 1e3), 9),
        },
        "steps": {str(n): {"nodes_mm": _rounded(paths[n])} for n in STEPS},
        "surface": {
            str(n): dict(zip(("vertices_mm", "normals"), map(_rounded, surface_over(bundle, paths[n])), strict=True))
            for n in (0, 100)
        },
        "tolerance_mm": TOLERANCE_MM,
    }


def enclosed(mesh: dict[str, npt.NDArray[Any]]) -> float:
    """Volume that the surface encloses, mm3: negative where its triangles turn the wrong way."""
    corners = mesh["vertices"].astype(float)[mesh["triangles"]]
    corners -= corners.reshape(-1, 3).mean(axis=0)
    return float(np.linalg.det(corners).sum() / 6)


def _scan_samples(bundle: OpenBundle) -> list[dict[str, Any]]:
    """Three voxels, one far out along each axis: index, place and intensity."""
    manifest = bundle.manifest
    intensity = bundle.arrays(FileRole.SCAN)["intensity"]
    size = manifest.scan_geometry.size
    samples = []
    for i, j, k in ((size[0] - 1, 0, 0), (0, size[1] - 1, 0), (0, 0, size[2] - 1)):
        assert manifest.scan_values is not None
        value = manifest.scan_values.slope * float(intensity[k, j, i]) + manifest.scan_values.intercept
        place = manifest.scan_geometry.index_to_world((i, j, k)).round(6)
        samples.append({"index": [i, j, k], "lps_mm": place.tolist(), "intensity": value})
    return samples


def _rounded(values: Float64) -> list[list[float]]:
    return (np.round(values, DECIMALS) + 0.0).tolist()


def exact_lattice(bundle: OpenBundle) -> LatticeModel:
    """The simulator's lattice with stiffnesses and masses summed cell by cell in float64."""
    model = load_case(bundle.directory, needs=("grid",)).model
    grid = bundle.arrays(FileRole.GRID)
    h = bundle.manifest.simulation.cell_mm * 1e-3
    spring_n_m: dict[tuple[int, int], float] = {}
    mass_kg = np.zeros(model.node_count)
    values = (grid[f"cell_{name}"].astype(float) for name in ("coverage", "stiffness", "density"))
    for corners, c, modulus_kpa, density in zip(model.cell_corners.tolist(), *values, strict=True):
        k = 0.4 * modulus_kpa * 1e3 * h
        for pairs, share in ((CELL_EDGES, 1 / 4), (CELL_DIAGONALS, 1 / 2)):
            for a, b in pairs.tolist():
                ends = (corners[a], corners[b])
                spring_n_m[ends] = spring_n_m.get(ends, 0.0) + c * k * share
        mass_kg[corners] += c * density * h**3 / 8
    units = model.units
    weight = [spring_n_m[lower, higher] for lower, higher in model.spring_nodes.tolist()]
    assert len(weight) == len(spring_n_m)
    return dataclasses.replace(
        model,
        spring_weight=np.array(weight) * units.length_m / units.force_n,  # type: ignore[arg-type]
        node_mass=mass_kg / units.mass_kg,  # type: ignore[arg-type]
    )


def nodes_over_time(bundle: OpenBundle, start: dict[int, tuple[float, float, float]]) -> dict[int, Float64]:
    """Step -> positions of the nodes, LPS mm, shape (node_count, 3); step 0 is REST, not the start."""
    model = exact_lattice(bundle)
    units = model.units
    verlet = Verlet(
        step=bundle.manifest.simulation.step_default_s / units.time_s,
        damping=DAMPING_PER_S * units.time_s,
        gravity=tuple(np.array(GRAVITY_M_S2) @ model.geometry.direction_matrix / units.acceleration_m_s2),
    )
    displacement = np.zeros((model.node_count, 3))
    for node, offset in start.items():
        displacement[node] = model.to_grid(offset)
    velocity = np.zeros_like(displacement)
    inverse_mass = np.where(model.node_is_fixed, 0.0, 1.0 / model.node_mass)
    paths = {0: model.rest_positions_mm()}
    for step in range(1, max(STEPS) + 1):
        displacement, velocity = verlet_step(model, verlet, displacement, velocity, inverse_mass)
        paths[step] = model.rest_positions_mm() + model.to_mm(displacement)
    return paths


def surface_over(bundle: OpenBundle, nodes_mm: Float64) -> tuple[Float64, Float64]:
    """Vertices (LPS mm) and normals over nodes at these positions, as docs/bundle.md writes it."""
    mapping = {name: array.astype(float) for name, array in bundle.arrays(FileRole.MAPPING).items()}
    triangle_nodes = bundle.arrays(FileRole.MAPPING)["triangle_nodes"]
    springs = load_case(bundle.directory, needs=("grid",)).model.spring_nodes
    rest_mm = bundle.manifest.grid_geometry.index_to_world(bundle.arrays(FileRole.GRID)["nodes"] - 0.5)
    vertices, normals = np.empty((len(triangle_nodes), 3)), np.empty((len(triangle_nodes), 3))
    for v, three in enumerate(triangle_nodes):
        w, is_curved = mapping["weights"][v], mapping["curvature"][v] == 1
        flat, at_rest = _flat_basis(nodes_mm[three]), _flat_basis(rest_mm[three])
        offset, normal, basis = mapping["offset"][v], mapping["normal"][v], flat
        if is_curved:
            curved_at_rest = _curved_basis(rest_mm, springs, three, w)
            offset = curved_at_rest @ (at_rest.T @ offset)
            normal = curved_at_rest @ (at_rest.T @ normal)
            basis = _curved_basis(nodes_mm, springs, three, w)
        vertices[v] = w @ nodes_mm[three] + offset @ basis
        normals[v] = normal @ basis
    return vertices, normals


def _flat_basis(p: Float64) -> Float64:
    T = _unit(p[1] - p[0])
    N = _unit(np.cross(p[1] - p[0], p[2] - p[0]))
    return np.array([T, N, np.cross(N, T)])


def _curved_basis(nodes_mm: Float64, springs: Int32, three: Int32, w: Float64) -> Float64:
    T = _unit(nodes_mm[three[1]] - nodes_mm[three[0]])
    approximate = []
    for node in three:
        others = np.concatenate([springs[springs[:, 0] == node, 1], springs[springs[:, 1] == node, 0]])
        approximate.append(_unit(sum(_unit(nodes_mm[node] - nodes_mm[j]) for j in others)))
    N = _unit(w @ np.array(approximate))
    B = _unit(np.cross(N, T))
    return np.array([np.cross(B, N), N, B])


def _unit(vector: Float64) -> Float64:
    unit: Float64 = vector / np.sqrt(vector @ vector)
    return unit
