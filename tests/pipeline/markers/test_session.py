import itertools
from unittest.mock import patch

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from heartcase.pipeline.data import Markers, Scan
from heartcase.pipeline.markers.load_markers import rasterise_strokes
from heartcase.pipeline.markers.session import SegmentationSession
from heartcase.pipeline.watershed import voxel_labels
from heartcase.pipeline.watershed.segment_scan import segment_scan
from heartcase.schemas.errors import MarkerError, UsageError
from heartcase.schemas.geometry import Geometry
from heartcase.schemas.labels import Label, LabelTable, Role
from heartcase.schemas.recipe.settings import SegmentSettings, Stroke

SHAPE = (9, 11, 13)
SPACING = (0.8, 1.1, 2.0)
GEOMETRY = Geometry.of(shape=SHAPE, spacing_mm=SPACING)
TABLE = LabelTable(
    labels=(
        Label(value=3, name="left ventricle", role=Role.BLOOD),
        Label(value=5, name="aorta", role=Role.VESSEL_LUMEN),
        Label(value=7, name="left ventricular myocardium", role=Role.MYOCARDIUM),
    )
)
NAMES = ["background", "left ventricle", "aorta", "left ventricular myocardium"]


def scan(seed, levels=None):
    random = np.random.default_rng(seed)
    values = random.normal(0.0, 100.0, SHAPE) if levels is None else random.integers(0, levels, SHAPE)
    return Scan(values=values.astype(np.float32), geometry=GEOMETRY)


def world(index):
    return tuple(float(x) for x in GEOMETRY.index_to_world(index))


points = st.tuples(*(st.floats(-0.4, n - 0.6) for n in GEOMETRY.size)).map(world)
strokes = st.builds(
    lambda name, radius, line: Stroke(label=name, radius_mm=radius, points_mm=line, erase=name is None),
    st.sampled_from([*NAMES, None]),
    st.floats(0.0, 2.5),
    st.lists(points, min_size=1, max_size=3).map(tuple),
)
further = st.lists(points, min_size=1, max_size=3).map(tuple)
deeds = st.lists(st.one_of(strokes, further, st.sampled_from(["undo", "redo", "take"])), max_size=14)


@settings(max_examples=120, deadline=None)
@given(seed=st.integers(0, 1000), levels=st.sampled_from([None, 2, 5]), deeds=deeds)
def test_after_any_deeds_it_holds_what_its_strokes_give_from_scratch(seed, levels, deeds):
    source = scan(seed, levels)
    start = rasterise_strokes([Stroke(label="aorta", points_mm=(world((2, 3, 4)),))], TABLE, GEOMETRY)
    session = SegmentationSession.of_scan(source, TABLE, markers=Markers(start, GEOMETRY))
    held, undone = [], []
    shown = session.labels.copy()
    for deed in deeds:
        if deed == "undo":
            if held:
                session.undo()
                undone.append(held.pop())
            else:
                with pytest.raises(UsageError, match="no stroke"):
                    session.undo()
        elif deed == "redo":
            if undone:
                session.redo()
                held.append(undone.pop())
            else:
                with pytest.raises(UsageError, match="no stroke"):
                    session.redo()
        elif deed == "take":
            box = session.take_changed()
            outside = np.ones(SHAPE, bool)
            if box is not None:
                outside[box] = False
            np.testing.assert_array_equal(session.labels[outside], shown[outside])
            shown = session.labels.copy()
        elif isinstance(deed, tuple):
            if held and not undone:
                session.extend(deed)
                held[-1] = held[-1].model_copy(update={"points_mm": held[-1].points_mm + deed})
            else:
                with pytest.raises(UsageError, match="no stroke to go on with"):
                    session.extend(deed)
        else:
            session.paint(deed)
            held.append(deed)
            undone.clear()
    assert session.strokes == tuple(held)
    assert session.redo_count == len(undone)
    marked = start.copy()
    for stroke in held:
        value = 255 if stroke.erase else TABLE[stroke.label].value
        marked[rasterise_strokes([Stroke(label="aorta", **line_of(stroke))], TABLE, GEOMETRY) == 5] = value
    np.testing.assert_array_equal(session.markers().labels, marked)
    if (marked == 255).all():
        assert (session.labels == 255).all()
    else:
        fresh = segment_scan(source, Markers(marked, GEOMETRY), SegmentSettings(), TABLE)
        np.testing.assert_array_equal(session.labels, fresh.labels)


def line_of(stroke):
    return {"radius_mm": stroke.radius_mm, "points_mm": stroke.points_mm}


def test_slices_and_boxes_are_copies_of_the_labels():
    session = SegmentationSession.of_scan(scan(1), TABLE)
    session.paint(Stroke(label="aorta", points_mm=(world((1, 1, 1)),)))
    session.paint(Stroke(label="background", points_mm=(world((11, 9, 7)),)))
    for axis, place in zip("ijk", (2, 1, 0), strict=True):
        cut = session.labels_of_slice(axis, 3)
        np.testing.assert_array_equal(cut, np.take(session.labels, 3, axis=place))
    box = (slice(1, 4), slice(0, 5), slice(2, 3))
    part = session.labels_of_box(box)
    np.testing.assert_array_equal(part, session.labels[box])
    part[:] = 9
    assert not (session.labels == 9).any()
    with pytest.raises(ValueError, match="read-only"):
        session.labels[0, 0, 0] = 1
    with pytest.raises(UsageError, match="no slice 11 along j"):
        session.labels_of_slice("j", 11)
    with pytest.raises(UsageError, match="no axis 'x'"):
        session.labels_of_slice("x", 0)


def test_what_cannot_be_painted_changes_nothing():
    session = SegmentationSession.of_scan(scan(2), TABLE)
    with pytest.raises(MarkerError, match="no voxel of the scan is marked"):
        session.segmentation()
    session.paint(Stroke(label="aorta", points_mm=(world((1, 1, 1)),)))
    session.paint(Stroke(label="background", points_mm=(world((9, 9, 5)),)))
    session.undo()
    before = session.labels.copy()
    for stroke, message in (
        (Stroke(label="aorta", points_mm=((900.0, 0.0, 0.0),)), "lies outside the scan"),
        (Stroke(erase=True, points_mm=((900.0, 0.0, 0.0),)), "the eraser's stroke lies outside"),
        (Stroke(label="spleen", points_mm=(world((1, 1, 1)),)), "no label 'spleen'"),
    ):
        with pytest.raises(MarkerError, match=message):
            session.paint(stroke)
    np.testing.assert_array_equal(session.labels, before)
    # a stroke that was refused does not end what can be painted again
    assert session.redo_count == 1
    session.redo()
    assert session.segmentation().labels.max() == 5


def test_markers_that_do_not_fit_are_refused():
    tree = SegmentationSession.of_scan(scan(3), TABLE)._forest.tree
    strange = np.full(SHAPE, 255, np.uint8)
    strange[0, 0, 0] = 99
    with pytest.raises(MarkerError, match="value 99"):
        SegmentationSession(tree, GEOMETRY, TABLE, markers=Markers(strange, GEOMETRY))
    moved = GEOMETRY.model_copy(update={"origin_mm": (5.0, 0.0, 0.0)})
    with pytest.raises(MarkerError, match="another lattice"):
        SegmentationSession(tree, GEOMETRY, TABLE, markers=Markers(np.full(SHAPE, 255, np.uint8), moved))
    with pytest.raises(UsageError, match="another scan"):
        SegmentationSession(tree, Geometry.of(shape=(3, 3, 3), spacing_mm=SPACING), TABLE)


def test_redo_is_forgotten_after_a_new_stroke():
    session = SegmentationSession.of_scan(scan(4), TABLE)
    one, other, third = (
        Stroke(label=n, points_mm=(world((i, 5, 4)),)) for i, n in zip((2, 6, 10), NAMES, strict=False)
    )
    for stroke in itertools.chain((one, other)):
        session.paint(stroke)
    session.undo()
    session.paint(third)
    assert session.strokes == (one, third)
    with pytest.raises(UsageError, match="no stroke"):
        session.redo()


def test_a_stroke_goes_on_with_points_only():
    session = SegmentationSession.of_scan(scan(4), TABLE)
    session.paint(Stroke(label="aorta", points_mm=(world((2, 5, 4)),)))
    before = session.markers().labels
    for points_mm, message in (([], "at least one point"), ([(np.nan, 0.0, 0.0)], "finite"), ([(1.0,)], "points_mm")):
        with pytest.raises(MarkerError, match=message):
            session.extend(points_mm)
    np.testing.assert_array_equal(session.markers().labels, before)
    # it may leave the scan, and come back
    session.extend([(900.0, 0.0, 0.0), world((9, 5, 4))])
    assert session.markers().labels[4, 5, 9] == 5
    session.undo()
    assert (session.markers().labels == 255).all()


@pytest.mark.parametrize("one_by_one", [0, 10**9])
def test_what_is_put_off_counts_as_changed_and_boxes_are_taken_as_numpy_takes_them(one_by_one):
    def painted(*, puts_off):
        session = SegmentationSession.of_scan(scan(1), TABLE)
        if puts_off:
            session.put_off()
        session.paint(Stroke(label="aorta", points_mm=(world((1, 1, 1)),)))
        session.take_changed()
        session.paint(Stroke(label="background", points_mm=(world((11, 9, 7)),)))
        return session

    boxes = [np.s_[:, 3:5, :], np.s_[2:900, -3:, 4:], np.s_[5:2, :, :], np.s_[::2, :, 8:2:-1], np.s_[20:30, :, :]]
    with patch.multiple(voxel_labels, MOST_AT_ONCE=0, MOST_LISTED=10**9, MOST_ONE_BY_ONE=one_by_one):
        plain = painted(puts_off=False)
        for box in boxes:
            session = painted(puts_off=True)
            assert session.put_off_tiles.any()
            np.testing.assert_array_equal(session.labels_of_box(box), plain.labels[box])
        before = SegmentationSession.of_scan(scan(1), TABLE)
        before.paint(Stroke(label="aorta", points_mm=(world((1, 1, 1)),)))
        session = painted(puts_off=True)
        outside = np.ones(SHAPE, bool)
        changed = session.take_changed()
        assert changed is not None
        outside[changed] = False
        np.testing.assert_array_equal(session.labels[outside], before.labels[outside])
        assert (session.labels != before.labels).any()
