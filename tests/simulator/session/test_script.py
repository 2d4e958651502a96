"""Scripts, summaries and the files that a session leaves."""

from __future__ import annotations

import json
from unittest import mock

import numpy as np
import pytest
import trimesh

from heartcase.cli.main import main
from heartcase.schemas.errors import ScriptError, UsageError
from heartcase.schemas.landmarks import Landmark
from heartcase.schemas.scripts.script import GrabAction, SimulationScript, Waypoint
from heartcase.simulator.load import load_case
from heartcase.simulator.session.script import default_script, load_script, parse_script, run_script, with_positions
from heartcase.simulator.simulation import Simulation
from heartcase.simulator.surface.write_surface import write_surface

PULL = """
seconds = 0.3
damping_per_s = 40

[[actions]]
name = "lift"
position_mm = [20.5, -14.0, 40.5]
radius_mm = 5.0
release_s = 0.2
path = [{ time_s = 0.1, offset_mm = [0, 0, 2.0] }]
"""


def test_script_is_read(tmp_path):
    file = tmp_path / "pull.toml"
    file.write_text(PULL)
    script = load_script(file)
    assert script.seconds == 0.3
    assert script.actions[0].path == (Waypoint(time_s=0.1, offset_mm=(0, 0, 2.0)),)


def test_every_problem_of_a_script_is_reported_at_once():
    text = PULL.replace("seconds = 0.3", "seconds = -1").replace("radius_mm = 5.0", "radius_mm = 0\ncolour = 3")
    with pytest.raises(ScriptError) as caught:
        parse_script(text)
    assert {problem.place for problem in caught.value.problems} == {
        "seconds", "actions[1].radius_mm", "actions[1].colour",
    }  # fmt: skip


def test_broken_scripts_are_one_line(tmp_path):
    with pytest.raises(ScriptError, match="TOML"):
        parse_script("seconds = = 3")
    with pytest.raises(ScriptError, match="no such file"):
        load_script(tmp_path / "absent.toml")
    (tmp_path / "binary.toml").write_bytes(b"\xff\xfe\x00")
    with pytest.raises(ScriptError, match="UTF-8"):
        load_script(tmp_path / "binary.toml")


def test_landmarks_become_positions():
    path = (Waypoint(time_s=1.0, offset_mm=(1, 0, 0)),)
    script = SimulationScript(actions=(GrabAction(landmark="Apex", path=path), GrabAction(landmark="ring", path=path)))
    ring = Landmark(name="Ring", kind="ring", points_mm=((0, 0, 0), (2, 0, 0), (1, 3, 0)))
    apex = Landmark(name="apex", kind="point", points_mm=((4, 5, 6),))
    placed = with_positions(script, (apex, ring))
    assert [action.position_mm for action in placed.actions] == [(4, 5, 6), (1, 1, 0)]
    with pytest.raises(ScriptError) as caught:
        with_positions(script, ())
    assert [problem.place for problem in caught.value.problems] == ["actions[1].landmark", "actions[2].landmark"]


def test_session_follows_the_script(case_path):
    case = load_case(case_path)
    script = parse_script(PULL)
    simulation = Simulation(case.model, surface=case.surface, damping_per_s=script.damping_per_s)
    seen = []

    def look(running, time_s):
        held = running.grabs[0].pose.offset if running.grabs else None
        seen.append((time_s, None if held is None else running.model.to_mm(held)[2]))

    summary = run_script(simulation, script, on_frame=look)
    assert len(seen) == 1 + round(0.3 * 30)
    step = simulation.step_s
    for time_s, height in seen[1:]:
        # The frame's time is a whole number of steps; the hand is at 2 mm from 0.1 s on, and gone after 0.2 s.
        if time_s > 0.2 + step:
            assert height is None
        elif time_s < 0.2 - step:
            assert height == pytest.approx(min(time_s / 0.1, 1.0) * 2.0, abs=2.0 * step / 0.1)
    assert summary.step_count == round(0.3 / step) == simulation.step_count
    assert summary.held_node_count["lift"] > 0
    assert summary.displacement_max_mm == pytest.approx(2.0, abs=0.4)
    assert 0.01 < summary.peak_force_n["lift"] < 10
    assert summary.frame_time_s == tuple(time for time, _ in seen)
    assert summary.frame_energy[0].total_j == 0.0
    assert max(energy.elastic_j for energy in summary.frame_energy) > 0
    assert summary.inverted_cell_count_end == 0
    json.dumps(summary.to_dict())


def test_frames_do_not_change_the_motion(case_path):
    """How often one looks does not matter, but for the float32 rounding of where the hand is led."""
    case = load_case(case_path, needs=("grid",))
    ends = []
    for rate in (10, 90):
        simulation = Simulation(case.model)
        run_script(simulation, parse_script(PULL).model_copy(update={"frames_per_second": rate}))
        ends.append(simulation.displacement_mm())
    assert np.abs(ends[0]).max() > 0.1
    np.testing.assert_allclose(ends[0], ends[1], atol=1e-3)


def test_default_pull_is_away_from_the_base_and_lets_go(case_path):
    case = load_case(case_path)
    script = default_script(case.model, case.surface, seconds=1.0)
    (pull,) = script.actions
    assert pull.position_mm[2] == pytest.approx(case.surface.rest_mm[:, 2].max())
    assert np.linalg.norm(pull.path[-1].offset_mm) == pytest.approx(10.0)
    assert pull.path[-1].offset_mm[2] > 0
    assert pull.release_s < script.seconds


@pytest.mark.parametrize("suffix", [".ply", ".stl", ".obj"])
def test_surfaces_are_read_back_by_another_library(case_path, tmp_path, suffix):
    case = load_case(case_path, needs=("colours",))
    simulation = Simulation(case.model, surface=case.surface)
    now = simulation.surface_now()
    file = tmp_path / f"end{suffix}"
    write_surface(file, now.vertices_mm, now.normals, case.surface.triangles, colours=case.triangle_colours)
    mesh = trimesh.load(file, process=False)
    np.testing.assert_allclose(mesh.triangles, now.vertices_mm[case.surface.triangles], rtol=1e-6)
    assert mesh.volume == pytest.approx(8 * 5 * 4 * 27.0, rel=1e-5)
    if suffix == ".ply":
        np.testing.assert_array_equal(mesh.visual.face_colors[:, :3], case.triangle_colours)
    assert [path.name for path in tmp_path.iterdir()] == [file.name]


def test_unknown_surface_format_is_refused(tmp_path):
    nothing = np.zeros((0, 3), np.float32)
    with pytest.raises(UsageError, match=r"\.ply, \.stl, \.obj"):
        write_surface(tmp_path / "end.vtk", nothing, nothing, nothing.astype(np.int32))


def test_command_prints_a_summary_and_writes_the_surface(case_path, tmp_path, capsys):
    script = tmp_path / "pull.toml"
    script.write_text(PULL)
    surface = tmp_path / "end.ply"
    arguments = ["simulate", str(case_path), "--script", str(script), "--seconds", "0.05", "--surface", str(surface)]
    assert main(arguments) == 0
    text = capsys.readouterr().out
    for words in ("270 nodes", "step", "real-time factor", "lift: at most", "Not a medical device"):
        assert words in text
    assert len(trimesh.load(surface, process=False).faces) > 0
    assert main([*arguments, "--json"]) == 0
    summary = json.loads(capsys.readouterr().out)
    assert summary["node_count"] == 270
    assert summary["seconds"] == pytest.approx(0.05, abs=summary["step_s"])


@pytest.mark.parametrize(
    ("arguments", "code", "message"),
    [
        (["--step", "0.1"], 1, "bound is"),
        (["--surface", "end.vtk"], 2, ".ply"),
        (["--animation", "end.avi"], 2, ".gif"),
        (["--picture", "end.txt"], 2, ".png"),
        (["--surface", "nowhere/at/all/end.ply"], 2, "folder"),
        (["--script", "absent.toml"], 1, "no such file"),
        (["--near-cuts"], 2, "nothing to look at"),
        (["--near-cuts", "--picture", "end.png"], 2, "--near-cuts: needs a --script with [[cuts]]\n"),
        (["--seconds", "-1"], 2, "range"),
    ],
)
def test_command_refuses_in_one_line(case_path, capsys, arguments, code, message):
    assert main(["simulate", str(case_path), *arguments]) == code
    assert message in capsys.readouterr().err


def test_animation_and_picture_show_the_deformation(case_path, tmp_path, capsys):
    image = pytest.importorskip("PIL.Image")
    montage = pytest.importorskip("heartcase.pipeline.report.montage")
    film, picture = tmp_path / "pull.gif", tmp_path / "pull.png"
    arguments = ["--seconds", "0.2", "--animation", str(film), "--picture", str(picture)]
    with mock.patch.object(montage, "montage", wraps=montage.montage) as laid_out:
        assert main(["simulate", str(case_path), *arguments]) == 0
    assert next(iter(laid_out.call_args.args[0])) == "block, at the start"
    assert f"wrote the picture to {picture}\nwrote the animation to {film}\n" in capsys.readouterr().out
    with image.open(film) as frames:
        assert frames.n_frames == 4
        first = np.array(frames.convert("RGB"), int)
        frames.seek(frames.n_frames // 2)
        assert np.abs(np.array(frames.convert("RGB"), int) - first).max() > 60
    with image.open(picture) as shot:
        pixels = np.array(shot.convert("RGB"))
    assert (pixels == 255).all(axis=2).mean() > 0.2
    # The tissue's colour is red.
    tissue = pixels[(pixels < 250).any(axis=2)].astype(int)
    assert len(tissue) > 5000
    assert (tissue[:, 0] >= tissue[:, 2]).mean() > 0.95


def test_cuts_are_looked_at_from_close_by_and_from_where_the_blade_came(case_path, tmp_path, capsys):
    image = pytest.importorskip("PIL.Image")
    surface = load_case(case_path).surface
    low, high = surface.rest_mm.min(axis=0), surface.rest_mm.max(axis=0)
    x, y, z = ((low + high) / 2).tolist()
    # From the top down into the middle: the inner end of the blade comes first. Also as the line, and the line above.
    poses = np.array([[[x + by, y, z], [x + by, y, float(high[2]) + 1.0]] for by in (-4.0, 4.0)])
    pull = PULL.replace("position_mm = [20.5, -14.0, 40.5]", f"position_mm = {[x, y + 3.0, float(high[2]) - 1.0]}")
    shown = {}
    for name, options, form in (
        ("far", (), poses),
        ("near", ("--near-cuts",), poses),
        ("line", ("--near-cuts",), poses.swapaxes(0, 1)),
    ):
        film, script = tmp_path / f"{name}.gif", tmp_path / f"{name}.toml"
        script.write_text(
            f"{pull.replace('[0, 0, 2.0]', '[0, 4.0, 0]')}\n[[cuts]]\ntime_s = 0.01\n"
            f"poses_mm = {form.tolist()}\n".replace("radius_mm = 5.0", "radius_mm = 4.0")
        )
        arguments = ["--script", str(script), "--animation", str(film), *options]
        assert main(["simulate", str(case_path), *arguments]) == 0
        with image.open(film) as frames:
            shown[name] = np.array(frames.convert("RGB"), int)
    white = {name: float((pixels == 255).all(axis=2).mean()) for name, pixels in shown.items()}
    assert white["far"] > 0.3
    assert white["near"] < 0.05  # the box around the cut is narrower than the top that is looked at
    assert np.array_equal(shown["line"], shown["near"])


def test_interrupted_session_leaves_nothing(case_path, tmp_path, monkeypatch, capsys):
    def interrupt(*_):
        raise KeyboardInterrupt

    monkeypatch.setattr(Simulation, "surface_now", interrupt)
    surface = tmp_path / "end.ply"
    assert main(["simulate", str(case_path), "--seconds", "0.1", "--surface", str(surface)]) == 130
    assert "interrupted" in capsys.readouterr().err
    assert list(tmp_path.iterdir()) == []
