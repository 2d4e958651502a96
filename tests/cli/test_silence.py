"""Commands that take more than a second say at once what they do, in a terminal."""

import io
import time
from types import SimpleNamespace

import pytest
from rich.console import Console

from heartcase.cli.main import main
from heartcase.cli.sessions import compare_incisions, record, replay, simulate
from heartcase.cli.shared import output, sessions


@pytest.fixture
def terminal(monkeypatch):
    written = io.StringIO()
    console = Console(file=written, force_terminal=True, width=100)
    monkeypatch.setattr(output, "error_console", lambda: console)
    monkeypatch.setattr(sessions, "Console", lambda **_: console)
    return written


def is_seen(words, written):
    end = time.monotonic() + 5.0
    while words not in written.getvalue():
        if time.monotonic() > end:
            return False
        time.sleep(0.02)
    return True


@pytest.mark.parametrize(
    ("module", "arguments"),
    [
        (simulate, ["simulate", "a.case"]),
        (record, ["record", "a.case", "-o", "out.recording"]),
        (replay, ["replay", "a.recording", "--case", "a.case"]),
        (compare_incisions, ["compare-incisions", "plans.toml", "a.case"]),
    ],
)
def test_reading_a_case_is_said(monkeypatch, tmp_path, terminal, module, arguments):
    found = []

    def read(*_, **__):
        found.append(is_seen("reading the case", terminal))
        raise KeyboardInterrupt

    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(module, "load_case", read)
    if module is replay:
        monkeypatch.setattr(
            module, "open_recording", lambda *_, **__: SimpleNamespace(header=SimpleNamespace(tissue_sha256=None))
        )
    assert main(arguments) == 130
    assert found == [True]


def test_a_session_is_said_before_its_first_step(terminal):
    with sessions.session_bar("simulating", 2.0) as tell:
        assert is_seen("simulating", terminal)
        assert is_seen("0.00 of 2.00 s", terminal)
        tell(1.5)
        assert is_seen("1.50 of 2.00 s", terminal)
