"""A scripted device in a live session: it closes, pulls, feels the tissue, lets go; and what it did is a recording."""

from __future__ import annotations

import numpy as np
import pytest

from heartcase.schemas.recording.commands import CloseGrab, LeadGrab, OpenGrab, Undo
from heartcase.schemas.recording.reader import open_recording
from heartcase.simulator.background.device_hand import DeviceHand
from heartcase.simulator.haptics.device import DeviceSpec
from heartcase.simulator.haptics.servo import HapticServo
from heartcase.simulator.session.replay import load_session
from tests.simulator.live.scenes import live_on, load, until, write_case

TOP = np.array([22.0, -14.0, 40.5])


@pytest.fixture(scope="module")
def case(tmp_path_factory):
    return load(write_case(tmp_path_factory.mktemp("block")))


def pulling(*, forever=False):
    """A hand that closes at once, goes up by 4 mm in half a second, stays, and lets go."""
    up = TOP + np.array([0.0, 0.0, 4.0])
    closed = [False, True, True, True, forever]
    return DeviceSpec(
        "trajectory", {"times_s": [0.0, 0.4, 0.9, 4.0, 5.0], "positions_mm": [TOP, TOP, up, up, up], "closed": closed}
    )


def is_held_by_the_spring(shown):
    stretch_mm = shown.position_mm[2] - (TOP[2] + 4.0)
    pull_n = shown.force_n[2]
    return pull_n == pytest.approx(0.4 * stretch_mm * shown.part, abs=0.2) and pull_n < -0.1


@pytest.mark.slow  # a loop at its own pace: on a busy machine it is done before the tissue follows
def test_it_pulls_feels_lets_go_and_stands_in_the_history(case, tmp_path):
    live = live_on(case)
    live.record(tmp_path / "felt.recording")
    live.start()
    servo = HapticServo([pulling()]).__enter__()
    hand = DeviceHand(live, servo)
    try:
        until(lambda: hand.shown is not None and hand.shown.holds == "device")
        until(lambda: live.newest.held and live.newest.held[0].offset_mm[2] > 3.9)
        # pulled up, the user is pulled down; and no more than the device may
        until(lambda: hand.shown.force_n[2] < -0.05)
        assert np.linalg.norm(hand.shown.force_n) <= servo.settings.force_limit_n + 1e-9
        # between the user's hand and the tool in the tissue is the coupling's spring, 0.4 N/mm
        until(lambda: is_held_by_the_spring(hand.shown))
        felt = np.linalg.norm(live.newest.frame.instruments["device"].force_n)
        assert felt > 0.05
        until(lambda: not live.newest.held)
        assert hand.shown.holds is None
    finally:
        hand.detach()
    assert hand.shown is None
    assert not servo._process.is_alive()
    live.stop_recording()
    live.settle(30.0)
    step = live.session.step_count
    live.close()
    assert live.error is None
    recording = open_recording(tmp_path / "felt.recording")
    kinds = [type(one.command) for one in recording.entries]
    assert kinds.count(CloseGrab) == kinds.count(OpenGrab) == 1
    assert kinds.count(LeadGrab) > 50
    # to the byte, without the device
    again = load_session(recording, case.model, surface=case.surface, tissue=case.tissue)
    for _ in again.play():
        pass
    assert again.deviations == []
    assert again.step_count <= step


@pytest.mark.slow  # a loop at its own pace: on a busy machine it is done before the tissue follows
def test_a_loop_that_was_lost_is_told_and_its_hand_lets_go_softly(case):
    live = live_on(case)
    live.start()
    servo = HapticServo([pulling(forever=True)]).__enter__()
    hand = DeviceHand(live, servo)
    until(lambda: live.newest.held and live.newest.held[0].offset_mm[2] > 3.9)
    servo._process.kill()
    offsets = []
    until(lambda: offsets.append([one.offset_mm[2] for one in live.newest.held]) or not live.newest.held)
    # brought back before it let go, and time went on without it
    assert offsets[-2][0] < 0.5
    assert hand.error is not None
    assert any("haptic loop has ended" in str(said) for said in live.take_messages())
    step = live.newest.frame.step
    until(lambda: live.newest.frame.step > step)
    assert not servo._told.closed
    hand.detach()
    assert servo._told.closed
    hand.detach()
    live.close()
    assert live.error is None


def test_who_takes_back_what_it_closed_leaves_it_empty_handed(case):
    live = live_on(case)
    live.start()
    hand = DeviceHand(live, HapticServo([pulling(forever=True)]).__enter__())
    until(lambda: bool(live.newest.held))
    live.do(Undo())
    until(lambda: not live.newest.held)
    live.pause(False)
    step = live.newest.frame.step
    until(lambda: live.newest.frame.step > step + 50 and hand.shown.holds is None)
    hand.detach()
    live.close()
    assert live.error is None
