"""Excision: a piece that was cut free is taken out, does not come back by later cuts, and is undone to the byte."""

from __future__ import annotations

import numpy as np
import pytest

from heartcase.schemas.errors import SimulationError
from heartcase.schemas.recording.commands import Advance, Cut, Excise, Redo, Undo
from heartcase.schemas.recording.suture_commands import PlaceStitch
from heartcase.simulator.session.operating_session import OperatingSession
from heartcase.simulator.session.perform import changed_lattice
from heartcase.simulator.simulation import Simulation
from heartcase.simulator.surface_splitting.free_parts import cut_picking
from tests.simulator.surface_splitting.surfaces import block, box, check_closed, hung, volume

SHAPE = (9, 6, 6)
MODEL = block(SHAPE)
MM = MODEL.cell_mm
END = (8.9 * MM, 3 * MM, 3 * MM)


def across(x: float, name: str = "blade") -> Cut:
    """A cut through all of the block at right angles to x [cells]."""
    low, high = -2 * MM, 8 * MM
    poses = (((x * MM, low, low), (x * MM, low, high)), ((x * MM, high, low), (x * MM, high, high)))
    return Cut(name=name, poses_mm=poses, at_rest=True)


def along(y: float) -> Cut:
    """A cut at right angles to y [cells] from x = 5 cells on."""
    low, high = -2 * MM, 8 * MM
    poses = (((5 * MM, y * MM, low), (5 * MM, y * MM, high)), ((11 * MM, y * MM, low), (11 * MM, y * MM, high)))
    return Cut(name="along", poses_mm=poses, at_rest=True)


def session(backend="cpu") -> OperatingSession:
    surface = hung(MODEL, *box(SHAPE, np.array(SHAPE, float)))
    return OperatingSession(Simulation(MODEL, surface=surface, picking=cut_picking(MODEL), backend=backend))


def shown_ml(simulation: Simulation) -> float:
    surface = simulation.surface
    return volume(surface.rest_mm.astype(float), surface.triangles) / 1000.0


@pytest.mark.parametrize("backend", ["cpu", "reference"])
def test_a_piece_that_was_cut_free_is_gone_for_eyes_hands_probes_and_later_cuts(backend):
    operated = session(backend)
    simulation = operated.simulation
    operated.do(across(6.4))
    whole = shown_ml(simulation)
    operated.do(Excise(place_mm=END))
    gone = 2.6 * 36 * MM**3 / 1000.0
    # Of a cell's tissue the lattice knows eighths.
    in_cells = 2.625 * 36 * MM**3 / 1000.0
    assert simulation.cuts.excised_ml == pytest.approx(in_cells, rel=1e-6)
    assert whole - shown_ml(simulation) == pytest.approx(gone, rel=1e-3)
    for seen in (simulation.surface, simulation.picking):
        triangles = simulation.split.weld[seen.triangles] if seen is simulation.surface else seen.triangles
        check_closed(triangles)
    for _ in range(2):
        with pytest.raises(SimulationError):
            simulation.grab(END, 4.0)
        with pytest.raises(SimulationError, match="no tissue within"):
            simulation.place(END)
        probe = simulation.probe(END, (4.0, 4.0, 4.0))
        simulation.step(5)
        np.testing.assert_array_equal(simulation.force_on(probe), 0.0)
        simulation.withdraw(probe)
        # A cut through what is left and what is gone leaves it gone, and adds none of its walls.
        operated.do(along(2.2))
        corners = simulation.cuts.excised[simulation.model.cell_corners]
        assert (corners.all(axis=1) == corners.any(axis=1)).all()
        assert simulation.cuts.excised_ml == pytest.approx(in_cells, rel=1e-6)
        assert shown_ml(simulation) == pytest.approx(whole - gone, rel=1e-3)
        assert simulation.surface.rest_mm[simulation.surface.triangles][..., 0].max() <= 6.4 * MM + 1e-3


def test_undo_and_redo_give_the_same_bytes_and_the_lattice_follows_from_the_commands():
    operated = session()
    simulation = operated.simulation
    operated.do(across(6.4))
    operated.do(Advance(steps=10))

    def moment():
        return (
            simulation.state.displacement.tobytes(),
            simulation.surface.triangles.tobytes(),
            simulation.surface_now().vertices_mm.tobytes(),
            simulation.model.node_is_fixed.tobytes(),
        )

    before = moment()
    operated.do(Excise(place_mm=END))
    operated.do(Advance(steps=10))
    after = moment()
    operated.do(Undo())
    assert moment() == before
    operated.do(Redo())
    operated.do(Advance(steps=10))
    assert moment() == after
    operated.do(across(3.0, "other"))
    model, cuts = MODEL, operated.simulation.nothing_cut()
    for entry in operated.entries:
        model, cuts = changed_lattice(model, cuts, entry.command, step_s=simulation.step_s)
    np.testing.assert_array_equal(model.node_is_fixed, simulation.model.node_is_fixed)
    np.testing.assert_array_equal(model.node_index, simulation.model.node_index)
    np.testing.assert_array_equal(cuts.excised, simulation.cuts.excised)


def test_what_is_held_or_hangs_together_with_the_heart_is_not_taken_out():
    operated = session()
    simulation = operated.simulation
    with pytest.raises(SimulationError, match="nothing is cut"):
        operated.do(Excise(place_mm=END))
    operated.do(across(6.4))
    before = simulation.surface.triangles.tobytes()
    with pytest.raises(SimulationError, match="hangs together with the rest"):
        operated.do(Excise(place_mm=(0.0, 3 * MM, 3 * MM)))
    hand = simulation.grab(END, 6.0, name="left hand")
    operated.do(PlaceStitch(name="a thread", places_mm=(END, (2 * MM, 3 * MM, 6 * MM))))
    with pytest.raises(SimulationError, match="held by left hand, a thread"):
        operated.do(Excise(place_mm=END))
    assert simulation.surface.triangles.tobytes() == before
    simulation.release(hand)


def test_a_blade_passes_where_a_piece_was():
    operated = session()
    simulation = operated.simulation
    operated.do(across(6.4))
    operated.do(Excise(place_mm=END))
    hand = simulation.grab((0.5 * MM, 3 * MM, 3 * MM), 6.0)
    simulation.lead(hand, (1.0, 0.0, 0.0))
    simulation.step(40)
    poses = [[(8 * MM, -5.0, -5.0), (8 * MM, -5.0, 8 * MM)], [(8 * MM, 8 * MM, -5.0), (8 * MM, 8 * MM, 8 * MM)]]
    assert np.isnan(simulation.rest_poses_mm(poses)).all()
