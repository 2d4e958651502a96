"""``heartcase studio`` as a process of its own."""

import asyncio
import re
import shutil
import signal
import socket
import subprocess
import sys
import urllib.error
import urllib.request
from pathlib import Path

import pytest

from heartcase.cli.main import main
from heartcase.pipeline.building.session_file import open_session
from heartcase.studio.serving.serve import listening
from heartcase.studio.starting.registry import Left, Registry
from tests.cli.small_case import write_case, write_scan
from tests.studio.talking import write_recipe


@pytest.mark.parametrize("ending", [signal.SIGINT, signal.SIGTERM, signal.SIGKILL])
def test_it_serves_this_machine_until_it_is_ended(tmp_path, ending, monkeypatch):
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path / "state"))
    recipe, _ = write_recipe(tmp_path)
    text = recipe.read_text()
    command = [sys.executable, "-m", "heartcase", "studio", str(recipe), "--out", str(tmp_path / "out"), "--no-browser"]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as process:
        address = re.search(r"http://127\.0\.0\.1:\d+/prepare/\S+\?token=\S+", process.stdout.readline())[0]
        with pytest.raises(urllib.error.HTTPError, match="403"):
            urllib.request.urlopen(address.partition("?")[0], timeout=30)
        opener = urllib.request.build_opener(urllib.request.HTTPCookieProcessor())
        assert b"heartcase studio" in opener.open(address, timeout=30).read()
        process.send_signal(ending)
        out, err = process.communicate(timeout=60)
    if ending is signal.SIGINT:
        assert process.returncode == 0
        assert "the recipe holds every stroke" in out
    assert err == ""
    assert recipe.read_text() == text
    assert not list(tmp_path.glob(".heartcase-tmp-*"))


def test_for_a_scan_a_recipe_is_written_that_marks_nothing(tmp_path, monkeypatch, capsys):
    served = []
    serve = lambda recipe, out, **_: served.append((recipe, out)) or Left()  # noqa: E731
    monkeypatch.setattr("heartcase.studio.serving.serve.serve", serve)
    scan, recipe = write_scan(tmp_path / "scan.nii.gz"), tmp_path / "mine.toml"
    assert main(["studio", str(scan), "--recipe", str(recipe), "--no-browser"]) == 0
    # beside it, though another of its name may have been built elsewhere
    assert served == [(recipe, tmp_path)]
    session = open_session(recipe, out=tmp_path / "out", resumes=True).session
    assert (session.labels == 255).all()
    assert session.strokes == ()
    # what is there is never replaced
    assert main(["studio", str(scan), "--recipe", str(recipe), "--no-browser"]) == 2
    assert "there is already a recipe" in capsys.readouterr().err


def test_what_is_given_says_what_opens_first(tmp_path, monkeypatch):
    served = []
    monkeypatch.setattr("heartcase.studio.serving.serve.serve", lambda **given: served.append(given) or Left())
    recipe, _ = write_recipe(tmp_path)
    case, _ = write_case(tmp_path)
    for path, first in (
        (recipe, {"recipe": recipe}),
        (case, {"case": case}),
        (tmp_path, {"folder": tmp_path}),
        (None, {}),
    ):
        assert main(["studio", *([str(path)] if path else []), "--no-browser"]) == 0
        assert {key: value for key, value in served[-1].items() if isinstance(value, Path) and key != "out"} == first


@pytest.mark.parametrize(
    ("left", "lines"),
    [
        (Left(), ["The studio is closed."]),
        (Left(recipe_count=1), ["The studio is closed; the recipe holds every stroke."]),
        (Left(case_count=1), ["The studio is closed.", "No recording was written."]),
        (
            Left(2, 1, (Path("a.recording"), Path("b.recording"))),
            ["The studio is closed; the recipes hold every stroke.", "Recorded: a.recording", "Recorded: b.recording"],
        ),
    ],
)
def test_its_end_says_what_is_left(monkeypatch, capsys, left, lines):
    monkeypatch.setattr("heartcase.studio.serving.serve.serve", lambda **_: left)
    assert main(["studio", "--no-browser"]) == 0
    assert capsys.readouterr().out.splitlines() == lines


def test_recordings_that_came_while_a_case_was_open_are_known(tmp_path):
    registry = Registry("token")
    assert registry.left() == Left()
    (tmp_path / "old.recording").mkdir()
    registry.open_case(tmp_path / "a.case")
    (tmp_path / "new.recording").mkdir()
    registry.open_case(tmp_path / "b.case")
    registry.open_case(tmp_path / "gone" / "c.case")
    registry.open_recipe(tmp_path / "a.toml", out=tmp_path)
    asyncio.run(registry.close())
    assert registry.left() == Left(1, 3, (tmp_path / "new.recording",))


def test_a_recording_under_another_name_did_not_come(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    for name in ("one", "other"):
        (tmp_path / f"{name}.recording").mkdir()
        (tmp_path / f"{name}.recording" / "recording.json").write_text(name)
    registry = Registry("token")
    # one folder, spelled in two ways
    registry.open_case(Path("a.case"))
    registry.open_case(tmp_path / "b.case")
    (tmp_path / "one.recording").rename(tmp_path / "again.recording")
    shutil.copytree(tmp_path / "other.recording", tmp_path / "new.recording")
    assert registry.left() == Left(0, 2, (tmp_path / "new.recording",))
    asyncio.run(registry.close())


def test_what_it_cannot_open_is_said_in_one_line(tmp_path, capsys, monkeypatch):
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path / "state"))
    case = tmp_path / "torn.case"
    case.mkdir()
    (case / "case.json").write_text("{}")
    missing, torn, script = tmp_path / "nothing", tmp_path / "torn.toml", tmp_path / "script.toml"
    torn.write_text("heartcase_recipe = [\n")
    script.write_text("heartcase_recipe = 1\nseconds = 1.0\nname = 'x'\n[scan]\npath = 'x.nii.gz'\n")
    for path, code, message in (
        (case, 1, "case.json"),
        (missing, 1, "there is nothing at this path"),
        (torn, 1, "this is not valid TOML"),
        (script, 1, "seconds: unknown setting"),
    ):
        assert main(["studio", str(path), "--no-browser"]) == code
        error = capsys.readouterr().err
        assert message in error
        assert error.count("\n") == 1


def test_no_message_waits_until_the_one_before_is_acknowledged():
    async def sends_at_once():
        found = asyncio.get_running_loop().create_future()

        def connected(_, writer):
            line = writer.get_extra_info("socket")
            found.set_result(line.getsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY))
            writer.close()

        with listening(0) as listener:
            async with await asyncio.start_server(connected, sock=listener):
                _, writer = await asyncio.open_connection(*listener.getsockname())
                value = await found
                writer.close()
        return value

    assert asyncio.run(sends_at_once())
