"""The same violent scripts on the reference, and on a GPU where there is one: numba's simulator would take hours."""

from __future__ import annotations

import pytest

from heartcase.simulator.engine.cuda.intrinsics import IS_SIMULATED
from tests.stress.test_violence import LAWS, survive

on_a_gpu = pytest.mark.skipif(IS_SIMULATED, reason="there is no GPU here")


def test_five_violent_scripts_on_the_reference():
    assert survive(LAWS["springs"], "reference", range(5), 2) > 5


@pytest.mark.slow
@pytest.mark.timeout(3600)  # ten minutes and more
@pytest.mark.parametrize("law", LAWS)
def test_a_thousand_violent_scripts_on_the_reference(law):
    survive(LAWS[law], "reference", range(1000), 10)


@on_a_gpu
@pytest.mark.parametrize("law", LAWS)
def test_fifty_violent_scripts_on_a_gpu(law):
    assert survive(LAWS[law], "cuda", range(50 if law == "springs" else 10), 2) > 50


@on_a_gpu
@pytest.mark.slow
@pytest.mark.parametrize("law", LAWS)
def test_a_thousand_violent_scripts_on_a_gpu(law):
    survive(LAWS[law], "cuda", range(1000), 10)
