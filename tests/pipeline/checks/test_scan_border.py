"""What the faces of a scan or region cut off, against areas that are counted by hand."""

from __future__ import annotations

import re

import numpy as np
import pytest

from heartcase.pipeline.checks.scan_border import cut_warnings, face_name, voxel_warnings
from heartcase.pipeline.data import Segmentation, VesselEnd
from heartcase.pipeline.warnings import CaseWarning, WarningGrade, worst_first
from heartcase.schemas.geometry import Geometry
from heartcase.schemas.labels import Label, LabelTable, Role, default_label_table

TABLE = default_label_table().with_walls()
LV, LA, AORTA, MUSCLE = (TABLE[name].value for name in ("LV", "LA", "aorta", "LV myocardium"))


def turned(degrees: float, axis: int = 0) -> np.ndarray:
    """A rotation around one of the axes of space."""
    c, s = np.cos(np.radians(degrees)), np.sin(np.radians(degrees))
    matrix = np.eye(3)
    a, b = (n for n in range(3) if n != axis)
    matrix[a, a], matrix[a, b], matrix[b, a], matrix[b, b] = c, -s, s, c
    return matrix


def segmentation(shape=(20, 24, 28), spacing=(1.5, 2.0, 2.5), table: LabelTable = TABLE, **geometry) -> Segmentation:
    labels = np.zeros(shape, np.uint8)
    return Segmentation(labels, Geometry.of(shape=shape, spacing_mm=spacing, **geometry), table)


def test_nothing_is_told_of_a_heart_that_lies_inside() -> None:
    whole = segmentation()
    whole.labels[1:-1, 1:-1, 1:-1] = MUSCLE
    whole.labels[5:-5, 5:-5, 5:-5] = LV
    assert cut_warnings(whole) == ()


FACES = [
    (2, False, "feet face"),
    (2, True, "head face"),
    (1, False, "front face"),
    (1, True, "back face"),
    (0, False, "right face"),
    (0, True, "left face"),
]


@pytest.mark.parametrize(("axis", "is_last", "name"), FACES)
def test_a_chamber_and_muscle_at_a_face_are_told_with_its_name_and_their_areas(axis, is_last, name) -> None:
    """Plain LPS axes: index grows to the left, the back and the head."""
    cut = segmentation()
    layer = np.moveaxis(cut.labels, 2 - axis, 0)[-1 if is_last else 0]
    layer[4:14, 4:14] = MUSCLE
    layer[6:12, 6:12] = LV
    pixel = np.prod([spacing for n, spacing in enumerate(cut.geometry.spacing_mm) if n != axis])
    (warning,) = cut_warnings(cut, whole=cut.geometry)
    assert warning.grade is WarningGrade.ANATOMY
    assert f"the {name} of the scan" in warning.text

    def words(area: float) -> str:
        return f"{area / 100:.1f} cm²" if area >= 100 else f"{area:.0f} mm²"

    assert f"{TABLE[LV].name} ({words(36 * pixel)})" in warning.text
    assert f"{TABLE[MUSCLE].name} ({words(64 * pixel)})" in warning.text


def test_a_short_axis_stack_of_25_mm_is_the_first_warning() -> None:
    """Five slices of 5 mm through a left ventricle: both its ends are cut."""
    short_axis = turned(35.0, axis=0) @ turned(40.0, axis=1)
    stack = segmentation((5, 40, 40), (1.5, 1.5, 5.0), direction=short_axis)
    j, i = np.indices((40, 40))
    radius = 1.5 * np.hypot(j - 20, i - 20)
    stack.labels[:] = np.where(radius < 20, LV, np.where(radius < 28, MUSCLE, 0))
    first, *rest = worst_first((CaseWarning("something else"),), cut_warnings(stack, whole=stack.geometry))
    assert first.grade is WarningGrade.ANATOMY
    assert "first slice (towards" in first.text
    assert "last slice (towards" in rest[0].text
    found = re.search(rf"{TABLE[LV].name} \(([\d.]+) cm²\)", first.text)
    assert found is not None
    assert float(found.group(1)) == pytest.approx(np.pi * 20**2 / 100, rel=0.02)
    assert any("3.3 times as long as wide" in line.text for line in voxel_warnings(stack.geometry))


def test_oblique_faces_are_called_by_where_they_look() -> None:
    geometry = segmentation(direction=turned(40.0, axis=0)).geometry
    assert face_name(geometry, 0, is_last=True) == "left face"
    # the slices' axis is turned from the head towards the front
    assert face_name(geometry, 2, is_last=True) == "last slice (towards head and front)"
    assert face_name(geometry, 2, is_last=False) == "first slice (towards feet and back)"
    assert face_name(geometry, 1, is_last=True) == "face towards back and head"
    slightly = segmentation(direction=turned(20.0, axis=0)).geometry
    assert face_name(slightly, 2, is_last=True) == "head face"
    mirrored = segmentation(direction=np.diag([-1.0, 1.0, -1.0])).geometry
    assert face_name(mirrored, 2, is_last=True) == "feet face"
    assert face_name(mirrored, 0, is_last=False) == "left face"


def test_the_faces_of_a_region_are_told_from_those_of_its_scan() -> None:
    whole = Geometry.of(shape=(20, 24, 28), spacing_mm=(1.5, 2.0, 2.5))
    box = whole.cropped((3, 0, 5), (20, 24, 15))
    labels = np.zeros(box.shape, np.uint8)
    labels[:, 10:14, 10:14] = LV
    low, high = cut_warnings(Segmentation(labels, box, TABLE), whole=whole)
    assert "the feet face of the region of interest" in low.text
    assert "enlarge the region" in low.text
    assert "the head face of the scan" in high.text
    assert "enlarge the region" not in high.text
    assert "the scan or its region of interest" in cut_warnings(Segmentation(labels, box, TABLE))[0].text


def test_a_vessel_that_leaves_is_for_information_and_one_cut_along_its_length_to_be_looked_at() -> None:
    cut = segmentation((40, 40, 40), (1.0, 1.0, 1.0))
    k, j, i = np.indices(cut.labels.shape)
    cut.labels[(np.hypot(j - 20, i - 20) < 6) & (k > 20)] = AORTA
    (leaves,) = cut_warnings(cut, whole=cut.geometry)
    assert leaves.grade is WarningGrade.NOTE
    assert "head face" in leaves.text
    assert f"aorta ({np.pi * 36 / 100:.1f} cm²)" in leaves.text
    cut.labels[:] = np.where((np.hypot(j - 20, i + 2) < 6) & (abs(k - 20) < 18), AORTA, 0)
    (along,) = cut_warnings(cut, whole=cut.geometry)
    assert along.grade is WarningGrade.LOOK
    assert "right face" in along.text


def test_the_grown_wall_of_a_chamber_counts_where_the_chamber_ends_before_and_a_vessels_wall_never() -> None:
    wall_of_atrium, wall_of_aorta = TABLE.wall_value(LA), TABLE.wall_value(AORTA)
    assert wall_of_atrium is not None
    assert wall_of_aorta is not None
    cut = segmentation()
    cut.labels[-1, 5:10, 5:10] = wall_of_atrium
    cut.labels[0, 5:10, 5:10] = wall_of_aorta
    (warning,) = cut_warnings(cut, whole=cut.geometry)
    assert warning.grade is WarningGrade.ANATOMY
    assert TABLE[wall_of_atrium].name in warning.text
    # with the chamber itself at the face its wall is no finding of its own
    cut.labels[-1, 6:9, 6:9] = LA
    (warning,) = cut_warnings(cut, whole=cut.geometry)
    assert TABLE[wall_of_atrium].name not in warning.text


def test_a_painted_wall_or_a_device_at_a_face_is_no_finding() -> None:
    table = LabelTable(
        labels=(Label(value=1, name="painted", role=Role.WALL), Label(value=2, name="d", role=Role.DEVICE))
    )
    cut = segmentation(table=table)
    cut.labels[0, :4], cut.labels[0, 8:] = 1, 2
    assert cut_warnings(cut) == ()


@pytest.mark.parametrize(("spacing", "is_told"), [((1, 1, 3), False), ((1, 1, 3.1), True), ((8, 1.4, 1.4), True)])
def test_voxels_more_than_three_times_as_long_as_wide(spacing, is_told) -> None:
    warnings = voxel_warnings(Geometry.of(shape=(4, 4, 4), spacing_mm=spacing))
    assert bool(warnings) is is_told
    assert all(warning.grade is WarningGrade.ANATOMY for warning in warnings)


@pytest.mark.parametrize(("axis", "is_last", "name"), FACES)
def test_a_vein_of_an_atrium_that_is_open_at_a_face_is_a_vessel_and_the_rest_of_the_atrium_is_not(axis, is_last, name):
    cut = segmentation(direction=turned(20.0))
    layer = np.moveaxis(cut.labels, 2 - axis, 0)[-1 if is_last else 0]
    layer[3:6, 4:6] = LA  # the vein
    layer[10:14, 9:14] = LA
    pixel = np.prod([spacing for n, spacing in enumerate(cut.geometry.spacing_mm) if n != axis])
    index = np.zeros(3)
    index[axis] = cut.geometry.size[axis] - 1 if is_last else 0.0
    rows, columns = (n for n in (2, 1, 0) if n != axis)
    index[rows], index[columns] = 4.0, 4.5
    vein = VesselEnd(TABLE["LA"].name, tuple(cut.geometry.index_to_world(index)), (0, 0, 1), 3.0, 3.0, is_open=True)
    (alone,) = cut_warnings(cut)
    assert alone.grade is WarningGrade.ANATOMY
    assert f"morphologically left atrium ({26 * pixel:.0f} mm²)" in alone.text or 26 * pixel >= 100.0
    anatomy, note = worst_first(cut_warnings(cut, ends=[vein]))
    assert anatomy.grade is WarningGrade.ANATOMY
    assert note.grade is WarningGrade.NOTE
    assert f"veins of the morphologically left atrium ({6 * pixel:.0f} mm²)" in note.text
    rest = 20 * pixel
    assert f"morphologically left atrium ({rest / 100:.1f} cm²)" in anatomy.text or f"({rest:.0f} mm²)" in anatomy.text
    # an end that a disc cuts, or one elsewhere, takes nothing off
    assert cut_warnings(cut, ends=[vein._replace(is_open=False)]) == (alone,)
    index[rows] = 18.0
    assert cut_warnings(cut, ends=[vein._replace(position_mm=tuple(cut.geometry.index_to_world(index)))]) == (alone,)
