"""Recordings: the same bytes again, taken over, cut short, damaged, of another case, of a newer version."""

from __future__ import annotations

import contextlib
import errno
import json
import os
import shutil
import signal
import subprocess
import sys
from collections.abc import Callable
from dataclasses import replace
from hashlib import sha256
from pathlib import Path
from typing import Any
from unittest import mock

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from heartcase import __version__
from heartcase.schemas.errors import HeartcaseError, RecordingError, SimulationError
from heartcase.schemas.recording.commands import (
    COMMANDS_VERSION,
    Advance,
    CloseGrab,
    LeadGrab,
    Mark,
    Rewind,
    Undo,
    parse_command,
)
from heartcase.schemas.recording.header import HEADER_NAME, LOG_NAME, header_bytes, header_hash
from heartcase.schemas.recording.kept_entries import KeptEntries
from heartcase.schemas.recording.log import opened, sealed
from heartcase.schemas.recording.reader import check_recording, is_recording, open_recording
from heartcase.simulator.engine.cpu import chunks
from heartcase.simulator.engine.cpu.engine import CpuEngine
from heartcase.simulator.engine.shared.contact import NO_PROBES
from heartcase.simulator.lattice.moduli import ForceLaw
from heartcase.simulator.session import recorder as recorder_module
from heartcase.simulator.session.operating_session import OperatingSession
from heartcase.simulator.session.recorder import Recorder
from heartcase.simulator.session.replay import load_session, refuse_deviation
from tests.crash import Crash, crash_after
from tests.simulator.lattices import block
from tests.simulator.session.sessions import (
    CELL_MM,
    SIZE,
    block_model,
    block_simulation,
    commands,
    fingerprint,
    operate,
)
from tests.thoroughly import thoroughly

ROOT = Path(__file__).parents[3]


def recorded(path: Path, *, every: int = 50, **how) -> str:
    """Record a little of everything; returns the fingerprint of the end."""
    session = OperatingSession(block_simulation(**how))
    with Recorder(session, path, state_every_s=every * session.simulation.step_s):
        operate(session)
    return fingerprint(session.simulation)


def replayed(path: Path, **how) -> OperatingSession:
    """The session that a recording is repeated in, at its end."""
    session = load_session(open_recording(path), block(*SIZE, fix_base=True, cell_mm=CELL_MM), **how)
    for _ in session.play():
        pass
    return session


@pytest.fixture
def recording(tmp_path: Path) -> Path:
    recorded(tmp_path / "sound.recording")
    return tmp_path / "sound.recording"


@pytest.mark.parametrize("law", ["springs", "element"])
@pytest.mark.parametrize(("backend", "sleep_mm"), thoroughly([("cpu", 0.0), ("cpu", 0.2), ("reference", 0.0)], 1))
def test_a_replay_comes_to_the_same_bytes(tmp_path, backend, law, sleep_mm):
    path = tmp_path / "one.recording"
    end = recorded(path, backend=backend, law=law, sleep_mm=sleep_mm)
    session = replayed(path)
    assert fingerprint(session.simulation) == end
    assert session.deviations == []
    header = session.simulation
    assert (header.backend, header.sleep_mm, header.model.law.name) == (backend, sleep_mm, law)
    opened_now = open_recording(path)
    assert opened_now.is_whole
    assert opened_now.marks == (("joined", 105),)
    # 300 steps in rows of 60, 45, 75, 60, 60, a state at the first end after each 50, at the start and at the end.
    assert [state.step for state in opened_now.states.values()] == [0, 60, 180, 240, 300]
    assert check_recording(path) == []


@pytest.mark.parametrize(("law", "sleep_mm"), thoroughly([("springs", 0.0), ("springs", 0.2), ("element", 0.2)], 1, 2))
def test_threads_do_not_matter(tmp_path, law, sleep_mm):
    """Recorded by one, repeated by two and by three, each with its own share of the lattice."""
    size = (16, 4, 12)
    ends = []
    for thread_count in (1, 2, 3):

        def advance(engine, step_count, verlet, probes=NO_PROBES, thread_count=thread_count):
            engine.advance_by(thread_count, step_count, verlet, probes)

        with pytest.MonkeyPatch.context() as patch:
            patch.setattr(chunks, "get_num_threads", lambda thread_count=thread_count: thread_count)
            patch.setattr(CpuEngine, "advance", advance)
            path = tmp_path / "one.recording"
            if thread_count == 1:
                recorded(path, law=law, sleep_mm=sleep_mm, size=size)
            session = load_session(open_recording(path), block(*size, fix_base=True, cell_mm=CELL_MM))
            assert len(session.simulation._engine._chunks.before_counts) >= thread_count
            for _ in session.play():
                pass
            assert session.deviations == []
            ends.append(fingerprint(session.simulation))
    assert ends[0] == ends[1] == ends[2]


@settings(max_examples=40, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(data=st.data())
def test_whatever_is_done_is_repeated(tmp_path, data):
    """Also what was taken back: the history of the recording is that of the session."""
    path = tmp_path / "any.recording"
    shutil.rmtree(path, ignore_errors=True)
    session = OperatingSession(block_simulation(sleep_mm=data.draw(st.sampled_from([0.0, 0.2]))))
    session.entries = KeptEntries(block=data.draw(st.sampled_from([1, 3, 512])))
    start = data.draw(st.integers(0, 6))
    recorder = None
    for number, command in enumerate(data.draw(st.lists(commands(), min_size=3, max_size=20))):
        if number == start:
            recorder = Recorder(session, path, state_every_s=0.005)
        with contextlib.suppress(SimulationError):
            session.do(command)
    session.forget_ahead()
    (recorder or Recorder(session, path)).finish()
    found = open_recording(path)
    assert list(found.entries[: found.position]) == session.entries
    again = replayed(path)
    assert again.deviations == []
    assert fingerprint(again.simulation) == fingerprint(session.simulation)


@pytest.mark.parametrize(
    "command", [Advance(steps=1), CloseGrab(name="left", center_mm=(2.0, 4.0, 8.0), radius_mm=3.0)]
)
def test_a_row_that_was_gone_back_into_ends_where_something_else_is_done(tmp_path, command):
    session, path = OperatingSession(block_simulation()), tmp_path / "any.recording"
    with Recorder(session, path, state_every_s=0.001):
        session.advance(26)
        session.go_to(25)
        session.do(command)
        session.advance(5)
    assert [one.step for one in open_recording(path).entries][:2] == [0, 25]
    again = replayed(path)
    assert again.deviations == []
    assert fingerprint(again.simulation) == fingerprint(session.simulation)


def test_seeking_takes_the_way_by_the_stored_states(recording):
    played, sought = replayed(recording), load_session(open_recording(recording), block_model())
    steps = []
    with pytest.MonkeyPatch.context() as patch:
        step = type(sought.simulation).step
        patch.setattr(type(sought.simulation), "step", lambda self, count=1: (steps.append(count), step(self, count)))
        sought.go_to(300)
        # The last state is that of the end.
        assert steps == []
        sought.go_to(239)
        assert steps == [59]
    live = OperatingSession(block_simulation())
    operate(live)
    assert fingerprint(played.simulation) == fingerprint(live.simulation)
    live.go_to(239)
    assert fingerprint(live.simulation) == fingerprint(sought.simulation)


@pytest.mark.parametrize("step", [105, 150])
def test_taken_over_in_the_middle_and_repeated(recording, tmp_path, step):
    parent = open_recording(recording)
    session = load_session(parent, block_model())
    session.go_to(step)
    session.forget_ahead()
    with Recorder(session, tmp_path / "other.recording", parent=parent.branch_at(step)):
        session.do(LeadGrab(name="left", offset_mm=(1, 1, 1)))
        session.advance(40)
    again = replayed(tmp_path / "other.recording")
    assert again.deviations == []
    assert again.step_count == step + 40
    assert fingerprint(again.simulation) == fingerprint(session.simulation)
    said = open_recording(tmp_path / "other.recording").header.parent
    assert (said.log_hash, said.step) == (parent.log_hash, step)
    # States of the first that lie where the other history is another are not gone back to, nor compared with.
    ends = {}
    for number in range(12):
        session.do(LeadGrab(name="left", offset_mm=(1, 1, 1 + 0.1 * number)))
        ends[session.step_count] = fingerprint(session.simulation)
        session.advance(6)
    for end in (*ends, *reversed(ends)):
        session.go_to(end)
        assert fingerprint(session.simulation) == ends[end]
    assert session.deviations == []
    # The first is what it was.
    assert fingerprint(replayed(recording).simulation)


def test_what_was_taken_back_is_not_repeated(tmp_path):
    session = OperatingSession(block_simulation())
    with Recorder(session, tmp_path / "one.recording", state_every_s=0.01):
        session.advance(20)
        session.do(Mark(name="before"))
        session.do(CloseGrab(name="a", center_mm=(2, 4, 8), radius_mm=3))
        session.do(LeadGrab(name="a", offset_mm=(0, 0, 2)))
        session.advance(60)
        session.do(Undo())
        session.do(CloseGrab(name="b", center_mm=(9, 4, 8), radius_mm=3))
        session.advance(10)
        session.do(Rewind(seconds=4 * session.simulation.step_s))
    found = open_recording(tmp_path / "one.recording")
    assert [entry.command.kind for entry in found.entries] == ["advance", "mark", "close_grab", "advance"]
    # It was left 6 steps into the last row, which nobody went on from.
    assert found.position == 3
    assert found.end_step == 20
    assert replayed(tmp_path / "one.recording").step_count == 20


def test_states_of_a_history_that_was_given_up_are_no_part_of_the_recording(tmp_path):
    session = OperatingSession(block_simulation())
    step_s = session.simulation.step_s
    with Recorder(session, tmp_path / "one.recording", state_every_s=15 * step_s):
        for _ in range(5):
            session.advance(20)
        session.go_to(0)
        session.do(CloseGrab(name="a", center_mm=(2, 4, 8), radius_mm=3))
        session.do(LeadGrab(name="a", offset_mm=(0, 0, 2)))
        for _ in range(6):
            session.advance(8)
    found = open_recording(tmp_path / "one.recording")
    assert {position: state.step for position, state in found.states.items()} == {0: 0, 4: 16, 6: 32, 8: 48}
    assert replayed(tmp_path / "one.recording").deviations == []


def test_a_deviation_is_told_with_step_and_distance(recording):
    """A state that says something else, sealed as it should be: what another machine would have recorded."""
    from safetensors.numpy import load, save

    found = open_recording(recording)
    line = found.states[3]
    file = recording / line.file
    content = file.read_bytes()
    length = int.from_bytes(content[:8], "little")
    arrays, told = load(content), json.loads(content[8 : 8 + length])["__metadata__"]
    arrays["displacement"] = arrays["displacement"].copy()
    arrays["displacement"][-1, 2] += np.float32(0.25)
    file.write_bytes(save(arrays, told))
    reseal(recording, {line.sha256: sha256(file.read_bytes()).hexdigest()})
    session = replayed(recording)
    (deviation,) = session.deviations
    assert deviation.step == 60
    assert deviation.distance_mm == pytest.approx(0.25 * CELL_MM, rel=1e-5)
    with pytest.raises(RecordingError, match=r"from step 60 on it differs, by up to 0\.5 mm"):
        refuse_deviation(session)


def reseal(path: Path, changes: dict[str, str]) -> None:
    """Change the text of a log, and seal it as whoever wrote it would have."""
    header = json.loads((path / HEADER_NAME).read_text())
    found = open_recording(path, partial=True)
    old = new = header_hash(found.header)
    lines = []
    for content in (path / LOG_NAME).read_bytes().splitlines():
        line, old = opened(content, old)
        text = line.model_dump_json(exclude_none=True)
        for before, after in changes.items():
            text = text.replace(before, after)
        sealed_line, new = sealed(type(line).model_validate_json(text), new)
        lines.append(sealed_line)
    (path / LOG_NAME).write_bytes(b"".join(lines))
    header["end"]["log_hash"] = new
    (path / HEADER_NAME).write_text(json.dumps(header))


def test_another_backend_is_near(tmp_path):
    """Until the hand lets go of what it turned: whether corners are then held back depends on the last digits."""
    recorded(tmp_path / "one.recording", every=5)
    session = replayed(tmp_path / "one.recording", backend="reference")
    before = [deviation.distance_mm for deviation in session.deviations if deviation.step <= 180]
    assert len(before) >= 3
    assert 0 < max(before) < 0.01 * CELL_MM


def test_of_another_case(recording):
    model = block(*SIZE, fix_base=True, cell_mm=CELL_MM)
    others = (
        block(6, 4, 5, fix_base=True, cell_mm=CELL_MM),
        block(*SIZE, cell_mm=CELL_MM),
        block(*SIZE, fix_base=True, cell_mm=CELL_MM * 1.01),
        replace(model, cell_coverage=model.cell_coverage * np.float32(0.99)),
    )
    for other in others:
        with pytest.raises(RecordingError, match="give the case that was recorded") as caught:
            load_session(open_recording(recording), other)
        assert len(caught.value.problems) == 1
    load_session(open_recording(recording), model.with_law(ForceLaw("element")))


@pytest.mark.parametrize(
    ("key", "value"), [("format_version", "1.2"), ("format_version", "2.0"), ("commands_version", COMMANDS_VERSION + 1)]
)
def test_of_a_newer_version(recording, key, value):
    file = recording / HEADER_NAME
    file.write_text(json.dumps(json.loads(file.read_text()) | {key: value, "software_version": "9.1", "new": 1}))
    for partial in (False, True):
        with pytest.raises(
            RecordingError, match=r"newer version than this heartcase reads: get heartcase 9\.1"
        ) as told:
            open_recording(recording, partial=partial)
        assert len(told.value.problems) == 1


def test_the_header_says_what_was_recorded(recording):
    header = open_recording(recording).header
    assert header.software_version == __version__
    assert header.node_count == block_model().node_count
    assert header.end is not None
    assert header.end.step == 300


def test_the_header_says_how_long_steps_were(tmp_path, recording):
    """And of one in which they were of one length, it has the hash that it had in format 1.0."""
    recorded(tmp_path / "element.recording", law="element")
    paced, plain = (open_recording(path).header for path in (tmp_path / "element.recording", recording))
    assert paced.pace == block_simulation(law="element").pace > 1.1
    assert plain.pace == 1.0
    for header, later in ((paced, {"end"}), (plain, {"end", "pace"})):
        said = {key: value for key, value in json.loads(header_bytes(header)).items() if key not in later}
        text = json.dumps(said, sort_keys=True, separators=(",", ":"))
        assert header_hash(header) == sha256(text.encode()).hexdigest()


def test_what_is_no_recording_is_refused(tmp_path):
    for path, told in ((tmp_path / "absent", "nothing at this path"), (tmp_path, "not a recording")):
        with pytest.raises(RecordingError, match=told):
            open_recording(path)
    session = OperatingSession(block_simulation())
    with pytest.raises(RecordingError, match="something at this path already"):
        Recorder(session, tmp_path)
    with pytest.raises(RecordingError, match="make it first"):
        Recorder(session, tmp_path / "none" / "a.recording")
    joined = block_simulation()
    joined.add_springs([[0, 90]], 0.1)
    with pytest.raises(RecordingError, match="cut or joined"):
        Recorder(OperatingSession(joined), tmp_path / "a.recording")
    assert list(tmp_path.iterdir()) == []
    recorder = Recorder(session, tmp_path / "a.recording")
    with pytest.raises(RecordingError, match="recorded already"):
        Recorder(session, tmp_path / "b.recording")
    recorder.discard()
    assert list(tmp_path.iterdir()) == []


def test_a_name_that_no_path_may_have_is_a_recording_that_is_not_there():
    session = OperatingSession(block_simulation())
    for name in ("a\0b", "x" * 5000):
        with pytest.raises(RecordingError, match="nothing at this path"):
            open_recording(name)
        assert [problem.place for problem in check_recording(name)] == ["recording"]
        assert not is_recording(Path(name))
        with pytest.raises(RecordingError, match=r"no path may hold|cannot be written"):
            Recorder(session, name)
    assert session.log is None


def test_steps_and_states_that_a_recording_does_not_have_are_refused(recording):
    opened_now = open_recording(recording)
    assert opened_now.branch_at(opened_now.end_step).step == 300
    for step in (-1, 301, 99999, 1.5):
        with pytest.raises(RecordingError, match=r"step: .*at least 0 and at most 300"):
            opened_now.branch_at(step)
    with pytest.raises(RecordingError, match=r"77 entries are done; there are: 0, "):
        opened_now.state_bytes(77)


def told_of(call: Callable[[], Any]) -> tuple[Any, list[str]]:
    """What a call returns, or None and the lines of what it was refused with."""
    try:
        return call(), []
    except HeartcaseError as error:
        lines = [str(problem) for problem in error.problems]
    assert lines
    assert all(line.isprintable() for line in lines)
    return None, lines


def prefix_of(path: Path, whole: tuple) -> int:
    """How many entries can be had of what is left; they are those that were recorded."""
    found = open_recording(path, partial=True)
    assert found.entries == whole[: len(found.entries)]
    assert not found.is_whole
    return len(found.entries)


def test_a_log_that_was_cut_at_any_byte(recording):
    whole = open_recording(recording).entries
    log = recording / LOG_NAME
    content = log.read_bytes()
    had = []
    rng = np.random.default_rng(3)
    for size in sorted(rng.choice(len(content), 60, replace=False)):
        log.write_bytes(content[:size])
        with pytest.raises(RecordingError, match="cut short") as caught:
            open_recording(recording)
        assert len(caught.value.problems) == 1
        had.append(prefix_of(recording, whole))
    assert had == sorted(had)
    assert had[0] <= 1
    assert had[-1] >= len(whole) - 2


def test_a_log_in_which_any_byte_was_changed(recording):
    whole = open_recording(recording).entries
    log = recording / LOG_NAME
    content = log.read_bytes()
    for at in np.random.default_rng(4).choice(len(content), 80, replace=False):
        damaged = bytearray(content)
        damaged[at] ^= 1 << (at % 8)
        log.write_bytes(damaged)
        with pytest.raises(RecordingError) as caught:
            open_recording(recording)
        assert len(caught.value.problems) == 1
        assert "damaged" in str(caught.value) or "cut short" in str(caught.value)
        assert prefix_of(recording, whole) <= len(whole)


def test_a_header_in_which_any_byte_was_changed(recording):
    """It is refused, or says the same as before."""
    sound = open_recording(recording)
    file = recording / HEADER_NAME
    content = file.read_bytes()
    refused = 0
    for at in range(0, len(content), 3):
        damaged = bytearray(content)
        damaged[at] ^= 1 << (at % 7)
        file.write_bytes(damaged)
        found, problems = told_of(lambda: open_recording(recording))
        refused += found is None
        assert len(problems) == (found is None)
        if found is not None:
            assert found.header.model_dump(exclude={"end"}) == sound.header.model_dump(exclude={"end"})
            assert found.entries == sound.entries
    assert refused > 0.7 * len(content) / 3


def test_states_that_were_damaged(recording):
    found = open_recording(recording)
    file = recording / found.states[3].file
    content = file.read_bytes()
    damaged = bytearray(content)
    damaged[-5] ^= 1
    file.write_bytes(damaged)
    (problem,) = check_recording(recording)
    assert "the state of step 60 is damaged" in problem.message
    with pytest.raises(RecordingError, match="the state of step 60 is damaged"):
        replayed(recording)
    file.write_bytes(content[:-1])
    with pytest.raises(RecordingError, match="the state of step 60 is damaged"):
        open_recording(recording)
    file.unlink()
    with pytest.raises(RecordingError, match="the state of step 60 is missing"):
        open_recording(recording)
    # Without one of its states it can be repeated all the same.
    partial = open_recording(recording, partial=True)
    assert 3 not in partial.states
    session = load_session(partial, block_model())
    session.go_to(session.end_step)
    assert session.step_count == 300


def test_a_process_that_is_killed_leaves_what_it_had(tmp_path):
    """SIGKILL while it records: all that was done is there, and it can be repeated and gone on from."""
    program = f"""
import os, sys
sys.path.insert(0, {str(ROOT)!r})
from tests.simulator.session.sessions import block_simulation, operate
from heartcase.simulator.session.operating_session import OperatingSession
from heartcase.simulator.session.recorder import Recorder
session = OperatingSession(block_simulation())
Recorder(session, {str(tmp_path / "killed.recording")!r}, state_every_s=0.01)
operate(session)
print("done", flush=True)
os.kill(os.getpid(), {signal.SIGKILL})
"""
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=False, env=os.environ)
    assert done.stdout == "done\n", done.stderr
    assert done.returncode == -signal.SIGKILL
    path = tmp_path / "killed.recording"
    with pytest.raises(RecordingError, match=r"cut short, as when .* was killed"):
        open_recording(path)
    recorded(tmp_path / "whole.recording")
    found, whole = open_recording(path, partial=True), open_recording(tmp_path / "whole.recording")
    assert found.entries == whole.entries
    assert found.end_step == 300
    session = load_session(found, block_model())
    for _ in session.play():
        pass
    assert session.deviations == []
    assert fingerprint(session.simulation) == fingerprint(replayed(tmp_path / "whole.recording").simulation)


def test_a_crash_at_any_operation_on_files_leaves_a_beginning(tmp_path):
    recorded(tmp_path / "whole.recording")
    whole = open_recording(tmp_path / "whole.recording")
    model = block_model()
    had, limit, is_done = [], 0, False
    while not is_done:
        path = tmp_path / f"{limit}.recording"
        session = OperatingSession(block_simulation(), snapshot_every_s=float("inf"))
        try:
            with crash_after(limit):
                recorder = Recorder(session, path, state_every_s=50 * session.simulation.step_s)
                operate(session)
                recorder.finish()
            is_done = True
        except Crash:
            pass
        limit += 1
        if not (path / HEADER_NAME).exists():
            assert had == []
            continue
        found = open_recording(path, partial=True)
        assert found.entries == whole.entries[: len(found.entries)]
        assert all(state.step in (0, 60, 180, 240, 300) for state in found.states.values())
        had.append(len(found.entries))
        if found.states and not limit % 5:
            load_session(found, model)
    assert found.is_whole
    assert had == sorted(had)
    assert had[0] == 0
    assert had[-1] == len(whole.entries)


def test_what_interrupts_it_at_any_operation_on_files_leaves_a_whole_recording_of_what_was_done(tmp_path):
    recorded(tmp_path / "whole.recording")
    whole = open_recording(tmp_path / "whole.recording")
    had, limit, found = [], 0, None
    while found is None or found.entries != whole.entries:
        session = OperatingSession(block_simulation(), snapshot_every_s=float("inf"))
        path, limit = tmp_path / f"{limit}.recording", limit + 1
        recorder = Recorder(session, path, state_every_s=50 * session.simulation.step_s)
        with contextlib.suppress(KeyboardInterrupt), recorder, crash_after(limit, KeyboardInterrupt):
            operate(session)
        found = open_recording(path)
        assert check_recording(path) == []
        assert found.is_whole
        assert found.header.end.step == found.end_step
        assert found.entries == whole.entries[: len(found.entries)]
        assert {file.name for file in path.glob("state-*")} == {state.file for state in found.states.values()}
        had.append(len(found.entries))
    assert had == sorted(had)
    assert len(set(had)) > 3


def test_a_line_that_was_being_written_when_it_was_interrupted_is_left_out(tmp_path):
    session = OperatingSession(block_simulation())
    recorder = Recorder(session, tmp_path / "a.recording")
    kept = "heartcase.simulator.session.recorder._Written"
    session.advance(20)
    with pytest.raises(KeyboardInterrupt), recorder, mock.patch(kept, side_effect=KeyboardInterrupt):
        session.advance(20)
    assert check_recording(recorder.path) == []
    assert open_recording(recorder.path).end_step == 20


def interrupted_at(place: int, path: Path) -> bool:
    """Record two rows of steps, interrupted at this place of the recorder's code; whether it has so many."""
    session = OperatingSession(block_simulation(), snapshot_every_s=float("inf"))
    passed, before = 0, sys.gettrace()

    def at(frame, event, _):
        nonlocal passed
        if frame.f_code.co_filename != recorder_module.__file__:
            return None
        passed += event in ("line", "return")
        if passed == place and event in ("line", "return"):
            raise KeyboardInterrupt
        return at

    recorder = Recorder(session, path, state_every_s=5 * session.simulation.step_s)
    with contextlib.suppress(KeyboardInterrupt), recorder:
        sys.settrace(at)
        try:
            session.advance(10)
            session.advance(10)
        finally:
            sys.settrace(before)
    return passed >= place


def test_what_interrupts_it_anywhere_in_its_own_code_leaves_a_whole_recording_of_what_was_done(tmp_path):
    place, had = 1, []
    while interrupted_at(place, path := tmp_path / f"{place}.recording"):
        assert check_recording(path) == [], place
        found = open_recording(path)
        assert found.header.end.step == found.end_step, place
        assert {file.name for file in path.glob("state-*")} == {state.file for state in found.states.values()}, place
        had.append(found.end_step)
        place += 1
    assert had == sorted(had)
    assert set(had) == {0, 10, 20}


def test_a_disk_that_is_full_at_any_operation_ends_the_recording_and_not_the_session(tmp_path):
    untouched = recorded(tmp_path / "whole.recording")
    whole = open_recording(tmp_path / "whole.recording")
    limit, had, is_done = 0, [], False
    while not is_done:
        path, told = tmp_path / f"{limit}.recording", []
        session = OperatingSession(block_simulation(), snapshot_every_s=float("inf"))
        with crash_after(limit, OSError(errno.ENOSPC, os.strerror(errno.ENOSPC), "a path")):
            try:
                every_s = 50 * session.simulation.step_s
                recorder = Recorder(session, path, state_every_s=every_s, failed=told.append)
            except RecordingError as error:
                assert had == []
                told.append(error)
            else:
                operate(session)
                recorder.finish()
                assert recorder.error is (told[0] if told else None)
                had.append(limit)
            is_done = not told
        limit += 3
        assert session.log is None
        if told:
            assert [str(error) for error in told] == ["recording: cannot be written: No space left on device"]
        if had and told:
            found = open_recording(path, partial=True)
            assert found.entries == whole.entries[: len(found.entries)]
        if had:
            assert fingerprint(session.simulation) == untouched
    assert len(had) > 5
    assert found.entries == whole.entries


@pytest.mark.parametrize("ended", [KeyboardInterrupt(), SimulationError("a grab finds no tissue")])
def test_a_disk_that_is_full_when_the_block_ends_early_does_not_hide_what_ended_it(tmp_path, ended):
    session = OperatingSession(block_simulation())
    recorder = Recorder(session, tmp_path / "a.recording")
    session.advance(10)
    full = mock.patch.object(recorder_module, "atomic_write", side_effect=OSError(errno.ENOSPC, "No space left"))
    with pytest.raises(type(ended)) as raised, full, recorder:
        raise ended
    assert raised.value is ended
    assert "No space left" in str(recorder.error)
    assert open_recording(recorder.path, partial=True).end_step == 10


def test_where_a_recording_cannot_begin_nothing_is_left_and_who_does_not_ask_is_told_by_an_error(tmp_path):
    session = OperatingSession(block_simulation())
    file = tmp_path / "file"
    file.write_bytes(b"")
    with pytest.raises(RecordingError, match="cannot be written: Not a directory"):
        Recorder(session, file / "a.recording")
    full = OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
    with mock.patch("heartcase.simulator.session.recorder.snapshot_bytes", side_effect=full):
        with pytest.raises(RecordingError, match="No space left"):
            Recorder(session, tmp_path / "a.recording")
        assert sorted(tmp_path.iterdir()) == [file]
        assert session.log is None
    recorder = Recorder(session, tmp_path / "a.recording")
    no_room = mock.patch("heartcase.simulator.session.recorder.sealed", side_effect=full)
    with no_room, pytest.raises(RecordingError, match="No space left"):
        session.advance(1)
    assert recorder.error is not None


JSON = st.recursive(
    st.none() | st.booleans() | st.integers(-5, 2**70) | st.floats() | st.text(max_size=12),
    lambda inner: st.lists(inner, max_size=4) | st.dictionaries(st.text(max_size=8), inner, max_size=4),
    max_leaves=12,
)
KEYS = st.sampled_from(["kind", "name", "center_mm", "nodes", "steps", "of", "seconds", "turn", "numbers", "step"])
KINDS = st.sampled_from(["close_grab", "lead_grab", "add_springs", "advance", "go_to", "rewind", "bring_probe", "undo"])
NEAR = st.dictionaries(KEYS, JSON | KINDS | st.lists(st.floats(-1e3, 1e3), min_size=3, max_size=3), max_size=6)


@settings(max_examples=300, deadline=None)
@given(NEAR | JSON, st.none() | KINDS)
def test_any_json_is_a_command_or_refused_in_lines(data, kind):
    if isinstance(data, dict) and kind:
        data = data | {"kind": kind}
    command, problems = told_of(lambda: parse_command(data))
    assert bool(problems) == (command is None)
    if command is not None:
        assert parse_command(command.model_dump(mode="json")) == command


@settings(max_examples=60, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(data=st.data())
def test_a_log_of_any_lines_that_is_sealed_is_repeated_or_refused(recording, tmp_path, data):
    """What a faulty or hostile program might write: commands in any order, steps and places that do not follow."""
    copy = tmp_path / "copy.recording"
    shutil.rmtree(copy, ignore_errors=True)
    shutil.copytree(recording, copy)
    header = json.loads((copy / HEADER_NAME).read_text())
    link = header_hash(open_recording(copy).header)
    lines = [json.loads(line) for line in (copy / LOG_NAME).read_text().splitlines()]
    for line in lines:
        del line["link"]
    for _ in range(data.draw(st.integers(1, 3))):
        at = data.draw(st.integers(0, len(lines) - 1))
        change = data.draw(st.sampled_from(["swap", "drop", "twice", "number", "to", "any"]))
        if change == "swap":
            lines[at], lines[-1] = lines[-1], lines[at]
        elif change == "drop" and len(lines) > 1:
            del lines[at]
        elif change == "twice":
            lines.insert(at, lines[at])
        elif change == "number" and "command" in lines[at]:
            command = dict(lines[at]["command"])
            key = data.draw(st.sampled_from(sorted(command)))
            command[key] = data.draw(st.sampled_from([0, -1, 3, 90, "left", [[0, 90]], [1, 2, 3], 1e9, None]))
            lines[at] = lines[at] | {"command": command}
        elif change == "to":
            lines.insert(at, {"to": data.draw(st.integers(0, 30))})
        else:
            lines[at] = data.draw(JSON.filter(lambda value: isinstance(value, dict)))
    content = b""
    for line in lines:
        body = json.dumps(line, separators=(",", ":")).encode()
        link = sha256(link.encode() + body).hexdigest()
        content += (body[:-1] + f',"link":"{link}"'.encode() + b"}\n") if line else b"{}\n"
    (copy / LOG_NAME).write_bytes(content)
    header["end"] |= {"line_count": len(lines), "log_hash": link}
    (copy / HEADER_NAME).write_text(json.dumps(header))

    def repeat() -> bool:
        session = load_session(open_recording(copy), block_model())
        if session.end_step < 2000:
            for _ in session.play():
                pass
            refuse_deviation(session)
        return True

    is_repeated, problems = told_of(repeat)
    assert bool(problems) == (is_repeated is None)


def test_steps_of_a_recording_are_counted(recording):
    assert [entry.step for entry in open_recording(recording).entries if isinstance(entry.command, Advance)] == [
        0, 60, 105, 180, 240,
    ]  # fmt: skip
