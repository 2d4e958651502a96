"""Patches on moving tissue: a sheet's stiffness, forces that balance, the same bytes again, and nothing left behind."""

from __future__ import annotations

import json

import numpy as np
import pytest
from safetensors.numpy import load

from heartcase.schemas.errors import RecordingError, SimulationError
from heartcase.schemas.recording.commands import (
    CloseGrab,
    Cut,
    DrawStitch,
    PlacePatch,
    PlaceRow,
    TakeOutPatch,
    TieStitch,
    parse_command,
)
from heartcase.schemas.recording.reader import open_recording
from heartcase.simulator.lattice.moduli import ForceLaw
from heartcase.simulator.patching.flat_sheets import FlatSheet
from heartcase.simulator.patching.patches import patch_springs, with_patch
from heartcase.simulator.session.operating_session import OperatingSession
from heartcase.simulator.session.recorder import Recorder
from heartcase.simulator.session.replay import load_session
from heartcase.simulator.session.stored import snapshot_bytes, snapshot_from
from heartcase.simulator.simulation import Simulation
from heartcase.simulator.suturing.places import Place
from tests.simulator.lattices import block

BACKENDS = ("cpu", "reference")
ANGLE = np.arange(12) / 12 * 2 * np.pi
OUTLINE = np.stack([12 + 6 * np.cos(ANGLE), 12 + 6 * np.sin(ANGLE), np.full(12, 4.0)], axis=1)


def slab(backend="cpu", *, law="springs", damping_per_s=30.0, **options):
    """A slab of 24 x 24 x 4 mm that is held at two ends."""
    model = block(12, 12, 2, cell_mm=2.0).with_law(ForceLaw(law, 0.25 if law == "springs" else 0.4))
    model.node_is_fixed[np.isin(model.node_index[:, 0], (0, 12))] = True
    return Simulation(model, backend=backend, damping_per_s=damping_per_s, **options)


def hexagons(count):
    """A sheet of triangles of equal sides of 1 mm: a parallelogram of ``count`` by ``count``."""
    i, j = np.meshgrid(np.arange(count + 1), np.arange(count + 1))
    flat = np.stack([i + 0.5 * j, np.sqrt(0.75) * j], axis=-1).reshape(-1, 2)
    a = (i + (count + 1) * j)[:-1, :-1].ravel()
    triangles = np.concatenate([[a, a + 1, a + count + 1], [a + 1, a + count + 2, a + count + 1]], axis=1).T
    return FlatSheet(flat, np.column_stack([flat, 0 * flat[:, 0]]), triangles.astype(np.int32), 4 * count, 1.0, 1.0)


STRAINS = [(1e-4, 0.0, 0.0), (0.0, 1e-4, 0.0), (1e-4, 1e-4, 0.0), (0.0, 0.0, 1e-4), (1e-4, -5e-5, 3e-5)]


@pytest.mark.parametrize("strain", STRAINS)
def test_springs_of_equal_triangles_are_a_sheet_with_a_poissons_ratio_of_a_third(strain):
    """Energy at small strain, against plane stress: E t / (1 - v^2) (xx^2 + yy^2 + 2 v xx yy + 2 (1 - v) xy^2) / 2."""
    sheet, stiffness, ratio = hexagons(5), 7.0, 1 / 3
    edges, k, length = patch_springs(sheet, stiffness)
    xx, yy, xy = strain
    moved = sheet.flat_mm @ (np.eye(2) + np.array([(xx, xy), (xy, yy)]))
    stretch = np.linalg.norm(moved[edges[:, 1]] - moved[edges[:, 0]], axis=1) - length
    density = stiffness / (1 - ratio**2) * (xx**2 + yy**2 + 2 * ratio * xx * yy + 2 * (1 - ratio) * xy**2) / 2
    assert 0.5 * (k * stretch**2).sum() == pytest.approx(density * 25 * np.sqrt(0.75), rel=1e-3)


@pytest.mark.parametrize("backend", BACKENDS)
def test_a_patch_that_was_cut_small_pulls_at_the_tissue_and_comes_to_rest_in_balance(backend):
    simulation = slab(backend)
    patch = simulation.patch(OUTLINE, scale=0.9)
    start = simulation.patch_state(patch)
    assert start.forces_n == pytest.approx(0.0, abs=1e-9)
    assert start.stretch_most == pytest.approx(1 / 0.9, rel=1e-3)
    assert start.kind == "patch"
    np.testing.assert_allclose(start.vertices_mm[: len(start.stitches_mm)], start.stitches_mm, atol=1e-5)
    before, energies = simulation.displacement_mm(), []
    for _ in range(40 if backend == "cpu" else 12):
        energies.append(simulation.energy().total_j)
        simulation.step(100)
    assert (np.diff(energies) <= 1e-9 * energies[0]).all()
    now = simulation.patch_state(patch)
    assert 1.0 < now.stretch_most < 1.06
    assert (now.forces_n > 1e-3).all()
    # What the stitches of the rim pull at the patch with adds up to nothing, and all pull inward at the tissue.
    rim = now.vertices_mm[: len(now.stitches_mm)]
    way = rim - now.stitches_mm
    pull = now.forces_n[:, None] * way / np.linalg.norm(way, axis=1, keepdims=True)
    assert np.linalg.norm(pull.sum(axis=0)) < 0.05 * now.forces_n.sum()
    assert (np.einsum("sx,sx->s", pull, now.vertices_mm.mean(axis=0) - now.stitches_mm) > 0).all()
    tissue = slice(None, simulation.model.node_count - simulation.model.loose_count)
    assert np.linalg.norm(simulation.displacement_mm()[tissue] - before[tissue], axis=1).max() > 0.05


@pytest.mark.parametrize(("law", "step_count"), [("springs", 150), ("element", 40)])
def test_both_engines_of_the_host_come_to_the_same_patch(law, step_count):
    ends = []
    for backend in BACKENDS:
        simulation = slab(backend, law=law, sleep_mm=0.0)
        patch = simulation.patch(OUTLINE, scale=0.9)
        simulation.step(step_count)
        simulation.cut([[(12, -2, 6), (12, 26, 6)], [(12, -2, -2), (12, 26, -2)]], at_rest=True)
        simulation.step(step_count)
        ends.append(simulation.patch_state(patch))
    np.testing.assert_allclose(ends[0].forces_n, ends[1].forces_n, rtol=2e-3)
    np.testing.assert_allclose(ends[0].vertices_mm, ends[1].vertices_mm, atol=2e-3)


def test_a_patch_as_large_as_its_outline_pulls_at_nothing():
    simulation = slab()
    patch = simulation.patch(OUTLINE)
    simulation.step(500)
    assert simulation.patch_state(patch).forces_n.max() < 1e-6
    assert simulation.patch_state(patch).distortion < 1e-6
    assert np.abs(simulation.displacement_mm()[: -patch.node_count]).max() < 1e-4


def test_no_stiffness_makes_the_steps_unstable_and_mass_is_the_sheets_where_that_is_enough():
    """The largest eigenvalue of springs and masses of a patch alone, in the plane, against what the step allows."""
    for stiffness, is_own in ((1e-3, True), (100.0, False), (1e5, False)):
        simulation = slab(step_s=1e-4)
        patch = simulation.patch(OUTLINE, stiffness_n_m=stiffness)
        model, nodes = simulation.model, patch.nodes_in(simulation.model)
        springs = model.explicit
        ends = springs.nodes - nodes[0]
        matrix = np.zeros((len(nodes), len(nodes)))
        for (a, b), k in zip(ends, springs.stiffness, strict=True):
            matrix[[a, b, a, b], [a, b, b, a]] += np.array([k, k, -k, -k])
        root = 1 / np.sqrt(model.node_mass[nodes])
        assert np.linalg.eigvalsh(root[:, None] * matrix * root).max() <= springs.rate_bound(model.inverse_mass)
        assert simulation.step_limit_s > simulation.step_s
        own_g = patch.sheet.area_mm2 * 0.5 * 1.1e-3
        mass_g = simulation.patch_state(patch).mass_g
        assert mass_g == pytest.approx(own_g, rel=1e-5) if is_own else mass_g > 1.5 * own_g
        simulation.step(200)


def test_a_patch_holds_two_halves_together_and_is_carried_over_the_cut():
    simulation = slab(gravity_m_s2=(4.0, 0, 0))
    simulation.model.node_is_fixed[simulation.model.node_index[:, 0] == 12] = False
    simulation = Simulation(simulation.model, damping_per_s=30.0)
    patch = simulation.patch(OUTLINE, stiffness_n_m=50.0)
    moment = simulation.snapshot()
    simulation.cut([[(12, -2, 6), (12, 26, 6)], [(12, -2, -2), (12, 26, -2)]], at_rest=True)
    assert simulation.model.loose_count == patch.node_count
    state = simulation.patch_state(patch)
    np.testing.assert_allclose(state.vertices_mm[: len(patch.places)], state.stitches_mm, atol=1e-5)
    hand = simulation.grab((23, 12, 2), 5.0)
    simulation.lead(hand, (2.0, 0, 0))
    for _ in range(10):
        simulation.step(100)
    state = simulation.patch_state(patch)
    assert state.forces_n.max() > 5e-3
    # Across the cut the patch bears all that the hand pulls the free half with.
    assert simulation.force_on(hand)[0] < -1e-2
    left = state.stitches_mm[:, 0] < 12 + 1e-6
    way = state.vertices_mm[: len(left)] - state.stitches_mm
    pull = state.forces_n[:, None] * way / np.linalg.norm(way, axis=1, keepdims=True)
    assert pull[left].sum(axis=0)[0] == pytest.approx(-simulation.force_on(hand)[0], rel=0.1)
    simulation.restore(moment)
    simulation.step(10)
    assert simulation.patches == [patch]


def test_a_patch_that_is_taken_out_leaves_no_trace():
    simulation = slab()
    plain = simulation.model
    first, second = simulation.patch(OUTLINE), simulation.patch(OUTLINE - np.array([0, 0, 4]), name="below", scale=0.9)
    hand = simulation.grab((6, 6, 2), 4.0)
    simulation.step(50)
    kept = simulation.patch_state(second)
    simulation.take_out_patch(first)
    simulation.take_out_patch(first)
    np.testing.assert_array_equal(simulation.patch_state(second).vertices_mm, kept.vertices_mm)
    np.testing.assert_array_equal(simulation.patch_state(second).forces_n, kept.forces_n)
    simulation.step(50)
    assert simulation.grabs == [hand]
    simulation.take_out_patch(second)
    for name, value in vars(plain).items():
        if isinstance(value, np.ndarray):
            np.testing.assert_array_equal(getattr(simulation.model, name), value)
    assert simulation.model.loose_count == simulation.model.explicit.count == 0
    with pytest.raises(SimulationError, match="taken out"):
        simulation.patch_state(first)


def test_what_cannot_be_sewn_on_is_refused_and_changes_nothing():
    simulation = slab()
    simulation.patch(OUTLINE)
    model, there = simulation.model, list(simulation.patches)
    refused = [
        (lambda: simulation.patch(OUTLINE), "there is a patch of this name"),
        (lambda: simulation.patch(OUTLINE[:2], name="b"), "at least three"),
        (lambda: simulation.patch(OUTLINE * np.nan, name="b"), "finite"),
        (lambda: simulation.patch(OUTLINE + np.array([0, 0, 90]), name="b"), "no tissue within"),
        (lambda: simulation.patch(OUTLINE, name="b", spacing_mm=0.0), "above 0"),
        (lambda: simulation.patch(OUTLINE, name="b", spacing_mm=0.01), "400 are the most"),
        (lambda: simulation.patch(OUTLINE, name="b", stiffness_n_m=-1.0, scale=0.0), "scale.* above 0"),
        (lambda: simulation.sew_on([Place(10**6, 0, (0, 0, 0))] * 12, OUTLINE, name="b"), "another lattice"),
    ]
    for do, message in refused:
        with pytest.raises(SimulationError, match=message):
            do()
        assert simulation.model is model
        assert simulation.patches == there
    coarse = slab(step_s=0.999 * slab().step_limit_s)
    with pytest.raises(SimulationError, match="smaller step"):
        coarse.patch(OUTLINE)


def operate(session):
    """A patch, a running row, a cut, another patch, and the first taken out."""
    outline = tuple(map(tuple, OUTLINE.tolist()))
    session.do(PlacePatch(name="p", outline_mm=outline, scale=0.9))
    session.advance(80)
    session.do(PlaceRow(name="row", places_mm=(((6, 4, 4), (10, 4, 4)), ((6, 20, 4), (10, 20, 4))), running=True))
    session.do(DrawStitch(name="row", tension_n=0.01))
    session.advance(60)
    session.do(TieStitch(name="row"))
    session.do(Cut(poses_mm=(((12, -2, 8), (12, 26, 8)), ((12, -2, -2), (12, 26, -2)))))
    session.do(CloseGrab(name="hand", center_mm=(20, 12, 2), radius_mm=4.0))
    session.advance(60)
    session.do(PlacePatch(name="q", outline_mm=tuple((x, y, 0.0) for x, y, _ in outline)))
    session.advance(60)
    session.do(TakeOutPatch(name="p"))
    session.advance(60)


def test_a_recording_with_patches_and_rows_repeats_to_the_same_bytes(tmp_path):
    session = OperatingSession(slab())
    with Recorder(session, tmp_path / "sewn.recording", state_every_s=0.02):
        operate(session)
    end = session.simulation.state
    assert list(session.frame().patches) == ["q"]
    session.undo()
    assert set(session.frame().patches) == {"p", "q"}
    session.redo()
    assert session.simulation.state.displacement.tobytes() == end.displacement.tobytes()
    recording = open_recording(tmp_path / "sewn.recording")
    assert len(recording.states) >= 3
    again = load_session(recording, slab().model)
    for _ in again.play():
        pass
    assert again.deviations == []
    assert again.simulation.state.displacement.tobytes() == end.displacement.tobytes()
    # From each stored state, too: what it holds is all there is.
    for step in sorted({state.step for state in recording.states.values()}):
        other = load_session(recording, slab().model)
        other.go_to(step)
        other.go_to(other.end_step)
        assert other.simulation.state.displacement.tobytes() == end.displacement.tobytes()


def test_a_moment_with_patches_and_rows_is_stored_to_the_last_digit():
    session = OperatingSession(slab("reference"))
    operate(session)
    simulation = session.simulation
    moment = simulation.snapshot()
    content = snapshot_bytes(moment)
    taken = snapshot_from(content, moment.model, moment.cuts)
    arrays, again = load(content), load(snapshot_bytes(taken))
    assert arrays.keys() == again.keys()
    for name, array in arrays.items():
        np.testing.assert_array_equal(again[name], array)
    for kept, again in zip(moment.patches, taken.patches, strict=True):
        for name in ("nodes", "shares"):
            np.testing.assert_array_equal(getattr(again.then, name), getattr(kept.then, name))
    for kept, again in zip(moment.stitches, taken.stitches, strict=True):
        assert (again.then.row, again.then.is_running) == ("row", True)
        np.testing.assert_array_equal(again.then.nodes, kept.then.nodes)
    with pytest.raises(RecordingError, match="does not fit"):
        snapshot_from(content, slab().model)


def test_commands_that_sew_are_plain_data():
    session = OperatingSession(slab())
    operate(session)
    for entry in session.entries:
        plain = json.loads(json.dumps(entry.command.model_dump(mode="json")))
        assert parse_command(plain) == entry.command
    for wrong in (
        {"kind": "place_row", "name": "r", "between": ["a", "b"], "places_mm": [[[0, 0, 0]] * 2] * 2},
        {"kind": "place_row", "name": "r"},
        {"kind": "place_patch", "name": "p", "outline_mm": [[0, 0, 0], [1, 0, 0]]},
        {"kind": "place_patch", "name": "p", "outline_mm": [[0, 0, 0]] * 3, "scale": 0.0},
    ):
        with pytest.raises(RecordingError):
            parse_command(wrong)


def test_the_lattice_with_a_patch_follows_from_numbers_alone():
    simulation = slab()
    uncut = simulation.model
    patch = simulation.patch(OUTLINE, scale=0.95)
    again = with_patch(uncut, uncut, patch.sheet, 100.0, 0.5, simulation.step_s)
    for name, value in vars(simulation.model).items():
        if isinstance(value, np.ndarray):
            np.testing.assert_array_equal(getattr(again, name), value)
    np.testing.assert_array_equal(again.explicit.rest_length, simulation.model.explicit.rest_length)


def test_a_patch_a_running_row_and_a_cut_come_out_alike_on_a_gpu():
    """On a device where there is one, else in numba's simulator: a small slab, few steps."""
    ends = []
    angle = ANGLE[::2]
    outline = np.stack([6 + 3 * np.cos(angle), 6 + 3 * np.sin(angle), np.full(6, 2.0)], axis=1)
    for backend in ("cuda", "reference"):
        model = block(6, 6, 1, cell_mm=2.0)
        model.node_is_fixed[model.node_index[:, 0] == 0] = True
        simulation = Simulation(model, damping_per_s=30.0, backend=backend)
        patch = simulation.patch(outline, scale=0.9, spacing_mm=3.0)
        chosen = [((2, y, 2), (4, y, 2)) for y in (2, 10)]
        row = simulation.stitch_row(simulation.row_places(chosen, spacing_mm=4.0), is_running=True)
        simulation.draw(row[0], length_mm=1.5)
        simulation.step(4)
        simulation.cut([[(6, -2, 6), (6, 14, 6)], [(6, -2, -2), (6, 14, -2)]], at_rest=True)
        simulation.step(4)
        forces = [simulation.stitch_state(stitch).force_n for stitch in row]
        ends.append((simulation.state.displacement.astype(float), simulation.patch_state(patch).forces_n, forces))
    assert min(ends[1][2]) > 1e-3
    assert ends[1][1].max() > 1e-3
    np.testing.assert_allclose(ends[0][0], ends[1][0], atol=1e-5)
    np.testing.assert_allclose(ends[0][1], ends[1][1], atol=1e-6)
    np.testing.assert_allclose(ends[0][2], ends[1][2], rtol=1e-4)
