"""The heart's own planes from labels, against the phantom that knows its valves and its apex."""

import numpy as np
import pytest

from heartcase.phantom.anatomy.heart import HeartPhantom
from heartcase.pipeline.report.heart_planes import heart_planes
from heartcase.pipeline.report.views import places_of
from heartcase.schemas.geometry import Geometry
from heartcase.schemas.labels import default_label_table

CUTS = {
    "four_chamber": ("apex", "mitral valve", "tricuspid valve"),
    "three_chamber": ("apex", "mitral valve", "aortic valve"),
}


@pytest.fixture(scope="module")
def heart():
    phantom = HeartPhantom.child()
    geometry = phantom.scan_geometry((1.5, 2.0, 2.5), oblique=False)
    k, j, i = np.indices(geometry.shape)
    at = np.stack([i, j, k], axis=-1) @ geometry.affine[:3, :3].T + geometry.affine[:3, 3]
    labels = phantom.truth.label(at.reshape(-1, 3)).reshape(geometry.shape)
    # of grown walls a segmentation knows nothing
    labels[labels > 9] = 0
    return phantom, labels, geometry


def degrees(one, other):
    return np.degrees(np.arccos(np.clip(abs(one @ other), 0.0, 1.0)))


def assert_is_a_frame(plane):
    axes = np.array([plane.right, plane.down, plane.normal])
    np.testing.assert_allclose(axes @ axes.T, np.eye(3), atol=1e-12)


def test_planes_from_labels_are_those_of_the_heart(heart):
    phantom, labels, geometry = heart
    found = heart_planes(labels, geometry, phantom.table)
    assert found.missing == {}
    assert list(found.planes) == ["short_axis", "four_chamber", "two_chamber", "three_chamber"]
    places = {name: place.position_mm for name, place in places_of(phantom.landmarks).items()}
    axis = places["apex"] - places["mitral valve"]
    length = np.linalg.norm(axis)
    short, four, two, three = found.planes.values()
    assert degrees(short.normal, axis / length) < 6.0
    assert short.normal @ axis > 0.0
    assert np.linalg.norm(found.centre_mm - (places["apex"] + places["mitral valve"]) / 2.0) < 0.1 * length
    for name, corners in CUTS.items():
        a, b, c = (places[corner] for corner in corners)
        normal = np.cross(b - a, c - a)
        assert degrees(found.planes[name].normal, normal / np.linalg.norm(normal)) < 10.0, name
    for plane in found.planes.values():
        assert_is_a_frame(plane)
    # they hold the long axis, and two chambers are seen at right angles to four
    for plane in (four, two, three):
        assert abs(plane.normal @ short.normal) < 1e-9
    assert abs(four.normal @ two.normal) < 1e-9
    # as radiologists see them: right ventricle at the left, four chambers from the feet, the others from the left
    middles = {
        name: (np.argwhere(labels == phantom.table[name].value)[:, ::-1] @ geometry.affine[:3, :3].T).mean(axis=0)
        for name in ("left ventricle", "right ventricle", "left atrium")
    }
    to_the_right = middles["right ventricle"] - middles["left ventricle"]
    assert to_the_right @ short.right < 0.0
    assert to_the_right @ four.right < 0.0
    assert np.cross(four.right, four.down)[2] > 0.0
    assert (middles["left atrium"] - middles["left ventricle"]) @ two.right > 0.0
    for plane in (two, three):
        assert np.cross(plane.right, plane.down)[0] < 0.0
        assert plane.down[2] < 0.0


def test_planes_through_landmarks_are_exact(heart):
    phantom, labels, geometry = heart
    places = places_of(phantom.landmarks)
    found = heart_planes(np.zeros_like(labels), geometry, phantom.table, places=places)
    assert found.missing == {}
    for name, corners in CUTS.items():
        plane = found.planes[name]
        depths = [(places[corner].position_mm - places["apex"].position_mm) @ plane.normal for corner in corners]
        np.testing.assert_allclose(depths, 0.0, atol=1e-9)


@pytest.mark.parametrize(
    ("left_out", "there", "lack"),
    [
        (("aorta",), ["short_axis", "four_chamber", "two_chamber"], {"three_chamber": "aorta"}),
        (
            ("right atrium",),
            ["short_axis", "three_chamber"],
            {"four_chamber": "right atrium", "two_chamber": "right atrium"},
        ),
        (
            ("left atrium",),
            ["short_axis", "four_chamber", "two_chamber"],
            {"three_chamber": "left atrium"},
        ),
        (("left ventricle",), [], dict.fromkeys(["short_axis", "four_chamber"], "left ventricle")),
        (("left atrium", "aorta"), [], {"short_axis": "left atrium"}),
    ],
)
def test_what_too_few_labels_lack_is_said(heart, left_out, there, lack):
    phantom, labels, geometry = heart
    gone = [phantom.table[name].value for name in left_out]
    some = np.where(np.isin(labels, gone), np.uint8(0), labels)
    found = heart_planes(some, geometry, phantom.table)
    assert list(found.planes) == there
    for plane, name in lack.items():
        assert phantom.table[name].name in found.missing[plane]
    assert (found.centre_mm is None) == (not there)
    assert set(found.planes) | set(found.missing) == {"short_axis", "four_chamber", "two_chamber", "three_chamber"}


def test_without_surroundings_labels_tell_nothing():
    geometry = Geometry.of(shape=(8, 8, 8))
    for value in (255, 1):
        found = heart_planes(np.full((8, 8, 8), value, np.uint8), geometry, default_label_table())
        assert found.planes == {}
        assert all("background" in lack for lack in found.missing.values())
