"""A haptic device at the server, started and stopped from a page."""

from __future__ import annotations

import time

import numpy as np

from heartcase.simulator.haptics.device import open_device
from heartcase.studio.operating.devices import MADE_UP, device_of, known_devices
from tests.simulator.live.scenes import until
from tests.studio.operating.performing import UP, operator

LOOK = {"start_mm": [22.0, -14.0, 140.5], "direction": [0, 0, -1]} | UP


def test_a_page_starts_a_device_that_pulls_and_it_goes_with_the_page(operated):
    browser, opened = operated
    theatre = opened.places["operating"]
    with operator(browser, opened) as page:
        page.until(lambda frame: frame["step"] > 0)
        assert page.opened["devices"] == [MADE_UP]
        assert page.frames[-1]["device"] is None
        aside = LOOK | {"start_mm": [400.0, -14.0, 140.5]}
        for wrong in ({"name": "stylus", "pointer": LOOK}, {"name": MADE_UP, "pointer": aside}, {"name": MADE_UP}):
            assert page.ask("device", **wrong)["kind"] == "refused", wrong
        page.done("device", name=MADE_UP, pointer=LOOK)
        assert page.ask("device", name=MADE_UP, pointer=LOOK)["kind"] == "refused"
        frame = page.until(lambda frame: frame["device"] and frame["device"]["holds"])
        np.testing.assert_allclose(frame["device"]["position_mm"], [22.0, -14.0, 40.5], atol=2.0)
        # it pulls by some millimetres, and the user's hand is pulled back
        page.until(lambda frame: frame["device"] and frame["device"]["position_mm"][1] < -17.0)
        page.until(lambda frame: frame["device"] and frame["device"]["force_n"][1] > 0.02)
        assert [one["name"] for one in page.frames[-1]["instruments"]] == ["device"]
        # stopped, it lets go
        page.done("device", name=None)
        page.until(lambda frame: frame["device"] is None and not frame["instruments"])
        page.done("device", name=MADE_UP, pointer=LOOK)
        page.until(lambda frame: frame["device"] and frame["device"]["holds"])
        process = theatre._stage.device._servo._process
        assert process.is_alive()
    # a page that is gone takes its device along, and what it held lets go
    until(lambda: not process.is_alive() and theatre._stage.device is None)
    until(lambda: not theatre._stage.live.newest.frame.instruments)
    with operator(browser, opened) as page:
        page.done("begin")
        page.until(lambda frame: frame["act_count"] == 0)


def test_a_heart_that_stands_still_after_a_device_was_lost_costs_next_to_nothing(operated):
    browser, opened = operated
    with operator(browser, opened) as page:
        page.until(lambda frame: frame["step"] > 0)
        page.done("device", name=MADE_UP, pointer=LOOK)
        page.until(lambda frame: frame["device"] is not None)
        hand = opened.places["operating"]._stage.device
        hand._servo._process.kill()
        page.until(lambda frame: frame["device"] is None and not frame["instruments"])
        assert opened.places["operating"]._stage.device is hand
        still_s = page.frames[-1]["time_s"] + 1.5
        page.until(lambda frame: frame["time_s"] > still_s)
        first, began = len(page.frames), time.monotonic()
        page.until(lambda frame: frame["time_s"] > page.frames[first - 1]["time_s"] + 0.5)
        assert len(page.frames) - first <= 11.0 * (time.monotonic() - began) + 2
        page.done("device", name=None)
        assert hand._servo._told.closed
        page.done("begin")
        page.until(lambda frame: frame["act_count"] == 0)


def test_the_made_up_device_goes_round_and_others_are_told_where_the_middle_is(monkeypatch):
    device = open_device(device_of(MADE_UP, np.array([1.0, 2.0, 3.0])))
    readings = [device.read(time) for time in (0.0, 1.0, 2.9, 8.0, 9.0)]
    assert [one.buttons for one in readings] == [(False,), (True,), (True,), (False,), (True,)]
    np.testing.assert_allclose(readings[3].pose.position_mm, [1.0, 2.0, 3.0])
    assert readings[2].pose.position_mm[1] < -5.5
    monkeypatch.setattr("heartcase.studio.operating.devices.device_names", lambda: ("mouse", "stylus", "trajectory"))
    assert known_devices() == ("stylus", MADE_UP)
    spec = device_of("stylus", np.array([1.0, 2.0, 3.0]))
    assert (spec.name, spec.options) == ("stylus", {"centre_mm": (1.0, 2.0, 3.0)})
