import os
import re
import subprocess
import sys

import numpy as np
import pytest
import SimpleITK
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from heartcase.phantom.anatomy.heart import HeartPhantom
from heartcase.phantom.scan.acquisition import CT_UNITS, MRI_UNITS, noise_free
from heartcase.pipeline.data import Scan
from heartcase.pipeline.image.diffusion import diffuse
from heartcase.pipeline.image.filter_scan import default_conductance, filter_scan, resolve_filter, time_step_limit
from heartcase.schemas.errors import StageError
from heartcase.schemas.geometry import Geometry
from heartcase.schemas.recipe.settings import FilterSettings
from tests.thoroughly import thoroughly

EPSILON = float(np.finfo(np.float32).eps)
ANISOTROPIC = (0.7, 1.1, 2.5)
METHODS = ("curvature_diffusion", "gradient_diffusion")


def make_scan(values, spacing=(1.0, 1.0, 1.0), **more):
    return Scan(
        values=np.asarray(values, np.float32), geometry=Geometry.of(shape=np.shape(values), spacing_mm=spacing), **more
    )


def step_with_noise(shape=(9, 11, 14), seed=3):
    noise = np.random.default_rng(seed).normal(0.0, 30.0, shape)
    noise[:, :, shape[2] // 2 :] += 400.0
    return noise.astype(np.float32)


def reference_diffusion(values, spacing, iterations, conductance, time_step):
    """Fluxes through all faces of a volume whose outermost voxels are repeated, in float64, a face at a time."""
    u = np.asarray(values, float)
    axes = [(axis, spacing[2 - axis]) for axis in range(3)]
    inner = (slice(1, -1),) * 3
    for _ in range(iterations):
        p = np.pad(u, 1, mode="edge")
        central = {axis: (np.roll(p, -1, axis) - np.roll(p, 1, axis)) / (2 * h) for axis, h in axes}
        mean_square = np.mean(sum(g[inner] ** 2 for g in central.values()))
        change = np.zeros_like(p)
        for axis, h in axes:
            along = (np.roll(p, -1, axis) - p) / h
            square = along**2
            for other, g in central.items():
                if other != axis:
                    square += (0.5 * (g + np.roll(g, -1, axis))) ** 2
            flux = along * np.exp(-square / (2.0 * mean_square * conductance**2))
            change += (flux - np.roll(flux, 1, axis)) / h
        u = u + time_step * change[inner]
    return u


def reference_curvature_diffusion(values, spacing, iterations, conductance, time_step):
    """The level sets' motion, voxel faces and upwind slopes of whole padded volumes in float64."""
    u = np.asarray(values, float)
    axes = [(axis, spacing[2 - axis]) for axis in range(3)]
    inner = (slice(1, -1),) * 3
    for _ in range(iterations):
        p = np.pad(u, 1, mode="edge")
        central = {axis: (np.roll(p, -1, axis) - np.roll(p, 1, axis)) / (2 * h) for axis, h in axes}
        mean_square = np.mean(sum(g[inner] ** 2 for g in central.values()))
        divergence, rising, falling = np.zeros_like(p), np.zeros_like(p), np.zeros_like(p)
        for axis, h in axes:
            along = (np.roll(p, -1, axis) - p) / h
            square = along**2
            for other, g in central.items():
                if other != axis:
                    square += (0.5 * (g + np.roll(g, -1, axis))) ** 2
            normal = along / np.sqrt(square + 1e-60) * np.exp(-square / (2.0 * mean_square * conductance**2))
            divergence += (normal - np.roll(normal, 1, axis)) / h
            along = along * np.exp(-(along**2) / (2.0 * mean_square * conductance**2))
            before = np.roll(along, 1, axis)
            rising += np.maximum(along, 0) ** 2 + np.minimum(before, 0) ** 2
            falling += np.minimum(along, 0) ** 2 + np.maximum(before, 0) ** 2
        slope = np.sqrt(np.where(divergence > 0, rising, falling))
        u = u + time_step * (divergence * slope)[inner]
    return u


@pytest.mark.parametrize("spacing", [1.0, 0.9, 1.75])
def test_curvature_equals_simpleitk_on_cubic_voxels_where_nothing_is_too_steep(spacing):
    values = step_with_noise()
    image = SimpleITK.GetImageFromArray(values)
    image.SetSpacing((spacing,) * 3)
    step = 0.05
    want = SimpleITK.GetArrayFromImage(
        SimpleITK.CurvatureAnisotropicDiffusion(image, timeStep=step, conductanceParameter=1e4, numberOfIterations=5)
    )
    got = diffuse(values, (spacing,) * 3, iterations=5, conductance=1e4, time_step=step * spacing, by_curvature=True)
    # a normal in a place without slope turns with the last bit, but moves nothing then
    assert np.abs(got - want).max() <= 5 * 64 * EPSILON * np.abs(values).max()
    assert np.abs(got - values).max() > 1.0


@pytest.mark.parametrize("spacing", [(1.0, 1.0, 1.0), ANISOTROPIC, (3.0, 0.5, 0.5)])
@pytest.mark.parametrize(
    "shape", [(7, 8, 9), (1, 12, 13), (6, 1, 9), (2, 3, 1), (17, 45, 130), (9, 3, 2500), (1, 1, 40), (40, 1, 1)]
)
def test_curvature_equals_the_double_precision_reference(spacing, shape):
    values = step_with_noise(shape)
    step = time_step_limit(make_scan(values, spacing).geometry, "curvature_diffusion")
    want = reference_curvature_diffusion(values, spacing, 4, 0.8, step)
    got = diffuse(values, spacing, iterations=4, conductance=0.8, time_step=step, by_curvature=True)
    assert np.abs(got - want).max() <= 4 * 256 * EPSILON * np.abs(values).max()


def test_a_ball_shrinks_as_fast_as_its_curvature():
    """Level sets of a distance move by their curvature: the square of a sphere's radius falls by 4 t."""
    spacing, radius, step, steps = 0.5, 6.0, 0.017, 118
    z, y, x = (np.indices((49, 49, 49)) - 24) * spacing
    distance = np.sqrt(x**2 + y**2 + z**2).astype(np.float32)
    assert step <= time_step_limit(make_scan(distance, (spacing,) * 3).geometry, "curvature_diffusion")
    got = diffuse(distance, (spacing,) * 3, iterations=steps, conductance=1e3, time_step=step, by_curvature=True)
    n = np.arange(24)
    for line, length in (
        (got[24, 24, 24 + n], 1.0),
        (got[24, 24 + n, 24 + n], 2**0.5),
        (got[24 + n, 24 + n, 24 + n], 3**0.5),
    ):
        found = np.interp(radius, line, length * spacing * n)
        assert radius**2 - found**2 == pytest.approx(4.0 * steps * step, rel=0.06)


def test_curvature_hardly_softens_a_plane_border():
    border = np.zeros((20, 20, 20), np.float32)
    border[:, :, 8] = 30.0
    border[:, :, 9:] = 100.0
    chosen = {"iterations": 20, "conductance": 1e3, "time_step": 0.06}
    by_curvature = np.abs(diffuse(border, (1.0,) * 3, by_curvature=True, **chosen) - border).max()
    by_gradient = np.abs(diffuse(border, (1.0,) * 3, **chosen) - border).max()
    assert by_curvature < 5.0
    assert by_gradient > 15.0


@pytest.mark.parametrize("method", METHODS)
def test_a_wall_of_one_voxel_between_two_cavities_stays_above_the_noise(method):
    noisy = np.random.default_rng(4).normal(350.0, 30.0, (24, 24, 24))
    noisy[:, :, 12] -= 240.0
    got = filter_scan(make_scan(noisy), FilterSettings(method=method)).values
    wall, cavities = got[2:-2, 2:-2, 12], np.delete(got, (11, 12, 13), axis=2)[2:-2, 2:-2]
    assert cavities.mean() - wall.mean() > 0.8 * 240.0
    assert wall.max() < cavities.min()


def test_a_voxel_that_stands_out_comes_down_to_its_neighbours_at_once_and_not_beyond():
    for spacing in ((1.0, 1.0, 1.0), ANISOTROPIC):
        values = np.zeros((7, 7, 7), np.float32)
        values[3, 3, 3] = 80.0
        limit = time_step_limit(make_scan(values, spacing).geometry, "curvature_diffusion")
        for part in (1.0, 0.5):
            got = diffuse(values, spacing, iterations=1, conductance=1e4, time_step=part * limit, by_curvature=True)
            assert got[3, 3, 3] == pytest.approx(80.0 * (1.0 - part), abs=1e-3)


@pytest.mark.parametrize("spacing", [1.0, 0.9, 1.75])
@pytest.mark.parametrize("conductance", [0.5, 1.0, 3.0])
def test_equals_simpleitk_on_cubic_voxels(spacing, conductance):
    values = step_with_noise()
    image = SimpleITK.GetImageFromArray(values)
    image.SetSpacing((spacing,) * 3)
    # SimpleITK divides by the spacing once where the divergence in mm divides twice: hence the other unit of its step
    step = 0.05
    want = SimpleITK.GetArrayFromImage(
        SimpleITK.GradientAnisotropicDiffusion(
            image, timeStep=step, conductanceParameter=conductance, numberOfIterations=5
        )
    )
    got = diffuse(values, (spacing,) * 3, iterations=5, conductance=conductance, time_step=step * spacing)
    # each of the five steps of both rounds a few numbers of the size of the values
    assert np.abs(got - want).max() <= 5 * 8 * EPSILON * np.abs(values).max()
    assert np.abs(got - values).max() > 1.0


@pytest.mark.parametrize("spacing", [(1.0, 1.0, 1.0), ANISOTROPIC, (3.0, 0.5, 0.5)])
@pytest.mark.parametrize(
    "shape", [(7, 8, 9), (1, 12, 13), (6, 1, 9), (2, 3, 1), (17, 45, 130), (9, 3, 2500), (1, 1, 40), (40, 1, 1)]
)
def test_equals_the_double_precision_reference(spacing, shape):
    values = step_with_noise(shape)
    scan = make_scan(values, spacing)
    step = time_step_limit(scan.geometry, "gradient_diffusion")
    want = reference_diffusion(values, spacing, 4, 0.8, step)
    got = diffuse(values, spacing, iterations=4, conductance=0.8, time_step=step)
    assert np.abs(got - want).max() <= 4 * 16 * EPSILON * np.abs(values).max()


@pytest.mark.parametrize("mode", [(1, 0, 0), (0, 2, 1), (3, 1, 4), (6, 7, 8)])
def test_cosines_decay_as_the_heat_equation_says_where_the_conductance_is_one(mode):
    shape = (7, 8, 9)
    scan = make_scan(np.zeros(shape), ANISOTROPIC)
    step = time_step_limit(scan.geometry, "gradient_diffusion")
    wave = np.ones(shape)
    rate = 0.0
    for axis, (m, n) in enumerate(zip(mode, shape, strict=True)):
        line = np.cos(np.pi * m * (np.arange(n) + 0.5) / n)
        wave = wave * line.reshape([-1 if a == axis else 1 for a in range(3)])
        rate += (2.0 / ANISOTROPIC[2 - axis] * np.sin(np.pi * m / (2 * n))) ** 2
    got = diffuse(wave.astype(np.float32), ANISOTROPIC, iterations=3, conductance=1e4, time_step=step)
    factor = (1.0 - step * rate) ** 3
    assert 0.0 <= factor < 1.0
    # a conductance of 1e4 leaves exp(-square / 2e8) below one by less than 1e-6 here
    assert np.abs(got - factor * wave).max() <= 3 * (16 * EPSILON + 1e-6)


@settings(max_examples=60, deadline=None)
@given(
    values=hnp.arrays(
        np.float32, hnp.array_shapes(min_dims=3, max_dims=3, max_side=6), elements=st.integers(-3000, 3000)
    ),
    spacing=st.tuples(*[st.floats(0.2, 5.0)] * 3),
    conductance=st.sampled_from([0.01, 0.3, 1.0, 100.0]),
    method=st.sampled_from(METHODS),
)
def test_at_the_limit_nothing_leaves_the_range_and_flow_loses_nothing(values, spacing, conductance, method):
    chosen = FilterSettings(method=method, iterations=20, conductance=conductance)
    got = filter_scan(make_scan(values, spacing), chosen).values
    slack = 20 * 4 * EPSILON * float(np.abs(values).max())
    assert got.min() >= values.min() - slack
    assert got.max() <= values.max() + slack
    if method == "gradient_diffusion":
        assert abs(got.mean(dtype=float) - values.mean(dtype=float)) <= slack


def test_past_the_limit_the_finest_frequency_turns_its_sign():
    shape = (6, 6, 6)
    board = np.where(np.indices(shape).sum(axis=0) % 2, 1.0, -1.0).astype(np.float32)
    limit = time_step_limit(make_scan(board, ANISOTROPIC).geometry, "gradient_diffusion")
    inside = (slice(1, -1),) * 3
    at = diffuse(board, ANISOTROPIC, iterations=1, conductance=1e4, time_step=limit)
    past = diffuse(board, ANISOTROPIC, iterations=1, conductance=1e4, time_step=1.1 * limit)
    assert np.abs(at[inside]).max() < 1e-5
    assert np.all(past[inside] * board[inside] < 0.0)


@pytest.mark.parametrize(("method", "conductance"), [("gradient_diffusion", 0.8), ("curvature_diffusion", 2.0)])
def test_an_edge_stays_and_noise_goes(method, conductance):
    values = step_with_noise((16, 16, 16))
    chosen = FilterSettings(method=method, conductance=conductance, iterations=10)
    got = filter_scan(make_scan(values), chosen).values
    left, right = got[:, :, :8], got[:, :, 8:]
    assert right.mean() - left.mean() == pytest.approx(values[:, :, 8:].mean() - values[:, :, :8].mean(), rel=0.02)
    assert left.std() < 0.35 * values[:, :, :8].std()
    assert right.std() < 0.35 * values[:, :, 8:].std()


@pytest.mark.parametrize("level", [0.0, -1024.0, 1e6])
def test_a_constant_stays_as_it_is(level):
    values = np.full((4, 5, 6), level, np.float32)
    np.testing.assert_array_equal(filter_scan(make_scan(values, ANISOTROPIC), FilterSettings()).values, values)


def test_scaling_and_shifting_the_intensities_scales_and_shifts_the_result():
    values = step_with_noise()
    plain = filter_scan(make_scan(values), FilterSettings()).values
    other = filter_scan(make_scan(values * 1024.0), FilterSettings()).values
    np.testing.assert_allclose(other, plain * 1024.0, rtol=0, atol=1024.0 * 5 * 8 * EPSILON * np.abs(values).max())


@settings(max_examples=40, deadline=None)
@given(
    shape=st.tuples(st.integers(1, 20), st.integers(1, 40), st.integers(2, 150)),
    spacing=st.tuples(*[st.floats(0.3, 4.0)] * 3),
    conductance=st.sampled_from([0.2, 1.0, 5.0]),
    seed=st.integers(0, 99),
)
def test_any_shape_equals_the_reference(shape, spacing, conductance, seed):
    values = step_with_noise(shape, seed)
    step = min(time_step_limit(make_scan(values, spacing).geometry, "gradient_diffusion"), 1.0)
    want = reference_diffusion(values, spacing, 2, conductance, step)
    got = diffuse(values, spacing, iterations=2, conductance=conductance, time_step=step)
    assert np.abs(got - want).max() <= 2 * 16 * EPSILON * np.abs(values).max()


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("size", [1e-30, 1e-6, 1e6, 1e30])
@pytest.mark.parametrize("conductance", [1e-12, 1.0, None])
def test_tiny_and_huge_intensities_give_what_ordinary_ones_do(size, conductance, method):
    values = step_with_noise() / np.float32(1000.0)
    chosen = FilterSettings(method=method, conductance=conductance)
    plain = filter_scan(make_scan(values), chosen).values
    got = filter_scan(make_scan(values * np.float32(size)), chosen).values
    np.testing.assert_allclose(got / np.float32(size), plain, rtol=0, atol=5 * 16 * EPSILON * np.abs(values).max())


THREADS = """
import hashlib, sys
import numpy as np
from heartcase.pipeline.data import Scan
from heartcase.pipeline.image.filter_scan import filter_scan, resolve_filter
from heartcase.schemas.geometry import Geometry
from heartcase.schemas.recipe.settings import FilterSettings
values = np.random.default_rng(1).normal(0.0, 9.0, (21, 37, 93)).astype(np.float32)
scan = Scan(values=values, geometry=Geometry.of(shape=values.shape, spacing_mm=(0.7, 1.1, 2.5)))
print(resolve_filter(FilterSettings(), scan).model_dump_json())
print(hashlib.sha256(filter_scan(scan, FilterSettings()).values.tobytes()).hexdigest())
"""


def test_the_number_of_threads_does_not_matter():
    said = {
        subprocess.run(
            [sys.executable, "-c", THREADS],
            env=os.environ | {"NUMBA_NUM_THREADS": str(count)},
            capture_output=True,
            text=True,
            check=True,
        ).stdout
        for count in (1, 2)
    }
    assert len(said) == 1


def blocks_of_tissue(seed, sigma, shape=(24, 40, 44)):
    """Three tissues and noise."""
    values = np.zeros(shape)
    values[4:20, 5:30, 6:36] = 300.0
    values[8:16, 10:24, 10:28] = 500.0
    return values, (values + np.random.default_rng(seed).normal(0.0, sigma, shape)).astype(np.float32)


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("spacing", [(1.0, 1.0, 1.0), (0.8, 0.8, 2.0)])
@pytest.mark.parametrize("sigma", [5.0, 20.0, 60.0])
def test_the_default_conductance_removes_noise_at_any_level(sigma, spacing, method):
    clean, noisy = blocks_of_tissue(2, sigma)
    got = filter_scan(make_scan(noisy, spacing), FilterSettings(method=method)).values

    def error(values):
        return float(np.sqrt(np.mean((values - clean) ** 2)))

    assert error(got) < 0.6 * error(noisy)


@pytest.fixture(scope="module")
def chest():
    """Geometry and noise-free MRI and CT of the child's heart at 2 mm, without partial volume."""
    phantom = HeartPhantom.of_size("child")
    geometry = phantom.scan_geometry(2.0)
    signals = {units: noise_free(phantom, geometry, units, supersampling=1) for units in (MRI_UNITS, CT_UNITS)}
    return geometry, signals


@pytest.mark.parametrize("contrast_to_noise", thoroughly([5.0, 10.0, 20.0], 1))
@pytest.mark.parametrize("units", [MRI_UNITS, CT_UNITS], ids=["mri", "ct"])
def test_the_default_conductance_suits_every_level_of_noise_in_a_chest(chest, units, contrast_to_noise):
    """A conductance of 1, the default of before, suits one of them."""
    geometry, clean = chest[0], chest[1][units]
    sigma = (units[1] - units[2]) / contrast_to_noise
    generator = np.random.default_rng(11)
    noisy = clean + generator.normal(0.0, sigma, clean.shape)
    if units is MRI_UNITS:
        noisy = np.hypot(noisy, generator.normal(0.0, sigma, clean.shape))
    scan = Scan(noisy.astype(np.float32), geometry)
    inside = clean > units[4]  # the heart, the liver and soft tissue: no lung, no fat

    def error(conductance):
        got = filter_scan(scan, FilterSettings(conductance=conductance)).values
        return float(np.sqrt(np.mean((got - clean)[inside] ** 2))) / sigma

    assert error(None) < 0.9
    assert error(None) < 1.05 * error(1.0)


@pytest.mark.parametrize(("method", "large"), [("gradient_diffusion", 1.0), ("curvature_diffusion", 10.0)])
def test_a_scan_without_noise_comes_through(method, large):
    clean, _ = blocks_of_tissue(1, 1.0)
    got = filter_scan(make_scan(clean), FilterSettings(method=method)).values
    assert np.abs(got - clean).max() < 1e-6 * 500.0
    smoothed = filter_scan(make_scan(clean), FilterSettings(method=method, conductance=large)).values
    assert np.abs(smoothed - clean).max() > 0.1


def test_clamped_air_does_not_change_the_default_much():
    _, noisy = blocks_of_tissue(3, 20.0)
    whole = np.pad(np.round(noisy), ((0, 0), (0, 60), (0, 0)), constant_values=-1024.0).astype(np.int16)
    padded = np.pad(whole, ((20, 0), (0, 0), (0, 0)), constant_values=-2048).astype(np.float32)

    def threshold(values):
        """K in units of intensity per mm."""
        z, y, x = np.gradient(np.pad(values.astype(float), 1, mode="edge"))
        inner = (slice(1, -1),) * 3
        root_mean_square = np.sqrt(np.mean((z**2 + y**2 + x**2)[inner]))
        return default_conductance(make_scan(values)) * root_mean_square

    assert threshold(padded) == pytest.approx(threshold(noisy), rel=0.15)


def test_a_ct_is_smoothed_by_curvature_and_any_other_scan_by_gradient():
    _, noisy = blocks_of_tissue(1, 30.0)
    for modality, method in (("CT", METHODS[0]), ("MR", METHODS[1]), ("unknown", METHODS[1])):
        scan = make_scan(noisy, modality=modality)
        resolved = resolve_filter(FilterSettings(), scan)
        assert resolved.method == method
        assert resolved.time_step == time_step_limit(scan.geometry, method)
        assert resolved.conductance == default_conductance(scan, method)
        stated = filter_scan(scan, FilterSettings(method=method)).values
        np.testing.assert_array_equal(filter_scan(scan, FilterSettings()).values, stated)
        other = FilterSettings(method=METHODS[modality == "CT"])
        assert np.abs(filter_scan(scan, other).values - stated).max() > 1.0


def test_what_is_left_out_is_filled_in_once():
    _, noisy = blocks_of_tissue(1, 30.0)
    scan = make_scan(noisy, ANISOTROPIC)
    resolved = resolve_filter(FilterSettings(), scan)
    assert resolved.time_step == time_step_limit(scan.geometry)
    assert resolved.conductance == default_conductance(scan)
    assert float(f"{resolved.conductance:.4g}") == resolved.conductance
    assert resolve_filter(resolved, scan) is resolved
    np.testing.assert_array_equal(filter_scan(scan, resolved).values, filter_scan(scan, FilterSettings()).values)
    stated = FilterSettings(method="curvature_diffusion", conductance=0.7, time_step=0.01)
    assert resolve_filter(stated, scan).model_dump() == stated.model_dump()
    off = FilterSettings(method="none")
    assert resolve_filter(off, scan).model_dump() == off.model_dump()


def test_the_default_conductance_of_a_constant_is_a_number():
    scan = make_scan(np.full((3, 4, 5), 7.0))
    assert resolve_filter(FilterSettings(), scan).conductance == 1.0


@pytest.mark.parametrize(("factor", "shift"), [(4.0, 0.0), (1.0, 1024.0), (0.25, -512.0)])
def test_the_default_conductance_does_not_depend_on_the_unit_of_the_intensities(factor, shift):
    _, noisy = blocks_of_tissue(5, 25.0)
    plain = default_conductance(make_scan(np.round(noisy)))
    assert default_conductance(make_scan(np.round(noisy) * factor + shift)) == pytest.approx(plain, rel=2e-3)


def test_only_the_values_change():
    values = step_with_noise()
    scan = make_scan(values.copy(), ANISOTROPIC, modality="CT", acquisition={"tube_voltage_kv": 100})
    got = filter_scan(scan, FilterSettings())
    np.testing.assert_array_equal(scan.values, values)
    assert (got.geometry, got.modality, got.acquisition) == (scan.geometry, scan.modality, scan.acquisition)
    assert got.values.dtype == np.float32
    assert got.values.flags.c_contiguous


def test_no_filter_returns_the_scan():
    scan = make_scan(step_with_noise())
    assert filter_scan(scan, FilterSettings(method="none")) is scan


@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf])
def test_values_that_are_not_finite_are_refused(bad):
    values = step_with_noise()
    values[1, 2, 3] = bad
    with pytest.raises(StageError, match="1 voxels of the scan are NaN or infinite"):
        filter_scan(make_scan(values), FilterSettings(conductance=1.0))
    with pytest.raises(StageError, match="1 voxels of the scan are NaN or infinite"):
        resolve_filter(FilterSettings(), make_scan(values))


@pytest.mark.parametrize(
    ("method", "beyond", "limit"),
    [("gradient_diffusion", 0.0676, 0.9**2 / 12), ("curvature_diffusion", 0.0552, 0.9**2 / (6 * 6**0.5))],
)
def test_a_step_beyond_the_limit_is_refused_and_the_limit_that_is_stated_works(method, beyond, limit):
    scan = make_scan(step_with_noise(), (0.9, 0.9, 0.9))
    with pytest.raises(StageError, match=rf"filter\.time_step: {beyond} is beyond the stability limit") as caught:
        filter_scan(scan, FilterSettings(method=method, time_step=beyond))
    stated = float(re.search(r"([0-9.]+) mm2", str(caught.value))[1])
    assert stated == pytest.approx(limit, rel=1e-3)
    filter_scan(scan, FilterSettings(method=method, time_step=stated))


def test_the_limit_counts_only_axes_with_neighbours():
    cube, plane = (Geometry.of(shape=(n, 4, 4), spacing_mm=(2.0, 2.0, 2.0 if n > 1 else 0.1)) for n in (4, 1))
    assert time_step_limit(cube, "gradient_diffusion") == pytest.approx(4 / 12)
    assert time_step_limit(plane, "gradient_diffusion") == pytest.approx(4 / 8)
    assert time_step_limit(cube, "curvature_diffusion") == pytest.approx(4 / (6 * 6**0.5))
    assert time_step_limit(plane, "curvature_diffusion") == pytest.approx(4 / (4 * 4**0.5))
    scan = make_scan([[[7.0]]])
    assert filter_scan(scan, FilterSettings(time_step=1e6)).values == 7.0
