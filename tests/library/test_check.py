"""How far cases are from the hearts that their scans were made from: the measures, against what is known."""

import numpy as np
import pytest
from skimage.measure import marching_cubes

from heartcase.cli.main import main
from heartcase.library.check import CaseCheck, DefectCheck, _defect_check, joined_cavities, problems_of
from heartcase.library.openings import FalseOpening, false_openings
from heartcase.phantom.anatomy.heart import HeartPhantom
from heartcase.phantom.metrics import SurfaceError


@pytest.fixture(scope="module")
def child():
    return HeartPhantom.child()


def surface_around(truth, centre, reach=9.0, step=0.4):
    """Border of the true tissue in a cube around a place: vertices and triangles."""
    axis = np.arange(-reach, reach, step)
    points = centre + np.stack(np.meshgrid(axis, axis, axis, indexing="ij"), axis=-1)
    vertices, triangles, _, _ = marching_cubes(truth.value(points), 0.0)
    return centre - reach + step * vertices.astype(float), triangles.astype(np.int32)


@pytest.mark.parametrize(("wider", "shift"), [(0.0, 0.0), (1.0, 0.0), (-1.5, 0.0), (0.0, 0.8), (0.7, 0.5)])
def test_width_and_place_of_a_hole_are_measured(child, wider, shift):
    canal = child.ventricular_defect(6.0)
    middle, axis = np.array(canal.position_mm), np.array(canal.axis)
    side = np.cross(axis, (0.0, 0.0, 1.0))
    side /= np.linalg.norm(side)
    other = canal.model_copy(
        update={"diameter_mm": 6.0 + wider, "position_mm": tuple((middle + shift * side).tolist())}
    )
    truth = HeartPhantom.child(defects=[canal]).truth
    surface = surface_around(HeartPhantom.child(defects=[other]).truth, middle)
    found = _defect_check("mid muscular", canal, truth, surface)
    assert found.diameter_mm == pytest.approx(6.0)
    assert found.diameter_error_mm == pytest.approx(wider, abs=0.12)
    assert found.position_error_mm == pytest.approx(shift, abs=0.08)


def test_a_hole_that_is_not_there_is_missed(child):
    canal = child.ventricular_defect(6.0)
    truth = HeartPhantom.child(defects=[canal]).truth
    found = _defect_check("mid muscular", canal, truth, surface_around(child.truth, np.array(canal.position_mm)))
    assert found.diameter_error_mm is None


def test_cavities_that_share_blood_are_grouped():
    labels = np.zeros((8, 8, 20), np.uint8)
    labels[:, :, :6], labels[:, :, 7:13], labels[:, :, 14:] = 1, 2, 3
    names = {1: "a", 2: "b", 3: "c"}
    assert joined_cavities(labels > 0, labels, names) == (("a",), ("b",), ("c",))
    labels[3, 3, 6] = 2
    assert joined_cavities(labels > 0, labels, names) == (("a", "b"), ("c",))
    # Pieces that touch at an edge only do not share blood.
    labels[3, 3, 6] = 0
    labels[:, :4, 6] = 2
    labels[:, :5, 5] = 0
    assert joined_cavities(labels > 0, labels, names) == (("a",), ("b",), ("c",))


def test_openings_that_the_truth_has_not_are_found(child):
    left, atrium, aorta = "morphologically left ventricle", "morphologically left atrium", "aorta"
    mitral, root = (child.anatomy.places[f"{name} valve"].tolist() for name in ("mitral", "aortic"))

    def figure(one, other, center, verdict):
        return {"between": [one, other], "area_mm2": 7.25, "center_mm": center, "verdict": verdict}

    figures = [
        figure(left, atrium, mitral, "expected"),
        figure(left, aorta, root, "expected"),
        figure(atrium, aorta, root, "unexpected"),
        figure(left, atrium, [mitral[0], mitral[1], mitral[2] + 30.0], "expected"),
        figure(left, atrium, mitral, "unexpected"),
    ]
    found = false_openings(figures, child.truth)
    assert [(one.between, one.is_true_nearby) for one in found] == [
        ((atrium, aorta), False),
        ((left, atrium), False),
        ((left, atrium), True),
    ]
    place = ", ".join(f"{value:.1f}" for value in root)
    assert str(found[0]) == f"left atrium and aorta are open to each other over 7.2 mm² near ({place}) mm, in truth not"
    assert str(found[2]).endswith(" mm, beyond their true opening")


def test_a_false_opening_is_worse_than_allowed():
    false = FalseOpening(("a", "b"), 3.0, (0.0, 0.0, 0.0), False)
    check = CaseCheck("x", 0.9, {}, SurfaceError(0.2, 0.6, 100), (), (("a", "b"),), (("a", "b"),), (false,))
    assert problems_of(check, least_dice=0.85, surface_mm=1.0, diameter_mm=2.0) == [str(false)]


def test_what_is_worse_than_allowed_is_said():
    error = SurfaceError(0.2, 1.4, 100)
    defects = (DefectCheck("secundum", 9.0, None, None), DefectCheck("primum", 9.0, 2.5, 0.1))
    check = CaseCheck("x", 0.8, {}, error, defects, (("a", "b"),), (("a",), ("b",)))
    problems = problems_of(check, least_dice=0.85, surface_mm=1.0, diameter_mm=2.0)
    assert len(problems) == 5
    assert problems[0] == "other cavities are connected than in truth"
    assert not problems_of(
        CaseCheck("x", 0.9, {}, SurfaceError(0.2, 0.6, 100), (), (("a",),), (("a",),)),
        least_dice=0.85,
        surface_mm=1.0,
        diameter_mm=2.0,
    )
    assert check.as_dict()["is_joined_as_it_should"] is False


def test_a_case_that_was_not_built_is_listed(tmp_path, capfd):
    recipe = (
        'heartcase_recipe = 1\nname = "made"\n[scan]\npath = "a.nii.gz"\n[scan.phantom]\n'
        '[[strokes]]\nlabel = "aorta"\npoints_mm = [[0.0, 0.0, 0.0]]\n'
    )
    (tmp_path / "r.toml").write_text(recipe)
    assert main(["library", "check", str(tmp_path), "--out", str(tmp_path)]) == 1
    output = capfd.readouterr().out
    assert "made" in output
    assert "1 case compared with the truth, 1 to be looked at" in output
