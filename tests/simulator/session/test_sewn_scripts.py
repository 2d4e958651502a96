"""Scripts that sew: a hole closed with a patch, an incision with a row, what they tell, and the sample scripts."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from heartcase.cli.main import main
from heartcase.schemas.errors import ScriptError, UsageError
from heartcase.simulator.lattice.model import make_model
from heartcase.simulator.load import load_case
from heartcase.simulator.session.script import load_script, parse_script, run_script
from heartcase.simulator.simulation import Simulation
from tests.simulator.lattices import block, block_cells

SAMPLES = Path(__file__).parents[3] / "sample_cases"
CLOSING = """
seconds = 0.6
damping_per_s = 40.0

[[cuts]]
time_s = 0.01
at_rest = true
poses_mm = [[[12.0, 2.0, 8.0], [12.0, 14.0, 8.0]], [[12.0, 2.0, -2.0], [12.0, 14.0, -2.0]]]

[[actions]]
name = "one lip"
position_mm = [8.0, 8.0, 6.0]
radius_mm = 3.0
start_s = 0.02
release_s = 0.25
path = [{ time_s = 0.15, offset_mm = [-2.0, 0.0, 0.0] }]

[[actions]]
name = "other lip"
position_mm = [16.0, 8.0, 6.0]
radius_mm = 3.0
start_s = 0.02
release_s = 0.25
path = [{ time_s = 0.15, offset_mm = [2.0, 0.0, 0.0] }]

[[stitches]]
name = "stay"
time_s = 0.2
tied_s = 0.3
out_s = 0.5
tension_n = 0.02
at_rest = true
places_mm = [[9.0, 7.0, 6.0], [15.0, 7.0, 6.0]]

[[stitch_rows]]
name = "closure"
time_s = 0.26
tied_s = 0.4
length_mm = 5.0
running = RUNNING
spacing_mm = 2.5
at_rest = true
places_mm = [[[9.0, 3.0, 6.0], [15.0, 3.0, 6.0]], [[9.0, 13.0, 6.0], [15.0, 13.0, 6.0]]]
"""
PATCHING = """
seconds = 0.1
damping_per_s = 40.0

[[patches]]
name = "septal patch"
time_s = 0.01
spacing_mm = 2.0
scale = 0.9
outline_mm = [
  [5.0, 5.0, 4.0], [10.0, 4.0, 4.0], [15.0, 5.0, 4.0], [16.0, 10.0, 4.0],
  [15.0, 15.0, 4.0], [10.0, 16.0, 4.0], [5.0, 15.0, 4.0], [4.0, 10.0, 4.0],
]
"""


@pytest.mark.parametrize("running", ["true", "false"])
def test_a_script_closes_an_incision_with_stitches(running):
    model = block(12, 8, 3, cell_mm=2.0)
    model.node_is_fixed[model.node_index[:, 2] == 0] = True
    simulation = Simulation(model, damping_per_s=40.0)
    gaps = {}

    def watch(simulation, time_s):
        if simulation.cuts is None:
            return
        now = simulation.model
        lips = [np.flatnonzero((now.node_index == (6, 4, 3)).all(axis=1))]
        at = simulation.displacement_mm()[lips[0]]
        gaps[time_s] = float(np.ptp(at[:, 0]))

    summary = run_script(simulation, parse_script(CLOSING.replace("RUNNING", running)), on_frame=watch)
    times = np.array(sorted(gaps))
    held, closed = gaps[times[np.abs(times - 0.2).argmin()]], gaps[times[-1]]
    assert held > 2.0
    assert closed < 1.5
    names = [f"closure {number}" for number in range(1, 10 if running == "true" else 6)]
    assert set(summary.stitch_end_force_n) == {"stay", *names}
    assert summary.stitch_peak_force_n["stay"] >= 0.0199
    assert {stitch.name for stitch in simulation.stitches} == set(names)
    forces = np.array([summary.stitch_end_force_n[name] for name in names])
    assert (forces > 0).all()
    if running == "true":
        np.testing.assert_allclose(forces, forces[0], rtol=1e-5)


def is_covered(points, vertices, triangles):
    """Whether a patch lies over or under points, seen along z."""
    a, b, c = (vertices[triangles[:, corner], :2] for corner in range(3))

    def side(p, q, r):
        return (q[:, 0] - p[:, 0]) * (r[:, 1] - p[:, 1]) - (q[:, 1] - p[:, 1]) * (r[:, 0] - p[:, 0])

    found = []
    for point in points:
        r = np.broadcast_to(point, a.shape)
        signs = np.stack([side(a, b, r), side(b, c, r), side(c, a, r)])
        found.append(bool(((signs >= 0).all(axis=0) | (signs <= 0).all(axis=0)).any()))
    return np.array(found)


def test_a_script_closes_a_hole_with_a_patch():
    """A slab with a hole of 8 by 8 mm: the patch lies over all of it, and every stitch of its rim holds in tissue."""
    cells = block_cells(10, 10, 2)
    in_hole = ((cells[:, :2] >= 3) & (cells[:, :2] < 7)).all(axis=1)
    model = make_model(cells[~in_hole], cell_mm=2.0)
    model.node_is_fixed[np.isin(model.node_index[:, 0], (0, 10))] = True
    simulation = Simulation(model, damping_per_s=40.0)
    summary = run_script(simulation, parse_script(PATCHING))
    state = simulation.patch_state(simulation.patches[0])
    x = np.linspace(6.2, 13.8, 9)
    hole = np.stack(np.meshgrid(x, x), axis=-1).reshape(-1, 2)
    assert is_covered(hole, state.vertices_mm, state.triangles).all()
    assert not is_covered(np.array([(1.0, 1.0), (19.0, 10.0)]), state.vertices_mm, state.triangles).any()
    forces = summary.patch_end_force_n["septal patch"]
    assert len(forces) == len(state.stitches_mm)
    assert min(forces) > 0
    assert max(forces) <= summary.patch_peak_force_n["septal patch"]
    assert summary.displacement_max_mm < 2.0


def test_on_the_command_line_forces_stand_beside_measured_ones_and_templates_are_written(case_path, tmp_path, capfd):
    case = load_case(case_path, needs=("surface",))
    top = case.surface.rest_mm.astype(float)
    low, high = top.min(axis=0), top.max(axis=0)
    middle = (low + high) / 2
    reach = 0.3 * (high - low)
    angle = np.arange(8) / 8 * 2 * np.pi
    outline = [
        [float(middle[0] + reach[0] * np.cos(a)), float(middle[1] + reach[1] * np.sin(a)), float(high[2])]
        for a in angle
    ]
    ends = [[float(middle[0] + s * reach[0]), float(middle[1]), float(high[2])] for s in (-1, 1)]
    script = tmp_path / "sew.toml"
    script.write_text(
        "seconds = 0.02\nstep_s = 1e-4\n\n[[patches]]\nname = 'patch A'\nscale = 0.9\n"
        f"outline_mm = {outline}\n\n[[stitches]]\nname = 'one'\ntied_s = 0.01\nlength_mm = 0.5\nplaces_mm = {ends}\n"
    )
    line = ["simulate", str(case_path), "--script", str(script), "--templates", str(tmp_path)]
    assert main(line) == 0
    told = capfd.readouterr().out
    assert "Stitch     one: " in told
    assert "Patch      patch A: " in told
    assert "cuts in at 4.77 +- 3.28 N, tears out at 10.67 +- 4.04 N" in told
    for suffix in ("svg", "pdf"):
        assert (tmp_path / f"patch A.{suffix}").stat().st_size > 500
    assert main([*line, "--json"]) == 0
    told = json.loads(capfd.readouterr().out)
    assert told["patch_end_force_n"].keys() == {"patch A"}
    over = told["stitches_over_measured"]
    assert over.keys() == {"one", "patch A"}
    assert over["one"]["aortic-cut-in"] == pytest.approx(told["stitch_end_force_n"]["one"] / 9.31, rel=1e-9)
    rim = told["patch_end_force_n"]["patch A"]
    assert over["patch A"]["aortic-tear-out"] == pytest.approx(max(rim) / 20.41, rel=1e-9)
    assert main([*line[:-1], str(tmp_path / "absent")]) == UsageError.exit_code
    capfd.readouterr()


def test_what_is_wrong_with_what_a_script_sews_is_told():
    row = CLOSING.replace("RUNNING", "true")
    for text, message in (
        (row.replace('name = "stay"', 'name = "closure"'), "one name"),
        (row.replace("time_s = 0.26\ntied_s = 0.4", "time_s = 0.7\ntied_s = 0.8"), "rows come after the end: closure"),
        (PATCHING.replace("time_s = 0.01", "time_s = 0.5"), "patches come after the end: septal patch"),
        (PATCHING.replace("time_s = 0.01", "time_s = 0.01\nout_s = 0.005"), "out_s must come after time_s"),
        (row.replace("length_mm = 5.0", "length_mm = 5.0\ntension_n = 1.0"), "either length_mm or tension_n"),
    ):
        with pytest.raises(ScriptError, match=message):
            parse_script(text)


@pytest.mark.parametrize("name", ["incision_closed", "vsd_patch", "vsd_muscular_patch"])
def test_sample_scripts_are_read(name):
    script = load_script(SAMPLES / f"{name}.toml")
    assert script.cuts
    assert script.stitch_rows
    assert (len(script.patches) == 1) == (name != "incision_closed")
