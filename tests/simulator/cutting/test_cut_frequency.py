"""What is worked out around the cuts alone, beside the highest frequency of the whole lattice."""

from __future__ import annotations

import numpy as np
import pytest

from heartcase.schemas.errors import SimulationError
from heartcase.simulator.cutting.cut_frequency import rate_along_cuts
from heartcase.simulator.cutting.tissue_samples import TissueSamples
from heartcase.simulator.dynamics.spectrum import largest_eigenvalue
from heartcase.simulator.lattice.moduli import ForceLaw
from heartcase.simulator.lattice.state import State
from heartcase.simulator.lattice.sub_lattice import cells_around, sub_lattice
from heartcase.simulator.simulation import Simulation
from heartcase.simulator.snapshot import Snapshot
from tests.simulator.lattices import block, random_moments
from tests.stress.cut_scripts import random_blade


def cut_at_random(seed: int, law: ForceLaw, cut_count: int = 3) -> Simulation:
    """A block of full and partly filled elements, on a fixed base, after some cuts."""
    rng = np.random.default_rng(seed)
    size = rng.integers(4, [12, 8, 7])
    cell_count = int(np.prod(size))
    moments = random_moments(cell_count, rng)
    moments[rng.random(cell_count) < 0.7] = [0, 0, 0, 1 / 12, 1 / 12, 1 / 12, 0, 0, 0]
    model = block(*size, fix_base=True, law=law, moments=moments)
    simulation = Simulation(model, tissue=TissueSamples.everywhere())
    at = model.rest_positions_mm()
    for _ in range(cut_count):
        try:
            simulation.cut(random_blade(rng, at.min(axis=0), at.max(axis=0)), at_rest=True)
        except SimulationError:
            continue
    return simulation


@pytest.mark.parametrize(
    "law", [ForceLaw("element"), ForceLaw("element", 0.45), ForceLaw("element", 0.25, True, False)]
)
def test_the_quickest_of_a_lattice_is_that_before_or_along_the_cuts(law):
    """Never is the whole quicker; where pieces are, what is found is theirs, within what Lanczos may miss."""
    quicker = 0
    for seed in range(12):
        simulation = cut_at_random(seed, law)
        cuts = simulation.cuts
        if cuts is None or cuts.parted is None:
            continue
        before, whole = largest_eigenvalue(cuts.uncut), largest_eigenvalue(cuts.model)
        along = rate_along_cuts(cuts.parted)
        assert whole.lower <= max(before.upper, along) * (1 + 1e-6)
        if whole.lower > 1.1 * before.upper:
            quicker += 1
            assert along == pytest.approx(whole.lower, rel=0.06)
    assert quicker >= 4


def test_a_plain_incision_through_whole_cells_is_no_quicker():
    """Between two layers of nodes, half a cell off: pieces of half a cell."""
    model = block(10, 6, 5, fix_base=True, law=ForceLaw("element"))
    simulation = Simulation(model, tissue=TissueSamples.everywhere())
    at = model.rest_positions_mm()
    low, high = at.min(axis=0) - 5.0, at.max(axis=0) + 5.0
    x = at[:, 0].mean() + 0.3
    simulation.cut([[[x, low[1], low[2]], [x, high[1], low[2]]], [[x, low[1], high[2]], [x, high[1], high[2]]]])
    assert simulation.cuts is not None
    # what Lanczos may fall short by is added
    assert 0.0 < simulation.cuts.rate_along < largest_eigenvalue(model).upper / 0.95
    assert simulation._paced.pace > 0.97 * simulation.pace > 1.1


def test_the_pace_after_cuts_is_that_of_the_quickest_piece_and_undo_brings_the_old_one_back():
    paces = []
    for seed in range(8):
        simulation = cut_at_random(seed, ForceLaw("element"))
        assert 1.0 <= simulation._paced.pace <= simulation.pace
        if simulation.cuts is not None:
            paces.append(simulation._paced.pace / simulation.pace)
            # no step is beyond 0.8 of what is stable, but where the default one is
            longest = simulation._paced.pace * simulation.step_s
            assert longest <= max(0.81 * simulation.step_limit_s, simulation.step_s)
            before = Snapshot.of(
                simulation.cuts.uncut, State.at_rest(simulation.cuts.uncut.node_count), (), None, [], []
            )
            simulation.restore(before)
            assert simulation._paced.pace == simulation.pace
    assert min(paces) < 0.9


def test_cells_around_nodes_by_rings():
    model = block(9, 7, 7, law=ForceLaw("element"))
    middle = (model.node_index == (4, 3, 3)).all(axis=1)
    for rings, count in ((0, 8), (1, 64), (2, 6**3)):
        part, _ = sub_lattice(model, cells_around(model, middle, rings))
        assert part.cell_count == count
        assert part.node_count == (2 * rings + 3) ** 3
        places = {tuple(place): mass for place, mass in zip(model.node_index.tolist(), model.node_mass, strict=True)}
        assert all(places[tuple(i)] == mass for i, mass in zip(part.node_index.tolist(), part.node_mass, strict=True))
        corner = part.node_index[part.cell_corners[:, 0]]
        np.testing.assert_array_equal(corner, part.cells)
