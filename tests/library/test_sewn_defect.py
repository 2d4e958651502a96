"""Two sample cases sewn: incised, held open, the septal defect closed with a patch, the incision with a running thread.

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
from heartcase.simulator.incisions.directions import cone_directions
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
    reach = 1.5 * landmark.radius_mm
    return at - reach * axis, at + reach * axis


def lines_through_incision(script):
    """Lines across the wall beside the blade's way, from outside inward, between its second and last but one pose."""
    poses = np.array(script.cuts[0].poses_mm)[1:-1]
    outside, inside = poses[:, 0], poses[:, -1]
    along = np.gradient(outside, axis=0)
    across = np.cross(along, inside - outside)
    across /= np.linalg.norm(across, axis=1, keepdims=True)
    shifts = np.array([-1.2, -0.6, 0.6, 1.2])[:, None, None] * across
    return (outside + shifts).reshape(-1, 3), (inside + shifts).reshape(-1, 3)


def sights(landmark, script, patch_mm):
    """Lines of sight from outside, in front of the incision, to places in the hole half a millimetre behind a patch:
    both ends of each, (place, eye, 3)."""
    middle, opening = np.array(landmark.points_mm[0]), np.array(script.cuts[0].poses_mm).mean(axis=(0, 1))
    axis = np.array(landmark.axis) / np.linalg.norm(landmark.axis)
    beside = np.linalg.norm(np.cross(patch_mm - middle, axis), axis=1)
    places = patch_mm[beside < 0.9 * landmark.radius_mm] - 0.5 * axis
    eyes = middle + 400.0 * cone_directions(opening - middle, 30.0, 200)
    return np.broadcast_arrays(eyes[None], places[:, None])


def lips_apart_mm(simulation):
    """Largest distance between two places of cut faces that are one at rest, mm."""
    split, now = simulation.split, simulation.surface_now().vertices_mm.astype(float)
    if split is None:
        return 0.0
    own = np.unique(simulation.surface.triangles[split.triangle_is_cut_face])
    _, place = np.unique(np.round(simulation.surface.rest_mm[own].astype(float), 3), axis=0, return_inverse=True)
    place = place.reshape(-1)
    first = np.full(place.max() + 1, -1)
    first[place[::-1]] = own[::-1]
    return float(np.linalg.norm(now[own] - now[first[place]], axis=1).max())


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "defect", "script", "stitches"),
    [
        ("vsd-perimembranous", "perimembranous defect", "vsd_patch", 15),
        ("vsd-muscular-mid", "mid muscular defect", "vsd_muscular_patch", 24),
    ],
)
def test_a_patch_closes_the_defect_and_stitches_close_the_incision(name, defect, script, stitches, tmp_path, capfd):
    out = Path(os.environ.get("HEARTCASE_LIBRARY", tmp_path))
    recipe = SAMPLES / f"{name.replace('-', '_')}.toml"
    if out == tmp_path:
        (tmp_path / "sample_cases").mkdir()
        recipe = Path(shutil.copy(recipe, tmp_path / "sample_cases"))
    assert main(["build", str(recipe), "--out", str(out)]) == 0
    path, script_path = out / f"{name}.case", SAMPLES / f"{script}.toml"
    case, script = load_case(path, needs=("surface", "tissue")), load_script(script_path)
    simulation = Simulation(
        case.model,
        surface=case.surface,
        tissue=case.tissue,
        step_s=script.step_s,
        damping_per_s=script.damping_per_s,
    )
    landmark = next(mark for mark in case.manifest.landmarks if mark.name == defect)
    hole, wall = lines_through(landmark), lines_through_incision(script)
    times = (0.0, 0.2, 0.3, script.seconds)
    told: dict[str, list[float]] = {"hole": [], "wall": [], "apart": [], "inverted": []}
    shown = []

    def watch(simulation, time_s):
        if not any(abs(time_s - at) < 0.5 / script.frames_per_second for at in times):
            return
        now = simulation.surface_now()
        tissue = triangle_tree(now.vertices_mm, simulation.surface.triangles)
        sheets = [simulation.patch_state(patch) for patch in simulation.patches]
        trees = [tissue, *(triangle_tree(sheet.vertices_mm, sheet.triangles) for sheet in sheets)]
        shown.append((trees, sheets))
        told["hole"].append(float(np.any([touches(tree, *hole) for tree in trees], axis=0).mean()))
        told["wall"].append(float(touches(tissue, *wall).mean()))
        told["apart"].append(lips_apart_mm(simulation))
        told["inverted"].append(simulation.inverted_cell_count())

    summary = run_script(simulation, script, on_frame=watch)
    eyes, places = sights(landmark, script, shown[2][1][0].vertices_mm)
    seen = []
    for trees, _ in shown:
        hidden = np.any([touches(tree, eyes.reshape(-1, 3), places.reshape(-1, 3)) for tree in trees], axis=0)
        seen.append(float((~hidden.reshape(eyes.shape[:2])).any(axis=1).mean()))
    # At the start, held open, patched and held open, closed again.
    assert max(told["hole"][:2]) < 0.1
    assert told["hole"][2] == told["hole"][3] == 1.0
    assert told["wall"][0] == told["wall"][3] == 1.0
    assert max(told["wall"][1:3]) < 0.5
    assert seen[1] > 0.5
    assert (seen[0], seen[2], seen[3]) == (0.0, 0.0, 0.0)
    assert min(told["apart"][1:3]) > 5.0
    assert told["apart"][3] < 0.5
    assert told["inverted"] == [0, 0, 0, 0]
    forces = np.array(list(summary.stitch_end_force_n.values()))
    np.testing.assert_allclose(forces, forces[0], rtol=1e-4, atol=3e-7)  # places are in single precision
    assert forces[0] > 0
    rim = summary.patch_end_force_n["septal patch"]
    assert len(rim) == stitches
    assert min(rim) > 0
    (patch,) = simulation.patches
    assert simulation.patch_state(patch).distortion < 0.05
    recording = tmp_path / "sewn.recording"
    assert main(["record", str(path), "--script", str(script_path), "--out", str(recording)]) == 0
    capfd.readouterr()
    assert main(["replay", str(recording), "--case", str(path)]) == 0
    assert "the same bytes" in capfd.readouterr().out
