"""Plane cuts through the adult's heart: what they take, and what steps take after them.

The blade is a square that lies askew, as large as it must be to cross so many springs; where one through the whole
heart crosses fewer, there are several side by side. ``cut`` parts the lattice and makes the engine that goes on with
it; ``springs_removed`` is the plain way: the springs that the squares cross are taken away. ``steps`` and
``steps_uncut`` take the same number of steps with and without the cut.

``python -m benchmarks.cut_heart`` takes steps with and without it in turn, on one thread, and prints what of the
processor's time one takes: that can be compared on a busy machine, too.
"""

from __future__ import annotations

from dataclasses import dataclass
from time import thread_time
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
from heartcase.simulator.engine.shared.contact import NO_PROBES
from heartcase.simulator.lattice.model import LatticeModel
from heartcase.simulator.lattice.moduli import ForceLaw
from heartcase.simulator.lattice.state import State

TISSUE = TissueSamples.everywhere()
SQUARES_MOST = 8
_LARGEST, _APART = 80.0, 6.0
"""Half the side of a square through the whole heart, and how far two are apart [cells]."""
_NORMAL, _ALONG = np.array([0.25, 0.95, 0.2]), np.array([1.0, 0.0, 0.3])
"""Directions of the square, i, j, k."""


@dataclass(frozen=True)
class Inputs:
    """A lattice, a blade and a state away from rest."""

    model: LatticeModel
    sheets: list[Sheet]
    crossed: Bool
    """Springs that they cross, shape (spring_count,)."""
    cut: PartedLattice
    start: State
    verlet: Verlet
    step_count: int
    memory: dict[str, CpuEngine]
    """Engines that are made already, by method."""


def prepare(params: dict[str, Any]) -> Inputs:
    model = heart_lattice(params["node_count"]).with_law(ForceLaw(params.get("law", "springs")))
    wanted = params["springs"]
    for count in range(1, SQUARES_MOST + 1):
        squares = [_square(model, _LARGEST, number) for number in range(count)]
        if _crossed_by_any(model, squares).sum() >= wanted:
            break
    low, high = 1.0, _LARGEST
    while high / low > 1.005:
        size = np.sqrt(low * high)
        crossed = _crossed_by_any(model, [_square(model, size, number) for number in range(count)])
        low, high = (size, high) if crossed.sum() < wanted else (low, size)
    squares = [_square(model, high, number) for number in range(count)]
    sheets = [Sheet.swept(_corners(square)) for square in squares]
    crossed = _crossed_by_any(model, squares)
    generator = np.random.Generator(np.random.PCG64(1))
    displacement = generator.normal(0.0, 0.005, (model.node_count, 3)).astype(np.float32)
    displacement[model.node_is_fixed] = 0.0
    start = State(displacement, np.zeros_like(displacement))
    verlet = Verlet(default_step(model) / model.units.time_s, damping=10.0 * model.units.time_s)
    cut = part(model, sheets, TISSUE)
    return Inputs(model, sheets, crossed, cut, start, verlet, params["step_count"], {})


def _square(model: LatticeModel, size: float, number: int) -> Float64:
    """Middle and two half sides of ``size`` [cells], shape (3, 3): about the middle of a wall, or beside it in turn."""
    normal = _NORMAL / np.linalg.norm(_NORMAL)
    along = np.cross(np.cross(normal, _ALONG), normal)
    along *= size / np.linalg.norm(along)
    across = np.cross(normal, along)
    middle = model.node_index[model.node_count // 2] + np.array([0.31, 0.27, 0.43])
    aside = _APART * (number + 1) // 2 * (-1.0) ** number
    return np.stack([middle + aside * normal, along, across])


def _corners(square: Float64) -> Float64:
    middle, along, across = square
    return np.array([[middle + b * across + a * along for a in (-1, 1)] for b in (-1, 1)])


def _crossed_by_any(model: LatticeModel, squares: list[Float64]) -> Bool:
    crossed: Bool = np.any([crossed_springs(model, square) for square in squares], axis=0)
    return crossed


def cut(inputs: Inputs) -> CpuEngine:
    parted = part(inputs.model, inputs.sheets, TISSUE)
    engine = CpuEngine(parted.model)
    engine.load(parted.carried(inputs.start))
    return engine


def springs_removed(inputs: Inputs) -> CpuEngine:
    if "removed" not in inputs.memory:
        inputs.memory["removed"] = CpuEngine(inputs.model)
    engine = inputs.memory["removed"]
    engine.set_springs(inputs.model.without_springs(inputs.crossed))
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
        "springs crossed [1]": float(inputs.crossed.sum()) if is_cut else 0.0,
        "springs more [1]": float(springs),
        "irregular springs [1]": float(len(fast.layout.irregular_springs(model))),
        "irregular cells [1]": float(len(fast.layout.irregular_cells)),
        "steps per run [1]": float(inputs.step_count),
    }


def main(turns: int = 9, step_count: int = 150) -> None:
    """Print what a step takes on one thread: microseconds of the processor's time, the least of some turns."""
    for law in ("springs", "element"):
        for springs in (100, 1000, 10000):
            inputs = prepare({"node_count": 30000, "law": law, "springs": springs, "step_count": step_count})
            engines = CpuEngine(inputs.model), CpuEngine(inputs.cut.model)
            times: list[list[float]] = [[], []]
            for engine, state in zip(engines, (inputs.start, inputs.cut.carried(inputs.start)), strict=True):
                engine.load(state)
                engine.advance_by(1, 8, inputs.verlet, NO_PROBES)
            for _ in range(turns):
                for engine, taken in zip(engines, times, strict=True):
                    start = thread_time()
                    engine.advance_by(1, step_count, inputs.verlet, NO_PROBES)
                    taken.append(1e6 * (thread_time() - start) / step_count)
            uncut, cut = map(min, times)
            more = [
                f"{100 * (after / before - 1):.1f}% more {of_what}"
                for of_what, before, after in (
                    ("nodes", inputs.model.node_count, inputs.cut.model.node_count),
                    ("cells", inputs.model.cell_count, inputs.cut.model.cell_count),
                    ("springs", inputs.model.spring_count, inputs.cut.model.spring_count),
                )
            ]
            print(
                f"{law}, {inputs.crossed.sum()} crossed, {', '.join(more)}: "
                f"{uncut:.0f}, {cut:.0f} us a step, {uncut / cut:.2f}",
                flush=True,
            )


if __name__ == "__main__":
    main()
