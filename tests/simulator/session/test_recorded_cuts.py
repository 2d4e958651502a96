"""Cuts as commands of a session: taken back, recorded, repeated to the byte, and in scripts."""

from __future__ import annotations

import numpy as np
import pytest

from heartcase.schemas.errors import RecordingError, ScriptError
from heartcase.schemas.recording.commands import Advance, CloseGrab, Cut, LeadGrab, Rewind, Undo, parse_command
from heartcase.schemas.recording.reader import open_recording
from heartcase.schemas.scripts.script import CutAction
from heartcase.simulator.session.operating_session import OperatingSession
from heartcase.simulator.session.recorder import Recorder
from heartcase.simulator.session.replay import load_session
from heartcase.simulator.session.script import parse_script, run_script
from heartcase.simulator.simulation import Simulation
from tests.simulator.cutting.test_cuts import across_bar, blade_mm
from tests.simulator.lattices import block, oblique_geometry


def bar():
    model = block(9, 4, 4, geometry=oblique_geometry((4, 4, 9)))
    model.node_is_fixed[model.node_index[:, 0] == 0] = True
    return model


def as_tuples(poses):
    return tuple(tuple(tuple(point) for point in pose) for pose in np.asarray(poses).tolist())


def pull(model):
    tip = model.rest_positions_mm()[model.node_index[:, 0] == 9].mean(axis=0)
    return [
        CloseGrab(name="hand", center_mm=tuple(tip.tolist()), radius_mm=2 * model.cell_mm),
        LeadGrab(name="hand", offset_mm=(1.0, 2.0, 3.0)),
        Advance(steps=40),
    ]


def bytes_of(simulation):
    return simulation.model.node_count, simulation.state.displacement.tobytes(), simulation.state.velocity.tobytes()


def operate(session, model):
    for command in pull(model):
        session.do(command)
    session.do(Cut(poses_mm=as_tuples(across_bar(model))))
    session.do(Advance(steps=30))
    session.do(Cut(poses_mm=as_tuples(across_bar(model, 6.3, 1.5))))
    session.do(Advance(steps=30))


def test_a_cut_is_taken_back_and_done_again():
    model = bar()
    session = OperatingSession(Simulation(model, sleep_mm=0))
    operate(session, model)
    end = bytes_of(session.simulation)
    session.do(Undo())
    assert session.simulation.model.node_count < end[0]
    session.do(Undo())
    assert session.simulation.model.node_count == model.node_count
    session.go_to(session.end_step)
    assert bytes_of(session.simulation) == end
    session.do(Rewind(seconds=45 * session.simulation.step_s))
    session.go_to(session.end_step)
    assert bytes_of(session.simulation) == end
    assert [change.kind for change in session.frame().topology].count("cut") >= 2


@pytest.mark.parametrize("backend", ["cpu", "reference"])
def test_a_recording_with_cuts_repeats_to_the_byte_and_is_taken_over(tmp_path, backend):
    model = bar()
    session = OperatingSession(Simulation(model, backend=backend, sleep_mm=0))
    with Recorder(session, tmp_path / "a.recording", state_every_s=20 * session.simulation.step_s):
        operate(session, model)
    end = bytes_of(session.simulation)
    recording = open_recording(tmp_path / "a.recording")
    again = load_session(recording, model)
    assert sum(1 for _ in again.play()) == 3
    assert not again.deviations
    assert bytes_of(again.simulation) == end
    # A short way there, by stored states behind the cuts, and on from between them.
    again = load_session(recording, model)
    again.go_to(85)
    again.go_to(again.end_step)
    assert bytes_of(again.simulation) == end
    again.go_to(55)
    again.do(Cut(poses_mm=as_tuples(across_bar(model, 7.4, 2.0)), at_rest=True))
    again.do(Advance(steps=5))
    assert np.isfinite(again.simulation.positions_mm()).all()


def test_a_recording_is_refused_where_tissue_is_another_or_was_cut_before(tmp_path):
    model = bar()
    session = OperatingSession(Simulation(model, sleep_mm=0))
    with Recorder(session, tmp_path / "a.recording"):
        operate(session, model)
    recording = open_recording(tmp_path / "a.recording")
    other = recording.header.model_copy(update={"tissue_sha256": "0" * 64})
    object.__setattr__(recording, "header", other)
    with pytest.raises(RecordingError, match="with needs="):
        load_session(recording, model)
    with pytest.raises(RecordingError, match="cut or joined"):
        Recorder(OperatingSession(session.simulation), tmp_path / "b.recording")


def test_a_script_cuts_now_or_at_rest():
    model = bar()
    poses = as_tuples(across_bar(model))
    text = f"""
heartcase_script = 1
seconds = 0.02
[[actions]]
kind = "grab"
position_mm = {list(model.rest_positions_mm()[model.node_index[:, 0] == 9].mean(axis=0).tolist())}
radius_mm = 6.0
path = [{{ time_s = 0.01, offset_mm = [1.0, 2.0, 3.0] }}]
[[cuts]]
time_s = 0.012
poses_mm = {[[list(point) for point in pose] for pose in poses]}
"""
    counts = []
    for script in (text, text + "at_rest = true\n", text.replace("0.012", "0.0")):
        simulation = Simulation(model, sleep_mm=0)
        summary = run_script(simulation, parse_script(script))
        assert summary.node_count == simulation.model.node_count > model.node_count
        assert summary.inverted_cell_count_end == 0
        counts.append(summary.node_count)
    assert counts[1] == counts[2]
    with pytest.raises(ScriptError, match="as many points"):
        parse_script(text.replace("]]]", "], [1.0, 2.0, 3.0]]]"))
    assert CutAction(poses_mm=poses).time_s == 0


def test_commands_that_are_no_cut_are_refused():
    for poses in (
        [],
        [[[0, 0, 0]]],
        [[[0, 0, 0], [1, 1, 1]]],
        [[[0, 0], [1, 1]]] * 2,
        [[[0, 0, 0]] * 2, [[0, 0, 0]] * 3],
    ):
        with pytest.raises(RecordingError, match="pose"):
            parse_command({"kind": "cut", "poses_mm": poses})


def test_a_blade_in_the_gap_of_a_cut_is_recorded_where_it_met_tissue(tmp_path):
    model = bar()
    session = OperatingSession(Simulation(model, sleep_mm=0))
    with Recorder(session, tmp_path / "a.recording"):
        session.do(Cut(poses_mm=as_tuples(across_bar(model, 4.3, 3.3))))
        hand = pull(model)[0]
        down = -3.0 * (blade_mm(model, [0, 0, 1]) - blade_mm(model, [0, 0, 0]))
        session.do(hand)
        session.do(LeadGrab(name=hand.name, offset_mm=tuple(down.tolist())))
        session.do(Advance(steps=400))
        # Between the lips at the top, and in tissue further down.
        poses = [[[place, -1.0, 5.0], [place, -1.0, 0.5]] for place in (4.7, 4.7)]
        poses[1][0][1] = poses[1][1][1] = 5.0
        session.do(Cut(poses_mm=as_tuples(blade_mm(model, poses))))
        session.do(Advance(steps=20))
    cut = [entry.command for entry in session.entries if isinstance(entry.command, Cut)][-1]
    places = [point for pose in cut.poses_mm for point in pose]
    assert None in places
    assert any(places)
    assert parse_command(cut.model_dump(mode="json")) == cut
    with pytest.raises(RecordingError, match="where it is not at rest"):
        parse_command({**cut.model_dump(mode="json"), "at_rest": False})
    again = load_session(open_recording(tmp_path / "a.recording"), model)
    for _ in again.play():
        pass
    assert not again.deviations
    assert bytes_of(again.simulation) == bytes_of(session.simulation)
