"""Pictures of surfaces: the right side, the right colour, the right size."""

import subprocess
import sys

import numpy as np
import pytest
import trimesh
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp
from matplotlib import colormaps
from scipy.ndimage import gaussian_filter

from heartcase.pipeline.mesh.triangles.thickness import vertex_normals
from heartcase.pipeline.report import render
from heartcase.pipeline.report.cutaway import clipped, crossings, filled
from heartcase.pipeline.report.montage import label_colours, legend_picture, montage, stacked
from heartcase.pipeline.report.pictures import (
    VIEWS,
    _value_colours,
    cutaway_picture,
    direction_letters,
    four_chamber_plane,
    surface_picture,
)
from heartcase.pipeline.report.render import Mesh, camera_for, downsampled, draw_mesh
from heartcase.schemas.labels import default_label_table
from tests.pipeline.report.analytic_heart import CAVITIES, make_heart

SIZE = (300, 240)

RED, BLUE = 1, 2
"""Left ventricle and right ventricle, in colours that can be told apart by their channels."""
TABLE = default_label_table()
for value, colour in ((RED, "#d8412f"), (BLUE, "#3f6fd0")):
    TABLE = TABLE.with_label(TABLE[value].model_copy(update={"colour": colour}))


@pytest.fixture(scope="module")
def heart():
    return make_heart(spacing_mm=(2.0, 2.0, 2.5))


def two_balls(offset: tuple[float, float, float]) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """A red ball in the middle and a blue one beside it."""
    one = trimesh.creation.icosphere(subdivisions=3, radius=8.0)
    vertices = np.concatenate([one.vertices, one.vertices + offset])
    triangles = np.concatenate([one.faces, one.faces + len(one.vertices)])
    return vertices, triangles, np.repeat([RED, BLUE], len(one.faces))


def centre_of(picture: np.ndarray, colour: int) -> np.ndarray:
    """Row and column of the middle of what is mostly red or blue."""
    channels = picture.astype(int)
    strong, weak = (0, 2) if colour == RED else (2, 0)
    return np.argwhere(channels[..., strong] - channels[..., weak] > 40).mean(axis=0)


@pytest.mark.parametrize(
    ("view", "to_the_right", "upwards"),
    [
        ("anterior", (1, 0, 0), (0, 0, 1)),
        ("posterior", (-1, 0, 0), (0, 0, 1)),
        ("left", (0, 1, 0), (0, 0, 1)),
        ("right", (0, -1, 0), (0, 0, 1)),
        ("superior", (-1, 0, 0), (0, -1, 0)),
        ("inferior", (1, 0, 0), (0, -1, 0)),
        ("surgeon", (0, 0, -1), (np.sqrt(0.75), -0.5, 0)),
    ],
)
def test_patient_directions_appear_on_the_right_side(view, to_the_right, upwards):
    for direction, axis, sign in ((to_the_right, 1, 1.0), (upwards, 0, -1.0)):
        vertices, triangles, label = two_balls(tuple(20.0 * np.array(direction)))
        picture = surface_picture(vertices, triangles, label, TABLE, view=view, size=SIZE)
        assert picture.shape == (SIZE[1], SIZE[0], 3)
        assert picture.dtype == np.uint8
        gap = centre_of(picture, BLUE) - centre_of(picture, RED)
        assert sign * gap[axis] > 40
        assert abs(gap[1 - axis]) < 3


def test_nearer_ball_hides_the_farther_one():
    vertices, triangles, label = two_balls((0.0, -20.0, 0.0))
    front = surface_picture(vertices, triangles, label, TABLE, view="anterior", size=SIZE)
    behind = surface_picture(vertices, triangles, label, TABLE, view="posterior", size=SIZE)
    assert front[120, 150, 2] > front[120, 150, 0] + 40
    assert behind[120, 150, 0] > behind[120, 150, 2] + 40


def test_outside_takes_the_tissue_colour():
    vertices, triangles, _ = two_balls((20.0, 0.0, 0.0))
    outside = np.zeros(len(triangles), int)
    tissue = np.repeat([9, 2], len(triangles) // 2)
    picture = surface_picture(vertices, triangles, outside, TABLE, triangle_tissue=tissue, size=SIZE)
    row, column = np.round(centre_of(picture, BLUE)).astype(int)
    hue = picture[row, column] / picture[row, column].max()
    wanted = np.array([int(TABLE[2].colour[n : n + 2], 16) for n in (1, 3, 5)])
    assert np.abs(hue - wanted / wanted.max()).max() < 0.12


def test_picture_has_true_lengths():
    ball = trimesh.creation.icosphere(subdivisions=4, radius=10.0)
    camera = camera_for(ball.vertices, towards=(0, -1, 0), up=(0, 0, 1), size=SIZE)
    mesh = Mesh(ball.vertices, ball.faces, ball.vertices / 10.0, np.full((len(ball.faces), 3), 128, np.uint8))
    covered = (draw_mesh(mesh, camera) < 250).any(axis=2).sum() * camera.mm_per_pixel**2
    assert covered == pytest.approx(np.pi * 100.0, rel=0.01)


@pytest.mark.thorough
def test_rasteriser_draws_what_vtk_draws(tmp_path):
    code = (
        "import sys, numpy as np\n"
        "from heartcase.pipeline.report.render import Mesh, camera_for, draw_mesh\n"
        "d = np.load(sys.argv[1])\n"
        "m = Mesh(d['v'], d['t'], d['n'], d['c'])\n"
        "camera = camera_for(m.points_mm, towards=(1, -2, 0.5), up=(0, 0, 1), size=(300, 240))\n"
        "np.save(sys.argv[2], draw_mesh(m, camera, backend='vtk'))\n"
    )
    vertices, triangles, label = two_balls((14.0, 6.0, 4.0))
    colours = np.array([[216, 65, 47], [63, 111, 208]], np.uint8)[label - 1]
    normals = vertex_normals(vertices, triangles)
    np.savez(tmp_path / "mesh.npz", v=vertices, t=triangles, n=normals, c=colours)
    # In a process of its own: without OpenGL, VTK ends the program.
    done = subprocess.run(
        [sys.executable, "-c", code, tmp_path / "mesh.npz", tmp_path / "vtk.npy"], capture_output=True, check=False
    )
    if done.returncode != 0:
        pytest.skip("VTK cannot draw on this machine")
    camera = camera_for(vertices, towards=(1, -2, 0.5), up=(0, 0, 1), size=SIZE)
    ours = draw_mesh(Mesh(vertices, triangles, normals, colours), camera).astype(int)
    gap = np.abs(ours - np.load(tmp_path / "vtk.npy").astype(int))
    assert gap.mean() < 1.5
    assert np.percentile(gap, 98) < 16


@pytest.mark.parametrize("colours_of_points", [False, True])
def test_clipping_leaves_the_area_of_a_spherical_cap(colours_of_points):
    ball = trimesh.creation.icosphere(subdivisions=4, radius=10.0)
    colours = np.zeros((len(ball.vertices) if colours_of_points else len(ball.faces), 3), np.uint8)
    mesh = Mesh(ball.vertices, ball.faces, ball.vertices / 10.0, colours, colours_of_points)
    plane = (np.array([0.0, 0.0, 4.0]), np.array([0.0, 0.0, 3.0]))
    kept = clipped(mesh, plane)
    assert kept.points_mm[kept.triangles][..., 2].max() == pytest.approx(4.0)
    corners = kept.points_mm[kept.triangles]
    area = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1).sum() / 2
    assert area == pytest.approx(2 * np.pi * 10.0 * 14.0, rel=0.005)
    assert len(kept.colours) == (len(kept.points_mm) if colours_of_points else len(kept.triangles))
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    assert ((normals * corners.mean(axis=1)).sum(axis=1) >= 0).all()


def test_cut_through_a_shell_fills_the_ring_and_nothing_else():
    ball = trimesh.creation.icosphere(subdivisions=4)
    vertices = np.concatenate([ball.vertices * 20.0, ball.vertices * 14.0])
    triangles = np.concatenate([ball.faces, ball.faces[:, ::-1] + len(ball.vertices)])
    plane = (np.array([0.0, 3.0, 0.0]), np.array([0.0, -1.0, 0.0]))
    camera = camera_for(vertices, towards=plane[1], up=(0, 0, 1), size=(500, 500))
    start, end, owner = crossings(vertices, triangles, plane)
    assert np.allclose(start[:, 1], 3.0)
    assert set(owner) <= set(range(len(triangles)))
    inside = filled(camera.project(start)[:, :2], camera.project(end)[:, :2], 500, 500)
    area = inside.sum() * camera.mm_per_pixel**2
    assert area == pytest.approx(np.pi * (20.0**2 - 14.0**2), rel=0.01)
    assert not inside[250, 250]


def test_hole_in_the_surface_leaves_rows_empty_instead_of_streaks():
    square = np.array([[10.0, 10.0], [10.0, 90.0], [90.0, 90.0], [90.0, 10.0]])
    whole = filled(square, np.roll(square, -1, axis=0), 100, 100)
    assert whole.sum() == 80 * 80
    torn = filled(square[:2], np.roll(square, -1, axis=0)[:2], 100, 100)
    assert not torn.any()


def test_cutaway_shows_chambers_and_cut_walls_in_their_colours(heart):
    s = heart.surface
    centre = np.array(CAVITIES[1][0])
    plane = (centre, (0.0, -1.0, 0.0))
    picture = cutaway_picture(
        s.vertices_mm, s.triangles, s.triangle_label, s.triangle_tissue, heart.table, plane=plane, size=(500, 500)
    ).astype(int)
    colour = [int(TABLE[9].colour[n : n + 2], 16) for n in (1, 3, 5)]
    pale = np.round(np.array(colour) * 0.72 + 255 * 0.28).astype(int)
    wall = np.abs(picture - pale).max(axis=2) <= 2
    assert wall.sum() > 3000
    rows, columns = np.nonzero(wall)
    middle = picture[round((rows.min() + rows.max()) / 2), round((columns.min() + columns.max()) / 2)]
    assert middle[0] > middle[1] + 60
    assert middle[0] > middle[2] + 60
    assert not wall[0].any()


def test_default_cut_passes_through_the_chambers(heart):
    s = heart.surface
    point, normal = four_chamber_plane(s.vertices_mm, s.triangles, s.triangle_label, heart.table)
    assert np.linalg.norm(normal) == pytest.approx(1.0)
    assert normal @ [0.0, -1.0, -1.0] > 0.0
    for value in (1, 2, 3, 4):
        centre, radii = CAVITIES[value]
        assert abs((np.array(centre) - point) @ normal) < 0.6 * min(radii)


def test_default_cut_without_chambers_is_nearly_coronal():
    vertices, triangles, _ = two_balls((20.0, 0.0, 0.0))
    point, normal = four_chamber_plane(vertices, triangles, np.zeros(len(triangles), int), TABLE)
    assert np.allclose(point, (10.0, 0.0, 0.0), atol=1e-6)
    assert normal[1] == pytest.approx(-np.cos(np.radians(20.0)))


def test_colours_of_values_are_those_of_viridis():
    values = np.linspace(3.0, 7.0, 1001)
    wanted = colormaps["viridis"](np.linspace(0.0, 1.0, 1001))[:, :3] * 255.0
    assert np.abs(_value_colours(values, 3.0, 7.0) - wanted).max() <= 3.1
    beyond = _value_colours(np.array([-50.0, 2.0, 8.0, 90.0]), 3.0, 7.0)
    assert np.array_equal(beyond, _value_colours(np.array([3.0, 3.0, 7.0, 7.0]), 3.0, 7.0))


def test_values_are_shown_by_the_colour_bar_and_missing_ones_grey():
    ball = trimesh.creation.icosphere(subdivisions=4, radius=10.0)
    values = ball.vertices[:, 0].copy()
    values[ball.vertices[:, 2] > 6.0] = np.nan
    label = np.zeros(len(ball.faces), int)
    picture = surface_picture(
        ball.vertices, ball.faces, label, TABLE, scalars=values, scalar_range=(-10, 10), size=SIZE, scalar_title="x"
    ).astype(int)
    left, right, top = picture[120, 90], picture[120, 210], picture[50, 150]
    # viridis runs from purple (blue above green) to yellow (red above blue).
    assert left[2] > left[1]
    assert right[1] > right[2] + 40
    assert np.ptp(top) < 8
    bar = picture[30:100, SIZE[0] - 70 : SIZE[0] - 60].mean(axis=1)
    assert bar[1, 0] > bar[1, 2] + 80
    assert bar[-3, 2] > bar[-3, 1] + 40


@pytest.mark.parametrize(
    ("direction", "letters"),
    [
        ((1, 0, 0), "L"),
        ((-3, 0, 0), "R"),
        ((0, 1, 0), "P"),
        ((0, -1, 0), "A"),
        ((0, 0, 1), "H"),
        ((0, 0, -1), "F"),
        ((0.9, -0.5, 0.1), "LA"),
        ((1, 1.2, -1.1), "PFL"),
        ((1.0, 0.2, 0.0), "L"),
    ],
)
def test_direction_letters(direction, letters):
    assert direction_letters(direction) == letters


def test_empty_and_one_sided_clips_are_drawn():
    vertices, triangles, label = two_balls((20.0, 0.0, 0.0))
    away = ((0.0, 0.0, -100.0), (0.0, 0.0, 1.0))
    nothing = surface_picture(vertices, triangles, label, TABLE, size=SIZE, clip=away)
    assert (nothing[40:200, 40:260] == 255).all()
    whole = surface_picture(vertices, triangles, label, TABLE, size=SIZE)
    untouched = surface_picture(vertices, triangles, label, TABLE, size=SIZE, clip=((0, 0, 100.0), (0, 0, 1.0)))
    assert np.array_equal(whole, untouched)


def test_sheets_hold_every_picture_and_name():
    pictures = {name: np.full((40, 60, 3), shade, np.uint8) for name, shade in (("a", 10), ("b", 120), ("c", 60))}
    sheet = montage(pictures, columns=2)
    for shade in (10, 120, 60):
        assert (sheet == shade).all(axis=2).sum() >= 40 * 60
    names = label_colours(TABLE, [1, 5])
    assert names == {TABLE[1].name: TABLE[1].colour, TABLE[5].name: TABLE[5].colour}
    narrow, wide = legend_picture(names, width=220), legend_picture(names, width=800)
    assert narrow.shape[0] > wide.shape[0]
    assert (wide == [int(TABLE[5].colour[n : n + 2], 16) for n in (1, 3, 5)]).all(axis=2).sum() > 150
    assert stacked([sheet, wide]).shape[:2] == (sheet.shape[0] + wide.shape[0], 800)


def test_views_are_right_handed():
    for towards, up in VIEWS.values():
        camera = camera_for(np.eye(3), towards=towards, up=up, size=SIZE)
        assert np.linalg.det([camera.right, camera.up, camera.towards]) == pytest.approx(1.0)
        assert np.allclose(camera.towards, towards)


@given(
    factor=st.integers(1, 4),
    height=st.integers(1, 5),
    width=st.integers(1, 5),
    data=st.data(),
)
def test_a_smaller_picture_is_the_mean_of_each_block(factor, height, width, data):
    picture = data.draw(hnp.arrays(np.uint8, (factor * height, factor * width, 3)))
    mean = [
        [picture[y : y + factor, x : x + factor].mean(axis=(0, 1)) for x in range(0, factor * width, factor)]
        for y in range(0, factor * height, factor)
    ]
    smaller = downsampled(picture, factor)
    assert smaller.dtype == np.uint8
    # Between two whole numbers either is right.
    np.testing.assert_allclose(smaller, mean, atol=0.5 + 1e-5)


@given(st.integers(0, 2**32), st.integers(5, 40), st.integers(5, 40), st.floats(0.02, 2.0))
@settings(max_examples=50)
def test_depth_shading_is_that_of_whole_arrays(seed, height, width, mm_per_pixel):
    random = np.random.default_rng(seed)
    picture = random.integers(0, 256, (height, width, 3), np.uint8)
    depth = np.where(random.random((height, width)) < 0.7, random.normal(0.0, 8.0, (height, width)), -np.inf)
    picture[~np.isfinite(depth)] = 255
    wanted = depth_shaded(picture, depth, mm_per_pixel)
    render._shade_by_depth(picture, depth, mm_per_pixel)
    np.testing.assert_array_equal(picture, wanted)


def depth_shaded(picture, depth, mm_per_pixel):
    """The formula as it is written: mean depth of a quarter of the pixels each way, then light from the difference."""
    seen = np.isfinite(depth)
    height = np.where(seen, depth, 0.0)
    reach = 3.0 / (mm_per_pixel * 4)
    weight = gaussian_filter(seen[::4, ::4].astype(float), reach)
    mean = gaussian_filter(height[::4, ::4], reach) / np.maximum(weight, 1e-3)
    mean = mean.repeat(4, axis=0).repeat(4, axis=1)[: depth.shape[0], : depth.shape[1]]
    light = np.clip(1.0 - 0.07 * np.maximum(mean - height, 0.0), 0.6, 1.0)
    return np.where(seen[..., None], np.round(picture * light[..., None]), 255.0).astype(np.uint8)
