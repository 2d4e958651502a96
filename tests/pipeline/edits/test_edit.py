"""Edits against the shapes they ask for: diameter, place, what joins what, and what is refused."""

import cc3d
import numpy as np
import pytest
from pydantic import ValidationError

from heartcase.pipeline.artifacts.serialise import artifact_from_bytes, artifact_to_bytes
from heartcase.pipeline.data import Segmentation, Structures
from heartcase.pipeline.edits.apply_edits import apply_edits, made_by, with_edit_names
from heartcase.pipeline.fields.reader import ownership_at_points, ownership_on_lattice
from heartcase.pipeline.walls.grow_walls import grow_walls, structure_volumes_ml
from heartcase.pipeline.warnings import CaseWarning, WarningGrade, of_edit
from heartcase.schemas.errors import StageError, problems_from_validation
from heartcase.schemas.labels import Label, LabelTable, Role
from heartcase.schemas.recipe.edit_settings import CloseDefect, KeepLargest, Sculpt, SeptalDefect
from heartcase.schemas.recipe.settings import WallsSettings
from tests.pipeline.lattices import LATTICES, lattice, points_of
from tests.thoroughly import thoroughly

NORMAL = np.array([0.48, 0.6, 0.64])
SIDE = np.array([0.8, -0.6, 0.0]) / np.linalg.norm([0.8, -0.6, 0.0])
SIDE = SIDE - (SIDE @ NORMAL) * NORMAL
SIDE /= np.linalg.norm(SIDE)
UP = np.cross(NORMAL, SIDE)


def two_cavities(kind="oblique", *, septum_mm=8.0, wall_mm=0.0, septum_label=3) -> Structures:
    """A ball of two cavities with a plane septum across ``NORMAL`` between them."""
    geometry = lattice(kind, 46.0)
    points = points_of(geometry)
    height = points @ NORMAL
    labels = np.where(np.abs(height) < 0.5 * septum_mm, septum_label, np.where(height < 0.0, 1, 2))
    labels[np.linalg.norm(points, axis=-1) > 16.0] = 0
    table = LabelTable(
        labels=(
            Label(value=1, name="left ventricle", role=Role.BLOOD, wall_thickness_mm=wall_mm),
            Label(value=2, name="right ventricle", role=Role.BLOOD, wall_thickness_mm=wall_mm),
            Label(value=3, name="septum", role=Role.MYOCARDIUM),
        )
    )
    return grow_walls(Segmentation(labels.astype(np.uint8), geometry, table), WallsSettings(), ())


def defect(diameter=5.0, *, at=(0.0, 0.0, 0.0), axis=NORMAL, length=16.0) -> SeptalDefect:
    return SeptalDefect(
        kind="septal_defect", position_mm=at, diameter_mm=diameter, axis=tuple(2.0 * axis), length_mm=length
    )


def patch(diameter=9.0, *, thickness=1.0, at=(0.0, 0.0, 0.0), label="patch") -> CloseDefect:
    return CloseDefect(
        kind="close_defect",
        position_mm=at,
        diameter_mm=diameter,
        axis=tuple(NORMAL),
        thickness_mm=thickness,
        label=label,
    )


def sculpt(kind, label, points, radius=4.0, into=None) -> Sculpt:
    return Sculpt(kind=kind, label=label, radius_mm=radius, points_mm=points, into=into)


def owners(structures, points):
    owner = ownership_at_points(structures, np.asarray(points).reshape(-1, 3))
    labels = np.where(owner.tissue_mm < 0.0, owner.tissue_label, owner.void_label)
    return labels.reshape(np.asarray(points).shape[:-1])


def compartments(structures, factor=3) -> int:
    """6-connected pieces of blood on a fine lattice."""
    owner = ownership_on_lattice(structures, structures.geometry.refined(factor))
    blood = (owner.tissue_mm > 0.0) & np.isin(owner.void_label, structures.table.blood_values)
    return int(cc3d.connected_components(blood, connectivity=6).max())


def disc(height=0.0, half=8.0, count=321):
    """Points of a plane across the septum, and their two coordinates."""
    u, v = np.meshgrid(*(np.linspace(-half, half, count),) * 2)
    return height * NORMAL + u[..., None] * SIDE + v[..., None] * UP, u, v


@pytest.mark.parametrize("kind", thoroughly(LATTICES, 0, len(LATTICES) - 1))
@pytest.mark.parametrize("diameter", [2.0, 5.0])
def test_a_defect_has_its_diameter_and_place(kind, diameter):
    structures = two_cavities(kind)
    assert compartments(structures) == 2
    shift = 1.5 * SIDE - 0.7 * UP
    edited = apply_edits(structures, (defect(diameter, at=tuple(shift)),))
    assert compartments(edited) == 1
    for height in (-2.0, 0.0, 2.0):
        points, u, v = disc(height)
        hole = np.isin(owners(edited, points), (1, 2))
        area = hole.sum() * (u[0, 1] - u[0, 0]) ** 2
        assert 2.0 * np.sqrt(area / np.pi) == pytest.approx(diameter, abs=0.05)
        assert u[hole].mean() == pytest.approx(1.5, abs=0.02)
        assert v[hole].mean() == pytest.approx(-0.7, abs=0.02)
    points, _, _ = disc(9.0)
    assert (owners(edited, points) == owners(structures, points)).all()


SKEW = tuple(SIDE + 0.4 * UP + 0.7 * NORMAL)
"""A long axis as a person would give it: neither of length one nor at right angles to the axis."""


def plane_of(long_axis):
    """The part of a long axis across ``NORMAL``, and what is at right angles to both."""
    long = np.array(long_axis) - (np.array(long_axis) @ NORMAL) * NORMAL
    long /= np.linalg.norm(long)
    return long, np.cross(NORMAL, long)


def in_shape(shape, long, short, u, v):
    if shape == "elliptic":
        return (2.0 * u / long) ** 2 + (2.0 * v / short) ** 2 < 1.0
    return np.hypot(np.maximum(np.abs(u) - 0.5 * (long - short), 0.0), v) < 0.5 * short


@pytest.mark.parametrize("kind", thoroughly(LATTICES, 0, len(LATTICES) - 1))
@pytest.mark.parametrize("shape", ["elliptic", "slit"])
def test_a_defect_has_its_shape(kind, shape):
    structures = two_cavities(kind)
    round_one = defect(9.0)
    one = SeptalDefect.model_validate(round_one.model_dump() | {"shape": shape, "width_mm": 3.0, "long_axis": SKEW})
    edited = apply_edits(structures, (one,))
    assert compartments(edited) == 1
    assert edited.thinnest_layer_mm is None
    long, short = plane_of(SKEW)
    for height in (-2.0, 0.0, 2.0):
        points, u, _ = disc(height)
        hole = np.isin(owners(edited, points), (1, 2))
        true = in_shape(shape, 9.0, 3.0, points @ long, points @ short)
        step = u[0, 1] - u[0, 0]
        assert hole.sum() * step**2 == pytest.approx(one.area_mm2, rel=0.01)
        assert np.ptp((points @ long)[hole]) == pytest.approx(9.0, abs=0.06)
        assert np.ptp((points @ short)[hole]) == pytest.approx(3.0, abs=0.06)
        assert (hole != true).mean() < 0.003


@pytest.mark.parametrize("shape", ["elliptic", "slit"])
def test_a_patch_has_its_shape(shape):
    wide = SeptalDefect.model_validate(defect(9.0).model_dump() | {"shape": shape, "width_mm": 5.0, "long_axis": SKEW})
    sheet = CloseDefect.model_validate(
        patch(7.0, thickness=0.6).model_dump() | {"shape": shape, "width_mm": 2.5, "long_axis": SKEW}
    )
    edited = apply_edits(two_cavities(), (wide, sheet))
    assert edited.thinnest_layer_mm == pytest.approx(0.6)
    points, _, _ = disc()
    long, short = plane_of(SKEW)
    found = owners(edited, points) == edited.table["patch"].value
    assert (found != in_shape(shape, 7.0, 2.5, points @ long, points @ short)).mean() < 0.003


@pytest.mark.parametrize(
    ("update", "places"),
    [
        ({"shape": "slit"}, ["width_mm", "long_axis"]),
        ({"width_mm": 2.0, "long_axis": (1.0, 0.0, 0.0)}, ["width_mm", "long_axis"]),
        ({"shape": "elliptic", "width_mm": 5.1, "long_axis": tuple(NORMAL)}, ["width_mm", "long_axis"]),
        ({"shape": "elliptic", "width_mm": 5.0, "long_axis": (0.0, 0.0, 0.0)}, ["long_axis"]),
    ],
)
def test_sizes_that_do_not_fit_the_shape_are_refused(update, places):
    with pytest.raises(ValidationError) as error:
        SeptalDefect.model_validate(defect().model_dump() | update)
    assert [problem.place for problem in problems_from_validation(error.value)] == places


def test_the_canal_is_the_nearer_cavitys():
    edited = apply_edits(two_cavities(), (defect(),))
    line = np.linspace(-6.0, 6.0, 601)
    found = owners(edited, line[:, None] * NORMAL)
    assert set(found) == {1, 2}
    change = line[np.argmax(found == 2)]
    assert abs(change) < 0.35
    assert (found[line < change] == 1).all()


def test_a_defect_through_a_wall_thinner_than_a_voxel():
    """The background between two cavities is filled by their walls of 1.7 mm each."""
    structures = two_cavities("even", septum_mm=2.5, wall_mm=1.7, septum_label=0)
    edited = apply_edits(structures, (defect(4.0, length=10.0),))
    assert compartments(structures) == 2
    assert compartments(edited) == 1
    points, u, _ = disc()
    hole = np.isin(owners(edited, points), (1, 2))
    assert 2.0 * np.sqrt(hole.sum() / np.pi) * (u[0, 1] - u[0, 0]) == pytest.approx(4.0, abs=0.15)


def test_a_defect_through_two_walls_with_background_between_is_refused():
    structures = two_cavities("even", septum_mm=7.0, wall_mm=1.0, septum_label=0)
    with pytest.raises(StageError, match="background lies between the walls"):
        apply_edits(structures, (defect(4.0),))
    name = structures.table[structures.table.wall_value(2)].name
    filled = apply_edits(structures, (sculpt("add", name, ((0.0, 0.0, 0.0),), 5.0), defect(4.0)))
    assert compartments(filled) == 1


def test_background_in_the_canal_stays_background():
    structures = two_cavities(septum_mm=6.0)
    edited = apply_edits(structures, (defect(3.0, at=tuple(15.0 * SIDE), axis=NORMAL, length=20.0),))
    outside = 15.5 * SIDE + np.linspace(6.0, 9.0, 31)[:, None] * NORMAL
    assert (owners(edited, outside) == 0).all()


@pytest.mark.parametrize("kind", thoroughly(LATTICES, 0, len(LATTICES) - 1))
@pytest.mark.parametrize("thickness", [0.6, 2.0])
def test_a_patch_closes_the_defect_and_has_its_thickness(kind, thickness):
    edited = apply_edits(two_cavities(kind), (defect(6.0), patch(10.0, thickness=thickness)))
    label = edited.table["patch"]
    assert label.role is Role.DEVICE
    assert label.value in edited.values
    assert edited.thinnest_layer_mm == pytest.approx(thickness)
    assert compartments(edited, 6) == 2
    line = np.linspace(-3.0, 3.0, 6001)
    found = owners(edited, line[:, None] * NORMAL + 1.0 * SIDE)
    assert (found == label.value).sum() * 0.001 == pytest.approx(thickness, abs=0.005)
    points, u, v = disc()
    found = owners(edited, points)
    assert (found[np.hypot(u, v) < 2.95] == label.value).all()
    assert (found[np.hypot(u, v) > 3.05] == 3).all()


def test_edits_follow_one_another():
    structures = two_cavities()
    edited = apply_edits(structures, (defect(6.0), patch(10.0), defect(2.0)))
    assert compartments(edited, 6) == 1
    points, u, v = disc()
    found = owners(edited, points)
    assert np.isin(found[np.hypot(u, v) < 0.95], (1, 2)).all()
    assert (found[(np.hypot(u, v) > 1.05) & (np.hypot(u, v) < 2.9)] == edited.table["patch"].value).all()
    in_steps = apply_edits(apply_edits(structures, (defect(6.0),)), (patch(10.0), defect(2.0)))
    assert (owners(in_steps, points) == found).all()


def test_adding_and_removing_with_a_brush():
    structures = two_cavities()
    base = structure_volumes_ml(structures)
    line = (tuple(-6.0 * UP), tuple(6.0 * UP))
    capsule = (np.pi * 2.0**2 * 12.0 + 4.0 / 3.0 * np.pi * 2.0**3) / 1000.0
    removed = apply_edits(structures, (sculpt("remove", "septum", line, 2.0, "left ventricle"),))
    volumes = structure_volumes_ml(removed)
    assert volumes[3] - base[3] == pytest.approx(-capsule, rel=0.03)
    assert volumes[1] - base[1] == pytest.approx(capsule, rel=0.03)
    assert volumes[2] == pytest.approx(base[2], abs=0.002)
    back = structure_volumes_ml(apply_edits(removed, (sculpt("add", "Septum", line, 2.0),)))
    assert back == pytest.approx(base, abs=0.002)
    ball = apply_edits(structures, (sculpt("add", "septum", (tuple(12.0 * NORMAL),), 3.0),))
    assert structure_volumes_ml(ball)[3] - base[3] == pytest.approx(4.0 / 3.0 * np.pi * 27.0 / 1000.0, rel=0.03)


def test_a_brush_takes_only_from_what_is_named():
    structures = two_cavities("even", wall_mm=1.0)
    wall = structures.table.wall_value(2)
    across = np.linspace(9.0, 20.0, 1101)[:, None] * NORMAL
    before = owners(structures, across)
    assert {2, wall, 0} <= set(before)
    brush = sculpt("add", "septum", (tuple(across[before == wall].mean(axis=0)),), 3.0)
    assert set(owners(apply_edits(structures, (brush,)), across)) == {0, 2, 3}
    kept = apply_edits(structures, (brush.model_copy(update={"only_from": ("Right ventricle",)}),))
    after = owners(kept, across)
    assert set(after) == {0, 2, 3, wall}
    assert set(before[after == 3]) == {2}
    np.testing.assert_array_equal(after[before != 2], before[before != 2])
    reach = np.linalg.norm(across - brush.points_mm[0], axis=1)
    inside = (before == 2) & (reach < 2.95)
    assert (after[inside] == 3).all()


@pytest.mark.parametrize(
    ("names", "message"),
    [
        (("septum",), "cannot be added to from itself"),
        (("left ventricle",), "touches nothing of 'left ventricle'"),
        (("valve",), "there is no label 'valve'"),
    ],
)
def test_what_a_brush_cannot_take_from_is_told(names, message):
    structures = two_cavities("even", wall_mm=1.0)
    brush = sculpt("add", "septum", (tuple(12.0 * NORMAL),), 3.0).model_copy(update={"only_from": names})
    with pytest.raises(StageError, match=message):
        apply_edits(structures, (brush,))


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"kind": "remove", "only_from": ("a",)}, "takes from its label"),
        ({"kind": "add", "into": "a"}, "gives to its label"),
        ({"kind": "add", "only_from": ()}, "names no structure"),
    ],
)
def test_a_brush_adds_from_and_removes_into(settings, message):
    with pytest.raises(ValueError, match=message):
        Sculpt(label="septum", radius_mm=1.0, points_mm=((0.0, 0.0, 0.0),), **settings)


def test_what_edits_make_is_known():
    table = two_cavities().table
    line = ((0.0, 0.0, 0.0),)
    edits = (
        sculpt("add", "Septum", line),
        sculpt("remove", "septum", line, into="left ventricle"),
        sculpt("remove", "septum", line),
        patch(label="patch"),
        sculpt("add", "right ventricle", line).model_copy(update={"enabled": False}),
    )
    assert made_by(edits, table) == {1, 3}


def test_what_is_removed_goes_to_the_nearest():
    structures = two_cavities(septum_mm=10.0)
    edited = apply_edits(structures, (sculpt("remove", "septum", ((0.0, 0.0, 0.0),), 4.0),))
    found = owners(edited, np.array([[-1.5], [-0.6], [0.6], [1.5]]) * NORMAL)
    assert found.tolist() == [1, 1, 2, 2]


def test_a_grown_wall_can_be_sculpted():
    structures = two_cavities("even", wall_mm=1.0)
    name = structures.table[structures.table.wall_value(2)].name
    outside = 18.0 * NORMAL
    opened = apply_edits(structures, (sculpt("remove", name, (tuple(outside),), 4.0, "background"),))
    line = np.linspace(14.0, 20.0, 601)[:, None] * NORMAL
    assert set(owners(opened, line)) == {0, 2}
    thick = apply_edits(structures, (sculpt("add", name, (tuple(outside),), 4.0),))
    wall = structures.table.wall_value(2)
    found = owners(thick, np.linspace(14.05, 21.95, 80)[:, None] * NORMAL)
    assert (found == wall).all()


def test_nothing_of_the_input_changes():
    structures = two_cavities()
    before = artifact_to_bytes(structures)
    edited = apply_edits(structures, (defect(), patch(), sculpt("add", "septum", ((0.0, 0.0, 0.0),))))
    assert artifact_to_bytes(structures) == before
    assert apply_edits(structures, ()) is structures
    again = artifact_from_bytes(artifact_to_bytes(edited), Structures)
    assert again.reshapings == edited.reshapings
    points, _, _ = disc()
    assert (owners(again, points) == owners(edited, points)).all()


def test_every_edit_that_meets_nothing_is_reported():
    edits = (
        defect(at=tuple(10.0 * NORMAL), length=3.0),
        defect(length=4.0),
        defect(at=(200.0, 0.0, 0.0)),
        patch(2.0, thickness=1.0),
        sculpt("add", "septum", ((0.0, 0.0, 0.0),), 1.0),
        sculpt("remove", "left ventricle", (tuple(10.0 * NORMAL),), 2.0),
        sculpt("add", "valve", ((0.0, 0.0, 0.0),), 1.0),
        sculpt("remove", "septum", ((0.0, 0.0, 0.0),), 1.0, "septum"),
        patch(label="right ventricle", at=tuple(6.0 * NORMAL)),
        defect(),
    )
    with pytest.raises(StageError) as error:
        apply_edits(two_cavities(), edits)
    found = {problem.place: problem.message for problem in error.value.problems}
    assert list(found) == [f"edits[{number}]" for number in range(1, 10)]
    for number, words in enumerate(
        (
            "touches no tissue",
            "does not join two cavities, it meets no cavity",
            "outside the region of interest",
            "touches no blood",
            "lies in 'septum' already",
            "touches no 'left ventricle'",
            "there is no label 'valve'",
            "into itself",
            "is not tissue",
        ),
        start=1,
    ):
        assert words in found[f"edits[{number}]"]


def test_an_edit_is_told_by_its_name_too_where_it_has_one():
    wrong = sculpt("add", "septum", ((0.0, 0.0, 0.0),), 1.0)
    edits = (wrong, wrong.model_copy(update={"name": "residual VSD"}))
    with pytest.raises(StageError) as error:
        apply_edits(two_cavities(), edits)
    assert [problem.place for problem in error.value.problems] == ["edits[1]", 'edits[2] "residual VSD"']
    lines = (
        of_edit(2, "changes nothing", WarningGrade.NOTE),
        of_edit(1, "odd", WarningGrade.LOOK),
        CaseWarning("aorta: edits[2]"),
        of_edit(3, "of another recipe", WarningGrade.LOOK),
    )
    told = with_edit_names(lines, edits)
    assert told == (CaseWarning('edits[2] "residual VSD": changes nothing', WarningGrade.NOTE, edit=2), *lines[1:])


def test_a_name_changes_nothing_of_the_stage_s_output():
    plain = KeepLargest(kind="keep_largest", label="septum")
    outputs = [
        artifact_to_bytes(apply_edits(two_cavities(), (one,)))
        for one in (plain, plain.model_copy(update={"name": "a name"}))
    ]
    assert outputs[0] == outputs[1]
