"""Random cuts into moving tissue: none fails, the surface stays closed, nothing jumps, and undoing gives the bytes."""

from __future__ import annotations

import numpy as np
import pytest

from heartcase.simulator.simulation import Simulation
from tests.stress.cut_scripts import block_with_surface, operate, random_blade
from tests.stress.test_violence import LAWS


def run(seed, law, backend="cpu"):
    rng = np.random.default_rng(seed)
    model, surface, tissue = block_with_surface(rng, law)
    simulation = Simulation(model, surface=surface, tissue=tissue, damping_per_s=30.0, backend=backend)
    rest = model.rest_positions_mm()
    blades = [random_blade(rng, rest.min(axis=0), rest.max(axis=0)) for _ in range(rng.integers(1, 5))]
    return operate(simulation, rng, blades)


def check(seeds, law):
    ends = [run(seed, law) for seed in seeds]
    assert sum(end.refused_count for end in ends) == 0
    assert np.mean([end.cut_face_count > 0 for end in ends]) > 0.6
    assert max(end.part_count for end in ends) > 1
    # Tissue changes sides near the end of another cut alone, and elements share strain with fewer after a cut.
    assert sum(end.mixed_count for end in ends) < 0.5 * sum(end.cut_count for end in ends)
    assert max(end.elastic_rise for end in ends) < 0.25
    assert max(end.mixed_rise for end in ends) < 0.5


@pytest.mark.parametrize("law", LAWS)
def test_random_cuts_into_blocks(law):
    check(range(16), LAWS[law])


@pytest.mark.slow
@pytest.mark.parametrize("law", LAWS)
def test_ten_thousand_random_cuts_into_blocks(law):
    check(range(10_000 // len(LAWS) + 1), LAWS[law])
