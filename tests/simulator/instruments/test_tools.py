"""Forceps, retractors and scissors: whom they hold, what they press and pull with, what they cut, and their history."""

from __future__ import annotations

import numpy as np
import pytest

from heartcase.schemas.errors import SimulationError
from heartcase.schemas.recording.commands import (
    Advance,
    BringScissors,
    CloseForceps,
    CloseRetractor,
    Cut,
    LeadGrab,
    OpenGrab,
    PlaceScissors,
    Snip,
    SqueezeForceps,
    Undo,
    WithdrawScissors,
)
from heartcase.schemas.recording.reader import open_recording
from heartcase.simulator.session.operating_session import OperatingSession
from heartcase.simulator.session.recorder import Recorder
from heartcase.simulator.session.replay import load_session
from heartcase.simulator.session.script import parse_script, run_script
from heartcase.simulator.simulation import Simulation
from tests.simulator.lattices import block

CELL_MM = 2.0
E_KPA = 30.0


def slab():
    """A wall of 10 x 8 x 3 cells that is fixed at both ends along i, and the frame of its index space, mm."""
    model = block(10, 8, 3, cell_mm=CELL_MM, stiffness_kpa=E_KPA)
    model.node_is_fixed[(model.node_index[:, 0] == 0) | (model.node_index[:, 0] == 10)] = True
    return model


def at(model, *node_index):
    """LPS mm of places in the frame of the nodes [cells]."""
    return model.geometry.index_to_world(np.asarray(node_index, dtype=float) - 0.5)


def as_tuples(points):
    return tuple(map(tuple, np.asarray(points, dtype=float).tolist()))


def cut_through(model, i=5.03, low=1.6, high=6.4):
    """Poses of a blade through the slab at ``i``, between ``low`` and ``high`` along j."""
    return [at(model, [i, low, z], [i, high, z]) for z in (-1.0, 4.0)]


def pieces(model):
    """Number of what hangs together by springs or cells."""
    label = np.arange(model.node_count)
    while True:
        least = label.copy()
        of_cells = label[model.cell_corners].min(axis=1)
        np.minimum.at(least, model.cell_corners.ravel(), np.repeat(of_cells, 8))
        if (least == label).all():
            return len(np.unique(label))
        label = least


def test_forceps_press_with_the_stress_of_uniaxial_strain_times_their_area():
    """All nodes are between the jaws: stress is (lambda + 2 mu) strain, with lambda = mu = E / 2.5."""
    model = block(4, 4, 4, cell_mm=CELL_MM, stiffness_kpa=E_KPA)
    simulation = Simulation(model, sleep_mm=0)
    tip = at(model, 2.0, 4.2, 2.0)
    forceps = simulation.forceps(tip, (0, 1, 0), (0, 0, 1), length_mm=8.8, width_mm=8.8, opening_mm=12.0)
    assert len(forceps.nodes) == model.node_count
    assert forceps.thickness == pytest.approx(4.0, rel=1e-4)
    simulation.step(5)
    assert abs(simulation.pinch_force_n(forceps)) < 1e-5
    strain = 0.01
    simulation.squeeze(forceps, 4 * CELL_MM * (1 - strain))
    simulation.step(20)
    expected_n = 3.0 * (E_KPA * 1e3 / 2.5) * strain * (4 * CELL_MM * 1e-3) ** 2
    assert simulation.pinch_force_n(forceps) == pytest.approx(expected_n, rel=0.03)
    # Jaws that pinch pull at nothing.
    assert np.linalg.norm(simulation.force_on(forceps)) < 1e-3 * expected_n


def test_forceps_over_an_incision_hold_the_tissue_of_one_side_alone():
    model = slab()
    simulation = Simulation(model, sleep_mm=0)
    simulation.cut(cut_through(model, low=-1.0, high=9.0))
    # The jaws lie across the incision, their middle half a cell to the left of it.
    tip = at(model, 4.5, 5.5, 1.5)
    forceps = simulation.forceps(tip, (0, 1, 0), (0, 0, 1), length_mm=6.0, width_mm=6.0, opening_mm=8.0)
    simulation.lead(forceps, (0.0, 0.0, 4.0))
    simulation.step(200)
    cut = simulation.model
    lift = simulation.displacement_mm()[:, 2]
    assert lift[forceps.nodes] == pytest.approx(4.0, abs=1e-4)
    tissue_i = cut.node_index[cut.cell_corners].mean(axis=1)[:, 0] + cut.cell_moments[:, 0]
    right = np.unique(cut.cell_corners[tissue_i > 5.03])
    assert np.abs(lift[right]).max() < 1e-6


@pytest.mark.parametrize("limit_n_mm", [0.05, None])
def test_retractors_hold_an_incision_open_and_come_to_rest_at_their_limit(limit_n_mm):
    model = slab()
    simulation = Simulation(model, sleep_mm=0, damping_per_s=60.0)
    simulation.cut(cut_through(model))
    line = at(model, [5.03, 2.0, 3.0], [5.03, 6.0, 3.0])
    pads = {"depth_mm": 2.5, "stiffness_n_mm2": 1.0, "limit_n_mm": limit_n_mm}
    hands = {sign: simulation.retractor(line, (sign, 0, 0), name=f"lip {sign}", **pads) for sign in (-1, 1)}
    assert not np.intersect1d(hands[-1].nodes, hands[1].nodes).size
    for row in range(1, 161):
        for sign, hand in hands.items():
            simulation.lead(hand, (sign * min(3.0, 0.1 * row), 0.0, 0.0))
        simulation.step(20)
    moved = {sign: simulation.displacement_mm()[hand.nodes, 0].mean() for sign, hand in hands.items()}
    forces = {sign: simulation.force_on(hand) for sign, hand in hands.items()}
    # They are led almost in mirror image: the cut lies 0.03 cells beside the middle.
    assert forces[-1][0] == pytest.approx(-forces[1][0], rel=0.08)
    length_mm = 4.0 * CELL_MM
    pull_n = np.linalg.norm(forces[1])
    if limit_n_mm is None:
        assert min(-moved[-1], moved[1]) > 2.5
        assert pull_n > 2.0 * 0.05 * length_mm
    else:
        assert pull_n == pytest.approx(limit_n_mm * length_mm, rel=0.05)
        assert 0.5 < min(-moved[-1], moved[1]) < max(-moved[-1], moved[1]) < 2.0
    pulls = simulation.retraction_n_mm(hands[1])
    assert pulls.sum() * length_mm / len(pulls) >= 0.99 * pull_n
    simulation.release(hands[1])
    assert not simulation.retraction_n_mm(hands[1]).any()


def test_scissors_cut_as_far_as_their_jaws_have_met():
    model = block(10, 3, 3, cell_mm=CELL_MM)
    simulation = Simulation(model, sleep_mm=0)
    hinge = at(model, 5.03, -2.5, 1.5)
    scissors = simulation.scissors(hinge, (0, 1, 0), (0, 0, 1), length_mm=14.0, opening_deg=90.0)
    mass_kg = model.node_mass.sum()
    simulation.snip(scissors, 40.0)
    # 5 / 9 of the way from the hinge: 3.9 cells, of which 1.4 in the tissue.
    corners = simulation.model.cell_corners
    cut_cells = simulation.model.cell_coverage < 0.99
    assert cut_cells.any()
    assert simulation.model.node_index[corners[cut_cells]].mean(axis=1)[:, 1].max() < 1.6
    assert pieces(simulation.model) == 1
    simulation.snip(scissors, 80.0)  # they open: nothing is cut
    assert scissors.angle == pytest.approx(np.radians(80.0))
    simulation.snip(scissors, 0.0)
    assert pieces(simulation.model) == 2
    assert simulation.model.node_mass.sum() == pytest.approx(mass_kg, rel=1e-6)
    with pytest.raises(SimulationError, match="open to 90 degrees"):
        simulation.snip(scissors, 95.0)


def test_what_cannot_be_held_or_brought_is_refused_with_all_that_is_wrong():
    simulation = Simulation(slab(), sleep_mm=0)
    with pytest.raises(SimulationError) as caught:
        simulation.forceps((np.nan, 0, 0), (0, 0, 1), (0, 0, 1), length_mm=-1.0)
    assert len(caught.value.problems) >= 3
    with pytest.raises(SimulationError, match="no tissue between the jaws"):
        simulation.forceps((500.0, 0, 0), (0, 1, 0), (0, 0, 1))
    with pytest.raises(SimulationError, match="on that side"):
        simulation.retractor([(500.0, 0, 0), (500.0, 9, 0)], (1, 0, 0))
    with pytest.raises(SimulationError) as caught:
        simulation.retractor([(0.0, 0, 0)], (0, 0, 0), depth_mm=0.0)
    assert len(caught.value.problems) == 3
    with pytest.raises(SimulationError, match="at most 90 degrees"):
        simulation.scissors((0, 0, 0), (0, 1, 0), (0, 0, 1), opening_deg=120.0)
    assert simulation.instruments == ()


def operate(session, model):
    """An incision that a retractor and forceps hold, and a snip."""
    session.do(Cut(poses_mm=tuple(as_tuples(pose) for pose in cut_through(model))))
    line = at(model, [5.03, 2.0, 3.0], [5.03, 6.0, 3.0])
    session.do(CloseRetractor(name="lip", line_mm=as_tuples(line), side=(1.0, 0.0, 0.0), depth_mm=2.5))
    tip = at(model, 3.8, 4.5, 1.5)
    jaws = {"direction": (0.0, 1.0, 0.0), "closing": (0.0, 0.0, 1.0)}
    session.do(CloseForceps(name="pick", tip_mm=tuple(tip.tolist()), length_mm=5.0, gap_mm=5.4, **jaws))
    session.do(LeadGrab(name="lip", offset_mm=(1.0, 0.0, 0.3)))
    session.do(Advance(steps=40))
    session.do(LeadGrab(name="pick", offset_mm=(-1.0, 0.0, 0.5)))
    session.do(SqueezeForceps(name="pick", gap_mm=4.6))
    session.do(Advance(steps=40))
    hinge = at(model, 2.03, -1.0, 1.5)
    session.do(BringScissors(name="snips", hinge_mm=tuple(at(model, 9.0, 9.0, 9.0).tolist()), length_mm=8.0, **jaws))
    session.do(PlaceScissors(name="snips", hinge_mm=tuple(hinge.tolist()), **jaws))
    session.do(Advance(steps=10))
    session.do(Snip(name="snips", angle_deg=10.0))
    session.do(Advance(steps=30))
    session.do(WithdrawScissors(name="snips"))
    session.do(OpenGrab(name="pick"))
    session.do(Advance(steps=30))


def bytes_of(simulation):
    return simulation.model.node_count, simulation.state.displacement.tobytes(), simulation.state.velocity.tobytes()


def test_their_commands_are_taken_back_recorded_and_repeated_to_the_byte(tmp_path):
    model = slab()
    session = OperatingSession(Simulation(model, sleep_mm=0))
    with Recorder(session, tmp_path / "a.recording", state_every_s=25 * session.simulation.step_s):
        operate(session, model)
    end = bytes_of(session.simulation)
    frame = session.frame()
    assert frame.instruments["lip"].kind == "retractor"
    assert frame.instruments["lip"].pull_n_mm.size
    session.do(Undo())
    shown = session.frame().instruments
    assert {one.kind for one in shown.values()} == {"retractor", "forceps"}
    assert shown["pick"].pinch_n > 0.0
    for _ in range(3):
        session.do(Undo())
    assert "snips" not in session.frame().instruments
    session.go_to(session.end_step)
    assert bytes_of(session.simulation) == end

    recording = open_recording(tmp_path / "a.recording")
    again = load_session(recording, model)
    for _ in again.play():
        pass
    assert again.deviations == []
    assert bytes_of(again.simulation) == end
    for step in (55, 85, 110):  # by stored states, with instruments in the tissue, and into the middle of a row
        again = load_session(recording, model)
        again.go_to(step)
        again.go_to(again.end_step)
        assert bytes_of(again.simulation) == end


def test_a_script_holds_and_snips():
    model = slab()
    line = [list(point) for point in as_tuples(at(model, [5.03, 2.0, 3.0], [5.03, 6.0, 3.0]))]
    tip, hinge = (as_tuples([at(model, *place)])[0] for place in ((3.8, 4.5, 1.5), (2.03, -1.0, 1.5)))
    text = f"""
heartcase_script = 1
seconds = 0.06
[[cuts]]
time_s = 0.0
poses_mm = {[[list(point) for point in as_tuples(pose)] for pose in cut_through(model)]}
[[retractors]]
name = "lip"
line_mm = {line}
side = [1.0, 0.0, 0.0]
depth_mm = 2.5
start_s = 0.005
path = [{{ time_s = 0.03, offset_mm = [1.0, 0.0, 0.0] }}]
[[forceps]]
name = "pick"
tip_mm = {list(tip)}
direction = [0.0, 1.0, 0.0]
closing = [0.0, 0.0, 1.0]
length_mm = 5.0
gap_mm = 5.0
start_s = 0.005
close_s = 0.02
release_s = 0.05
[[scissors]]
hinge_mm = {list(hinge)}
direction = [0.0, 1.0, 0.0]
closing = [0.0, 0.0, 1.0]
length_mm = 8.0
snips = [{{ time_s = 0.03, seconds = 0.01, angle_deg = 0.0 }}]
"""
    session = OperatingSession(Simulation(model, sleep_mm=0))
    summary = run_script(session, parse_script(text))
    assert summary.peak_force_n["lip"] > 0.0
    kinds = [entry.command.kind for entry in session.entries]
    assert {"cut", "close_retractor", "close_forceps", "squeeze_forceps", "snip", "open_grab"} <= set(kinds)
    assert session.simulation.model.node_count > model.node_count
    assert session.simulation.inverted_cell_count() == 0
