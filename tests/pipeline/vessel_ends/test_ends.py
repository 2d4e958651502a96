"""Vessel ends against tubes of known radius: open at the disc, the wall's ring whole up to it, nothing beyond."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.ndimage import map_coordinates

from heartcase.pipeline.data import Segmentation
from heartcase.pipeline.fields.reader import ownership_at_points
from heartcase.pipeline.vessel_ends.cut_ends import HALF, _count_inside, cut_ends
from heartcase.pipeline.vessel_ends.discs import Stumps
from heartcase.pipeline.walls.grow_walls import grow_walls
from heartcase.schemas.errors import StageError
from heartcase.schemas.labels import Label, LabelTable, Role
from heartcase.schemas.recipe.settings import EndMarker, WallsSettings
from tests.pipeline.lattices import LATTICES, lattice, points_of

KINDS = ["even", "flat", "oblique", "left-handed"]
AXIS = np.array([0.48, 0.6, 0.64])
WALL_MM = 2.0
STEP_MM = 0.15
TABLE = LabelTable(
    labels=(
        Label(value=1, name="vein", role=Role.VESSEL_LUMEN, wall_thickness_mm=WALL_MM),
        Label(value=2, name="ventricle", role=Role.BLOOD),
        Label(value=3, name="muscle", role=Role.MYOCARDIUM),
    )
)


def marker(position=(0.0, 0.0, 0.0), axis=AXIS, radius_mm=10.0):
    return EndMarker(label="vein", position_mm=tuple(position), axis=tuple(axis), radius_mm=radius_mm)


def grown(labels, geometry, *ends):
    return grow_walls(Segmentation(labels.astype(np.uint8), geometry, TABLE), WallsSettings(), ends)


def sides_of(axis):
    side = np.cross(axis, [1.0, 0.0, 0.0])
    side /= np.linalg.norm(side)
    return side, np.cross(axis, side)


def disc_points(end, *, before_mm):
    """Points of a plane before the disc, within its radius."""
    axis = np.array(end.axis) / np.linalg.norm(end.axis)
    across = np.arange(-end.radius_mm, end.radius_mm + STEP_MM, STEP_MM)
    u, v = np.meshgrid(across, across)
    within = np.hypot(u, v) <= end.radius_mm
    side, other = sides_of(axis)
    return np.array(end.position_mm) - before_mm * axis + u[within][:, None] * side + v[within][:, None] * other


def areas(structures, end, before_mm):
    """Area of tissue and of lumen, mm2."""
    owner = ownership_at_points(structures, disc_points(end, before_mm=before_mm))
    tissue = owner.tissue_mm < 0.0
    lumen = ~tissue & (owner.void_label == 1)
    return STEP_MM**2 * np.count_nonzero(tissue), STEP_MM**2 * np.count_nonzero(lumen)


def check_open(structures, end, radius_mm, *, tolerance):
    """The ring and the lumen right before the plane, an open mouth, and nothing beyond."""
    for before in (3.0, 1.5, 0.5, 0.1):
        radius = radius_mm(before)
        tissue, lumen = areas(structures, end, before)
        assert tissue == pytest.approx(np.pi * ((radius + WALL_MM) ** 2 - radius**2), rel=tolerance)
        assert lumen == pytest.approx(np.pi * radius**2, rel=2.0 * tolerance)
    axis = np.array(end.axis) / np.linalg.norm(end.axis)
    mouth = np.array(end.position_mm) + np.array([[-3.0], [-0.5], [-0.02], [0.02], [0.5], [3.0]]) * axis
    assert (ownership_at_points(structures, mouth).tissue_mm > 0.0).all()
    for beyond in (0.05, 1.0, 3.0, 6.0, 12.0):
        owner = ownership_at_points(structures, disc_points(end, before_mm=-beyond))
        assert (owner.tissue_mm > 0.0).all()
        assert (owner.void_label == 0).all()


def tube(geometry, *, radius_mm, taper=0.0, stop_mm=100.0, is_round=False):
    """A straight tube along AXIS whose radius at the origin's plane is given; it stops there or rounds off."""
    points = points_of(geometry)
    along = points @ AXIS
    across = np.linalg.norm(points - along[..., None] * AXIS, axis=-1)
    inside = (across < radius_mm - taper * along) & (along <= stop_mm)
    if is_round:
        inside &= np.hypot(np.maximum(along - (stop_mm - radius_mm), 0.0), across) < radius_mm
    return inside


def tolerance_for(radius_mm):
    """Part of the ring's area: 0.05 mm of the wall's thickness and 0.2 mm of its middle's radius.

    The first is what ``test_walls.py`` holds whole walls to; the second is a ninth of a voxel's edge.
    """
    return 0.05 / WALL_MM + 0.2 / (radius_mm + 0.5 * WALL_MM)


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("beyond_voxels", [-2.0, 0.0, 3.0, 100.0])
def test_the_ring_is_whole_up_to_the_disc_wherever_the_segmentation_stops(kind, beyond_voxels):
    geometry = lattice(kind, 44.0)
    stop = beyond_voxels * max(LATTICES[kind][0])
    end = marker()
    structures = grown(tube(geometry, radius_mm=6.0, stop_mm=stop), geometry, end)
    check_open(structures, end, lambda before: 6.0, tolerance=tolerance_for(6.0))
    assert structures.warnings == ()


@pytest.mark.parametrize("kind", ["even", "oblique"])
@pytest.mark.parametrize("stop_mm", [-3.0, 0.0, 3.0])
def test_a_rounded_tip_is_opened(kind, stop_mm):
    geometry = lattice(kind, 44.0)
    end = marker()
    structures = grown(tube(geometry, radius_mm=6.0, stop_mm=stop_mm, is_round=True), geometry, end)
    check_open(structures, end, lambda before: 6.0, tolerance=2.0 * tolerance_for(6.0))


@pytest.mark.parametrize("beyond_voxels", [-2.0, 3.0, 100.0])
def test_a_tapering_tube(beyond_voxels):
    geometry = lattice("oblique", 44.0)
    end = marker(radius_mm=12.0)
    slope = 0.05
    structures = grown(tube(geometry, radius_mm=6.0, taper=slope, stop_mm=beyond_voxels * 2.0), geometry, end)
    # A straight continuation from up to 6 mm before the disc is 0.3 mm too wide there.
    check_open(structures, end, lambda before: 6.0 + slope * before, tolerance=tolerance_for(6.0) + 0.3 / 6.0)


@pytest.mark.parametrize("beyond_voxels", [-2.0, 0.0, 3.0])
def test_a_curved_tube(beyond_voxels):
    geometry = lattice("even", 60.0)
    points = points_of(geometry)
    bend = 25.0
    side, other = sides_of(AXIS)
    x, y, z = points @ side + bend, points @ other, points @ AXIS
    along = bend * np.arctan2(z, x)
    inside = (np.hypot(np.hypot(x, z) - bend, y) < 6.0) & (along <= beyond_voxels * 1.75)
    end = marker()
    structures = grown(inside, geometry, end)
    # In a plane d before the disc the ring is cut at an angle: longer by 1 / cos(d / bend), below 1%.
    check_open(structures, end, lambda before: 6.0, tolerance=tolerance_for(6.0) + 0.01)


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("bend", [14.0, 25.0])
def test_no_wall_is_left_beside_the_stump_of_a_vessel_that_turns_away(kind, bend):
    """Behind its disc the tube bends out of the cylinder that is cut off, in a scan that shows it whole."""
    geometry = lattice(kind, 60.0)
    points = points_of(geometry)
    side, other = sides_of(AXIS)
    x, y, z = points @ side + bend, points @ other, points @ AXIS
    along = bend * np.arctan2(z, x)
    inside = (np.hypot(np.hypot(x, z) - bend, y) < 6.0) & (np.abs(along) < 0.45 * np.pi * bend)
    end = marker(radius_mm=9.0)
    structures = grown(inside, geometry, end)
    check_open(structures, end, lambda before: 6.0, tolerance=tolerance_for(6.0) + 0.03)
    flat = np.arange(-20.0, 20.1, 0.5)
    u, v, w = np.meshgrid(flat, flat, np.arange(0.5, 16.1, 0.5))
    beyond = u[..., None] * side + v[..., None] * other + w[..., None] * AXIS
    owner = ownership_at_points(structures, beyond.reshape(-1, 3))
    assert (owner.tissue_mm > 0.0).all()
    assert (owner.void_label == 0).all()


def test_a_lumen_that_runs_on_by_itself_is_left_as_it_is():
    geometry = lattice("oblique", 44.0)
    labels = tube(geometry, radius_mm=6.0).astype(np.uint8)
    cut = cut_ends(Segmentation(labels, geometry, TABLE), TABLE.with_walls(), (marker(),), Stumps(8.0, {}))
    near = points_of(geometry) @ AXIS <= 8.0 - 1e-9
    assert np.array_equal(cut.labels[near], labels[near])


def test_a_vein_on_a_body_is_continued_by_its_own_section():
    geometry = lattice("even", 60.0)
    points = points_of(geometry)
    centre = -22.0 * AXIS
    body = np.linalg.norm(points - centre, axis=-1) < 14.0
    vein = tube(geometry, radius_mm=5.0, stop_mm=-1.0, is_round=True) & (points @ AXIS > -22.0)
    end = marker(radius_mm=9.0)
    structures = grown(body | vein, geometry, end)
    check_open(structures, end, lambda before: 5.0, tolerance=2.0 * tolerance_for(5.0))


@pytest.mark.parametrize("kind", KINDS)
def test_short_branches_beside_each_other_on_a_tube_are_cut_clean(kind):
    """Branches that leave a wide tube 5 mm before their discs, not two thick slices: no wall is left over."""
    geometry = lattice(kind, 64.0)
    points = points_of(geometry)
    inside = np.hypot(points[..., 0], points[..., 2] + 14.0) < 9.0
    ends = []
    for y, lean in ((-13.0, -0.35), (0.0, 0.1), (13.0, 0.35)):
        axis = np.array([0.0, lean, 1.0]) / np.hypot(1.0, lean)
        offset = points - [0.0, y, 0.0]
        along = offset @ axis
        across = np.linalg.norm(offset - along[..., None] * axis, axis=-1)
        inside |= (across < 3.5) & (along <= 0.0) & (along > -14.0)
        ends.append(marker((0.0, y, 0.0), axis, radius_mm=7.5))
    structures = grown(inside, geometry, *ends)
    for end in ends:
        tissue, lumen = areas(structures, end, 0.1)
        # So little of a branch is seen that its radius is known to half a millimetre only.
        radius = np.sqrt(lumen / np.pi)
        assert radius == pytest.approx(3.5, abs=0.5)
        assert tissue == pytest.approx(np.pi * ((radius + WALL_MM) ** 2 - radius**2), rel=0.1)
    x, y, z = np.meshgrid(np.arange(-12.0, 12.1, 0.5), np.arange(-26.0, 26.1, 0.5), np.arange(4.0, 16.1, 0.5))
    above = ownership_at_points(structures, np.stack([x, y, z], axis=-1).reshape(-1, 3))
    assert (above.tissue_mm > 0.0).all()
    assert (above.void_label == 0).all()
    assert structures.warnings == ()


@pytest.mark.parametrize("kind", ["even", "flat"])
@pytest.mark.parametrize("is_round", [False, True])
def test_a_disc_that_the_lumen_nearly_fills(kind, is_round):
    geometry = lattice(kind, 60.0)
    end = marker(radius_mm=18.2)
    structures = grown(tube(geometry, radius_mm=16.0, stop_mm=-5.0, is_round=is_round), geometry, end)
    check_open(structures, end, lambda before: 16.0, tolerance=tolerance_for(16.0))


def test_the_continuation_takes_background_only_and_joins_no_blood():
    geometry = lattice("even", 50.0)
    along = points_of(geometry) @ AXIS
    side, _ = sides_of(AXIS)
    labels = tube(geometry, radius_mm=6.0, stop_mm=-3.0).astype(np.uint8)
    lateral = points_of(geometry) @ side
    labels[(lateral > 3.0) & (along > -2.0)] = 2
    labels[(lateral < -4.0) & (along > -2.0)] = 3
    cut = cut_ends(Segmentation(labels, geometry, TABLE), TABLE.with_walls(), (marker(),), Stumps(8.0, {}))
    changed = cut.labels != labels
    assert changed.any()
    assert (labels[changed] == 0).all()
    assert (cut.labels[changed] == 1).all()
    new = np.argwhere(changed)
    for axis in range(3):
        for step in (-1, 1):
            beside = new.copy()
            beside[:, axis] += step
            assert (cut.labels[tuple(beside.T)] != 2).all()


def test_a_marker_away_from_its_vessel_is_a_warning_and_cuts_nothing():
    geometry = lattice("even", 60.0)
    labels = tube(geometry, radius_mm=4.0, stop_mm=-12.0)
    structures = grown(labels, geometry, marker(position=-20.0 * AXIS), marker(radius_mm=7.0))
    (warning,) = structures.warnings
    assert warning.text.startswith("ends[2] (vein): ")
    distance = float(warning.text.split(" mm away")[0].split()[-1])
    assert distance == pytest.approx(12.0, abs=1.75)
    assert "add a stroke" in warning.text
    assert len(structures.reshapings) == len(structures.fixed_planes) == 1


def test_a_marker_that_points_into_the_heart_is_told_to_turn():
    geometry = lattice("even", 44.0)
    labels = tube(geometry, radius_mm=4.0, stop_mm=-3.0)
    structures = grown(labels, geometry, marker(axis=-AXIS))
    (warning,) = structures.warnings
    assert "turn its axis round" in warning.text
    assert structures.reshapings == ()


def test_a_gap_that_is_closed_is_told():
    geometry = lattice("even", 44.0)
    end = marker()
    structures = grown(tube(geometry, radius_mm=6.0, stop_mm=-7.0), geometry, end)
    (warning,) = structures.warnings
    assert "ends[1] (vein): the segmented vessel stops" in warning.text
    check_open(structures, end, lambda before: 6.0, tolerance=tolerance_for(6.0))


def test_a_vessel_closed_by_others_is_told():
    geometry = lattice("even", 44.0)
    along = points_of(geometry) @ AXIS
    labels = tube(geometry, radius_mm=6.0, stop_mm=-3.0).astype(np.uint8)
    labels[along > -3.0] = 3
    (warning,) = grown(labels, geometry, marker()).warnings
    assert "other structures close the vessel" in warning.text


def test_a_marker_outside_the_volume_is_refused():
    geometry = lattice("even", 44.0)
    with pytest.raises(StageError, match="outside the volume"):
        grown(tube(geometry, radius_mm=6.0), geometry, marker(position=(60.0, 0.0, 0.0)))


@settings(max_examples=25, deadline=None)
@given(seed=st.integers(0, 2**32 - 1), share=st.floats(0.1, 0.9))
def test_points_of_a_section_are_counted_as_by_linear_interpolation(seed, share):
    random = np.random.default_rng(seed)
    mask = random.random(random.integers(2, 9, 3)) < share
    points = random.uniform(-2.0, 9.0, (40, 3))
    way, places, is_rim = random.normal(size=3), np.linspace(-3.0, 3.0, 7), random.random(40) < 0.3
    inside, inside_rim = np.empty(len(places), np.int64), np.empty(len(places), np.int64)
    _count_inside(mask, points, way, places, is_rim, inside, inside_rim)
    for n, place in enumerate(places):
        value = map_coordinates(mask.astype(float), (points + place * way).T, order=1, mode="nearest")
        assert inside[n] == np.count_nonzero(value >= HALF)
        assert inside_rim[n] == np.count_nonzero(value[is_rim] >= HALF)
