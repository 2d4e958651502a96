"""What a simulation is given wrongly: one clear error each, and nothing is done."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from heartcase.schemas.bundle.lattice import cell_nodes
from heartcase.schemas.errors import BundleError, RecordingError, SimulationError, UsageError
from heartcase.schemas.recording.header import RecordingParent
from heartcase.simulator.cutting.tissue_samples import TissueSamples
from heartcase.simulator.lattice.model import make_model
from heartcase.simulator.load import load_case
from heartcase.simulator.session.operating_session import OperatingSession
from heartcase.simulator.session.recorder import Recorder
from heartcase.simulator.simulation import Simulation
from heartcase.simulator.surface.write_surface import write_surface
from tests.simulator.lattices import block

GOLDEN = Path(__file__).parents[2] / "golden" / "lopsided.case"


@pytest.mark.parametrize(
    "steps", [np.nan, np.inf, 0.5, 1.5, np.float32(2), -1, 10**30, "a", None, np.array([2]), np.array(1.0)]
)
def test_steps_are_whole_numbers(steps):
    simulation = Simulation(block(2, 1, 1, fix_base=True), backend="reference")
    with pytest.raises(SimulationError, match="step_count: must be a whole number"):
        simulation.step(steps)
    assert simulation.step_count == 0
    simulation.step(np.int64(2))
    assert simulation.step_count == 2


@pytest.mark.parametrize("gravity", [(np.nan, 0, 0), (0, 0, -1e300), (0, 0), (0, 0, 0, 0), 9.81, ("a", 0, 0)])
def test_gravity_is_three_numbers(gravity):
    with pytest.raises(SimulationError, match="gravity_m_s2: gravity is three numbers"):
        Simulation(block(2, 1, 1), backend="reference", gravity_m_s2=gravity)


def test_instruments_are_given_numbers_and_taken_for_what_they_are():
    simulation = Simulation(block(4, 2, 2, fix_base=True), backend="reference")
    place = simulation.model.rest_positions_mm()[-1]
    hand, probe = simulation.grab(place, 5.0), simulation.probe(place + 20.0, 4.0)
    wrong = [
        lambda: simulation.grab(place, "a"),
        lambda: simulation.grab("abc", 5.0),
        lambda: simulation.grab([[1], [2, 3]], 5.0),
        lambda: simulation.lead(hand, (0, 0, 0), "x"),
        lambda: simulation.lead(hand, ("a", 0, 0)),
        lambda: simulation.lead(probe, (0, 0, 0)),
        lambda: simulation.probe(place, "x"),
        lambda: simulation.probe(place, 4.0, axis_mm="x"),
        lambda: simulation.move(hand, place),
        lambda: simulation.move(None, place),
        lambda: simulation.force_on(None),
        lambda: simulation.restore(None),
    ]
    for call in wrong:
        with pytest.raises(SimulationError):
            call()
    assert simulation.instruments == (hand, probe)
    simulation.release(hand)
    assert not simulation.force_on(hand).any()
    with pytest.raises(SimulationError, match="the hand has let go, or is not of this simulation"):
        simulation.lead(hand, (0, 0, 0))


def test_surfaces_are_of_the_lattice(case_path):
    case, other = load_case(case_path, needs=("surface", "picking", "tissue")), load_case(GOLDEN)
    Simulation(case.model, surface=case.surface, picking=case.picking, tissue=case.tissue, backend="reference")
    # of a lattice with fewer nodes, and of one with as many in other places
    for model in (other.model, block(12, 12, 12)):
        with pytest.raises(SimulationError) as raised:
            Simulation(model, surface=case.surface, picking=case.picking, backend="reference")
        assert [problem.place for problem in raised.value.problems] == ["surface", "picking"]
        assert "of another lattice" in str(raised.value)


def test_surfaces_stand_in_their_places(case_path):
    case = load_case(case_path, needs=("surface", "picking"))
    with pytest.raises(SimulationError) as raised:
        Simulation(case.model, surface=case.picking, picking=case.surface, tissue=case.surface, backend="reference")
    assert [problem.place for problem in raised.value.problems] == ["surface", "picking", "tissue"]
    Simulation(case.model, tissue=TissueSamples.everywhere(), backend="reference")


@pytest.mark.parametrize(
    "cells",
    [[[1, 2], [3, 4], [5, 6]], [0, 0, 0], [[0.7, 0, 0]], [[np.nan, 0, 0]], [[2**20, 0, 0]], "cells", [[1], [2, 3]]],
)
def test_cells_are_indices(cells):
    with pytest.raises(BundleError, match="cells: give the index"):
        cell_nodes(cells)
    with pytest.raises(SimulationError, match="cells: give the index"):
        make_model(cells)


def test_whole_numbers_of_any_kind_are_indices():
    for kind in (np.int8, np.uint16, np.int64, np.float32):
        nodes, corners = cell_nodes(np.array([[1, 2, 3]], dtype=kind))
        assert nodes.dtype == corners.dtype == np.int32
        assert nodes.min(axis=0).tolist() == [1, 2, 3]
    assert cell_nodes([])[0].shape == (0, 3)


@pytest.mark.parametrize(
    ("given", "place"),
    [
        ({"coverage": [1, 1]}, "coverage"),
        ({"stiffness_kpa": "soft"}, "stiffness_kpa"),
        ({"density_kg_m3": [1, 2, 3]}, "density_kg_m3"),
        ({"moments": [1, 2]}, "moments"),
        ({"cell_mm": -1.0}, "cell_mm"),
        ({"cell_mm": np.nan}, "cell_mm"),
    ],
)
def test_numbers_of_cells_have_their_shape(given, place):
    with pytest.raises(SimulationError, match=f"^{place}: "):
        make_model([[0, 0, 0]], **given)


def test_a_recording_is_of_its_case(case_path, tmp_path):
    case, other = load_case(case_path), load_case(GOLDEN)
    session = OperatingSession(Simulation(case.model, backend="reference"))
    far = RecordingParent(log_hash="0" * 64, step=5)
    for wrong, place in (
        ({"case": other.manifest}, "case"),
        ({"state_every_s": np.nan}, "state_every_s"),
        ({"state_every_s": -1.0}, "state_every_s"),
        ({"parent": far}, "parent"),
    ):
        with pytest.raises(RecordingError, match=f"^{place}: "):
            Recorder(session, tmp_path / "x.recording", **wrong)
        assert not list(tmp_path.iterdir())
    with Recorder(session, tmp_path / "x.recording", case=case.manifest, state_every_s=np.inf):
        session.advance(1)


@pytest.mark.parametrize("every", [np.nan, -1.0])
def test_snapshots_are_some_time_apart(every):
    with pytest.raises(SimulationError, match="snapshot_every_s: "):
        OperatingSession(Simulation(block(2, 1, 1), backend="reference"), snapshot_every_s=every)


@pytest.mark.parametrize("suffix", ["ply", "stl", "obj"])
@pytest.mark.parametrize(
    ("wrong", "place"),
    [
        ({"vertices_mm": np.zeros((4, 2), np.float32)}, "vertices_mm"),
        ({"vertices_mm": np.full((4, 3), np.nan, np.float32)}, "vertices_mm"),
        ({"normals": np.zeros((3, 3), np.float32)}, "normals"),
        ({"triangles": np.array([[0, 1, 4]])}, "triangles"),
        ({"triangles": np.array([[0, 1, -1]])}, "triangles"),
        ({"triangles": np.array([[0.0, 1.0, 2.0]])}, "triangles"),
        ({"triangles": np.array([0, 1, 2])}, "triangles"),
        ({"colours": np.zeros((1, 3))}, "colours"),
    ],
)
def test_a_surface_is_written_whole_or_not_at_all(tmp_path, suffix, wrong, place):
    mesh = {"vertices_mm": np.eye(4, 3, dtype=np.float32), "normals": np.eye(4, 3, dtype=np.float32)}
    mesh |= {"triangles": np.array([[0, 1, 2]])} | wrong
    with pytest.raises(UsageError, match=f"^{place}: "):
        write_surface(tmp_path / f"x.{suffix}", **mesh)
    assert not list(tmp_path.iterdir())
