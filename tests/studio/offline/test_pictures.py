"""The cut that shows what a case is about."""

import numpy as np
import pytest

from heartcase.schemas.landmarks import Landmark
from heartcase.studio.offline.pictures import lesion_view

APEX = Landmark(name="apex", kind="point", points_mm=[(30.0, -40.0, -30.0)])
HOLE = Landmark(
    name="mid muscular defect", kind="ring", points_mm=[(5.0, -20.0, -10.0)], axis=(-0.6, -0.8, 0.0), radius_mm=4.0
)
VALVE = Landmark(name="aortic valve", kind="point", points_mm=[(0.0, -10.0, 5.0)])
ISTHMUS = Landmark(
    name="aortic isthmus", kind="polyline", points_mm=[(20.0, 40.0, 60.0), (20.0, 50.0, 40.0)], depth_mm=2.0
)


@pytest.mark.parametrize("landmarks", [(APEX, HOLE), (VALVE, ISTHMUS)])
def test_the_cut_holds_what_it_says(landmarks):
    view = lesion_view(landmarks)
    point, normal = view.plane
    assert np.linalg.norm(normal) == pytest.approx(1.0)
    assert view.up @ normal == pytest.approx(0.0, abs=1e-9)
    for landmark in landmarks:
        if landmark.name != "aortic isthmus":
            assert (np.array(landmark.points_mm[0]) - point) @ normal == pytest.approx(0.0, abs=1e-9)
    if HOLE in landmarks:
        assert np.array(HOLE.axis) @ normal == pytest.approx(0.0, abs=1e-9)
        assert "mid muscular defect" in view.source
        assert normal[2] < 0.0
    else:
        assert (np.array(ISTHMUS.points_mm) - point) @ normal == pytest.approx([0.0, 0.0], abs=1e-9)


def test_without_a_lesion_there_is_none():
    assert lesion_view((APEX, VALVE)) is None
    assert lesion_view((HOLE,)) is None
    assert lesion_view(()) is None
    along = HOLE.model_copy(update={"axis": tuple((np.array(APEX.points_mm[0]) - HOLE.points_mm[0]).tolist())})
    assert lesion_view((APEX, along)) is None
