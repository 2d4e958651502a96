import numpy as np
import pytest
from scipy import ndimage

from heartcase.phantom.scan.artefacts import (
    acquired_by_lines,
    breathing,
    coarse_blocks,
    hardening_error,
    line_weights,
    streaked,
    textured_noise,
)
from heartcase.schemas.errors import UsageError

# float32 with values up to 1
EXACT = {"rtol": 0.0, "atol": 2e-6}
ONE_VOXEL = (1.0, 1.0, 1.0)


def rng(seed=1):
    return np.random.Generator(np.random.PCG64(seed))


@pytest.fixture
def block():
    """A block of random values from 0 to 1 with 8 empty voxels around it."""
    values = np.zeros((32, 36, 30))
    values[8:-8, 8:-8, 8:-8] = rng().random((16, 20, 14))
    return values


# --- lines of an MRI


@pytest.mark.parametrize("phase_axis", [0, 1, 2])
def test_nothing_wrong_gives_the_object_itself(block, phase_axis):
    shifts = np.zeros(block.shape[phase_axis])
    for settings in ({}, {"weights": shifts + 1.0, "shifts_mm": shifts, "voxels_per_mm": ONE_VOXEL, "centred": True}):
        image = acquired_by_lines(block, phase_axis, **settings)
        assert image.dtype == np.complex64
        assert image.shape == block.shape
        np.testing.assert_allclose(image, block, **EXACT)


@pytest.mark.parametrize("axis", [0, 1, 2])
@pytest.mark.parametrize("shift_mm", [2.0, -1.5])
def test_a_constant_shift_is_a_translation(block, axis, shift_mm):
    # 2 voxels per mm
    rate = tuple(2.0 * (number == axis) for number in range(3))
    for phase_axis in range(3):
        shifts = np.full(block.shape[phase_axis], shift_mm)
        image = acquired_by_lines(block, phase_axis, shifts_mm=shifts, voxels_per_mm=rate)
        np.testing.assert_allclose(image, np.roll(block, round(2 * shift_mm), axis), **EXACT)


def test_what_leaves_comes_back_along_the_phase_axis_alone():
    values = rng(2).random((20, 24, 22))
    shifts = np.full(24, 3.0)
    along = acquired_by_lines(values, 1, shifts_mm=shifts, voxels_per_mm=(0.0, 1.0, 0.0))
    np.testing.assert_allclose(along, np.roll(values, 3, 1), **EXACT)
    across = acquired_by_lines(values, 1, shifts_mm=shifts, voxels_per_mm=(1.0, 0.0, 0.0))
    np.testing.assert_allclose(across[3:], values[:-3], **EXACT)
    np.testing.assert_allclose(across[:3], np.broadcast_to(values[:1], (3, 24, 22)), **EXACT)
    back = acquired_by_lines(values, 1, shifts_mm=-shifts, voxels_per_mm=(1.0, 0.0, 0.0))
    np.testing.assert_allclose(back[:-3], values[3:], **EXACT)
    np.testing.assert_allclose(back[-3:], np.broadcast_to(values[-1:], (3, 24, 22)), **EXACT)


@pytest.mark.parametrize("count", [30, 31])
@pytest.mark.parametrize("wave", [0, 4, -4])
def test_each_wave_along_the_phase_axis_moves_with_its_own_line(count, wave):
    # exp(2 pi i w y / n) has one line, w after the middle one; of a real cosine lines w and -w move each by its own.
    profile = np.zeros(40)
    profile[12:20] = rng(5).random(8)
    cosine = np.cos(2.0 * np.pi * wave * np.arange(count) / count)
    shifts = np.zeros(count)
    shifts[count // 2 + wave] = 5.0
    image = acquired_by_lines(profile[:, None, None] * cosine[:, None], 1, shifts_mm=shifts, voxels_per_mm=ONE_VOXEL)
    turning = np.exp(2j * np.pi * wave * (np.arange(count) - 5.0) / count)
    still = np.exp(-2j * np.pi * wave * np.arange(count) / count)
    moved = np.roll(profile, 5)[:, None] * turning
    expected = moved if wave == 0 else 0.5 * (moved + profile[:, None] * still)
    np.testing.assert_allclose(image[..., 0], expected, **EXACT)


def test_a_slanted_shift_moves_along_every_axis(block):
    image = acquired_by_lines(block, 1, shifts_mm=np.full(36, 2.0), voxels_per_mm=(1.0, -1.5, 0.5))
    np.testing.assert_allclose(image, np.roll(block, (2, -3, 1), (0, 1, 2)), **EXACT)


def test_a_gaussian_moves_by_a_part_of_a_voxel():
    z = np.arange(40.0)
    gaussian = np.exp(-0.5 * ((z - 20.0) / 3.0) ** 2)
    values = np.broadcast_to(gaussian[:, None, None], (40, 6, 5))
    image = acquired_by_lines(values, 1, shifts_mm=np.full(6, 1.0), voxels_per_mm=(1.0 / 1.75, 0.0, 0.0))
    moved = np.exp(-0.5 * ((z - 20.0 - 1.0 / 1.75) / 3.0) ** 2)
    np.testing.assert_allclose(image, np.broadcast_to(moved[:, None, None], values.shape), **EXACT)


@pytest.mark.parametrize(("amplitude", "period"), [(0.3, 4), (0.1, 8), (0.5, 3)])
@pytest.mark.parametrize("axis", [0, 1, 2])
def test_lines_that_rise_and_fall_make_two_ghosts_of_half_the_amplitude(amplitude, period, axis):
    values = np.zeros((48, 48, 48))
    values[20:26, 18:27, 21:25] = rng(3).random((6, 9, 4))
    image = acquired_by_lines(values, axis, weights=line_weights(48, amplitude, period))
    ghosts = np.roll(values, 48 // period, axis) + np.roll(values, -48 // period, axis)
    np.testing.assert_allclose(image, values + 0.5 * amplitude * ghosts, **EXACT)


def test_with_a_period_of_two_lines_both_ghosts_fall_together_half_a_field_away():
    values = np.zeros((6, 40, 6))
    values[2:4, 5:9, 1:5] = 1.0
    image = acquired_by_lines(values, 1, weights=line_weights(40, 0.2, 2))
    np.testing.assert_allclose(image, values + 0.2 * np.roll(values, 20, 1), **EXACT)


def test_places_without_order_are_spread_evenly_over_the_window():
    places = breathing(100, 5.0, rng())
    np.testing.assert_allclose(np.sort(places), (np.arange(100) + 0.5) / 20.0 - 2.5, atol=1e-12)
    assert abs(np.corrcoef(places[1:], places[:-1])[0, 1]) < 0.4
    np.testing.assert_array_equal(places, breathing(100, 5.0, rng()))
    assert np.any(places != breathing(100, 5.0, rng(2)))


def test_a_breath_is_periodic_and_spread_evenly_over_the_window():
    places = breathing(10_000, 5.0, rng(), lines_per_breath=12.5)
    np.testing.assert_allclose(places[25:], places[:-25], atol=1e-9)
    assert np.abs(places).max() <= 2.5
    places = breathing(10_000, 5.0, rng(), lines_per_breath=4.0 * np.e)
    assert np.abs(places).max() > 2.499
    # moments of a uniform distribution
    assert places.mean() == pytest.approx(0.0, abs=2e-3)
    assert places.var() == pytest.approx(25.0 / 12.0, rel=1e-3)
    assert (places**4).mean() == pytest.approx(2.5**4 / 5.0, rel=1e-3)


def test_motion_without_order_blurs_by_the_window():
    # All lines of a point are equal, so that its own row gets the mean over the places: a box as wide as the window.
    values = np.zeros((64, 200, 1))
    values[32, 70, 0] = 1.0
    window = 5.0
    image = acquired_by_lines(values, 1, shifts_mm=breathing(200, window, rng()), voxels_per_mm=(0.5, 0.0, 0.0))
    # The ends of the volume are far away: what is outside is the padding, zero.
    response = np.zeros(1024, complex)
    response[:64] = image[:, 70, 0]
    frequency = np.fft.fftfreq(1024)
    found = np.fft.fft(np.roll(response, -32))
    inner = np.abs(frequency) < 0.4
    # the box, of 2.5 voxels; the point's ripple goes on behind both ends
    np.testing.assert_allclose(found[inner], np.sinc(2.5 * frequency)[inner], atol=0.02)


def test_motion_keeps_the_energy_of_every_line():
    values = np.zeros((40, 32, 4))
    values[15:25, 10:20, 1:3] = rng(4).random((10, 10, 2))
    image = acquired_by_lines(values, 1, shifts_mm=breathing(32, 3.0, rng()), voxels_per_mm=(0.0, 1.0, 0.0))
    before, after = (np.abs(np.fft.fft(array, axis=1)) for array in (values, image))
    np.testing.assert_allclose(after, before, atol=1e-5)
    assert np.abs(np.abs(image) - values).max() > 0.05


def test_a_periodic_breath_makes_ghosts_at_its_harmonics_alone():
    # The lines' factors have period 8: whatever they are, they are 8 copies, an eighth of the field apart.
    values = np.zeros((40, 64, 1))
    values[14:26, 3, 0] = 1.0
    shifts = breathing(64, 4.0, rng(), lines_per_breath=8.0)
    image = np.abs(acquired_by_lines(values, 1, shifts_mm=shifts, voxels_per_mm=(1.0, 0.0, 0.0)))
    rows = image.max(axis=(0, 2))
    there = np.arange(64) % 8 == 3
    assert rows[~there].max() < 1e-5
    assert rows[there].min() > 0.01


def test_the_best_shift_is_taken_off():
    # What does not change along the phase axis is all in one line: it must lie where it was.
    bar = np.zeros((40, 31, 5))
    bar[15:25] = 1.0
    shifts = breathing(31, 5.0, rng(7))
    settings = {"shifts_mm": shifts, "voxels_per_mm": (1.0 / 1.75, 0.0, 0.0)}
    np.testing.assert_allclose(acquired_by_lines(bar, 1, **settings, centred=True), bar, **EXACT)
    moved = acquired_by_lines(bar, 1, **settings)
    assert np.abs(moved - bar).max() > 0.1
    # A blunt object in one line and a sharp one in others: fitted by its derivative, all of it has not moved.
    z, y = np.arange(48.0)[:, None] - 24.0, np.arange(31.0)
    sharp = np.exp(-0.5 * (z / 1.5) ** 2) * np.cos(2.0 * np.pi * 3.0 * y / 31.0)
    both = (5.0 * np.exp(-0.5 * (z / 6.0) ** 2) + sharp)[..., None]
    slope = 0.5 * (np.roll(both, 1, 0) - np.roll(both, -1, 0))

    def displacement(centred):
        small = acquired_by_lines(
            both, 1, shifts_mm=breathing(31, 0.5, rng(7)), voxels_per_mm=(1.0, 0.0, 0.0), centred=centred
        )
        return float(((small.real - both) * slope).sum() / (slope * slope).sum())

    assert abs(displacement(False)) > 0.05
    assert abs(displacement(True)) < 0.01


def test_the_signal_is_not_changed(block):
    before = block.copy()
    shifts = breathing(36, 2.0, rng())
    once, again = (
        acquired_by_lines(block, 1, weights=line_weights(36, 0.2, 4), shifts_mm=shifts, voxels_per_mm=(1.0, 0.5, 0.0))
        for _ in range(2)
    )
    np.testing.assert_array_equal(block, before)
    np.testing.assert_array_equal(once, again)


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda: breathing(9, -1.0, rng()), "at least 0 mm"),
        (lambda: breathing(9, np.nan, rng()), "at least 0 mm"),
        (lambda: breathing(9, 1.0, rng(), lines_per_breath=1.5), "at least 2 lines"),
        (lambda: line_weights(9, 1.0, 4), "below 1"),
        (lambda: line_weights(9, -0.1, 4), "below 1"),
        (lambda: line_weights(9, 0.1, 1), "at least 2 lines"),
        (lambda: textured_noise((2, 8, 8), (1.0, 1.0), rng(), peak_per_mm=0.0), "above zero"),
        (lambda: textured_noise((2, 8, 8), (1.0, 1.0), rng(), slice_correlation=0.71), "from 0 to 0.7"),
        (lambda: textured_noise((2, 1, 1), (1.0, 1.0), rng()), "one pixel"),
        (lambda: textured_noise((2, 2, 2), (0.1, 0.1), rng()), "too small"),
        (lambda: streaked(np.zeros((1, 4, 4)), (1.0, 1.0), above=0.0, darkest=-1.0), "at least 0"),
    ],
)
def test_wrong_settings_are_refused(call, message):
    with pytest.raises(UsageError, match=message):
        call()


# --- noise of a CT

PIXEL = (0.5, 0.4)


@pytest.fixture(scope="module")
def noise():
    return textured_noise((40, 256, 320), PIXEL, rng(), peak_per_mm=0.3, slice_correlation=0.3)


def test_texture_has_the_standard_deviation_asked_for_and_no_mean(noise):
    assert noise.dtype == np.float32
    assert noise.std(dtype=float) == pytest.approx(1.0, rel=0.005)
    # The power at frequency zero is zero: no slice has a mean but for rounding.
    assert np.abs(noise.mean(axis=(1, 2), dtype=float)).max() < 1e-6
    # Gaussian
    assert (noise.astype(float) ** 4).mean() == pytest.approx(3.0, rel=0.02)
    assert (noise.astype(float) ** 3).mean() == pytest.approx(0.0, abs=0.02)


def test_texture_has_the_power_of_filtered_back_projection(noise):
    power = (np.abs(np.fft.fft2(noise.astype(float))) ** 2).mean(axis=0)
    frequency = np.hypot(np.fft.fftfreq(256, PIXEL[0])[:, None], np.fft.fftfreq(320, PIXEL[1]))
    width = 0.02
    rings = (frequency / width).astype(int)
    radial = np.bincount(rings.ravel(), power.ravel())[:50] / np.bincount(rings.ravel())[:50]
    middle = (np.arange(50) + 0.5) * width
    # Hann's window with its cutoff where the highest power is at 0.3: f cos(pi f / 2c)^4, derived by a fine search.
    u = np.linspace(1e-4, 1.0, 2_000_001)
    cutoff = 0.3 / u[np.argmax(u * np.cos(0.5 * np.pi * u) ** 4)]
    truth = middle * np.cos(0.5 * np.pi * np.minimum(middle / cutoff, 1.0)) ** 4
    truth *= radial.sum() / truth.sum()
    # 40 slices of some hundred frequencies a ring: 2% of noise; a ring's mean is not its middle's value where it bends
    np.testing.assert_allclose(radial, truth, atol=0.04 * truth.max())
    assert middle[radial.argmax()] == pytest.approx(0.3, abs=0.05)
    assert radial[0] < 0.1 * radial.max()
    assert radial[45:].max() < 0.05 * radial.max()


def test_texture_is_the_same_in_all_directions_whatever_the_pixels(noise):
    # Correlation at 1.2 mm along x (3 pixels) and at 1 and 1.5 mm along y, which are around it.
    values = noise.astype(float)
    along_x = (values * np.roll(values, 3, 2)).mean()
    along_y = [(values * np.roll(values, n, 1)).mean() for n in (2, 3)]
    assert min(along_y) < along_x < max(along_y)
    assert along_x < -0.05


def test_neighbouring_slices_are_correlated_as_asked(noise):
    values = noise.astype(float)
    assert (values[1:] * values[:-1]).mean() == pytest.approx(0.3, abs=0.01)
    # the kernel (s, m, s) with 2 s m = 0.3 and m^2 + 2 s^2 = 1 gives s^2 two slices on
    middle = np.sqrt(0.5 + 0.5 * np.sqrt(1.0 - 2.0 * 0.3**2))
    assert (values[2:] * values[:-2]).mean() == pytest.approx((0.15 / middle) ** 2, abs=0.01)
    assert (values[3:] * values[:-3]).mean() == pytest.approx(0.0, abs=0.01)
    apart = textured_noise((30, 128, 128), PIXEL, rng(), slice_correlation=0.0).astype(float)
    assert (apart[1:] * apart[:-1]).mean() == pytest.approx(0.0, abs=0.01)


def test_the_ensemble_has_unit_power_for_any_shape_and_pixel():
    for shape, pixel in [((400, 7, 10), (3.0, 0.2)), ((400, 9, 8), (1.0, 1.0)), ((3000, 1, 12), (0.3, 0.3))]:
        noise = textured_noise(shape, pixel, rng(), slice_correlation=0.0)
        # some dozen independent values a slice at least
        assert (noise.astype(float) ** 2).mean() == pytest.approx(1.0, rel=0.05)


def test_texture_depends_on_the_seed_alone():
    once, again, other = (textured_noise((3, 20, 21), PIXEL, rng(seed)) for seed in (1, 1, 2))
    np.testing.assert_array_equal(once, again)
    assert np.any(once != other)


# --- streaks of a CT


def disc(shape, centre, radius, pixel=(1.0, 1.0), parts=8):
    """Share of each pixel in a disc; places in mm from the middle."""
    inside = np.zeros(shape)
    steps = (np.arange(parts) + 0.5) / parts - 0.5
    y, x = (((np.arange(n) - 0.5 * (n - 1))[:, None] + steps) * step for n, step in zip(shape, pixel, strict=True))
    for b in range(parts):
        for a in range(parts):
            inside += np.hypot(y[:, None, b] - centre[0], x[None, :, a] - centre[1]) < radius
    return inside / parts**2


@pytest.mark.parametrize("pixel", [(1.0, 1.0), (0.8, 1.3)])
def test_hardening_in_a_disc_is_a_dome_inside_it_and_nothing_outside(pixel):
    # p = 2 u sqrt(r^2 - s^2); the projection of sqrt(r^2 - rho^2) is pi / 2 (r^2 - s^2): p^2 is that of a dome.
    shape, centre, radius, u = (140, 110), (6.0, -9.0), 16.0, 0.02
    error = hardening_error(u * disc(shape, centre, radius, pixel)[None], pixel)[0]
    y, x = ((np.arange(n) - 0.5 * (n - 1)) * step for n, step in zip(shape, pixel, strict=True))
    rho = np.hypot(y[:, None] - centre[0], x - centre[1])
    dome = -8.0 / np.pi * u**2 * np.sqrt(np.maximum(radius**2 - rho**2, 0.0))
    off = np.abs(error - dome) / -dome.min()
    assert off[(rho < radius - 3.0) | (rho > radius + 3.0)].max() < 0.03
    # the dome is as steep as a wall at its rim, where a pixel holds a good part of it
    assert off.max() < 0.15


def test_hardening_between_two_discs_is_a_dark_band():
    shape, radius, u = (128, 128), 10.0, 0.02
    left, right = disc(shape, (0.0, -35.0), radius), disc(shape, (0.0, 35.0), radius)
    both = hardening_error(u * (left + right)[None], (1.0, 1.0))[0]
    alone = sum(hardening_error(u * one[None], (1.0, 1.0))[0] for one in (left, right))
    peak = 8.0 / np.pi * u**2 * radius
    middle = both[62:66, 54:74]
    assert middle.max() < -0.1 * peak
    # The band is that of rays through both: without one of the discs there is none.
    assert np.abs(alone[62:66, 54:74]).max() < 0.02 * peak
    # above and below the discs it is a tenth of the band, and not dark
    assert np.abs(both[:30]).max() < 0.1 * np.abs(middle).max()
    assert np.abs(both[-30:]).max() < 0.1 * np.abs(middle).max()
    # The image's projection along the band is minus the square of the path, u times both chords; but for the far tails
    # of the band, which are beyond the slice and hardly differ from row to row.
    height = np.arange(128) - 63.5
    square = (2.0 * u * 2.0 * np.sqrt(np.maximum(radius**2 - height**2, 0.0))) ** 2
    inner = np.abs(height) < radius - 2.0
    tails = both.sum(axis=1)[inner] + square[inner]
    assert np.ptp(tails) < 0.01 * square.max()
    assert 0.0 < tails.mean() < 0.2 * square.max()


def test_hardening_agrees_with_another_reconstruction():
    transform = pytest.importorskip("skimage.transform")
    shape = (128, 128)
    dense = 0.02 * disc(shape, (-10.0, -30.0), 12.0) + 0.015 * disc(shape, (14.0, 22.0), 15.0)
    angles = np.arange(180.0)
    other = -transform.iradon(transform.radon(dense, angles, circle=True) ** 2, angles, circle=True)
    ours = hardening_error(dense[None], (1.0, 1.0))[0]
    # its pixels are rotated with interpolation: 1 pixel of the rims is another
    inside = np.hypot(*(np.indices(shape) - 64.0)) < 60.0
    difference = (ours - other)[inside]
    assert np.sqrt((difference**2).mean()) < 0.01 * np.abs(other).max()
    assert np.corrcoef(ours[inside], other[inside])[0, 1] > 0.998


def test_streaks_darken_the_worst_place_as_asked_and_leave_slices_without_dense_tissue():
    pixel, shape = (0.7, 0.7), (128, 128)
    dense = disc(shape, (0.0, -25.0), 7.0, pixel) + disc(shape, (0.0, 25.0), 7.0, pixel)
    values = np.stack([50.0 + 0.0 * dense, 50.0 + 850.0 * dense, 50.0 + 300.0 * dense])
    before = values.copy()
    change = streaked(values, pixel, above=200.0, darkest=60.0) - values
    np.testing.assert_array_equal(values, before)
    assert np.all(change[0] == 0.0)
    assert change.min() == pytest.approx(-60.0, abs=1e-9)
    assert change[1].min() == change.min()
    assert change[1, 60:68, 54:74].max() < -6.0
    # Half the darkening asked for is half everywhere; of excesses 700 and 150 the squares count.
    half = streaked(values, pixel, above=200.0, darkest=30.0) - values
    np.testing.assert_allclose(half, 0.5 * change, atol=1e-9)
    ratio = change[2, 60:68, 54:74].sum() / change[1, 60:68, 54:74].sum()
    assert ratio == pytest.approx((150.0 / 700.0) ** 2, rel=0.05)


def test_no_streaks_change_nothing():
    values = rng().normal(300.0, 200.0, (3, 12, 14))
    np.testing.assert_array_equal(streaked(values, (1.0, 1.0), above=200.0, darkest=0.0), values)
    np.testing.assert_array_equal(streaked(values, (1.0, 1.0), above=2000.0, darkest=50.0), values)


def test_fine_slices_get_the_streaks_of_their_coarse_ones():
    # 2 x 3 pixels in one of the coarse slice.
    coarse = np.stack([disc((60, 66), (0.0, -15.0), 9.0) + disc((60, 66), (3.0, 17.0), 8.0)]) * 900.0
    fine = np.repeat(np.repeat(coarse, 2, axis=1), 3, axis=2)
    expected = streaked(coarse, (1.0, 1.0), above=200.0, darkest=100.0, most=66) - coarse
    found = streaked(fine, (0.5, 1.0 / 3.0), above=200.0, darkest=100.0, most=66) - fine
    means, block = coarse_blocks(found, 66)
    assert block == (2, 3)
    # Two linear steps at 1/4 from the middle have the mean 1/8, 6/8, 1/8 of three blocks; three at 1/3 1/9, 7/9, 1/9.
    for axis, kernel in ((1, (1 / 8, 6 / 8, 1 / 8)), (2, (1 / 9, 7 / 9, 1 / 9))):
        expected = ndimage.correlate1d(expected, kernel, axis=axis, mode="nearest")
    np.testing.assert_allclose(means, expected, atol=1e-9)


def test_blocks_hold_means_and_zero_beyond_the_edges():
    values = np.arange(2 * 5 * 4, dtype=float).reshape(2, 5, 4)
    means, block = coarse_blocks(values, 3)
    assert block == (2, 2)
    assert means.shape == (2, 3, 2)
    assert means[0, 0, 0] == np.mean([0.0, 1.0, 4.0, 5.0])
    assert means[1, 2, 1] == (38.0 + 39.0) / 4.0
    same, block = coarse_blocks(values, 5)
    assert block == (1, 1)
    np.testing.assert_array_equal(same, values)
