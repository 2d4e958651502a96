"""``heartcase view``: what it refuses, what it leaves, and that its page says what its keys do."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from heartcase.cli.main import main
from heartcase.schemas.recording.reader import open_recording
from heartcase.window.keys import KEYS, MOUSE
from tests.simulator.live.scenes import threads, until, write_case
from tests.window.scenes import SIZE

pytest.importorskip("pyvista")

PAGE = Path(__file__).parents[2] / "docs" / "window.md"


@pytest.fixture(scope="module")
def case(tmp_path_factory):
    return write_case(tmp_path_factory.mktemp("view"))


@pytest.fixture
def off_screen(monkeypatch):
    """The window without a screen; what is put into ``runs`` is done in place of waiting for the user."""
    from heartcase.window import window

    monkeypatch.setenv("VTK_DEFAULT_OPENGL_WINDOW", "vtkEGLRenderWindow")
    monkeypatch.setattr(window, "require_display", lambda: None)
    runs = []

    class OffScreen(window.HeartWindow):
        def __init__(self, case, live, *, size):
            super().__init__(case, live, size=SIZE, off_screen=True)

        def draw(self):
            super().draw()
            runs.pop(0)(self) if runs else self.act("leave:")

    monkeypatch.setattr(window, "HeartWindow", OffScreen)
    return runs


def test_without_a_screen_one_line_says_so(case, monkeypatch, capsys):
    for name in ("DISPLAY", "WAYLAND_DISPLAY"):
        monkeypatch.delenv(name, raising=False)
    monkeypatch.setattr("sys.platform", "linux")
    assert main(["view", str(case)]) == 2
    said = capsys.readouterr().err
    assert said.startswith("heartcase: there is no screen here")
    assert said.count("\n") == 1
    assert said.strip() in PAGE.read_text()


def test_it_records_from_the_start_and_plays_what_was_recorded(case, off_screen, tmp_path, capsys):
    before = threads()
    path = tmp_path / "a.recording"
    off_screen.append(lambda window: until(lambda: window.live.newest.frame.step > 20))
    assert main(["view", str(case), "--record", str(path)]) == 0
    said = capsys.readouterr().out
    assert "recorded in a.recording" in said
    assert "Not a medical device" in said
    recording = open_recording(path)
    assert recording.header.damping_per_s == 30.0
    steps = recording.entries[-1].end_step
    assert steps > 20

    seen = []

    def wait(window):
        until(lambda: window.live.newest.mode == "paused")
        seen.append(window.live.newest.frame.step)

    off_screen.append(wait)
    assert main(["view", str(case), "--recording", str(path)]) == 0
    assert seen == [steps]
    assert main(["view", str(case), "--record", str(path)]) == 1
    assert main(["view", str(case), "--recording", str(path), "--record", str(tmp_path / "b.recording")]) == 2
    assert threads() == before


def test_ctrl_c_leaves_a_whole_recording_and_no_thread(case, off_screen, tmp_path, capsys):
    before = threads()

    def interrupt(window):
        until(lambda: window.live.newest.frame.step > 20)
        raise KeyboardInterrupt

    off_screen.append(interrupt)
    assert main(["view", str(case), "--record", str(tmp_path / "a.recording")]) == 130
    assert "interrupted" in capsys.readouterr().err
    assert open_recording(tmp_path / "a.recording").header.end is not None
    assert [path.name for path in tmp_path.iterdir()] == ["a.recording"]
    assert threads() == before


def test_the_page_lists_all_keys_and_what_the_mouse_does():
    rows = re.findall(r"^\| (.+?) \| (.+) \|$", PAGE.read_text(), re.M)
    for key in KEYS:
        assert (key.shown, key.words) in rows
    for row in MOUSE:
        assert row in rows
