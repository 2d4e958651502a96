import dataclasses
import json
import re

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from heartcase.pipeline.cells.build_grid import _find_ridges, _labels_of_cells, build_grid
from heartcase.pipeline.data import Structures
from heartcase.pipeline.kernels.topology import distance_in_samples
from heartcase.pipeline.warnings import WarningGrade
from heartcase.schemas.bundle.lattice import CORNER_OFFSETS, FULL_MOMENTS, cell_nodes
from heartcase.schemas.errors import StageError
from heartcase.schemas.labels import Label, LabelTable, Role
from heartcase.schemas.recipe.settings import GridSettings, Pin
from tests.pipeline.analytic_structures import (
    LEFT,
    RIGHT,
    TABLE,
    WALL,
    ball,
    box,
    common,
    cylinder,
    lattice,
    rotation,
    slab,
    structures,
    torus,
    union,
    without,
)

PIN = Pin(position_mm=(0.0, 0.0, 0.0), radius_mm=40.0)
OBLIQUE = rotation((1.0, 2.0, 3.0), 33.0)
RATIOS = (1.5, 2.0, 3.0, 4.0)


def grid_of(shapes, geometry, cell_mm, pins=(PIN,), **settings):
    return build_grid(structures(shapes, geometry), GridSettings(cell_mm=cell_mm, **settings), pins=list(pins))


def rooms(normal, wall_mm, *, canal_mm=None, radius=9.0):
    """Two half balls, left above and right below a wall, inside a shell 2 mm thick; a canal may pierce the wall."""
    n = np.asarray(normal, dtype=float) / np.linalg.norm(normal)
    wall = slab(-wall_mm / 2, wall_mm / 2, n)
    if canal_mm is not None:
        wall = without(wall, cylinder(canal_mm / 2, n))
    blood = without(ball(radius), wall)
    return {
        0: lambda p: -ball(radius + 2.0)(p),
        LEFT: common(blood, lambda p: -(p @ n)),
        RIGHT: common(blood, lambda p: p @ n),
        WALL: without(ball(radius + 2.0), blood),
    }


def blood_pieces(grid):
    return grid.quality["betti_blood"]["grid"][0]


@pytest.mark.parametrize(
    ("direction", "ratio"),
    [
        (np.eye(3), 1.5),
        (np.eye(3), 2.3),
        (OBLIQUE, 2.0),
        (OBLIQUE, 4.0),
        (OBLIQUE @ np.diag([1.0, 1.0, -1.0]), 2.0),
        (OBLIQUE @ np.diag([1.0, 1.0, -1.0]), 3.0),
    ],
)
def test_volumes_are_exact_for_ball_shell_and_ring(direction, ratio):
    # The fields are linear between voxels of edge h: a border of mean curvature H moves inwards by up to H h^2 / 6.
    shapes = {
        "ball": (ball(12.0), 4 / 3 * np.pi * 12.0**3, 1.0 / (2.0 * 12.0**2)),
        "shell": (without(ball(14.0), ball(11.0)), 4 / 3 * np.pi * (14.0**3 - 11.0**3), 1.5 / (14.0**3 - 11.0**3)),
        "ring": (torus(10.0, 4.0), 2 * np.pi**2 * 10.0 * 4.0**2, 1.0 / (6.0 * 4.0**2)),
    }
    geometry = lattice(17.0, direction=direction, shift=(0.3, 0.2, -0.4))
    for shape, volume_mm3, linear in shapes.values():
        grid = grid_of({WALL: shape}, geometry, ratio)
        assert grid.quality["tissue_volume_ml"] * 1e3 == pytest.approx(volume_mm3, rel=linear + 0.002)
        assert grid.quality["grid_volume_ml"] * 1e3 == pytest.approx(volume_mm3, rel=linear + 0.005)
        assert grid.quality["volume_error_percent"] == pytest.approx(
            100.0 * (grid.quality["grid_volume_ml"] / grid.quality["tissue_volume_ml"] - 1.0)
        )


@pytest.mark.parametrize("ratio", [2.0, 3.0, 4.0])
def test_volumes_are_exact_to_a_tenth_of_a_percent_where_samples_are_voxels(ratio):
    for radius in (4.0, 6.0, 12.0):
        grid = grid_of({WALL: ball(radius)}, lattice(14.0, shift=(0.31, 0.22, 0.43)), ratio)
        assert grid.quality["tissue_volume_ml"] * 1e3 == pytest.approx(4 / 3 * np.pi * radius**3, rel=1e-3)


def test_coverage_is_exact_for_planes_along_the_axes():
    for offset in (0.0, 0.17, 0.5, 0.83):
        grid = grid_of({WALL: slab(-3.0 + offset, 1.0 + offset)}, lattice(8.0), 2.0)
        side = grid.geometry.size[0] * grid.geometry.size[1]
        extent = (2 * 8.0 + 1.0) ** 2
        volume = grid.cell_coverage.sum(dtype=float) * 8.0
        assert volume == pytest.approx(4.0 * extent, rel=1e-3)
        assert len(grid.cells) % side == 0


@pytest.mark.parametrize("spacing", [(0.8, 1.1, 2.0), (2.0, 1.0, 1.3)])
def test_anisotropic_scans_keep_their_volume(spacing):
    grid = grid_of({WALL: without(ball(15.0), ball(10.0))}, lattice(18.0, spacing, direction=OBLIQUE), 2.5)
    volume = 4 / 3 * np.pi * (15.0**3 - 10.0**3)
    assert grid.quality["tissue_volume_ml"] * 1e3 == pytest.approx(volume, rel=0.005)


@pytest.mark.parametrize("flip", [False, True])
def test_the_lattice_is_right_handed_parallel_to_the_scan_and_starts_at_its_corner(flip):
    direction = OBLIQUE @ np.diag([1.0, 1.0, -1.0]) if flip else OBLIQUE
    volume = lattice(12.0, (1.0, 1.2, 1.4), direction=direction)
    grid = grid_of({WALL: ball(8.0)}, volume, 2.0)
    assert grid.geometry.is_right_handed
    across = grid.geometry.direction_matrix.T @ volume.direction_matrix
    np.testing.assert_allclose(np.abs(across), np.eye(3), atol=1e-12)
    corner = volume.world_to_index(grid.geometry.index_to_world((-0.5, -0.5, -0.5)))
    expected = [-0.5, -0.5, volume.size[2] - 0.5 if flip else -0.5]
    np.testing.assert_allclose(corner, expected, atol=1e-9)
    centres = grid.geometry.index_to_world(grid.cells)
    inside = np.linalg.norm(centres, axis=1) <= 8.0 - np.sqrt(3.0)
    np.testing.assert_allclose(grid.cell_coverage[inside], 1.0, atol=1e-6)
    assert np.linalg.norm(centres, axis=1).max() < 8.0 + np.sqrt(3.0)


def test_cells_nodes_and_faces_follow_the_format():
    grid = grid_of({LEFT: ball(7.0), WALL: without(ball(10.0), ball(7.0))}, lattice(14.0), 2.0)
    order = np.lexsort((grid.cells[:, 0], grid.cells[:, 1], grid.cells[:, 2]))
    np.testing.assert_array_equal(order, np.arange(len(grid.cells)))
    nodes, corners = cell_nodes(grid.cells)
    np.testing.assert_array_equal(grid.nodes, nodes)
    # Every cell side without a cell beyond is a face, seen counter-clockwise from there.
    cells = {tuple(cell) for cell in grid.cells.tolist()}
    sides = [(axis, sign) for axis in range(3) for sign in (-1, 1)]
    expected = sum(
        tuple(np.add(cell, np.eye(3, dtype=int)[axis] * sign)) not in cells for cell in cells for axis, sign in sides
    )
    assert len(grid.faces) == expected
    points = grid.node_positions_mm()[grid.faces]
    normal = np.cross(points[:, 1] - points[:, 0], points[:, 2] - points[:, 0])
    outward = points.mean(axis=1) - grid.geometry.index_to_world(grid.cells[grid.face_cell])
    np.testing.assert_allclose(normal / 4.0, outward, atol=1e-9)
    assert set(corners[grid.face_cell[0]]) >= set(grid.faces[0])
    assert grid.cell_coverage.dtype == grid.cell_moments.dtype == np.float32
    assert grid.face_label.dtype == grid.fixed.dtype == grid.cell_label.dtype == np.uint8
    assert CORNER_OFFSETS.shape == (8, 3)
    json.dumps(grid.quality)


@pytest.mark.parametrize("ratio", RATIOS)
@pytest.mark.parametrize("thickness", [1.5, 4.0])
def test_faces_carry_the_label_of_the_void_beside_them(ratio, thickness):
    grid = grid_of(rooms((1.0, 2.0, -1.0), thickness), lattice(14.0), ratio)
    centres = grid.node_positions_mm()[grid.faces].mean(axis=1)
    out = centres - grid.geometry.index_to_world(grid.cells[grid.face_cell])
    # Half a sample into the void; cells that were opened may hold tissue there.
    points = centres + out / grid.quality["samples_per_cell_edge"]
    shapes = rooms((1.0, 2.0, -1.0), thickness)
    distance = np.stack([shapes[value](points) for value in (0, LEFT, RIGHT, WALL)])
    expected = np.array([0, LEFT, RIGHT, WALL])[distance.argmin(axis=0)]
    in_void = expected != WALL
    assert in_void.mean() > 0.9
    np.testing.assert_array_equal(grid.face_label[in_void], expected[in_void])


def test_a_wall_thinner_than_a_cell_has_both_its_labels():
    grid = grid_of(rooms((0.0, 0.0, 1.0), 1.0), lattice(14.0), 3.0)
    at_wall = np.abs(grid.node_positions_mm()[grid.faces].mean(axis=1)[:, 2]) < 3.0
    assert {LEFT, RIGHT} <= set(grid.face_label[at_wall].tolist())


def test_the_asked_node_count_is_met():
    shell = {LEFT: ball(15.0), WALL: without(ball(18.0), ball(15.0))}
    made = structures(shell, lattice(22.0))
    for wanted in (900,):
        grid = build_grid(made, GridSettings(node_count=wanted), pins=[PIN])
        assert len(grid.nodes) == pytest.approx(wanted, rel=0.05)
    assert len(build_grid(made, GridSettings(), pins=[PIN]).nodes) == pytest.approx(30_000, rel=0.05)


def test_cell_label_is_the_tissue_that_fills_most():
    table = LabelTable(labels=(*TABLE.labels, Label(value=9, name="patch", role=Role.DEVICE)))
    shapes = {
        WALL: common(ball(9.0), slab(-20.0, 0.7)),
        9: common(ball(9.0), slab(0.7, 20.0)),
        0: lambda p: -ball(9.0)(p),
    }
    grid = build_grid(structures(shapes, lattice(13.0), table), GridSettings(cell_mm=2.0), pins=[PIN])
    height = grid.geometry.index_to_world(grid.cells)[:, 2]
    np.testing.assert_array_equal(grid.cell_label, np.where(height > 0.7, 9, WALL))


@pytest.mark.parametrize("settings", [{"cell_mm": 2.5}, {"node_count": 2000}])
def test_walls_that_are_grown_at_the_point_are_tissue(settings):
    chamber = Label(value=LEFT, name="left", role=Role.BLOOD, wall_thickness_mm=1.2)
    table = LabelTable(labels=(chamber,)).with_walls()
    made = structures({LEFT: ball(10.0)}, lattice(14.0, (2.0, 2.0, 2.0)), table)
    grid = build_grid(made, GridSettings(**settings), pins=[PIN])
    volume = 4 / 3 * np.pi * (11.2**3 - 10.0**3)
    # Half a voxel's sag of the ball between voxels moves both sides of the wall alike.
    assert grid.quality["grid_volume_ml"] * 1e3 == pytest.approx(volume, rel=0.03)
    assert set(grid.cell_label.tolist()) == {table.wall_value(LEFT)}
    assert set(grid.face_label.tolist()) == {0, LEFT}
    assert blood_pieces(grid) == 1


@pytest.mark.parametrize("ratio", [1.5, 2.0, 2.7])
def test_tissue_that_the_region_cuts_is_fixed(ratio):
    tube = {
        LEFT: cylinder(5.0, (0.0, 0.0, 1.0)),
        WALL: without(cylinder(8.0, (0.0, 0.0, 1.0)), cylinder(5.0, (0.0, 0.0, 1.0))),
    }
    geometry = lattice(12.0)
    grid = grid_of(tube, geometry, ratio, pins=())
    index = geometry.world_to_index(grid.node_positions_mm())[:, 2]
    at_low, at_high = index <= -0.5 + ratio + 1e-6, index >= geometry.size[2] - 0.5 - 2.0 * ratio - 1e-6
    fixed = grid.fixed.astype(bool)
    assert fixed[index < -0.4].all()
    assert fixed[index == index.max()].all()
    assert not fixed[~at_low & ~at_high].any()
    # The lumen stays open: no face of the blood's label lies beyond the tube's ends.
    assert set(grid.face_label.tolist()) == {0, LEFT}


def test_end_markers_and_pins_fix_and_nothing_fixed_is_refused():
    made = structures({WALL: cylinder(4.0, (0.0, 0.0, 1.0))}, lattice(12.0))
    closed = structures({WALL: common(cylinder(4.0, (0.0, 0.0, 1.0)), slab(-9.0, 7.0))}, lattice(12.0))
    with pytest.raises(StageError, match=r"\[\[pins\]\]"):
        build_grid(closed, GridSettings(cell_mm=2.0))
    with_end = dataclasses.replace(closed, fixed_planes=(((0.0, 0.0, 7.0), (0.0, 0.0, 1.0), 6.0),))
    grid = build_grid(with_end, GridSettings(cell_mm=2.0))
    height = grid.node_positions_mm()[grid.fixed.astype(bool)][:, 2]
    assert len(height) > 0
    assert height.min() > 7.0 - 2 * 2.0 - 0.5
    pinned = build_grid(closed, GridSettings(cell_mm=2.0), pins=[Pin(position_mm=(0.0, 0.0, -9.0), radius_mm=3.0)])
    distance = np.linalg.norm(pinned.node_positions_mm() - (0.0, 0.0, -9.0), axis=1)
    np.testing.assert_array_equal(pinned.fixed.astype(bool), distance <= 3.0)
    far = [Pin(position_mm=(0.0, 0.0, 50.0), radius_mm=1.0), Pin(position_mm=(50.0, 0.0, 0.0), radius_mm=1.0)]
    with pytest.raises(StageError) as caught:
        build_grid(made, GridSettings(cell_mm=2.0), pins=far)
    assert [problem.place for problem in caught.value.problems] == ["pins[1]", "pins[2]"]


def test_impossible_requests_are_refused_in_plain_words():
    with pytest.raises(StageError, match="too small"):
        grid_of({WALL: ball(8.0)}, lattice(12.0), 0.01)
    with pytest.raises(StageError, match="no tissue"):
        grid_of({LEFT: ball(8.0)}, lattice(12.0), 2.0)
    with pytest.raises(StageError, match="no tissue"):
        build_grid(structures({WALL: ball(8.0, (90.0, 0.0, 0.0))}, lattice(12.0)), GridSettings())
    with pytest.raises(StageError, match="smaller"):
        build_grid(structures({WALL: ball(2.0)}, lattice(12.0)), GridSettings(cell_mm=24.0), pins=[PIN])


@pytest.mark.parametrize("ratio", RATIOS)
@pytest.mark.parametrize("normal", [(0.0, 0.0, 1.0), (1.0, 1.0, 1.0), (1.0, 2.0, 0.0)])
def test_a_septum_of_one_voxel_stays_closed(normal, ratio):
    for shift in (0.0, 0.4):
        grid = grid_of(rooms(normal, 1.0), lattice(14.0, shift=(shift, shift / 2, shift)), ratio)
        assert grid.quality["betti_blood"]["full_resolution"][0] == 2
        assert blood_pieces(grid) == 2
        assert grid.quality["leaks_left"] == 0


@pytest.mark.parametrize("normal", [(0.0, 0.0, 1.0), (1.0, 1.0, 1.0), (1.0, 2.0, 0.0)])
@pytest.mark.parametrize("ratio", [2.0, 3.0])
def test_a_defect_of_one_and_a_half_cells_stays_open_at_every_offset(normal, ratio):
    for offset in np.random.default_rng(0).uniform(0.0, ratio, (6, 3)):
        grid = grid_of(rooms(normal, 3.0, canal_mm=1.5 * ratio), lattice(15.0, shift=offset), ratio)
        assert grid.quality["betti_blood"]["full_resolution"][0] == 1
        assert blood_pieces(grid) == 1
        assert grid.quality["openings_closed"] == 0


def test_without_repair_the_same_defect_closes_and_is_reported():
    for offset in np.random.default_rng(0).uniform(0.0, 3.0, (12, 3)):
        made = (rooms((0.0, 0.0, 1.0), 3.0, canal_mm=4.0), lattice(15.0, shift=offset), 3.0)
        raw = grid_of(*made, repair=False)
        if blood_pieces(raw) > 1:
            break
    assert blood_pieces(raw) == 2
    assert any("opening" in warning.text and "mm" in warning.text for warning in raw.warnings)
    assert any(warning.text.startswith("the blood is in 1 separate piece at") for warning in raw.warnings)
    fixed = grid_of(*made)
    assert blood_pieces(fixed) == 1
    assert fixed.quality["repairs"]["opening_cells_removed"] > 0


def test_gaps_in_the_muscle_that_are_lost_are_told_in_short_with_what_was_kept():
    # Slits of 1.2 mm through a block of muscle, beside a chamber: nothing of the blood changes.
    slits = union(*(box((0.6, 2.0, 30.0), (x, 7.0, 0.0)) for x in (-8.0, -4.0, 0.0, 4.0, 8.0)))
    chamber = box((9.0, 2.0, 9.0), (0.0, -4.0, 0.0))
    shapes = {LEFT: chamber, WALL: without(box((12.0, 11.0, 12.0)), union(slits, chamber))}
    grid = grid_of(shapes, lattice(30.0), 2.5)
    assert grid.quality["blood_changes"] == 0
    assert grid.quality["betti_tissue"]["full_resolution"][1] == 5
    lost = grid.quality["tissue_changes"]
    assert lost == 5 - grid.quality["betti_tissue"]["grid"][1] > 3
    (line,) = grid.warnings
    assert f"one of its cells (2.5 mm): {lost} places, the first at (" in line.text
    assert line.text.count("(") == 4
    assert "the chambers and the passages between them are as in the scan. Nothing need be done" in line.text


def test_a_second_hole_is_opened_too_although_blood_is_connected_already():
    n = np.array([0.0, 0.0, 1.0])
    canals = union(cylinder(3.0, n, (-6.0, 0.0, 0.0)), cylinder(1.7, n, (6.4, 0.3, 0.0)))
    blood = without(ball(12.0), without(slab(-2.0, 2.0), canals))
    shapes = {LEFT: blood, WALL: without(ball(14.0), blood)}
    closed = 0
    for shift in np.random.default_rng(1).uniform(0.0, 2.5, (6, 3)):
        raw = grid_of(shapes, lattice(18.0, shift=shift), 2.5, repair=False)
        if raw.quality["betti_blood"]["grid"] == [1, 0, 0]:
            closed += 1
            (line,) = [warning for warning in raw.warnings if "smallest gaps" in warning.text]
            assert line.grade is WarningGrade.NOTE
            assert "one of its cells (2.5 mm): 1 place, at (" in line.text
            # The hole between the chambers is gone, so nothing may be said to be as in the scan.
            assert "as in the scan" not in line.text
            assert not any("separate piece" in warning.text for warning in raw.warnings)
        grid = grid_of(shapes, lattice(18.0, shift=shift), 2.5)
        assert grid.quality["betti_blood"]["full_resolution"] == [1, 1, 0]
        assert grid.quality["betti_blood"]["grid"] == [1, 1, 0]
    assert closed > 0


@pytest.mark.parametrize("ratio", RATIOS)
def test_two_vessels_that_touch_keep_their_blood_apart(ratio):
    # A wall of one voxel parts the lumens along a line.
    left, right = cylinder(5.0, (0.0, 0.0, 1.0), (-5.5, 0.0, 0.0)), cylinder(5.0, (0.2, 0.0, 1.0), (5.7, 0.0, 0.0))
    walls = union(cylinder(6.5, (0.0, 0.0, 1.0), (-5.5, 0.0, 0.0)), cylinder(6.5, (0.2, 0.0, 1.0), (5.7, 0.0, 0.0)))
    lumens = union(left, right)
    shapes = {
        LEFT: left,
        RIGHT: without(right, left),
        WALL: without(walls, lumens),
        0: lambda p: -union(walls, lumens)(p),
    }
    limited = {v: common(s, slab(-2.0, 2.0)) for v, s in shapes.items() if v}
    grid = grid_of(limited, lattice(14.0, shift=(0.2, 0.1, 0.3)), ratio)
    full = grid.quality["betti_blood"]["full_resolution"][0]
    assert full == 2
    assert blood_pieces(grid) == 2


def test_a_membrane_that_no_cell_can_hold_is_closed_by_added_cells():
    # 0.9 mm in cells of 10 mm: 4.5% on both sides of a cell face, below the least coverage asked for.
    blood = {
        LEFT: common(box((14.0, 14.0, 14.0)), slab(0.45, 20.0)),
        RIGHT: common(box((14.0, 14.0, 14.0)), slab(-20.0, -0.45)),
    }
    outer = box((19.0, 19.0, 19.0))
    wall = without(outer, union(*blood.values()))
    made = structures(
        {**blood, WALL: wall, 0: lambda p: -outer(p)}, lattice(20.0, 0.5 * np.ones(3), shift=(0.25, 0.25, 0.25))
    )
    settings = {"cell_mm": 10.0, "coverage_min": 0.06}
    raw = build_grid(made, GridSettings(**settings, repair=False), pins=[PIN])
    grid = build_grid(made, GridSettings(**settings), pins=[PIN])
    assert raw.quality["betti_blood"]["full_resolution"][0] == 2
    assert blood_pieces(raw) == 1
    assert any("has a hole in the simulation" in warning.text for warning in raw.warnings)
    assert blood_pieces(grid) == 2
    assert grid.quality["repairs"]["leak_cells_added"] > 0
    assert grid.cell_coverage.min() >= np.float32(0.06)


def test_a_strand_that_breaks_in_the_cells_is_joined_again():
    strand = cylinder(0.8, (1.0, 0.3, 0.2))
    shape = union(ball(5.0, (-9.0, -2.7, -1.8)), ball(5.0, (9.0, 2.7, 1.8)), common(strand, ball(9.0)))
    geometry = lattice(16.0, (0.5, 0.5, 0.5))
    settings = {"cell_mm": 5.0, "coverage_min": 0.1}
    raw = build_grid(structures({WALL: shape}, geometry), GridSettings(**settings, repair=False), pins=[PIN])
    grid = build_grid(structures({WALL: shape}, geometry), GridSettings(**settings), pins=[PIN])
    assert raw.quality["betti_tissue"]["full_resolution"][0] == 1
    assert raw.quality["betti_tissue"]["grid"][0] > 1
    assert grid.quality["betti_tissue"]["grid"][0] == 1
    assert grid.quality["repairs"]["break_cells_added"] > 0


def test_blocks_that_touch_by_an_edge_are_joined_and_counted():
    first = box((4.0, 4.0, 4.0), (-5.0, -5.0, -1.0))
    blocks = union(first, box((4.0, 4.0, 4.0), (3.0, 3.0, -1.0)))
    geometry = lattice(13.0, shift=(0.5, 0.5, 0.5))
    settings = {"cell_mm": 2.0, "coverage_min": 0.1}
    pin = Pin(position_mm=(-5.0, -5.0, -1.0), radius_mm=4.0)
    raw = build_grid(structures({WALL: blocks}, geometry), GridSettings(**settings, repair=False), pins=[pin])
    grid = build_grid(structures({WALL: blocks}, geometry), GridSettings(**settings), pins=[pin])
    assert len(raw.cells) == 2 * 4**3
    assert raw.quality["hinges_left"] == 1
    assert any("swing" in warning.text for warning in raw.warnings)
    assert grid.quality["hinges_left"] == 0
    assert grid.quality["repairs"]["hinge_groups_joined"] == 1
    assert len(grid.cells) == len(raw.cells) + grid.quality["repairs"]["hinge_cells_added"]
    # The cells that joined hold no tissue, so it counts as spread over them.
    assert (grid.cell_coverage < 1.0).sum() == grid.quality["repairs"]["hinge_cells_added"]
    np.testing.assert_array_equal(grid.cell_moments, np.tile(FULL_MOMENTS, (len(grid.cells), 1)))
    assert not any("swing" in warning.text for warning in grid.warnings)
    json.dumps(grid.quality)


def test_a_piece_that_nothing_holds_is_named():
    shape = union(ball(5.0, (-7.0, 0.0, 0.0)), ball(3.0, (8.0, 0.0, 0.0)))
    pin = Pin(position_mm=(-7.0, 0.0, 0.0), radius_mm=6.0)
    grid = grid_of({WALL: shape}, lattice(13.0), 1.5, pins=[pin])
    warning = next(warning for warning in grid.warnings if "drift" in warning.text)
    place = [float(number) for number in re.search(r"at \((.*)\) mm", warning.text)[1].split(",")]
    np.testing.assert_allclose(place, (8.0, 0.0, 0.0), atol=0.3)


def test_thickness_of_a_plate_in_cells():
    grid = grid_of({WALL: common(slab(-2.0, 2.0, (1.0, 2.0, 2.0)), ball(20.0))}, lattice(14.0), 2.5)
    assert grid.quality["thickness_cells"]["p50"] == pytest.approx(4.0 / 2.5, abs=0.5 / 2.5)


@pytest.mark.parametrize("ratio", [2.0, 3.0, 4.0])
def test_a_vessel_little_wider_than_a_cell_keeps_its_lumen_and_its_volume(ratio):
    axis = np.array([1.0, 0.4, 0.7])
    lumen = cylinder(0.6 * ratio, axis)
    wall = without(cylinder(0.6 * ratio + 1.5, axis), lumen)
    grid = grid_of({LEFT: lumen, WALL: wall}, lattice(14.0), ratio, pins=())
    assert abs(grid.quality["volume_error_percent"]) < 2.0
    assert grid.cell_coverage.max() <= 1.0
    # Along the whole vessel a face with the lumen's label is near.
    centres = grid.node_positions_mm()[grid.faces].mean(axis=1)[grid.face_label == LEFT]
    along = np.arange(-10.0, 10.5, 0.5)[:, None] * axis / np.linalg.norm(axis)
    gap = np.linalg.norm(along[:, None] - centres[None], axis=2).min(axis=1)
    assert gap.max() < 3.0 * ratio


def test_the_same_bytes_every_time():
    first, second = (grid_of(rooms((1.0, 1.0, 1.0), 2.0, canal_mm=3.0), lattice(15.0), 2.0) for _ in range(2))
    for one in dataclasses.fields(first):
        a, b = getattr(first, one.name), getattr(second, one.name)
        assert a.tobytes() == b.tobytes() if isinstance(a, np.ndarray) else a == b


def test_structures_are_not_changed():
    made = structures({WALL: ball(8.0)}, lattice(12.0))
    before = {value: values.copy() for value, values in made.distance_mm.items()}
    build_grid(made, GridSettings(cell_mm=2.0), pins=[PIN])
    assert isinstance(made, Structures)
    for value, values in before.items():
        np.testing.assert_array_equal(made.distance_mm[value], values)


@settings(max_examples=25, deadline=None)
@given(seed=st.integers(0, 2**32 - 1), share=st.floats(0.3, 0.95))
def test_ridges_are_those_of_plain_array_arithmetic(seed, share):
    random = np.random.default_rng(seed)
    tissue = np.pad(random.random(random.integers(2, 9, 3)) < share, 1, mode="edge")
    tissue[0, 0, 0] = False
    depth = distance_in_samples(tissue)
    inner = (slice(1, -1),) * 3
    ridge = depth[inner].copy()
    peak = tissue[inner].copy()
    for axis in range(3):
        low, high = (np.roll(depth, step, axis)[inner] for step in (1, -1))
        peak &= (depth[inner] >= low) & (depth[inner] >= high)
        np.maximum(ridge, 0.5 * (low + high) + np.maximum(depth[inner] - low, depth[inner] - high), out=ridge)
    found = np.empty_like(ridge)
    _find_ridges(tissue, depth, found)
    np.testing.assert_array_equal(found, np.where(peak, ridge, 0.0))


def test_a_cell_without_a_label_takes_the_commonest_near_it():
    tissue = np.ones((3, 3, 5), bool)
    label = np.full(tissue.shape, 7, np.uint8)
    label[1, 1, 1] = 0
    label[:, :, 3:] = 4
    found = _labels_of_cells(label, tissue)
    assert found[1, 1, 1] == 7
    label[1, 1, 1] = 7
    np.testing.assert_array_equal(found, label)
    # a tie goes to the lowest label, and cells that are no tissue do not count
    row = np.array([[[9, 0, 5, 3]]], np.uint8)
    assert _labels_of_cells(row, row != 3)[0, 0, 1] == 5
