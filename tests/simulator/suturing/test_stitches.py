"""Stitches in moving tissue: what they bear, what they keep, and that cuts, snapshots and sleep know of them."""

from __future__ import annotations

import numpy as np
import pytest

from heartcase.schemas.errors import SimulationError
from heartcase.simulator.simulation import Simulation
from heartcase.simulator.suturing.places import Place, nearest_on_surface, place_near
from heartcase.simulator.suturing.stitches import StitchState
from tests.simulator.cutting.test_cuts import across_bar
from tests.simulator.lattices import block, oblique_geometry
from tests.simulator.suturing.threads import two_blocks

BACKENDS = ("cpu", "reference")
MIDDLE = 3.0  # of a face of three cells of 2 mm [mm]
LOWER, UPPER = (MIDDLE, MIDDLE, 6.0), (MIDDLE, MIDDLE, 10.0)


def hanging(backend="cpu", **options):
    """A free cube under one that is held, with a stitch from face to face."""
    simulation = Simulation(two_blocks(upper_fixed=True), backend=backend, **options)
    return simulation, simulation.stitch([LOWER, UPPER])


@pytest.mark.parametrize("backend", BACKENDS)
def test_a_stitch_that_a_block_hangs_on_bears_its_weight(backend):
    """Statics: the force is the mass times the acceleration of gravity, however the tissue gives."""
    simulation, stitch = hanging(backend, damping_per_s=40.0, gravity_m_s2=(0.0, 0.0, -9.81))
    simulation.step(4000)
    at_end = simulation.stitch_state(stitch)
    mass_kg = simulation.model.node_mass[simulation.model.node_index[:, 2] <= 3].sum() * simulation.model.units.mass_kg
    assert mass_kg == pytest.approx(216e-9 * 1060, rel=1e-6)
    assert at_end.force_n == pytest.approx(mass_kg * 9.81, rel=1e-3)
    stiffness_n_m = stitch.stiffness * simulation.model.units.force_n / simulation.model.units.length_m
    assert at_end.distance_mm - at_end.length_mm == pytest.approx(1e3 * at_end.force_n / stiffness_n_m, rel=1e-3)
    assert at_end.places_mm[0][:2] == pytest.approx([MIDDLE, MIDDLE], abs=1e-3)


def test_a_thread_drawn_with_a_tension_pulls_with_it_and_keeps_it_when_it_is_tied():
    simulation, stitch = hanging(damping_per_s=40.0, gravity_m_s2=(0.0, 0.0, -9.81))
    heavy = 3e-3  # more than the weight: the block is drawn up
    simulation.draw(stitch, tension_n=heavy)
    simulation.step(50)
    state = simulation.stitch_state(stitch)
    assert state.force_n == pytest.approx(heavy, rel=1e-5)
    assert state.drawn_n == pytest.approx(heavy, rel=1e-5)
    simulation.tie(stitch)
    tied = simulation.stitch_state(stitch)
    assert tied.drawn_n is None
    assert tied.is_tied
    assert tied.force_n == pytest.approx(heavy, rel=1e-5)
    assert tied.length_mm == pytest.approx(state.length_mm, abs=1e-6)
    with pytest.raises(SimulationError, match="is tied"):
        simulation.draw(stitch, length_mm=0.0)
    simulation.step(4000)
    assert simulation.stitch_state(stitch).force_n == pytest.approx(216e-9 * 1060 * 9.81, rel=2e-3)


def test_a_state_that_is_made_by_position_means_what_it_did():
    state = StitchState("stay", False, np.zeros((2, 3)), 0.1, 2.0, 2.5, "row", True)
    assert (state.row, state.is_running, state.drawn_n) == ("row", True, None)


@pytest.mark.parametrize(("backend", "part"), [("reference", 1e-13), ("cpu", 1e-5)])
def test_momentum_of_two_free_blocks_is_kept(backend, part):
    """Exactly, but for the rounding of what is added up; the blocks go towards each other with one momentum."""
    simulation = Simulation(two_blocks(), backend=backend, damping_per_s=0.0, sleep_mm=0.0)
    stitch = simulation.stitch([LOWER, UPPER])
    simulation.draw(stitch, length_mm=1.0)
    simulation.step(60)
    state, mass = simulation.state, simulation.model.node_mass[:, None].astype(float)
    velocity = getattr(state, "precise_velocity", state.velocity).astype(float)
    lower = simulation.model.node_index[:, 2] <= 3
    momentum = (mass * velocity)[lower].sum(axis=0)
    assert momentum[2] > 0.01
    assert np.abs((mass * velocity).sum(axis=0)).max() <= part * momentum[2]


def test_energy_never_rises_once_a_thread_is_drawn():
    simulation, stitch = hanging("reference", damping_per_s=5.0)
    simulation.draw(stitch, length_mm=2.0)
    simulation.step(80)
    simulation.tie(stitch)
    energies = []
    for _ in range(60):
        energies.append(simulation.energy().total_j)
        simulation.step(20)
    assert energies[0] > 0
    assert (np.diff(energies) < 0).all()


def test_a_stitch_pulls_the_place_that_was_chosen_and_no_node():
    model = block(6, 4, 3, geometry=oblique_geometry((3, 4, 6)))
    simulation = Simulation(model)
    rng = np.random.default_rng(4)
    for local in rng.uniform(0.1, 0.9, (5, 3)):
        first, second = model.geometry.index_to_world(np.array([[1, 1, 1], [4, 2, 1]]) + local - 0.5)
        stitch = simulation.stitch([first, second])
        np.testing.assert_allclose(simulation.stitch_state(stitch).places_mm, [first, second], atol=1e-4)
        assert (stitch.shares.reshape(2, 8).sum(axis=1, dtype=np.float32) == (-1, 1)).all()
        assert len(np.unique(stitch.nodes)) == 16


def test_places_of_moved_tissue_are_found_where_they_are_now_or_at_rest():
    model = block(8, 3, 3, cell_mm=2.0)
    simulation = Simulation(model)
    x = model.node_index[:, 0]
    moved = np.stack([0.1 * x, 0.02 * x**2, 0.05 * x], axis=1).astype(np.float32)
    local = (0.3, 0.6, 0.2)
    cell = int(np.flatnonzero((model.cells == (4, 1, 1)).all(axis=1))[0])
    from heartcase.simulator.suturing.places import nodes_and_weights

    nodes, weights = nodes_and_weights(model, cell, local)
    now = weights @ (model.node_index[nodes] + moved[nodes].astype(float))
    found = place_near(model, simulation.nothing_cut(), moved, now)
    assert found.cell == cell
    assert found.local == pytest.approx(local, abs=1e-4)
    at_rest = place_near(model, simulation.nothing_cut(), np.zeros_like(moved), model.cells[cell] + local)
    assert at_rest.local == pytest.approx(local, abs=1e-9)


def test_the_nearest_place_of_a_surface():
    vertices = np.array([(0.0, 0, 0), (4, 0, 0), (0, 4, 0), (0, 0, 4)])
    triangles = np.array([(0, 2, 1), (0, 1, 3), (0, 3, 2), (1, 2, 3)], np.int32)
    found = nearest_on_surface((1.0, 1.0, -0.5), vertices, triangles)
    assert found.point == pytest.approx((1, 1, 0))
    assert found.behind == pytest.approx((1, 1, 0.125))
    assert found.distance == pytest.approx(0.5)


@pytest.mark.parametrize("backend", BACKENDS)
def test_after_a_cut_each_place_follows_its_own_side(backend):
    """A thread across a bar that is then cut through between its places, and one on one side of the cut."""
    model = block(9, 4, 4, geometry=oblique_geometry((4, 4, 9)))
    model.node_is_fixed[model.node_index[:, 0] == 0] = True
    simulation = Simulation(model, backend=backend, damping_per_s=20.0)

    def at(x, y, z):
        return model.geometry.index_to_world(np.array([x, y, z]) - 0.5)

    across = simulation.stitch([at(4.2, 2.1, 4.0), at(4.8, 2.1, 4.0)], name="across")
    beside = simulation.stitch([at(1.5, 2.1, 4.0), at(2.5, 2.1, 4.0)], name="beside")
    for stitch in (across, beside):
        simulation.draw(stitch, length_mm=0.5 * stitch.length * model.cell_mm)
    simulation.step(100)
    before = [simulation.stitch_state(stitch) for stitch in (across, beside)]
    moment, elastic = simulation.snapshot(), simulation.energy().elastic_j
    simulation.cut(across_bar(simulation.model, 4.5, 9.0))
    after = [simulation.stitch_state(stitch) for stitch in (across, beside)]
    assert simulation.energy().elastic_j <= elastic * (1 + 1e-6)
    for was, now in zip(before, after, strict=True):
        np.testing.assert_allclose(now.places_mm, was.places_mm, atol=2e-3)
        assert 0 < now.force_n <= was.force_n * (1 + 1e-3)
    ends = across.nodes.reshape(2, 8), np.abs(across.shares.reshape(2, 8))
    # The half that is cut off hangs on the thread alone, and the bar's end comes nearer.
    parts = parts_of(simulation.model)
    first, second = (set(parts[nodes[weights > 0]]) for nodes, weights in zip(*ends, strict=True))
    assert len(first) == len(second) == 1
    assert first != second
    assert set(parts[beside.nodes]) == first
    end = simulation.model.node_index[:, 0] == 9
    simulation.step(300)
    assert simulation.stitch_state(across).force_n < before[0].force_n
    moved = simulation.state.displacement[end, 0].mean()
    assert moved < moment.state.displacement[moment.model.node_index[:, 0] == 9, 0].mean()
    simulation.restore(moment)
    assert across.nodes.max() < model.node_count
    again = simulation.stitch_state(across)
    assert again.force_n == before[0].force_n
    assert again.places_mm.tobytes() == before[0].places_mm.tobytes()


def parts_of(model):
    """Number of what each node hangs together with by cells, shape (node_count,)."""
    from heartcase.simulator.surface_splitting.free_parts import parts_of_lattice

    parts = np.full(model.node_count, -1)
    parts[model.cell_corners] = parts_of_lattice(model)[:, None]
    return parts


def test_cuts_in_any_order_bind_a_place_to_the_same_nodes():
    model = block(9, 4, 4, geometry=oblique_geometry((4, 4, 9)))
    one, other = across_bar(model, 4.5, 9.0), across_bar(model, 6.3, 2.0)
    shares = []
    for order in ((one, other), (other, one)):
        simulation = Simulation(model)
        stitch = simulation.stitch(
            [model.geometry.index_to_world(np.array(p) - 0.5) for p in ((4.2, 2, 4), (6.6, 1, 4))]
        )
        for poses in order:
            simulation.cut(poses, at_rest=True)
        shares.append((simulation.model.node_index[stitch.nodes].tolist(), stitch.shares.tolist()))
        hung = simulation.model.cell_corners
        assert all((hung == nodes).all(axis=1).any() for nodes in stitch.nodes.reshape(2, 8))
    assert shares[0] == shares[1]


def test_tissue_at_the_other_end_of_a_thread_does_not_sleep():
    """Two blocks far apart: where one is pulled, the other follows as if no tissue ever slept."""
    ends = []
    for sleep_mm in (0.0, 0.05):
        model = two_blocks(gap=20)
        model.node_is_fixed[model.node_index[:, 2] == 26] = True
        simulation = Simulation(model, sleep_mm=sleep_mm, damping_per_s=20.0)
        stitch = simulation.stitch([LOWER, (MIDDLE, MIDDLE, 46.0)])
        simulation.step(1000)
        hand = simulation.grab((MIDDLE, MIDDLE, 0.0), 3.0)
        simulation.lead(hand, (0.0, 0.0, -6.0))
        simulation.step(700)
        ends.append((simulation.displacement_mm(), simulation.stitch_state(stitch).force_n))
    assert ends[0][1] > 0
    upper = two_blocks(gap=20).node_index[:, 2] >= 23
    assert np.abs(ends[0][0][upper]).max() > 0.02
    assert np.abs(ends[0][0] - ends[1][0]).max() < 0.05


def test_snapshots_hold_stitches():
    simulation, stitch = hanging(gravity_m_s2=(0, 0, -9.81))
    simulation.step(30)
    moment = simulation.snapshot()
    ends = []
    for _ in range(2):
        simulation.draw(stitch, length_mm=1.0)
        simulation.step(20)
        simulation.step(20)
        simulation.tie(stitch)
        simulation.step(20)
        ends.append(simulation.state.displacement.tobytes())
        simulation.take_out(stitch)
        simulation.step(5)
        assert simulation.stitches == []
        simulation.restore(moment)
        assert simulation.stitches == [stitch]
        assert not stitch.is_tied
    assert ends[0] == ends[1]
    simulation.restore(moment.state)
    assert simulation.stitches == [stitch]


def test_what_cannot_be_sewn_is_refused_and_changes_nothing():
    simulation, stitch = hanging()
    refused = [
        (lambda: simulation.stitch([LOWER]), "two places"),
        (lambda: simulation.stitch([LOWER, (90.0, 0, 0)]), "no tissue within 6 mm"),
        (lambda: simulation.stitch([LOWER, (np.nan, 0, 0)]), "finite"),
        (lambda: simulation.stitch([LOWER, UPPER], stiffness_n_m=1e6), "stiffer than the time step allows"),
        (lambda: simulation.stitch([LOWER, UPPER], stiffness_n_m=-1.0), "above 0"),
        (lambda: simulation.draw(stitch), "either"),
        (lambda: simulation.draw(stitch, length_mm=1.0, tension_n=1.0), "either"),
        (lambda: simulation.draw(stitch, length_mm=-1.0), "0 mm or more"),
        (lambda: simulation.draw(stitch, tension_n=np.inf), "0 N or more"),
    ]
    for do, message in refused:
        with pytest.raises(SimulationError, match=message):
            do()
        assert simulation.stitches == [stitch]
    held = two_blocks(upper_fixed=True)
    held.node_is_fixed[:] = True
    with pytest.raises(SimulationError, match="held for good"):
        Simulation(held, step_s=1e-4).stitch([LOWER, UPPER])
    simulation.take_out(stitch)
    simulation.take_out(stitch)
    for do in (simulation.tie, simulation.stitch_state, lambda one: simulation.draw(one, length_mm=1.0)):
        with pytest.raises(SimulationError, match="taken out"):
            do(stitch)


def test_many_stitches_in_one_place_share_what_the_step_allows():
    simulation, _ = hanging()
    for number in range(12):
        simulation.stitch([LOWER, UPPER], name=str(number))
    assert simulation._thread_rate() <= simulation._thread_rate_limit(simulation.model, None)
    assert simulation.step_limit_s > simulation.step_s
    for stitch in simulation.stitches:
        simulation.draw(stitch, length_mm=0.0)
    for _ in range(10):
        simulation.step(100)
    assert simulation.inverted_cell_count() == 0
    assert np.linalg.norm(simulation.displacement_mm(), axis=1).max() < 10.0


def test_a_place_of_another_lattice_is_refused():
    simulation, _ = hanging()
    with pytest.raises(SimulationError, match="another lattice"):
        simulation.stitch([Place(99999, 0, (0.5, 0.5, 0.5)), LOWER])
