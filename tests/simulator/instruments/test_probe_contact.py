"""What a probe gives the tissue is what it reports; nothing jumps through it, and no corner is turned."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from heartcase.simulator.dynamics.integrate import Verlet
from heartcase.simulator.dynamics.step_size import default_step
from heartcase.simulator.engine.cpu.engine import CpuEngine
from heartcase.simulator.engine.shared import contact
from heartcase.simulator.engine.shared.contact import probe_row
from heartcase.simulator.engine.shared.turning import CORNER_NODES, SHARE, allowed_parts, make_turn_math
from heartcase.simulator.lattice.model import make_model
from heartcase.simulator.lattice.moduli import ForceLaw
from heartcase.simulator.lattice.state import State
from heartcase.simulator.simulation import Simulation
from tests.simulator.instruments.test_hands import zigzag
from tests.simulator.lattices import block, oblique_geometry

SHAPES = {
    "ball": ((1.2, 1.2, 1.2), None),
    "ellipsoid": ((0.8, 2.0, 1.2), None),
    "capsule": ((1.0,) * 3, (1.0, 3.0, 0.5)),
}
LAWS = {"springs": ForceLaw(), "springs-0.45": ForceLaw("springs", 0.45), "element": ForceLaw("element")}


def momentum(simulation, nodes=slice(None)):
    """Momentum and its moment about the grid's origin [grid units], shape (6,)."""
    model, state = simulation.model, simulation.state
    v = model.node_mass[nodes, None].astype(float) * state.velocity[nodes]
    x = model.node_index[nodes] + state.displacement[nodes].astype(float)
    return np.concatenate([v.sum(axis=0), np.cross(x, v).sum(axis=0)])


@pytest.mark.parametrize(("law", "backend"), [*((law, "cpu") for law in LAWS), ("element", "reference")])
@pytest.mark.parametrize("shape", SHAPES)
def test_what_a_probe_gives_is_what_it_reports(law, shape, backend):
    """A free block without damping has no other momentum, nor moment of it, than what the probe gave."""
    model = block(6, 5, 4, law=LAWS[law], geometry=oblique_geometry((4, 5, 6)))
    h, units, frame = model.cell_mm, model.units, model.geometry.direction_matrix
    simulation = Simulation(model, damping_per_s=0.0, sleep_mm=0.0, backend=backend)
    middle, up = model.rest_positions_mm().mean(axis=0), frame[:, 2]
    axes, axis = SHAPES[shape]
    axis = None if axis is None else np.multiply(axis, h)
    probe = simulation.probe(middle + 5 * h * up, np.multiply(axes, h), axis_mm=axis)
    total = np.zeros(6)
    count = 40 if backend == "cpu" else 12
    for number in range(count):
        simulation.move(probe, middle + (5 - 3 * (number + 1) / count) * h * up)
        simulation.step(1)
        force = simulation.force_on(probe) @ frame / units.force_n
        torque = simulation.wrench_on(probe).torque_n_mm @ frame / (units.force_n * h)
        total -= simulation.verlet.step * np.concatenate([force, torque + np.cross(probe.centre, force)])
    assert np.abs(total).max() > 1.0
    np.testing.assert_allclose(momentum(simulation), total, atol=2e-5 * np.abs(total).max())


def test_what_a_grab_pulls_is_what_the_rest_gains():
    """Free nodes gain what the force on the hand takes, in every step."""
    model = block(6, 3, 3)
    simulation = Simulation(model, damping_per_s=0.0, sleep_mm=0.0)
    hand = simulation.grab(model.rest_positions_mm()[0], 1.5 * model.cell_mm)
    free = np.setdiff1d(np.arange(model.node_count), hand.nodes)
    unit = model.units.force_n
    total = np.zeros(6)
    for number in range(60):
        centre = model.node_index[hand.nodes[0]] + hand.closed_at[0] - hand.arms[0] + hand.pose.offset
        force = simulation.force_on(hand) / unit
        torque = simulation.wrench_on(hand).torque_n_mm / (unit * model.cell_mm)
        simulation.lead(hand, np.array([-0.1, 0.05, 0.1]) * (number + 1))
        simulation.step(1)
        total -= simulation.verlet.step * np.concatenate([force, torque + np.cross(centre, force)])
    assert np.abs(total).max() > 0.1
    np.testing.assert_allclose(momentum(simulation, free), total, atol=1e-4 * np.abs(total).max())


@pytest.mark.parametrize("law", LAWS)
def test_force_is_nothing_without_contact_and_continuous_while_a_probe_slides(law):
    """Along three and a half cells, at a fiftieth of a cell a step: no change of the force beyond a tenth of it."""
    model = block(10, 6, 4, fix_base=True, law=LAWS[law])
    h = model.cell_mm
    simulation = Simulation(model, damping_per_s=60.0)
    at = np.array([3.0, 3.1, 5.6]) * h
    probe = simulation.probe(at, 1.5 * h)
    simulation.step(10)
    assert not simulation.force_on(probe).any()
    assert not simulation.wrench_on(probe).torque_n_mm.any()
    simulation.move(probe, at - np.array([0.0, 0.0, 0.6 * h]))
    simulation.step(1500)
    simulation.step(1500)
    forces = [simulation.force_on(probe)]
    for number in range(440):
        simulation.move(probe, at + np.array([0.008 * h * (number + 1), 0.0, -0.6 * h]))
        simulation.step(4)
        forces.append(simulation.force_on(probe))
    size = np.linalg.norm(forces, axis=1)
    assert size.min() > 0.7 * size.max()
    assert np.linalg.norm(np.diff(forces, axis=0), axis=1).max() < 0.1 * size.mean()
    simulation.move(probe, at + np.array([0.0, 0.0, 3 * h]))
    simulation.step(100)
    simulation.step(10)
    assert not simulation.force_on(probe).any()


@pytest.mark.parametrize("backend", ["cpu", "cuda", "reference"])
def test_a_quick_probe_does_not_jump_through_a_wall(backend):
    """A thin one at a cell a step, on one side of a node before a step and on the other after it."""
    cells = [(i, j, 0) for j in range(6) for i in range(6)]
    model = make_model(cells, cell_mm=2.5)
    simulation = Simulation(model, damping_per_s=0.0, backend=backend)
    h = model.cell_mm
    above, below = (int(np.flatnonzero((model.node_index == (3, 3, k)).all(axis=1))[0]) for k in (1, 0))
    probe = simulation.probe(np.array([3.0, 3.0, 2.0]) * h, (0.55 * h, 0.55 * h, 0.5 * h))
    simulation.move(probe, np.array([3.0, 3.0, 0.3]) * h)
    simulation.step(2)
    assert simulation.positions_mm()[above, 2] < 1.0 * h  # on its way ahead of the probe, not left above it
    assert simulation.positions_mm()[above, 2] > simulation.positions_mm()[below, 2]
    assert simulation.force_on(probe)[2] > 0
    assert simulation.inverted_cell_count() == 0


def test_without_looking_after_corners_cells_turn(monkeypatch):
    model = block(7, 7, 4, fix_base=True)
    monkeypatch.setattr(contact, "allowed_parts", lambda u, *_: (np.ones(u.shape[:2]), False))
    assert zigzag(model, 0, speed=0.3, backend="reference") > 3


def corners(seed, count=200):
    rng = np.random.default_rng(seed)
    u = rng.normal(size=(count, 8, 3)) * rng.uniform(0.02, 0.3, (count, 1, 1))
    moved = rng.normal(size=(count, 8, 3)) * np.exp(rng.uniform(np.log(0.01), 0.0, (count, 1, 1)))
    return u, moved, rng.random((count, 8)) < 0.9


def volumes(u):
    at = u + (np.arange(8)[:, None] >> np.arange(3) & 1)
    edges = [np.moveaxis(at[:, nodes[1:]] - at[:, nodes[:1]], 1, 0) for nodes in map(list, CORNER_NODES)]
    return np.stack([np.einsum("nx,nx->n", a, np.cross(b, c)) for a, b, c in edges], axis=1)


@settings(max_examples=20, deadline=None)
@given(st.integers(0, 2**32 - 1))
def test_no_part_of_what_is_allowed_turns_a_corner(seed):
    """Whichever parts up to those allowed the free nodes take; none are led here."""
    u, moved, _ = corners(seed)
    parts, _ = allowed_parts(u, moved, np.ones(u.shape[:2], bool), np.ones(len(u), bool), 0.0)
    before = volumes(u)
    rng = np.random.default_rng(seed)
    for number in range(8):
        taken = parts * (rng.random(parts.shape) if number % 2 else rng.integers(0, 2, parts.shape))
        after = volumes(u + taken[:, :, None] * moved)
        assert (after[before > 0] >= (1 - SHARE) * before[before > 0] - 1e-4).all()
    assert (parts < 1).any()
    assert (parts == 1).any()


@settings(max_examples=20, deadline=None)
@given(st.integers(0, 2**32 - 1))
def test_kernels_charge_what_inclusion_and_exclusion_does(seed):
    """The formulas, not compiled, against volumes with every choice of nodes moved; some are led."""
    u, moved, free = corners(seed, 30)
    expected, harm = allowed_parts(u, moved, free, np.ones(len(u), bool), 0.0)
    charges, limit, budget, harms, _ = make_turn_math(lambda function: function)
    at = u + (np.arange(8)[:, None] >> np.arange(3) & 1)
    parts, harmed = np.ones_like(expected), False
    for cell in range(len(u)):
        for nodes in CORNER_NODES:
            edges = [tuple(at[cell, node] - at[cell, nodes[0]]) for node in nodes[1:]]
            m = [tuple(moved[cell, node]) for node in nodes]
            volume, *charge = charges(*edges, *m)
            each = budget(volume, *charge, *(bool(free[cell, node]) for node in nodes))
            harmed = harmed or bool(harms(volume, *edges, *m))
            for node, own in zip(nodes, charge, strict=True):
                parts[cell, node] = min(parts[cell, node], limit(each, own, bool(free[cell, node])))
    assert harm == harmed
    np.testing.assert_allclose(parts, expected, rtol=1e-5, atol=1e-6)


@pytest.mark.parametrize("law", LAWS)
@pytest.mark.parametrize("speed", [0.1, 0.9])
def test_leaving_out_what_is_far_changes_no_bit(law, speed):
    """Two probes from far away into quick tissue: against an engine in which all nodes are looked at in every step."""
    model = block(40, 6, 5, law=LAWS[law])
    rng = np.random.default_rng(3)
    start = State(
        rng.uniform(-0.05, 0.05, (model.node_count, 3)).astype(np.float32),
        rng.uniform(-0.02, 0.02, (model.node_count, 3)).astype(np.float32),
    )
    verlet = Verlet(default_step(model) / model.units.time_s, 0.05)
    count = 60
    top = np.array([20.0, 3.0, 5.0])
    centres = top + np.array([[0.0, 0.0, 0.4 * count * speed + 1.0], [-12.0 - 0.9 * count * speed, 0.3, 0.2]])
    ways = speed * np.array([[0.0, 0.0, -1.0], [1.0, 0.0, 0.0]])
    probes = np.stack(
        [probe_row(centre, way, (1.3, 1.3, 1.3), np.eye(3)) for centre, way in zip(centres, ways, strict=True)]
    )
    ends = []
    for looks_at_all in (False, True):
        engine = CpuEngine(model)
        engine.load(start)
        for number in range(count):
            if looks_at_all:
                engine._turn.far_until[:] = 0
            engine.advance_by(1, 1, verlet, probes, first_step=number)
        ends.append((engine.read().displacement.tobytes(), engine.read().velocity.tobytes(), engine.probe_impulse))
        if not looks_at_all:
            assert (engine._turn.far_until > count).mean() > 0.3
    assert ends[0][:2] == ends[1][:2]
    np.testing.assert_array_equal(ends[0][2], ends[1][2])
    assert np.abs(ends[0][2]).max() > 0.1
