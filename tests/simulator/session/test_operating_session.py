"""Commands in, frames out: what is refused changes nothing, and going back and on again gives the same bytes."""

from __future__ import annotations

import random
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pydantic import ValidationError

from heartcase.schemas.errors import RecordingError, SimulationError
from heartcase.schemas.recording.branches import MOST_BRANCHES
from heartcase.schemas.recording.commands import (
    AddSprings,
    Advance,
    BringProbe,
    CloseGrab,
    Cut,
    DrawStitch,
    Entry,
    GoTo,
    LeadGrab,
    Mark,
    MoveProbe,
    OpenGrab,
    Redo,
    RemoveSprings,
    Rewind,
    Snip,
    Undo,
    parse_command,
)
from heartcase.schemas.recording.kept_entries import KeptEntries
from heartcase.schemas.recording.reader import check_recording, open_recording
from heartcase.simulator.lattice.state import State
from heartcase.simulator.session.operating_session import OperatingSession
from heartcase.simulator.session.recorder import Recorder
from heartcase.simulator.session.replay import load_session
from heartcase.simulator.session.snapshots import Snapshots
from heartcase.simulator.snapshot import Snapshot
from tests.simulator.session.sessions import block_model, block_simulation, commands, fingerprint, operate

NAVIGATION = (Undo, Redo, Rewind, GoTo)
INSIDE = (2.0, 4.0, 8.0)
"""A place in the block, LPS mm."""


@pytest.mark.parametrize("backend", ["cpu", "reference"])
@settings(max_examples=80, deadline=None)
@given(data=st.data())
def test_going_back_and_on_again_gives_the_same_bytes(backend, data):
    """The oracle is what the session came to when it was at a place of its history for the first time."""
    sequence = data.draw(st.lists(commands(), min_size=4, max_size=25 if backend == "cpu" else 8))
    law = data.draw(st.sampled_from(["springs", "element"]))
    sleep_mm = data.draw(st.sampled_from([0.0, 0.2]))
    every_s = data.draw(st.sampled_from([0.0, 0.01, float("inf")]))
    session = OperatingSession(block_simulation(law, backend=backend, sleep_mm=sleep_mm), snapshot_every_s=every_s)
    session.entries = KeptEntries(block=data.draw(st.sampled_from([1, 3, 512])))
    known = {0: fingerprint(session.simulation)}
    for command in sequence:
        before, place, was_on_the_way = fingerprint(session.simulation), session.position, session.is_on_the_way
        try:
            session.do(command)
        except SimulationError:
            if not isinstance(command, Advance):
                assert fingerprint(session.simulation) == before
                assert session.position == place
                continue
        if session.is_on_the_way:
            continue
        if isinstance(command, NAVIGATION):
            assert fingerprint(session.simulation) == known[session.position]
        else:
            # Where it was left between the ends of a row, the row ends there.
            known = {at: found for at, found in known.items() if at <= place} | {place + was_on_the_way: before}
            known[session.position] = fingerprint(session.simulation)
    place, end = session.position, fingerprint(session.simulation)
    session.forget_ahead()
    known = {at: found for at, found in known.items() if at <= place} | {session.position: end}
    for step in {entry.end_step for entry in session.entries}:
        session.go_to(step)
        assert fingerprint(session.simulation) == known[session.position]
    session.go_to(session.start_step)
    for _ in session.play():
        assert fingerprint(session.simulation) == known[session.position]
    assert fingerprint(session.simulation) == end


@pytest.mark.parametrize("number", range(6))
def test_undo_of_every_act_gives_the_bytes_before_it_and_redo_those_after(number):
    session = OperatingSession(block_simulation("element", sleep_mm=0.1))
    before, do = [], session._do_now

    def noting(command):
        if command.kind in (
            "close_grab",
            "open_grab",
            "bring_probe",
            "withdraw_probe",
            "add_springs",
            "remove_springs",
        ):
            before.append((command.kind, fingerprint(session.simulation)))
        do(command)

    session._do_now = noting
    operate(session)
    end = fingerprint(session.simulation)
    assert len(before) == 6
    for _ in range(number + 1):
        session.do(Undo())
    assert fingerprint(session.simulation) == before[-1 - number][1]
    for _ in range(number + 1):
        session.do(Redo())
    assert fingerprint(session.simulation) == end
    with pytest.raises(SimulationError, match="nothing to do again"):
        session.do(Redo())


def test_undo_takes_back_what_was_done_and_not_what_was_led():
    session = OperatingSession(block_simulation())
    with pytest.raises(SimulationError, match="nothing to take back"):
        session.do(Undo())
    session.do(CloseGrab(name="a", center_mm=(2, 4, 8), radius_mm=3))
    session.advance(10)
    session.do(LeadGrab(name="a", offset_mm=(0, 0, 1)))
    session.advance(10)
    session.do(Undo())
    assert session.step_count == 0
    assert session.simulation.instruments == ()
    assert session.end_step == 20


def test_acts_of_one_moment_are_taken_back_and_done_again_as_one_where_that_is_asked_for():
    session = OperatingSession(block_simulation())
    session.do(CloseGrab(name="first", center_mm=(2, 4, 8), radius_mm=1))
    session.advance(10)
    alone = fingerprint(session.simulation)
    for name, x in (("left", 4), ("middle", 6), ("right", 8)):
        session.do(CloseGrab(name=name, center_mm=(x, 4, 8), radius_mm=1))
    session.do(LeadGrab(name="left", offset_mm=(0, 0, 1)))
    session.advance(10)
    session.do(OpenGrab(name="middle"))
    open_one = fingerprint(session.simulation)
    # the last act was given at another moment
    session.undo(together=True)
    assert len(session.simulation.grabs) == 4
    session.undo(together=True)
    assert fingerprint(session.simulation) == alone
    session.redo(together=True)
    assert len(session.simulation.grabs) == 4
    session.redo(together=True)
    assert fingerprint(session.simulation) == open_one
    # one by one it is what it was
    session.undo()
    session.undo()
    assert [grab.name for grab in session.simulation.grabs] == ["first", "left", "middle"]
    session.redo()
    session.undo(together=True)
    session.undo(together=True)
    assert session.position == 0
    session.redo(together=True)
    assert fingerprint(session.simulation) == alone


def test_rewound_and_taken_over():
    session = OperatingSession(block_simulation(sleep_mm=0.05), snapshot_every_s=0.005)
    operate(session)
    abandoned = fingerprint(session.simulation)
    session.do(Rewind(seconds=137 * session.simulation.step_s))
    assert session.step_count == 163
    assert session.is_on_the_way
    # The hand is where a straight line has it: 58 of the 75 steps of its row are done.
    assert [name for name, _ in session.marks] == ["joined"]
    there = fingerprint(session.simulation)
    session.go_to(session.end_step)
    assert fingerprint(session.simulation) == abandoned
    session.go_to(163)
    assert fingerprint(session.simulation) == there
    session.do(LeadGrab(name="left", offset_mm=(1, 0, 0)))
    session.advance(50)
    assert session.end_step == session.step_count == 213
    other = fingerprint(session.simulation)
    session.go_to(0)
    for _ in session.play():
        pass
    assert fingerprint(session.simulation) == other
    assert session.entries[-3].command == Advance(steps=58, of=75)


def test_snapshots_of_a_history_that_was_given_up_are_not_gone_back_to():
    """The second history has the same number of entries in fewer steps: its snapshots lie at other places."""
    simulation = block_simulation()
    session = OperatingSession(simulation, snapshot_every_s=20.5 * simulation.step_s)
    session.do(CloseGrab(name="left", center_mm=(2, 4, 8), radius_mm=3))
    session.do(LeadGrab(name="left", offset_mm=(0, 0, 1)))
    for _ in range(6):
        session.advance(21)
    session.go_to(0)
    session.do(LeadGrab(name="left", offset_mm=(1, 0, 0)))
    ends = {}
    for _ in range(6):
        session.advance(7)
        ends[session.step_count] = fingerprint(simulation)
    for step in (42, 7, 28, 14, 35, 21):
        session.go_to(step)
        assert fingerprint(simulation) == ends[step]


def test_instruments_that_are_left_on_the_way_are_where_a_straight_line_has_them():
    session = OperatingSession(block_simulation())
    session.do(CloseGrab(name="a", center_mm=(2, 4, 8), radius_mm=3))
    session.do(LeadGrab(name="a", offset_mm=(0, 0, 1), turn=((0, -1, 0), (1, 0, 0), (0, 0, 1))))
    session.advance(40)
    (hand,) = session.simulation.grabs
    end = hand.displacement_at(hand.pose)
    session.go_to(10)
    (hand,) = session.simulation.grabs
    start = hand.closed_at
    np.testing.assert_allclose(hand.displacement_at(hand.pose), start + 0.25 * (end - start), atol=1e-6)
    now = session.simulation.state.displacement[hand.nodes]
    np.testing.assert_allclose(now, start + 0.25 * (end - start), atol=1e-6)
    np.testing.assert_allclose(session.frame().instruments["a"].center_mm, (2, 4, 8.25), atol=1e-6)


def test_frames_tell_what_was_refused_and_that_the_lattice_changed():
    session = OperatingSession(block_simulation())
    before = fingerprint(session.simulation)
    frame = session.take(
        [
            OpenGrab(name="nobody"),
            CloseGrab(name="a", center_mm=(200, 4, 8), radius_mm=3),
            RemoveSprings(numbers=(0,)),
            MoveProbe(name="tip", center_mm=(1, 2, 3)),
        ]
    )
    assert [refusal.command.kind for refusal in frame.refused] == [
        "open_grab", "close_grab", "remove_springs", "move_probe",
    ]  # fmt: skip
    assert all(refusal.problems and refusal.problems[0].message for refusal in frame.refused)
    assert fingerprint(session.simulation) == before
    assert session.entries == []
    frame = session.take([parse_command({"kind": "add_springs", "nodes": [[3, 90]], "stiffness_n_m": 0.5})], 10)
    assert frame.refused == ()
    (change,) = frame.topology
    assert (change.kind, change.explicit_count) == ("add_springs", 1)
    assert session.take([Undo()]).topology[0].kind == "history"
    assert session.take([]).topology == ()
    with pytest.raises(SimulationError, match="no surface"):
        session.frame(surface=True)


def test_a_frame_shows_instruments_and_what_they_feel():
    session = OperatingSession(block_simulation())
    session.do(CloseGrab(name="a", center_mm=(2, 4, 8), radius_mm=3))
    session.do(LeadGrab(name="a", offset_mm=(0, 0.5, 1)))
    frame = session.advance(80)
    hand = frame.instruments["a"]
    np.testing.assert_allclose(hand.center_mm, (2, 4.5, 9))
    np.testing.assert_array_equal(hand.turn, np.eye(3))
    np.testing.assert_array_equal(hand.force_n, session.simulation.force_on(session.simulation.grabs[0]))
    assert hand.force_n[2] < 0
    assert np.abs(hand.torque_n_mm).max() > 0
    assert frame.step == 80
    assert frame.time_s == pytest.approx(80 * session.simulation.step_s)
    np.testing.assert_array_equal(frame.displacement_mm, session.simulation.displacement_mm())


def test_a_breakdown_is_told_and_the_state_before_stays():
    session = OperatingSession(block_simulation(damping_per_s=0.0))
    session.do(CloseGrab(name="a", center_mm=(2, 4, 8), radius_mm=3))
    session.advance(20)
    before = session.simulation.state
    session.do(LeadGrab(name="a", offset_mm=(1e30, 1e30, 1e30)))
    frame = session.take([], 5)
    assert "broke down" in frame.breakdown
    assert frame.step == 20
    assert frame.state.displacement.tobytes() == before.displacement.tobytes()
    # The hand stays where it was, also when all of it is done again.
    session.advance(15)
    end = fingerprint(session.simulation)
    session.go_to(0)
    for _ in session.play():
        pass
    assert fingerprint(session.simulation) == end
    assert session.step_count == 35
    session.do(LeadGrab(name="a", offset_mm=(1e30, 1e30, 1e30)))
    with pytest.raises(SimulationError, match="broke down"):
        session.advance(5)


def test_marks_name_moments():
    session = OperatingSession(block_simulation())
    session.advance(7)
    session.do(Mark(name="open"))
    session.advance(5)
    session.do(Mark(name="closed"))
    assert session.marks == (("open", 7), ("closed", 12))
    session.go_to(7)
    assert session.marks == (("open", 7),)
    with pytest.raises(SimulationError, match="step 13 is not known: there are 0 to 12"):
        session.go_to(13)


def test_snapshots_thin_out_and_bound_what_going_back_costs():
    kept = Snapshots(10.0)
    model = block_simulation().model
    state = State.at_rest(model.node_count)
    count = 40_000
    for position in range(count + 1):
        if position % 10 == 0:
            kept.add(position, Snapshot(model, State(state.displacement, state.velocity, position)))
        if position in (1000, 10_000, count):
            steps = sorted(kept.positions)
            assert steps[0] == 0
            assert steps[-1] == position
            gaps = [(later - earlier, position - later) for earlier, later in pairwise(steps)]
            assert all(gap <= max(20.0, 0.15 * age + 20.0) for gap, age in gaps)
            # Eight for each e-fold of age over the finest gap, and those of the finest.
            assert len(kept) < 2 * (8 * np.log(position / 10) + 10)


def test_commands_are_plain_data_and_say_what_is_wrong_with_them():
    command = parse_command({"kind": "close_grab", "name": "a", "center_mm": [1, 2, 3]})
    assert command == CloseGrab(name="a", center_mm=(1, 2, 3))
    assert parse_command(command.model_dump(mode="json")) == command
    for wrong, told in (
        ({"kind": "cut_off"}, "must be"),
        ({"name": "a"}, "missing"),
        ({"kind": "close_grab", "name": "a", "center_mm": [1, 2, float("nan")]}, "finite"),
        ({"kind": "advance", "steps": 0}, "at least 1"),
        ({"kind": "advance", "steps": 5, "of": 4}, "fewer"),
        ([1, 2], "table"),
    ):
        with pytest.raises(RecordingError, match=told):
            parse_command(wrong)


def test_a_command_that_is_made_in_a_program_says_all_that_is_wrong_with_it():
    with pytest.raises(RecordingError) as found:
        CloseGrab(name="", center_mm=(1.0, 2.0, float("nan")), radius_mm=-1)
    places = [problem.place for problem in found.value.problems]
    assert places == ["CloseGrab.name", "CloseGrab.center_mm[3]", "CloseGrab.radius_mm"]
    for make, told in (
        (lambda: CloseGrab(nme="a", center_mm=(1, 2, 3)), "did you mean 'name'"),
        (lambda: Cut(poses_mm=[[(0, 0, 0), (1, 1, 1)]]), "at least 2"),
        (lambda: AddSprings(nodes=((0, -1),), stiffness_n_m=1.0), r"nodes\[1\]\[2\]: must be at least 0"),
        (lambda: Advance(steps=5, of=4), "fewer"),
        (lambda: DrawStitch(name="a"), "either"),
        (lambda: Snip(name="a", angle_deg=91), "at most 90"),
        (lambda: Entry(step=0, command={"kind": "advance", "steps": 0}), "Entry.command.steps: must be at least 1"),
        (lambda: Undo(steps=1), "unknown setting"),
    ):
        with pytest.raises(RecordingError, match=told):
            make()
    # a model that holds commands is read as before
    with pytest.raises(ValidationError):
        Entry.model_validate({"step": 0, "command": {"kind": "advance", "steps": 0}})


def test_what_is_given_and_is_no_command_or_no_number_is_refused_and_nothing_is_done():
    session = OperatingSession(block_simulation())
    session.advance(20)
    before = fingerprint(session.simulation)
    nan, inf = float("nan"), float("inf")
    for call, told in (
        *((lambda steps=steps: session.advance(steps), "steps: .*whole number") for steps in (0, -1, 1.5, "2", None)),
        (lambda: session.take([], -1), r"steps: .*at least 0 .*\(found -1\)"),
        (lambda: session.take(["x"]), r"command: give a command.*found str"),
        (lambda: session.do({"kind": "undo"}), "parse_command.*found dict"),
        (lambda: session.do(None), "None"),
        (lambda: session.begin_cut(Undo()), r"give a Cut \(found Undo\)"),
        (lambda: session.begin_cut(None), r"give a Cut \(found None\)"),
        *((lambda s=s: session.rewind(s), rf"seconds: .*\(found {s}\)") for s in (nan, inf, -1, None)),
        (lambda: session.go_to(1.5), "step: must be a whole number"),
        (lambda: list(session.play("x")), "step: must be a whole number"),
    ):
        with pytest.raises(SimulationError, match=told):
            call()
    assert fingerprint(session.simulation) == before
    assert session.advance(np.int64(2)).step == 22
    assert session.take([], 2.0).step == 24


def _done(session):
    """Grabs, steps and a probe, with the fingerprint after each."""
    session.do(CloseGrab(name="left", center_mm=INSIDE, radius_mm=3.0))
    session.advance(10)
    session.do(LeadGrab(name="left", offset_mm=(0.0, 0.0, 1.0)))
    session.advance(10)
    return fingerprint(session.simulation)


def test_what_was_taken_back_is_a_branch_once_the_session_goes_on_another_way(tmp_path):
    session = OperatingSession(block_simulation())
    with Recorder(session, tmp_path / "a.recording"):
        session.advance(10)
        grabbed = _done(session)
        session.undo()
        assert session.branches == ()
        # time that goes on leaves it
        session.advance(5)
        (branch,) = session.branches
        assert (branch.start_step, branch.end_step, branch.acts) == (10, 30, (CloseGrab,))
        session.do(Mark(name="elsewhere"))
        session.advance(5)
        elsewhere = fingerprint(session.simulation)
        # another one that begins before it
        session.go_to(4)
        session.do(CloseGrab(name="right", center_mm=INSIDE, radius_mm=3.0))
        session.advance(3)
        righted = fingerprint(session.simulation)
        assert [one.start_step for one in session.branches] == [10]
        # it is known again, and comes to the same bytes; what was known is left in its place
        session.take_up(branch.number)
        assert (session.step_count, session.end_step) == (10, 30)
        session.go_to(30)
        assert fingerprint(session.simulation) == grabbed
        (other,) = session.branches
        assert (other.acts, other.end_step) == ((CloseGrab,), 7)
        session.take_up(other.number)
        session.go_to(7)
        assert fingerprint(session.simulation) == righted
        with pytest.raises(SimulationError, match="no such branch"):
            session.take_up(other.number)
        (branch,) = session.branches
        session.take_up(branch.number)
        session.go_to(30)
        entries = list(session.entries)
    # what was recorded is the history as it came to be
    assert elsewhere not in (grabbed, righted)
    recording = open_recording(tmp_path / "a.recording")
    assert list(recording.entries) == entries
    assert check_recording(tmp_path / "a.recording") == []
    again = load_session(recording, block_model())
    for _ in again.play():
        pass
    assert again.deviations == []
    assert fingerprint(again.simulation) == grabbed
    # a recording has what it holds: there is nothing to be kept
    again.undo()
    again.advance(1)
    assert again.branches == ()


@settings(max_examples=30, deadline=None)
@given(data=st.data())
def test_no_way_is_lost_and_each_comes_to_its_bytes(data):
    """Going back and on at random: every end that was left is come to again by its branch."""
    session = OperatingSession(
        block_simulation(), snapshot_every_s=data.draw(st.sampled_from([0.0, 0.01, float("inf")]))
    )
    ends, left = {}, set()
    for number in range(data.draw(st.integers(2, 6))):
        last = _last_probe(session.entries)
        session.go_to(data.draw(st.integers(0, session.end_step)))
        if last != _last_probe(session.entries[: session.position]):
            left.add(last)
        session.do(BringProbe(name=str(number), center_mm=(0.0, 0.0, 90.0 + number), semi_axes_mm=(1.0, 1.0, 1.0)))
        session.advance(data.draw(st.integers(1, 6)))
        ends[number] = session.step_count, fingerprint(session.simulation)
    left.add(_last_probe(session.entries))
    found = {}
    # the one that was left first, again and again: so each is taken up
    for _ in range(2 * len(ends)):
        session.go_to(session.end_step)
        found[_last_probe(session.entries)] = session.step_count, fingerprint(session.simulation)
        if session.branches:
            session.take_up(session.branches[-1].number)
    assert set(found) == left
    for number in left:
        assert found[number] == ends[number]


@pytest.mark.parametrize("undone_most", [1, 3])
def test_of_many_ways_the_latest_are_kept(undone_most):
    """Taken back again and again; with three at once branches lie on each other."""
    session, drawn = OperatingSession(block_simulation()), random.Random(1)
    for number in range(3 * MOST_BRANCHES):
        session.do(BringProbe(name=str(number), center_mm=(0.0, 0.0, 90.0 + number), semi_axes_mm=(1.0, 1.0, 1.0)))
        session.advance(1)
        for _ in range(min(drawn.randint(1, undone_most), len(session.simulation.instruments))):
            session.undo()
    numbers = [one.number for one in session.branches]
    assert 0.5 * MOST_BRANCHES < len(numbers) <= MOST_BRANCHES
    assert numbers == sorted(numbers, reverse=True)
    # the oldest one first: it makes room for what is left by that
    for one in reversed(numbers):
        if one in {branch.number for branch in session.branches}:
            session.take_up(one)
            session.go_to(session.end_step)
            assert len(session.branches) <= MOST_BRANCHES


@pytest.mark.parametrize("is_nested", [False, True])
def test_the_oldest_way_is_taken_up_where_there_are_as_many_as_are_kept(is_nested):
    """What is known ahead is left by it, and there is room for one branch, as it is none itself any more."""
    session = OperatingSession(block_simulation())

    def bring(number):
        session.do(BringProbe(name=str(number), center_mm=(0.0, 0.0, 90.0 + number), semi_axes_mm=(1.0, 1.0, 1.0)))
        session.advance(1)

    if is_nested:
        # the oldest lies on the one after it
        bring(200)
        bring(201)
        session.undo()
        bring(202)
        session.undo()
        session.undo()
    for number in range(MOST_BRANCHES - 2 * is_nested):
        bring(number)
        session.undo()
    bring(100)
    branches = session.branches
    assert len(branches) == MOST_BRANCHES
    assert (branches[-1].on is not None) == is_nested
    session.take_up(branches[-1].number)
    session.go_to(session.end_step)
    assert [one.name for one in session.simulation.instruments] == (["200", "201"] if is_nested else ["0"])
    assert {one.number for one in branches[:-1]} - {one.number for one in session.branches} == (
        {branches[-2].number} if is_nested else set()
    )
    assert len(session.branches) == MOST_BRANCHES


def _last_probe(entries):
    return max((int(one.command.name) for one in entries if isinstance(one.command, BringProbe)), default=-1)
