"""Which cells share strain, and that sharing changes nothing where strain is uniform, whole or cut."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from heartcase.schemas.bundle.lattice import CORNER_OFFSETS
from heartcase.simulator.dynamics.integrate import Verlet
from heartcase.simulator.dynamics.spectrum import largest_eigenvalue
from heartcase.simulator.engine.backends import make_engine
from heartcase.simulator.forces.cell_forces import mean_gradients
from heartcase.simulator.forces.reference import elastic_forces
from heartcase.simulator.lattice.model import make_model
from heartcase.simulator.lattice.moduli import ForceLaw
from heartcase.simulator.lattice.state import State
from heartcase.simulator.lattice.strain_sharing import corner_shares
from tests.simulator.lattices import block, random_models, random_moments, random_shares

SEEDS = st.integers(0, 2**32 - 1)
ELEMENT = ForceLaw("element")


def oblique_wall(thickness: float, normal: np.ndarray, samples: int = 10):
    """The cells of a wall through a box of 12 cells along each axis, about its middle."""
    cells = np.array(list(np.ndindex(12, 12, 12)), np.int32)
    along = (np.arange(samples) + 0.5) / samples - 0.5
    x = np.stack(np.meshgrid(along, along, along, indexing="ij"), axis=-1).reshape(-1, 3)
    terms = np.concatenate([x, x * x + 1 / (12 * samples**2), np.roll(x, -1, 1) * np.roll(x, -2, 1)], axis=1)
    is_tissue = np.abs((cells[:, None] + 0.5 + x - 6.0) @ normal) <= thickness / 2
    coverage = is_tissue.mean(axis=1)
    kept = coverage > 0.02
    moments = is_tissue[kept] @ terms / is_tissue[kept].sum(axis=1)[:, None]
    return make_model(cells[kept], coverage=coverage[kept], moments=moments, law=ELEMENT)


def parts_within(model):
    """What is shared of the cells away from the box's sides."""
    return model.cell_shares.sum(axis=1)[((model.cells >= 2) & (model.cells <= 9)).all(axis=1)]


@pytest.mark.parametrize("size", [(1, 1, 1), (9, 5, 1), (9, 9, 2), (3, 3, 12), (6, 6, 6)])
def test_a_box_along_the_grid_shares_nothing(size):
    assert not block(*size, law=ELEMENT).shares_strain


@pytest.mark.parametrize("law", [ForceLaw(), ForceLaw("springs", 0.45), ForceLaw("element", shares_strain=False)])
def test_laws_that_share_nothing_have_no_shares(law):
    model = oblique_wall(1.0, np.array([0.6, 0.0, 0.8]))
    assert model.shares_strain
    assert not model.with_law(law).shares_strain
    np.testing.assert_array_equal(model.with_law(law).with_law(ELEMENT).cell_shares, model.cell_shares)


def test_thin_walls_askew_share_most_and_thick_ones_nothing_inside():
    askew, along = np.array([1.0, 0.0, 1.0]) / np.sqrt(2), np.array([0.0, 0.0, 1.0])
    thin, thick = (parts_within(oblique_wall(thickness, askew)) for thickness in (0.5, 2.0))
    assert 0.75 < thin.min() <= thin.max() < 0.95
    assert 0.2 < thick.min() <= thick.max() < 0.5
    assert parts_within(oblique_wall(0.5, along)).max(initial=0) == 0
    model = oblique_wall(10.0, askew)
    inside = (np.abs((model.cells + 0.5 - 6.0) @ askew) < 1.5) & ((model.cells >= 4) & (model.cells <= 7)).all(axis=1)
    assert inside.any()
    assert model.cell_shares[inside].max() == 0


@settings(max_examples=20, deadline=None)
@given(random_models(), SEEDS)
def test_shares_are_parts_and_follow_the_cells(model, seed):
    """Whatever the order of the cells, and whichever way the grid is turned."""
    rng = np.random.default_rng(seed)
    moments = random_moments(model.cell_count, rng)
    given_ = (model.cells, model.cell_corners, model.cell_coverage, moments)
    shares = corner_shares(*given_)
    assert (shares >= 0).all()
    assert (shares.sum(axis=1) < 0.96).all()
    order = rng.permutation(model.cell_count)
    np.testing.assert_allclose(corner_shares(*(array[order] for array in given_)), shares[order], atol=1e-6)
    # Turned: x to y to z to x.
    turned = make_model(
        np.roll(model.cells, 1, axis=1),
        coverage=model.cell_coverage,
        moments=np.concatenate([np.roll(part, 1, axis=1) for part in np.split(moments, 3, axis=1)], axis=1),
        law=ELEMENT,
    )
    number = {tuple(offset): place for place, offset in enumerate(CORNER_OFFSETS.tolist())}
    corner = [number[tuple(np.roll(offset, 1))] for offset in CORNER_OFFSETS.tolist()]
    # An eigenvalue that is there twice is known to the root of the rounding.
    np.testing.assert_allclose(turned.cell_shares[:, corner], shares, atol=1e-4)


@settings(max_examples=20, deadline=None)
@given(random_models(), SEEDS)
def test_the_mean_of_a_uniform_strain_is_that_strain(model, seed):
    rng = np.random.default_rng(seed)
    model = replace(
        model, cell_moments=random_moments(model.cell_count, rng), cell_shares=random_shares(model.cell_count, rng)
    )
    G = rng.normal(size=(3, 3))
    mean, stiffness = mean_gradients(model, (model.node_index @ G.T)[model.cell_corners])
    np.testing.assert_allclose(
        mean[stiffness > 0], np.broadcast_to(np.eye(3) + G, mean[stiffness > 0].shape), atol=1e-9
    )
    shared = (model.cell_force_scale[:, None] * model.cell_shares).sum(dtype=float)
    assert stiffness.sum() == pytest.approx(shared, rel=1e-5, abs=1e-9)


@settings(max_examples=20, deadline=None)
@given(random_models(size_max=(6, 4, 4)), SEEDS)
@pytest.mark.thorough
def test_sharing_raises_no_frequency(model, seed):
    """A mean of strains stores at most what the strains do (Jensen's inequality)."""
    rng = np.random.default_rng(seed)
    moments = random_moments(model.cell_count, rng)
    alone = replace(model, cell_moments=moments).with_law(ForceLaw("element", shares_strain=False))
    sharing = replace(alone, cell_shares=random_shares(model.cell_count, rng), law=ELEMENT)
    assert largest_eigenvalue(sharing).lower <= largest_eigenvalue(alone).upper * (1 + 1e-9)


def test_what_a_cut_parts_shares_no_strain():
    model = oblique_wall(1.0, np.array([0.6, 0.0, 0.8]))
    j = model.node_index[model.spring_nodes, 1]
    model = model.without_springs((j.min(axis=1) == 6) & (j.max(axis=1) == 7))
    assert model.shares_strain
    is_far = model.node_index[:, 1] >= 7
    u = np.random.default_rng(1).normal(size=(model.node_count, 3)) * is_far[:, None] * 0.1
    force = elastic_forces(model, u)
    assert np.abs(force[is_far]).max() > 1e-3
    assert np.abs(force[~is_far]).max() == 0


@pytest.mark.parametrize("spread", [0.0, 1e-9])
def test_tissue_without_a_shape_shares_nothing(spread):
    for middle in (0.0, 0.5):
        moments = [middle] * 3 + [middle**2 + spread] * 3 + [middle**2] * 3
        assert not make_model([(0, 0, 0)], coverage=0.02, moments=moments, law=ELEMENT).shares_strain


def test_corners_near_the_tissue_have_the_most():
    """A lone cell, its tissue a bar askew near corner 6: (0, 1, 1)."""
    x, y, z = -0.3, 0.35, 0.3
    spread = np.array([[0.01, 0.008, 0.0], [0.008, 0.01, 0.0], [0.0, 0.0, 0.01]])
    second = spread + np.outer((x, y, z), (x, y, z))
    moments = [x, y, z, *second.diagonal(), second[1, 2], second[0, 2], second[0, 1]]
    (shares,) = make_model([(0, 0, 0)], coverage=0.1, moments=moments, law=ELEMENT).cell_shares
    assert shares.argmax() == 6
    assert shares.argmin() == 1


@pytest.mark.parametrize("backend", ["cpu", "cuda"])
def test_a_cut_changes_a_running_engine_as_it_changes_a_new_one(backend):
    """Also where a node was lost before: of cells that share nothing any more nothing is left."""
    model = oblique_wall(1.0, np.array([0.6, 0.0, 0.8]), samples=4)
    if backend == "cuda":
        near = ((model.cells >= 4) & (model.cells < 8)).all(axis=1)
        fields = {"coverage": model.cell_coverage[near], "moments": model.cell_moments[near], "law": ELEMENT}
        model = make_model(model.cells[near], **fields)
    j = model.node_index[model.spring_nodes, 1]
    cut = model.without_springs((j.min(axis=1) == 6) & (j.max(axis=1) == 7))
    rng = np.random.default_rng(2)
    u = rng.uniform(-0.1, 0.1, (model.node_count, 3)).astype(np.float32)
    lost = u.copy()
    lost[model.node_count // 2] = np.nan
    running, new = make_engine(model, backend), make_engine(cut, backend)
    running.load(State(lost, np.zeros_like(u)))
    running.advance(2, Verlet(0.05))
    assert np.isnan(running.forces()).any()
    running.set_springs(cut)
    for engine in (running, new):
        engine.load(State(u, np.zeros_like(u)))
        engine.advance(3, Verlet(0.05))
    assert np.isfinite(new.forces()).all()
    np.testing.assert_array_equal(running.forces(), new.forces())
    np.testing.assert_array_equal(running.read().displacement, new.read().displacement)
