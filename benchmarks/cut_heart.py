"""A plane cut through the adult's heart: what the cut takes, and what steps take after it.

The blade is a square that lies askew, as large as it must be to part so many springs. ``cut`` parts the lattice and
makes the engine that goes on with it; ``springs_removed`` is the plain way: the springs that the square crosses are
taken away. ``steps`` and ``steps_uncut`` take the same number of steps with and without the cut.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from benchmarks.lattices import heart_lattice
from heartcase.schemas.arrays import Bool, Float32, Float64
from heartcase.simulator.cutting.blade_sheet import Sheet
from heartcase.simulator.cutting.parted_lattice import PartedLattice, part
from heartcase.simulator.cutting.tissue_samples import TissueSamples
from heartcase.simulator.dynamics.integrate import Verlet
from heartcase.simulator.dynamics.step_size import default_step
from heartcase.simulator.engine.backends import make_engine
from heartcase.simulator.engine.cpu.engine import CpuEngine
from heartcase.simulator.lattice.force_law import ForceLaw
from heartcase.simulator.lattice.model import LatticeModel
from heartcase.simulator.lattice.state import State

TISSUE = TissueSamples.everywhere()
_NORMAL, _ALONG = np.array([0.25, 0.95, 0.2]), np.array([1.0, 0.0, 0.3])
"""Directions of the square, i, j, k."""


@dataclass(frozen=True)
class Inputs:
    """A lattice, a blade and a state away from rest."""

    model: LatticeModel
    sheet: Sheet
    corners: Float64
    """Middle of the square and its two half sides [cells], shape (3, 3)."""
    cut: PartedLattice
    start: State
    verlet: Verlet
    step_count: int
    memory: dict[str, CpuEngine]
    """Engines that are made already, by method."""


def prepare(params: dict[str, Any]) -> Inputs:
    model = heart_lattice(params["node_count"]).with_law(ForceLaw(params.get("law", "springs")))
    low, high = 1.0, 80.0
    while high / low > 1.02:
        size = np.sqrt(low * high)
        more = part(model, [_square(model, size)[0]], TISSUE).model.spring_count - model.spring_count
        low, high = (size, high) if more < params["springs"] else (low, size)
    sheet, corners = _square(model, high)
    generator = np.random.Generator(np.random.PCG64(1))
    displacement = generator.normal(0.0, 0.005, (model.node_count, 3)).astype(np.float32)
    displacement[model.node_is_fixed] = 0.0
    start = State(displacement, np.zeros_like(displacement))
    verlet = Verlet(default_step(model) / model.units.time_s, damping=10.0 * model.units.time_s)
    cut = part(model, [sheet], TISSUE)
    return Inputs(model, sheet, corners, cut, start, verlet, params["step_count"], {})


def _square(model: LatticeModel, size: float) -> tuple[Sheet, Float64]:
    """A square of half a side of ``size`` [cells], about the middle of a wall."""
    normal = _NORMAL / np.linalg.norm(_NORMAL)
    along = np.cross(np.cross(normal, _ALONG), normal)
    along *= size / np.linalg.norm(along)
    across = np.cross(normal, along)
    middle = model.node_index[model.node_count // 2] + np.array([0.31, 0.27, 0.43])
    corners = [[middle - along - across, middle + along - across], [middle - along + across, middle + along + across]]
    return Sheet.swept(corners), np.stack([middle, along, across])


def cut(inputs: Inputs) -> CpuEngine:
    parted = part(inputs.model, [inputs.sheet], TISSUE)
    engine = CpuEngine(parted.model)
    engine.load(parted.carried(inputs.start))
    return engine


def springs_removed(inputs: Inputs) -> CpuEngine:
    if "removed" not in inputs.memory:
        inputs.memory["removed"] = CpuEngine(inputs.model)
    engine = inputs.memory["removed"]
    engine.set_springs(inputs.model.without_springs(crossed_springs(inputs.model, inputs.corners)))
    return engine


def steps(inputs: Inputs) -> CpuEngine:
    if "cut" not in inputs.memory:
        inputs.memory["cut"] = cut(inputs)
    return _stepped(inputs, inputs.memory["cut"])


def steps_uncut(inputs: Inputs) -> CpuEngine:
    if "uncut" not in inputs.memory:
        inputs.memory["uncut"] = CpuEngine(inputs.model)
        inputs.memory["uncut"].load(inputs.start)
    return _stepped(inputs, inputs.memory["uncut"])


def _stepped(inputs: Inputs, engine: CpuEngine) -> CpuEngine:
    engine.advance(inputs.step_count, inputs.verlet)
    return engine


def crossed_springs(model: LatticeModel, corners: Float64) -> Bool:
    """Springs that a rectangle crosses, given by its middle and two half sides, shape (spring_count,)."""
    middle, along, across = corners
    normal = np.cross(along, across)
    ends = model.node_index[model.spring_nodes] - middle
    height = ends @ normal
    way = np.divide(
        height[:, 0], height[:, 0] - height[:, 1], out=np.full(len(ends), -1.0), where=height[:, 0] != height[:, 1]
    )
    at = ends[:, 0] + way[:, None] * (ends[:, 1] - ends[:, 0])
    is_inside = (np.abs(at @ along) <= along @ along) & (np.abs(at @ across) <= across @ across)
    crossed: Bool = is_inside & (way >= 0) & (way <= 1)
    return crossed


METHODS = {"cut": cut, "springs_removed": springs_removed, "steps": steps, "steps_uncut": steps_uncut}


def errors(inputs: Inputs, output: CpuEngine) -> dict[str, float]:
    """How far 20 steps are from the reference's, and what the cut added."""
    model = output.model
    fast = CpuEngine(model)
    is_cut = model.node_count != inputs.model.node_count
    start = inputs.cut.carried(inputs.start) if is_cut else inputs.start
    ends: list[Float32] = []
    for engine in (fast, make_engine(model, "reference")):
        engine.load(start)
        engine.advance(20, inputs.verlet)
        ends.append(engine.read().displacement)
    springs = inputs.cut.model.spring_count - inputs.model.spring_count if is_cut else 0
    return {
        "largest difference to the reference after 20 steps [cells]": float(np.abs(ends[0] - ends[1]).max()),
        "nodes [1]": float(model.node_count),
        "springs more [1]": float(springs),
        "irregular springs [1]": float(fast.layout.irregular_springs(model).sum()),
        "irregular cells [1]": float(len(fast.layout.irregular_cells)),
        "steps per run [1]": float(inputs.step_count),
    }
