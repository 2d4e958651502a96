import numpy as np
import pytest

from heartcase.phantom.scan.acquisition import (
    CT_UNITS,
    MRI_UNITS,
    SPECIMEN_UNITS,
    UNDILUTED_HU,
    CtArtefacts,
    MriArtefacts,
    acquire_ct,
    acquire_mri,
    noise_free,
)
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


def test_without_artefacts_an_mri_is_signal_and_noise_to_the_last_byte(adult, small):
    signal = noise_free(adult, small, MRI_UNITS)
    generator = np.random.Generator(np.random.PCG64(3))
    generator.standard_normal(9)  # of the bias field
    sigma = (MRI_UNITS[1] - MRI_UNITS[2]) / 14.5
    real = signal + sigma * generator.standard_normal(small.shape)
    expected = np.hypot(real, sigma * generator.standard_normal(small.shape)).astype(np.float32).tobytes()
    off = MriArtefacts(motion_mm=0.0, lines_per_breath=9.0, ghost=0.0, ghost_period=3.0, phase_axis=2)
    for artefacts in (None, MriArtefacts(), off):
        scan = acquire_mri(adult, small, bias=0.0, seed=3, signal=signal, artefacts=artefacts)
        assert scan.values.tobytes() == expected
    with_bias = (acquire_mri(adult, small, signal=signal, artefacts=artefacts) for artefacts in (None, off))
    assert len({scan.values.tobytes() for scan in with_bias}) == 1


def test_without_artefacts_a_ct_is_signal_and_noise_to_the_last_byte(adult, small):
    signal = noise_free(adult, small, CT_UNITS)
    noise = np.random.Generator(np.random.PCG64(3)).standard_normal(small.shape)
    expected = (signal + 30.0 * noise).astype(np.float32).tobytes()
    off = CtArtefacts(texture=False, texture_peak_per_mm=0.5, slice_correlation=0.5, streak=0.0, streak_above=0.0)
    for settings in ({}, {"artefacts": None}, {"artefacts": CtArtefacts()}, {"artefacts": off}, {"units": CT_UNITS}):
        assert acquire_ct(adult, small, seed=3, signal=signal, **settings).values.tobytes() == expected
    assert acquire_ct(adult, small, seed=3, slice_thickness_mm=1.75).values.tobytes() == expected
    same_blood = CtArtefacts(caval_hu=CT_UNITS[1])
    assert acquire_ct(adult, small, seed=3, artefacts=same_blood).values.tobytes() == expected
    assert noise_free(adult, small, CT_UNITS, slice_thickness_mm=1.75).tobytes() == signal.tobytes()


@pytest.fixture(scope="module")
def gaussian():
    """A lattice turned in the plane of i and k, and a smooth ball of 5 mm in it; the ball's signal and its middle.

    A step along i and one back along k is 2.5 mm across z: 0.6 * 2 mm is 0.8 * 1.5 mm.
    """
    direction = [[0.8, 0.0, -0.6], [0.0, 1.0, 0.0], [0.6, 0.0, 0.8]]
    geometry = Geometry.of(shape=(40, 40, 32), spacing_mm=(2.0, 1.6, 1.5), direction=direction)
    middle = geometry.index_to_world((15.5, 19.5, 19.5))
    signal = 900.0 * np.exp(-0.5 * ((lattice_points(geometry) - middle) ** 2).sum(axis=-1) / 5.0**2)
    return geometry, signal, middle


def still(adult, geometry, signal, **artefacts):
    return acquire_mri(
        adult, geometry, contrast_to_noise=np.inf, bias=0.0, signal=signal, artefacts=MriArtefacts(**artefacts)
    ).values


@pytest.mark.parametrize("phase_axis", [0, 1, 2])
def test_ghosts_of_an_mri_lie_along_the_phase_axis(adult, gaussian, phase_axis):
    geometry, signal, _ = gaussian
    values = still(adult, geometry, signal, ghost=0.2, ghost_period=4.0, phase_axis=phase_axis)
    quarter, axis = geometry.size[phase_axis] // 4, 2 - phase_axis
    ghosts = np.roll(signal, quarter, axis) + np.roll(signal, -quarter, axis)
    np.testing.assert_allclose(values, signal + 0.1 * ghosts, atol=2e-3)


@pytest.mark.parametrize("lines_per_breath", [0.0, 7.0])
def test_breathing_moves_along_the_patients_z(adult, gaussian, lines_per_breath):
    # The ball is a product of functions of x, y and z: whatever moves along z, and smears along y, leaves that of x.
    geometry, signal, middle = gaussian
    values = still(adult, geometry, signal, motion_mm=6.0, lines_per_breath=lines_per_breath)
    assert np.abs(values - signal).max() > 50.0
    x = (lattice_points(geometry) - middle)[..., 0]
    profile = np.exp(-0.5 * (x / 5.0) ** 2)
    # one step along i and one back along k: another x, the same y and z
    here, there = values[1:, :, :-1] / profile[1:, :, :-1], values[:-1, :, 1:] / profile[:-1, :, 1:]
    near = (np.abs(x[1:, :, :-1]) < 8.0) & (np.abs(x[:-1, :, 1:]) < 8.0)
    np.testing.assert_allclose(here[near], there[near], atol=0.02)


def test_the_image_of_a_breathing_object_is_where_the_truth_is(adult, gaussian):
    # What is the same along the phase axis is in one line of k-space, which is read at one place: the truth's.
    geometry, _, middle = gaussian
    away = lattice_points(geometry) - middle
    bar = 900.0 * np.exp(-0.5 * (away[..., 0] ** 2 + away[..., 2] ** 2) / 5.0**2)
    np.testing.assert_allclose(still(adult, geometry, bar, motion_mm=6.0), bar, atol=0.02)


def test_motion_leaves_the_noise_as_it_is(adult, lung):
    # In a box of nothing but lung nothing can be seen moving.
    plain = acquire_mri(adult, lung, bias=0.0)
    moving = acquire_mri(adult, lung, bias=0.0, artefacts=MriArtefacts(motion_mm=5.0))
    np.testing.assert_allclose(moving.values, plain.values, atol=1e-3)
    assert moving.noise_sd == plain.noise_sd


def test_motion_depends_on_the_seed_alone(adult, small):
    signal = noise_free(adult, small, MRI_UNITS)
    moving = MriArtefacts(motion_mm=5.0, ghost=0.1)
    once, again, other = (acquire_mri(adult, small, signal=signal, seed=n, artefacts=moving).values for n in (1, 1, 2))
    assert once.tobytes() == again.tobytes()
    assert np.any(once != other)
    one = still(adult, small, signal, motion_mm=5.0)
    assert np.abs(one - signal).max() > 50.0


def test_noise_with_texture_has_the_same_standard_deviation(adult, lung):
    scan = acquire_ct(adult, lung, artefacts=CtArtefacts(texture=True, texture_peak_per_mm=0.2))
    assert scan.noise_sd == 30.0
    noise = (scan.values.astype(float) - CT_UNITS[0]) / 30.0
    assert noise.std() == pytest.approx(1.0, rel=0.03)
    assert np.abs(noise.mean(axis=(1, 2))).max() < 1e-4
    assert (noise[1:] * noise[:-1]).mean() == pytest.approx(0.2, abs=0.05)
    # cycles per mm: power at 0.2 is the highest, and close to frequency zero there is little
    power = (np.abs(np.fft.fft2(noise)) ** 2).mean(axis=0)
    frequency = np.hypot(np.fft.fftfreq(30)[:, None], np.fft.fftfreq(30))
    cutoff = 0.2 / 0.30567
    truth = frequency * np.cos(0.5 * np.pi * np.minimum(frequency / cutoff, 1.0)) ** 4
    rings = [frequency < 0.05, np.abs(frequency - 0.2) < 0.03, frequency > 0.4]
    expected = np.array([truth[ring].mean() for ring in rings]) * 900.0 / truth.mean()
    # 4 frequencies that differ, in 30 slices that hardly do: 10% of noise in the first ring
    np.testing.assert_allclose([power[ring].mean() for ring in rings], expected, rtol=0.3)
    assert np.any(acquire_ct(adult, lung, artefacts=CtArtefacts(texture=True), seed=2).values != scan.values)


@pytest.fixture(scope="module")
def upper(adult):
    """Three axial slices of 2.5 mm through the superior vena cava, the aorta and the pulmonary artery."""
    middle = adult.anatomy.places["superior vena cava line"][12]
    return Geometry.of(shape=(3, 96, 96), origin_mm=middle - [35.0, 96.0, 2.0], spacing_mm=(1.5, 1.5, 2.0))


def test_the_superior_cava_alone_holds_undiluted_medium(adult, upper):
    plain = noise_free(adult, upper, CT_UNITS)
    marked = noise_free(adult, upper, (*CT_UNITS, UNDILUTED_HU))
    points = lattice_points(upper)
    cava = adult.truth.value(points, 7)
    assert (cava < -2.0).any()
    np.testing.assert_array_equal(marked[cava < -2.0], UNDILUTED_HU)
    np.testing.assert_array_equal(plain[cava < -2.0], CT_UNITS[1])
    np.testing.assert_array_equal(marked[cava > 2.0], plain[cava > 2.0])
    assert (plain[cava > 2.0] == CT_UNITS[1]).any()


def test_streaks_darken_a_ct_between_the_cava_and_other_blood(adult, upper):
    units = (*CT_UNITS, UNDILUTED_HU)
    clean = noise_free(adult, upper, units)
    settings = {"contrast_to_noise": np.inf, "signal": clean}
    streaked = acquire_ct(adult, upper, **settings, artefacts=CtArtefacts(streak=100.0, caval_hu=UNDILUTED_HU)).values
    change = streaked - clean
    assert change.min() == pytest.approx(-100.0, abs=1e-3)
    assert clean[np.unravel_index(change.argmin(), change.shape)] == UNDILUTED_HU
    # between the cava and the aorta, in what is not dense
    dense = clean > 200.0
    assert change[~dense].min() < -10.0
    far = np.zeros(clean.shape, bool)
    far[:, :8] = True
    assert not dense[far].any()
    assert np.abs(change[far]).max() < 5.0
    # nothing above the threshold: nothing changes
    none = CtArtefacts(streak=100.0, caval_hu=UNDILUTED_HU, streak_above=1000.0)
    np.testing.assert_array_equal(acquire_ct(adult, upper, **settings, artefacts=none).values, clean.astype(np.float32))


@pytest.mark.thorough
def test_thin_slices_average_over_their_own_thickness(adult, small):
    # The middles of 25 layers a voxel, 15 of them within a slice of 0.6 of the distance.
    thick = small.model_copy(update={"spacing_mm": (1.75, 1.75, 5.0), "size": (24, 24, 6)})
    layers = Geometry.of(
        shape=(6 * 25, 24, 24),
        origin_mm=thick.index_to_world((0.0, 0.0, -12.0 / 25.0)),
        spacing_mm=(1.75, 1.75, 0.2),
    )
    # in the plane as many points as in the slices
    fine = noise_free(adult, layers, CT_UNITS, supersampling=5).reshape(6, 25, 24, 24)
    expected = fine[:, 5:20].mean(axis=1)
    found = noise_free(adult, thick, CT_UNITS, supersampling=5, slice_thickness_mm=3.0)
    whole = noise_free(adult, thick, CT_UNITS, supersampling=5)
    near_heart = adult.truth.value(lattice_points(thick), 0) > -3.0
    border = near_heart & (found != np.round(found))
    assert border.sum() > 200
    # 5 points along k against 75: of a border that crosses a slice of 3 mm evenly, 1 in 10 of the contrast at most
    assert np.abs(found - expected)[border].max() < 0.1 * (CT_UNITS[1] - CT_UNITS[4]) + 1.0
    error = np.sqrt(((found - expected)[border] ** 2).mean())
    assert error < 0.1 * np.sqrt(((whole - expected)[border] ** 2).mean())


@pytest.mark.thorough
def test_a_thin_slice_sees_less_than_a_thick_one(adult):
    # A border that is horizontal in so narrow a voxel: the diaphragm, found in a column of thin ones.
    column = Geometry.of(shape=(1000, 1, 1), origin_mm=(120.0, -18.0, -62.0), spacing_mm=(0.1, 0.1, 0.01))
    lung, tissue = CT_UNITS[0], CT_UNITS[5]
    above = noise_free(adult, column, CT_UNITS, supersampling=1).ravel() == lung
    assert not above[0]
    assert above[-1]
    border = -62.0 + 0.01 * (np.argmax(above) - 0.5)
    # The border is 1.2 mm below the centre: outside a slice of 2 mm, within one of 3 and of 4 mm.
    one = Geometry.of(shape=(1, 1, 1), origin_mm=(120.0, -18.0, border + 1.2), spacing_mm=(0.1, 0.1, 4.0))
    values = [
        float(noise_free(adult, one, CT_UNITS, supersampling=40, slice_thickness_mm=t)[0, 0, 0])
        for t in (2.0, 3.0, 4.0)
    ]
    share = [(value - lung) / (tissue - lung) for value in values]
    assert share == pytest.approx([0.0, 0.1, 0.2], abs=0.013)


@pytest.mark.parametrize("thickness", [0.0, -1.0, 1.76, np.nan])
def test_impossible_slices_are_refused(adult, small, thickness):
    with pytest.raises(UsageError, match="slices must be thicker"):
        noise_free(adult, small, CT_UNITS, slice_thickness_mm=thickness)
    with pytest.raises(UsageError, match="slices must be thicker"):
        acquire_ct(adult, small, slice_thickness_mm=thickness)


def test_a_specimen_is_tissue_in_air(adult, small):
    assert len(SPECIMEN_UNITS) == len(CT_UNITS)
    signal = noise_free(adult, small, SPECIMEN_UNITS)
    points = lattice_points(small)
    assert set(np.unique(noise_free(adult, adult.scan_geometry(6.0), SPECIMEN_UNITS, supersampling=1))) == {
        -1000.0,
        100,
    }
    np.testing.assert_array_equal(signal[adult.truth.value(points, 1) < -2.0], -1000.0)
    np.testing.assert_array_equal(signal[adult.truth.value(points, 9) < -2.0], 100.0)
    scan = acquire_ct(adult, small, units=SPECIMEN_UNITS, signal=signal, contrast_to_noise=44.0)
    assert scan.noise_sd == 25.0
    assert (scan.values - signal).std() == pytest.approx(25.0, rel=0.03)


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: MriArtefacts(motion_mm=-1.0), "at least 0 mm"),
        (lambda: MriArtefacts(lines_per_breath=1.0), "at least 2 lines"),
        (lambda: MriArtefacts(ghost=1.0), "below 1"),
        (lambda: MriArtefacts(ghost_period=1.0), "at least 2 lines"),
        (lambda: MriArtefacts(phase_axis=3), "0 .i., 1 .j. or 2"),
    ],
)
def test_wrong_artefacts_of_an_mri_are_refused(make, message):
    with pytest.raises(UsageError, match=message):
        make()


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"artefacts": CtArtefacts(streak=-1.0)}, "at least 0"),
        ({"artefacts": CtArtefacts(texture=True, texture_peak_per_mm=0.0)}, "above zero"),
        ({"artefacts": CtArtefacts(texture=True, slice_correlation=0.8)}, "from 0 to 0.7"),
        ({"units": CT_UNITS[:6]}, "7 tissues"),
        ({"units": (*CT_UNITS, 1.0, 2.0)}, "7 tissues"),
    ],
)
def test_wrong_settings_of_a_ct_are_refused(adult, lung, settings, message):
    with pytest.raises(UsageError, match=message):
        acquire_ct(adult, lung, **settings)


@pytest.mark.thorough
def test_a_specimen_is_its_tissue_in_air_and_its_vessels_are_open(child):
    geometry = child.scan_geometry(2.0, margin_mm=8.0)
    found = noise_free(child, geometry, SPECIMEN_UNITS, supersampling=1, in_air=True)
    labels = child.truth.label(lattice_points(geometry))
    np.testing.assert_array_equal(found, np.where(np.isin(labels, child.truth.table.tissue_values), 100.0, -1000.0))
    for end in child.ends:
        disc, out = np.array(end.position_mm), np.array(end.axis)
        beyond = geometry.world_to_index(disc[None] + np.arange(0.5, 6.0, 0.5)[:, None] * out)
        index = np.rint(beyond).astype(int)[:, ::-1]
        assert (found[tuple(index.T)] == -1000.0).all(), end.label
    mean = noise_free(child, geometry, SPECIMEN_UNITS, supersampling=3, in_air=True)
    assert -1000.0 <= mean.min() < mean.max() <= 100.0
    assert mean.mean() == pytest.approx(found.mean(), abs=3.0)
