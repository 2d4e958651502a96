import numpy as np
import pytest
from scipy import ndimage
from scipy.spatial import cKDTree

from heartcase.phantom.anatomy.axes import LONG_AXIS, SEPTUM_AXIS, UPWARD_AXIS
from heartcase.phantom.anatomy.border import STEEPNESS, border_distances
from heartcase.phantom.anatomy.heart import HeartPhantom
from heartcase.phantom.anatomy.truth import TOLERANCE_MM
from heartcase.schemas.errors import UsageError
from heartcase.schemas.labels import default_label_table
from tests.phantom.conftest import lattice_points
from tests.thoroughly import thoroughly

LEFT, RIGHT = (1, 3, 5), (2, 4, 6, 7, 8)


def directions(count):
    """Unit vectors spread evenly over the sphere, shape (count, 3)."""
    height = 1.0 - (2.0 * np.arange(count) + 1.0) / count
    turn = np.pi * (1.0 + np.sqrt(5.0)) * np.arange(count)
    across = np.sqrt(1.0 - height**2)
    return np.stack([across * np.cos(turn), across * np.sin(turn), height], axis=1)


def assert_distance_by_labels(inside, point, distance, generator, cone=None):
    """Labels alone say that a distance is right to 0.01 mm: all one side within it, the other just beyond.

    The search for the other side is itself good to 0.003 mm.
    ``cone`` is a set of directions to look in; all of them where it is None.
    """
    tolerance = 0.01
    spread = directions(1000) if cone is None else cone
    here = inside(point[None])[0]
    radii = np.where(np.arange(len(spread)) % 4 > 0, 1.0, generator.random(len(spread)) ** (1.0 / 3.0))
    within = point + max(distance - tolerance, 0.0) * radii[:, None] * spread
    assert np.all(inside(within) == here), (point, distance)
    # The nearest points of the other side: of those found, look around the best, closer and closer.
    width, beyond = 0.5, distance + 0.5
    looking = spread
    for _ in range(14):
        reach = np.linspace(max(distance - tolerance, 0.0), beyond, 12)
        points = point + reach[:, None, None] * looking
        other = inside(points.reshape(-1, 3)).reshape(points.shape[:2]) != here
        first = np.where(other.any(axis=0), reach[other.argmax(axis=0)], np.inf)
        best = np.argsort(first)[:10]
        beyond = first[best[0]]
        if beyond <= distance + tolerance + 0.003:
            return
        found = point + np.where(np.isfinite(first[best]), first[best], beyond)[:, None] * looking[best]
        around = (found[:, None] + generator.normal(0.0, width, (10, 60, 3))).reshape(-1, 3) - point
        looking = np.concatenate([looking[best], around / np.linalg.norm(around, axis=1)[:, None]])
        width *= 0.65
    raise AssertionError(f"{point}: {distance} mm, but nothing nearer than {beyond} mm")


@pytest.mark.parametrize("label", thoroughly([None, 0, 1, 2, 3, 4, 5, 6, 8, 9, 10, 11, 12, 13], 0, 3, 9))
def test_distance_is_that_to_the_nearest_point_of_the_border(adult, label):
    truth, generator = adult.truth, np.random.default_rng(40 if label is None else label)
    values = truth.table.tissue_values if label is None else (label,)
    border = truth.surface_points(label)
    points = border[generator.integers(len(border), size=30)] + generator.normal(0.0, 1.5, (30, 3))
    found = truth.tissue_distance(points) if label is None else truth.distance(points, label)
    inside = np.isin(truth.label(points), values)
    np.testing.assert_array_equal((found < 0.0)[np.abs(found) > 1e-6], inside[np.abs(found) > 1e-6])
    for point, distance in zip(points, np.abs(found), strict=True):
        assert_distance_by_labels(lambda at: np.isin(truth.label(at), values), point, distance, generator)


@pytest.mark.parametrize("size", ["adult", pytest.param("child", marks=pytest.mark.slow)])
@pytest.mark.parametrize("label", thoroughly([2, 10]))
def test_no_value_is_so_steep_that_the_search_could_miss_the_border(size, label):
    truth, generator = HeartPhantom.of_size(size).truth, np.random.default_rng(label)
    border = truth.surface_points(label)
    points = border[generator.integers(len(border), size=30)] + generator.normal(0.0, 1.0, (30, 3))
    above = cKDTree(border).query(points)[0] + 0.01
    careful = np.empty(len(points))
    border_distances(*truth.kernel_arguments, label, points, above, TOLERANCE_MM, 2.0 * STEEPNESS, careful)
    assert np.all(np.abs(truth.value(points, label)) <= STEEPNESS * careful + TOLERANCE_MM)
    np.testing.assert_allclose(np.abs(truth.distance(points, label)), careful, atol=TOLERANCE_MM)


def test_labels_and_values_agree(adult):
    generator = np.random.default_rng(7)
    truth = adult.truth
    border = truth.surface_points()
    points = border[generator.integers(len(border), size=1500)] + generator.normal(0.0, 2.0, (1500, 3))
    labels = truth.label(points)
    for value in truth.table.values:
        distance = truth.value(points, value)
        clear = np.abs(distance) > 1e-6
        np.testing.assert_array_equal((distance < 0.0)[clear], (labels == value)[clear])
    tissue = truth.value(points)
    clear = np.abs(tissue) > 1e-6
    np.testing.assert_array_equal((tissue < 0.0)[clear], np.isin(labels, truth.table.tissue_values)[clear])


def test_far_distances_are_right_too(adult):
    centre = adult.anatomy.places["left ventricle"]
    far = centre + 400.0 * np.array([LONG_AXIS, -LONG_AXIS, UPWARD_AXIS])
    border, generator = adult.truth.surface_points(), np.random.default_rng(2)
    tissue = adult.truth.table.tissue_values
    for point in far:
        towards = border[np.argmin(np.linalg.norm(border - point, axis=1))] - point
        around = towards + generator.uniform(-8.0, 8.0, (2000, 3))
        cone = around / np.linalg.norm(around, axis=1)[:, None]
        distance = adult.truth.tissue_distance(point)
        assert distance <= np.linalg.norm(towards) + 0.01
        assert_distance_by_labels(lambda at: np.isin(adult.truth.label(at), tissue), point, distance, generator, cone)


def test_label_table_is_the_default_one(adult, child):
    assert adult.table == default_label_table()
    assert adult.truth.table == default_label_table().with_walls()
    assert [(label.value, label.name) for label in child.table] == [
        (label.value, label.name) for label in default_label_table()
    ]


def test_tissue_volume(adult_voxels, adult, child):
    geometry, _, labels = adult_voxels
    tissue = np.isin(labels, adult.truth.table.tissue_values).sum() * geometry.voxel_volume_mm3 / 1000.0
    assert 180.0 < tissue < 220.0
    geometry = child.scan_geometry(1.4, margin_mm=2.0)
    labels = child.truth.label(lattice_points(geometry))
    tissue = np.isin(labels, child.truth.table.tissue_values).sum() * geometry.voxel_volume_mm3 / 1000.0
    assert 25.0 < tissue < 45.0


def compartments(labels, blood_values):
    """Set of connected blood compartments (6-connected, of 5 voxels up) that each cavity has a part in."""
    pieces, _ = ndimage.label(np.isin(labels, blood_values))
    sizes = np.bincount(pieces.ravel())
    return {value: {n for n in np.unique(pieces[labels == value]) if sizes[n] >= 5} for value in blood_values}


def test_sides_are_apart_and_each_is_one(adult_voxels, adult):
    _, _, labels = adult_voxels
    found = compartments(labels, adult.truth.table.blood_values)
    assert set.union(*(found[value] for value in LEFT)) == found[1]
    assert set.union(*(found[value] for value in RIGHT)) == found[2]
    assert len(found[1]) == len(found[2]) == 1
    assert found[1] != found[2]


@pytest.mark.parametrize("which", thoroughly(["ventricular", "atrial"]))
def test_a_defect_joins_the_sides(adult, adult_voxels, which):
    defect = adult.ventricular_defect(8.0) if which == "ventricular" else adult.atrial_defect(8.0)
    holed = HeartPhantom.adult(defects=[defect])
    _, points, before = adult_voxels
    after = holed.truth.label(points)
    found = compartments(after, adult.truth.table.blood_values)
    assert found[1] == found[2]
    changed = before != after
    assert np.all(np.isin(before[changed], adult.truth.table.tissue_values))
    assert np.all(np.isin(after[changed], (1, 2) if which == "ventricular" else (3, 4)))
    gap = points[changed] - np.array(defect.position_mm)
    axis = np.array(defect.axis) / np.linalg.norm(defect.axis)
    radial = np.linalg.norm(gap - (gap @ axis)[:, None] * axis, axis=1)
    assert 3.0 < radial.max() <= 4.0
    # All tissue within the canal is gone: what is left is a hole of the wanted diameter.
    axial = (points - np.array(defect.position_mm)) @ axis
    radial = np.linalg.norm(points - np.array(defect.position_mm) - axial[..., None] * axis, axis=-1)
    canal = (radial < 4.0) & (np.abs(axial) < 0.5 * defect.length_mm)
    assert not np.isin(after[canal], adult.truth.table.tissue_values).any()
    assert holed.truth.tissue_distance(np.array(defect.position_mm)) == pytest.approx(4.0, abs=0.02)


@pytest.mark.parametrize("shape", thoroughly(["elliptic", "slit"]))
def test_a_long_defect_is_a_hole_of_its_shape(adult, shape):
    plain = adult.ventricular_defect(12.0)
    more = {"shape": shape, "width_mm": 5.0, "long_axis": tuple(LONG_AXIS + 0.3 * SEPTUM_AXIS)}
    defect = type(plain).model_validate(plain.model_dump() | more)
    truth = HeartPhantom.adult(defects=[defect]).truth
    axis = np.array(defect.axis) / np.linalg.norm(defect.axis)
    long = LONG_AXIS - (LONG_AXIS @ axis) * axis
    long /= np.linalg.norm(long)
    u, v = np.meshgrid(*(np.arange(-7.0321, 7.0, 0.1),) * 2)
    points = np.array(defect.position_mm) + u[..., None] * long + v[..., None] * np.cross(axis, long)
    if shape == "elliptic":
        true = (u / 6.0) ** 2 + (v / 2.5) ** 2 < 1.0
    else:
        true = np.hypot(np.maximum(np.abs(u) - 3.5, 0.0), v) < 2.5
    solid = np.isin(adult.truth.label(points), truth.table.tissue_values)
    found = np.isin(truth.label(points), truth.table.tissue_values)
    assert (found == (solid & ~true)).all()
    assert true[solid].sum() > 0.9 * true.sum()
    assert truth.tissue_distance(np.array(defect.position_mm)) == pytest.approx(2.5, abs=0.02)


def test_every_cavity_and_the_tissue_are_in_one_piece(adult_voxels, adult):
    _, _, labels = adult_voxels
    for value in (*range(1, 10), 13, 14):
        _, count = ndimage.label(labels == value)
        assert count == 1, value
    _, count = ndimage.label(np.isin(labels, adult.truth.table.tissue_values), np.ones((3, 3, 3)))
    assert count == 1


@pytest.mark.parametrize("cavity", [3, *(pytest.param(value, marks=pytest.mark.slow) for value in (2, *range(4, 9)))])
def test_wall_is_as_thick_as_the_table_says(adult, cavity):
    truth, table = adult.truth, adult.truth.table
    wall, thickness = table.wall_value(cavity), table[cavity].wall_thickness_mm
    outer = truth.surface_points(wall)
    _, normal = truth._on_border(outer, wall, steps=1)
    inner = truth.surface_points(cavity)
    outward = truth.label(outer + 0.3 * normal)
    free = outer[(outward == 0) & (truth.label(outer - 0.3 * normal) == wall)]
    # End discs are cut, not grown: leave the points near them out.
    for end in adult.ends:
        free = free[np.linalg.norm(free - np.array(end.position_mm), axis=1) > end.radius_mm + thickness]
    # Across a valve the lumen goes on as another cavity's: only where this cavity is the nearest has a wall its own.
    others = np.concatenate([truth.surface_points(value) for value in range(1, 9) if value != cavity])
    gap, _ = cKDTree(inner).query(free)
    own = gap < cKDTree(others).query(free)[0]
    free, gap = free[own], gap[own]
    assert len(free) > 100
    # The inner surface is sampled every 1.4 mm, its samples at most 0.87 times that from a foot.
    assert np.percentile(gap, 1.5) > thickness - 0.02
    assert gap.min() > thickness - 0.15
    assert np.percentile(gap, 98) < np.hypot(thickness, 1.22)
    some = free[np.random.default_rng(cavity).permutation(len(free))[:1000]]
    exact = np.abs(truth.distance(some, cavity))
    assert np.percentile(np.abs(exact - thickness), 99) < 0.02
    assert np.percentile(np.abs(exact - thickness), 99.5) < 0.1


def test_left_ventricular_wall_is_about_nine_millimetres_and_thinner_at_the_apex(adult):
    reach = np.arange(0.0, 80.0, 0.05)
    centre = adult.anatomy.places["left ventricle"]

    def thickness(direction):
        labels = adult.truth.label(centre + reach[:, None] * direction)
        return 0.05 * np.count_nonzero(labels == 9)

    assert thickness(-SEPTUM_AXIS) == pytest.approx(9.0, abs=0.5)
    assert thickness(UPWARD_AXIS) == pytest.approx(9.0, abs=0.5)
    assert thickness(LONG_AXIS) == pytest.approx(0.85 * 9.0, abs=0.5)


def test_septum_separates_the_ventricles_by_myocardium(adult):
    centre = adult.anatomy.places["left ventricle"]
    line = adult.truth.label(centre + np.arange(0.0, 45.0, 0.1)[:, None] * SEPTUM_AXIS)
    assert list(line[np.flatnonzero(np.diff(line, prepend=0))]) == [1, 9, 2, 10]


def test_heart_lies_as_hearts_do(adult_voxels, adult):
    _, points, labels = adult_voxels
    middle = {value: points[labels == value].mean(axis=0) for value in range(1, 10)}
    apex, places = adult.anatomy.places["apex"], adult.anatomy.places
    base = places["mitral valve"]
    assert apex[0] > base[0] + 20.0
    assert apex[1] < base[1] - 20.0
    assert apex[2] < base[2] - 20.0
    assert middle[2][0] < middle[1][0]
    assert middle[2][1] < middle[1][1]
    assert middle[3][1] > max(middle[value][1] for value in (1, 2, 4))
    assert middle[4][0] < min(middle[value][0] for value in (1, 2, 3))
    assert places["pulmonary valve"][1] < places["aortic valve"][1]
    assert middle[7][2] > middle[4][2] > middle[8][2]
    np.testing.assert_allclose(middle[7][:2], middle[8][:2], atol=15.0)


def test_openings_between_the_cavities(adult_voxels):
    _, _, labels = adult_voxels
    pairs = set()
    for axis in range(3):
        a, b = np.moveaxis(labels, axis, 0)[:-1], np.moveaxis(labels, axis, 0)[1:]
        both = np.stack([np.minimum(a, b), np.maximum(a, b)], axis=-1)[(a != b) & (a < 9) & (b < 9) & (a > 0) & (b > 0)]
        pairs |= {tuple(int(v) for v in pair) for pair in np.unique(both, axis=0)}
    assert pairs == {(1, 3), (1, 5), (2, 4), (2, 6), (4, 7), (4, 8)}


def test_blood_is_open_to_the_outside_at_the_end_discs_only(adult_voxels, adult):
    _, points, labels = adult_voxels
    table = adult.truth.table
    touching = ndimage.binary_dilation(labels == 0) & np.isin(labels, table.blood_values)
    gap = np.full(labels.shape, np.inf)
    for end in adult.ends:
        axis = np.array(end.axis) / np.linalg.norm(end.axis)
        offset = points - np.array(end.position_mm)
        axial = np.abs(offset @ axis)
        near = np.linalg.norm(offset, axis=-1) < end.radius_mm
        gap = np.where(near, np.minimum(gap, axial), gap)
        behind = np.array(end.position_mm) + 1.0 * axis
        assert adult.truth.label(behind) == 0
        assert adult.truth.label(np.array(end.position_mm) - 1.0 * axis) == table[end.label].value
    assert touching.any()
    assert gap[touching].max() <= 1.5


def test_end_disc_is_wider_than_the_vessel(adult):
    for end in adult.ends:
        axis = np.array(end.axis) / np.linalg.norm(end.axis)
        side = np.cross(axis, np.eye(3)[np.argmin(np.abs(axis))])
        side /= np.linalg.norm(side)
        ring = np.array(end.position_mm) - 0.01 * axis + end.radius_mm * side
        assert adult.truth.label(ring) == 0


@pytest.mark.parametrize("oblique", [False, True])
def test_scan_geometry_holds_the_heart_with_its_margin(adult, oblique):
    geometry = adult.scan_geometry((2.0, 2.5, 3.0), margin_mm=5.0, oblique=oblique)
    index = geometry.world_to_index(adult.truth.surface_points()) * geometry.spacing_mm
    last = (np.array(geometry.size) - 1) * geometry.spacing_mm
    room = np.minimum(index.min(axis=0), last - index.max(axis=0)) + 0.5 * np.array(geometry.spacing_mm)
    assert np.all(room > 5.0 - 1.0)
    assert np.all(room < 5.0 + 0.5 * 3.0 + 1.0)
    assert geometry.is_right_handed
    if oblique:
        np.testing.assert_allclose(geometry.direction_matrix[:, 2], LONG_AXIS, atol=1e-9)


def test_any_points_of_any_shape(adult):
    points = np.zeros((2, 3, 3))
    assert adult.truth.label(points).shape == (2, 3)
    assert adult.truth.label(points).dtype == np.uint8
    assert adult.truth.distance(points, 1).shape == (2, 3)
    assert adult.truth.label((0.0, 0.0, 500.0)) == 0


def test_wrong_use_is_said(adult):
    with pytest.raises(UsageError, match="adult or child"):
        HeartPhantom.of_size("giraffe")
    with pytest.raises(UsageError, match="above zero"):
        adult.scan_geometry(0.0)
