"""Cores of drafts, and markers that the program sets: against analytic depths, the phantom's truth and a slow rule."""

from pathlib import Path

import edt
import numpy as np
import pytest
import SimpleITK
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import ndimage

from heartcase.phantom.anatomy.heart import HeartPhantom
from heartcase.phantom.drawing.strokes import first_strokes
from heartcase.phantom.metrics import dice
from heartcase.phantom.scan.acquisition import CT_UNITS, acquire_ct, acquire_mri, noise_free
from heartcase.pipeline.artifacts.cache import Cache
from heartcase.pipeline.building.lock import lock_recipe, recipe_text
from heartcase.pipeline.building.runner import Runner, SilentListener, run_stages
from heartcase.pipeline.building.session_file import open_session
from heartcase.pipeline.data import UNMARKED, Scan
from heartcase.pipeline.image.filter_scan import filter_scan
from heartcase.pipeline.markers.load_markers import check_markers, load_markers, rasterise_strokes
from heartcase.pipeline.markers.marker_help import ERASED, AutomaticMarkers, label_cores
from heartcase.pipeline.markers.session import SegmentationSession
from heartcase.pipeline.stages.resolve import resolve_recipe
from heartcase.pipeline.stages.stage import Work
from heartcase.pipeline.watershed.segment_scan import segment_scan
from heartcase.schemas.errors import MarkerError, RecipeError
from heartcase.schemas.geometry import Geometry
from heartcase.schemas.labels import default_label_table
from heartcase.schemas.recipe.recipe import MarkerFile, parse_recipe
from heartcase.schemas.recipe.settings import FilterSettings, SegmentSettings, Stroke
from tests.examples import few_and_many, hold_for

TABLE = default_label_table()
SPACING = (0.8, 1.1, 2.3)
GEOMETRY = Geometry.of(shape=(20, 40, 50), spacing_mm=SPACING)


def positions(geometry):
    k, j, i = np.indices(geometry.shape)
    return geometry.index_to_world(np.stack([i, j, k], axis=-1))


@pytest.mark.parametrize("core_mm", [1.5, 4.0, 7.0])
def test_the_core_of_a_ball_is_a_smaller_ball(core_mm):
    away = np.linalg.norm(positions(GEOMETRY) - positions(GEOMETRY)[10, 20, 25], axis=-1)
    draft = np.where(away < 14.0, 5, 0).astype(np.uint8)
    core = label_cores(draft, GEOMETRY, core_mm)
    # the nearest voxel outside lies up to a voxel's diagonal beyond the ball's border
    assert (core[away < 14.0 - core_mm] == 5).all()
    assert (core[(away > 14.0 - core_mm + np.linalg.norm(SPACING)) & (draft == 5)] == UNMARKED).all()
    assert (core[core != UNMARKED] == draft[core != UNMARKED]).all()
    assert (core == 0).any()


def test_the_core_of_a_box_is_as_deep_as_asked_along_every_axis():
    draft = np.full(GEOMETRY.shape, 3, np.uint8)
    draft[4:16, 8:30, 10:40] = 7
    core = label_cores(draft, GEOMETRY, 4.0)
    wanted = np.full(GEOMETRY.shape, UNMARKED, np.uint8)
    # voxels whose nth neighbour is the first outside, with n steps of 4 mm or more: 2 of 2.3, 4 of 1.1, 5 of 0.8
    wanted[4 + 1 : 16 - 1, 8 + 3 : 30 - 3, 10 + 4 : 40 - 4] = 7
    np.testing.assert_array_equal(core == 7, wanted == 7)
    # the border of the volume is no border of a label
    assert core[0, 0, 0] == 3


@settings(max_examples=60, deadline=None)
@given(seed=st.integers(0, 2**32 - 1), core_mm=st.floats(0.5, 12.0), count=st.integers(1, 4))
def test_no_label_is_lost_and_no_core_leaves_its_label(seed, core_mm, count):
    random = np.random.default_rng(seed)
    geometry = Geometry.of(shape=(7, 9, 11), spacing_mm=SPACING)
    smooth = ndimage.gaussian_filter(random.normal(size=(count, *geometry.shape)), (0, 1, 1, 1))
    draft = smooth.argmax(axis=0).astype(np.uint8)
    draft[random.random(geometry.shape) < 0.1] = UNMARKED
    core = label_cores(draft, geometry, core_mm)
    kept = core != UNMARKED
    np.testing.assert_array_equal(core[kept], draft[kept])
    assert set(np.unique(core)) - {UNMARKED} == set(np.unique(draft)) - {UNMARKED}


def test_a_thin_label_keeps_its_deepest_part_and_not_its_noise():
    draft = np.zeros(GEOMETRY.shape, np.uint8)
    draft[5:8, 5:35, 5:45] = 2  # a sheet of three slices: 2.3 mm deep at its rim, 4.6 mm in its middle slice
    draft[15, 20, 20:22] = 2  # a speck
    core = label_cores(draft, GEOMETRY, 10.0)
    where = np.argwhere(core == 2)
    assert set(where[:, 0]) == {6}
    # three quarters of 4.6 mm is 3.45 mm: 4 steps of 1.1 mm from the sheet's edge, 5 of 0.8 mm
    np.testing.assert_array_equal(where.min(axis=0), (6, 5 + 3, 5 + 4))
    np.testing.assert_array_equal(where.max(axis=0), (6, 34 - 3, 44 - 4))
    assert len(where) == 24 * 32


@pytest.fixture(scope="module")
def phantom():
    return HeartPhantom.adult()


@pytest.fixture(scope="module")
def lattice(phantom):
    geometry = phantom.scan_geometry((2.4, 2.6, 3.0), margin_mm=30.0, oblique=True)
    return geometry, phantom.truth.label(positions(geometry))


@pytest.fixture(scope="module")
def signal(phantom, lattice):
    """The CT without noise: lung and air where it is exactly theirs."""
    return noise_free(phantom, lattice[0], CT_UNITS)


@pytest.fixture(scope="module", params=["MR", "CT"])
def scan(request, phantom, lattice, signal):
    geometry = lattice[0]
    if request.param == "MR":
        return Scan(acquire_mri(phantom, geometry, seed=2).values, geometry, "MR")
    return Scan(acquire_ct(phantom, geometry, seed=2, signal=signal).values, geometry, "CT")


def stated(phantom, geometry, count=2):
    strokes = [stroke for stroke in first_strokes(phantom, count) if stroke.label != "background"]
    return rasterise_strokes(strokes, phantom.table, geometry)


@pytest.mark.parametrize(
    ("kinds", "of_background"), [(("background",), 0.5), (("lung",), 0.45), (("lung", "background"), 0.5)]
)
def test_no_voxel_of_the_heart_is_marked_and_most_of_the_lung_is(phantom, lattice, scan, signal, kinds, of_background):
    geometry, truth = lattice
    found = AutomaticMarkers(scan, kinds, stated(phantom, geometry)).markers.labels == 0
    assert not (found & (truth != 0)).any()
    assert found[truth == 0].mean() > of_background
    assert found[signal == CT_UNITS[0]].mean() > 0.95


def test_a_scan_of_hounsfield_units_whose_kind_is_not_known_is_no_worse(phantom, lattice, signal):
    geometry, truth = lattice
    values = acquire_ct(phantom, geometry, seed=3, signal=signal).values
    found = AutomaticMarkers(Scan(values, geometry), ("lung",), stated(phantom, geometry)).found
    assert not (found & (truth != 0)).any()
    assert found[truth == 0].mean() > 0.45


def test_what_is_far_outside_the_marked_heart_is_background_and_what_is_near_is_not():
    geometry = Geometry.of(shape=(60, 30, 80), spacing_mm=(2.0, 3.0, 1.5))
    values = np.full(geometry.shape, 100.0, np.float32)  # nothing is dark
    marked = np.full(geometry.shape, UNMARKED, np.uint8)
    marked[30:34, 10:12, 40:50] = 5
    found = AutomaticMarkers(Scan(values, geometry), ("background",), marked).found
    wanted = np.ones(geometry.shape, bool)
    # 40 mm: 26 slices of 1.5, 13 rows of 3 and 20 voxels of 2
    wanted[30 - 26 : 33 + 26 + 1, : 11 + 13 + 1, 40 - 20 : 49 + 20 + 1] = False
    np.testing.assert_array_equal(found, wanted)
    assert not AutomaticMarkers(Scan(values, geometry), ("lung",), marked).found.any()
    assert not AutomaticMarkers(Scan(values, geometry), (), marked).found.any()


def by_the_rules(scan, kinds, labels):
    """Automatic background from its definition, the slow way."""
    geometry = scan.geometry
    heart = ~np.isin(labels, (UNMARKED, ERASED, 0))
    found = np.zeros(heart.shape, bool)
    if not heart.any():
        return found
    if scan.modality == "CT":
        below = -500.0
    else:
        low = scan.values.min()
        half = 0.5 * (np.percentile(scan.values[heart], 5.0) - low)
        below = low + 2.0 ** (np.floor(4 * np.log2(half)) / 4) if half > 0 else low
    image = np.pad((scan.values < below).astype(float), 8, mode="edge")
    core = ndimage.distance_transform_edt(image, sampling=geometry.spacing_mm[::-1])[8:-8, 8:-8, 8:-8] >= 3.0
    regions, count = ndimage.label(core)
    for n in range(1, count + 1):
        region = regions == n
        rim = region.copy()
        rim[1:-1, 1:-1, 1:-1] = False
        if region.sum() * geometry.voxel_volume_mm3 > 5000.0 and ("lung" in kinds or rim.any()):
            found |= region
    if "background" in kinds:
        away = [np.zeros(n) for n in heart.shape]
        for axis, step in enumerate(geometry.spacing_mm[::-1]):
            at = np.argwhere(heart)[:, axis]
            index = np.arange(heart.shape[axis])
            away[axis] = np.maximum(at.min() - index, index - at.max()) * step
        found |= np.maximum(np.maximum(away[0][:, None, None], away[1][None, :, None]), away[2]) > 40.0 + 1e-6
    return found & (ndimage.distance_transform_edt(~heart, sampling=geometry.spacing_mm[::-1]) >= 5.0 - 1e-3)


SMALL = Geometry.of(shape=(14, 16, 40), spacing_mm=(2.5, 2.0, 3.0))


def small_scan(seed, modality):
    random = np.random.default_rng(seed)
    values = ndimage.gaussian_filter(random.normal(size=SMALL.shape), 2.5)
    # regions of dark and bright, with soft borders
    values = 1400.0 / (1.0 + np.exp(-4.0 * values / values.std())) - (1000.0 if modality == "CT" else 0.0)
    return Scan(values.astype(np.float32), SMALL, modality)


@pytest.mark.parametrize("modality", ["MR", "CT"])
@pytest.mark.parametrize("kinds", [("background",), ("lung",), ("background", "lung")])
def test_after_any_painting_they_are_what_the_rules_give_from_scratch(modality, kinds):
    total = 0
    for seed in range(12):
        random = np.random.default_rng(seed)
        scan = small_scan(seed, modality)
        labels = np.full(SMALL.shape, UNMARKED, np.uint8)
        automatic = AutomaticMarkers(scan, kinds, labels)
        shown = automatic.markers.labels
        for _ in range(8):
            low = random.integers(0, np.array(SMALL.shape) - 2)
            box = tuple(slice(a, a + int(random.integers(1, 5))) for a in low)
            labels[box] = random.choice([5, 7, 0, UNMARKED, ERASED])
            voxels = np.flatnonzero(np.isin(np.arange(labels.size), np.arange(labels.size).reshape(SMALL.shape)[box]))
            changed, values = automatic.paint(voxels, labels.flat[voxels])
            shown.flat[changed] = values
            wanted = by_the_rules(scan, kinds, labels)
            np.testing.assert_array_equal(automatic.found, wanted)
            np.testing.assert_array_equal(shown, automatic.markers.labels)
            np.testing.assert_array_equal((shown == 0), (labels == 0) | (wanted & (labels == UNMARKED)))
            assert ((labels == shown) | ~np.isin(labels, (5, 7))).all()
            total += wanted.sum()
    assert total > 1000


points = st.tuples(*(st.floats(-0.4, n - 0.6) for n in SMALL.size)).map(
    lambda index: tuple(float(x) for x in SMALL.index_to_world(index))
)
NAMES = [label.name for label in TABLE if label.value in (0, 5, 7)]


DEEDS = st.lists(
    st.one_of(
        st.builds(
            lambda name, radius, line: Stroke(label=name, radius_mm=radius, points_mm=line, erase=name is None),
            st.sampled_from([*NAMES, None]),
            st.floats(0.0, 8.0),
            st.lists(points, min_size=1, max_size=2).map(tuple),
        ),
        st.sampled_from(["undo", "redo"]),
    ),
    min_size=1,
    max_size=8,
)


@few_and_many(5, 200)
def test_a_sessions_strokes_give_the_same_when_a_build_paints_them(count):
    hold_for(count, a_build_gives_what_the_session_did, st.integers(0, 50), st.sampled_from(["MR", "CT"]), DEEDS)


def a_build_gives_what_the_session_did(seed, modality, deeds):
    scan, kinds = small_scan(seed, modality), ("background", "lung")
    nothing = np.full(SMALL.shape, UNMARKED, np.uint8)
    session = SegmentationSession.of_scan(scan, TABLE, markers=AutomaticMarkers(scan, kinds, nothing))
    for deed in deeds:
        if isinstance(deed, Stroke):
            session.paint(deed)
        elif deed == "undo" and session.strokes:
            session.undo()
        elif deed == "redo" and session.redo_count:
            session.redo()
    rebuilt = load_markers((), session.strokes, TABLE, SMALL, Path(), scan=scan, automatic=kinds)
    np.testing.assert_array_equal(session.markers().labels, rebuilt.labels)
    if (rebuilt.labels != UNMARKED).any():
        wanted = segment_scan(scan, rebuilt, SegmentSettings(), TABLE).labels
        np.testing.assert_array_equal(session.labels, wanted)


def test_an_eraser_keeps_the_program_out_and_a_stroke_paints_over_it(tmp_path):
    scan = Scan(np.full(SMALL.shape, 10.0, np.float32), SMALL, "CT")
    scan.values[:, :, 20:] = -900.0
    lung = tuple(float(x) for x in SMALL.index_to_world((32, 8, 7)))
    heart = tuple(float(x) for x in SMALL.index_to_world((8, 8, 7)))
    strokes = [Stroke(label=NAMES[1], radius_mm=4.0, points_mm=(heart,))]
    index = (7, 8, 32)
    for extra, wanted in (
        ([], 0),
        ([Stroke(erase=True, radius_mm=4.0, points_mm=(lung,))], UNMARKED),
        ([Stroke(label=NAMES[2], radius_mm=4.0, points_mm=(lung,))], 7),
    ):
        markers = load_markers((), strokes + extra, TABLE, SMALL, tmp_path, scan=scan, automatic=("lung",))
        assert markers.labels[index] == wanted


def test_without_a_marked_heart_the_words_say_that_it_comes_first(tmp_path):
    scan = small_scan(1, "CT")
    corner = Stroke(label="background", points_mm=(tuple(float(x) for x in SMALL.index_to_world((1, 1, 1))),))
    markers = load_markers((), [corner], TABLE, SMALL, tmp_path, scan=scan, automatic=("lung",))
    assert (markers.labels == 0).sum() < 20
    with pytest.raises(MarkerError, match="nothing of the heart is marked") as caught:
        check_markers(markers, TABLE, automatic=("lung",))
    assert caught.value.problems[0].place == "segment.automatic"
    middle = Stroke(label=NAMES[2], points_mm=(tuple(float(x) for x in SMALL.index_to_world((20, 8, 7))),))
    bright = Scan(np.full(SMALL.shape, 10.0, np.float32), SMALL, "CT")
    markers = load_markers((), [middle], TABLE, SMALL, tmp_path, scan=bright, automatic=("lung",))
    with pytest.raises(MarkerError, match="the program found nothing that is surely not heart"):
        check_markers(markers, TABLE, automatic=("lung",))


def write_labels(path, labels, geometry):
    image = SimpleITK.GetImageFromArray(labels)
    image.SetSpacing(geometry.spacing_mm)
    image.SetOrigin(geometry.origin_mm)
    image.SetDirection(geometry.direction_matrix.ravel().tolist())
    SimpleITK.WriteImage(image, str(path))


def lumens(truth):
    """The truth without grown walls, which no recipe marks."""
    return np.where(truth <= max(TABLE.values), truth, 0).astype(np.uint8)


def dilated(truth):
    """Every structure of the heart a voxel too large, the nearest one where two meet."""
    distance, (k, j, i) = ndimage.distance_transform_edt(truth == 0, return_indices=True)
    return np.where(distance <= 1.0, truth[k, j, i], 0)


@pytest.mark.parametrize(
    "spoil", [dilated, lambda truth: np.roll(truth, (1, 1), axis=(1, 2))], ids=["dilated", "moved"]
)
def test_a_slightly_wrong_draft_is_better_after_the_watershed(phantom, lattice, tmp_path, spoil):
    geometry, truth = lattice
    truth = lumens(truth)
    scan = Scan(acquire_mri(phantom, geometry, seed=4).values, geometry, "MR")
    draft = spoil(truth).astype(np.uint8)
    write_labels(tmp_path / "draft.nrrd", draft, geometry)
    file = MarkerFile(path="draft.nrrd", core_mm=4.0, background=True)
    markers = load_markers((file,), (), TABLE, geometry, tmp_path)
    labels = segment_scan(filter_scan(scan, FilterSettings()), markers, SegmentSettings(), TABLE).labels
    before, after = ([dice(made, truth, v) for v in TABLE.values if v] for made in (draft, labels))
    assert np.mean(after) > np.mean(before) + 0.05


def test_what_lies_beyond_a_draft_is_not_its_background(tmp_path):
    part = GEOMETRY.cropped((10, 8, 4), (30, 24, 12))
    draft = np.zeros(part.shape, np.uint8)
    draft[4:8, 6:18, 8:22] = 5
    write_labels(tmp_path / "draft.nrrd", draft, part)
    file = MarkerFile(path="draft.nrrd", core_mm=2.0, background=True)
    labels = load_markers((file,), (), TABLE, GEOMETRY, tmp_path).labels
    inside = np.zeros(GEOMETRY.shape, bool)
    inside[4:16, 8:32, 10:40] = True
    assert (labels[~inside] == UNMARKED).all()
    whole = np.full(GEOMETRY.shape, UNMARKED, np.uint8)
    whole[inside] = draft.ravel()
    depth = edt.edt(whole.astype(np.uint16) + 1, anisotropy=SPACING[::-1], black_border=False)
    np.testing.assert_array_equal(labels == 0, (whole == 0) & (depth >= 2.0))
    without = load_markers((file.model_copy(update={"background": False}),), (), TABLE, GEOMETRY, tmp_path)
    assert set(np.unique(without.labels)) == {5, UNMARKED}
    assert without.warnings == ()


def test_a_draft_that_lacks_structures_says_that_it_takes_them_for_background(tmp_path):
    # all but the venae cavae
    absent = [label for label in TABLE if label.name.endswith("vena cava")]
    assert len(absent) == 2
    draft = np.zeros(GEOMETRY.shape, np.uint8)
    for n, label in enumerate(one for one in TABLE if one not in absent):
        draft[2:8, 2:30, 3 + 4 * n : 6 + 4 * n] = label.value
    write_labels(tmp_path / "draft.nrrd", draft, GEOMETRY)
    file = MarkerFile(path="draft.nrrd", core_mm=1.0, background=True)
    (warning,) = load_markers((file,), (), TABLE, GEOMETRY, tmp_path).warnings
    assert warning.text.startswith(
        f"markers[1] holds no {absent[0].name}, {absent[1].name}, and with background = true"
    )
    for n, label in enumerate(absent):
        draft[12:18, 2:30, 3 + 20 * n : 20 + 20 * n] = label.value
    write_labels(tmp_path / "draft.nrrd", draft, GEOMETRY)
    assert load_markers((file,), (), TABLE, GEOMETRY, tmp_path).warnings == ()


def test_points_have_no_core(tmp_path):
    (tmp_path / "points.mrk.json").write_text("{}")
    with pytest.raises(MarkerError, match="points have no core"):
        load_markers((MarkerFile(path="points.mrk.json", core_mm=2.0),), (), TABLE, GEOMETRY, tmp_path)


AUTOMATIC = """
heartcase_recipe = 1
name = "small"

[scan]
path = "scan.nrrd"
modality = "CT"

[segment]
automatic = ["lung", "background"]
"""


@pytest.fixture
def automatic_recipe(tmp_path):
    values = np.random.default_rng(1).normal(0.0, 30.0, SMALL.shape).astype(np.float32)
    values[4:10, 4:12, 6:14] += 300.0
    values[:, :, 20:] -= 900.0
    write_labels(tmp_path / "scan.nrrd", values, SMALL)
    path = tmp_path / "small.toml"
    path.write_text(AUTOMATIC)
    return path


def labels_of_a_build(path):
    recipe = parse_recipe(path.read_text())
    runner = Runner(Cache(path.parent / "cache"), SilentListener(), force=False)
    work = Work(recipe, path.parent, cache=runner.cache)

    def after(stage):
        if stage == "read":
            work.recipe = resolve_recipe(recipe, work.outputs.scan.get())

    run_stages(runner, work, until="segment", after=after)
    return work


def test_a_session_that_was_saved_is_what_a_build_makes(automatic_recipe):
    path = automatic_recipe
    opened = open_session(path, out=path.parent, cache=path.parent / "cache")
    middle, lung = (tuple(float(x) for x in SMALL.index_to_world(index)) for index in ((10, 8, 7), (30, 8, 7)))
    opened.session.paint(Stroke(label=NAMES[1], radius_mm=4.0, points_mm=(middle,)))
    assert (opened.session.markers().labels == 0).sum() > 1000
    opened.session.paint(Stroke(erase=True, radius_mm=8.0, points_mm=(lung,)))
    opened.save()
    work = labels_of_a_build(path)
    nodes = work.outputs
    np.testing.assert_array_equal(nodes.markers.get().labels, opened.session.markers().labels)
    np.testing.assert_array_equal(nodes.segmentation.get().labels, opened.session.labels)
    assert set(np.unique(opened.session.labels)) == {0, TABLE.find(NAMES[1]).value}
    settings_of = {record.stage: record.settings for record in work.records}
    assert settings_of["markers"]["automatic"] == ["background", "lung"]
    assert "automatic" not in settings_of["segment"]
    again = open_session(path, out=path.parent, cache=path.parent / "cache")
    np.testing.assert_array_equal(again.session.labels, opened.session.labels)


def test_without_a_marked_heart_a_build_says_so_before_it_computes(automatic_recipe):
    path = automatic_recipe
    corner = [float(x) for x in SMALL.index_to_world((1, 1, 1))]
    path.write_text(path.read_text() + f'[[strokes]]\nlabel = "background"\npoints_mm = [{corner}]\n')
    with pytest.raises(MarkerError, match="nothing of the heart is marked"):
        labels_of_a_build(path)


def test_a_locked_recipe_keeps_cores_and_automatic_markers(automatic_recipe):
    path = automatic_recipe
    write_labels(path.parent / "draft.nrrd", np.ones(SMALL.shape, np.uint8), SMALL)
    path.write_text(path.read_text() + '[[markers]]\npath = "draft.nrrd"\ncore_mm = 2.5\nbackground = true\n')
    recipe = parse_recipe(path.read_text())
    locked = lock_recipe(recipe, directory=path.parent, out=path.parent)
    again = parse_recipe(recipe_text(locked))
    assert again.segment.automatic == recipe.segment.automatic == ("lung", "background")
    assert again.markers == recipe.markers
    with pytest.raises(RecipeError, match="background = true needs core_mm"):
        parse_recipe(path.read_text().replace("core_mm = 2.5", ""))
