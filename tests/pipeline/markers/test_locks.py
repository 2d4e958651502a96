"""Locked structures, and states of structures, in a painting session."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from heartcase.pipeline.data import Markers
from heartcase.pipeline.markers.load_markers import rasterise_strokes
from heartcase.pipeline.markers.session import SegmentationSession
from heartcase.pipeline.markers.states import StillSegmentation, StructureState, structure_states
from heartcase.pipeline.markers.suggest import RightPlace, StrokePlace, StrokePlaces
from heartcase.pipeline.watershed.segment_scan import segment_scan
from heartcase.schemas.errors import MarkerError, UsageError
from heartcase.schemas.recipe.settings import SegmentSettings, Stroke
from tests.pipeline.markers.test_session import GEOMETRY, NAMES, TABLE, further, scan, strokes, world

acts = st.one_of(strokes, further, st.sampled_from(["undo", "redo"]), st.sets(st.sampled_from(NAMES)))


@settings(max_examples=10, deadline=None)
@given(seed=st.integers(0, 1000), levels=st.sampled_from([None, 3]), deeds=st.lists(acts, max_size=14))
def test_strokes_of_others_leave_every_voxel_of_what_is_locked(seed, levels, deeds):
    source = scan(seed, levels)
    start = rasterise_strokes([Stroke(label="aorta", points_mm=(world((2, 3, 4)),))], TABLE, GEOMETRY)
    session = SegmentationSession.of_scan(source, TABLE, markers=Markers(start, GEOMETRY))
    locked = set()
    for deed in deeds:
        before, marked, state = session.labels.copy(), session.marked.copy(), (session.strokes, session.undone)
        if isinstance(deed, set):
            locked = {TABLE[name].value for name in deed}
            session.lock(locked)
            assert session.locked == locked
            continue
        refusal = ""
        try:
            if isinstance(deed, str):
                session.undo() if deed == "undo" else session.redo()
            elif isinstance(deed, tuple):
                session.extend(deed)
            else:
                session.paint(deed)
        except UsageError:
            continue
        except MarkerError as error:
            refusal = str(error)
        if refusal:
            # nothing changed, of redo neither, and what was refused would have changed something that is locked
            assert "locked" in refusal
            np.testing.assert_array_equal(session.labels, before)
            np.testing.assert_array_equal(session.marked, marked)
            assert (session.strokes, session.undone) == state
            session.lock(())
            session.paint(deed) if isinstance(deed, Stroke) else session.extend(deed)
            own = session.strokes[-1].label
            others = [value for value in locked if own is None or value != TABLE[own].value]
            assert any(((session.labels == value) != (before == value)).any() for value in others)
            session.undo()
            if not isinstance(deed, Stroke):
                session.redo()
                session.undo()
            session.lock(locked := set())
            continue
        if not isinstance(deed, str):
            own = session.strokes[-1].label
            for value in locked - ({TABLE[own].value} if own else set()):
                np.testing.assert_array_equal(session.labels == value, before == value)
    # a lock leaves no trace: the labels are those of the strokes alone
    if (session.marked != 255).any():
        fresh = segment_scan(source, session.markers(), SegmentSettings(), TABLE)
        np.testing.assert_array_equal(session.labels, fresh.labels)


def test_what_a_refusal_says_and_what_is_locked_may_change_itself():
    source = scan(4)
    session = SegmentationSession.of_scan(source, TABLE)
    session.paint(Stroke(label="left ventricle", radius_mm=1.0, points_mm=(world((2, 3, 4)),)))
    session.paint(Stroke(label="background", radius_mm=1.0, points_mm=(world((10, 8, 6)),)))
    session.lock({TABLE["left ventricle"].value})
    over = Stroke(label="aorta", radius_mm=1.0, points_mm=(world((2, 3, 4)),))
    with pytest.raises(MarkerError, match=r"locked: left ventricle \([0-9.e-]+ ml\); unlock it"):
        session.paint(over)
    erases = Stroke(erase=True, radius_mm=9.0, points_mm=(world((2, 3, 4)),))
    with pytest.raises(MarkerError, match="locked"):
        session.paint(erases)
    own = Stroke(label="left ventricle", radius_mm=3.0, points_mm=(world((10, 8, 6)),))
    before = session.labels.copy()
    session.paint(own)
    assert (session.labels != before).any()
    # taken back in spite of the lock
    session.undo()
    np.testing.assert_array_equal(session.labels, before)
    session.redo()
    session.lock(())
    session.paint(over)
    with pytest.raises(UsageError, match="not in the label table"):
        session.lock({99})


def test_states_follow_marks_and_places():
    session = SegmentationSession.of_scan(scan(4), TABLE)
    names = {label.value: label.name for label in TABLE}

    def states(**options):
        return {names[value]: state for value, state in structure_states(session.still(), **options).items()}

    assert set(states().values()) == {StructureState.NOTHING}
    session.paint(Stroke(label="left ventricle", radius_mm=1.0, points_mm=(world((2, 3, 4)),)))
    assert states()["left ventricle"] is StructureState.MARKED
    session.paint(Stroke(label="background", radius_mm=1.0, points_mm=(world((10, 8, 6)),)))
    still = session.still()
    ml = (session.labels == 3).sum() * GEOMETRY.voxel_volume_mm3 / 1000.0
    # worth 3.5% of the volume
    place = StrokePlace((0.0, 0.0, 0.0), 3, 0, 1.0, 0.1, 1.0, 0.035 * ml)
    found = states(places=StrokePlaces((place,), 0.0))
    assert found["left ventricle"] is StructureState.UNSURE
    assert found["aorta"] is StructureState.NOTHING
    sure = StrokePlace((0.0, 0.0, 0.0), 3, 0, 1.0, 0.1, 1.0, 0.01 * ml)
    assert states(places=StrokePlaces((sure,), 0.0))["left ventricle"] is StructureState.CONFIDENT
    # places that were found right make the others count less, while they have the label that they had
    right = [RightPlace(world((2, 3, 4)), 3, 0), RightPlace(world((10, 8, 6)), 0, 3)]
    changed = RightPlace(world((10, 8, 6)), 3, 0)
    for known, state in (
        ((), StructureState.UNSURE),
        # 2/3 of it, and half of it
        ((right[0],), StructureState.UNSURE),
        ((right[0], changed), StructureState.UNSURE),
        (right, StructureState.CONFIDENT),
    ):
        looked_at = replace(still, right=tuple(known))
        assert structure_states(looked_at, places=StrokePlaces((place,), 0.0))[3] is state
    # what was copied stays as it was
    labels = still.forest.labels.copy()
    session.paint(Stroke(label="aorta", radius_mm=3.0, points_mm=(world((6, 6, 5)),)))
    np.testing.assert_array_equal(still.forest.labels, labels)
    assert isinstance(still, StillSegmentation)
    assert structure_states(still).keys() == names.keys()
