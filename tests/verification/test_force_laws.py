"""The force laws against elasticity, their own energy, and what keeps a step stable."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from heartcase.schemas.errors import SimulationError
from heartcase.simulator.dynamics.integrate import Verlet
from heartcase.simulator.dynamics.measures import inverted_cells
from heartcase.simulator.dynamics.spectrum import largest_eigenvalue
from heartcase.simulator.engine.backends import make_engine
from heartcase.simulator.forces.reference import elastic_energy, elastic_forces
from heartcase.simulator.lattice.model import make_model
from heartcase.simulator.lattice.moduli import ForceLaw
from heartcase.simulator.lattice.state import State
from tests.examples import few_and_many, hold_for
from tests.simulator.lattices import block, random_models, random_moments, stiffness_matrix
from tests.thoroughly import thoroughly
from tests.verification.test_elasticity import stretch

LAWS = st.builds(
    ForceLaw,
    st.sampled_from(["springs", "element"]),
    st.sampled_from([0.25, 0.3, 0.45, 0.49]),
    st.booleans(),
    st.booleans(),
)
RATIOS = [0.25, 0.35, 0.45, 0.49]


@settings(max_examples=30, deadline=None)
@given(random_models(size_max=(3, 2, 2)), LAWS, st.integers(0, 2**32 - 1), st.sampled_from([1e-2, 0.2, 1.0]))
def test_forces_are_the_slope_of_the_energy(model, law, seed, size):
    """Central differences of 1e-6: good to 1e-10 of the second slope, and 1e-9 for the rounding of the energy."""
    rng = np.random.default_rng(seed)
    fields = {"coverage": model.cell_coverage, "moments": random_moments(model.cell_count, rng), "law": law}
    model = make_model(model.cells, **fields).without_springs(rng.random(model.spring_count) < 0.05)
    u = rng.uniform(-size, size, (model.node_count, 3))
    way = rng.normal(size=u.shape)
    step = 1e-6
    slope = (elastic_energy(model, u + step * way) - elastic_energy(model, u - step * way)) / (2 * step)
    force = -(elastic_forces(model, u) * way).sum()
    scale = (law.rest_bound + 30.0) * (1.0 + size) ** 4 * model.cell_count
    assert abs(slope - force) <= 1e-8 * scale


@settings(max_examples=30, deadline=None)
@given(random_models(), LAWS, st.integers(0, 2**32 - 1))
def test_energy_of_any_small_uniform_strain_is_hookes(model, law, seed):
    """W = lambda/2 tr(e)^2 + mu e:e over the covered volume, wherever in its cells the tissue lies."""
    rng = np.random.default_rng(seed)
    moments = random_moments(model.cell_count, rng)
    model = make_model(model.cells, coverage=model.cell_coverage, moments=moments, law=law)
    size = 1e-5
    gradient = rng.uniform(-size, size, (3, 3))
    e = (gradient + gradient.T) / 2
    density = law.lame_modulus * np.trace(e) ** 2 / 2 + law.shear_modulus * (e * e).sum()
    expected = model.cell_coverage.sum(dtype=float) * density
    assert elastic_energy(model, model.node_index @ gradient.T) == pytest.approx(expected, rel=500 * size)


@pytest.mark.parametrize("name", ["springs", "element"])
@pytest.mark.parametrize("ratio", RATIOS)
@pytest.mark.parametrize("size", [(3, 2, 1), (1, 1, 1)])
def test_tension_gives_modulus_and_ratio(name, ratio, size):
    model = block(*size, law=ForceLaw(name, ratio))
    pull, ratio_j, ratio_k = stretch(model, size)
    assert pull / (size[1] * size[2] * 1e-3) == pytest.approx(2.5, rel=1e-3)
    assert [ratio_j, ratio_k] == pytest.approx([ratio, ratio], abs=1e-3)


@pytest.mark.parametrize("name", ["springs", "element"])
@pytest.mark.parametrize("ratio", RATIOS)
def test_highest_frequency_of_a_lone_cell(name, ratio):
    law = ForceLaw(name, ratio)
    model = block(1, 1, 1, law=law)
    K = stiffness_matrix(model) / float(model.node_mass[0])
    assert np.linalg.eigvalsh((K + K.T) / 2)[-1] == pytest.approx(law.rest_bound, rel=1e-5)
    assert law.rest_bound == pytest.approx(12 * law.lame_modulus + 8 * law.shear_modulus)


@few_and_many(5, 30)
@pytest.mark.thorough
def test_own_highest_frequency_is_bracketed(count):
    hold_for(
        count, own_highest_frequency_is_bracketed, random_models(size_max=(3, 2, 2)), LAWS, st.integers(0, 2**32 - 1)
    )


def own_highest_frequency_is_bracketed(model, law, seed):
    rng = np.random.default_rng(seed)
    moments = random_moments(model.cell_count, rng)
    fields = {"coverage": model.cell_coverage, "moments": moments, "law": law, "fixed": model.node_is_fixed}
    model = make_model(model.cells, **fields).without_springs(rng.random(model.spring_count) < 0.03)
    root = np.repeat(np.where(model.node_is_fixed, 0, 1 / np.sqrt(model.node_mass.astype(float))), 3)
    K = root[:, None] * stiffness_matrix(model) * root
    true = np.linalg.eigvalsh((K + K.T) / 2)[-1]
    found = largest_eigenvalue(model)
    if true > 1e-6:
        # differences of 1e-5 in the matrix
        assert found.lower * (1 - 1e-4) <= true <= found.upper * (1 + 1e-4)
        assert found.upper <= 1.03 * true


def random_deformations(count, stretch_most, rng):
    """Displacements of a lone cell: principal stretches down to 0.15, some cells inside out, and each corner by itself.

    Shape (count, 8, 3).
    """
    first, second = (np.linalg.qr(rng.normal(size=(count, 3, 3)))[0] for _ in range(2))
    second[rng.random(count) < 0.5] = np.eye(3)
    principal = np.exp(rng.uniform(np.log(0.15), np.log(stretch_most), (count, 3)))
    principal[:, 0] *= np.where(rng.random(count) < 0.3, -1, 1)
    F = first @ (principal[:, :, None] * second)
    corners = np.array([[c & 1, c >> 1 & 1, c >> 2 & 1] for c in range(8)]) - 0.5
    own = 0.3 * rng.normal(size=(count, 8, 3)) * rng.random((count, 1, 1))
    return np.einsum("nij,cj->nci", F, corners) + own - corners


def highest_rates(law, u):
    """Largest omega^2 m h / k of lone cells at displacements of their corners, shape (count, 8, 3)."""
    cells = np.stack([3 * np.arange(len(u)), np.zeros(len(u), int), np.zeros(len(u), int)], axis=1)
    model = make_model(cells, law=law)
    at = np.empty((model.node_count, 3))
    at[model.cell_corners] = u
    K = np.empty((len(u), 24, 24))
    for column in range(24):
        push = np.zeros((len(u), 8, 3))
        push[:, column // 3, column % 3] = 1e-5
        moved = np.zeros_like(at)
        moved[model.cell_corners] = push
        change = elastic_forces(model, at - moved) - elastic_forces(model, at + moved)
        K[:, :, column] = change[model.cell_corners].reshape(len(u), 24) / 2e-5
    return 8.0 * np.linalg.eigvalsh((K + K.transpose(0, 2, 1)) / 2)[:, -1]


BARE_LAWS = [ForceLaw(guards_corners=False), ForceLaw("springs", 0.45), ForceLaw("element"), ForceLaw("element", 0.45)]


@pytest.mark.parametrize("law", BARE_LAWS)
def test_deformed_cells_stay_within_what_the_default_step_leaves_room_for(law):
    """Stretches up to 3: omega^2 of a lone cell below (1 / 0.8)^2 of what the step is made for, in 99% of them."""
    rates = highest_rates(law, random_deformations(400, 3.0, np.random.default_rng(1)))
    assert (rates <= law.stretched_bound / 0.64).mean() >= 0.99
    assert rates.max() > 0.6 * law.rest_bound  # the cells were deformed, not gone


def test_guarded_slivers_stay_within_what_the_default_step_leaves_room_for():
    """Scrambled blocks of full cells and slivers: omega^2 below (1 / 0.8)^2 of what the step is made for."""
    rng = np.random.default_rng(4)
    whole = block(3, 3, 2, fix_base=True)
    rates = []
    for size in (0.3, 0.6, 1.2) * 2:
        coverage = np.where(rng.random(18) < 0.5, 1.0, rng.uniform(0.02, 0.5, 18))
        model = make_model(whole.cells, coverage=coverage, fixed=whole.node_is_fixed)
        assert (model.corner_guard_scale > 2.0 * model.cell_force_scale).any()
        u = rng.normal(size=(model.node_count, 3)) * size * ~model.node_is_fixed[:, None]
        assert inverted_cells(model, u).any()
        root = np.repeat(np.where(model.node_is_fixed, 0.0, 1 / np.sqrt(model.node_mass.astype(float))), 3)
        K = root[:, None] * stiffness_matrix(model, u) * root
        rates.append(np.linalg.eigvalsh((K + K.T) / 2)[-1])
    assert max(rates) <= model.law.stretched_bound / 0.64


@pytest.mark.parametrize("law", thoroughly(BARE_LAWS, 0, len(BARE_LAWS) - 1))
def test_no_deformation_stiffens_a_cell_without_bound(law):
    """Corners anywhere, up to a hundred edges away."""
    rng = np.random.default_rng(3)
    u = np.concatenate([rng.normal(size=(400, 8, 3)) * size for size in (0.1, 0.3, 1.0, 3.0, 10.0, 100.0)])
    rates = highest_rates(law, u)
    assert rates.max() <= 3.1 * law.rest_bound


@pytest.mark.parametrize(
    ("law", "shared"),
    [
        (ForceLaw(), 0.0),
        (ForceLaw("springs", 0.45), 0.0),
        *((ForceLaw("element", ratio), shared) for ratio in (0.25, 0.45) for shared in (0.0, 0.5, 0.9)),
    ],
)
def test_a_scrambled_block_comes_back(law, shared):
    """Every free node up to a cell and a half astray: most cells are inside out, and after 0.2 s none.

    Also where most of each element is strained by the means around its corners.
    """
    model = block(5, 5, 5, fix_base=True, law=law)
    model = replace(model, cell_shares=np.full((model.cell_count, 8), shared / 8, np.float32))
    u = np.random.default_rng(2).normal(size=(model.node_count, 3)).astype(np.float32) * np.float32(0.5)
    u[model.node_is_fixed] = 0
    engine = make_engine(model, "cpu")
    engine.load(State(u, np.zeros_like(u)))
    assert inverted_cells(model, u).mean() > 0.5
    step = 0.8 * 2 / np.sqrt(law.stretched_bound)
    engine.advance(round(300 / step), Verlet(step=step, damping=0.05))
    end = engine.read().displacement
    assert not inverted_cells(model, end).any()
    assert np.abs(end).max() < 0.2


def test_without_the_guard_springs_stay_inside_out():
    model = block(5, 5, 5, fix_base=True, law=ForceLaw(guards_corners=False))
    u = np.random.default_rng(2).normal(size=(model.node_count, 3)).astype(np.float32) * np.float32(0.5)
    u[model.node_is_fixed] = 0
    engine = make_engine(model, "cpu")
    engine.load(State(u, np.zeros_like(u)))
    engine.advance(1000, Verlet(step=0.3, damping=0.05))
    assert inverted_cells(model, engine.read().displacement).any()


def test_what_a_cut_leaves_of_an_element_is_springs():
    model = block(3, 1, 1, law=ForceLaw("element"))
    removed = np.zeros(model.spring_count, dtype=bool)
    i = model.node_index[model.spring_nodes, 0]
    removed[np.flatnonzero((i.min(axis=1) == 0) & (i.max(axis=1) == 1))[0]] = True
    cut = model.without_springs(removed)
    np.testing.assert_array_equal(cut.cell_is_whole, [False, True, True])
    acts = cut.acting_weight > 0
    in_first = cut.node_index[cut.spring_nodes, 0].max(axis=1) <= 1
    np.testing.assert_array_equal(acts, in_first)
    # four edges around a square share a quarter each, a diagonal a half
    np.testing.assert_allclose(np.unique(cut.acting_weight[acts]), [0.25, 0.5])


@pytest.mark.parametrize("ratio", [0.2, 0.5, np.nan, -1.0])
def test_a_ratio_out_of_range_is_refused(ratio):
    with pytest.raises(SimulationError, match=r"poissons_ratio.*0\.25 to 0\.49"):
        ForceLaw("springs", ratio)


def test_everything_wrong_with_a_law_is_said_at_once():
    with pytest.raises(SimulationError, match="'beams'") as error:
        ForceLaw("beams", 0.7)  # type: ignore[arg-type]
    assert len(error.value.problems) == 2
