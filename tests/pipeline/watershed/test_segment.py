import numpy as np
import pytest
from scipy import ndimage

from heartcase.pipeline.data import UNMARKED, Markers, Scan, Segmentation
from heartcase.pipeline.watershed.segment_scan import keep_large_pieces, segment_scan, segmentation_warnings
from heartcase.schemas.errors import MarkerError, StageError
from heartcase.schemas.geometry import Geometry
from heartcase.schemas.labels import Label, LabelTable, Role
from heartcase.schemas.recipe.settings import SegmentSettings, ThresholdRange

TABLE = LabelTable(
    labels=(
        Label(value=3, name="left ventricle", role=Role.BLOOD),
        Label(value=7, name="left ventricular myocardium", role=Role.MYOCARDIUM),
    )
)
SPACING = (1.0, 1.5, 2.0)


def make_scan(values, spacing=SPACING):
    values = np.asarray(values, np.float32)
    return Scan(values=values, geometry=Geometry.of(shape=values.shape, spacing_mm=spacing))


def no_markers(scan):
    return np.full(scan.geometry.shape, UNMARKED, np.uint8)


def shells(shape=(24, 32, 48)):
    """Blood of 11 mm radius in a muscle of 19 mm around the middle; the truth is a formula."""
    geometry = Geometry.of(shape=shape, spacing_mm=SPACING)
    middle = geometry.index_to_world((np.array(geometry.size) - 1) / 2)
    k, j, i = np.indices(shape)
    radius = np.linalg.norm(geometry.index_to_world(np.stack([i, j, k], -1)) - middle, axis=-1)
    truth = np.where(radius < 11.0, 3, np.where(radius < 19.0, 7, 0)).astype(np.uint8)
    level = np.array([40.0, 0, 0, 300.0, 0, 0, 0, 120.0])[truth]
    return truth, radius, make_scan(ndimage.gaussian_filter(level, 0.5))


def test_watershed_finds_the_shells_from_a_few_marked_voxels():
    truth, radius, scan = shells()
    labels = no_markers(scan)
    labels[radius < 2.0] = 3
    labels[np.abs(radius - 15.0) < 0.7] = 7
    labels[radius > 24.0] = 0
    markers = Markers(labels=labels, geometry=scan.geometry)
    got = segment_scan(scan, markers, SegmentSettings(), TABLE)
    assert got.geometry == scan.geometry
    assert got.table == TABLE
    # the divide is the steepest place: within half a voxel (1 mm along z) of the true border, and a rounding voxel
    wrong = got.labels != truth
    distance = np.minimum(np.abs(radius - 11.0), np.abs(radius - 19.0))
    assert distance[wrong].max() <= 2.0
    for value in (3, 7):
        both = np.count_nonzero((got.labels == value) & (truth == value))
        dice = 2 * both / (np.count_nonzero(got.labels == value) + np.count_nonzero(truth == value))
        assert dice > 0.9


def test_a_marked_voxel_keeps_its_label_by_either_method():
    _, radius, scan = shells()
    labels = no_markers(scan)
    labels[radius < 2.0] = 3
    labels[radius > 24.0] = 0
    labels[12, 16, 24] = 7
    markers = Markers(labels=labels, geometry=scan.geometry)
    ranges = (ThresholdRange(label="left ventricle", lower=200.0),)
    for settings in (SegmentSettings(), SegmentSettings(method="threshold", ranges=ranges, smallest_piece_ml=0.1)):
        got = segment_scan(scan, markers, settings, TABLE).labels
        marked = labels != UNMARKED
        np.testing.assert_array_equal(got[marked], labels[marked])


def test_thresholds_include_their_bounds_and_the_first_range_wins():
    scan = make_scan(np.arange(-2, 10).reshape(1, 3, 4))
    ranges = (
        ThresholdRange(label="left ventricle", lower=4.0, upper=6.0),
        ThresholdRange(label="Left Ventricular Myocardium", lower=6.0),
        ThresholdRange(label="left ventricular myocardium", upper=-1.0),
    )
    got = segment_scan(scan, None, SegmentSettings(method="threshold", ranges=ranges), TABLE)
    assert got.labels.ravel().tolist() == [7, 7, 0, 0, 0, 0, 3, 3, 3, 7, 7, 7]


def test_blood_hangs_together_over_faces_and_tissue_over_corners():
    diagonal = np.zeros((5, 5, 5), np.uint8)
    diagonal[range(5), range(5), range(5)] = 1
    geometry = Geometry.of(shape=diagonal.shape, spacing_mm=(10.0, 10.0, 10.0))
    for value, left in ((3, 0), (7, 5)):
        got = keep_large_pieces(diagonal * np.uint8(value), geometry, TABLE, smallest_piece_ml=2.0)
        assert np.count_nonzero(got) == left
    untouched = keep_large_pieces(diagonal * np.uint8(3), geometry, TABLE, smallest_piece_ml=1.0)
    assert np.count_nonzero(untouched) == 5


def test_small_pieces_go_as_scipy_counts_them_but_marked_ones_stay():
    values = np.random.default_rng(5).normal(size=(14, 15, 16))
    scan = make_scan(ndimage.gaussian_filter(values, 1.0), (2.0, 2.0, 2.0))
    limit = float(np.quantile(scan.values, 0.8))
    ranges = (ThresholdRange(label="left ventricle", lower=limit),)
    above = scan.values >= limit
    pieces, count = ndimage.label(above)
    sizes = np.bincount(pieces.ravel())
    big = np.flatnonzero(sizes * 0.008 >= 0.1)[1:]
    assert 0 < len(big) < count
    small = next(n for n in range(1, count + 1) if n not in big)
    labels = no_markers(scan)
    labels.flat[np.flatnonzero(pieces == small)[0]] = 3
    markers = Markers(labels=labels, geometry=scan.geometry)
    settings = SegmentSettings(method="threshold", ranges=ranges, smallest_piece_ml=0.1)
    np.testing.assert_array_equal(segment_scan(scan, None, settings, TABLE).labels == 3, np.isin(pieces, big))
    np.testing.assert_array_equal(
        segment_scan(scan, markers, settings, TABLE).labels == 3, np.isin(pieces, [*big, small])
    )


def test_wrong_input_is_refused_in_plain_words():
    scan = make_scan(np.zeros((3, 4, 5)))
    empty = Markers(labels=no_markers(scan), geometry=scan.geometry)
    for markers in (None, empty):
        with pytest.raises(MarkerError, match="no voxel of the scan is marked"):
            segment_scan(scan, markers, SegmentSettings(), TABLE)
    shifted = scan.geometry.model_copy(update={"origin_mm": (1.0, 0.0, 0.0)})
    with pytest.raises(MarkerError, match="another lattice"):
        segment_scan(scan, Markers(labels=empty.labels, geometry=shifted), SegmentSettings(), TABLE)
    unknown = no_markers(scan)
    unknown[0, 0, :2] = 4, 9
    with pytest.raises(MarkerError, match=r"value 4, 9 is not in the label table \(0 background, 3 left ventricle"):
        segment_scan(scan, Markers(labels=unknown, geometry=scan.geometry), SegmentSettings(), TABLE)
    with pytest.raises(StageError, match="finished segmentation"):
        segment_scan(scan, None, SegmentSettings(method="labels", file="labels.nrrd"), TABLE)
    bad = make_scan(np.full((3, 4, 5), np.nan))
    ranges = (ThresholdRange(label="left ventricle", lower=0.0),)
    with pytest.raises(StageError, match="60 voxels of the scan are NaN"):
        segment_scan(bad, None, SegmentSettings(method="threshold", ranges=ranges), TABLE)


def test_warnings_name_what_is_absent_and_what_is_in_pieces():
    scan = make_scan(np.zeros((3, 4, 50)), (1.0, 1.0, 1.0))
    labels = no_markers(scan)
    labels[1, 1, 0] = 3
    markers = Markers(labels=labels, geometry=scan.geometry)
    got = segment_scan(scan, markers, SegmentSettings(), TABLE)
    warnings = segmentation_warnings(got, markers, filtered=scan)
    assert warnings[0].text.startswith("the scan has the same intensity everywhere")
    assert warnings[1].text.startswith("nothing is marked as background")
    (absent,) = warnings[2:]
    assert absent.text.startswith("the left ventricular myocardium is not in the model, as nothing was painted for it")
    by_an_edit = {TABLE["left ventricular myocardium"].value}
    assert segmentation_warnings(got, markers, filtered=scan, made_later=by_an_edit) == warnings[:2]

    blood = np.zeros(scan.geometry.shape, np.uint8)
    blood[:, :, 10:20] = 3
    blood[0, 0, [0, 2, 4, 6]] = 3
    blood[:2, :2, 47:] = 3
    warnings = segmentation_warnings(Segmentation(labels=blood, geometry=scan.geometry, table=TABLE))
    absent, pieces = warnings
    assert absent.text.startswith(
        "the left ventricular myocardium is not in the model, as no part of the scan was found"
    )
    assert pieces.text.startswith(
        "the left ventricle is in 6 pieces; beside the largest: 0.012 ml near (47, 0, 0) mm, "
        "0.001 ml near (0, 0, 0) mm, 0.001 ml near (2, 0, 0) mm and 2 more: "
    )


def test_nothing_to_say_of_a_sound_segmentation():
    truth, _, scan = shells()
    assert segmentation_warnings(Segmentation(labels=truth, geometry=scan.geometry, table=TABLE), filtered=scan) == ()
