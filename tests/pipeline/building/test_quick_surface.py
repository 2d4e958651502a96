"""The quick surface, against balls whose sizes are known, and the number of holes that an edit makes."""

import numpy as np
import pytest

from heartcase.pipeline.building.quick_surface import quick_surface
from heartcase.pipeline.data import Segmentation
from heartcase.pipeline.mesh.extraction.extract import enclosed_volume_mm3
from heartcase.schemas.errors import StageError
from heartcase.schemas.geometry import Geometry
from heartcase.schemas.labels import default_label_table
from heartcase.schemas.recipe.recipe import parse_recipe

TABLE = default_label_table()
LEFT, RIGHT = TABLE["left atrium"].value, TABLE["right atrium"].value
APART, RADIUS = 26.0, 11.0
"""Two cavities of this radius, mm, their middles so far apart along x; 4 mm of muscle between them."""

TEXT = """
heartcase_recipe = 1
name = "balls"
[scan]
path = "scan.nii.gz"
"""
DEFECT = """
[[edits]]
kind = "septal_defect"
position_mm = [0.0, 0.0, 0.0]
diameter_mm = 4.0
axis = [1.0, 0.0, 0.0]
"""


def recipe(more=""):
    return parse_recipe(TEXT + more, needs_markers=False)


def two_balls(size=96, spacing=0.75):
    geometry = Geometry.of(shape=(size,) * 3, spacing_mm=(spacing,) * 3, origin_mm=(-0.5 * spacing * (size - 1),) * 3)
    k, j, i = np.meshgrid(*(np.arange(size),) * 3, indexing="ij")
    at = geometry.index_to_world(np.stack([i, j, k], axis=-1))
    labels = np.zeros(geometry.shape, np.uint8)
    for value, side in ((LEFT, -0.5), (RIGHT, 0.5)):
        labels[np.linalg.norm(at - [side * APART, 0.0, 0.0], axis=-1) <= RADIUS] = value
    return Segmentation(labels, geometry, TABLE)


def parts(surface):
    """Triangles of each connected part of a surface, the largest part first."""
    count = len(surface.vertices_mm)
    part = np.arange(count)
    for _ in range(count):
        low = part[surface.triangles].min(axis=1)
        before = part.copy()
        np.minimum.at(part, surface.triangles.ravel(), np.repeat(low, 3))
        part = part[part]
        if (part == before).all():
            break
    names = part[surface.triangles[:, 0]]
    return sorted((surface.triangles[names == name] for name in np.unique(names)), key=len, reverse=True)


def euler(triangles):
    """Euler characteristic of a closed surface: 2 for each part of it, less 2 for each handle."""
    edges = np.unique(np.sort(triangles[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2), axis=1), axis=0)
    return len(np.unique(triangles)) - len(edges) + len(triangles)


def shells(surface):
    """Euler characteristics of the connected parts of a surface, the largest part first."""
    return [euler(triangles) for triangles in parts(surface)]


def test_walls_are_as_thick_as_they_are_stated_on_every_other_voxel():
    surface = quick_surface(two_balls(), recipe())
    assert surface.spacing_mm == (1.5, 1.5, 1.5)
    assert surface.problems == ()
    # an outer shell and the insides of two cavities
    assert shells(surface) == [2, 2, 2]
    away = np.linalg.norm(surface.vertices_mm - np.array([0.5 * APART, 0.0, 0.0]), axis=1)
    outside = surface.vertices_mm[:, 0] > 0.5 * APART + 3.0
    wall = TABLE["right atrium"].wall_thickness_mm
    for low, high, radius in ((0.0, RADIUS + 0.5 * wall, RADIUS), (RADIUS + 0.5 * wall, 99.0, RADIUS + wall)):
        shell = away[outside & (away > low) & (away < high)]
        assert abs(shell.mean() - radius) < 0.5
        assert np.abs(shell - radius).max() < 1.2
    # closed, facing outwards, its normals too
    volume = enclosed_volume_mm3(surface.vertices_mm.astype(float), surface.triangles)
    assert 0.0 < volume < 2.2 * 4.0 / 3.0 * np.pi * ((RADIUS + wall) ** 3 - RADIUS**3)
    outer = outside & (away > RADIUS + 0.5 * wall)
    towards = surface.vertices_mm[outer] - np.array([0.5 * APART, 0.0, 0.0])
    assert (np.einsum("ij,ij->i", surface.normals[outer].astype(float), towards) > 0.0).all()


def test_a_first_look_has_the_same_walls_to_about_a_voxel_of_its_own():
    fine, first = (quick_surface(two_balls(128, 0.5), recipe(), is_coarse=is_coarse) for is_coarse in (False, True))
    voxel = first.spacing_mm[0]
    assert fine.spacing_mm[0] < voxel < 4.0
    assert len(first.triangles) < 0.8 * len(fine.triangles)
    for side in (-0.5, 0.5):
        away = np.linalg.norm(first.vertices_mm - [side * APART, 0.0, 0.0], axis=1)
        # the cavity's wall is what lies nearest to its middle
        inner = away[away < RADIUS + 1.5]
        assert len(inner) > 100
        assert abs(inner - RADIUS).max() < voxel


@pytest.mark.parametrize("is_coarse", [False, True])
def test_one_thread_makes_the_surface_that_several_make(monkeypatch, is_coarse):
    given = two_balls(), recipe(DEFECT)
    one = quick_surface(*given, is_coarse=is_coarse)
    monkeypatch.setattr("heartcase.pipeline.building.quick_surface.MOST_IN_ONE_THREAD", 0)
    several = quick_surface(*given, is_coarse=is_coarse)
    for name in ("vertices_mm", "normals", "colours", "triangles"):
        np.testing.assert_array_equal(getattr(one, name), getattr(several, name))
    assert one.problems == several.problems


def test_a_defect_makes_one_cavity_of_two_and_what_meets_nothing_is_told_and_left_out():
    segmentation = two_balls()
    surface = quick_surface(segmentation, recipe(DEFECT))
    assert surface.problems == ()
    assert shells(surface) == [2, 2]
    wrong = quick_surface(segmentation, recipe(DEFECT.replace("[0.0, 0.0, 0.0]", "[0.0, 30.0, 0.0]")))
    assert [problem.place for problem in wrong.problems] == ["edits[1]"]
    assert shells(wrong) == [2, 2, 2]
    end = '\n[[ends]]\nlabel = "aorta"\nposition_mm = [0.0, 0.0, 0.0]\naxis = [1.0, 0.0, 0.0]\nradius_mm = 3.0\n'
    both = quick_surface(segmentation, recipe(end + DEFECT))
    assert both.problems[0].place == "ends[1]"


ADD = """
[[edits]]
kind = "add"
label = "left atrium wall"
radius_mm = {radius}
points_mm = [{point}]
"""


def test_only_the_edits_that_are_wrong_are_left_out():
    segmentation = two_balls()
    far = DEFECT.replace("[0.0, 0.0, 0.0]", "[0.0, 30.0, 0.0]")
    # the second one is wrong as well, and named by its place in the recipe
    surface = quick_surface(segmentation, recipe(far + far.replace("30.0", "31.0") + DEFECT))
    assert [problem.place for problem in surface.problems] == ["edits[1]", "edits[2]"]
    assert shells(surface) == [2, 2]
    one_by_one = quick_surface(segmentation, recipe(DEFECT + far))
    assert [problem.place for problem in one_by_one.problems] == ["edits[2]"]
    assert shells(one_by_one) == [2, 2]


def test_only_the_ends_that_are_wrong_are_left_out():
    size, spacing = 96, 0.75
    geometry = Geometry.of(shape=(size,) * 3, spacing_mm=(spacing,) * 3, origin_mm=(-0.5 * spacing * (size - 1),) * 3)
    k, j, i = np.meshgrid(*(np.arange(size),) * 3, indexing="ij")
    x, y, z = np.moveaxis(geometry.index_to_world(np.stack([i, j, k], axis=-1)), -1, 0)
    labels = np.zeros(geometry.shape, np.uint8)
    labels[(np.hypot(x, y) <= 6.0) & (np.abs(z) <= 25.0)] = TABLE["aorta"].value
    segmentation = Segmentation(labels, geometry, TABLE)
    line = '\n[[ends]]\nlabel = "{label}"\nposition_mm = [0.0, 0.0, {z}]\naxis = [0.0, 0.0, {way}]\nradius_mm = 8.0\n'
    good = [line.format(label="aorta", z=way * 15.0, way=way) for way in (-1.0, 1.0)]
    bad = line.format(label="pulmonary artery", z=15.0, way=1.0)
    # a tube that is open at both ends: one surface, like a ring's
    assert shells(quick_surface(segmentation, recipe("".join(good)))) == [0]
    for wrong, number in ((bad + good[0] + good[1], 1), (good[0] + bad + good[1], 2)):
        surface = quick_surface(segmentation, recipe(wrong + DEFECT))
        assert [problem.place for problem in surface.problems] == [f"ends[{number}]", "edits[1]"]
        assert shells(surface) == [0]


def test_what_is_sculpted_away_from_the_labels_is_in_the_surface_whole():
    at = [-0.5 * APART, 0.0, 26.0]
    surface = quick_surface(two_balls(), recipe(ADD.format(radius=7.0, point=at)))
    assert surface.problems == ()
    away = np.linalg.norm(surface.vertices_mm - np.array(at), axis=1)
    ball = surface.vertices_mm[away < 8.5]
    assert np.abs(ball - at).max(axis=0) == pytest.approx([7.0] * 3, abs=0.8)
    assert np.abs(away[away < 8.5] - 7.0).max() < 0.8


def test_nothing_painted_is_said():
    empty = two_balls()
    labels = np.where(empty.labels > 0, 255, 0).astype(np.uint8)
    with pytest.raises(StageError, match="nothing is segmented but background"):
        quick_surface(Segmentation(labels, empty.geometry, TABLE), recipe())
