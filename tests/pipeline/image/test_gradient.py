import numpy as np
import pytest
from scipy import ndimage

from heartcase.pipeline.image.gradient import gradient_magnitude

SPACING = (0.8, 1.5, 3.0)


def coordinates(shape):
    z, y, x = np.indices(shape)
    return x * SPACING[0], y * SPACING[1], z * SPACING[2]


@pytest.mark.parametrize("sigma", [0.0, 0.3, 1.0, 4.0])
def test_a_slope_has_its_true_steepness_up_to_the_outer_faces(sigma):
    x, y, z = coordinates((9, 11, 13))
    got = gradient_magnitude(10.0 + 3.0 * x - 4.0 * y + 12.0 * z, SPACING, sigma_mm=sigma)
    # values of up to 350 in float32, differences over 0.8 mm
    np.testing.assert_allclose(got, 13.0, rtol=0, atol=350 * 2**-23 * 16)


def test_equals_scipy_central_differences_inside():
    values = np.random.default_rng(1).normal(0, 100, (8, 9, 10)).astype(np.float32)
    kernel = np.array([-0.5, 0.0, 0.5])
    slopes = [ndimage.correlate1d(values.astype(float), kernel / SPACING[2 - a], axis=a) for a in range(3)]
    want = np.sqrt(sum(s**2 for s in slopes))
    inside = (slice(1, -1),) * 3
    np.testing.assert_allclose(gradient_magnitude(values, SPACING)[inside], want[inside], rtol=1e-5)


def test_equals_scipy_gaussian_gradient_inside_for_a_wide_blur():
    values = np.zeros((41, 41, 41), np.float32)
    values[15:26, 15:26, 15:26] = 100.0
    sigma, spacing = 3.0, (1.0, 1.5, 2.0)
    slopes = [
        ndimage.gaussian_filter(
            values.astype(float), sigma / np.array(spacing[::-1]), order=np.eye(3, dtype=int)[axis], truncate=8.0
        )
        / spacing[2 - axis]
        for axis in range(3)
    ]
    want = np.sqrt(sum(s**2 for s in slopes))
    got = gradient_magnitude(values, spacing, sigma_mm=sigma)
    # the third derivative of the blurred cube is at most peak / sigma^2; central differences err by h^2 / 6 of it
    bound = max(spacing) ** 2 / 6 / sigma**2
    assert np.abs(got - want).max() <= bound * want.max()


def test_it_is_finite_not_negative_and_has_no_negative_zero():
    values = np.zeros((5, 6, 7), np.float32)
    values[2:, 3:] = -5.0
    got = gradient_magnitude(values, SPACING)
    assert got.dtype == np.float32
    assert np.all(np.isfinite(got))
    assert not np.signbit(got).any()


def test_an_axis_of_one_voxel_has_no_slope():
    values = np.arange(12, dtype=np.float32).reshape(1, 3, 4)
    got = gradient_magnitude(values, (1.0, 1.0, 1.0), sigma_mm=1.0)
    np.testing.assert_allclose(got, np.hypot(4.0, 1.0), rtol=1e-5)
