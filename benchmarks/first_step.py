"""From a closed case to the first step of its tissue: open, check, build the lattice, lay it out, step once.

The peer is what anyone would write from docs/bundle.md: the standard JSON reader, the safetensors library, NumPy.
"""

from __future__ import annotations

import json
import subprocess
import sys
import tempfile
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from safetensors.numpy import load_file

from benchmarks.build import build_phantom
from heartcase.schemas.arrays import Float32
from heartcase.simulator.dynamics.integrate import verlet_step
from heartcase.simulator.lattice.state import State
from heartcase.simulator.load import load_case
from heartcase.simulator.simulation import Simulation

DAMPING_PER_S = 10.0
GRAVITY_M_S2 = (0.0, 9.81, 0.0)


@dataclass(frozen=True)
class Inputs:
    """A finished case, what of it is loaded, and where its nodes start [cells, grid axes]."""

    case: Path
    needs: tuple[str, ...]
    start: Float32


@dataclass(frozen=True)
class Output:
    """Displacements after the first step [cells, grid axes]."""

    displacement: Any


def prepare(params: dict[str, Any]) -> Inputs:
    needs = tuple(params.pop("needs"))
    case = build_phantom(params, Path(tempfile.gettempdir()) / "heartcase-benchmark-case")
    model = load_case(case, needs=()).model
    start = np.random.Generator(np.random.PCG64(1)).normal(0.0, 0.02, (model.node_count, 3)).astype(np.float32)
    start[model.node_is_fixed] = 0.0
    return Inputs(case, needs, start)


def heartcase(inputs: Inputs) -> Output:
    case = load_case(inputs.case, needs=inputs.needs)  # type: ignore[arg-type]
    simulation = Simulation(case.model, surface=case.surface, damping_per_s=DAMPING_PER_S, gravity_m_s2=GRAVITY_M_S2)
    simulation.restore(State(inputs.start, np.zeros_like(inputs.start)))
    simulation.step()
    if case.surface is not None:
        simulation.surface_now()
    return Output(simulation.state.displacement)


def stock(inputs: Inputs) -> Output:
    """Lattice and step in float64, by the formulas of docs/bundle.md."""
    manifest = json.loads((inputs.case / "case.json").read_bytes())
    name = next(entry["name"] for entry in manifest["files"] if entry["role"] == "grid")
    grid = load_file(inputs.case / name)
    h = manifest["simulation"]["cell_mm"] / 1000
    offsets = np.array([(c & 1, c >> 1 & 1, c >> 2 & 1) for c in range(8)])
    nodes = grid["nodes"].astype(np.int64)
    keys = (nodes[:, 2] << 42) | (nodes[:, 1] << 21) | nodes[:, 0]
    corner_index = grid["cells"][:, None, :].astype(np.int64) + offsets
    corners = np.searchsorted(keys, (corner_index[..., 2] << 42) | (corner_index[..., 1] << 21) | corner_index[..., 0])
    coverage = grid["cell_coverage"].astype(float)
    k = coverage * 0.4 * grid["cell_stiffness"] * 1e3 * h
    pairs, stiffness = [], []
    for a in range(8):
        for b in range(a + 1, 8):
            share = {1: 1 / 4, 2: 1 / 2}.get((a ^ b).bit_count())
            if share:
                pairs.append(corners[:, a] * len(nodes) + corners[:, b])
                stiffness.append(k * share)
    found, which = np.unique(np.concatenate(pairs), return_inverse=True)
    w = np.bincount(which, np.concatenate(stiffness))
    lower, higher = np.divmod(found, len(nodes))
    mass = np.bincount(corners.ravel(), np.repeat(coverage * grid["cell_density"] * h**3 / 8, 8))

    at_rest = (nodes[higher] - nodes[lower]) * h
    u = inputs.start * h
    d = at_rest + u[higher] - u[lower]
    length, rest = np.linalg.norm(d, axis=1), np.linalg.norm(at_rest, axis=1)
    pull = (w * (length - rest) / length)[:, None] * d
    force = np.stack([np.bincount(lower, p, len(nodes)) - np.bincount(higher, p, len(nodes)) for p in pull.T], axis=1)
    s = manifest["simulation"]["step_default_s"]
    q = DAMPING_PER_S * s / 2
    gravity = np.array(GRAVITY_M_S2) @ np.array(manifest["grid_geometry"]["direction"])
    velocity = s * (force / mass[:, None] + gravity) / (1 + q)
    velocity[grid["fixed"] == 1] = 0.0
    return Output((u + s * velocity) / h)


METHODS = {"heartcase": heartcase, "stock": stock}

_FRESH = """
import sys
from heartcase.simulator.load import load_case
from heartcase.simulator.simulation import Simulation
case = load_case(sys.argv[1], needs=())
Simulation(case.model).step()
"""


def errors(inputs: Inputs, output: Output) -> dict[str, float]:
    """Difference to the reference's first step; and the time that a new process needs, imports included."""
    case = load_case(inputs.case, needs=())
    simulation = Simulation(case.model, damping_per_s=DAMPING_PER_S, gravity_m_s2=GRAVITY_M_S2, backend="reference")
    inverse_mass = np.where(case.model.node_is_fixed, 0.0, 1.0 / case.model.node_mass.astype(float))
    start = inputs.start.astype(float)
    after, _ = verlet_step(case.model, simulation.verlet, start, np.zeros_like(start), inverse_mass)
    before = time.perf_counter()
    subprocess.run([sys.executable, "-c", _FRESH, str(inputs.case)], check=True)
    return {
        "largest difference to the reference [mm]": float(np.abs(output.displacement - after).max())
        * case.model.cell_mm,
        "moved by the step [mm]": float(np.abs(after - start).max()) * case.model.cell_mm,
        "nodes [1]": float(case.model.node_count),
        "new process, grid only, kernels in the cache [s]": time.perf_counter() - before,
    }
