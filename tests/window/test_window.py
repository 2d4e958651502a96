"""A window without a screen, driven by mouse and keys through a whole story, and what it shows."""

from __future__ import annotations

import threading
import time

import numpy as np
import pytest

from heartcase.pipeline.data import Scan
from heartcase.pipeline.image.scan_part import scan_part
from heartcase.schemas.recording.reader import open_recording
from heartcase.simulator.session.replay import load_session
from heartcase.window.keys import KEYS, MOUSE, help_text
from tests.factories import block_grid
from tests.simulator.live.scenes import bytes_of, live_on, load, threads, until, write_case
from tests.window.scenes import Mouse, off_screen_window

pytest.importorskip("pyvista")

# The block reaches from 8.5 to 32.5, -21.5 to -6.5 and 28.5 to 40.5 mm; its upper side is seen.
HIGH = 40.5


@pytest.fixture
def case(window_case):
    return load(window_case)


def on_top(x, y):
    return (x, y, HIGH)


def test_a_story_by_mouse_and_keys_is_recorded_and_repeats_to_the_byte(case, tmp_path):
    before = threads()
    live = live_on(case)
    with off_screen_window(case, live, record_folder=tmp_path) as window:
        mouse = Mouse(window)
        window.draw()
        live.start()
        mouse.key("w")
        until(lambda: live.newest.recording == "block-1.recording")
        kinds = lambda: {one.kind for one in live.newest.frame.instruments.values()}  # noqa: E731

        # Grab, lift by the wheel, let go.
        mouse.key("g")
        mouse.press(on_top(14.0, -14.0))
        until(lambda: kinds() == {"grab"})
        mouse.move(on_top(16.0, -14.0))
        mouse.wheel(-3)
        until(lambda: live.newest.held and live.newest.held[0].offset_mm[2] > 2.9)
        window.draw()
        assert live.newest.held[0].offset_mm[0] == pytest.approx(2.0, abs=0.2)
        mouse.release(on_top(16.0, -14.0))
        until(lambda: not live.newest.frame.instruments)

        # Cut across the upper side.
        mouse.key("c")
        node_count = live.newest.frame.model.node_count
        line = [on_top(20.3, y) for y in np.linspace(-19.0, -9.0, 8)]
        mouse.drag(*line)
        until(lambda: live.newest.frame.model.node_count > node_count)
        window.draw()

        # Hold both lips: forceps at one, a retractor along the other.
        mouse.key("f")
        mouse.drag(on_top(18.0, -14.0), on_top(17.0, -14.0))
        until(lambda: kinds() == {"forceps"})
        mouse.key("r")
        mouse.drag(*[on_top(21.0, y) for y in np.linspace(-18.0, -10.0, 8)])
        assert window.tool.is_waiting
        mouse.drag(on_top(22.0, -14.0), on_top(24.0, -14.0), on_top(26.0, -14.0))
        until(lambda: kinds() == {"forceps", "retractor"})
        window.draw()

        # A stitch, tied.
        mouse.key("s")
        mouse.drag(on_top(12.0, -18.0))
        mouse.drag(on_top(15.0, -18.0))
        until(lambda: len(live.newest.frame.stitches) == 1)
        mouse.key("t")
        until(lambda: all(stitch.is_tied for stitch in live.newest.frame.stitches.values()))

        # A row of stitches and a patch, which is taken out by pointing at it.
        mouse.key("n")
        for place in (on_top(11.0, -12.0), on_top(14.0, -12.0), on_top(11.0, -9.0), on_top(14.0, -9.0)):
            mouse.drag(place)
        until(lambda: len(live.newest.frame.stitches) >= 3)
        mouse.key("e")
        turns = np.linspace(0.0, 2.0 * np.pi, 16)
        mouse.drag(*[on_top(27.5 + 3.0 * np.cos(turn), -15.0 + 3.0 * np.sin(turn)) for turn in turns])
        until(lambda: len(live.newest.frame.patches) == 1)
        window.draw()
        mouse.move(next(iter(live.newest.frame.patches.values())).vertices_mm.mean(axis=0))
        mouse.key("x")
        until(lambda: not live.newest.frame.patches)
        window.draw()
        mouse.key("u")
        until(lambda: live.newest.mode == "paused" and len(live.newest.frame.patches) == 1)
        mouse.key("u")
        until(lambda: not live.newest.frame.patches)
        mouse.key("space")

        until(lambda: live.newest.mode == "running")

        # Its handle is seen, though it lies in the tissue.
        handle = next(one for one in live.newest.frame.instruments.values() if one.kind == "forceps").center_mm
        seen = window.picture()
        x, y = mouse.pixel(handle)
        assert np.ptp(seen[seen.shape[0] - 1 - y, x].astype(int)) < 25  # silver, and not the colour of muscle

        # The retractor is let go, by pointing at it.
        retractor = next(one for one in live.newest.frame.instruments.values() if one.kind == "retractor")
        mouse.move(retractor.center_mm)
        mouse.key("x")
        until(lambda: kinds() == {"forceps"})

        # Undo brings the retractor back, redo lets it go again.
        mouse.key("u")
        until(lambda: live.newest.mode == "paused" and kinds() == {"forceps", "retractor"})
        window.draw()
        mouse.key("y")
        until(lambda: kinds() == {"forceps"} and live.newest.ahead_s == 0.0)
        mouse.key("p")
        mouse.press(on_top(29.0, -10.0))
        until(lambda: "probe" in kinds())
        window.draw()
        mouse.wheel(2)
        until(lambda: live.newest.mode == "running")
        mouse.release(on_top(29.0, -10.0))
        until(lambda: "probe" not in kinds())
        mouse.key("m")
        mouse.key("space")
        until(lambda: live.newest.mode == "paused")
        mouse.key("w")
        until(lambda: live.newest.recording is None)
        end = bytes_of(live.session.simulation)

        # Back to the start of it all, and played again in the window.
        mouse.key("b")
        until(lambda: live.newest.ahead_s > 0.0)
        mouse.key("Return")
        until(lambda: live.newest.mode == "paused" and live.newest.ahead_s == 0.0)
        window.draw()
        assert bytes_of(live.session.simulation) == end
        said = window._message
        mouse.key("q")
        assert not window.is_open
    assert said == "recorded in block-1.recording"
    assert live.error is None
    assert threads() == before

    again = load_session(
        open_recording(tmp_path / "block-1.recording"), case.model, surface=case.surface, tissue=case.tissue
    )
    for _ in again.play():
        pass
    assert again.deviations == []
    assert bytes_of(again.simulation) == end
    done = [entry.command.kind for entry in again.entries]
    for kind in ("close_grab", "cut", "close_forceps", "close_retractor", "place_stitch", "tie_stitch", "bring_probe"):
        assert kind in done, kind


def test_what_is_seen_tissue_cut_faces_hidden_structures_and_strain(case):
    live = live_on(case)
    with off_screen_window(case, live) as window:
        mouse = Mouse(window)
        whole = window.picture()
        assert whole.shape == (360, 480, 3)
        x, y = mouse.pixel(on_top(20.0, -14.0))

        def at(picture):
            return picture[picture.shape[0] - 1 - y, x].astype(int)

        assert np.abs(at(whole) - 255).sum() > 100
        # A click on its name hides the only structure there is.
        structure = window.scene.structures.all[0]
        place = (int(0.8 * 480), int(360 * (0.97 - 0.5 * 0.032)))
        mouse.press(place)
        assert structure.number in window.scene.structures.hidden
        assert (at(window.picture()) == 255).all()
        assert window.pointer(x, y).hit is None
        mouse.key("a")
        assert at(window.picture()) == pytest.approx(at(whole), abs=2)
        assert window.pointer(x, y).hit.point_mm == pytest.approx(on_top(20.0, -14.0), abs=0.3)

        mouse.key("c")
        mouse.drag(*[on_top(20.3, y) for y in np.linspace(-19.0, -9.0, 8)])
        live.tick()
        assert window.picture().shape == whole.shape
        mouse.key("j")
        mouse.drag(*[on_top(x, -14.0) for x in np.linspace(24.0, 32.0, 8)])
        live.tick()
        made = [
            entry.command
            for entry in live.session.entries
            if "scissors" in entry.command.kind or entry.command.kind == "snip"
        ]
        assert [one.kind for one in made][:2] == ["bring_scissors", "snip"]
        assert made[-1].kind == "withdraw_scissors"
        assert made[0].closing == pytest.approx((0.0, 0.0, 1.0), abs=0.05)
        assert len(live.session.simulation.cuts.sheets) == 1 + sum(one.kind == "snip" for one in made)
        assert window.picture().shape == whole.shape
        mouse.key("o")
        assert window.tool is None

        mouse.key("v")
        until(lambda: window._strain.newest is not None and window._strain.newest[0] is live.newest.frame.model)
        strained = window.picture()
        # At rest all is as dark blue as the first colour; structures are not.
        red, _, blue = at(strained)
        assert blue > 1.5 * red
        mouse.key("v")
        mouse.key("h")
        assert (window.picture() != whole).any()


def test_the_mouse_orbits_without_a_tool_beside_the_heart_and_by_the_right_button(case):
    live = live_on(case)
    with off_screen_window(case, live) as window:
        mouse = Mouse(window)
        window.draw()

        def turned(does):
            before = np.array(window.plotter.camera.position)
            does()
            return float(np.linalg.norm(np.array(window.plotter.camera.position) - before))

        entries = len(live.session.entries)
        assert turned(lambda: mouse.drag((240, 180), (280, 190))) > 1.0
        mouse.key("g")
        assert turned(lambda: mouse.drag((5, 5), (40, 15))) > 1.0
        mouse.send("RightButtonPressEvent", (240, 180))
        assert turned(lambda: mouse.move((280, 200))) > 1.0
        mouse.send("RightButtonReleaseEvent", (280, 200))
        assert turned(lambda: mouse.move((240, 180))) == 0.0
        assert turned(lambda: mouse.wheel(2)) > 1.0
        assert len(live.session.entries) == entries
        mouse.key("Home")
        assert window.plotter.camera.up == pytest.approx((0.0, 0.0, 1.0))


def test_a_slice_of_the_scan_lies_where_the_scan_says(tmp_path):
    grid = block_grid((8, 5, 4)).geometry
    values = np.random.default_rng(1).integers(0, 2, grid.shape).astype(np.float32) * 1000
    path = write_case(tmp_path, scan=scan_part(Scan(values, grid)))
    case = load(path, "scan")
    live = live_on(case)
    with off_screen_window(case, live) as window:
        mouse = Mouse(window)
        window.draw()
        index = 2
        window.scene.show_slice(index)
        window.scene.structures.hidden.update(one.number for one in window.scene.structures.all)
        window.scene.hidden_changed()
        picture = window.picture()
        geometry = case.scan.geometry
        checked = 0
        for j in range(geometry.size[1]):
            for i in range(geometry.size[0]):
                x, y = mouse.pixel(geometry.index_to_world([[float(i), float(j), float(index)]])[0])
                if 0 <= x < 360 and 60 <= y < 290:
                    grey = picture[picture.shape[0] - 1 - y, x]
                    assert (grey > 127).all() == (case.scan.slice_at(index)[j, i] > 500), (i, j)
                    checked += 1
        assert checked > 20
        mouse.key("bracketright")
        assert window.scene.slice_index == index + 1
        mouse.key("i")
        assert window.scene.slice_index is None


def test_a_case_without_a_scan_says_so(case):
    live = live_on(case)
    with off_screen_window(case, live) as window:
        Mouse(window).key("i")
        assert "holds no scan" in window._message


def test_the_list_of_keys_is_whole_and_each_does_something(case):
    names = [name for key in KEYS for name in key.keys]
    assert len(names) == len(set(names))
    live = live_on(case)
    with off_screen_window(case, live) as window:
        for key in KEYS:
            assert hasattr(window, f"_{key.action.partition(':')[0]}"), key
            assert key.words in help_text()
    assert all(where in help_text() for where, _ in MOUSE)


def test_closing_twice_and_closing_while_it_runs(case):
    live = live_on(case)
    with off_screen_window(case, live) as window:
        live.start()
        time.sleep(0.05)
        window.close()
        window.close()
    assert live._thread is None


def test_steps_go_on_while_a_picture_is_drawn_and_the_view_turns_while_steps_are_taken(case, monkeypatch):
    live = live_on(case)
    with off_screen_window(case, live) as window:
        window.draw()
        draw = window.scene.draw

        def slow_draw(*given, **named):
            """A picture that is not ready before many frames of steps were taken."""
            step = live.newest.frame.step
            until(lambda: live.newest.frame.step > step + 200)
            draw(*given, **named)

        monkeypatch.setattr(window.scene, "draw", slow_draw)
        live.start()
        until(lambda: live.newest.frame.step > 0)
        window.draw()
        # The other way round: a frame of steps that does not end before the view has turned.
        has_turned, is_held = threading.Event(), threading.Event()

        def wait():
            is_held.set()
            assert has_turned.wait(60.0)

        monkeypatch.setattr(window.scene, "draw", draw)
        live._ask([wait])
        assert is_held.wait(60.0)
        before = np.array(window.plotter.camera.position)
        Mouse(window).drag((240, 180), (280, 190))
        window.draw()
        assert np.linalg.norm(np.array(window.plotter.camera.position) - before) > 1.0
        has_turned.set()
    assert live.error is None
