"""Scripts at random of what no surgeon does: far, fast hands, probes through tissue, slivers, coincident nodes."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from heartcase.schemas.bundle.lattice import cell_nodes
from heartcase.schemas.errors import SimulationError
from heartcase.simulator.dynamics.measures import inverted_cells
from heartcase.simulator.dynamics.step_size import default_step
from heartcase.simulator.lattice.model import LatticeModel, make_model
from heartcase.simulator.lattice.moduli import ForceLaw
from heartcase.simulator.lattice.state import State
from heartcase.simulator.simulation import Simulation
from tests.simulator.lattices import block_cells, random_moments
from tests.stress.cut_scripts import random_blade

SETTLED_STEPS = 250
"""Steps between two counts of the cells that are inside out, once the hands have left."""


@dataclass(frozen=True)
class Outcome:
    """What a script did to the tissue."""

    deeds: tuple[str, ...]
    """What was done, in order."""
    inverted_most: int
    """Most cells that were inside out at once."""
    inverted_left: int
    """Cells inside out at the end, of those that no cut has touched or bordered."""
    settled_s: float
    """Time until there were none, or until the end, s."""
    hurried_left: int
    """Free nodes that move at the speed limit for good."""
    way_most: float
    """Largest displacement at the end [cells]."""


def tissue(rng: np.random.Generator, law: ForceLaw) -> LatticeModel:
    """Up to 9 x 5 x 5 cells, some missing, half of them of a coverage from 0.02 up, on a fixed base."""
    cells = block_cells(*rng.integers(2, [10, 6, 6]))
    kept = rng.random(len(cells)) < rng.uniform(0.5, 1.0)
    kept[0] = True
    cells = cells[kept]
    is_full = rng.random(len(cells)) < 0.5
    moments = random_moments(len(cells), rng)
    moments[is_full] = [0, 0, 0, 1 / 12, 1 / 12, 1 / 12, 0, 0, 0]
    return make_model(
        cells,
        coverage=np.where(is_full, 1.0, rng.uniform(0.02, 1.0, len(cells))),
        moments=moments,
        stiffness_kpa=rng.uniform(10.0, 60.0, len(cells)) if rng.random() < 0.5 else 30.0,
        fixed=cell_nodes(cells)[0][:, 2] == 0,
        cell_mm=2.5,
        law=law,
    )


def run(
    seed: int,
    law: ForceLaw,
    backend: str,
    settle_steps: int = 3000,
    step_factor: float = 1.0,
    *,
    has_blades: bool = False,
) -> Outcome:
    """Run one script; an error of the simulation is the caller's.

    Its cuts take springs away, or with ``has_blades`` part the tissue.

    The default step, for elements at its pace, or a multiple of it; a damping of 30/s.
    """
    rng = np.random.default_rng(seed)
    model = tissue(rng, law)
    step_s = None if step_factor == 1.0 else step_factor * default_step(model)
    simulation = Simulation(model, damping_per_s=30.0, backend=backend, step_s=step_s)  # type: ignore[arg-type]
    deeds = []
    inverted_most = 0
    for _ in range(rng.integers(3, 7)):
        deed = (_grab, _probe, _part if has_blades else _cut, _tie, _collapse, _kick)[rng.integers(6)]
        deeds.append(deed.__name__[1:])
        deed(simulation, rng)
        simulation.step(50)
        inverted_most = max(inverted_most, simulation.inverted_cell_count())
    for hand in list(simulation.grabs):
        simulation.release(hand)
    simulation.remove_explicit_springs(np.ones(simulation.model.explicit.count, dtype=bool))
    start_s = simulation.time_s
    for _ in range(settle_steps // SETTLED_STEPS):
        simulation.step(SETTLED_STEPS)
        left = int(
            (inverted_cells(simulation.model, simulation.state.displacement) & _untouched(simulation.model)).sum()
        )
        if not left:
            break
    settled_s = simulation.time_s - start_s
    way = float(np.abs(simulation.state.displacement).max())
    hurried = simulation.watch().hurried_node_count
    if hurried:
        simulation.step(settle_steps)
        hurried = simulation.watch().hurried_node_count
    return Outcome(tuple(deeds), inverted_most, left, settled_s, hurried, way)


def _untouched(model: LatticeModel) -> np.ndarray:
    """Cells of which no node belongs to a cell that was cut."""
    near = np.zeros(model.node_count, dtype=bool)
    near[model.cell_corners[~model.cell_is_whole]] = True
    return ~near[model.cell_corners].any(axis=1)


def _grab(simulation: Simulation, rng: np.random.Generator) -> None:
    size = np.ptp(simulation.model.rest_positions_mm(), axis=0)
    at = simulation.positions_mm()[rng.integers(simulation.model.node_count)]
    try:
        hand = simulation.grab(at, float(rng.uniform(2.0, 8.0)))
    except SimulationError:
        return  # another hand holds it all
    for _ in range(rng.integers(1, 4)):
        turn = np.linalg.qr(rng.normal(size=(3, 3)))[0]
        turn *= np.sign(np.linalg.det(turn))
        way = rng.uniform(-2.0, 2.0, 3) * size * rng.random()  # pulled to three times the size
        simulation.lead(hand, way, turn if rng.random() < 0.3 else None)
        simulation.step(int(rng.integers(10, 200)))
    if rng.random() < 0.7:
        simulation.release(hand)


def _probe(simulation: Simulation, rng: np.random.Generator) -> None:
    at = simulation.model.rest_positions_mm()[rng.integers(simulation.model.node_count)]
    probe = simulation.probe(at + rng.uniform(-5, 5, 3), rng.uniform(2.0, 6.0, 3))
    for _ in range(rng.integers(1, 5)):
        simulation.move(probe, at + rng.uniform(-15, 15, 3))
        simulation.step(int(rng.integers(10, 150)))
    simulation.withdraw(probe)


def _cut(simulation: Simulation, rng: np.random.Generator) -> None:
    model = simulation.model
    if rng.random() < 0.5:
        simulation.remove_springs(rng.random(model.spring_count) < rng.uniform(0.0, 0.5))
    else:
        simulation.remove_springs(model.node_index[model.spring_nodes, 0].min(axis=1) == rng.integers(0, 6))


def _part(simulation: Simulation, rng: np.random.Generator) -> None:
    at = simulation.model.rest_positions_mm()
    for _ in range(rng.integers(1, 4)):
        simulation.cut(random_blade(rng, at.min(axis=0), at.max(axis=0)), at_rest=True)


def _tie(simulation: Simulation, rng: np.random.Generator) -> None:
    pair = rng.permutation(simulation.model.node_count)[:2]
    try:
        simulation.add_springs([pair], float(rng.uniform(0.1, 5.0)), float(rng.uniform(0.0, 20.0)))
    except SimulationError:
        return  # too stiff for the step, and said so


def _collapse(simulation: Simulation, rng: np.random.Generator) -> None:
    """Some corners of a cell on one spot."""
    model, state = simulation.model, simulation.state
    corners = rng.permutation(model.cell_corners[rng.integers(model.cell_count)])[: rng.integers(2, 7)]
    corners = corners[~model.node_is_fixed[corners]]
    displacement = state.displacement.copy()
    if len(corners):
        spot = model.node_index[corners[0]] + displacement[corners[0]]
        displacement[corners] = spot - model.node_index[corners]
    simulation.restore(State(displacement, state.velocity, state.step_count))


def _kick(simulation: Simulation, rng: np.random.Generator) -> None:
    """Every free node a velocity of up to the speed limit."""
    state = simulation.state
    size = rng.uniform(0.0, simulation.verlet.speed_limit)
    velocity = state.velocity + rng.normal(size=state.velocity.shape) * size
    velocity[simulation.model.node_is_fixed] = 0
    simulation.restore(State(state.displacement, velocity.astype(np.float32), state.step_count))
