"""The surface against rigid motion, and against eq. 9.4 to 9.9 written out in float64."""

from __future__ import annotations

import numpy as np
import pytest

from heartcase.schemas.errors import SimulationError
from heartcase.simulator.lattice.model import make_model
from heartcase.simulator.surface.deform import deform, deform_picking, make_picking, make_surface
from heartcase.simulator.surface.formulas import make_surface_math
from tests.simulator.lattices import EPS, block, oblique_geometry, random_field

# Corner numbers of a cell's six faces, counter-clockwise from outside.
FACES = [(0, 4, 6, 2), (1, 3, 7, 5), (0, 1, 5, 4), (2, 6, 7, 3), (0, 2, 3, 1), (4, 5, 7, 6)]
STEPS = [(-1, 0, 0), (1, 0, 0), (0, -1, 0), (0, 1, 0), (0, 0, -1), (0, 0, 1)]


def unit(vectors):
    return vectors / np.linalg.norm(vectors, axis=-1, keepdims=True)


def boundary_triangles(model):
    """Node numbers of the outer faces' triangles, counter-clockwise from outside."""
    there = {tuple(cell) for cell in model.cells.tolist()}
    quads = [
        corners[list(face)]
        for cell, corners in zip(model.cells, model.cell_corners, strict=True)
        for step, face in zip(STEPS, FACES, strict=True)
        if tuple((cell + step).tolist()) not in there
    ]
    quads = np.array(quads)
    return np.concatenate([quads[:, [0, 1, 2]], quads[:, [0, 2, 3]]])


def hung_surface(model, mode, *, seed=0, count=300, tangents=False):
    """Vertices hung on random boundary triangles, with everything the bundle would hold."""
    rng = np.random.default_rng(seed)
    triangles = boundary_triangles(model)
    corners = triangles[rng.integers(len(triangles), size=count)]
    arrays = {
        "triangle_nodes": corners.astype(np.int32),
        "weights": rng.dirichlet((1, 1, 1), count).astype(np.float32),
        "offset_mm": (rng.uniform(-0.4, 0.4, (count, 3)) * model.cell_mm).astype(np.float32),
        "normal": unit(rng.normal(size=(count, 3)) * 0.3 + (0, 1, 0)).astype(np.float32),
        "curvature": rng.integers(0, 2, count).astype(np.uint8),
    }
    if tangents:
        arrays["render_to_welded"] = rng.integers(count, size=2 * count).astype(np.int32)
        arrays["tangent"] = np.hstack([unit(rng.normal(size=(2 * count, 3))), np.ones((2 * count, 1))]).astype("f4")
    return make_surface(model, mode=mode, **arrays), arrays


def node_normal(model, positions, node):
    """Eq. 9.3."""
    total = np.zeros(3)
    for a, b in model.spring_nodes:
        if node in (a, b):
            other = b if node == a else a
            total += unit(positions[node] - positions[other])
    return unit(total)


def basis_at(model, positions, corners, weights, *, curved):
    """Rows T, N, B of eq. 9.6 or, curved, of eq. 9.8, normalised."""
    p1, p2, p3 = positions[corners]
    T = unit(p2 - p1)
    N = unit(np.cross(T, unit(p3 - p1)))
    if curved:
        N = unit(sum(w * node_normal(model, positions, n) for w, n in zip(weights, corners, strict=True)))
        B = unit(np.cross(N, T))
        return np.array([np.cross(B, N), N, B])
    return np.array([T, N, np.cross(N, T)])


def expected_vertex(model, arrays, v, positions, *, curved):
    """Eq. 9.4 to 9.9: the offset and normal at rest along the basis at rest, put along the basis now."""
    rest = model.rest_positions_mm()
    corners, weights = arrays["triangle_nodes"][v], arrays["weights"][v].astype(float)
    stored = basis_at(model, rest, corners, weights, curved=False)
    before = basis_at(model, rest, corners, weights, curved=curved)
    after = basis_at(model, positions, corners, weights, curved=curved)
    turn = after.T @ before @ stored.T
    return weights @ positions[corners] + turn @ arrays["offset_mm"][v], turn @ arrays["normal"][v]


@pytest.mark.parametrize("mode", ["none", "all", "flagged"])
@pytest.mark.parametrize("amplitude", [0.0, 0.1, 0.4])
def test_kernel_agrees_with_the_formulas(mode, amplitude):
    model = block(4, 3, 2, geometry=oblique_geometry())
    surface, arrays = hung_surface(model, mode, count=60)
    displacement = random_field(model, 7, amplitude)
    positions = model.rest_positions_mm() + model.to_mm(displacement.astype(float))
    moved = deform(model, surface, displacement)
    for v in range(60):
        vertex, normal = expected_vertex(model, arrays, v, positions, curved=bool(surface.curvature[v]))
        # Some ten roundings of lengths up to four cells; a basis over short edges loses another digit.
        np.testing.assert_allclose(moved.vertices_mm[v], vertex, atol=EPS * (400 + 100 * 4 * model.cell_mm))
        np.testing.assert_allclose(moved.normals[v], normal, atol=200 * EPS)


def plain_frame(model, surface, displacement):
    """The formulas vertex by vertex without numba: bases in the grid, then tangents, then LPS axes, in float32."""
    node_normal, deform_vertex = make_surface_math(lambda function: function)
    springs = surface.normals_of
    approximate = np.zeros((max(len(springs.nodes), 1), 3), np.float32)
    for number in range(len(springs.nodes)):
        arrays = springs.nodes, springs.first, springs.neighbours, springs.offset
        approximate[number] = node_normal(number, *arrays, displacement)
    moved, normals = np.zeros((2, surface.vertex_count, 3), np.float32)
    bases = np.zeros((surface.vertex_count, 3, 3), np.float32)
    for v in range(surface.vertex_count):
        hung = surface.triangle_nodes, surface.weights, surface.edges, surface.curvature, surface.offset, surface.normal
        deform_vertex(v, *hung, surface.normal_number, approximate, displacement, moved, normals, bases)

    def along(vectors, rows):
        return vectors[:, :1] * rows[..., 0, :] + vectors[:, 1:2] * rows[..., 1, :] + vectors[:, 2:3] * rows[..., 2, :]

    direction = model.geometry.direction_matrix.astype(np.float32).T
    tangents = surface.tangent.copy()
    tangents[:, :3] = along(along(surface.tangent, bases[surface.render_to_welded]), direction)
    way = along(moved - surface.rest_turn, direction * np.float32(model.cell_mm))
    return surface.rest_mm + way, along(normals, direction), tangents


@pytest.mark.parametrize("mode", ["none", "all", "flagged"])
@pytest.mark.parametrize("amplitude", [0.0, 0.4])
def test_one_pass_gives_the_bits_of_the_plain_version(mode, amplitude):
    model = block(4, 3, 2, geometry=oblique_geometry())
    surface, _ = hung_surface(model, mode, count=100, tangents=True)
    displacement = random_field(model, 7, amplitude)
    now = deform(model, surface, displacement)
    for array, expected in zip(
        (now.vertices_mm, now.normals, now.tangents), plain_frame(model, surface, displacement), strict=True
    ):
        np.testing.assert_array_equal(array, expected)


def test_flags_choose_the_basis():
    model = block(4, 3, 2)
    for mode, wanted in (("none", 0), ("all", 1)):
        surface, _ = hung_surface(model, mode)
        assert (surface.curvature == wanted).all()
    surface, arrays = hung_surface(model, "flagged")
    np.testing.assert_array_equal(surface.curvature, arrays["curvature"])


@pytest.mark.parametrize("mode", ["none", "all", "flagged"])
def test_rest_is_exact(mode):
    """To the last bit the same whichever basis: a vertex at rest lies where the mapping says."""
    model = block(5, 4, 3, geometry=oblique_geometry())
    surface, _ = hung_surface(model, mode)
    still = deform(model, surface, np.zeros((model.node_count, 3), np.float32))
    np.testing.assert_array_equal(still.vertices_mm, surface.rest_mm)
    plain, _ = hung_surface(model, "none")
    np.testing.assert_allclose(surface.rest_mm, plain.rest_mm, atol=EPS * 400)


@pytest.mark.parametrize("mode", ["none", "all", "flagged"])
def test_rigid_motion_of_the_nodes_moves_the_surface_rigidly(mode):
    model = block(6, 4, 3, geometry=oblique_geometry())
    surface, _ = hung_surface(model, mode, tangents=True)
    rng = np.random.default_rng(3)
    rotation = np.linalg.qr(rng.normal(size=(3, 3)))[0]
    rotation *= np.sign(np.linalg.det(rotation))
    shift = rng.uniform(-30, 30, 3)
    rest = model.rest_positions_mm()
    centre = rest.mean(axis=0)

    def moved(points):
        return (points - centre) @ rotation.T + centre + shift

    displacement = model.to_grid(moved(rest) - rest).astype(np.float32)
    now = deform(model, surface, displacement)
    still = deform(model, surface, np.zeros_like(displacement))
    # Positions up to 400 mm and displacements up to 80 mm are each rounded a few times.
    np.testing.assert_allclose(now.vertices_mm, moved(surface.rest_mm.astype(float)), atol=4 * EPS * 480)
    # The edges of the bases are differences of displacements of up to 30 cells.
    tolerance = 4 * EPS * 30
    np.testing.assert_allclose(now.normals, still.normals @ rotation.T, atol=tolerance)
    np.testing.assert_allclose(now.tangents[:, :3], still.tangents[:, :3] @ rotation.T, atol=tolerance)
    np.testing.assert_array_equal(now.tangents[:, 3], still.tangents[:, 3])
    np.testing.assert_allclose(np.linalg.norm(now.normals, axis=1), 1.0, atol=10 * EPS)


def test_approximate_normals_of_a_block_point_outward():
    """Eq. 9.3 on the middle of a face is the face's normal; on a corner the diagonal."""
    model = block(4, 4, 4)
    triangles = boundary_triangles(model)
    nodes = np.unique(triangles)
    picking = make_picking(model, nodes, np.searchsorted(nodes, triangles))
    still = deform_picking(model, picking, np.zeros((model.node_count, 3), np.float32))
    number = {tuple(model.node_index[node]): n for n, node in enumerate(nodes)}
    np.testing.assert_allclose(still.normals[number[4, 2, 2]], (1, 0, 0), atol=10 * EPS)
    np.testing.assert_allclose(still.normals[number[2, 0, 2]], (0, -1, 0), atol=10 * EPS)
    np.testing.assert_allclose(still.normals[number[4, 4, 4]], np.ones(3) / np.sqrt(3), atol=10 * EPS)


def test_one_to_one_surface_is_the_nodes():
    model = block(3, 2, 2, geometry=oblique_geometry())
    triangles = boundary_triangles(model)
    nodes = np.unique(triangles)
    picking = make_picking(model, nodes, np.searchsorted(nodes, triangles))
    displacement = random_field(model, 2, 0.2)
    now = deform_picking(model, picking, displacement)
    expected = model.rest_positions_mm() + model.to_mm(displacement.astype(float))
    np.testing.assert_allclose(now.vertices_mm, expected[nodes], atol=EPS * 400)
    np.testing.assert_array_equal(nodes[picking.triangles], triangles)
    np.testing.assert_allclose(now.normals, [node_normal(model, expected, node) for node in nodes], atol=100 * EPS)


def test_node_without_a_normal_falls_back_to_the_triangle():
    """The springs of a node that two cells share only there cancel: no interpolated basis is defined."""
    model = make_model([(0, 0, 0), (1, 1, 1)])
    shared = int(np.flatnonzero((model.node_index == 1).all(axis=1))[0])
    triangle = next(t for t in boundary_triangles(model) if shared in t)
    corners = np.roll(triangle, -list(triangle).index(shared))[None]
    surface = make_surface(
        model,
        triangle_nodes=corners.astype(np.int32),
        weights=np.float32([[1, 0, 0]]),
        offset_mm=np.float32([[0, 0.1, 0]]),
        normal=np.float32([[0, 1, 0]]),
        curvature=np.uint8([1]),
    )
    assert surface.curvature.tolist() == [0]
    assert np.isfinite(deform(model, surface, random_field(model, 1, 0.2)).vertices_mm).all()


def test_nodes_on_one_line_are_refused():
    model = block(3, 1, 1)
    with pytest.raises(SimulationError, match="one line"):
        make_surface(
            model,
            triangle_nodes=np.int32([[0, 1, 2]]),
            weights=np.float32([[1, 0, 0]]),
            offset_mm=np.zeros((1, 3), np.float32),
            normal=np.float32([[0, 1, 0]]),
            curvature=np.uint8([0]),
        )
