"""Distance fields against spheres, cylinders and ellipsoids, whose distance is known."""

import numpy as np
import pytest
from scipy.ndimage import map_coordinates, zoom
from scipy.spatial import cKDTree
from skimage import measure

from heartcase.pipeline.fields.compartments import bridging_voxels
from heartcase.pipeline.fields.distance import default_smoothing_mm, label_distances, signed_distance
from tests.pipeline.lattices import directions, lattice, points_of
from tests.thoroughly import thoroughly

AXIS = np.array([0.36, -0.48, 0.8])


def sphere(points, radius=10.0):
    return np.linalg.norm(points, axis=-1) - radius


def cylinder(points, radius=8.0):
    return np.linalg.norm(points - (points @ AXIS)[..., None] * AXIS, axis=-1) - radius


def ellipsoid(points, radii=(13.0, 10.0, 9.0)):
    """Distance to the nearest of a million points of the surface: 0.03 mm apart, so right to 1e-4 mm off it."""
    unit = directions(1_000_000, seed=3)
    distance, _ = cKDTree(unit * np.array(radii)).query(points.reshape(-1, 3))
    inside = np.linalg.norm(points / np.array(radii), axis=-1) < 1.0
    return np.where(inside, -distance.reshape(inside.shape), distance.reshape(inside.shape))


@pytest.mark.parametrize("kind", ["even", "flat", "oblique", "left-handed"])
@pytest.mark.parametrize("shape", [sphere, cylinder])
def test_redistancing_is_exact_to_a_twentieth_voxel(kind, shape):
    geometry = lattice(kind, 36.0)
    exact = shape(points_of(geometry))
    distorted = 3.0 * np.tanh(exact / 3.0) * (1.0 + 0.1 * np.sin(points_of(geometry)[..., 0] / 7.0))
    found = signed_distance(distorted.astype(np.float32), geometry.spacing_mm, band_mm=5.0)
    near = np.abs(exact) < 4.9
    # The lattice's edge hides the closest point of the nodes beside it.
    near[[0, -1]] = near[:, [0, -1]] = near[:, :, [0, -1]] = False
    if shape is cylinder:
        near &= np.abs(points_of(geometry) @ AXIS) < 10.0
    assert np.isfinite(found[near]).all()
    error = np.abs(found - exact)[near] / max(geometry.spacing_mm)
    assert error.mean() < 0.02
    assert np.percentile(error, 99) < 0.05


def test_redistancing_an_ellipsoid():
    geometry = lattice("even", 40.0)
    points = points_of(geometry)
    level = np.linalg.norm(points / np.array([13.0, 10.0, 9.0]), axis=-1) - 1.0
    found = signed_distance((9.0 * level).clip(-4, 4).astype(np.float32), geometry.spacing_mm, band_mm=4.0)
    near = np.isfinite(found) & (np.abs(found) < 4.0)
    error = np.abs(found[near] - ellipsoid(points[near])) / 1.75
    assert error.mean() < 0.02
    assert np.percentile(error, 99) < 0.05


@pytest.mark.parametrize("kind", ["even", "flat", "oblique", "left-handed"])
def test_a_sphere_of_voxels_gets_its_true_surface_back(kind):
    geometry = lattice(kind, 40.0)
    labels = (sphere(points_of(geometry)) < 0.0).astype(np.uint8)
    spacing = geometry.spacing_mm
    fields = label_distances(labels, spacing, smoothing_mm=default_smoothing_mm(spacing), band_mm=6.0)
    surface = 10.0 * directions(4000)
    index = geometry.world_to_index(surface)[:, ::-1].T
    offset = map_coordinates(fields[1], index, order=1)
    # A voxel's label says no more than half a voxel: the mask's own error has a standard deviation of 0.29 voxel.
    assert abs(offset.mean()) < 0.05 * max(spacing)
    assert offset.std() < 0.15 * max(spacing)
    assert np.array_equal(fields[0], -fields[1]) or np.abs(fields[0] + fields[1])[np.abs(fields[1]) < 4.0].max() < 0.02


@pytest.mark.parametrize("radius", [3.0, 5.0, 9.0])
def test_small_vessels_keep_their_volume(radius):
    geometry = lattice("even", 40.0)
    exact = cylinder(points_of(geometry), radius)
    fields = label_distances((exact < 0.0).astype(np.uint8), geometry.spacing_mm, smoothing_mm=1.4, band_mm=6.0)
    index = points_of(geometry.refined(3))
    fine = map_coordinates(fields[1], np.moveaxis(geometry.world_to_index(index)[..., ::-1], -1, 0), order=1)
    middle = np.linalg.norm(index, axis=-1) < 14.0
    ratio = np.count_nonzero(fine[middle] < 0.0) / np.count_nonzero(cylinder(index[middle], radius) < 0.0)
    assert ratio == pytest.approx(1.0, abs=0.04)


def three_regions(geometry):
    """Two halves of a ball side by side, and the rest."""
    points = points_of(geometry)
    ball = np.linalg.norm(points, axis=-1) < 12.0
    return np.where(ball, np.where(points @ AXIS < 0.0, 1, 2), 0).astype(np.uint8)


def test_fields_divide_space():
    geometry = lattice("oblique", 40.0)
    fields = label_distances(three_regions(geometry), geometry.spacing_mm, smoothing_mm=1.4, band_mm=8.0)
    stack = np.sort(np.stack([fields[value] for value in (0, 1, 2)]), axis=0)
    assert stack[0].max() < 0.05 * 1.4
    assert stack[1].min() > -0.05 * 1.4
    points = points_of(geometry)
    on_face = (np.linalg.norm(points, axis=-1) < 7.0) & (np.abs(points @ AXIS) < 2.0)
    assert np.abs(fields[1] + fields[2])[on_face].max() < 0.05 * 1.4
    assert np.abs(fields[1] - points @ AXIS)[on_face].mean() < 0.2


def test_faces_go_straight_on_at_the_border():
    geometry = lattice("even", 24.0)
    exact = cylinder(points_of(geometry), 6.0)
    fields = label_distances((exact < 0.0).astype(np.uint8), geometry.spacing_mm, smoothing_mm=1.4, band_mm=5.0)
    border = np.ones(exact.shape, np.bool_)
    border[1:-1, 1:-1, 1:-1] = False
    near = border & (np.abs(exact) < 2.0)
    assert near.sum() > 100
    assert np.abs(fields[1] - exact)[near].mean() < 0.35


def test_beyond_the_band_the_field_goes_on():
    geometry = lattice("even", 60.0)
    exact = sphere(points_of(geometry))
    fields = label_distances((exact < 0.0).astype(np.uint8), geometry.spacing_mm, smoothing_mm=1.4, band_mm=3.0)
    beyond = exact > 4.5
    assert (fields[1][beyond] >= 3.0).all()
    assert np.abs(fields[1] - exact)[beyond].max() < 1.75


def test_a_septum_of_one_voxel_keeps_two_cavities_apart():
    labels = np.zeros((16, 16, 17), np.uint8)
    labels[3:13, 3:13, 3:8] = 1
    labels[3:13, 3:13, 8] = 3
    labels[3:13, 3:13, 9:14] = 2
    fields = label_distances(labels, (1.0, 1.0, 1.0), smoothing_mm=0.8, band_mm=4.0, blood_values=(1, 2))
    owner = np.argmin(np.stack([fields[value] for value in (0, 1, 2, 3)]), axis=0)
    assert (owner[5:11, 5:11, 8] == 3).all()
    assert not (owner[:, :, :8] == 2).any()


@pytest.mark.parametrize("value", [1, 2])
def test_a_gap_of_background_that_the_blur_would_close_stays(value):
    labels = np.zeros((14, 14, 15), np.uint8)
    labels[2:12, 2:12, 2:7] = 1
    labels[2:12, 2:12, 8:13] = value
    for smoothing in (0.8, 1.5, 2.5):
        fields = label_distances(labels, (1.0, 1.0, 1.0), smoothing_mm=smoothing, band_mm=4.0, blood_values=(1, 2))
        blood = np.minimum(fields[1], fields[value])
        assert (blood[:, :, 7] > 0.0).all()


def test_voxels_go_back_where_compartments_would_join_or_split():
    before = np.zeros((5, 5, 9), np.uint8)
    before[1:4, 1:4, 1:4] = 1
    before[1:4, 1:4, 5:8] = 2
    after = before.copy()
    after[2, 2, 4] = 1
    joined = bridging_voxels(before, after, (1, 2))
    assert np.argwhere(joined).tolist() == [[2, 2, 4]]
    canal = after.copy()
    split = bridging_voxels(canal, before, (1, 2))
    assert np.argwhere(split).tolist() == [[2, 2, 4]]
    after = before.copy()
    after[0, 2, 2] = 1
    assert not bridging_voxels(before, after, (1, 2)).any()


def test_without_smoothing_faces_lie_halfway_between_voxels():
    labels = np.zeros((8, 8, 8), np.uint8)
    labels[:, :, 4:] = 1
    fields = label_distances(labels, (2.0, 1.0, 1.0), smoothing_mm=0.0, band_mm=3.0)
    assert np.allclose(fields[0][4, 4], [-7.0, -5.0, -3.0, -1.0, 1.0, 3.0, 5.0, 7.0], atol=1.0)
    assert np.allclose(fields[0][4, 4, 2:6], [-3.0, -1.0, 1.0, 3.0], atol=1e-5)


def test_one_label_alone_is_deep_everywhere():
    fields = label_distances(np.full((3, 4, 5), 7, np.uint8), (1.0, 1.0, 1.0), smoothing_mm=0.8, band_mm=3.0)
    assert list(fields) == [7]
    assert (fields[7] < -3.0).all()


def test_same_labels_same_bytes():
    labels = three_regions(lattice("flat", 40.0))
    first, second = (label_distances(labels, (1.0, 1.0, 3.0), smoothing_mm=1.3, band_mm=6.0) for _ in range(2))
    assert all(first[value].tobytes() == second[value].tobytes() for value in first)


@pytest.mark.parametrize("spacing", [(1.0, 1.0, 1.0), (0.7, 1.1, 2.0)])
@pytest.mark.parametrize("seed", thoroughly(range(4)))
def test_redistancing_of_random_levels_is_that_of_a_fine_mesh(seed, spacing):
    rng = np.random.default_rng(seed)
    size = np.array([26, 30, 34])
    h = np.array(spacing[::-1])
    place = np.stack(
        np.meshgrid(*[np.arange(n) * step for n, step in zip(size, h, strict=True)], indexing="ij"), axis=-1
    )
    middle = rng.uniform(0.3, 0.7, (4, 3)) * size * h
    radius = rng.uniform(4.0, 7.0, 4)
    away = np.linalg.norm(place[..., None, :] - middle, axis=-1) - radius
    field = -2.0 * np.log(np.exp(-away / 2.0).sum(axis=-1))  # a smooth union of balls
    found = signed_distance(field.astype(np.float32), spacing, band_mm=6.0)
    fine = zoom(field, 4, order=3, grid_mode=False)
    scale = (np.array(field.shape) - 1.0) / (np.array(fine.shape) - 1.0) * h
    vertices = measure.marching_cubes(fine, 0.0)[0] * scale
    true, _ = cKDTree(vertices).query(place.reshape(-1, 3))
    true = true.reshape(field.shape)
    inner = np.zeros(field.shape, np.bool_)
    inner[2:-2, 2:-2, 2:-2] = True
    near = inner & np.isfinite(found) & (true < 5.5)
    assert np.isfinite(found[inner & (true < 5.5)]).all()
    error = np.abs(np.abs(found) - true)[near] / max(spacing)
    assert error.mean() < 0.02
    assert np.percentile(error, 99) < 0.08
    assert (np.sign(found[near]) == np.sign(field[near])).all()


def test_voxels_that_are_kept_hold_a_vessel_that_the_blur_takes_away():
    labels = np.zeros((24, 30, 30), np.uint8)
    labels[4:20, 15, 15] = 1
    how = {"smoothing_mm": 0.8, "band_mm": 4.0}
    assert list(label_distances(labels, (1.0, 1.0, 1.0), **how)) == [0]
    fields = label_distances(labels, (1.0, 1.0, 1.0), kept=labels == 1, **how)
    # the field between them is interpolated: it stays within the vessel
    assert (fields[1][labels == 1] < 0.0).all()
    assert not (fields[1][labels == 0] < 0.0).any()
    plain = label_distances(labels, (1.0, 1.0, 1.0), kept=np.zeros(labels.shape, np.bool_), **how)
    assert list(plain) == [0]
