"""A session that was prepared for cuts compiles next to nothing in its first ones."""

from __future__ import annotations

import json
import subprocess
import sys

import pytest

from heartcase.pipeline.bundle.write_bundle import write_bundle
from tests.hollow_case import hollow_case

STORY = """
import json, sys
import numpy as np
from heartcase.compiling.kernel import KERNELS
from heartcase.simulator.lattice.moduli import ForceLaw
from heartcase.simulator.load import load_case
from heartcase.simulator.simulation import Simulation

case = load_case(sys.argv[1], needs=("surface", "tissue"))
model = case.model.with_law(ForceLaw(sys.argv[2]))
simulation = Simulation(model, surface=case.surface, tissue=case.tissue)
simulation.prepare()
simulation.prepare_cuts()
simulation.surface_now()
known = {id(one): len(one.overloads) for one in KERNELS}
low, high = model.rest_positions_mm().min(axis=0), model.rest_positions_mm().max(axis=0)
middle, wide = 0.5 * (low + high), 0.4 * (high - low)
for step in range(3):
    simulation.step(5)
    at = middle + [0.0, (step - 1) * 0.3 * wide[1], wide[2]]
    across, down = np.array([wide[0], 0.0, 0.0]), np.array([0.0, 0.1 * wide[1], -wide[2]])
    simulation.cut(np.array([[at - across, at + across], [at - across + down, at + across + down]]))
    simulation.surface_now()
assert simulation.model.node_count > model.node_count
print(json.dumps([one.py_func.__name__ for one in KERNELS if len(one.overloads) != known.get(id(one), 0)]))
"""


@pytest.mark.thorough
@pytest.mark.parametrize("law", ["springs", "element"])
def test_the_first_cuts_call_what_was_compiled_before(law, tmp_path):
    write_bundle(tmp_path / "hollow.case", hollow_case())
    done = subprocess.run(
        [sys.executable, "-c", STORY, str(tmp_path / "hollow.case"), law], capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr
    # what a hole in the surface, or one that closes, asks for, is small
    assert set(json.loads(done.stdout.splitlines()[-1])) <= {"glue_around"}
