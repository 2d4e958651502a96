"""What is worked out where elements are tied together, beside dense matrices and the whole lattice."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from heartcase.simulator.cutting.tissue_samples import TissueSamples
from heartcase.simulator.dynamics.spectrum import largest_eigenvalue
from heartcase.simulator.dynamics.tied_frequency import rate_where_tied, ties_of
from heartcase.simulator.forces.reference import elastic_forces
from heartcase.simulator.lattice.explicit_springs import ExplicitSprings
from heartcase.simulator.lattice.moduli import ForceLaw
from heartcase.simulator.lattice.tethers import Tethers
from heartcase.simulator.simulation import Simulation
from tests.simulator.lattices import block, random_moments

ELEMENT = ForceLaw("element")


def tied_at_random(seed: int, size, law: ForceLaw = ELEMENT) -> Simulation:
    """A block on a fixed base with stitches, explicit springs and a patch."""
    rng = np.random.default_rng(seed)
    count = int(np.prod(size))
    moments = random_moments(count, rng)
    moments[rng.random(count) < 0.7] = [0, 0, 0, 1 / 12, 1 / 12, 1 / 12, 0, 0, 0]
    model = block(*size, fix_base=True, law=law, moments=moments)
    simulation = Simulation(model, tissue=TissueSamples.everywhere())
    free = np.flatnonzero(~model.node_is_fixed)
    at, h = model.rest_positions_mm(), model.cell_mm
    pairs = rng.permutation(free)[:4].reshape(2, 2)
    simulation.add_springs(pairs, 0.3)
    for number in range(2):
        ends = at[rng.permutation(free)[:2]] + rng.uniform(-0.4, 0.4, (2, 3)) * h
        simulation.stitch(np.clip(ends, at.min(axis=0), at.max(axis=0)), name=f"stitch {number}")
    turns = np.linspace(0.0, 2.0 * np.pi, 12, endpoint=False)
    middle, top = at.mean(axis=0), at[:, 2].max()
    ring = np.stack([np.cos(turns), np.sin(turns), np.zeros(12)], axis=1)
    simulation.patch(np.array([middle[0], middle[1], top]) + 1.2 * h * ring, spacing_mm=0.9 * h)
    return simulation


def dense_largest(simulation: Simulation, *, in_all_directions: bool) -> float:
    """omega^2 of all that pulls at rest, by differences of the reference's forces; threads by their shares one by one.

    Explicit springs as they are, or resisting in all directions alike.
    """
    model, tethers = simulation.model, simulation._strung()
    ties = list(zip(tethers.nodes, tethers.shares.astype(float), tethers.stiffness.astype(float), strict=True))
    if in_all_directions:
        explicit = model.explicit
        ties += [(nodes, (-1.0, 1.0), k) for nodes, k in zip(explicit.nodes, explicit.stiffness, strict=True)]
        model = replace(model, explicit=ExplicitSprings.none())
    count = model.node_count
    stiffness = np.zeros((3 * count, 3 * count))
    step = 1e-5
    for unknown in range(3 * count):
        u = np.zeros((count, 3))
        u.flat[unknown] = step
        stiffness[:, unknown] = (elastic_forces(model, -u) - elastic_forces(model, u)).ravel() / (2 * step)
    for nodes, shares, k in ties:
        for one, of_one in zip(nodes, shares, strict=True):
            for other, of_other in zip(nodes, shares, strict=True):
                for axis in range(3):
                    stiffness[3 * one + axis, 3 * other + axis] += k * of_one * of_other
    root = np.repeat(np.where(model.node_is_fixed, 0.0, 1.0 / np.sqrt(model.node_mass.astype(float))), 3)
    return float(np.linalg.eigvalsh(root[:, None] * (stiffness + stiffness.T) / 2 * root)[-1])


@pytest.mark.parametrize("seed", range(3))
def test_ties_count_with_their_whole_stiffness_in_all_directions(seed):
    """As in a dense matrix; with explicit springs as they are it is no quicker."""
    simulation = tied_at_random(seed, (3, 2, 3))
    model = simulation.model
    whole = largest_eigenvalue(model, ties=ties_of(model, simulation._strung()))
    dense = dense_largest(simulation, in_all_directions=True)
    assert whole.lower * (1 - 1e-4) <= dense <= whole.upper * (1 + 1e-4)
    assert dense > 1.02 * largest_eigenvalue(model).lower
    assert dense_largest(simulation, in_all_directions=False) <= dense * (1 + 1e-6)


@pytest.mark.parametrize("law", [ELEMENT, ForceLaw("element", 0.45)])
def test_the_quickest_of_a_lattice_is_that_without_ties_or_around_them(law):
    quicker = 0
    for seed in range(8):
        simulation = tied_at_random(seed, (7, 5, 5), law)
        model, strung = simulation.model, simulation._strung()
        if seed % 2:
            # stiffer than any that the time step allows
            strung = replace(strung, stiffness=20.0 * strung.stiffness)
        before = largest_eigenvalue(simulation.uncut(model, None))
        whole, tied = largest_eigenvalue(model, ties=ties_of(model, strung)), rate_where_tied(model, strung)
        assert whole.lower <= max(before.upper, tied) * (1 + 1e-6)
        if whole.lower > 1.02 * before.upper:
            quicker += 1
            assert tied == pytest.approx(whole.lower, rel=0.06)
    assert quicker >= 3


def test_where_nothing_is_tied_there_is_no_rate():
    model = block(3, 3, 3, law=ELEMENT)
    assert rate_where_tied(model, Tethers.none()) == 0.0
