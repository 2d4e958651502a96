"""Kinds of triangles, and the rims of defects, on two chambers with a septum between them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from heartcase.pipeline.bundle.assembly import labels_of
from heartcase.pipeline.checks.openings import find_openings
from heartcase.pipeline.checks.rims import with_rims
from heartcase.pipeline.edits.apply_edits import apply_edits
from heartcase.pipeline.mesh.build_surface import build_surface
from heartcase.pipeline.walls.grow_walls import grow_walls
from heartcase.schemas.bundle.surface_kinds import SurfaceKind, group_labels, plain_kinds
from heartcase.schemas.labels import Label, LabelTable, Role
from heartcase.schemas.recipe.edit_settings import CloseDefect, SeptalDefect
from heartcase.schemas.recipe.settings import SurfaceSettings, WallsSettings
from tests.pipeline.checks.test_openings import MUSCLE, openings_of, walled

SETTINGS = SurfaceSettings(triangle_count=20_000, level_counts=(1_000,), normal_map_size=0)
WALL_MM = 6.0
HOLE_MM = 5.0


def shown(structures, edits=()):
    """The surface with its rims, and for each triangle its centre and unit normal."""
    openings = find_openings(structures, labels_of(structures), edits)
    surface = with_rims(build_surface(structures, SETTINGS, render=False), openings, structures.geometry)
    corner = surface.vertices_mm[surface.triangles].astype(float)
    doubled = np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0])
    return surface, corner.mean(axis=1), doubled / np.linalg.norm(doubled, axis=1)[:, None]


def test_the_wall_of_a_canal_that_an_edit_made_is_its_rim():
    edit = SeptalDefect(
        kind="septal_defect", position_mm=(1.0, 2.0, 0.0), axis=(0.0, 0.0, 1.0), diameter_mm=2.0 * HOLE_MM
    )
    structures = apply_edits(walled(holes=(), wall_mm=WALL_MM), [edit])
    surface, centre, normal = shown(structures, [edit])
    is_rim = surface.triangle_kind == SurfaceKind.DEFECT_RIM
    from_axis = np.linalg.norm(centre[:, :2] - [1.0, 2.0], axis=1)
    inside = np.abs(centre[:, 2]) < 0.5 * WALL_MM - 0.7
    is_wall = inside & (np.abs(from_axis - HOLE_MM) < 0.3) & (np.abs(normal[:, 2]) < 0.5)
    assert is_wall.sum() > 100
    assert is_rim[is_wall].all()
    # nothing but the canal's wall, and the septum's edge around its two mouths
    assert (np.abs(from_axis[is_rim] - HOLE_MM) < 2.0).all()
    assert (np.abs(centre[is_rim, 2]) < 0.5 * WALL_MM + 1.0).all()
    (level,) = surface.levels
    assert (level.triangle_kind == SurfaceKind.DEFECT_RIM).sum() > 10


def test_a_hole_that_no_heart_has_gets_a_rim_and_a_patch_takes_it_away():
    structures = walled(holes=((0.0, 0.0, HOLE_MM),), wall_mm=WALL_MM)
    surface, centre, _ = shown(structures)
    rim = centre[surface.triangle_kind == SurfaceKind.DEFECT_RIM]
    assert len(rim) > 100
    assert (np.abs(np.linalg.norm(rim[:, :2], axis=1) - HOLE_MM) < 1.5).all()
    around = np.arctan2(rim[:, 1], rim[:, 0])
    assert np.diff(np.sort(around)).max() < 0.3
    patch = CloseDefect(
        kind="close_defect", position_mm=(0.0, 0.0, 0.0), axis=(0.0, 0.0, 1.0), diameter_mm=2.0 * HOLE_MM + 3.0
    )
    closed, _, _ = shown(apply_edits(structures, [patch]), [patch])
    assert not (closed.triangle_kind == SurfaceKind.DEFECT_RIM).any()
    assert (closed.triangle_kind == SurfaceKind.DEVICE).sum() > 50


def test_a_valve_has_no_rim():
    structures = walled(holes=((0.0, 0.0, HOLE_MM),), wall_mm=WALL_MM)
    names = {1: "left atrium", 2: "left ventricle"}
    labels = tuple(
        label.model_copy(update={"name": names.get(label.value, label.name), "snomed": None})
        for label in structures.table
    )
    structures = replace(structures, table=LabelTable(labels=labels))
    assert [one.verdict.value for one in openings_of(structures)] == ["expected"]
    surface, _, _ = shown(structures)
    assert not (surface.triangle_kind == SurfaceKind.DEFECT_RIM).any()


TABLE = LabelTable(
    labels=(
        Label(value=1, name="left ventricle", role=Role.BLOOD),
        Label(value=2, name="aorta", role=Role.VESSEL_LUMEN, wall_thickness_mm=2.0),
        Label(value=3, name="left atrium", role=Role.BLOOD, wall_thickness_mm=2.0),
        Label(value=4, name="myocardium", role=Role.MYOCARDIUM),
        Label(value=5, name="patch", role=Role.DEVICE),
    )
).with_walls()


@pytest.mark.parametrize(
    ("void", "tissue", "is_cut", "kind", "group"),
    [
        (1, "myocardium", 0, SurfaceKind.ENDOCARDIUM, 1),
        (2, "aorta", 0, SurfaceKind.VESSEL_INSIDE, 2),
        (3, "left atrium", 0, SurfaceKind.ENDOCARDIUM, 3),
        (0, "myocardium", 0, SurfaceKind.EPICARDIUM, 0),
        (0, "left atrium", 0, SurfaceKind.EPICARDIUM, 0),
        (0, "aorta", 0, SurfaceKind.VESSEL_OUTSIDE, "aorta"),
        (1, "patch", 0, SurfaceKind.DEVICE, 5),
        (0, "myocardium", 1, SurfaceKind.CUT_FACE, 0),
        (0, "aorta", 1, SurfaceKind.CUT_FACE, 0),
    ],
)
def test_the_labels_on_both_sides_say_what_a_triangle_is(void, tissue, is_cut, kind, group):
    walls = {TABLE[label.wall_of].name: label.value for label in TABLE if label.wall_of is not None}
    values = {label.name: label.value for label in TABLE if label.role.is_tissue} | walls
    sides = np.array([void], np.uint8), np.array([values[tissue]], np.uint8)
    (found,) = plain_kinds(*sides, np.array([is_cut]), TABLE)
    assert found == kind
    assert group_labels(np.array([found]), *sides) == [walls.get(group, group)]


def test_a_septum_of_muscle_is_endocardium_on_both_sides():
    surface, _, _ = shown(walled(holes=(), wall_mm=WALL_MM))
    assert (surface.triangle_tissue[surface.triangle_kind == SurfaceKind.ENDOCARDIUM] == MUSCLE).all()


def test_muscle_and_wall_of_a_vessel_are_told_apart_outside():
    from heartcase.pipeline.data import Segmentation
    from tests.pipeline.lattices import lattice, points_of

    geometry = lattice("even", 44.0)
    points = points_of(geometry)
    labels = np.zeros(geometry.shape, np.uint8)
    ball = np.linalg.norm(points - np.array([0.0, 0.0, -6.0]), axis=-1)
    labels[ball < 12.0] = 4
    labels[ball < 8.0] = 1
    labels[(np.hypot(points[..., 0], points[..., 1]) < 4.0) & (points[..., 2] > 0.0) & (points[..., 2] < 18.0)] = 2
    plain = LabelTable(labels=tuple(label for label in TABLE if label.wall_of is None))
    structures = grow_walls(Segmentation(labels, geometry, plain), WallsSettings(), ())
    surface, centre, _ = shown(structures)
    vessel = surface.triangle_kind == SurfaceKind.VESSEL_OUTSIDE
    assert vessel.sum() > 100
    assert (centre[vessel, 2] > 2.0).all()
    muscle = surface.triangle_kind == SurfaceKind.EPICARDIUM
    assert np.abs(np.linalg.norm(centre[muscle] - np.array([0.0, 0.0, -6.0]), axis=1) - 12.0).max() < 1.5
