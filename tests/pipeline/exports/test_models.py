"""The hollow and the solid model against spheres, and against each other."""

from __future__ import annotations

import numpy as np
import pytest

from heartcase.pipeline.bundle.assembly import labels_of
from heartcase.pipeline.data import Segmentation
from heartcase.pipeline.exports.models import hollow_model, solid_model, walls_smoothing_mm
from heartcase.pipeline.exports.print_check import check_for_printing
from heartcase.pipeline.mesh.build_surface import build_surface
from heartcase.pipeline.mesh.triangles.mesh_distance import mesh_distance_mm
from heartcase.pipeline.mesh.triangles.triangle_grid import triangle_grid
from heartcase.pipeline.walls.grow_walls import grow_walls
from heartcase.schemas.bundle.reader import open_bundle
from heartcase.schemas.errors import StageError
from heartcase.schemas.geometry import Geometry
from heartcase.schemas.labels import Label, LabelTable, Role
from heartcase.schemas.recipe.settings import SurfaceSettings, WallsSettings
from tests.pipeline.solids import OBLIQUE, points
from tests.readers.test_readers import ROOT

GEOMETRY = Geometry.of(shape=(30, 36, 40), origin_mm=(-20, 5, -60), spacing_mm=(1.25, 1.25, 1.5), direction=OBLIQUE)
CENTRE = GEOMETRY.index_to_world([(n - 1) / 2 for n in GEOMETRY.size])
TABLE = LabelTable(
    labels=(
        Label(value=1, name="left ventricle", role=Role.BLOOD),
        Label(value=3, name="left atrium", role=Role.BLOOD, wall_thickness_mm=2.5),
        Label(value=9, name="left ventricular myocardium", role=Role.MYOCARDIUM),
    )
)


def segmentation(radius_mm=12.0):
    """A ball of blood: below its middle the ventricle in 4 mm of muscle, above it the atrium, whose wall is grown."""
    away = points(GEOMETRY) - CENTRE
    distance = np.linalg.norm(away, axis=-1)
    above = away @ OBLIQUE[:, 2] > 0.0
    labels = np.where(distance < radius_mm, np.where(above, 3, 1), 0).astype(np.uint8)
    labels[(distance >= radius_mm) & (distance < radius_mm + 4.0) & ~above] = 9
    return Segmentation(labels, GEOMETRY, TABLE)


@pytest.fixture(scope="module")
def structures():
    return grow_walls(segmentation(), WallsSettings(), ())


@pytest.fixture(scope="module")
def solid(structures):
    """From the labels as a case holds them: with the grown wall."""
    return solid_model(labels_of(structures))


def test_the_cast_of_a_ball_is_a_ball(solid):
    check = check_for_printing(solid, min_thickness_mm=1.0)
    assert (check.piece_count, check.closed_hollow_count, check.self_intersection_count) == (1, 0, 0)
    assert check.thin is None
    assert check.volume_ml == pytest.approx(4.0 / 3.0 * np.pi * 12.0**3 / 1000.0, rel=0.01)
    radius = np.linalg.norm(solid.vertices_mm - CENTRE, axis=1)
    # a third of a voxel, at the rim where four labels meet
    assert np.abs(radius - 12.0).max() < 0.45
    assert np.sqrt(np.mean((radius - 12.0) ** 2)) < 0.2
    outward = ((solid.vertices_mm - CENTRE) / radius[:, None] * solid.normals).sum(axis=1)
    assert outward.min() > 0.9


def test_the_cast_is_named_by_its_chambers(solid):
    middle = solid.vertices_mm[solid.triangles].mean(axis=1) - CENTRE
    height = middle @ OBLIQUE[:, 2]
    np.testing.assert_array_equal(solid.structure, solid.triangle_label)
    assert set(solid.triangle_label[height > 1.5]) == {3}
    assert set(solid.triangle_label[height < -1.5]) == {1}
    # the muscle was segmented; the atrium's wall was grown, and its place is background here
    assert set(solid.triangle_tissue[height < -3.0]) == {9}
    assert set(solid.triangle_tissue[height > 3.0]) == {0}
    assert [label.name for label in solid.structures] == ["left ventricle", "left atrium"]
    assert not solid.triangle_is_cut.any()


def test_the_cast_fills_just_what_the_hollow_model_leaves_open(structures, solid):
    surface = build_surface(structures, SurfaceSettings(triangle_count=20_000), render=False)
    inside = surface.triangles[surface.triangle_label != 0]
    assert (
        mesh_distance_mm(
            solid.vertices_mm.astype(float), triangle_grid(surface.vertices_mm.astype(float), inside)
        ).max()
        < 0.02
    )
    used = surface.vertices_mm[np.unique(inside)].astype(float)
    away = mesh_distance_mm(used, triangle_grid(solid.vertices_mm.astype(float), solid.triangles))
    assert away.max() < 0.02


@pytest.mark.parametrize("smoothing_mm", [None, 2.5])
def test_blood_that_only_a_wall_of_one_voxel_parts_stays_apart(smoothing_mm):
    labels = segmentation().labels
    height = (points(GEOMETRY) - CENTRE) @ OBLIQUE[:, 2]
    labels[(height > 0.0) & (height < 1.5) & np.isin(labels, (1, 3))] = 9
    cast = solid_model(Segmentation(labels, GEOMETRY, TABLE), smoothing_mm=smoothing_mm)
    assert check_for_printing(cast, min_thickness_mm=1.0).piece_count == 2


def test_a_structure_that_is_too_small_is_told():
    whole = segmentation()
    for size, smoothing_mm, is_cast in ((3, None, True), (3, 4.0, False), (1, 0.0, False)):
        labels = np.where(whole.labels == 3, 0, whole.labels).astype(np.uint8)
        labels[2 : 2 + size, 2 : 2 + size, 2 : 2 + size] = 3
        cast = solid_model(Segmentation(labels, GEOMETRY, TABLE), smoothing_mm=smoothing_mm)
        assert set(cast.triangle_label) == ({1, 3} if is_cast else {1})
        assert cast.warnings == (() if is_cast else ("the cast lacks the left atrium, which is too small for it",))


def test_without_blood_there_is_no_cast():
    whole = segmentation()
    speck = np.zeros_like(whole.labels)
    speck[5, 5, 5] = 1
    with pytest.raises(StageError, match="too small for the smoothing"):
        solid_model(Segmentation(speck, GEOMETRY, TABLE), smoothing_mm=2.0)
    with pytest.raises(StageError, match="no blood"):
        solid_model(Segmentation(np.where(whole.labels == 9, 9, 0).astype(np.uint8), GEOMETRY, TABLE))


def test_the_hollow_model_is_the_surface_of_the_case():
    bundle = open_bundle(ROOT / "tests" / "golden" / "lopsided.case")
    hollow = hollow_model(bundle)
    check = check_for_printing(hollow, min_thickness_mm=1.0)
    assert check.piece_count == 1
    names = [label.name for label in hollow.structures]
    assert names == ["left ventricle", "left ventricular myocardium", "aorta wall"]
    cavity = hollow.triangle_label == 1
    np.testing.assert_array_equal(hollow.structure[cavity], 1)
    np.testing.assert_array_equal(hollow.structure[~cavity], hollow.triangle_tissue[~cavity])
    assert tuple(hollow.colours[cavity][0]) == (0xD8, 0x41, 0x2F)
    assert walls_smoothing_mm(bundle) is None
