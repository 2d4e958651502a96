import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st
from scipy import ndimage

from heartcase.phantom.anatomy.heart import HeartPhantom
from heartcase.phantom.scan.acquisition import CT_UNITS, MRI_UNITS, noise_free
from heartcase.pipeline.image.noise import NoiseEstimate, estimate_noise

NONE = NoiseEstimate(0.0, 0.0)


def ball(shape, inside, outside):
    """A ball in the middle; its diameter is 0.6 of the shortest side."""
    place = np.indices(shape) - (np.array(shape).reshape(3, 1, 1, 1) - 1) / 2
    return np.where(np.sqrt((place**2).sum(axis=0)) < 0.3 * min(shape), inside, outside).astype(float)


def with_noise(values, sigma, seed):
    return (values + np.random.default_rng(seed).normal(0.0, sigma, np.shape(values))).astype(np.float32)


@example(sigma=1e-6, level=0.0, shape=(1, 250, 260), seed=209)
@settings(max_examples=25, deadline=None)
@given(
    sigma=st.sampled_from([1e-6, 0.3, 30.0, 1e6]),
    level=st.sampled_from([0.0, -1000.0, 400.0]),
    shape=st.sampled_from([(40, 40, 40), (30, 41, 52), (5, 110, 120), (1, 250, 260), (90, 1, 700)]),
    seed=st.integers(0, 1000),
)
def test_pure_noise_of_any_size_is_found(sigma, level, shape, seed):
    # the intensities' own digits must not be coarser than the noise
    found = estimate_noise(with_noise(np.full(shape, level if sigma > 0.01 else 0.0), sigma, seed))
    # five standard deviations of an estimate from 60,000 voxels, which are 2.2% and 1.4%
    assert found.sigma == pytest.approx(sigma, rel=0.11)
    assert found.difference_sigma == pytest.approx(sigma, rel=0.07)


@pytest.mark.parametrize("sigma", [5.0, 20.0, 80.0])
@pytest.mark.parametrize("slope", [0.0, 2.0])
def test_edges_and_slopes_change_it_little(sigma, slope):
    shape = (48, 50, 52)
    clean = ball(shape, 400.0, 0.0) + slope * np.arange(shape[2])
    found = estimate_noise(with_noise(clean, sigma, 4))
    assert found.sigma == pytest.approx(sigma, rel=0.05)
    assert 0.97 * sigma <= found.difference_sigma <= 1.25 * sigma


@pytest.fixture(scope="module")
def chest():
    """Noise-free MRI and CT of the child's heart at 2 mm, without partial volume (which takes long to work out)."""
    phantom = HeartPhantom.of_size("child")
    geometry = phantom.scan_geometry(2.0)
    return {units: noise_free(phantom, geometry, units, supersampling=1) for units in (MRI_UNITS, CT_UNITS)}


@pytest.mark.parametrize("contrast_to_noise", [5.0, 10.0, 20.0])
@pytest.mark.parametrize("units", [MRI_UNITS, CT_UNITS], ids=["mri", "ct"])
def test_the_noise_of_a_heart_is_found(chest, units, contrast_to_noise):
    clean = chest[units]
    sigma = (units[1] - units[2]) / contrast_to_noise
    values = with_noise(clean, sigma, 7)
    if units is MRI_UNITS:
        values = np.hypot(values, with_noise(np.zeros(clean.shape), sigma, 8))
    else:
        values = np.round(np.maximum(values, -820.0))  # whole Hounsfield units; half of the lung is clamped
    found = estimate_noise(values)
    # the worst of these six is 6% off; the heart's many edges are in the other number
    assert found.sigma == pytest.approx(sigma, rel=0.1)
    assert 0.95 * sigma <= found.difference_sigma <= 1.6 * sigma


def test_without_noise_nothing_is_found(chest):
    assert estimate_noise(chest[CT_UNITS].astype(np.float32)) == NONE
    assert estimate_noise(ball((20, 21, 22), 400.0, 0.0).astype(np.float32)) == NONE


@pytest.mark.parametrize("shape", [(1, 1, 1), (2, 2, 2), (1, 1, 9), (3, 1, 2)])
def test_constants_and_tiny_scans_have_none(shape):
    assert estimate_noise(np.full(shape, -1024.0, np.float32)) == NONE


@pytest.mark.parametrize("axis", [0, 1, 2])
def test_padding_and_clamped_air_do_not_hide_it(axis):
    shape = (60, 60, 60)
    values = np.round(with_noise(ball(shape, 300.0, 50.0), 25.0, 1))
    empty = np.moveaxis(values, axis, 0)
    empty[:25] = -1024.0
    empty[:10] = -2000.0
    empty[50:] = 3071.0
    found = estimate_noise(values.astype(np.int16).astype(np.float32))
    assert found.sigma == pytest.approx(25.0, rel=0.07)
    assert found.difference_sigma == pytest.approx(25.0, rel=0.15)


def test_two_thirds_of_zeros_do_not_hide_it():
    values = with_noise(np.full((45, 46, 47), 500.0), 20.0, 2)
    values[:30] = 0.0
    assert estimate_noise(values).sigma == pytest.approx(20.0, rel=0.05)


def test_noise_that_neighbours_share_is_seen_in_the_differences_only():
    noise = ndimage.gaussian_filter(np.random.default_rng(3).standard_normal((50, 60, 70)), 0.6)
    noise *= 30.0 / noise.std()
    # white noise has differences of sqrt(2) sigma
    differences = np.sqrt(np.mean([np.mean(np.diff(noise, axis=axis) ** 2) for axis in range(3)]) / 2.0)
    found = estimate_noise((ball(noise.shape, 600.0, 200.0) + noise).astype(np.float32))
    assert found.sigma < 0.6 * 30.0  # the stated limit
    assert differences <= found.difference_sigma <= 1.8 * differences


@pytest.mark.parametrize("factor", [1.0 / 1024.0, 1024.0])
def test_it_scales_with_the_intensities(factor):
    values = with_noise(ball((20, 30, 40), 400.0, 0.0), 10.0, 1)
    one, other = estimate_noise(values), estimate_noise(values * np.float32(factor))
    assert other.sigma == pytest.approx(factor * one.sigma, rel=1e-12)
    assert other.difference_sigma == pytest.approx(factor * one.difference_sigma, rel=1e-12)
