import numpy as np
import pytest

from heartcase.phantom.acquisition import CT_UNITS, MRI_UNITS, acquire_ct, acquire_mri, noise_free
from heartcase.schemas.errors import UsageError
from heartcase.schemas.geometry import Geometry
from tests.phantom.conftest import lattice_points


@pytest.fixture(scope="module")
def small(adult):
    """A box of 40 mm around the middle of the left ventricle, 1.75 mm."""
    centre = adult.anatomy.places["left ventricle"]
    return Geometry.of(shape=(24, 24, 24), origin_mm=centre - 23 * 0.875, spacing_mm=(1.75,) * 3)


@pytest.fixture(scope="module")
def lung(adult):
    """A box of nothing but lung."""
    geometry = Geometry.of(shape=(30, 30, 30), origin_mm=(75.0, -10.0, 20.0), spacing_mm=(1.0,) * 3)
    assert np.all(noise_free(adult, geometry, MRI_UNITS) == MRI_UNITS[0])
    return geometry


def test_noise_free_voxels_within_one_tissue_have_its_signal(adult, small):
    signal = noise_free(adult, small, MRI_UNITS)
    points = lattice_points(small)
    deep_blood = adult.truth.value(points, 1) < -2.0
    deep_wall = adult.truth.value(points, 9) < -2.0
    assert deep_blood.any()
    assert deep_wall.any()
    np.testing.assert_array_equal(signal[deep_blood], MRI_UNITS[1])
    np.testing.assert_array_equal(signal[deep_wall], MRI_UNITS[2])


def test_partial_volume_keeps_the_mean_signal(adult, small):
    # The same box at a quarter of the spacing, every voxel sampled, then averaged: nothing but sampling differs.
    coarse = noise_free(adult, small, CT_UNITS, supersampling=4)
    fine = noise_free(adult, small.refined(4), CT_UNITS, supersampling=1)
    averaged = fine.reshape(24, 4, 24, 4, 24, 4).mean(axis=(1, 3, 5))
    near_heart = adult.truth.value(lattice_points(small), 0) > -3.0
    np.testing.assert_allclose(coarse[near_heart], averaged[near_heart], atol=1e-9)
    # In the chest a border that only cuts a corner of a voxel may be missed.
    assert (np.abs(coarse - averaged) > 1e-9).mean() < 1e-3


def test_mri_noise_is_rician(adult, small, lung):
    clean = noise_free(adult, small, MRI_UNITS)
    scans = [acquire_mri(adult, small, bias=0.0, seed=seed) for seed in range(1, 9)]
    sigma = scans[0].noise_sd
    assert sigma == pytest.approx((MRI_UNITS[1] - MRI_UNITS[2]) / 14.5)
    blood = clean == MRI_UNITS[1]
    values = np.concatenate([scan.values[blood] for scan in scans])
    count = len(values)
    # At high signal A: mean A + sigma^2 / 2A, standard deviation sigma; five standard errors.
    assert values.mean() == pytest.approx(1000.0 + sigma**2 / 2000.0, abs=5.0 * sigma / np.sqrt(count))
    assert values.std() == pytest.approx(sigma, rel=5.0 / np.sqrt(2.0 * count) + 1e-3)
    # In lung the signal is sigma itself; Rice's mean at A = sigma is 1.5486 sigma, its second moment A^2 + 2 sigma^2.
    air = acquire_mri(adult, lung, contrast_to_noise=(MRI_UNITS[1] - MRI_UNITS[2]) / MRI_UNITS[0], bias=0.0).values
    air = air.astype(float) / MRI_UNITS[0]
    assert air.mean() == pytest.approx(1.54857, abs=5.0 / np.sqrt(air.size))
    assert (air**2).mean() == pytest.approx(3.0, abs=5.0 * np.sqrt(8.0 / air.size))
    assert air.min() >= 0.0


def test_mri_noise_without_signal_is_rayleigh(adult, lung):
    sigma = 4000.0
    scan = acquire_mri(adult, lung, contrast_to_noise=(MRI_UNITS[1] - MRI_UNITS[2]) / sigma, bias=0.0)
    values = scan.values.astype(float) / sigma
    # The lung's signal is a hundredth of sigma: Rayleigh, mean sqrt(pi / 2), variance 2 - pi / 2.
    assert values.mean() == pytest.approx(np.sqrt(np.pi / 2.0), abs=5.0 * 0.6551 / np.sqrt(values.size) + 1e-4)
    assert values.var() == pytest.approx(2.0 - np.pi / 2.0, rel=0.04)


def test_ct_noise_is_gaussian_with_the_stated_contrast(adult, lung):
    scan = acquire_ct(adult, lung, contrast_to_noise=6.0)
    noise = (scan.values - CT_UNITS[0]) / scan.noise_sd
    assert scan.noise_sd == pytest.approx((CT_UNITS[1] - CT_UNITS[2]) / 6.0)
    assert scan.contrast_to_noise == 6.0
    count = noise.size
    assert noise.mean() == pytest.approx(0.0, abs=5.0 / np.sqrt(count))
    assert noise.std() == pytest.approx(1.0, abs=5.0 / np.sqrt(2.0 * count))
    assert (noise**4).mean() == pytest.approx(3.0, abs=5.0 * np.sqrt(96.0 / count))
    assert scan.modality == "CT"


def test_bias_field_is_smooth_and_as_large_as_asked(adult, lung):
    clean = acquire_mri(adult, lung, contrast_to_noise=np.inf, bias=0.0)
    biased = acquire_mri(adult, lung, contrast_to_noise=np.inf, bias=0.2)
    ratio = biased.values / clean.values
    assert np.abs(ratio - 1.0).max() == pytest.approx(0.2, abs=1e-5)
    third = np.diff(ratio.astype(float), n=3, axis=0)
    assert np.abs(third).max() < 1e-5


def test_same_seed_same_scan_and_another_seed_another(adult, lung):
    once, again = (acquire_mri(adult, lung, seed=5) for _ in range(2))
    np.testing.assert_array_equal(once.values, again.values)
    assert once.values.dtype == np.float32
    assert once.geometry == lung
    assert np.any(acquire_mri(adult, lung, seed=6).values != once.values)
    np.testing.assert_array_equal(acquire_ct(adult, lung).values, acquire_ct(adult, lung).values)


@pytest.mark.parametrize(
    ("options", "message"),
    [({"contrast_to_noise": 0.0}, "above zero"), ({"bias": 1.5}, "below 1"), ({"supersampling": 0}, "at least one")],
)
def test_wrong_settings_are_refused(adult, lung, options, message):
    with pytest.raises(UsageError, match=message):
        acquire_mri(adult, lung, **options)


def test_chest_around_the_heart_has_lung_fat_soft_tissue_and_liver(adult):
    geometry = adult.scan_geometry(6.0)
    signal = noise_free(adult, geometry, CT_UNITS, supersampling=1)
    present = set(np.unique(signal))
    assert present == set(CT_UNITS)
    assert (signal == CT_UNITS[0]).mean() > 0.2
