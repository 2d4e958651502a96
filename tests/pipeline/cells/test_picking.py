import numpy as np
import pytest

from heartcase.pipeline.cells.build_grid import build_grid
from heartcase.pipeline.cells.picking import picking_surface, split_faces
from heartcase.schemas.recipe.settings import GridSettings, Pin
from tests.pipeline.analytic_structures import LEFT, WALL, ball, lattice, structures, torus, union, without

PIN = Pin(position_mm=(0.0, 0.0, 0.0), radius_mm=30.0)
SHAPES = {
    "ball": {WALL: ball(9.0)},
    "shell": {LEFT: ball(7.0), WALL: without(ball(9.0), ball(7.0))},
    "ring and ball": {WALL: union(torus(8.0, 2.5), ball(2.0))},
}


@pytest.fixture(params=SHAPES, scope="module")
def grid(request):
    return build_grid(structures(SHAPES[request.param], lattice(14.0)), GridSettings(cell_mm=1.7), pins=[PIN])


def test_every_edge_is_passed_as_often_one_way_as_the_other(grid):
    surface = picking_surface(grid)
    edges = np.concatenate([surface.triangles[:, pair] for pair in ([0, 1], [1, 2], [2, 0])])
    forward, forward_count = np.unique(edges, axis=0, return_counts=True)
    backward, backward_count = np.unique(edges[:, ::-1], axis=0, return_counts=True)
    np.testing.assert_array_equal(forward, backward)
    np.testing.assert_array_equal(forward_count, backward_count)


def test_it_encloses_the_cells(grid):
    surface = picking_surface(grid)
    corners = grid.node_positions_mm()[surface.nodes][surface.triangles]
    volume = np.einsum("tx,tx->", corners[:, 0], np.cross(corners[:, 1], corners[:, 2])) / 6.0
    assert volume == pytest.approx(len(grid.cells) * grid.geometry.voxel_volume_mm3, rel=1e-9)


def test_one_vertex_per_boundary_node_and_two_triangles_per_face(grid):
    surface = picking_surface(grid)
    np.testing.assert_array_equal(surface.nodes, np.unique(grid.faces))
    np.testing.assert_array_equal(surface.nodes[surface.triangles], split_faces(grid.faces))
    np.testing.assert_array_equal(surface.triangle_label, np.repeat(grid.face_label, 2))
    assert surface.nodes.dtype == np.int32
    assert surface.triangles.dtype == np.int32
    assert surface.triangle_label.dtype == np.uint8
