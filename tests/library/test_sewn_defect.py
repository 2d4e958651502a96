"""A sample case sewn: incised, held open, its septal defect closed with a patch, the incision with a running thread.

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
from heartcase.simulator.incisions.segments import touches
from heartcase.simulator.incisions.triangle_tree import triangle_tree
from heartcase.simulator.load import load_case
from heartcase.simulator.session.script import load_script, run_script
from heartcase.simulator.simulation import Simulation

SAMPLES = Path(__file__).parents[2] / "sample_cases"


def lines_through(landmark):
    """Lines through a defect, along its axis: both ends of each."""
    middle, axis = np.array(landmark.points_mm[0]), np.array(landmark.axis) / np.linalg.norm(landmark.axis)
    first = np.cross(axis, np.eye(3)[np.abs(axis).argmin()])
    first /= np.linalg.norm(first)
    angle, part = np.meshgrid(np.arange(24) / 24 * 2 * np.pi, (0.1, 0.4, 0.7, 0.9))
    arms = np.cos(angle)[..., None] * first + np.sin(angle)[..., None] * np.cross(axis, first)
    at = middle + landmark.radius_mm * (part[..., None] * arms).reshape(-1, 3)
    return at - 5.0 * axis, at + 5.0 * axis


def lines_through_incision(script):
    """Lines across the wall beside the blade's way, from outside inward, between its second and last but one pose."""
    poses = np.array(script.cuts[0].poses_mm)[1:-1]
    outside, inside = poses[:, 0], poses[:, -1]
    along = np.gradient(outside, axis=0)
    across = np.cross(along, inside - outside)
    across /= np.linalg.norm(across, axis=1, keepdims=True)
    shifts = np.array([-1.2, -0.6, 0.6, 1.2])[:, None, None] * across
    return (outside + shifts).reshape(-1, 3), (inside + shifts).reshape(-1, 3)


@pytest.mark.slow
def test_a_patch_closes_the_defect_and_stitches_close_the_incision(tmp_path, capfd):
    out = Path(os.environ.get("HEARTCASE_LIBRARY", tmp_path))
    recipe = SAMPLES / "vsd_perimembranous.toml"
    if out == tmp_path:
        (tmp_path / "sample_cases").mkdir()
        recipe = Path(shutil.copy(recipe, tmp_path / "sample_cases"))
    assert main(["build", str(recipe), "--out", str(out)]) == 0
    path = out / "vsd-perimembranous.case"
    case, script = load_case(path, needs=("surface", "tissue")), load_script(SAMPLES / "vsd_patch.toml")
    simulation = Simulation(
        case.model,
        surface=case.surface,
        tissue=case.tissue,
        step_s=script.step_s,
        damping_per_s=script.damping_per_s,
    )
    defect = next(mark for mark in case.manifest.landmarks if mark.name == "perimembranous defect")
    hole, wall = lines_through(defect), lines_through_incision(script)
    closed: dict[str, list[float]] = {"hole": [], "wall": [], "inverted": []}

    def watch(simulation, time_s):
        if not any(abs(time_s - at) < 0.5 / script.frames_per_second for at in (0.0, 0.2, 0.3, script.seconds)):
            return
        now = simulation.surface_now()
        tissue = triangle_tree(now.vertices_mm, simulation.surface.triangles)
        shut = touches(tissue, *hole)
        for patch in simulation.patches:
            state = simulation.patch_state(patch)
            shut |= touches(triangle_tree(state.vertices_mm, state.triangles), *hole)
        closed["hole"].append(float(shut.mean()))
        closed["wall"].append(float(touches(tissue, *wall).mean()))
        closed["inverted"].append(simulation.inverted_cell_count())

    summary = run_script(simulation, script, on_frame=watch)
    # At the start, held open, patched and held open, closed again.
    assert max(closed["hole"][:2]) < 0.1
    assert closed["hole"][2] == closed["hole"][3] == 1.0
    assert closed["wall"][0] == closed["wall"][3] == 1.0
    assert max(closed["wall"][1:3]) < 0.5
    assert closed["inverted"] == [0, 0, 0, 0]
    forces = np.array(list(summary.stitch_end_force_n.values()))
    np.testing.assert_allclose(forces, forces[0], rtol=1e-4)
    assert forces[0] > 0
    rim = summary.patch_end_force_n["septal patch"]
    assert len(rim) == 15
    assert min(rim) > 0
    (patch,) = simulation.patches
    assert simulation.patch_state(patch).distortion < 0.05
    recording = tmp_path / "sewn.recording"
    record = ["record", str(path), "--script", str(SAMPLES / "vsd_patch.toml"), "--out", str(recording)]
    assert main(record) == 0
    capfd.readouterr()
    assert main(["replay", str(recording), "--case", str(path)]) == 0
    assert "the same bytes" in capfd.readouterr().out
