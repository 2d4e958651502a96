"""Whatever a hand does: nothing breaks down, and tissue that was turned inside out comes back."""

from __future__ import annotations

import numpy as np
import pytest

from heartcase.simulator.lattice.moduli import ForceLaw
from tests.stress.violence import run

LAWS = {
    "springs": ForceLaw(),
    "springs-0.45": ForceLaw("springs", 0.45),
    "element": ForceLaw("element", 0.25),
    "element-0.45": ForceLaw("element", 0.45),
}
TURNED_BACK_S = 0.3
"""Time within which cells are the right side out again, s."""
LEFT_MOST = 8
"""Cells that a script leaves inside out for good at most, of up to 225."""


def survive(law, backend, seeds, left_scripts, **how):
    """Run scripts: nothing breaks down, and all but a few leave no cell inside out; the sum of what they turned."""
    outcomes = {seed: run(seed, law, backend, **how) for seed in seeds}
    assert all(np.isfinite(outcome.way_most) for outcome in outcomes.values())
    left = {seed: outcome for seed, outcome in outcomes.items() if outcome.inverted_left}
    assert len(left) <= left_scripts, left
    assert all(outcome.inverted_left <= LEFT_MOST for outcome in left.values()), left
    assert not any(outcome.hurried_left for outcome in outcomes.values()), outcomes
    slow = {seed: o for seed, o in outcomes.items() if not o.inverted_left and o.settled_s > TURNED_BACK_S}
    assert not slow, slow
    return sum(outcome.inverted_most for outcome in outcomes.values())


@pytest.mark.parametrize("law", LAWS)
def test_fifty_violent_scripts(law):
    inverted = survive(LAWS[law], "cpu", range(50 if law == "springs" else 10), 2)
    assert inverted > 50  # they were violent


@pytest.mark.parametrize("law", ["element", "element-0.45"])
def test_violent_scripts_in_which_blades_part_elements(law):
    """Steps are as long as the pieces along the cuts allow."""
    assert survive(LAWS[law], "cpu", range(12), 1, has_blades=True) > 30


@pytest.mark.slow
@pytest.mark.parametrize("law", LAWS)
def test_a_thousand_violent_scripts(law):
    survive(LAWS[law], "cpu", range(1000), 10)
