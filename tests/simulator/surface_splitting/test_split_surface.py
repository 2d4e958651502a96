"""A split surface over a cut lattice: every vertex follows nodes of its own side, and nothing moves by the cut."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from heartcase.schemas.bundle.surface_kinds import SurfaceKind
from heartcase.simulator.cutting.blade_sheet import Sheet
from heartcase.simulator.cutting.parted_lattice import part
from heartcase.simulator.simulation import Simulation
from heartcase.simulator.surface.deform import deform, deform_picking
from heartcase.simulator.surface.followers import SurfaceFollower
from heartcase.simulator.surface_splitting.cuttable_surface import CuttableSurface
from heartcase.simulator.surface_splitting.free_parts import (
    cut_picking,
    parts_of_lattice,
    triangles_of_parts,
    without_excised,
)
from heartcase.simulator.surface_splitting.split_surface import split_surface
from tests.simulator.surface_splitting.surfaces import block, box, check_closed, check_ties, hung, plane, sheets, volume

SHAPE = (3, 3, 2)
MODEL = block(SHAPE)
CUTTABLE = CuttableSurface.of(MODEL, hung(MODEL, *box((6, 6, 4), np.array(SHAPE, float))))
BENT = CuttableSurface.of(MODEL, hung(MODEL, *box((6, 6, 4), np.array(SHAPE, float)), curvature=1))
TISSUE = CUTTABLE.samples()


def cut(blades, cuttable=CUTTABLE):
    parted = part(MODEL, blades, TISSUE)
    return parted, split_surface(cuttable, parted, blades)


def bent(seed, size=0.1):
    """A stretch, a shear and a wave."""
    gradient = np.random.default_rng(seed).normal(0, size, (3, 3))
    wave = size * np.sin(MODEL.node_index[:, [1, 2, 0]])
    return (MODEL.node_index @ gradient.T + wave).astype(np.float32)


def places_of(cuttable, surface):
    return cuttable.model.geometry.world_to_index(surface.rest_mm.astype(float)) + 0.5


@settings(max_examples=25, deadline=None)
@given(sheets(), st.integers(0, 99), st.booleans())
def test_vertices_follow_their_own_side_and_nothing_moves_by_a_cut(blades, seed, is_bent):
    cuttable = BENT if is_bent else CUTTABLE
    parted, found = cut(blades, cuttable)
    check_closed(found.weld[found.surface.triangles])
    check_ties(parted.model, found, cuttable.surface)
    still = deform(parted.model, found.surface, np.zeros((parted.model.node_count, 3), np.float32))
    np.testing.assert_array_equal(still.vertices_mm, found.surface.rest_mm)
    old_count = cuttable.surface.vertex_count
    np.testing.assert_array_equal(still.vertices_mm[:old_count], cuttable.surface.rest_mm)
    displacement = bent(seed)
    before = deform(MODEL, cuttable.surface, displacement).vertices_mm
    now = deform(parted.model, found.surface, displacement[parted.node_origin])
    # Those of which a node is a copy follow their cell.
    as_before = found.vertex_cells[:old_count] < 0
    if not is_bent:
        np.testing.assert_array_equal(now.vertices_mm[:old_count][as_before], before[as_before])
    assert np.abs(now.vertices_mm[:old_count] - before).max() < 0.5 * MODEL.cell_mm
    np.testing.assert_array_equal(now.vertices_mm[found.weld], now.vertices_mm)
    used = np.unique(found.surface.triangles)
    np.testing.assert_allclose(np.linalg.norm(now.normals[used], axis=1), 1.0, atol=1e-4)


@pytest.mark.parametrize("places", [(1.3,), (1.0,), (2.0,), (1.5,), (1.5, 1.5), (1.3, 1.7, 1.2), (1.0, 2.0, 1.0)])
def test_lips_part_as_the_lattice_does(places):
    """In planes through, between and along cells: each part of the surface follows the lattice's part in its place."""
    parted, found = cut([plane(axis, place) for axis, place in enumerate(places)])
    check_ties(parted.model, found, CUTTABLE.surface)
    assert found.triangle_part.max() + 1 == 2 ** len(places) == parts_of_lattice(parted.model).max() + 1
    at = places_of(CUTTABLE, found.surface)
    cells = parted.model.cells + 0.5 + parted.model.cell_moments[:, :3]
    of_node = np.zeros(parted.model.node_count, int)
    of_node[parted.model.cell_corners] = parts_of_lattice(parted.model)[:, None]
    for number in range(found.triangle_part.max() + 1):
        triangles = found.surface.triangles[found.triangle_part == number]
        part_of = of_node[found.surface.triangle_nodes[triangles[0, 0], 0]]
        middle = at[triangles].mean(axis=(0, 1))
        mine = cells[parts_of_lattice(parted.model) == part_of]
        for axis, place in enumerate(places):
            assert ((mine[:, axis] > place) == (middle[axis] > place)).all()


@pytest.mark.parametrize(
    "blades", [[plane(0, 1.3)], [plane(0, 1.0)], [plane(0, 1.5), plane(1, 1.5)], [plane(1, 1.2, high=1.6)]]
)
def test_both_lips_lie_on_the_old_surface_while_the_cut_is_closed(blades):
    parted, found = cut(blades)
    displacement = bent(5, 0.05)
    before = deform(MODEL, CUTTABLE.surface, displacement).vertices_mm
    now = deform(parted.model, found.surface, displacement[parted.node_origin]).vertices_mm
    lips = np.flatnonzero(found.on_triangle >= 0)
    corners = CUTTABLE.surface.triangles[found.on_triangle[lips]]
    there = np.einsum("nc,ncx->nx", found.on_weights[lips], before[corners])
    away = np.linalg.norm(now[lips] - there, axis=1)
    assert np.median(away) < 0.02 * MODEL.cell_mm
    assert away.max() < 0.1 * MODEL.cell_mm
    _, place = np.unique(places_of(CUTTABLE, found.surface)[lips].round(5), axis=0, return_inverse=True)
    for axis in range(3):
        order = np.lexsort((now[lips, axis], place.ravel()))
        is_same = np.diff(place.ravel()[order]) == 0
        np.testing.assert_allclose(np.diff(now[lips, axis][order])[is_same], 0, atol=1e-5)


def test_halves_that_go_apart_take_their_walls_along():
    """Two halves moved rigidly: each is a closed box that moved, with its cut face."""
    parted, found = cut([plane(0, 1.3)])
    of_node = np.zeros(parted.model.node_count, int)
    of_node[parted.model.cell_corners] = parts_of_lattice(parted.model)[:, None]
    displacement = np.where((of_node == 0)[:, None], [-0.5, 0.1, 0.0], [0.7, 0.0, 0.2]).astype(np.float32)
    now = deform(parted.model, found.surface, displacement).vertices_mm.astype(float)
    rest = found.surface.rest_mm.astype(float)
    for number in (0, 1):
        triangles = found.surface.triangles[found.triangle_part == number]
        assert volume(now, triangles) == pytest.approx(volume(rest, triangles), rel=1e-5)
        moved = now[np.unique(triangles)] - rest[np.unique(triangles)]
        assert np.ptp(moved, axis=0).max() < 1e-4
    walls = found.surface.triangles[found.triangle_is_cut_face]
    normals = deform(parted.model, found.surface, displacement).normals[walls]
    np.testing.assert_allclose(np.abs(normals[..., 0]), 1.0, atol=1e-5)
    kinds = found.carried(np.full(len(CUTTABLE.surface.triangles), 3, np.uint8), SurfaceKind.CUT_FACE)
    assert kinds.dtype == np.uint8
    np.testing.assert_array_equal(kinds == SurfaceKind.CUT_FACE, found.triangle_is_cut_face)


def test_a_cut_that_goes_on_is_the_cut_made_at_once():
    """Strip by strip: after each, the surface is that of one sheet with the poses so far."""
    poses = [[(1.3 + 0.1 * n, -1, 4 - n), (1.3 + 0.1 * n, 4, 4 - n)] for n in range(4)]
    _, at_once = cut([Sheet.swept(poses)])
    strips = [Sheet.swept(poses[n : n + 2]) for n in range(3)]
    in_parts = split_surface(CUTTABLE, part(MODEL, strips, TISSUE), strips)
    np.testing.assert_array_equal(at_once.surface.triangles, in_parts.surface.triangles)
    np.testing.assert_array_equal(at_once.surface.rest_mm, in_parts.surface.rest_mm)
    np.testing.assert_array_equal(at_once.triangle_origin, in_parts.triangle_origin)


@settings(max_examples=8, deadline=None)
@given(sheets(), sheets())
def test_undoing_a_cut_gives_the_same_bytes(blades, more):
    _, before = cut(blades)
    cut(blades + more)
    _, again = cut(list(blades))
    for name in ("weld", "triangle_origin", "vertex_cells", "uv_mm", "triangle_part"):
        assert getattr(before, name).tobytes() == getattr(again, name).tobytes(), name
    for name, values in vars(before.surface).items():
        if isinstance(values, np.ndarray):
            assert values.tobytes() == getattr(again.surface, name).tobytes(), name


@st.composite
def strokes(draw):
    """Sheets sample by sample: of strokes that go on, cross, come back, end inside, or run along faces of cells."""
    found = []
    for _ in range(draw(st.integers(1, 2))):
        if draw(st.booleans()):
            found += draw(sheets())
            continue
        number = st.sampled_from([0.0, 0.5, 1.0, 1.5, 2.0, 2.5]) if draw(st.booleans()) else st.floats(-0.5, 3.5)
        ways = draw(st.lists(st.tuples(number, number, number), min_size=3, max_size=5))
        edge = np.array(draw(st.tuples(number, number, number))) - 1.2
        poses = np.array(ways)[:, None] + np.stack([-edge, edge])
        poses = np.concatenate([poses, poses[:1]]) if draw(st.booleans()) else poses
        found += [Sheet.swept(poses[n : n + 2]) for n in range(len(poses) - 1)]
    return found


def assert_same(found, wanted):
    """Every array the same to the byte."""
    for name, values in vars(wanted).items():
        if isinstance(values, np.ndarray):
            assert values.dtype == getattr(found, name).dtype, name
            assert values.tobytes() == getattr(found, name).tobytes(), name


@settings(max_examples=30, deadline=None)
@given(strokes(), st.booleans())
def test_a_cut_that_goes_on_from_the_one_before_gives_the_same_bytes(blades, is_bent):
    """Sample by sample, and from any earlier one."""
    cuttable = BENT if is_bent else CUTTABLE
    split = earlier = None
    for count in range(1, len(blades) + 1):
        parted = part(MODEL, blades[:count], TISSUE)
        wanted = split_surface(cuttable, parted, blades[:count])
        for before in (split, earlier):
            found = split_surface(cuttable, parted, blades[:count], before)
            assert_same(found, wanted)
            assert_same(found.surface, wanted.surface)
            assert_same(found.surface.normals_of, wanted.surface.normals_of)
        split, earlier = found, split
    # What another stroke left is no help, and no harm.
    assert_same(
        split_surface(cuttable, part(MODEL, blades[-1:], TISSUE), blades[-1:], split).surface,
        cut(blades[-1:], cuttable)[1].surface,
    )


def test_no_cut_leaves_the_surface_as_it_was():
    _, found = cut([])
    for name, values in vars(CUTTABLE.surface).items():
        if isinstance(values, np.ndarray):
            np.testing.assert_array_equal(getattr(found.surface, name), values, err_msg=name)
    assert (found.vertex_cells == -1).all()


@settings(max_examples=15, deadline=None)
@given(sheets())
def test_the_picking_surface_of_a_cut_lattice_is_closed(blades):
    parted, _ = cut(blades)
    picking = cut_picking(parted.model)
    assert len(np.unique(picking.nodes)) == len(picking.nodes)
    starts, ends = picking.triangles, np.roll(picking.triangles, -1, axis=1)
    net = np.zeros((len(picking.nodes),) * 2, int)
    np.add.at(net, (starts.ravel(), ends.ravel()), 1)
    np.testing.assert_array_equal(net, net.T)
    assert volume(parted.model.node_index[picking.nodes].astype(float), picking.triangles) >= 18.0 - 1e-9
    still = deform_picking(parted.model, picking, np.zeros((parted.model.node_count, 3), np.float32))
    np.testing.assert_allclose(still.vertices_mm, picking.rest_mm, atol=1e-4)


def test_an_uncut_lattice_is_picked_at_its_outer_faces():
    picking = cut_picking(MODEL)
    assert len(picking.triangles) == 2 * 2 * (3 * 3 + 3 * 2 + 3 * 2)
    assert volume(MODEL.node_index[picking.nodes].astype(float), picking.triangles) == pytest.approx(18.0)


def test_a_part_that_is_cut_free_is_taken_out_of_the_surfaces():
    parted, found = cut([plane(0, 1.3)])
    numbers = parts_of_lattice(parted.model)
    gone = numbers[np.argmax(parted.model.cells[:, 0])]
    excised = np.zeros(parted.model.node_count, bool)
    excised[parted.model.cell_corners[numbers == gone]] = True
    of_triangle = triangles_of_parts(parted.model, found)
    left = without_excised(found, excised)
    np.testing.assert_array_equal(left.surface.triangles, found.surface.triangles[of_triangle != gone])
    check_closed(left.weld[left.surface.triangles])
    assert set(found.triangle_part[of_triangle == gone]).isdisjoint(left.triangle_part)
    assert left.surface.rest_mm[left.surface.triangles][..., 0].max() <= 1.3 * MODEL.cell_mm + 1e-3
    picking = cut_picking(parted.model, excised)
    assert not excised[picking.nodes].any()
    check_closed(picking.triangles)


# Seeds 2 and 7 cut exactly along an edge of the box.
@pytest.mark.parametrize("seed", range(12))
def test_vertices_that_lie_on_the_sheet_go_with_their_triangles(seed):
    """A cut from above through vertices of the surface: opened as a wedge, no triangle reaches across."""
    rng = np.random.default_rng(seed)
    high = CUTTABLE.mesh.places[:, 2].max()
    top = CUTTABLE.mesh.places[CUTTABLE.mesh.places[:, 2] == high]
    inner = top[(np.abs(top[:, 0] - 1.5) < 0.7) & (np.abs(top[:, 1] - 1.5) < 1.2)]
    one, other = inner[rng.choice(len(inner), 2, replace=False)]
    along = (other - one) / np.linalg.norm(other - one)
    normal = np.array([along[1], -along[0], 0.0])
    low = high - 1.3
    ends = [one - 9 * along, one + 9 * along]
    blade = Sheet.swept([[(x, y, high + 1), (x, y, low)] for x, y, _ in ends])
    parted, found = cut([blade])
    model = parted.model
    # A copy is of the side of the tissue that hangs on it.
    middle = model.cells + 0.5 + model.cell_moments[:, :3]
    height = np.repeat(((middle - one) @ normal) * model.cell_coverage, 8)
    side = np.sign(np.bincount(model.cell_corners.ravel(), height))
    apart = 2.0 * np.maximum(model.node_index[:, 2] - low, 0.0) * side
    moved = deform(model, found.surface, (apart[:, None] * normal).astype(np.float32)).vertices_mm
    corners = moved[found.surface.triangles] / model.cell_mm
    assert np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=2).max() < 2.5
    # The wedge is open.
    lips = np.flatnonzero(found.on_triangle >= 0)
    across = ((moved[lips] - found.surface.rest_mm[lips]) @ normal) / model.cell_mm
    assert across.min() < -1.5
    assert across.max() > 1.5


def assert_shown_whole(simulation):
    now, wanted = simulation.surface_now(), deform(simulation.model, simulation.surface, simulation.state.displacement)
    assert now.vertices_mm.tobytes() == wanted.vertices_mm.tobytes()
    assert now.normals.tobytes() == wanted.normals.tobytes()


@settings(max_examples=10, deadline=None)
@given(st.integers(0, 999), st.booleans(), st.lists(st.booleans(), min_size=4, max_size=4))
def test_what_is_shown_after_a_cut_is_what_is_worked_out_anew(seed, is_bent, moves):
    """Whether tissue moved since the last frame or not, and after going back."""
    rng = np.random.default_rng(seed)
    simulation = Simulation(MODEL, surface=(BENT if is_bent else CUTTABLE).surface, tissue=TISSUE)
    simulation.grab(MODEL.rest_positions_mm()[0], 4.0)
    assert_shown_whole(simulation)
    edge, points = rng.normal(0, 1.5, 3), []
    ways = np.array(SHAPE) / 2 + np.cumsum(rng.normal(0, 0.7, (len(moves) + 1, 3)), axis=0)
    for n, moves_on in enumerate(moves):
        poses = ways[n : n + 2, None] + np.stack([-edge, edge])
        points.append(simulation.snapshot())
        simulation.cut(MODEL.geometry.index_to_world(poses.reshape(-1, 3) - 0.5).reshape(2, 2, 3), at_rest=True)
        assert_shown_whole(simulation)
        if moves_on:
            simulation.lead(simulation.grabs[0], rng.normal(0, 1.0, 3))
            simulation.step(2)
            assert_shown_whole(simulation)
    for n in (1, 3, 0):
        simulation.restore(points[n])
        assert_shown_whole(simulation)


def test_a_vertex_that_hangs_otherwise_is_worked_out_again():
    surface = CUTTABLE.surface
    other = surface.offset.copy()
    other[[3, 40]] += 0.5
    moved = replace(surface, offset=other)
    before, after = SurfaceFollower(MODEL, surface), SurfaceFollower(MODEL, moved)
    displacement = bent(3)
    before.now(displacement)
    after.go_on_from(before, surface, MODEL.node_count, np.array([3, 40]))
    assert after.now(displacement).vertices_mm.tobytes() == deform(MODEL, moved, displacement).vertices_mm.tobytes()
