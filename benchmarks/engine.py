"""Steps of the spring lattice of a whole heart: ours, and the textbook kernel with a neighbour list."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numba
import numpy as np
from geometry import prepare as prepare_geometry

from heartcase.pipeline.grid import build_grid
from heartcase.schemas.settings import GridSettings
from heartcase.simulator.engine import make_engine
from heartcase.simulator.integrate import Verlet, verlet_step
from heartcase.simulator.model import LatticeModel, make_model
from heartcase.simulator.state import State
from heartcase.simulator.step_size import default_step


@dataclass(frozen=True)
class Inputs:
    """A lattice, a state away from rest, and a number of steps."""

    model: LatticeModel
    start: State
    verlet: Verlet
    step_count: int
    neighbours: Any
    memory: dict[str, Any]


@dataclass(frozen=True)
class Output:
    """Where the nodes ended."""

    displacement: Any


def prepare(params: dict[str, Any]) -> Inputs:
    step_count, node_count = params.pop("step_count"), params.pop("node_count")
    structures = prepare_geometry(params | {"stage": "grid"}).structures
    grid = build_grid(structures, GridSettings(node_count=node_count))
    model = make_model(grid.cells, coverage=grid.cell_coverage, fixed=grid.fixed, geometry=grid.geometry)
    generator = np.random.Generator(np.random.PCG64(1))
    displacement = generator.normal(0.0, 0.02, (model.node_count, 3)).astype(np.float32)
    displacement[np.asarray(grid.fixed, bool)] = 0.0
    start = State(displacement, np.zeros_like(displacement))
    verlet = Verlet(default_step(model) / model.units.time_s, damping=10.0 * model.units.time_s)
    return Inputs(model, start, verlet, step_count, _neighbour_list(model), {})


def heartcase(inputs: Inputs) -> Output:
    engine = inputs.memory.setdefault("engine", make_engine(inputs.model, "cpu"))
    engine.load(inputs.start)
    engine.advance(inputs.step_count, inputs.verlet)
    return Output(engine.read().displacement)


def textbook(inputs: Inputs) -> Output:
    """One core, float64, the way it is written in a lecture."""
    displacement, velocity = inputs.start.displacement.astype(float), inputs.start.velocity.astype(float)
    mass_inverse = inputs.model.inverse_mass.astype(float)
    count, other, rest, weight = inputs.neighbours
    rule = inputs.verlet
    for _ in range(inputs.step_count):
        _textbook_step(
            displacement, velocity, mass_inverse, count, other, rest, weight, rule.keep, rule.kick, rule.step
        )
    return Output(displacement)


def _neighbour_list(model: LatticeModel) -> tuple[Any, Any, Any, Any]:
    count = np.zeros(model.node_count, np.int64)
    other = np.zeros((model.node_count, 18), np.int64)
    rest = np.zeros((model.node_count, 18, 3))
    weight = np.zeros((model.node_count, 18))
    for (a, b), w in zip(model.spring_nodes, model.spring_weight, strict=True):
        offset = model.node_index[b] - model.node_index[a]
        for here, there, sign in ((a, b, 1.0), (b, a, -1.0)):
            slot = count[here]
            other[here, slot], rest[here, slot], weight[here, slot] = there, sign * offset, w
            count[here] += 1
    return count, other, rest, weight


@numba.njit
def _textbook_step(u, v, mass_inverse, count, other, rest, weight, keep, kick, step):  # type: ignore[no-untyped-def]
    force = np.empty_like(u)
    for n in range(len(u)):
        fx = fy = fz = 0.0
        for s in range(count[n]):
            j = other[n, s]
            rx, ry, rz = rest[n, s, 0], rest[n, s, 1], rest[n, s, 2]
            dx, dy, dz = rx + u[j, 0] - u[n, 0], ry + u[j, 1] - u[n, 1], rz + u[j, 2] - u[n, 2]
            length = np.sqrt(dx * dx + dy * dy + dz * dz)
            pull = weight[n, s] * (length - np.sqrt(rx * rx + ry * ry + rz * rz)) / length
            fx += pull * dx
            fy += pull * dy
            fz += pull * dz
        force[n, 0], force[n, 1], force[n, 2] = fx, fy, fz
    for n in range(len(u)):
        for c in range(3):
            if mass_inverse[n] > 0.0:
                v[n, c] = keep * v[n, c] + kick * mass_inverse[n] * force[n, c]
            u[n, c] += step * v[n, c]


METHODS = {"heartcase": heartcase, "textbook": textbook}


def errors(inputs: Inputs, output: Output) -> dict[str, float]:
    """Difference to the NumPy reference in float64 after the same steps."""
    displacement, velocity = inputs.start.displacement.astype(float), inputs.start.velocity.astype(float)
    mass_inverse = inputs.model.inverse_mass.astype(float)
    for _ in range(inputs.step_count):
        displacement, velocity = verlet_step(inputs.model, inputs.verlet, displacement, velocity, mass_inverse)
    return {
        "largest difference to the reference [cells]": float(np.abs(output.displacement - displacement).max()),
        "nodes [1]": float(inputs.model.node_count),
        "steps per run [1]": float(inputs.step_count),
        "real steps per second needed [1/s]": 1.0 / default_step(inputs.model),
    }
