"""A double outlet right ventricle sewn: incised, held open, a baffle from the defect to the aorta, closed again.

With ``HEARTCASE_LIBRARY`` set to the folder of a build of ``sample_cases``, such as ``out``, what is up to date there
is not built again.
"""

from __future__ import annotations

import os
import shutil
from pathlib import Path

import numpy as np
import pytest

from heartcase.cli.main import main
from heartcase.simulator.incisions.triangle_tree import triangle_tree
from heartcase.simulator.load import load_case
from heartcase.simulator.session.script import load_script, run_script
from heartcase.simulator.simulation import Simulation
from tests.library.blood import Blood

SAMPLES = Path(__file__).parents[2] / "sample_cases"
LEFT_VENTRICLE, RIGHT_VENTRICLE, AORTA, PULMONARY_ARTERY = 1, 2, 5, 6
GAP_MM = 0.2
"""What is no wider, such as between two stitches of a rim, does not count as open."""


@pytest.mark.slow
def test_a_baffle_leads_the_left_ventricles_blood_to_the_aorta_alone(tmp_path):
    out = Path(os.environ.get("HEARTCASE_LIBRARY", tmp_path))
    recipe = SAMPLES / "dorv_unrepaired.toml"
    if out == tmp_path:
        (tmp_path / "sample_cases").mkdir()
        recipe = Path(shutil.copy(recipe, tmp_path / "sample_cases"))
    assert main(["build", str(recipe), "--out", str(out)]) == 0
    path = out / "dorv-unrepaired.case"
    case, script = load_case(path, needs=("surface", "tissue")), load_script(SAMPLES / "baffle.toml")
    simulation = Simulation(
        case.model,
        surface=case.surface,
        tissue=case.tissue,
        step_s=script.step_s,
        damping_per_s=script.damping_per_s,
    )
    blood = Blood.of_case(path, (LEFT_VENTRICLE, RIGHT_VENTRICLE, AORTA, PULMONARY_ARTERY))
    cavities = {
        "left ventricle": blood.nearest(LEFT_VENTRICLE, (25.0, -20.0, -20.0)),
        "right ventricle": blood.nearest(RIGHT_VENTRICLE, (-20.0, -20.0, -15.0)),
        "its apex": blood.nearest(RIGHT_VENTRICLE, (0.0, -42.0, -25.0)),
        "aorta": blood.nearest(AORTA, (-15.0, -22.0, 33.0)),
        "pulmonary artery": blood.nearest(PULMONARY_ARTERY, (17.0, -30.0, 30.0)),
    }

    def compartments(wide_mm):
        """Compartment of each cavity for what is no wider than this, and the sizes of all."""
        now = simulation.surface_now()
        walls = [triangle_tree(now.vertices_mm, simulation.surface.triangles)]
        for patch in simulation.patches:
            state = simulation.patch_state(patch)
            walls.append(triangle_tree(state.vertices_mm, state.triangles))
        part = blood.compartments(walls, wide_mm)
        return {name: int(part[voxel]) for name, voxel in cavities.items()}, np.bincount(part)

    before, _ = compartments(GAP_MM)
    assert len(set(before.values())) == 1  # all of it is one space
    summary = run_script(simulation, script)
    # What is 7 mm wide gets through the tunnel, and through what is left of the right ventricle.
    for wide_mm in (GAP_MM, 7.0):
        after, sizes = compartments(wide_mm)
        left, right = after["left ventricle"], after["right ventricle"]
        assert left != right
        assert after == {
            "left ventricle": left,
            "right ventricle": right,
            "its apex": right,
            "aorta": left,
            "pulmonary artery": right,
        }
        # The rest is what lies so near to a wall that it has no links.
        assert wide_mm > GAP_MM or sizes[left] + sizes[right] > 0.97 * sizes.sum()
    assert simulation.inverted_cell_count() == 0
    assert min(summary.patch_end_force_n["baffle"]) > 0
    (patch,) = simulation.patches
    assert simulation.patch_state(patch).distortion < 0.4
