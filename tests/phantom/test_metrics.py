"""The measures themselves, on shapes whose answers are known."""

import numpy as np
import pytest

from heartcase.phantom.metrics import SurfaceError, closest_distance_mm, dice, label_surface, wall_thickness_error
from heartcase.schemas.geometry import Geometry


def sphere(radius, steps=60):
    from skimage.measure import marching_cubes

    axis = np.linspace(-30, 30, steps)
    z, y, x = np.meshgrid(axis, axis, axis, indexing="ij")
    field = np.sqrt(x**2 + y**2 + z**2) - radius
    step = axis[1] - axis[0]
    vertices, triangles, _, _ = marching_cubes(field.astype(np.float32), 0.0, spacing=(step,) * 3)
    return vertices[:, ::-1] - 30.0, triangles


def test_dice_of_known_overlaps():
    a, b = np.zeros((1, 1, 8), np.uint8), np.zeros((1, 1, 8), np.uint8)
    a[..., :4], b[..., 2:6] = 1, 1
    assert dice(a, b, 1) == 0.5
    assert dice(a, a, 1) == 1.0
    assert dice(a, b, 7) == 1.0
    b[..., 6:] = 2
    assert dice(a, b, (1, 2)) == pytest.approx(2 * 2 / (4 + 6))


def test_summary_is_of_absolute_values():
    error = SurfaceError.of([-1.0, 1.0, 3.0, -3.0])
    assert (error.mean_mm, error.sample_count) == (2.0, 4)
    assert SurfaceError.of([]).mean_mm == float("inf")


def test_distance_to_a_square_is_exact_above_and_beside_it():
    vertices = [[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]]
    distances = closest_distance_mm(
        np.array([[0.5, 0.5, 2.0], [2.0, 0.5, 0.0], [4.0, 5.0, 0.0]]), vertices, [[0, 1, 2], [0, 2, 3]]
    )
    np.testing.assert_allclose(distances, [2.0, 1.0, 5.0], atol=1e-9)


def test_a_label_border_lies_half_way_between_voxels_in_world_space():
    labels = np.zeros((6, 6, 6), np.uint8)
    labels[2:4, 2:4, 2:4] = 3
    geometry = Geometry.of(shape=(6, 6, 6), spacing_mm=(1, 2, 3), origin_mm=(5, 5, 5))
    vertices, triangles = label_surface(labels, geometry, 3)
    np.testing.assert_allclose(vertices.min(axis=0), geometry.index_to_world((1.5, 1.5, 1.5)), atol=1e-5)
    np.testing.assert_allclose(vertices.max(axis=0), geometry.index_to_world((3.5, 3.5, 3.5)), atol=1e-5)
    assert triangles.max() == len(vertices) - 1


@pytest.mark.parametrize("true_mm", [3.0, 2.5])
def test_thickness_of_a_shell_of_three_millimetres(true_mm):
    inner, inner_triangles = sphere(15.0)
    outer, outer_triangles = sphere(18.0)
    vertices = np.concatenate([inner, outer])
    triangles = np.concatenate([inner_triangles, outer_triangles + len(inner)])
    label = np.repeat(np.uint8([5, 0]), [len(inner_triangles), len(outer_triangles)])
    error = wall_thickness_error(
        vertices,
        triangles,
        label,
        np.full(len(triangles), 11, np.uint8),
        cavity=5,
        wall=11,
        thickness_mm=true_mm,
        margin_mm=2.0,
    )
    # A chord of a 1 mm lattice lies at most 1/(8 * 15) mm inside the sphere, twice.
    assert error.mean_mm == pytest.approx(abs(3.0 - true_mm), abs=0.02)
    assert error.sample_count > 1000
