import dataclasses
import json

import numpy as np
import pytest
import trimesh

from heartcase.pipeline.cells.build_grid import build_grid
from heartcase.pipeline.cells.map_surface import NEAR_CELLS, map_surface
from heartcase.pipeline.cells.picking import split_faces
from heartcase.schemas.bundle.lattice import CELL_DIAGONALS, CELL_EDGES, CORNER_OFFSETS, cell_nodes
from heartcase.schemas.errors import StageError
from heartcase.schemas.recipe.settings import GridSettings, MapSettings, Pin
from tests.pipeline.analytic_structures import (
    LEFT,
    RIGHT,
    WALL,
    ball,
    box,
    common,
    lattice,
    rotation,
    slab,
    structures,
    surface_of,
    union,
    without,
)
from tests.pipeline.sides import sides

PIN = Pin(position_mm=(0.0, 0.0, 0.0), radius_mm=40.0)


def unit(vectors):
    return vectors / np.maximum(np.linalg.norm(vectors, axis=-1, keepdims=True), 1e-30)


def triangle_basis(points):
    """Rows T, N, B of eq. (9.6), normalised."""
    t = unit(points[:, 1] - points[:, 0])
    n = unit(np.cross(t, unit(points[:, 2] - points[:, 0])))
    return np.stack((t, n, np.cross(n, t)), axis=1)


def smooth_basis(grid, positions, mapped, flat):
    """Rows T, N, B of eq. (9.8), normalised, from the approximate normals of eq. (9.3)."""
    corners = cell_nodes(grid.cells)[1]
    springs = {tuple(sorted(pair)) for a, b in (*CELL_EDGES, *CELL_DIAGONALS) for pair in corners[:, [a, b]].tolist()}
    one, two = np.array(sorted(springs)).T
    total = np.zeros_like(positions)
    np.add.at(total, one, unit(positions[one] - positions[two]))
    np.add.at(total, two, unit(positions[two] - positions[one]))
    n = unit(np.einsum("vc,vcx->vx", mapped.weights, unit(total)[mapped.triangle_nodes]))
    b = unit(np.cross(n, flat[:, 0]))
    return np.stack((np.cross(b, n), n, b), axis=1)


def reference(positions, mapped):
    return np.einsum("vc,vcx->vx", mapped.weights.astype(float), positions[mapped.triangle_nodes])


def deformed(grid, positions, mapped, vertices):
    """Vertices under moved nodes with the flat basis, and with the interpolated one."""
    rest = grid.node_positions_mm()
    flat, moved_flat = (triangle_basis(p[mapped.triangle_nodes]) for p in (rest, positions))
    plain = reference(positions, mapped) + np.einsum("vb,vbx->vx", mapped.offset_mm.astype(float), moved_flat)
    smooth = smooth_basis(grid, rest, mapped, flat)
    offset = np.einsum("vbx,vx->vb", smooth, vertices - reference(rest, mapped))
    moved_smooth = smooth_basis(grid, positions, mapped, moved_flat)
    return plain, reference(positions, mapped) + np.einsum("vb,vbx->vx", offset, moved_smooth)


def trilinear(grid, positions, vertices):
    """Vertices interpolated between the corners of the cell that holds them, or of the nearest."""
    place = grid.geometry.world_to_index(vertices)
    away = np.abs(place[:, None, :] - grid.cells[None]) - 0.5
    cell = np.linalg.norm(np.maximum(away, 0.0), axis=2).argmin(axis=1)
    part = place - grid.cells[cell] + 0.5
    corners = cell_nodes(grid.cells)[1][cell]
    weight = np.stack([np.prod(np.where(offset, part, 1.0 - part), axis=1) for offset in CORNER_OFFSETS], axis=1)
    return np.einsum("vc,vcx->vx", weight, positions[corners])


@pytest.fixture(scope="module", params=["straight", "oblique", "left-handed"])
def heart(request):
    """Two chambers with a thin wall between them, inside a shell."""
    direction = {
        "straight": np.eye(3),
        "oblique": rotation((1.0, 2.0, 3.0), 33.0),
        "left-handed": rotation((1.0, 2.0, 3.0), 33.0) @ np.diag([1.0, 1.0, -1.0]),
    }[request.param]
    n = np.array([1.0, 2.0, -1.0]) / np.sqrt(6.0)
    blood = without(ball(8.0), slab(-0.75, 0.75, n))
    shapes = {
        0: lambda p: -ball(9.5)(p),
        LEFT: common(blood, lambda p: -(p @ n)),
        RIGHT: common(blood, lambda p: p @ n),
        WALL: without(ball(9.5), blood),
    }
    made = structures(shapes, lattice(12.0, direction=direction, shift=(40.0, -70.0, 30.0)))
    moved = {value: (lambda p, shape=shape: shape(p - (40.0, -70.0, 30.0))) for value, shape in shapes.items()}
    made = structures(moved, made.geometry)
    pin = Pin(position_mm=(40.0, -70.0, 30.0), radius_mm=30.0)
    return surface_of(made), build_grid(made, GridSettings(cell_mm=2.0), pins=[pin]), made


def test_the_rest_state_gives_back_the_vertices(heart):
    surface, grid, made = heart
    mapped = map_surface(surface, grid, made, MapSettings())
    plain, smooth = deformed(grid, grid.node_positions_mm(), mapped, surface.vertices_mm.astype(float))
    assert np.abs(plain - surface.vertices_mm).max() < 1e-5
    flagged = mapped.curvature.astype(bool)
    assert flagged.any()
    assert np.abs(smooth - surface.vertices_mm)[flagged].max() < 1e-9
    normal = np.einsum("vb,vbx->vx", mapped.normal, triangle_basis(grid.node_positions_mm()[mapped.triangle_nodes]))
    np.testing.assert_allclose(normal, surface.normals, atol=1e-6)


def test_weights_are_a_partition_of_one_in_float32(heart):
    mapped = map_surface(*heart, MapSettings())
    assert mapped.weights.dtype == np.float32
    assert mapped.weights.min() >= 0.0
    a, b, c = mapped.weights.T
    for total in (a + b + c, c + b + a, b + (a + c)):
        assert total.dtype == np.float32
        np.testing.assert_array_equal(total, np.float32(1.0))


def test_rigid_motion_is_exact(heart):
    surface, grid, made = heart
    mapped = map_surface(surface, grid, made, MapSettings())
    turn, shift = rotation((2.0, -1.0, 0.5), 77.0), np.array([13.0, -4.0, 21.0])
    positions = grid.node_positions_mm() @ turn.T + shift
    wanted = surface.vertices_mm.astype(float) @ turn.T + shift
    plain, smooth = deformed(grid, positions, mapped, surface.vertices_mm.astype(float))
    assert np.abs(plain - wanted).max() < 1e-5
    assert np.abs(smooth - wanted)[mapped.curvature.astype(bool)].max() < 1e-9
    normal = np.einsum("vb,vbx->vx", mapped.normal, triangle_basis(positions[mapped.triangle_nodes]))
    np.testing.assert_allclose(normal, surface.normals @ turn.T, atol=1e-6)


def test_without_penalty_each_vertex_takes_the_nearest_triangle_of_its_label(heart):
    surface, grid, made = heart
    mapped = map_surface(surface, grid, made, MapSettings(normal_penalty=0.0, candidate_count=64))
    rest = grid.node_positions_mm()
    got = np.linalg.norm(reference(rest, mapped) - surface.vertices_mm, axis=1)
    triangles, label = split_faces(grid.faces), np.repeat(grid.face_label, 2)
    for n in range(0, len(got), 97):
        corners = rest[triangles[label == surface.vertex_label[n]]]
        vertex = surface.vertices_mm[n].astype(float)
        closest = trimesh.triangles.closest_point(corners, np.repeat(vertex[None], len(corners), axis=0))
        nearest = np.linalg.norm(closest - vertex, axis=1).min()
        # In the corners of the chambers no face is near, and one between cells is taken.
        assert got[n] == pytest.approx(nearest, abs=1e-5) or got[n] < nearest > 1.25 * 2.0


def test_no_vertex_is_tied_across_a_wall(heart):
    surface, grid, made = heart
    mapped = map_surface(surface, grid, made, MapSettings())
    label_of = dict(
        zip(map(tuple, split_faces(grid.faces).tolist()), np.repeat(grid.face_label, 2).tolist(), strict=True)
    )
    tied = np.array([label_of.get(tuple(nodes), -1) for nodes in mapped.triangle_nodes.tolist()])
    is_inner = tied < 0
    np.testing.assert_array_equal(tied[~is_inner], surface.vertex_label[~is_inner])
    assert set(surface.vertex_label.tolist()) == {0, LEFT, RIGHT}
    assert is_inner.sum() == mapped.quality["inner_face_count"]
    # A face between cells is taken only where none of the vertex's own void is near, by brute force; or, a tenth of a
    # cell nearer, where the way to that one leads out of the tissue.
    triangles, label, cell_mm = split_faces(grid.faces), np.repeat(grid.face_label, 2), grid.geometry.spacing_mm[0]
    for n in np.flatnonzero(is_inner):
        corners = grid.node_positions_mm()[triangles[label == surface.vertex_label[n]]]
        vertex = surface.vertices_mm[n].astype(float)
        closest = trimesh.triangles.closest_point(corners, np.repeat(vertex[None], len(corners), axis=0))
        away = np.linalg.norm(closest - vertex, axis=1)
        facing = np.einsum("tx,x->t", triangle_basis(corners)[:, 1], surface.normals[n].astype(float))
        penalty = MapSettings().normal_penalty * np.maximum(0.0, -facing)
        assert (away + penalty * cell_mm).min() > (NEAR_CELLS - 0.1) * cell_mm
    assert mapped.quality["other_label_count"] == 0
    assert mapped.warnings == ()


def test_a_sheet_thinner_than_half_a_cell_is_not_passed_whatever_the_penalty():
    # One label on both sides, so that labels do not help.
    made = structures({WALL: common(slab(-0.5, 0.5, (0.3, 0.2, 1.0)), ball(9.0))}, lattice(12.0, (0.5, 0.5, 0.5)))
    surface = surface_of(made)
    grid = build_grid(made, GridSettings(cell_mm=2.5), pins=[PIN])
    for penalty in (0.0, 0.5, 1.0):
        mapped = map_surface(surface, grid, made, MapSettings(normal_penalty=penalty))
        facing = triangle_basis(grid.node_positions_mm()[mapped.triangle_nodes])[:, 1]
        assert (np.einsum("vx,vx->v", facing, surface.normals) < -0.5).mean() < 0.01
        assert not sides(made, surface, grid, mapped).wrong.any()


def test_the_penalty_keeps_vertices_off_triangles_that_face_away():
    # Around the rim of a plate the nearest triangle is often one of the other side of the rim.
    made = structures({WALL: common(slab(-1.6, 1.6, (0.3, 0.2, 1.0)), ball(9.0))}, lattice(12.0, (0.5, 0.5, 0.5)))
    surface = surface_of(made)
    grid = build_grid(made, GridSettings(cell_mm=2.5), pins=[PIN])
    away = []
    for penalty in (0.0, 1.0):
        mapped = map_surface(surface, grid, made, MapSettings(normal_penalty=penalty))
        facing = triangle_basis(grid.node_positions_mm()[mapped.triangle_nodes])[:, 1]
        away.append((np.einsum("vx,vx->v", facing, surface.normals) < 0.0).sum())
    assert 0 < away[1] < away[0]


def test_a_label_without_faces_follows_the_cells_around_it_and_says_so():
    made = structures({LEFT: ball(5.0), WALL: without(ball(8.0), ball(5.0))}, lattice(12.0))
    surface = surface_of(made)
    grid = build_grid(made, GridSettings(cell_mm=2.0), pins=[PIN])
    strange = dataclasses.replace(
        surface, vertex_label=np.where(surface.vertex_label == LEFT, RIGHT, 0).astype(np.uint8)
    )
    mapped = map_surface(strange, grid, made, MapSettings())
    is_lost = surface.vertex_label == LEFT
    assert mapped.quality["inner_face_count"] + mapped.quality["other_label_count"] == is_lost.sum()
    assert "moves with what is nearest" in mapped.warnings[0].text
    nearest = map_surface(surface, grid, made, MapSettings())
    np.testing.assert_array_equal(mapped.triangle_nodes[~is_lost], nearest.triangle_nodes[~is_lost])
    reach = np.linalg.norm(reference(grid.node_positions_mm(), mapped) - surface.vertices_mm, axis=1)
    assert reach.max() < 2.0 * np.sqrt(3.0)


def test_a_gap_narrower_than_a_cell_is_followed_by_the_cells_that_fill_it():
    # Two balls of muscle, half a cell apart; the rim of the gap is up to three cells away.
    made = structures(
        {WALL: union(box((9.0, 9.0, 3.0), (0.0, 0.0, -3.6)), box((9.0, 9.0, 3.0), (0.0, 0.0, 3.6)))},
        lattice(13.0, (0.5, 0.5, 0.5), shift=(0.1, 0.2, 0.3)),
    )
    surface, grid = surface_of(made), build_grid(made, GridSettings(cell_mm=2.5), pins=[PIN])
    mapped = map_surface(surface, grid, made, MapSettings())
    in_gap = (np.abs(surface.vertices_mm[:, 2]) < 1.0) & (np.abs(surface.vertices_mm[:, :2]) < 5.0).all(axis=1)
    reach = np.linalg.norm(reference(grid.node_positions_mm(), mapped) - surface.vertices_mm, axis=1)
    assert in_gap.sum() > 100
    assert mapped.quality["inner_face_count"] >= in_gap.sum()
    assert reach[in_gap].max() < 1.25 * 2.5
    assert not sides(made, surface, grid, mapped).wrong.any()

    def twisted(p, length=60.0):
        c, s = np.cos(p[:, 0] / length), np.sin(p[:, 0] / length)
        return np.stack((p[:, 0], c * p[:, 1] - s * p[:, 2], s * p[:, 1] + c * p[:, 2]), axis=1)

    positions = twisted(grid.node_positions_mm())
    wanted = trilinear(grid, positions, surface.vertices_mm.astype(float))
    got = deformed(grid, positions, mapped, surface.vertices_mm.astype(float))[0]
    assert np.linalg.norm(got - wanted, axis=1)[in_gap].max() < 0.05 * 2.5


def test_far_faces_of_the_own_label_do_not_drag_a_vertex_along():
    made = structures({LEFT: ball(5.0), WALL: without(ball(8.0), ball(5.0))}, lattice(12.0))
    surface = surface_of(made)
    grid = build_grid(made, GridSettings(cell_mm=2.0), pins=[PIN])
    label = surface.vertex_label.copy()
    top = surface.vertices_mm[:, 2].argmax()
    label[top] = LEFT
    one_face = grid.node_positions_mm()[grid.faces].mean(axis=1)[:, 2].argmin()
    faces = np.where(np.arange(len(grid.faces)) == one_face, LEFT, 0).astype(np.uint8)
    mapped = map_surface(
        dataclasses.replace(surface, vertex_label=label),
        dataclasses.replace(grid, face_label=faces),
        made,
        MapSettings(),
    )
    reach = np.linalg.norm(reference(grid.node_positions_mm(), mapped) - surface.vertices_mm, axis=1)
    assert reach[top] < 2.0


def test_nearest_node_is_the_nearest_of_the_same_side(heart):
    surface, grid, made = heart
    mapped = map_surface(surface, grid, made, MapSettings())
    rest = grid.node_positions_mm()
    for n in range(0, len(mapped.nearest_node), 53):
        own = np.unique(grid.faces[grid.face_label == surface.vertex_label[n]])
        distance = np.linalg.norm(rest[own] - surface.vertices_mm[n], axis=1)
        assert np.linalg.norm(rest[mapped.nearest_node[n]] - surface.vertices_mm[n]) == pytest.approx(distance.min())
        assert mapped.nearest_node[n] in own


def test_tangents_follow_their_welded_vertex(heart):
    surface, grid, made = heart
    count = len(surface.vertices_mm)
    seam = np.concatenate((np.arange(count), np.arange(0, count, 7))).astype(np.int32)
    side = np.where(np.arange(len(seam)) % 3 == 0, -1.0, 1.0).astype(np.float32)
    tangent = unit(np.cross(surface.normals[seam], (0.3, 0.5, 0.8))).astype(np.float32)
    with_atlas = dataclasses.replace(
        surface, render_to_welded=seam, render_tangents=np.concatenate((tangent, side[:, None]), axis=1)
    )
    mapped = map_surface(with_atlas, grid, made, MapSettings())
    basis = triangle_basis(grid.node_positions_mm()[mapped.triangle_nodes])[seam]
    np.testing.assert_allclose(np.einsum("vb,vbx->vx", mapped.tangent[:, :3], basis), tangent, atol=1e-6)
    np.testing.assert_array_equal(mapped.tangent[:, 3], side)


def test_a_surface_without_atlas_has_no_tangents(heart):
    surface, grid, made = heart
    assert map_surface(surface, grid, made, MapSettings()).tangent.shape == (0, 4)
    count = len(surface.vertices_mm)
    blank = dataclasses.replace(
        surface, render_to_welded=np.arange(count, dtype=np.int32), render_tangents=np.zeros((count, 4), np.float32)
    )
    np.testing.assert_array_equal(map_surface(blank, grid, made, MapSettings()).tangent, 0.0)


@pytest.mark.parametrize(("normal", "half_mm"), [((0.0, 0.0, 1.0), 1.5), ((0.3, 0.1, 1.0), 2.0)])
def test_curvature_correction_is_used_where_it_helps(normal, half_mm):
    made = structures({WALL: common(slab(-half_mm, half_mm, normal), ball(13.0))}, lattice(15.0, shift=(0.2, 0.4, 0.1)))
    surface, grid = surface_of(made), build_grid(made, GridSettings(cell_mm=2.2), pins=[PIN])
    mapped = map_surface(surface, grid, made, MapSettings())
    flagged = mapped.curvature.astype(bool)
    assert 0.0 < flagged.mean() < 1.0
    vertices = surface.vertices_mm.astype(float)

    def bent(p, radius=30.0):
        angle, height = p[:, 0] / radius, radius - p[:, 2]
        return np.stack((height * np.sin(angle), p[:, 1], radius - height * np.cos(angle)), axis=1)

    def twisted(p, radius=30.0):
        c, s = np.cos(p[:, 0] / radius), np.sin(p[:, 0] / radius)
        return np.stack((p[:, 0], c * p[:, 1] - s * p[:, 2], s * p[:, 1] + c * p[:, 2]), axis=1)

    errors = {}
    for name, move in (("bend", bent), ("twist", twisted)):
        positions = move(grid.node_positions_mm())
        wanted = trilinear(grid, positions, vertices)
        plain, smooth = (np.linalg.norm(got - wanted, axis=1) for got in deformed(grid, positions, mapped, vertices))
        chosen = np.where(flagged, smooth, plain)
        errors[name] = [float(np.sqrt(np.mean(e**2))) for e in (plain, smooth, chosen)]
        assert errors[name][2] <= errors[name][0]
        assert errors[name][2] < errors[name][1]
        assert np.percentile(chosen - plain, 95) < 0.01
    assert errors["twist"][2] < 0.8 * errors["twist"][0]


def test_dtypes_and_plain_quality(heart):
    mapped = map_surface(*heart, MapSettings())
    assert mapped.triangle_nodes.dtype == mapped.nearest_node.dtype == np.int32
    assert mapped.offset_mm.dtype == mapped.normal.dtype == mapped.tangent.dtype == np.float32
    assert mapped.curvature.dtype == np.uint8
    json.dumps(mapped.quality)


def test_the_same_bytes_every_time(heart):
    first, second = (map_surface(*heart, MapSettings()) for _ in range(2))
    for one in dataclasses.fields(first):
        a, b = getattr(first, one.name), getattr(second, one.name)
        assert a.tobytes() == b.tobytes() if isinstance(a, np.ndarray) else a == b


def test_walls_of_two_pieces_map_to_their_own_cells():
    shape = union(ball(5.0, (-7.0, 0.0, 0.0)), ball(5.0, (7.0, 0.0, 0.0)))
    made = structures({WALL: shape}, lattice(14.0))
    surface, grid = surface_of(made), build_grid(made, GridSettings(cell_mm=1.6), pins=[PIN])
    mapped = map_surface(surface, grid, made, MapSettings())
    side = np.sign(grid.node_positions_mm()[mapped.triangle_nodes][..., 0].mean(axis=1))
    np.testing.assert_array_equal(side, np.sign(surface.vertices_mm[:, 0]))


def test_vertices_and_normals_that_are_no_numbers_are_refused(heart):
    surface, grid, made = heart
    vertices, normals = surface.vertices_mm.copy(), surface.normals.copy()
    vertices[3, 1] = np.inf
    normals[[5, 8]] = np.nan
    broken = dataclasses.replace(surface, vertices_mm=vertices, normals=normals)
    with pytest.raises(StageError) as caught:
        map_surface(dataclasses.replace(surface, levels=(broken,)), grid, made, MapSettings())
    first, second = caught.value.problems
    assert first.place == "levels.1.vertices_mm"
    assert "1 of" in first.message
    assert "the first at vertex 3" in first.message
    assert second.place == "levels.1.normals"
    assert "2 of" in second.message


def test_structures_of_another_case_are_refused(heart):
    surface, grid, made = heart
    turned = dataclasses.replace(
        made,
        geometry=lattice(12.0, direction=rotation((0.0, 0.0, 1.0), 5.0) @ made.geometry.direction_matrix),
    )
    with pytest.raises(StageError, match="its axes are others"):
        map_surface(surface, grid, turned, MapSettings())
    other = dataclasses.replace(made, table=type(made.table)(labels=made.table.labels[:2]))
    with pytest.raises(StageError, match="not of one case"):
        map_surface(surface, grid, other, MapSettings())
