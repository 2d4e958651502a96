"""What is taken over from the last frame is, to the bit, what would have been worked out."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numba import get_num_threads, set_num_threads

from heartcase.simulator.simulation import Simulation
from heartcase.simulator.surface import followers as surface_moved
from heartcase.simulator.surface.cpu_kernels import EVERYTHING, MOVED, node_normals
from heartcase.simulator.surface.deform import deform, deform_picking, empty_frame, make_picking, write_vertices
from heartcase.simulator.surface.followers import SurfaceFollower
from tests.simulator.lattices import block, oblique_geometry, random_field
from tests.simulator.surface.test_cell_vertices import with_cells
from tests.simulator.surface.test_surface import boundary_triangles, hung_surface

MODES = ["none", "all", "flagged"]


def lattice():
    return block(6, 4, 3, geometry=oblique_geometry())


def one_to_one(model):
    triangles = boundary_triangles(model)
    nodes = np.unique(triangles)
    return make_picking(model, nodes, np.searchsorted(nodes, triangles))


def surface_in(model, mode, seed, tangents):
    if mode == "one to one":
        return one_to_one(model)
    if mode == "in cells":
        return with_cells(model, hung_surface(model, "flagged", seed=seed, tangents=tangents)[0], seed)[0]
    return hung_surface(model, mode, seed=seed, tangents=tangents)[0]


def arrays_of(frame):
    return [array for array in (frame.vertices_mm, frame.normals, frame.tangents) if array is not None]


def bytes_of(frame):
    return [array.tobytes() for array in arrays_of(frame)]


def whole(model, surface, displacement):
    return (deform if hasattr(surface, "offset") else deform_picking)(model, surface, displacement)


@pytest.fixture(params=[0.5, 2.0], ids=["falls back", "never falls back"], autouse=True)
def _share(request, monkeypatch):
    monkeypatch.setattr(surface_moved, "SKIPPING_SHARE_MAX", request.param)


@settings(max_examples=25, deadline=None)
@given(
    st.sampled_from([*MODES, "one to one", "in cells"]),
    st.booleans(),
    st.integers(0, 2**32 - 1),
    st.lists(st.sampled_from([0.0, 0.01, 0.05, 0.3, 0.7, 1.0]), min_size=2, max_size=6),
)
def test_frames_are_those_of_the_whole_to_the_bit(mode, tangents, seed, shares):
    model = lattice()
    surface = surface_in(model, mode, seed, tangents)
    follower, plain = SurfaceFollower(model, surface), SurfaceFollower(model, surface, skips_unmoved=False)
    rng = np.random.default_rng(seed)
    displacement = random_field(model, seed, 0.3)
    shown = []
    for share in shares:
        displacement = displacement.copy()
        moved = rng.random(displacement.shape) < share
        next_to = np.nextafter(displacement, np.float32(1))
        displacement[moved] = (next_to * rng.choice([1.0, -1.0, 0.0, -0.0, 1e-30, np.nan]))[moved]
        frame = follower.now(displacement)
        expected = bytes_of(whole(model, surface, displacement))
        assert bytes_of(frame) == expected
        assert bytes_of(plain.now(displacement)) == expected
        shown.append((frame, expected))
    for frame, expected in shown:
        assert bytes_of(frame) == expected


@pytest.mark.parametrize("mode", [*MODES, "one to one"])
def test_only_what_follows_from_a_moved_node_is_worked_out(mode):
    """Rest positions that are no numbers any more show which vertices were worked out since."""
    model = lattice()
    surface = one_to_one(model) if mode == "one to one" else hung_surface(model, mode)[0]
    follower = SurfaceFollower(model, surface)
    displacement = random_field(model, 1, 0.1)
    follower.now(displacement)
    surface.rest_mm[:] = np.nan
    moved = np.zeros(model.node_count, bool)
    moved[[0, 37]] = True
    beside = moved.copy()
    beside[model.spring_nodes[moved[model.spring_nodes].any(axis=1)]] = True
    frame = follower.now(np.where(moved[:, None], displacement + np.float32(0.01), displacement))
    if mode == "one to one":
        expected = beside[surface.nodes]
    else:
        is_bent = (surface.curvature != 0) & beside[surface.triangle_nodes].any(axis=1)
        expected = moved[surface.triangle_nodes].any(axis=1) | is_bent
    assert 0 < expected.sum() < len(expected)
    np.testing.assert_array_equal(np.isnan(frame.vertices_mm).any(axis=1), expected)


def test_where_nothing_moved_the_last_frame_is_the_frame():
    model = lattice()
    follower = SurfaceFollower(model, hung_surface(model, "flagged", tangents=True)[0])
    displacement = random_field(model, 1, 0.1)
    frame = follower.now(displacement)
    assert follower.now(displacement.copy()) is frame
    for array in arrays_of(frame):
        with pytest.raises(ValueError, match="read-only"):
            array[0] = 0
    # A zero of the other sign is another displacement.
    displacement[0] = 0.0
    follower.now(displacement)
    displacement[0] = -0.0
    assert bytes_of(follower.now(displacement)) == bytes_of(deform(model, follower.surface, displacement))


def test_displacement_that_is_changed_in_place_is_noticed():
    model = lattice()
    surface, _ = hung_surface(model, "flagged")
    follower = SurfaceFollower(model, surface)
    displacement = random_field(model, 1, 0.1)
    follower.now(displacement)
    displacement[5] += 0.25
    assert bytes_of(follower.now(displacement)) == bytes_of(deform(model, surface, displacement))


def test_frame_after_one_that_was_interrupted_is_whole(monkeypatch):
    model = lattice()
    surface, _ = hung_surface(model, "flagged")
    follower = SurfaceFollower(model, surface)
    displacement = random_field(model, 1, 0.1)
    follower.now(displacement)
    displacement[5] += 0.25

    def interrupted(*_, **__):
        raise KeyboardInterrupt

    with monkeypatch.context() as patched:
        patched.setattr(surface_moved, "write_vertices", interrupted)
        with pytest.raises(KeyboardInterrupt):
            follower.now(displacement)
    assert bytes_of(follower.now(displacement)) == bytes_of(deform(model, surface, displacement))


@pytest.mark.parametrize("mode", ["flagged", "one to one"])
def test_all_ways_and_threads_give_the_same_bytes(mode, monkeypatch):
    monkeypatch.setattr(surface_moved, "PARALLEL_VERTICES_MIN", 0)
    model = lattice()
    surface = one_to_one(model) if mode == "one to one" else hung_surface(model, mode, tangents=True)[0]
    displacement = random_field(model, 1, 0.3)
    expected = bytes_of(whole(model, surface, displacement))
    thread_count = get_num_threads()
    try:
        for threads in range(1, thread_count + 1):
            set_num_threads(threads)
            for together in (False, True):
                follower = SurfaceFollower(model, surface)
                follower.prepare()
                assert bytes_of(follower.now(displacement, together=together)) == expected
                for marks in (EVERYTHING, np.full(model.node_count, MOVED)):
                    normals = np.zeros((max(len(surface.normals_of.nodes), 1), 3), np.float32)
                    node_normals(surface.normals_of.springs, displacement, normals, marks, together=together)
                    frame = empty_frame(surface)
                    write_vertices(model, surface, normals, displacement, frame, marks, together=together)
                    assert bytes_of(frame) == expected
    finally:
        set_num_threads(thread_count)


@pytest.mark.parametrize("skips_unmoved", [True, False])
def test_simulation_shows_the_whole_surface_whatever_happened(skips_unmoved):
    model = block(8, 4, 3, fix_base=True, geometry=oblique_geometry())
    surface, _ = hung_surface(model, "flagged", tangents=True)
    picking = one_to_one(model)
    simulation = Simulation(model, surface=surface, picking=picking, skips_unmoved=skips_unmoved)
    simulation.prepare()
    shown = []

    def look():
        displacement = simulation.state.displacement
        now = simulation.surface_now(), simulation.picking_now()
        expected = (
            bytes_of(deform(model, surface, displacement)),
            bytes_of(deform_picking(model, picking, displacement)),
        )
        shown.append((now, expected))
        assert tuple(map(bytes_of, now)) == expected

    look()
    start = simulation.state
    hand = simulation.grab(model.rest_positions_mm()[model.node_index[:, 2] == 3].mean(axis=0), 1.5 * model.cell_mm)
    for way in (1.0, 1.0, 2.0):
        simulation.lead(hand, (0.0, 0.0, way))
        simulation.step()
        look()
    simulation.remove_springs(np.arange(model.spring_count) % 5 == 0)
    look()
    simulation.step(3)
    look()
    pulled = simulation.state
    simulation.restore(start)
    look()
    simulation.restore(pulled)
    look()
    for now, expected in shown:
        assert tuple(map(bytes_of, now)) == expected
