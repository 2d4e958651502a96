"""``heartcase record``, ``replay`` and ``export --recording``: what they write, print and refuse."""

from __future__ import annotations

import errno
import io
import json
import os
import re
import shutil
from pathlib import Path
from types import SimpleNamespace
from unittest import mock

import numpy as np
import pygltflib
import pytest
from PIL import Image

from heartcase.cli.main import main
from heartcase.cli.sessions import record, replay
from heartcase.schemas.errors import SimulationError, UsageError
from heartcase.schemas.recording.reader import open_recording
from heartcase.simulator.load import load_case
from heartcase.simulator.patching.sewn_mesh import sewn_mesh
from heartcase.simulator.session import recorder
from heartcase.simulator.session.replay import check_frame_count, frame_steps, load_session
from heartcase.simulator.session.script import load_script, run_script
from heartcase.simulator.simulation import Simulation

SCRIPT = """
seconds = 0.2
damping_per_s = 40

[[actions]]
name = "lift"
position_mm = [20.5, -14.0, 40.5]
radius_mm = 5.0
release_s = 0.15
path = [{ time_s = 0.1, offset_mm = [0, 1.0, 2.0] }]
"""
MORE = """
seconds = 0.05
[[actions]]
name = "lift"
position_mm = [28.0, -14.0, 40.5]
radius_mm = 5.0
path = [{ time_s = 0.05, offset_mm = [0, 0, 1.0] }]
"""
SEWING = """
seconds = 0.2
damping_per_s = 40

[[stitches]]
name = "stay"
time_s = 0.05
tied_s = 0.08
out_s = 0.15
length_mm = 3.0
places_mm = [[20.5, -14.0, 40.5], [28.0, -14.0, 40.5]]

[[patches]]
name = "patch"
time_s = 0.1
spacing_mm = 3.0
scale = 0.8
outline_mm = OUTLINE
"""


@pytest.fixture
def script(tmp_path: Path) -> Path:
    (tmp_path / "pull.toml").write_text(SCRIPT)
    (tmp_path / "more.toml").write_text(MORE)
    return tmp_path / "pull.toml"


@pytest.fixture
def recorded(case_path: Path, script: Path, capsys: pytest.CaptureFixture[str]) -> Path:
    path = script.parent / "pull.recording"
    arguments = ["--script", str(script), "--out", str(path), "--state-every", "0.05"]
    assert main(["record", str(case_path), *arguments]) == 0
    assert capsys.readouterr().out.startswith("recorded 0.200 s, ")
    return path


def test_what_is_recorded_is_what_the_script_does(case_path, script, recorded):
    """The end of the recording is the end of the same script without one."""
    case = load_case(case_path)
    alone = Simulation(case.model, surface=case.surface, damping_per_s=40)
    run_script(alone, load_script(script))
    session = load_session(open_recording(recorded), case.model)
    for _ in session.play():
        pass
    assert session.deviations == []
    for name in ("displacement", "velocity"):
        assert getattr(session.simulation.state, name).tobytes() == getattr(alone.state, name).tobytes()
    header = open_recording(recorded).header
    assert (header.case_name, header.damping_per_s) == (case.manifest.name, 40.0)
    assert len(open_recording(recorded).states) >= 4


def test_replay_prints_what_it_checked(case_path, recorded, capsys):
    assert main(["replay", str(recorded), "--case", str(case_path)]) == 0
    printed = capsys.readouterr().out
    assert "Replayed   0.200 of 0.200 s" in printed
    count = len(open_recording(recorded).states)
    assert f"Checked    {count} stored states: the same bytes" in printed
    assert main(["replay", str(recorded), "--case", str(case_path), "--to", "0.1", "--json"]) == 0
    said = json.loads(capsys.readouterr().out)
    assert said["seconds"] == pytest.approx(0.1, abs=1e-3)
    assert (said["deviation_mm"], said["is_whole"], said["branch"]) == (0.0, True, None)


@pytest.mark.parametrize("lets_go", [False, True])
def test_taken_over_by_a_script(case_path, recorded, capsys, lets_go):
    other = recorded.with_name("other.recording")
    more = ["--take-over", str(recorded.with_name("more.toml")), "--out", str(other)]
    arguments = ["replay", str(recorded), "--case", str(case_path), "--to", "0.0712", *more]
    assert main([*arguments, *(["--let-go"] if lets_go else [])]) == 0
    assert f"0.050 s more in {other}\n" in capsys.readouterr().out
    found, parent = open_recording(other), open_recording(recorded)
    step = round(0.0712 / parent.header.step_s)
    assert (found.header.parent.log_hash, found.header.parent.step) == (parent.log_hash, step)
    assert found.seconds == pytest.approx(0.1212, abs=1e-3)
    opened = [entry.command.name for entry in found.entries if entry.command.kind == "open_grab"]
    closed = [entry.command.name for entry in found.entries if entry.command.kind == "close_grab"]
    assert opened == (["lift"] if lets_go else [])
    assert closed == (["lift", "lift"] if lets_go else ["lift", "lift 2"])
    assert main(["replay", str(other), "--case", str(case_path)]) == 0
    assert "the same bytes" in capsys.readouterr().out
    assert main(["validate", str(other)]) == 0


def test_info_says_what_was_recorded(case_path, recorded, capsys):
    assert main(["info", str(recorded), "--json"]) == 0
    said = json.loads(capsys.readouterr().out)
    found = open_recording(recorded)
    assert (said["kind"], said["is_whole"], said["log_hash"]) == ("recording", True, found.log_hash)
    assert said["command_counts"]["close_grab"] == 1
    assert said["case"] == load_case(case_path).manifest.name
    log = recorded / "log.jsonl"
    log.write_bytes(log.read_bytes()[:-10])
    assert main(["info", str(recorded)]) == 0
    assert "cut short or damaged" in capsys.readouterr().out


def test_each_refusal_is_a_line(case_path, recorded, script, tmp_path, capsys):
    other = tmp_path / "more.toml"
    own = tmp_path / "own.toml"
    own.write_text("damping_per_s = 3.0\n" + MORE)
    replay = ["replay", str(recorded), "--case", str(case_path)]
    out = ["--out", str(tmp_path / "x.recording")]
    damaged = tmp_path / "damaged.recording"
    shutil.copytree(recorded, damaged)
    (damaged / "log.jsonl").write_bytes((recorded / "log.jsonl").read_bytes()[:-300])
    cases = [
        ([*replay, "--to", "9"], "--to: the recording lasts 0.200 s"),
        ([*replay, "--to", "nan"], "--to: must be numbers"),
        ([*replay, "--take-over", str(other)], "--out: is missing"),
        ([*replay, *out], "--out: nothing is recorded without --take-over"),
        ([*replay, "--let-go"], "--let-go: serves only with --take-over"),
        ([*replay, "--take-over", str(own), *out], "leave damping_per_s out of the script"),
        ([*replay, "--take-over", str(other), "--out", str(recorded)], "something at this path already"),
        (["replay", str(damaged), "--case", str(case_path)], "log.jsonl: the recording was cut short"),
        (["replay", str(tmp_path), "--case", str(case_path)], "this is not a recording"),
        (["replay", str(recorded), "--case", str(tmp_path)], "this is not a case"),
        (["record", str(case_path), "--out", str(recorded)], "something at this path already"),
        (["record", str(case_path), "--out", str(tmp_path / "no" / "x.recording")], "make it first"),
        (["record", str(case_path), "--state-every", "nan", *out], "heartcase: --state-every: must be numbers"),
        (["export", str(case_path), "--recording", str(recorded), "-o", str(tmp_path / "x.stl")], ".html, .gif, .mp4"),
        (["export", str(case_path), "--recording", str(damaged), "-o", str(tmp_path / "x.glb")], "was cut short"),
        (["preview", str(recorded), "--out", str(tmp_path / "x.png")], "a recording is shown in motion"),
        (["export", str(case_path), "--error-mm", "1", "-o", str(tmp_path / "x.stl")], "--error-mm: serves only"),
        (["export", str(case_path), "--frames-per-second", "9", "-o", str(tmp_path / "x.stl")], "serves only with"),
        (
            ["export", str(case_path), "--recording", str(recorded), "--model", "solid", "-o", str(tmp_path / "x.glb")],
            "--model: a recording shows the hollow model",
        ),
    ]
    before = sorted(path.name for path in tmp_path.iterdir())
    for arguments, told in cases:
        capsys.readouterr()
        assert main(arguments) in (1, 2), arguments
        printed = capsys.readouterr()
        assert told in printed.err, (arguments, printed.err)
        assert printed.out == ""
        assert "Traceback" not in printed.err
    assert sorted(path.name for path in tmp_path.iterdir()) == before
    assert main(["replay", str(damaged), "--case", str(case_path), "--partial"]) == 0
    assert "cut short or damaged: this is what is whole of it" in capsys.readouterr().out
    film = tmp_path / "x.glb"
    assert main(["export", str(case_path), "--recording", str(damaged), "--partial", "-o", str(film)]) == 0
    printed = capsys.readouterr()
    assert f"to {film}" in printed.out
    warning = f"{damaged.stem}: it is not whole: the first 0.2 s are shown"
    assert f"warning: {warning}" in printed.err
    film.unlink()
    page, site = ["-o", str(tmp_path / "x.html")], ["--web", "-o", str(tmp_path / "site")]
    for where in (["-o", str(film)], page, site):
        for shown, warnings in ((damaged, [warning]), (recorded, [])):
            options = ["--recording", str(shown), "--partial", "--no-tours", "--json", *where]
            assert main(["export", str(case_path), *options]) == 0
            assert json.loads(capsys.readouterr().out)["warnings"] == warnings
    for made in (film, tmp_path / "x.html"):
        made.unlink()
    shutil.rmtree(tmp_path / "site")
    assert main(["export", str(case_path), "--partial", "-o", str(film)]) == 2
    assert "--partial: serves only with --recording" in capsys.readouterr().err
    assert main(["validate", str(damaged)]) == 1
    assert "cut short" in capsys.readouterr().out


ENDS = [KeyboardInterrupt, SimulationError("the simulation broke down")]


def ended_early(case_path, recorded, script, monkeypatch, takes_over, run) -> tuple[int, Path]:
    """The exit code, and where to, of a recording whose script is run by ``run``."""
    out = script.parent / "x.recording"
    monkeypatch.setattr(replay if takes_over else record, "run_script", run)
    arguments = ["record", str(case_path), "--script", str(script)]
    if takes_over:
        more = ["--take-over", str(script.with_name("more.toml"))]
        arguments = ["replay", str(recorded), "--case", str(case_path), *more]
    return main([*arguments, "--out", str(out)]), out


@pytest.mark.parametrize("error", ENDS)
@pytest.mark.parametrize("takes_over", [False, True])
def test_a_recording_that_ends_before_it_began_leaves_nothing(
    case_path, recorded, script, capsys, monkeypatch, error, takes_over
):
    def interrupted(session, *_, **__):
        assert (session.log.path / "log.jsonl").is_file()
        raise error

    code, out = ended_early(case_path, recorded, script, monkeypatch, takes_over, interrupted)
    told = capsys.readouterr().err
    assert not out.exists()
    assert (code, "nothing half-written" in told) == ((130, True) if error is KeyboardInterrupt else (1, False))
    assert len([line for line in told.splitlines() if line]) == 1


@pytest.mark.parametrize("error", ENDS)
@pytest.mark.parametrize("takes_over", [False, True])
def test_a_recording_that_ends_early_keeps_what_was_done_by_then(
    case_path, recorded, script, capsys, monkeypatch, error, takes_over
):
    def interrupted(session, script, **_):
        def on_frame(_, time_s):
            if time_s > 0.02:
                if error is KeyboardInterrupt:
                    session.simulation.step(7)  # as in the middle of a row of steps, of which the log has nothing
                raise error

        run_script(session, script, on_frame=on_frame)

    code, out = ended_early(case_path, recorded, script, monkeypatch, takes_over, interrupted)
    told = [line for line in capsys.readouterr().err.splitlines() if line]
    assert code == (130 if error is KeyboardInterrupt else 1)
    found = open_recording(out)
    assert found.is_whole
    assert found.header.end.step == found.end_step
    assert 0.02 < found.seconds - (0.2 if takes_over else 0.0) < 0.04
    assert told[0] == f"kept what was recorded by then: {found.seconds:.3f} s in {out}"
    assert len(told) == 2
    assert main(["validate", str(out)]) == 0
    assert main(["replay", str(out), "--case", str(case_path)]) == 0
    assert f"Checked    {len(found.states)} stored states: the same bytes" in capsys.readouterr().out


@pytest.mark.parametrize("error", ENDS)
@pytest.mark.parametrize("takes_over", [False, True])
def test_what_ends_a_recording_early_is_told_also_where_the_disk_is_full_by_then(
    case_path, recorded, script, capsys, monkeypatch, error, takes_over
):
    def interrupted(session, script, **_):
        def on_frame(_, time_s):
            if time_s > 0.02:
                full = OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
                monkeypatch.setattr(recorder, "atomic_write", mock.Mock(side_effect=full))
                raise error

        run_script(session, script, on_frame=on_frame)

    code, out = ended_early(case_path, recorded, script, monkeypatch, takes_over, interrupted)
    kept, ended = [line for line in capsys.readouterr().err.splitlines() if line]
    assert (code, "interrupted" in ended, "broke down" in ended) == (
        (130, True, False) if error is KeyboardInterrupt else (1, False, True)
    )
    found = open_recording(out, partial=True)
    assert not found.is_whole
    assert kept.startswith(f"kept what was recorded by then: {found.seconds:.3f} s in {out}, cut short as it cannot be")
    assert "No space left on device" in kept
    assert "replay --partial" in kept


def shapes_at(content: bytes, frame: int) -> tuple[float, np.ndarray]:
    """Time and vertices of a frame of a GLB, mm, LPS, as a reader that is not ours takes them from the file."""
    file = pygltflib.GLTF2.load_from_bytes(content)
    blob = file.binary_blob()

    def array(number: int) -> np.ndarray:
        accessor = file.accessors[number]
        view = file.bufferViews[accessor.bufferView]
        width = {"SCALAR": 1, "VEC3": 3}[accessor.type]
        start = view.byteOffset + (accessor.byteOffset or 0)
        return np.frombuffer(blob, "<f4", accessor.count * width, start).reshape(-1, width)

    (animation,) = file.animations
    (channel,) = animation.channels
    sampler = animation.samplers[channel.sampler]
    assert channel.target.path == "weights"
    mesh = file.meshes[file.nodes[channel.target.node].mesh]
    primitive = mesh.primitives[0]
    weights = array(sampler.output).reshape(-1, len(primitive.targets))
    points = array(primitive.attributes.POSITION).astype(float)
    for weight, target in zip(weights[frame], primitive.targets, strict=True):
        points = points + weight * array(target["POSITION"])
    return float(array(sampler.input)[frame, 0]), points


def test_a_glb_moves_as_the_surface_did(case_path, recorded, capsys):
    out = recorded.with_suffix(".glb")
    arguments = ["export", str(case_path), "--recording", str(recorded), "-o", str(out), "--json"]
    assert main([*arguments, "--frames-per-second", "30", "--error-mm", "0.01"]) == 0
    said = json.loads(capsys.readouterr().out)
    assert said["frame_count"] == 7
    assert said["error_mm"] <= 0.01
    case = load_case(case_path)
    session = load_session(open_recording(recorded), case.model, surface=case.surface)
    furthest = 0.0
    for frame in range(7):
        time_s, points = shapes_at(out.read_bytes(), frame)
        session.go_to(round(time_s / session.simulation.step_s))
        expected = session.simulation.surface_now().vertices_mm
        assert np.linalg.norm(points - expected, axis=1).max() <= 0.0101
        furthest = max(furthest, float(np.linalg.norm(points - case.surface.rest_mm, axis=1).max()))
    assert time_s == pytest.approx(0.2, abs=1e-3)
    assert furthest > 1.5


def test_a_gif_has_its_frames(case_path, recorded):
    out = recorded.with_suffix(".gif")
    assert main(["export", str(case_path), "--recording", str(recorded), "-o", str(out)]) == 0
    picture = Image.open(io.BytesIO(out.read_bytes()))
    assert picture.n_frames == 4
    frames = []
    for number in (0, 2):
        picture.seek(number)
        frames.append(np.asarray(picture.convert("RGB")).astype(int))
    assert np.abs(frames[1] - frames[0]).max() > 30


def test_a_script_with_cuts_and_a_probe_is_shown_recorded_repeated_and_exported(case_path, script, capsys):
    """The same cut everywhere, by the case's finest surface, whether it is shown or not."""
    case = load_case(case_path, needs=("surface", "tissue"))
    low, high = case.surface.rest_mm.min(axis=0).tolist(), case.surface.rest_mm.max(axis=0).tolist()
    x, top, deep = low[0] + 0.4 * (high[0] - low[0]), high[2] + 2, low[2] + 0.4 * (high[2] - low[2])
    poses = [[[x, y, top], [x, y, deep]] for y in (low[1] - 2, high[1] + 2)]
    probe = [low[0] - 20.0, low[1], high[2]]
    file = script.parent / "cut.toml"
    file.write_text(
        f"{SCRIPT}[[cuts]]\ntime_s = 0.05\nposes_mm = {poses}\n[[probes]]\nposition_mm = {probe}\n"
        "path = [{ time_s = 0.1, offset_mm = [1.0, 0.0, 0.0] }]\n"
    )
    picture = script.parent / "cut.png"
    surface = script.parent / "cut.ply"
    arguments = [str(case_path), "--script", str(file)]
    assert main(["simulate", *arguments, "--picture", str(picture), "--surface", str(surface)]) == 0
    printed = capsys.readouterr().out
    nodes = int(printed.split("Lattice")[1].split(" nodes")[0].replace(",", ""))
    assert nodes > case.model.node_count
    assert "probe: at most 0 N\n" in printed
    path = script.parent / "cut.recording"
    assert main(["record", *arguments, "--out", str(path), "--state-every", "0.05"]) == 0
    assert main(["replay", str(path), "--case", str(case_path)]) == 0
    session = load_session(open_recording(path), case.model, tissue=case.tissue)
    for _ in session.play():
        pass
    assert session.simulation.model.node_count == nodes
    assert session.deviations == []
    for suffix in (".glb", ".gif"):
        out = script.parent / f"cut{suffix}"
        assert main(["export", str(case_path), "--recording", str(path), "--out", str(out)]) == 0
    glb = pygltflib.GLTF2().load(str(script.parent / "cut.glb"))
    assert len(glb.meshes) == 2
    assert sum(1 for _ in glb.nodes) >= 2


def sewn_at(content: bytes, time_s: float) -> np.ndarray:
    """Corners of the triangles of what a GLB shows beside the tissue at the time of a frame, (count, 3, 3)."""
    file = pygltflib.GLTF2.load_from_bytes(content)
    blob = file.binary_blob()

    def array(number: int) -> np.ndarray:
        accessor = file.accessors[number]
        view = file.bufferViews[accessor.bufferView]
        kind, width = {5126: "<f4", 5125: "<u4", 5123: "<u2"}[accessor.componentType], 1 + 2 * (accessor.type == "VEC3")
        start = view.byteOffset + (accessor.byteOffset or 0)
        return np.frombuffer(blob, kind, accessor.count * width, start).reshape(-1, width)

    (animation,) = file.animations
    found = [np.zeros((0, 3, 3))]
    for number, node in enumerate(file.nodes):
        if node.mesh is None or node.name == "surface 1":
            continue
        own = {
            one.target.path: animation.samplers[one.sampler] for one in animation.channels if one.target.node == number
        }
        times = array(own["scale"].input)[:, 0]
        if array(own["scale"].output)[np.searchsorted(times, time_s + 1e-4) - 1, 0] == 0:
            continue
        for primitive in file.meshes[node.mesh].primitives:
            points = array(primitive.attributes.POSITION).astype(float)
            if "weights" in own:
                frame = np.abs(array(own["weights"].input)[:, 0] - time_s).argmin()
                weights = array(own["weights"].output).reshape(-1, len(primitive.targets))[frame]
                for weight, target in zip(weights, primitive.targets, strict=True):
                    points = points + weight * array(target["POSITION"])
            found.append(points[array(primitive.indices).reshape(-1, 3)])
    return np.concatenate(found)


def test_a_glb_shows_what_is_sewn_while_it_is_there(case_path, tmp_path, capsys):
    """A stitch comes, a patch comes, the stitch goes: their triangles are where they are in the session."""
    angle = np.arange(8) / 8 * 2 * np.pi
    outline = np.stack([24 + 6 * np.cos(angle), -14 + 6 * np.sin(angle), np.full(8, 40.5)], axis=1).round(1).tolist()
    (tmp_path / "sewing.toml").write_text(SEWING.replace("OUTLINE", str(outline)))
    recorded, out = tmp_path / "sewing.recording", tmp_path / "sewing.glb"
    assert main(["record", str(case_path), "--script", str(tmp_path / "sewing.toml"), "--out", str(recorded)]) == 0
    arguments = ["export", str(case_path), "--recording", str(recorded), "-o", str(out), "--error-mm", "0.01"]
    assert main([*arguments, "--frames-per-second", "30"]) == 0
    case = load_case(case_path, needs=("surface", "tissue"))
    session = load_session(open_recording(recorded), case.model, surface=case.surface, tissue=case.tissue)
    counts = []
    for step in [session.start_step, *frame_steps(session, 30.0)]:
        session.go_to(step)
        simulation = session.simulation
        expected = sewn_mesh(
            [simulation.patch_state(patch) for patch in simulation.patches],
            [simulation.stitch_state(stitch) for stitch in simulation.stitches],
        )
        shown = sewn_at(out.read_bytes(), step * simulation.step_s)
        counts.append(len(shown))
        corners = expected.vertices_mm[expected.triangles]
        assert shown.shape == corners.shape
        if len(shown):
            apart = shown.mean(axis=1)[:, None] - corners.mean(axis=1)
            assert np.linalg.norm(apart, axis=2).min(axis=1).max() <= 0.0101
    assert counts[0] == 0
    assert len(set(counts)) == 4
    assert counts[1:] != sorted(counts[1:])


@pytest.mark.parametrize("seconds", [250.0, 312.53, 5_999.9])
def test_too_many_frames_are_refused_with_a_rate_that_is_not(seconds):
    recording = SimpleNamespace(seconds=seconds)
    with pytest.raises(UsageError, match=r"frames are more than 3,000: give ([\d.]+) or less") as caught:
        check_frame_count(recording, 15.0)
    rate = float(re.search(r"give ([\d.]+)", str(caught.value))[1])
    check_frame_count(recording, rate)
    with pytest.raises(UsageError):
        check_frame_count(recording, rate + 0.2)


def test_a_recording_that_no_rate_fits_is_said_to_be_too_long():
    with pytest.raises(UsageError, match="show a shorter recording"):
        check_frame_count(SimpleNamespace(seconds=1e6), 0.1)
