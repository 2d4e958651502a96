"""What kernels say of sheets, of what crosses, and of nodes is what plain NumPy says, to the bit."""

from __future__ import annotations

from collections import Counter

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from heartcase.simulator.cutting.crossings import QUANTA
from heartcase.simulator.cutting.parted_lattice import part
from heartcase.simulator.lattice.model import DIRECTIONS
from heartcase.simulator.mesh_arrangement.arrange import NOTHING_CROSSES, arrange, crossings
from heartcase.simulator.mesh_arrangement.sheet_mesh import NO_SHEETS, merged_mesh
from heartcase.simulator.mesh_arrangement.surface_crossings import is_inside
from heartcase.simulator.surface.deform import gather_springs, triangle_basis, ways_of_nodes
from heartcase.simulator.surface_splitting.gluing import number_parts
from heartcase.simulator.surface_splitting.hanging import _gathered
from heartcase.simulator.surface_splitting.hanging_kernels import hang_on
from heartcase.simulator.surface_splitting.lips_and_walls import split_mesh
from heartcase.simulator.surface_splitting.surface_binding import closest_weights
from tests.simulator.surface_splitting.plain_arrangement import plain_arrangement, plain_mesh
from tests.simulator.surface_splitting.surfaces import plane, sheets
from tests.simulator.surface_splitting.test_split_surface import BENT, CUTTABLE, MODEL, TISSUE, strokes


def same(found, wanted):
    for one, other in zip(found, wanted, strict=True):
        np.testing.assert_array_equal(one, other, strict=True)


@settings(max_examples=25, deadline=None)
@given(strokes(), st.integers(0, 9))
def test_sheets_and_what_they_cross_are_as_in_plain_numpy(blades, count):
    """Worked out at once, and on from the first sheets."""
    first = min(count, len(blades))
    surface = CUTTABLE.mesh
    whole = crossings(surface, blades, NOTHING_CROSSES, 0)
    further = crossings(surface, blades, crossings(surface, blades[:first], NOTHING_CROSSES, 0), first)
    wanted = plain_mesh(blades)
    for name in ("vertices", "triangles", "edges", "edge_vertices", "flat", "sheet"):
        np.testing.assert_array_equal(getattr(whole.mesh, name), getattr(wanted, name), strict=True)
        np.testing.assert_array_equal(getattr(further.mesh, name), getattr(wanted, name), strict=True)
    np.testing.assert_array_equal(further.mesh.ranks, whole.mesh.ranks)
    same(further.of_surface[:3], whole.of_surface[:3])
    same(further.between, whole.between)
    found = arrange(surface, whole)
    crossed, corners, arcs, arc_lists, faces, node_places = plain_arrangement(surface, whole)
    same((found.crossed, found.corners, found.arc_lists), (crossed, corners, arc_lists))
    same(found.arcs, arcs)
    same(found.faces, faces)
    same((found.places, found.on_surface, found.surface_weights), node_places)


def test_a_mesh_that_nothing_is_added_to_stays():
    mesh = merged_mesh(NO_SHEETS, [plane(0, 1.3)], 0).mesh
    again = merged_mesh(mesh, [plane(0, 1.3), plane(0, 1.3)], 1)
    np.testing.assert_array_equal(again.mesh.triangles, mesh.triangles)
    assert not len(again.added)


@settings(max_examples=15, deadline=None)
@given(sheets(), st.integers(0, 99))
def test_parts_springs_and_weights_near_a_cut_are_those_of_whole_passes(blades, seed):
    rng = np.random.default_rng(seed)
    split = split_mesh(CUTTABLE.mesh, crossings(CUTTABLE.mesh, blades, NOTHING_CROSSES, 0))
    np.testing.assert_array_equal(split.triangle_part, number_parts(split.weld[split.triangles], split.vertex_count))
    parted = part(MODEL, blades, TISSUE)
    model = parted.model
    nodes = np.flatnonzero(rng.random(model.node_count) < 0.4)
    is_whole = ways_of_nodes(model) == ways_of_nodes(MODEL)[parted.node_origin]
    whole = nodes[is_whole[nodes]]
    same(_gathered(BENT, parted, whole).springs, gather_springs(model, whole).springs)
    tied = model.cell_corners[rng.integers(0, model.cell_count, 20)][:, [0, 1, 5]]
    corners = model.node_index[tied].astype(float)
    points = corners.mean(axis=1) + rng.normal(0, 1, (20, 3))
    weights, edges, basis = np.empty((20, 3), np.float32), np.empty((20, 2, 3), np.float32), np.empty((20, 3, 3))
    hang_on(points, tied, model.node_index, 20, weights, edges, basis)
    np.testing.assert_allclose(weights, closest_weights(points, corners), rtol=0, atol=1e-7)
    np.testing.assert_allclose(basis, triangle_basis(corners[:, 1:] - corners[:, :1]), rtol=0, atol=1e-15)


def test_a_point_is_inside_a_box_or_not():
    """Of the block of cells, in whole numbers; on its sides it counts on one of them."""
    mesh, rng = CUTTABLE.mesh, np.random.default_rng(3)
    high = np.round(mesh.places.max(axis=0) * QUANTA).astype(int)
    points = rng.integers(-QUANTA, high + QUANTA, (300, 3))
    found = [is_inside(mesh.vertices, mesh.triangles, mesh.buckets, point) for point in points]
    wanted = ((points > 0) & (points < high)).all(axis=1)
    np.testing.assert_array_equal(found, wanted)
    assert 0 < wanted.sum() < len(wanted)


@settings(max_examples=15, deadline=None)
@given(sheets())
def test_normals_of_nodes_do_not_turn_towards_a_cut(blades):
    parted = part(MODEL, blades, TISSUE)
    nodes = np.arange(parted.model.node_count)
    found = _gathered(BENT, parted, nodes)
    whole = gather_springs(MODEL, np.arange(MODEL.node_count))
    along = DIRECTIONS[parted.model.spring_direction].astype(np.float32)
    for node in nodes:
        origin = parted.node_origin[node]
        before = {tuple(way) for way in whole.offset[whole.first[origin] : whole.first[origin + 1]]}
        left = [
            (other, *way)
            for end, sign in ((0, -1), (1, 1))
            for spring in np.flatnonzero(parted.model.spring_nodes[:, end] == node)
            for other, way in [(parted.model.spring_nodes[spring, 1 - end], sign * along[spring])]
        ]
        cut = before - {one[1:] for one in left}
        wanted = {one for one in left if tuple(-step for step in one[1:]) not in cut}
        rows = slice(found.first[node], found.first[node + 1])
        listed = [(other, *way) for other, way in zip(found.neighbours[rows], found.offset[rows], strict=True)]
        assert set(listed) == wanted
        assert len(set(Counter(one[1:] for one in listed).values())) <= 1
