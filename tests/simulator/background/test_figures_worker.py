"""Figures of an incision while it is held open: those of plans, on the same state; and of what a mouse cuts."""

from __future__ import annotations

from dataclasses import replace
from math import inf

import numpy as np
import pytest

from heartcase.pipeline.bundle.write_bundle import write_bundle
from heartcase.schemas.errors import SimulationError
from heartcase.schemas.recording.commands import (
    Advance,
    BringProbe,
    CloseGrab,
    Cut,
    Entry,
    LeadGrab,
    OpenGrab,
    Redo,
    Undo,
    WithdrawProbe,
)
from heartcase.schemas.recording.reader import open_recording
from heartcase.schemas.scripts.incision_plans import ShaftSettings
from heartcase.simulator.background.figures_worker import FiguresWorker, figures_of
from heartcase.simulator.background.recorded_figures import figures_of_recording, moments_of_incision
from heartcase.simulator.incisions.blade_line import line_of_blade
from heartcase.simulator.incisions.held_open import ShownHeart
from heartcase.simulator.live.live import Live
from heartcase.simulator.load import load_case
from heartcase.simulator.session.operating_session import OperatingSession
from heartcase.simulator.session.planned_incisions import on_case, parse_plans, run_plan
from heartcase.simulator.session.recorder import Recorder
from heartcase.simulator.session.replay import load_session
from heartcase.simulator.simulation import Simulation
from tests.hollow_case import hollow_case
from tests.simulator.live.scenes import threads, until

ROUGH = ShaftSettings(spacing_mm=8.0, depth_mm=20.0)
"""Fewer places of the instrument's tip."""
PLAN = (
    "heartcase_plans = 1\n[shaft]\nspacing_mm = 8.0\ndepth_mm = 20.0\n"
    '[[plans]]\nname = "lid"\ncuts = [{ landmark = "lid" }]\n'
    "retraction = { spread_mm = 6.0, lift_mm = 2.0, radius_mm = 4.5 }\n"
)


@pytest.fixture(scope="module")
def case(tmp_path_factory):
    path = tmp_path_factory.mktemp("hollow") / "hollow.case"
    write_bundle(path, hollow_case())
    return load_case(path, needs=("surface", "colours", "tissue"))


def simulation_of(case):
    return Simulation(case.model, surface=case.surface, tissue=case.tissue, damping_per_s=30.0)


def whole_of(live):
    return ShownHeart.of(live.newest.surface, live.newest.frame.surface)


@pytest.fixture(scope="module")
def planned(case, tmp_path_factory):
    """What a plan came to, and a live session that has played the plan's recording to its end."""
    session = OperatingSession(simulation_of(case), snapshot_every_s=inf)
    on = on_case(parse_plans(PLAN), case.manifest.landmarks)
    path = tmp_path_factory.mktemp("recorded") / "lid.recording"
    with Recorder(session, path, case=case.manifest):
        held = run_plan(on.runs[0], on, case, session)
    live = Live(load_session(open_recording(path), case.model, surface=case.surface, tissue=case.tissue))
    whole = whole_of(live)
    live.play()
    live.tick()
    while live.newest.mode == "playing":
        live.tick()
    assert live.session.deviations == []
    yield held, live, whole, path
    live.close()


def test_they_are_the_figures_of_the_plan_on_the_same_state(case, planned):
    held, live, whole, _ = planned
    found = figures_of(live.newest, whole, case.manifest.landmarks, shaft=ROUGH)
    assert found.defects == held.figures
    assert found.hand_force_n == held.hand_force_n
    assert (found.name, found.step) == ("lid", live.session.step_count)
    assert found.inverted_cell_count == held.inverted_cell_count
    assert found.rim_found == held.rim_found
    # nothing of it is left out
    assert found.defects["hole"].rim_seen_cut == 0.0
    assert found.defects["hole"].reach_mm3 > 0.0


def test_so_are_those_of_the_recording_at_its_last_held_moment(case, planned, tmp_path):
    held, _, _, path = planned
    found = figures_of_recording(case, open_recording(path), shaft=ROUGH)
    assert found.defects == held.figures
    # what came after the hands let go does not count
    session = load_session(open_recording(path), case.model, surface=case.surface, tissue=case.tissue)
    session.go_to(session.end_step)
    with Recorder(session, tmp_path / "on.recording", case=case.manifest):
        for name in held.hand_force_n:
            session.do(OpenGrab(name=name))
        session.advance(40)
    assert figures_of_recording(case, open_recording(tmp_path / "on.recording"), shaft=ROUGH) == found


def test_moments_of_an_incision():
    def entries(*commands):
        return [Entry(step=0, command=one) for one in commands]

    cut = Cut(poses_mm=(((0, 0, 0), (0, 0, 1)), ((1, 0, 0), (1, 0, 1))))
    hand = CloseGrab(name="hand", center_mm=(0, 0, 0))
    probe = BringProbe(name="tip", center_mm=(0, 0, 0), semi_axes_mm=(1, 1, 1))
    go, let_go, away = Advance(steps=5), OpenGrab(name="hand"), WithdrawProbe(name="tip")
    assert moments_of_incision(entries(cut, go)) == (2, 2)
    assert moments_of_incision(entries(cut, go, hand, go)) == (4, 2)
    assert moments_of_incision(entries(cut, go, hand, go, let_go, go)) == (4, 2)
    assert moments_of_incision(entries(hand, cut, go)) == (3, None)
    # a probe hides, but holds nothing open
    assert moments_of_incision(entries(probe, cut, go, away, go, probe, go)) == (7, 5)
    with pytest.raises(SimulationError, match="nothing is cut"):
        moments_of_incision(entries(hand, go))


def test_the_process_beside_the_steps_gives_the_same(case, planned):
    _, live, whole, _ = planned
    before, heard = threads(), []
    worker = FiguresWorker(whole, case.manifest.landmarks, heard=lambda: heard.append(1), shaft=ROUGH)
    exact = figures_of(live.newest, whole, case.manifest.landmarks, shaft=ROUGH)
    # all but the reach, which takes long: it is asked for, and waits until time stands
    worker.ask_for_reach()
    worker.ask(replace(live.newest, mode="running"))
    until(lambda: worker.newest is not None)
    assert not worker.newest.has_reach
    expected = {name: replace(one, reach_mm3=None) for name, one in exact.defects.items()}
    assert worker.newest.defects == expected
    worker.ask(live.newest)
    until(lambda: worker.newest.has_reach)
    assert worker.newest == exact
    # the same moment again is no news
    count = len(heard)
    worker.ask(live.newest)
    worker.ask(replace(live.newest, cuts=()))
    until(lambda: worker.newest is None)
    assert len(heard) == count + 1
    worker.close()
    assert not worker._process.is_alive()
    assert threads() == before


def test_a_process_that_was_killed_is_told(case, planned):
    _, live, whole, _ = planned
    worker = FiguresWorker(whole, case.manifest.landmarks)
    worker._process.kill()
    worker.ask(live.newest)
    until(lambda: worker.error is not None)
    assert "has ended" in str(worker.error)
    worker.close()


@pytest.fixture(scope="module")
def by_mouse(case):
    """The lid cut as a mouse cuts: a blade that lies along its line, led into the tissue; and one lip pulled."""
    live = Live(OperatingSession(simulation_of(case)))
    whole = whole_of(live)
    line = np.array(next(one for one in case.manifest.landmarks if one.name == "lid").points_mm)
    up = np.array([0.0, 0.0, 1.0])
    poses = np.stack([line + 2.0 * up, line - 6.0 * up])
    live.session.do(Cut(name="blade", poses_mm=tuple(tuple(map(tuple, pose)) for pose in poses.tolist())))
    live.session.advance(50)
    live.tick()
    cut = live.newest
    live.session.do(CloseGrab(name="hand", center_mm=tuple(line[2] + [0.0, 4.5, -1.0]), radius_mm=4.5))
    live.session.do(LeadGrab(name="hand", offset_mm=(0.0, 4.0, 2.0)))
    live.session.advance(200)
    live.tick()
    yield live, whole, line, poses, cut
    live.close()


def test_a_blade_of_the_mouse_has_the_line_that_was_drawn(case, by_mouse):
    live, whole, line, poses, _ = by_mouse
    found = line_of_blade(poses, whole)
    # the lid is flat: the line lies in it, and the blade looks out of it
    np.testing.assert_allclose(found.points_mm, line, atol=1e-3)
    np.testing.assert_allclose(found.outward, np.tile([0.0, 0.0, 1.0], (len(line), 1)), atol=1e-12)
    np.testing.assert_allclose(np.abs(found.across[:, 1]), 1.0, atol=1e-12)
    # stabs beside the tissue are no part of it, and a blade that meets none has no line
    wide = np.concatenate([poses[:, :1] - [400.0, 0.0, 0.0], poses], axis=1)
    np.testing.assert_allclose(line_of_blade(wide, whole).points_mm, line, atol=1e-3)
    assert line_of_blade(poses + np.array([900.0, 0.0, 0.0]), whole) is None
    figures = figures_of(live.newest, whole, case.manifest.landmarks, reaches=False).defects["hole"]
    assert figures.length_mm == pytest.approx(np.linalg.norm(np.diff(line, axis=0), axis=1).sum(), abs=1e-3)


def test_what_holds_is_told_apart_from_what_does_not(case, by_mouse):
    live, whole, _, _, cut = by_mouse
    closed = figures_of(cut, whole, case.manifest.landmarks, reaches=False)
    held = figures_of(live.newest, whole, case.manifest.landmarks, reaches=False)
    assert closed.hand_force_n == {}
    assert closed.defects["hole"].retraction_n is None
    assert closed.defects["hole"].gap_mm < 0.5 < 2.0 < held.defects["hole"].gap_mm
    assert held.defects["hole"].retraction_n == held.hand_force_n["hand"] > 0.0
    assert held.defects["hole"].rim_seen_cut == closed.defects["hole"].rim_seen


def test_the_unheld_moment_follows_undo(case, by_mouse):
    live, *_ = by_mouse
    assert live.newest.unheld is not None
    assert len(live.newest.cuts) == 1
    live.do(OpenGrab(name="hand"), Undo(), Undo())
    live.tick()
    assert live.newest.unheld is not None
    live.do(Undo())
    live.tick()
    assert live.newest.cuts == ()
    assert live.newest.unheld is None


def test_a_case_without_a_defect_has_figures_of_the_incision_alone(case, by_mouse):
    live, whole, _, _, _ = by_mouse
    live.do(Redo())
    live.tick()
    vessel = tuple(one for one in case.manifest.landmarks if one.kind != "ring")
    found = figures_of(live.newest, whole, vessel, reaches=False).defects
    assert list(found) == [""]
    assert found[""].rim_seen is found[""].freedom_mm3 is found[""].solid_angle_sr is None
    assert found[""].length_mm > 0.0
    assert set(found[""].nearest_mm) == {"vessel"}
