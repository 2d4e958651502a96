import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import ndimage

from heartcase.pipeline.data import UNMARKED
from heartcase.pipeline.image.gradient import gradient_magnitude
from heartcase.pipeline.image.landscape import landscape, resolve_segment
from heartcase.pipeline.watershed.forest import solve_forest
from heartcase.pipeline.watershed.tree import build_basin_tree
from heartcase.schemas.recipe.settings import SegmentSettings


def plain_gradient(values, spacing_mm, sigma_mm):
    """Gradient magnitude by SciPy's Gaussian and NumPy's differences in float64; the slopes go on past the faces."""
    spacing = spacing_mm[::-1]
    reach = [int(np.ceil(4.0 * sigma_mm / h)) + 1 for h in spacing]
    wide = np.pad(values.astype(np.float64), [(r, r) for r in reach], mode="reflect", reflect_type="odd")
    wide = ndimage.gaussian_filter(wide, [sigma_mm / h for h in spacing], mode="nearest", truncate=4.0)
    inner = wide[tuple(slice(r, -r) for r in reach)]
    return np.sqrt(sum(np.gradient(inner, h, axis=axis) ** 2 for axis, h in enumerate(spacing)))


@settings(max_examples=40, deadline=None)
@given(
    shape=st.tuples(st.integers(2, 14), st.integers(2, 14), st.integers(2, 40)),
    spacing_mm=st.tuples(*[st.sampled_from([0.5, 0.8, 1.75, 3.0])] * 3),
    shape_sigma_mm=st.sampled_from([0.6, 1.5, 3.0]),
    noise_floor=st.sampled_from([0.0, 6.0, 20.0]),
    seed=st.integers(0, 2**32 - 1),
)
def test_equals_the_formula_in_float64(shape, spacing_mm, shape_sigma_mm, noise_floor, seed):
    values = np.random.default_rng(seed).normal(0.0, 100.0, shape).astype(np.float32)
    steep, shaped = plain_gradient(values, spacing_mm, 1e-9), plain_gradient(values, spacing_mm, shape_sigma_mm)
    unit = np.quantile(steep, 0.1)
    most = 1.2 * unit
    bare = steep + most * shaped / np.hypot(most, shaped)
    given = {"gradient_sigma_mm": 0.0, "shape_sigma_mm": shape_sigma_mm, "noise_floor": noise_floor}
    got = landscape(values, spacing_mm, **given)
    assert got.height.dtype == np.float32
    # what is noise is well below the steepest voxels
    noise = min(unit, np.quantile(steep, 0.99) / 32.0)
    np.testing.assert_allclose(got.height, np.maximum(bare, noise_floor * noise), rtol=1e-4, atol=1e-3 * most)
    if not noise_floor:
        assert got.cost is None
        return
    cost = np.minimum(1.0 + np.minimum(bare / noise, noise_floor) ** 4, 65_535.0)
    assert got.cost.dtype == np.uint16
    assert (np.abs(got.cost - cost) <= 0.5 + 0.01 * cost).all()
    lengths = np.array(got.axis_cost[::-1]) / min(got.axis_cost)
    np.testing.assert_allclose(lengths, np.array(spacing_mm) / min(spacing_mm), rtol=0.07)


def test_without_shape_it_is_the_gradient():
    values = np.random.default_rng(0).normal(size=(6, 7, 8)).astype(np.float32)
    got = landscape(values, (1.0, 2.0, 3.0), gradient_sigma_mm=1.0, shape_sigma_mm=0.0)
    np.testing.assert_array_equal(got.height, gradient_magnitude(values, (1.0, 2.0, 3.0), sigma_mm=1.0))
    assert got.axis_cost == (3, 2, 1)


def test_the_shape_adds_no_more_than_the_gradient_of_what_is_flat_and_padding_does_not_count():
    values = np.zeros((20, 30, 30), np.float32)
    values[:, 10:, 10:] = np.random.default_rng(1).normal(200.0, 5.0, (20, 20, 20))
    steep = gradient_magnitude(values, (1.0, 1.0, 1.0))
    got = landscape(values, (1.0, 1.0, 1.0), gradient_sigma_mm=0.0, shape_sigma_mm=3.0)
    added = got.height - steep
    assert added.min() >= 0.0
    flat = np.quantile(steep[steep > 0.0], 0.1)
    assert added.max() <= 1.2 * flat * (1.0 + 1e-5)
    assert added.max() > 1.0 * flat


def test_lung_and_bone_of_a_steep_texture_do_not_raise_the_shape_in_blood():
    """In a real chest most voxels are steeper than blood."""
    generator = np.random.default_rng(3)
    quiet = generator.normal(300.0, 5.0, (30, 40, 60)).astype(np.float32)
    chest = quiet.copy()
    chest[:, :, 24:] = generator.normal(-700.0, 80.0, (30, 40, 36))

    def added(values):
        got = landscape(values, (1.0, 1.0, 1.0), gradient_sigma_mm=0.0, shape_sigma_mm=3.0)
        return float((got.height - gradient_magnitude(values, (1.0, 1.0, 1.0))).max())

    of_blood = 5.0 * np.sqrt(3.0 / 2.0)  # root mean square of central differences along three axes
    assert added(chest) < 1.2 * of_blood
    assert added(quiet) < 1.2 * of_blood


@pytest.mark.parametrize("noise_floor", [0.0, 3.5])
def test_what_is_flat_has_no_height(noise_floor):
    given = {"gradient_sigma_mm": 0.0, "shape_sigma_mm": 3.0, "noise_floor": noise_floor}
    assert not landscape(np.full((4, 5, 6), 7.0), (1.0, 1.0, 1.0), **given).height.any()


def test_over_a_floor_labels_meet_half_way_in_smooth_blood():
    """A tube with noise and no border, marked near both ends; without a floor the border is wherever noise is."""
    z, y, _ = np.indices((24, 24, 80))
    tube = ndimage.gaussian_filter(np.where((z - 12) ** 2 + (y - 12) ** 2 < 64, 300.0, 100.0), 0.6)
    markers = np.full(tube.shape, UNMARKED, np.uint8)
    markers[0], markers[11:14, 11:14, 10:13], markers[11:14, 11:14, 67:70] = 0, 1, 2

    def borders(noise_floor, *, has_costs):
        """Where label 1 ends along the axis of the tube, mean of some lines, for each noise."""
        for seed in range(8):
            values = (tube + np.random.default_rng(seed).normal(0.0, 4.0, tube.shape)).astype(np.float32)
            given = {"gradient_sigma_mm": 0.0, "shape_sigma_mm": 2.0, "noise_floor": noise_floor}
            found = landscape(values, (1.0, 1.0, 1.0), **given)
            costs = (found.cost, found.axis_cost) if has_costs else ()
            labels = solve_forest(build_basin_tree(found.height, *costs), markers).labels
            yield np.count_nonzero(labels[10:15, 10:15] == 1, axis=-1).mean()

    middle = 39.5
    off, off_without = (np.abs(np.array(list(borders(floor, has_costs=False))) - middle) for floor in (6.0, 0.0))
    assert off.max() < 3.0
    assert off_without.max() > 10.0
    # costs follow the noise, too: of 28 voxels to either marker
    off_with_costs = np.abs(np.array(list(borders(6.0, has_costs=True))) - middle)
    assert off_with_costs.mean() < 4.0
    assert off_with_costs.max() < 10.0


def test_a_weak_border_below_the_floor_is_where_labels_meet():
    """A step of intensity that is far nearer to one of two markers, as that of a vena cava with its atrium in MR."""
    values = np.random.default_rng(0).normal(0.0, 4.0, (16, 16, 60)).astype(np.float32)
    values[..., 40:] += 5.0
    # a border as steep as those of a heart with lung
    values[:, :3] += 800.0
    markers = np.full(values.shape, UNMARKED, np.uint8)
    markers[8, 8, 4], markers[8, 8, 52] = 1, 2
    found = landscape(values, (1.0, 1.0, 1.0), gradient_sigma_mm=1.0, shape_sigma_mm=0.0, noise_floor=20.0)
    # the weak border, too
    assert (found.height[:, 6:] == found.height.min()).mean() > 0.999
    tree = build_basin_tree(found.height, found.cost, found.axis_cost)
    labels = solve_forest(tree, markers).labels
    ends = np.count_nonzero(labels == 1, axis=-1)
    assert abs(np.median(ends) - 40.0) <= 1.0
    half_way = solve_forest(build_basin_tree(found.height), markers).labels
    assert np.median(np.count_nonzero(half_way == 1, axis=-1)) < 30.0


def test_a_ct_gets_a_lower_floor_than_others_where_the_settings_leave_it_out():
    for modality, shape_sigma_mm, noise_floor in (("CT", 3.0, 4.0), ("MR", 3.0, 6.0), ("unknown", 3.0, 6.0)):
        found = resolve_segment(SegmentSettings(), modality)
        assert (found.shape_sigma_mm, found.noise_floor) == (shape_sigma_mm, noise_floor)
        assert resolve_segment(found, "CT") is found
        given = SegmentSettings(shape_sigma_mm=0.0, noise_floor=1.5)
        assert resolve_segment(given, modality).model_dump() == given.model_dump()
        half = resolve_segment(SegmentSettings(shape_sigma_mm=0.0), modality)
        assert (half.shape_sigma_mm, half.noise_floor) == (0.0, noise_floor)


def test_two_chambers_part_at_the_door_between_them():
    """Balls of blood of 14 mm radius that are open to each other through a round door of 8 mm radius, in noise."""
    z, y, x = np.indices((40, 40, 64)).astype(np.float64)
    first = (z - 20) ** 2 + (y - 20) ** 2 + (x - 20) ** 2 < 14.0**2
    second = (z - 20) ** 2 + (y - 20) ** 2 + (x - 43) ** 2 < 14.0**2
    blood = first | second
    scan = ndimage.gaussian_filter(np.where(blood, 300.0, 100.0), 0.6)
    markers = np.full(scan.shape, UNMARKED, np.uint8)
    markers[0], markers[18:22, 15:18, 14:17], markers[18:22, 22:25, 46:49] = 0, 1, 2

    def wrong_share(seed, shape_sigma_mm):
        values = (scan + np.random.default_rng(seed).normal(0.0, 8.0, scan.shape)).astype(np.float32)
        heights = landscape(values, (1.0, 1.0, 1.0), gradient_sigma_mm=0.0, shape_sigma_mm=shape_sigma_mm)
        labels = solve_forest(build_basin_tree(heights.height), markers).labels
        return np.count_nonzero(blood & (labels != np.where(x < 31.5, 1, 2))) / np.count_nonzero(blood)

    with_shape, without = (np.mean([wrong_share(seed, sigma) for seed in range(10)]) for sigma in (3.0, 0.0))
    assert with_shape < 0.5 * without
