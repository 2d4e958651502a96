"""Cuts that are worked out ahead: motion goes on, and every byte is that of cuts made at the same moment."""

from __future__ import annotations

import threading

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from heartcase.schemas.errors import SimulationError
from heartcase.schemas.recording.commands import Cut, Undo
from heartcase.schemas.recording.reader import open_recording
from heartcase.simulator.session.operating_session import OperatingSession
from heartcase.simulator.session.perform import resolved
from heartcase.simulator.session.recorder import Recorder
from heartcase.simulator.session.replay import load_session
from heartcase.simulator.simulation import Simulation
from heartcase.simulator.surface_splitting.free_parts import cut_picking
from heartcase.simulator.tissue import coming_cuts
from tests.simulator.cutting.test_cuts import across_bar, blade_mm
from tests.simulator.session.test_recorded_cuts import as_tuples, bar, bytes_of, pull
from tests.simulator.surface_splitting.surfaces import box, hung


@pytest.fixture
def gate(monkeypatch):
    """Holds the thread that works cuts out until it is opened."""
    opened = threading.Event()
    work = coming_cuts.cut_further

    def held(*arguments):
        if threading.current_thread() is not threading.main_thread():
            assert opened.wait(60)
        return work(*arguments)

    monkeypatch.setattr(coming_cuts, "cut_further", held)
    yield opened
    opened.set()


def cut(model, place=4.4, depth=2.5):
    return Cut(poses_mm=as_tuples(across_bar(model, place, depth)))


def pulled(model):
    session = OperatingSession(Simulation(model, sleep_mm=0))
    for command in pull(model):
        session.do(command)
    return session


def test_motion_goes_on_and_the_cut_is_recorded_where_it_was_made(gate, tmp_path):
    model = bar()
    session = pulled(model)
    with Recorder(session, tmp_path / "cut.recording"):
        frame = session.take([cut(model), cut(model, 6.3, 1.5)], 10, cuts_soon=True)
        assert (frame.coming_cuts, frame.topology, frame.step) == (2, (), 50)
        frame = session.take([], 10)
        assert (frame.coming_cuts, frame.topology, frame.step) == (2, (), 60)
        gate.set()
        session.make_cuts(wait=True)
        frame = session.take([], 30)
        assert frame.coming_cuts == 0
        assert [change.kind for change in frame.topology] == ["cut", "cut"]
        assert frame.model.node_count > model.node_count
    made = [entry.step for entry in session.entries if isinstance(entry.command, Cut)]
    assert made == [60, 60]
    end = bytes_of(session.simulation)

    again = load_session(open_recording(tmp_path / "cut.recording"), model)
    assert len(list(again.play())) > 0
    assert again.deviations == []
    assert bytes_of(again.simulation) == end


def test_going_back_makes_the_cuts_before(gate):
    model = bar()
    session = pulled(model)
    before = bytes_of(session.simulation)
    session.begin_cut(cut(model))
    gate.set()
    session.do(Undo())
    assert bytes_of(session.simulation) == before
    session.redo()
    assert session.simulation.model.node_count > model.node_count


def test_another_cut_meanwhile_comes_after(gate):
    model = bar()
    session = pulled(model)
    session.begin_cut(cut(model))
    gate.set()
    session.do(cut(model, 6.3, 1.5))
    plain = pulled(model)
    for command in (cut(model), cut(model, 6.3, 1.5)):
        plain.do(command)
    assert bytes_of(session.simulation) == bytes_of(plain.simulation)
    assert session.entries == plain.entries


def test_a_cut_that_cannot_be_made_is_told_in_the_frame(gate):
    model = bar()
    session = pulled(model)
    session.begin_cut(cut(model))
    session.simulation.remove_springs(np.arange(model.spring_count) == 0)
    gate.set()
    session.make_cuts(wait=True)
    frame = session.frame()
    assert [refusal.command.kind for refusal in frame.refused] == ["cut"]
    assert frame.model.node_count == model.node_count
    with pytest.raises(SimulationError, match="near it"):
        session.begin_cut(Cut(poses_mm=((((1e9,) * 3,) * 2),) * 2))


def test_what_a_blade_goes_on_with_meanwhile_is_one_cut(gate, tmp_path):
    model = bar()
    session = pulled(model)
    x = np.linspace(-1.0, 5.0, 5)
    edges = as_tuples(blade_mm(model, [[(4.4, y, 5.0), (4.4, y, 1.5)] for y in x]))
    with Recorder(session, tmp_path / "stroke.recording"):
        for number in range(4):
            frame = session.take([Cut(poses_mm=edges[number : number + 2])], 5, cuts_soon=True)
        assert frame.coming_cuts == 2
        gate.set()
        session.make_cuts(wait=True)
        session.advance(20)
    made = [entry.command for entry in session.entries if isinstance(entry.command, Cut)]
    assert len(made) == 2
    assert made[1].poses_mm[0] == made[0].poses_mm[-1]
    # Of each sample all is kept that it met of the tissue, in its order.
    plain = pulled(model)
    found = []
    for number in range(4):
        found += resolved(plain.simulation, Cut(poses_mm=edges[number : number + 2])).poses_mm[number > 1 :]
        plain.advance(5)
    joined = [*made[0].poses_mm, *made[1].poses_mm]
    assert set(found) <= set(joined)
    again = load_session(open_recording(tmp_path / "stroke.recording"), model)
    assert len(list(again.play())) > 0
    assert again.deviations == []
    assert bytes_of(again.simulation) == bytes_of(session.simulation)


def test_another_blade_is_a_cut_of_its_own(gate):
    model = bar()
    session = pulled(model)
    a, b, c, d = as_tuples(blade_mm(model, [[(4.4, y, 5.0), (4.4, y, 1.5)] for y in (-1.0, 1.0, 3.0, 5.0)]))
    for poses, name in (((a, b), "one"), ((b, c), "one"), ((c, d), "other"), ((d, c), "other"), ((a, b), "other")):
        session.begin_cut(Cut(poses_mm=poses, name=name, at_rest=True))
    gate.set()
    session.make_cuts(wait=True)
    made = [entry.command for entry in session.entries if isinstance(entry.command, Cut)]
    assert [(cut.name, cut.poses_mm) for cut in made] == [
        ("one", (a, b)),
        ("one", (b, c)),
        ("other", (c, d, c)),
        ("other", (a, b)),
    ]


blades = st.lists(st.tuples(st.floats(1.5, 7.5), st.floats(0.5, 4.5)), min_size=1, max_size=3)


@settings(max_examples=15, deadline=None)
@given(blades, st.integers(0, 2), st.booleans())
def test_cuts_that_were_begun_are_those_that_were_not(found, changed, joins):
    model = bar()
    surface = hung(model, *box((9, 4, 4), np.array((9.0, 4.0, 4.0))))
    plain, ahead = (Simulation(model, surface=surface, picking=cut_picking(model), sleep_mm=0) for _ in range(2))
    poses = [across_bar(model, *blade) for blade in found]
    for one in poses:
        ahead.begin_cut(one, at_rest=True)
    for simulation in (plain, ahead):
        simulation.step(3)
        if joins:
            simulation.add_springs([[0, 20]], 0.5)
        for number, one in enumerate(poses):
            # Cuts that are made in another order than begun are worked out again.
            simulation.cut(poses[-1] if number == changed else one, at_rest=True)
            simulation.step(5)
    for show in (Simulation.surface_now, Simulation.picking_now):
        assert show(ahead).vertices_mm.tobytes() == show(plain).vertices_mm.tobytes()
    assert bytes_of(ahead) == bytes_of(plain)
    for name in ("spring_nodes", "spring_weight", "node_mass", "cell_corners"):
        np.testing.assert_array_equal(getattr(ahead.model, name), getattr(plain.model, name), strict=True)
    assert ahead.model.explicit.nodes.tobytes() == plain.model.explicit.nodes.tobytes()
