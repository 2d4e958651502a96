"""Places for one more stroke: known answers, and what really changes when the stroke is painted."""

import numpy as np
import pytest
from scipy import ndimage
from scipy.spatial.transform import Rotation

from heartcase.pipeline.data import UNMARKED
from heartcase.pipeline.markers.confidence import voxel_confidence
from heartcase.pipeline.markers.flat_places import in_marked_flat
from heartcase.pipeline.markers.load_markers import stroke_voxels
from heartcase.pipeline.markers.suggest import LEAST_ML, SURE, RightPlace, suggest_strokes
from heartcase.pipeline.watershed.certainty import foot_certainty
from heartcase.pipeline.watershed.forest import solve_forest
from heartcase.pipeline.watershed.tree import build_basin_tree
from heartcase.schemas.geometry import Geometry
from heartcase.schemas.recipe.settings import Stroke

DIRECTION = Rotation.from_euler("xyz", (20.0, -35.0, 50.0), degrees=True).as_matrix() @ np.diag([1.0, 1.0, -1.0])


def oblique(shape, spacing_mm=(0.9, 1.4, 2.2)):
    return Geometry.of(shape=shape, origin_mm=(12.0, -40.0, 90.0), spacing_mm=spacing_mm, direction=DIRECTION)


def index_of(geometry, position_mm):
    """Index [z, y, x] of the voxel at a position."""
    return tuple(np.rint(geometry.world_to_index(np.array(position_mm))).astype(int)[::-1].tolist())


def marked(shape, **labels):
    markers = np.full(shape, UNMARKED, np.uint8)
    for name, index in labels.items():
        markers[index] = int(name.removeprefix("label"))
    return markers


def test_a_plain_with_one_doubtful_lake_is_told_as_it_is():
    # two plains with a marker each, and a lake between them behind walls of 6 and 8
    shape = (12, 14, 30)
    height = np.ones(shape, np.float32)
    height[:, :, 12] = 6.0
    height[:, :, 20] = 8.0
    height[5, 7, 16] = 0.5  # the lake's lowest voxel
    height[5, 7, 3] = height[5, 7, 26] = 0.25
    geometry = oblique(shape)
    forest = solve_forest(build_basin_tree(height), marked(shape, label1=(5, 7, 3), label2=(5, 7, 26)))
    found = suggest_strokes(forest, geometry, count=3)
    assert len(found.places) == 1
    place = found.places[0]
    np.testing.assert_allclose(place.position_mm, geometry.index_to_world((16, 7, 5)), atol=1e-9)
    assert (place.label, place.rival) == (1, 2)
    # passes of 6 and 8
    assert place.certainty == pytest.approx(0.25)
    # both walls drain to the side of lower x: that at 20 into the lake, that at 12 is the first that does not change
    assert place.change_ml == pytest.approx(12 * 14 * 8 * 0.9 * 1.4 * 2.2 / 1000.0)
    assert place.radius_mm == pytest.approx(4 * 0.9)
    # 13 voxels to the one marker, 10 to the other
    nearness = 13.0 / (13.0 + 10.0)
    assert place.worth_ml == pytest.approx(min(place.change_ml, 5.0) * 0.75**4 * nearness**2)
    assert found.rest_ml == 0.0


def test_in_a_flat_lake_the_place_is_where_the_widest_brush_stays_inside():
    shape = (11, 13, 30)
    height = np.full(shape, 3.0, np.float32)
    height[:, :, 12] = 6.0
    height[:, :, 20] = 8.0
    height[2:9, 3:10, 14:19] = 0.5
    height[5, 7, 3] = height[5, 7, 26] = 0.25
    geometry = oblique(shape, (1.0, 1.0, 1.0))
    forest = solve_forest(build_basin_tree(height), marked(shape, label1=(5, 7, 3), label2=(5, 7, 26)))
    (place,) = suggest_strokes(forest, geometry, count=3).places
    changed = np.zeros(shape, bool)
    changed[:, :, 13:21] = True
    depth = ndimage.distance_transform_edt(np.pad(changed, 1, mode="edge"))[1:-1, 1:-1, 1:-1]
    lake = height == 0.5
    assert place.change_ml == pytest.approx(changed.sum() / 1000.0)
    assert place.radius_mm == depth[lake].max() == 4.0
    index = index_of(geometry, place.position_mm)
    # of equally deep ones the first
    assert index == tuple(np.argwhere(lake & (depth == 4.0))[0])
    # found right, it is not named again, though it is not the lowest voxel of its basin
    right = RightPlace(place.position_mm, place.label, place.rival)
    assert suggest_strokes(forest, geometry, count=3, right=[right]).places == ()


def test_a_place_that_was_found_right_is_not_named_again_while_it_has_its_label():
    shape = (20, 24, 28)
    markers = np.full(shape, UNMARKED, np.uint8)
    markers.flat[np.random.default_rng(0).choice(markers.size, 5, replace=False)] = [0, 1, 2, 3, 0]
    forest = solve_forest(build_basin_tree(rough(0, shape)), markers)
    geometry = oblique(shape, (1.5, 2.0, 2.5))
    before = suggest_strokes(forest, geometry, count=6, apart_mm=4.0).places
    assert len(before) >= 3
    for first in before[:3]:
        right = RightPlace(first.position_mm, first.label, first.rival)
        after = suggest_strokes(forest, geometry, count=6, apart_mm=4.0, right=[right]).places
        assert first.position_mm not in [one.position_mm for one in after]
        # the others stay, as far as they ask something else
        for one in after:
            away = np.linalg.norm(np.subtract(one.position_mm, first.position_mm))
            assert away >= 4.0 or (one.label, one.rival) != (first.label, first.rival)
    # and what comes first then is worth as much as what came second, or more
    right = RightPlace(before[0].position_mm, before[0].label, before[0].rival)
    (second,) = suggest_strokes(forest, geometry, count=1, apart_mm=4.0, right=[right]).places
    assert before[1].worth_ml <= second.worth_ml <= before[0].worth_ml
    # all of them one by one: it comes to an end
    said, asked = [], 0
    while places := suggest_strokes(forest, geometry, count=1, right=said).places:
        said.append(RightPlace(places[0].position_mm, places[0].label, places[0].rival))
        asked += 1
        assert asked < 500
    # a voxel that has another label now is asked for again
    other = RightPlace(before[0].position_mm, before[0].rival, before[0].label)
    outside = RightPlace((1e4, 0.0, 0.0), before[0].label, before[0].rival)
    assert suggest_strokes(forest, geometry, count=6, apart_mm=4.0, right=[other, outside]).places == before


def rough(seed, shape):
    values = ndimage.gaussian_filter(np.random.default_rng(seed).normal(size=shape), 1.5)
    return (values - values.min()).astype(np.float32)


@pytest.mark.parametrize("seed", range(6))
def test_a_stroke_inside_the_radius_changes_exactly_the_volume_that_was_said(seed):
    shape = (20, 24, 28)
    geometry = oblique(shape, (1.5, 2.0, 2.5))
    random = np.random.default_rng(seed)
    markers = np.full(shape, UNMARKED, np.uint8)
    markers.flat[random.choice(markers.size, 5, replace=False)] = [0, 1, 2, 3, 0]
    tree = build_basin_tree(rough(seed, shape))
    forest = solve_forest(tree, markers)
    found = suggest_strokes(forest, geometry, count=6, apart_mm=4.0)
    assert found.places
    changed_before = np.zeros(shape, bool)
    for place in found.places:
        assert 0.0 <= place.certainty < SURE
        assert place.change_ml >= LEAST_ML
        assert forest.labels[index_of(geometry, place.position_mm)] == place.label != place.rival
        for radius in (0.0, 0.999 * place.radius_mm):
            for label in (place.rival, 9):
                stroke = Stroke(label="any", radius_mm=min(radius, 50.0), points_mm=(place.position_mm,))
                painted = markers.copy()
                painted.flat[stroke_voxels(stroke, geometry)] = label
                changed = solve_forest(tree, painted).labels != forest.labels
                assert changed.sum() * geometry.voxel_volume_mm3 / 1000.0 == pytest.approx(place.change_ml, abs=1e-9)
        assert not (changed & changed_before).any()
        changed_before |= changed
    positions = np.array([place.position_mm for place in found.places])
    apart = np.linalg.norm(positions[:, None] - positions, axis=-1) + 1e9 * np.eye(len(positions))
    assert apart.min() >= 4.0
    worth = [place.worth_ml for place in found.places]
    assert worth == sorted(worth, reverse=True)
    assert worth[-1] >= found.rest_ml


@pytest.mark.parametrize("seed", range(3))
def test_the_rest_is_the_worth_of_the_next_place(seed):
    shape = (20, 24, 28)
    markers = np.full(shape, UNMARKED, np.uint8)
    markers.flat[np.random.default_rng(seed).choice(markers.size, 4, replace=False)] = [0, 1, 2, 3]
    forest = solve_forest(build_basin_tree(rough(seed, shape)), markers)
    geometry = oblique(shape)
    many = suggest_strokes(forest, geometry, count=4, apart_mm=3.0).places
    assert len(many) >= 2
    for count in range(1, len(many)):
        few = suggest_strokes(forest, geometry, count=count, apart_mm=3.0)
        assert few.places == many[:count]
        assert few.rest_ml >= many[count].worth_ml


def test_without_markers_or_with_one_label_there_is_nothing_to_say():
    shape = (6, 7, 8)
    for markers in (marked(shape), marked(shape, label4=(1, 2, 3))):
        found = suggest_strokes(solve_forest(build_basin_tree(rough(1, shape)), markers), oblique(shape))
        assert found.places == ()
        assert found.rest_ml == 0.0


def test_a_doubtful_lake_in_the_background_is_named_only_near_the_heart():
    # a plain of background and one of the heart, 7 high between them; in the background two lakes behind walls of 6
    shape = (5, 5, 80)
    height = np.ones(shape, np.float32)
    height[:, :, 70] = 7.0
    for lake, wall in ((10, 20), (60, 50)):
        height[:, :, wall] = 6.0
        height[2, 2, lake] = 0.5
    height[2, 2, 35] = height[2, 2, 75] = 0.25
    geometry = oblique(shape, (1.0, 1.0, 1.0))
    forest = solve_forest(build_basin_tree(height), marked(shape, label0=(35, 2, 2)[::-1], label3=(2, 2, 75)))
    near = [geometry.index_to_world((60, 2, 2))]
    found = suggest_strokes(forest, geometry)
    np.testing.assert_allclose([place.position_mm for place in found.places], near, atol=1e-9)
    assert found.rest_ml == 0.0


def touches_face(mask):
    return any(np.take(mask, side, axis).any() for axis in range(3) for side in (0, -1))


def over_a_floor(seed, shape, quantile=0.45):
    """A rough landscape with a floor under it: flat minima of many voxels."""
    height = rough(seed, shape)
    return np.maximum(height, np.quantile(height, quantile).astype(np.float32))


@pytest.mark.parametrize("seed", range(8))
def test_over_a_floor_too_a_stroke_changes_the_volume_that_was_said(seed):
    shape = (20, 24, 28)
    geometry = oblique(shape, (1.5, 2.0, 2.5))
    markers = np.full(shape, UNMARKED, np.uint8)
    markers.flat[np.random.default_rng(seed).choice(markers.size, 12, replace=False)] = [0, 1, 2, 3] * 3
    forest = solve_forest(build_basin_tree(over_a_floor(seed, shape)), markers)
    before = {name: getattr(forest, name).copy() for name in ("labels", "marks", "painted", "foot_level", "flat_label")}
    found = suggest_strokes(forest, geometry, count=10, apart_mm=4.0)
    for name, values in before.items():
        np.testing.assert_array_equal(getattr(forest, name), values)
    feet = foot_certainty(forest)
    confidence = voxel_confidence(forest, geometry, feet)
    changed_before = np.zeros(shape, bool)
    in_flats = 0
    for place in found.places:
        index = index_of(geometry, place.position_mm)
        assert forest.labels[index] == place.label != place.rival
        assert place.change_ml >= LEAST_ML
        assert 0.0 <= place.certainty < SURE
        is_in_flat = bool(in_marked_flat(forest)[forest.tree.basin[index]])
        in_flats += is_in_flat
        for radius in (0.999 * place.radius_mm, 0.0):
            for label in (place.rival,) if is_in_flat else (place.rival, 9):
                stroke = Stroke(label="any", radius_mm=min(radius, 50.0), points_mm=(place.position_mm,))
                painted = markers.copy()
                painted.flat[stroke_voxels(stroke, geometry)] = label
                changed = solve_forest(forest.tree, painted).labels != forest.labels
                ml = changed.sum() * geometry.voxel_volume_mm3 / 1000.0
                if is_in_flat and radius:
                    assert ml >= place.change_ml - 1e-9
                    wider = changed
                else:
                    assert ml == pytest.approx(place.change_ml, abs=1e-9)
        depth = ndimage.distance_transform_edt(np.pad(changed, 1, mode="edge"), (2.5, 2.0, 1.5))[1:-1, 1:-1, 1:-1]
        if not changed.all() and not touches_face(changed):
            assert place.radius_mm == pytest.approx(depth[index], rel=1e-5)
        if is_in_flat:
            # the wider dab stayed inside what one of a voxel changes
            assert changed.flat[
                stroke_voxels(stroke.model_copy(update={"radius_mm": 0.999 * place.radius_mm}), geometry)
            ].all()
            assert (wider >= changed).all()
        assert place.confidence == pytest.approx(confidence[index], abs=1e-5)
        assert not (changed & changed_before).any()
        changed_before |= changed
    assert in_flats > 0
    worth = [place.worth_ml for place in found.places]
    assert worth == sorted(worth, reverse=True)
    assert worth[-1] >= found.rest_ml


def test_in_a_flat_that_two_labels_share_a_place_is_named_far_from_the_markers_of_its_label():
    # a tube as flat as can be, marked near both ends; a person knows that the far half of label 1 is label 2
    shape = (9, 9, 60)
    height = np.full(shape, 5.0, np.float32)
    height[2:7, 2:7, 2:58] = 1.0
    markers = marked(shape, label0=(0, 0, 0), label1=(4, 4, 4), label2=(4, 4, 50))
    geometry = oblique(shape, (1.0, 1.0, 1.0))
    forest = solve_forest(build_basin_tree(height), markers)
    places = suggest_strokes(forest, geometry, count=5).places
    one = next(place for place in places if (place.label, place.rival) == (1, 2))
    z, y, x = index_of(geometry, one.position_mm)
    assert 15 <= x <= 27
    assert 2 <= y <= 6
    assert 2 <= z <= 6
    assert one.certainty == 0.0
    assert 1.0 <= one.radius_mm <= 3.0
    # what is nearer to it than to the marker of its own label, as far as that has label 1
    assert 25 * (27 - x) / 1000.0 <= one.change_ml <= 2 * 81 * (27 - 4) / 1000.0
    # found right, another place is named, or none
    right = RightPlace(one.position_mm, 1, 2)
    for place in suggest_strokes(forest, geometry, count=5, right=[right]).places:
        away = np.linalg.norm(np.subtract(place.position_mm, one.position_mm))
        assert (place.label, place.rival) != (1, 2) or away >= 10.0


def tube(**labels):
    """A flat tube along x, 56 voxels long, in a steep block: forest and lattice."""
    shape = (9, 9, 60)
    height = np.full(shape, 5.0, np.float32)
    height[2:7, 2:7, 2:58] = 1.0
    return solve_forest(build_basin_tree(height), marked(shape, **labels)), oblique(shape, (1.0, 1.0, 1.0))


def test_what_a_dab_would_change_of_a_place_that_was_found_right_is_not_named():
    forest, geometry = tube(label0=(0, 0, 0), label1=(4, 4, 4), label2=(4, 4, 50))
    said = []
    for _ in range(20):
        places = suggest_strokes(forest, geometry, count=1, right=said, apart_mm=1.0).places
        if not places:
            break
        (place,) = places
        painted = forest.painted.copy()
        painted[index_of(geometry, place.position_mm)] = place.rival
        changed = solve_forest(forest.tree, painted).labels != forest.labels
        for one in said:
            assert not changed[index_of(geometry, one.position_mm)]
        said.append(RightPlace(place.position_mm, place.label, place.rival))
    assert places == ()
    assert len(said) > 1


def test_background_in_a_flat_of_the_heart_is_named_though_the_heart_has_no_foot_near_it():
    for one, two in ((0, 1), (1, 0)):
        forest, geometry = tube(**{f"label{one}": (4, 4, 4), f"label{two}": (4, 4, 56)})
        pairs = {(place.label, place.rival) for place in suggest_strokes(forest, geometry, apart_mm=1.0).places}
        assert {(0, 1), (1, 0)} <= pairs


def test_no_place_at_all_can_be_asked_for():
    forest, geometry = tube(label1=(4, 4, 4), label2=(4, 4, 50))
    for count in (0, -1):
        found = suggest_strokes(forest, geometry, count=count)
        assert found.places == ()
        assert found.rest_ml > 0.0


@pytest.mark.parametrize("seed", range(3))
def test_over_a_floor_too_finding_all_places_right_comes_to_an_end(seed):
    shape = (14, 16, 18)
    geometry = oblique(shape, (1.5, 2.0, 2.5))
    markers = np.full(shape, UNMARKED, np.uint8)
    markers.flat[np.random.default_rng(seed).choice(markers.size, 8, replace=False)] = [0, 1, 2, 3] * 2
    forest = solve_forest(build_basin_tree(over_a_floor(seed, shape)), markers)
    said = []
    while places := suggest_strokes(forest, geometry, count=1, apart_mm=4.0, right=said).places:
        for one in said:
            away = np.linalg.norm(np.subtract(places[0].position_mm, one.position_mm))
            assert away >= 4.0 or (places[0].label, places[0].rival) != (one.label, one.rival)
        said.append(RightPlace(places[0].position_mm, places[0].label, places[0].rival))
        assert len(said) < 300
    assert said
