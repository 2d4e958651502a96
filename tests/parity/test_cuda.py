"""The CUDA kernels against the reference: on a device with large lattices, in numba's simulator with small ones."""

from __future__ import annotations

import os
import subprocess
import sys

import numpy as np
import pytest
from hypothesis import HealthCheck, assume, given, settings
from hypothesis import strategies as st

from heartcase.schemas.errors import SimulationError
from heartcase.simulator.dynamics.integrate import Verlet
from heartcase.simulator.engine.backends import make_engine
from heartcase.simulator.engine.cuda import step_kernels as kernel_cuda
from heartcase.simulator.engine.cuda.engine import CudaEngine, _fitting, plan_launch
from heartcase.simulator.engine.cuda.intrinsics import IS_SIMULATED
from heartcase.simulator.engine.shared.contact import NO_PROBES, probe_row
from heartcase.simulator.engine.shared.lanes import LANE_COUNT, lane_layout
from heartcase.simulator.forces.reference import elastic_forces, spring_forces
from heartcase.simulator.lattice.moduli import ForceLaw
from heartcase.simulator.lattice.state import State
from heartcase.simulator.simulation import Simulation
from tests.parity.test_engines import check_explicit_springs, check_probes, stretch_at_nodes, unguarded
from tests.parity.test_force_laws import force_scale, with_law
from tests.simulator.lattices import EPS, block, cut_models, random_field, random_models, random_probes, tied

SEEDS = st.integers(0, 2**32 - 1)
EXAMPLES = 12 if IS_SIMULATED else 60
STEPS = 3 if IS_SIMULATED else 100
SIZE_MAX = (11, 3, 3) if IS_SIMULATED else (20, 5, 4)
uncut_models = random_models(size_max=SIZE_MAX)
models = st.one_of(uncut_models, cut_models(size_max=SIZE_MAX))
patient = settings(max_examples=EXAMPLES, deadline=None, suppress_health_check=[HealthCheck.too_slow])


def large():
    """A lattice with blocks of full cells; on a device more nodes than can stay in registers."""
    return block(9, 3, 4, fix_base=True) if IS_SIMULATED else block(90, 40, 30, fix_base=True)


@patient
@given(models, SEEDS, st.sampled_from([1e-6, 1e-3, 0.1, 1.0, 10.0]))
def test_forces_agree(model, seed, scale):
    """About 20 roundings in a spring's pull, of at most w |D| each, and 18 pulls to add.

    Division and root are of 2 ulp each on the device: some 24 roundings.
    """
    model = unguarded(model)
    displacement = random_field(model, seed, scale)
    engine = CudaEngine(model)
    engine.load(State(displacement, np.zeros_like(displacement)))
    gap = np.abs(engine.forces() - spring_forces(model, displacement))
    assert (gap <= 48 * EPS * stretch_at_nodes(model, displacement)).all()
    some = np.arange(0, model.node_count, 3)
    np.testing.assert_array_equal(engine.forces(some), engine.forces()[some])


@patient
@given(models)
def test_rest_is_an_exact_equilibrium(model):
    assert np.abs(CudaEngine(model).forces()).max(initial=0.0) == 0


@patient
@given(models, SEEDS, st.floats(0.0, 0.3))
def test_steps_agree(model, seed, damping):
    """Each step rounds the velocity's change to EPS of the movement; all in one direction they add up to n^2 EPS.

    Corners are not guarded: slivers that a cut leaves may get flat between two looks of the device.
    """
    model = unguarded(model)
    displacement = random_field(model, seed, 0.05)
    displacement[model.node_is_fixed] = 0
    step = 0.8 * 2 / np.sqrt(24 * (model.cell_stiffness / model.cell_density).max())
    verlet = Verlet(step=step, damping=damping, gravity=(0.001, -0.002, 0.003))
    ends = []
    for engine in (CudaEngine(model), make_engine(model, "reference")):
        engine.load(State(displacement, np.zeros_like(displacement)))
        engine.advance(STEPS, verlet)
        ends.append(engine.read())
    assert ends[0].step_count == ends[1].step_count == STEPS
    assert np.abs(ends[0].displacement - ends[1].displacement).max() <= max(STEPS, 10) ** 2 * EPS * 0.05
    np.testing.assert_array_equal(ends[0].displacement[model.node_is_fixed], 0.0)


@pytest.mark.thorough
def test_all_ways_to_share_the_nodes_give_the_same_bytes(monkeypatch):
    model = large()
    start = State(random_field(model, 1, 0.1), random_field(model, 2, 0.01))
    ends = []
    for threads in (768, 64):
        monkeypatch.setattr(kernel_cuda, "STREAMING_THREADS", threads)
        engine = CudaEngine(model, resident=False)
        engine.load(start)
        engine.advance(STEPS, Verlet(0.3, 0.01))
        ends.append(engine.read())
    small = block(5, 4, 4, fix_base=True) if IS_SIMULATED else block(40, 20, 20, fix_base=True)
    for resident in (True, False):
        engine = CudaEngine(small, resident=resident)
        engine.load(State(random_field(small, 1, 0.1), random_field(small, 2, 0.01)))
        engine.advance(1, Verlet(0.3, 0.01))
        engine.advance(STEPS - 1, Verlet(0.3, 0.01))
        ends.append(engine.read())
    model = tied(small, 3)
    probes = random_probes(model, 3)
    for resident in (True, False):
        engine = CudaEngine(model, resident=resident)
        engine.advance(2, Verlet(0.1, 0.01), probes)
        ends.append(engine.read())
    for one, other in (ends[:2], ends[2:4], ends[4:]):
        assert one.displacement.tobytes() == other.displacement.tobytes()
        assert one.velocity.tobytes() == other.velocity.tobytes()
        assert len(np.unique(one.displacement)) > 20


@patient
@given(models, SEEDS, st.booleans())
@pytest.mark.thorough
def test_explicit_springs_agree(model, seed, resident):
    assume(model.node_count > 1)
    model = unguarded(tied(model, seed))
    check_explicit_springs(model, seed, [CudaEngine(model, resident=resident), make_engine(model, "reference")], STEPS)


@patient
@given(uncut_models, SEEDS, st.booleans())
def test_probes_push_alike(model, seed, resident):
    model = unguarded(model)
    check_probes(model, seed, [CudaEngine(model, resident=resident), make_engine(model, "reference")], min(STEPS, 30))


LAWS = st.sampled_from(
    [ForceLaw(), ForceLaw("springs", 0.4), ForceLaw("springs", 0.45, False), ForceLaw("element", 0.3)]
)


@patient
@given(models, LAWS, SEEDS, st.sampled_from([1e-3, 0.1, 0.4]))
def test_forces_of_every_law_agree(model, law, seed, size):
    """As on the CPU, with two more roundings in each division."""
    model = with_law(model, law, seed)
    displacement = random_field(model, seed, size)
    engine = CudaEngine(model)
    engine.load(State(displacement, np.zeros_like(displacement)))
    gap = np.abs(engine.forces() - elastic_forces(model, displacement))
    assert (gap <= 48 * EPS * force_scale(model, displacement)).all()


@patient
@given(uncut_models, LAWS, SEEDS, st.booleans())
def test_steps_of_every_law_agree(model, law, seed, has_probes):
    """Corners that are flat from the start push back from the first step on."""
    model = with_law(tied(model, seed) if model.node_count > 1 else model, law, seed)
    displacement = random_field(model, seed, 0.04)
    displacement[0] += 0.6
    displacement[model.node_is_fixed] = 0
    rate = (model.cell_stiffness / model.cell_density).max() + model.explicit.rate_bound(model.inverse_mass)
    verlet = Verlet(step=0.3 / np.sqrt(3.0 * law.rest_bound * rate), damping=0.1)
    probes = (
        probe_row((99.0, 99.0, 99.0), (0.0, 0.0, 0.0), (1.0, 1.0, 1.0), np.eye(3))[None] if has_probes else NO_PROBES
    )
    ends = []
    for engine in (CudaEngine(model), make_engine(model, "reference")):
        engine.load(State(displacement, np.zeros_like(displacement)))
        engine.advance(STEPS, verlet, probes)
        ends.append(engine.read().displacement)
    assert np.abs(ends[0] - ends[1]).max() <= max(STEPS, 10) ** 2 * EPS
    np.testing.assert_array_equal(ends[0][model.node_is_fixed], 0.0)


@pytest.mark.parametrize("resident", [True, False])
def test_corners_that_get_flat_on_the_way_are_found_as_on_the_cpu(resident):
    """A node that is thrown into its cells: for some steps springs act alone, then cells, then springs again."""
    model = block(2, 2, 2, fix_base=True)
    top = int(np.flatnonzero((model.node_index == (1, 1, 2)).all(axis=1))[0])
    velocity = np.zeros((model.node_count, 3), np.float32)
    velocity[top, 2] = -2.0
    verlet = Verlet(step=0.15, damping=0.3)
    engine, cpu = CudaEngine(model, resident=resident), make_engine(model, "cpu")
    launches = []
    alone, with_cells = engine._advance, engine._advance_with_cells
    engine._advance = lambda *given: (launches.append("springs"), alone(*given))
    engine._advance_with_cells = lambda *given: (launches.append("cells"), with_cells(*given))
    for each in (engine, cpu):
        each.load(State(np.zeros_like(velocity), velocity))
    ends = []
    for count in (50, 40):
        for each in (engine, cpu):
            each.advance(count, verlet)
            ends.append(each.read())
    assert launches[:3] == ["springs", "cells", "springs"]
    assert launches[-1] == "springs"
    assert ends[2].step_count == 90
    for one, other in (ends[:2], ends[2:]):
        np.testing.assert_allclose(one.displacement, other.displacement, atol=90 * EPS)


@given(st.integers(1, 3_000_000), st.integers(1, 300), st.sampled_from([64, 256, 768]))
def test_a_launch_takes_every_node_once(node_count, block_count, thread_count):
    launch = plan_launch(node_count, block_count, thread_count)
    assert 1 <= launch.block_count <= block_count
    assert launch.thread_count <= thread_count
    assert launch.thread_count % 32 == 0
    assert launch.share <= launch.thread_count
    assert launch.sweep_count * launch.block_count * launch.share >= node_count
    assert (launch.sweep_count - 1) * launch.block_count * launch.share < node_count


def test_fewer_threads_are_taken_where_the_device_has_fewer_registers():
    """65,536 registers in each of three multiprocessors, 96 a thread: 768 threads do not fit, 384 do."""
    assert _fitting(lambda threads: 3 * (65536 // (96 * threads)), 768) == (3, 384)
    assert _fitting(lambda threads: 7, 640) == (7, 640)
    with pytest.raises(SimulationError, match="choose the backend 'cpu'"):
        _fitting(lambda threads: 0, 640)


def test_windows_of_like_springs_are_those_whose_springs_are_alike():
    model = block(26, 4, 4)
    layout = lane_layout(model)
    uniform = layout.uniform_weight(model)
    assert set(np.unique(uniform)) == {0.0, 1.0}
    window_of = layout.node_slot // LANE_COUNT
    for number in range(layout.window_count):
        inside = np.flatnonzero(window_of == number)
        touched = np.isin(model.spring_nodes, inside)
        is_alike = touched.sum() == 18 * len(inside) and (model.spring_weight[touched.any(axis=1)] == 1).all()
        assert (uniform[number] == 1) == is_alike


def test_hands_pull_on_the_device_as_on_the_reference():
    model = block(4, 3, 3, fix_base=True)
    ends = []
    for backend in ("cuda", "reference"):
        simulation = Simulation(model, backend=backend)
        top = model.rest_positions_mm()[model.node_index[:, 2] == 3].mean(axis=0)
        hand = simulation.grab(top, 1.5 * model.cell_mm)
        simulation.lead(hand, (0.4, -0.7, 0.5))
        simulation.step(3)
        pulled = simulation.force_on(hand)
        simulation.release(hand)
        simulation.step(2)
        ends.append((simulation.positions_mm(), pulled))
    np.testing.assert_allclose(ends[0][0], ends[1][0], atol=100 * EPS * model.cell_mm)
    np.testing.assert_allclose(ends[0][1], ends[1][1], rtol=1e-4)


def test_removed_springs_pull_no_more():
    model = block(4, 3, 3)
    displacement = random_field(model, 1, 0.1)
    cut = model.without_springs(np.arange(model.spring_count) % 3 == 0)
    for resident in (True, False):
        engine = CudaEngine(model, resident=resident)
        engine.load(State(displacement, np.zeros_like(displacement)))
        engine.set_springs(cut)
        gap = np.abs(engine.forces() - spring_forces(cut, displacement))
        assert (gap <= 48 * EPS * stretch_at_nodes(cut, displacement)).all()
        engine.advance(1, Verlet(0.3))
        expected = 0.3 * spring_forces(cut, displacement) * model.inverse_mass[:, None]
        np.testing.assert_allclose(engine.read().velocity, expected, atol=50 * EPS)


def test_without_a_device_the_message_says_what_to_do():
    code = (
        "from heartcase.simulator.engine.backends import make_engine\n"
        "from tests.simulator.lattices import block\n"
        "make_engine(block(1, 1, 1), 'cuda')\n"
    )
    environment = os.environ | {"NUMBA_ENABLE_CUDASIM": "0", "CUDA_VISIBLE_DEVICES": "", "PYTHONWARNINGS": "ignore"}
    done = subprocess.run([sys.executable, "-c", code], env=environment, capture_output=True, text=True, check=False)
    assert done.returncode == 1
    assert "SimulationError" in done.stderr
    assert "pip install '.[cuda]'" in done.stderr.splitlines()[-1]


@pytest.mark.skipif(IS_SIMULATED, reason="there is no CUDA device")
def test_two_million_nodes_on_the_device():
    # Some corners are flat in this state. The engines look for those after different numbers of steps.
    model = unguarded(block(160, 120, 100, fix_base=True))
    start = State(random_field(model, 1, 0.05), random_field(model, 2, 0.01))
    engine, cpu = CudaEngine(model), make_engine(model, "cpu")
    for each in (engine, cpu):
        each.load(start)
        each.advance(100, Verlet(0.3, 0.01))
    gap = np.abs(engine.read().displacement - cpu.read().displacement).max()
    assert gap <= 100**2 * EPS * 0.05
