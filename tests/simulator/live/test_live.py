"""A session in a thread: commands at any time, time that stands and goes back, recordings that repeat to the byte."""

from __future__ import annotations

import errno
import os
from types import SimpleNamespace
from unittest import mock

import numpy as np
import pytest

from heartcase.schemas.recording.commands import (
    BringProbe,
    CloseGrab,
    Cut,
    LeadGrab,
    MoveProbe,
    OpenGrab,
    Redo,
    Rewind,
    Undo,
)
from heartcase.schemas.recording.reader import open_recording
from heartcase.simulator.live import live as live_module
from heartcase.simulator.live.live import Live
from heartcase.simulator.session.operating_session import OperatingSession
from heartcase.simulator.session.recorder import Recorder
from heartcase.simulator.session.replay import load_session
from tests.simulator.live.scenes import bytes_of, live_on, load, threads, until

TOP = (22.0, -14.0, 40.5)
"""A place at the upper side of the block, LPS mm."""


@pytest.fixture
def case(live_case):
    return load(live_case)


def played_again(path, case):
    again = load_session(open_recording(path), case.model, surface=case.surface, tissue=case.tissue)
    for _ in again.play():
        pass
    assert again.deviations == []
    return again


def test_what_was_taken_back_is_a_branch_when_time_goes_on_and_is_known_again_when_it_is_taken_up(case, tmp_path):
    live = live_on(case)
    live.record(tmp_path / "a.recording")
    live.do(CloseGrab(name="hand", center_mm=TOP, radius_mm=4.0))
    for _ in range(5):
        live.tick()
    end, bytes_then = live.newest.frame.step, bytes_of(live.session.simulation)
    live.do(Undo())
    live.tick()
    assert live.newest.branches == ()
    live.pause(False)
    live.tick()
    (branch,) = live.newest.branches
    assert live.newest.ahead_s == 0.0
    live.take_up(branch.number)
    live.tick()
    assert live.newest.mode == "paused"
    assert live.newest.branches == ()
    live.session.go_to(end)
    assert bytes_of(live.session.simulation) == bytes_then
    # what there is none of is told
    live.take_up(branch.number)
    live.tick()
    assert any("no such branch" in said.message for said in live.take_messages())
    # what is dropped for good is no branch
    live.do(Undo())
    live.forget_ahead()
    live.pause(False)
    live.tick()
    assert live.newest.branches == ()
    live.close()
    played_again(tmp_path / "a.recording", case)


def test_acts_are_counted_anew_where_others_came_in_their_place_within_one_frame(case):
    live = live_on(case)
    live.do(CloseGrab(name="first", center_mm=TOP, radius_mm=4.0))
    live.tick()
    live.tick()
    assert (live.newest.act_count, live.session.position) == (1, 3)
    live.do(Undo())
    live.do(CloseGrab(name="second", center_mm=TOP, radius_mm=4.0))
    live.do(CloseGrab(name="third", center_mm=(13.0, -14.0, 40.5), radius_mm=4.0))
    live.tick()
    assert (live.newest.act_count, live.session.position) == (2, 3)
    live.close()


def test_a_hand_comes_to_where_it_was_led_by_ticks_and_the_recording_repeats(case, tmp_path):
    live = live_on(case)
    live.record(tmp_path / "a.recording")
    live.do(CloseGrab(name="hand", center_mm=TOP, radius_mm=4.0), LeadGrab(name="hand", offset_mm=(0.0, 0.0, 6.0)))
    lifted = []
    for _ in range(200):
        live.tick()
        lifted.append(live.newest.held[0].offset_mm[2])
        if lifted[-1] >= 6.0:
            break
    assert lifted[-1] == pytest.approx(6.0, abs=1e-9)
    steps = live.newest.frame.step
    # 6 mm at 150 mm/s.
    assert steps * live.session.simulation.step_s >= 0.039
    assert live.newest.frame.instruments["hand"].force_n[2] < 0.0
    live.do(OpenGrab(name="hand"))
    live.tick()
    assert live.newest.held == ()
    assert live.newest.act_count == 2
    end = bytes_of(live.session.simulation)
    live.close()
    assert bytes_of(played_again(tmp_path / "a.recording", case).simulation) == end


def test_what_is_refused_is_told_once_and_the_rest_is_done(case):
    live = live_on(case)
    away = CloseGrab(name="hand", center_mm=(500.0, 0.0, 0.0))
    live.do(away, LeadGrab(name="hand", offset_mm=(1.0, 0.0, 0.0)), OpenGrab(name="hand"))
    live.do(BringProbe(name="tip", center_mm=(22.0, -14.0, 60.0), semi_axes_mm=(3.0, 3.0, 3.0)))
    live.tick()
    assert len(live.take_messages()) == 1
    assert live.take_messages() == []
    assert list(live.newest.frame.instruments) == ["tip"]
    assert live.newest.probes["tip"][:, :3] == pytest.approx(3.0 * np.eye(3))
    live.close()


def test_going_back_pauses_playing_comes_to_the_same_bytes_and_an_act_takes_over(case):
    live = live_on(case)
    live.do(CloseGrab(name="hand", center_mm=TOP, radius_mm=4.0), LeadGrab(name="hand", offset_mm=(0.0, 0.0, 3.0)))
    for _ in range(10):
        live.tick()
    end, step = bytes_of(live.session.simulation), live.newest.frame.step
    live.do(Undo())
    live.tick()
    assert (live.newest.mode, live.newest.held, live.newest.act_count) == ("paused", (), 0)
    assert live.newest.ahead_s > 0.0
    live.tick()
    assert live.newest.frame.step == 0
    live.do(Redo())
    live.tick()
    assert bytes_of(live.session.simulation) == end
    live.do(Rewind(seconds=0.5 * live.newest.frame.time_s))
    live.tick()
    assert 0 < live.newest.frame.step < step
    live.play()
    while live.newest.mode != "paused" or live.newest.ahead_s > 0.0:
        live.tick()
    assert bytes_of(live.session.simulation) == end
    live.do(Rewind(seconds=0.5 * live.newest.frame.time_s))
    live.play()
    live.tick()
    live.do(OpenGrab(name="hand"))
    live.tick()
    assert live.newest.mode == "running"
    assert live.newest.ahead_s == 0.0
    live.close()


@pytest.mark.parametrize("speed", [0.25, 0.5, 4.0])
def test_what_is_played_more_slowly_takes_its_time_and_comes_to_the_same_bytes(case, monkeypatch, speed):
    slept = []
    live = live_on(case)
    live.do(CloseGrab(name="hand", center_mm=TOP, radius_mm=4.0), LeadGrab(name="hand", offset_mm=(0.0, 0.0, 3.0)))
    for _ in range(10):
        live.tick()
    end, step = bytes_of(live.session.simulation), live.newest.frame.step
    live.do(Rewind(seconds=100.0))
    live.tick()
    assert live.newest.frame.step == 0
    # a machine that takes no time at all
    monkeypatch.setattr(live_module, "time", SimpleNamespace(perf_counter=lambda: 0.0, sleep=slept.append))
    live.play(speed)
    shown = [0]
    while live.newest.mode != "paused" or live.newest.ahead_s > 0.0:
        live.tick()
        shown.append(live.newest.frame.step)
    assert bytes_of(live.session.simulation) == end
    assert shown[-1] == step
    rows_s = np.diff(np.unique(shown)) * live.session.simulation.step_s
    wanted = rows_s / speed - live_module.FRAME_S
    assert slept == pytest.approx(wanted[wanted > 0.0])
    assert bool(slept) == (speed < 1.0)
    live.close()


@pytest.mark.parametrize("stored_s", [1.0, 1e9])
def test_pauses_are_passed_over_and_what_is_done_comes_to_the_same_bytes(case, tmp_path, monkeypatch, stored_s):
    simulation = live_on(case).session.simulation
    session, step_s = OperatingSession(simulation, snapshot_every_s=np.inf), simulation.step_s
    second = round(1.0 / step_s)
    with Recorder(session, tmp_path / "a.recording", case=case.manifest, state_every_s=stored_s):
        for name, idle_s in (("first", 5.0), ("second", 1.5), ("third", 4.0)):
            session.do(CloseGrab(name=name, center_mm=TOP, radius_mm=4.0))
            session.do(LeadGrab(name=name, offset_mm=(0.0, 0.0, 3.0)))
            # what is held is shown however long it is held
            session.advance(3 * second if name == "second" else second // 4)
            session.do(OpenGrab(name=name))
            for _ in range(round(idle_s * 20)):
                session.advance(second // 20)
    end, acts = bytes_of(simulation), [one.step for one in session.entries if isinstance(one.command, CloseGrab)]
    released = [one.step for one in session.entries if isinstance(one.command, OpenGrab)]
    again = load_session(open_recording(tmp_path / "a.recording"), case.model, surface=case.surface, tissue=case.tissue)
    live, slept = Live(again, manifest=case.manifest), []
    monkeypatch.setattr(
        live_module, "time", SimpleNamespace(perf_counter=lambda: 0.0, sleep=lambda s: slept.append(again.step_count))
    )
    live.play(0.5, skips=True)
    shown = []
    while live.newest.mode != "paused" or live.newest.ahead_s > 0.0:
        live.tick()
        shown.append(live.newest.frame.step)
    assert bytes_of(again.simulation) == end
    assert again.deviations == []
    slept, shown = np.array(slept), np.array(shown)
    for at, (start, stop) in enumerate(zip(released, [*acts[1:], session.end_step], strict=True)):
        inside = (slept > start + 0.6 * second) & (slept < stop - 0.6 * second)
        # a short one, and both ends of a long one, take their time
        assert inside.any() == (at == 1)
        assert ((slept > start) & (slept < start + 0.5 * second)).any()
        assert ((slept > stop - 0.45 * second) & (slept < stop)).any()
    # with states stored on the way nearly nothing of a pause is worked out
    middle = (shown > released[0] + 0.6 * second) & (shown < acts[1] - 1.8 * second)
    assert middle.any() == (stored_s > 10.0)
    live.close()


def test_the_thread_runs_cuts_records_and_leaves_nothing_behind(case, tmp_path):
    before = threads()
    live = live_on(case)
    live.record(tmp_path / "a.recording")
    live.start()
    until(lambda: live.newest.frame.step > 0)
    node_count = live.newest.frame.model.node_count
    poses = tuple(tuple((22.3, y, z) for y in (-18.0, -10.0)) for z in (45.0, 33.0))
    live.do(Cut(poses_mm=poses))
    until(lambda: live.newest.frame.model.node_count > node_count)
    newest = live.newest
    # What is published is of one moment.
    assert len(newest.frame.surface.vertices_mm) == newest.surface.vertex_count
    assert newest.triangle_origin.shape == (len(newest.surface.triangles),)
    assert (newest.triangle_origin < 0).any()
    live.do(BringProbe(name="tip", center_mm=(22.0, -14.0, 47.0), semi_axes_mm=(3.0, 3.0, 3.0)))
    live.do(MoveProbe(name="tip", center_mm=(22.0, -14.0, 42.0)))
    until(lambda: "tip" in live.newest.frame.instruments)
    until(lambda: np.linalg.norm(live.newest.frame.instruments["tip"].force_n) > 0.0)
    live.pause(True)
    until(lambda: live.newest.mode == "paused")
    step = live.newest.frame.step
    live.pause(False)
    until(lambda: live.newest.frame.step > step)
    live.close()
    live.close()
    assert live.error is None
    assert threads() == before
    end = bytes_of(live.session.simulation)
    assert bytes_of(played_again(tmp_path / "a.recording", case).simulation) == end


def test_what_ends_the_thread_is_kept_and_the_recording_is_finished(case, tmp_path):
    live = live_on(case)
    live.record(tmp_path / "a.recording")
    live.start()
    until(lambda: live.newest.recording is not None)

    def fail():
        raise ZeroDivisionError("a fault")

    live._ask([fail])
    until(lambda: live.error is not None)
    live.close()
    assert isinstance(live.error, ZeroDivisionError)
    assert open_recording(tmp_path / "a.recording").header.end is not None


def test_steps_of_a_frame_are_those_of_the_time_that_went_by_or_those_that_there_is_time_for(case):
    live = live_on(case)
    step_s, frame_s = live.session.simulation.step_s, live._frame_s

    def settled(fixed_s, per_step_s):
        """Simulated time over time that goes by, on a machine that needs so long for a frame and for a step."""
        simulated = wall = 0.0
        elapsed = frame_s
        for n in range(300):
            steps = live._steps_due(elapsed)
            took = fixed_s + steps * per_step_s
            live._learn(took)
            elapsed = max(took, frame_s)
            assert steps * step_s <= 2.6 * frame_s
            if n >= 100:
                simulated, wall = simulated + steps * step_s, wall + elapsed
        return simulated / wall, elapsed

    # As quick as it need be: real time, neither more nor less.
    assert settled(0.002, 0.1 * step_s)[0] == pytest.approx(1.0, rel=0.01)
    # What a frame takes besides steps is made up for by fewer frames.
    assert settled(0.5 * frame_s, 0.7 * step_s)[0] == pytest.approx(1.0, rel=0.02)
    # Too slow: half of real time, in frames of at most two and a half times the length.
    factor, elapsed = settled(0.002, 2.0 * step_s)
    assert factor == pytest.approx(0.5, rel=0.1)
    assert elapsed <= 1.2 * 2.5 * frame_s
    # Much too slow: time goes on all the same.
    assert settled(1.0, 50.0 * step_s)[0] > 0.15 * frame_s / (1.0 + 0.2 * 50.0 * frame_s)
    live.close()


def test_a_thread_that_was_never_started_is_closed(case):
    live = Live(live_on(case).session)
    live.close()
    live.close()


def test_a_cut_that_was_begun_is_made_before_the_end(case, tmp_path):
    live = live_on(case)
    live.record(tmp_path / "a.recording")
    live.do(Cut(poses_mm=tuple(tuple((22.3, y, z) for y in (-18.0, -10.0)) for z in (45.0, 33.0))))
    live._do_asked()
    assert live.session.frame().coming_cuts == 1
    live.close()
    again = played_again(tmp_path / "a.recording", case)
    assert [entry.command.kind for entry in again.entries] == ["cut"]
    assert again.simulation.model.node_count > case.model.node_count


def test_what_nobody_leads_any_more_stays_comes_back_slowly_and_lets_go(case):
    live = live_on(case)
    live.do(CloseGrab(name="hand", center_mm=TOP, radius_mm=4.0), LeadGrab(name="hand", offset_mm=(0.0, 0.0, 3.0)))
    live.do(BringProbe(name="tip", center_mm=(22.0, -14.0, 60.0), semi_axes_mm=(3.0, 3.0, 3.0)))
    live.do(MoveProbe(name="tip", center_mm=(22.0, -14.0, 55.0)))
    for _ in range(200):
        live.tick()
    assert live.newest.held[0].offset_mm[2] == pytest.approx(3.0, abs=1e-9)
    live.do(LeadGrab(name="hand", offset_mm=(0.0, 0.0, 100.0)))
    live.let_go_softly("hand")
    live.let_go_softly("tip")
    live.let_go_softly("nothing")
    heights, times = [3.0], [live.newest.frame.time_s]
    while live.newest.frame.instruments:
        live.tick()
        heights += [one.offset_mm[2] for one in live.newest.held]
        times.append(live.newest.frame.time_s)
        assert len(times) < 1000
    # never further, and at 30 mm/s where the mouse may lead at 150
    assert max(heights) == pytest.approx(3.0, abs=1e-9)
    assert heights[-1] == pytest.approx(0.0, abs=1e-9)
    assert times[-1] - times[0] >= 5.0 / 30.0
    assert [one.command.kind for one in live.session.entries].count("open_grab") == 1
    assert live.take_messages() == []
    live.close()


def test_a_frame_is_told_of_when_it_is_there(case):
    heard = []
    live = Live(live_on(case).session, heard=lambda: heard.append(live.newest.frame.step) if heard else heard.append(0))
    live.tick()
    live.tick()
    assert heard[-1] == live.newest.frame.step
    live.close()


def test_a_recording_that_cannot_be_written_is_told_and_the_session_goes_on(case, tmp_path):
    live = live_on(case)
    (tmp_path / "file").write_bytes(b"")
    live.record(tmp_path / "file" / "a.recording")
    live.start()
    heard = []
    until(lambda: heard.extend(live.take_messages()) or heard)
    assert (heard[0].place, heard[0].message[:17]) == ("recording", "cannot be written")
    live.record(tmp_path / "b.recording")
    until(lambda: live.newest.recording is not None)
    full = OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
    with mock.patch("heartcase.simulator.session.recorder.sealed", side_effect=full):
        live.do(CloseGrab(name="hand", center_mm=TOP, radius_mm=4.0))
        until(lambda: live.newest.recording is None)
    step = live.newest.frame.step
    until(lambda: live.newest.frame.step > step and live.newest.act_count == 1)
    assert "No space left" in " ".join(map(str, live.take_messages()))
    # all that was done is there, and is recorded where there is room
    live.record(tmp_path / "c.recording")
    until(lambda: live.newest.recording is not None)
    live.close()
    assert live.error is None
    assert "c.recording" in live.take_messages()[-1].message
    assert bytes_of(played_again(tmp_path / "c.recording", case).simulation) == bytes_of(live.session.simulation)


def test_an_end_that_fails_is_heard_of(case):
    heard = []
    live = Live(live_on(case).session, heard=lambda: heard.append(live.error))
    live.start()
    with mock.patch.object(live.session, "frame", side_effect=ZeroDivisionError("a fault")):
        live.close()
    assert isinstance(heard[-1], ZeroDivisionError)


def test_cuts_are_marked_on_the_time_line_also_those_ahead(case):
    live = live_on(case)
    live.do(CloseGrab(name="hand", center_mm=TOP, radius_mm=4.0))
    live.tick()
    assert live.newest.marks == ()
    step = live.newest.frame.step
    live.do(Cut(poses_mm=tuple(tuple((22.3, y, z) for y in (-18.0, -10.0)) for z in (45.0, 33.0))))
    live.make_cuts()
    live.tick()
    marks = live.newest.marks
    assert [kind for _, kind in marks] == ["cut"]
    assert marks[0][0] >= step
    live.tick()
    # the same while nothing is new
    assert live.newest.marks is marks
    live.do(Undo())
    live.tick()
    assert live.newest.marks == marks
    assert live.newest.ahead_s > 0.0
    # what comes instead drops it
    live.do(OpenGrab(name="hand"))
    live.tick()
    assert live.newest.marks == ()
    live.close()
