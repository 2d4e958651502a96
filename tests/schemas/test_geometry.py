"""Geometry against hand-made cases, SimpleITK, and its own inverse."""

import numpy as np
import pytest
import SimpleITK as sitk
from hypothesis import given
from hypothesis import strategies as st
from pydantic import ValidationError
from scipy.spatial.transform import Rotation

from heartcase.schemas.geometry import Geometry


@st.composite
def geometries(draw):
    rotation = Rotation.from_euler("xyz", [draw(st.floats(-180, 180)) for _ in range(3)], degrees=True).as_matrix()
    if draw(st.booleans()):
        rotation = rotation * np.array([1.0, 1.0, -1.0])
    return Geometry.of(
        shape=tuple(draw(st.integers(1, 40)) for _ in range(3)),
        origin_mm=[draw(st.floats(-500, 500)) for _ in range(3)],
        spacing_mm=[draw(st.floats(0.2, 6.0)) for _ in range(3)],
        direction=rotation,
    )


def test_a_known_point_of_an_anisotropic_rotated_lattice():
    # 90 degrees about z: i runs along +y, j along -x.
    geometry = Geometry.of(
        shape=(5, 4, 3), origin_mm=(10, 20, 30), spacing_mm=(1, 2, 3), direction=[[0, -1, 0], [1, 0, 0], [0, 0, 1]]
    )
    assert geometry.size == (3, 4, 5)
    np.testing.assert_allclose(geometry.index_to_world((1, 2, 3)), (10 - 4, 20 + 1, 30 + 9))


@given(geometries())
def test_agrees_with_simpleitk(geometry):
    image = sitk.Image(list(geometry.size), sitk.sitkUInt8)
    image.SetOrigin(geometry.origin_mm)
    image.SetSpacing(geometry.spacing_mm)
    image.SetDirection(geometry.direction_matrix.ravel().tolist())
    index = (1.25, -3.0, 7.5)
    expected = image.TransformContinuousIndexToPhysicalPoint(index)
    np.testing.assert_allclose(geometry.index_to_world(index), expected, atol=1e-9)


@given(geometries())
def test_world_to_index_inverts(geometry):
    points = np.array([[0.0, 0.0, 0.0], [1.5, -2.0, 30.0]])
    np.testing.assert_allclose(geometry.world_to_index(geometry.index_to_world(points)), points, atol=1e-9)


@given(geometries(), st.integers(0, 2))
def test_flipping_an_axis_keeps_the_points_and_changes_the_hand(geometry, axis):
    flipped = geometry.flipped(axis)
    assert flipped.is_right_handed != geometry.is_right_handed
    index = np.zeros(3)
    index[axis] = geometry.size[axis] - 1
    np.testing.assert_allclose(flipped.index_to_world((0, 0, 0)), geometry.index_to_world(index), atol=1e-9)


@given(geometries(), st.integers(1, 4))
def test_refining_keeps_the_outer_faces(geometry, factor):
    fine = geometry.refined(factor)
    np.testing.assert_allclose(
        fine.index_to_world((-0.5, -0.5, -0.5)), geometry.index_to_world((-0.5, -0.5, -0.5)), atol=1e-9
    )
    last = np.array(geometry.size) - 0.5
    np.testing.assert_allclose(fine.index_to_world(np.array(fine.size) - 0.5), geometry.index_to_world(last), atol=1e-9)


def test_cropping_moves_the_origin():
    geometry = Geometry.of(shape=(9, 9, 9), spacing_mm=(2, 3, 4))
    assert geometry.cropped((1, 2, 3), (4, 4, 4)).origin_mm == (2.0, 6.0, 12.0)


def test_matches_within_the_tolerance_only():
    geometry = Geometry.of(shape=(9, 9, 9))
    assert geometry.matches(Geometry.of(shape=(9, 9, 9), origin_mm=(5e-4, 0, 0)))
    assert not geometry.matches(Geometry.of(shape=(9, 9, 9), origin_mm=(5e-3, 0, 0)))
    assert not geometry.matches(Geometry.of(shape=(9, 9, 9), spacing_mm=(1.001, 1, 1)))
    assert not geometry.matches(Geometry.of(shape=(9, 9, 8)))


@pytest.mark.parametrize(
    "bad",
    [
        {"spacing_mm": (1, 0, 1)},
        {"spacing_mm": (1, -1, 1)},
        {"direction": [[1, 0.1, 0], [0, 1, 0], [0, 0, 1]]},
        {"origin_mm": (float("nan"), 0, 0)},
        {"shape": (0, 4, 4)},
    ],
)
def test_impossible_geometry_is_refused(bad):
    with pytest.raises(ValidationError):
        Geometry.of(**({"shape": (4, 4, 4)} | bad))
