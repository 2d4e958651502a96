"""Defects that a case states without a landmark are measured, too."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

from heartcase.schemas.landmarks import Landmark
from heartcase.simulator.incisions.stated_defects import landmarks_with_defects

STATED = {
    "between": ["morphologically left ventricle", "morphologically right ventricle"],
    "area_mm2": 78.5,
    "verdict": "stated",
    "middle_mm": [1.0, 2.0, 3.0],
    "axis": [0.0, 0.6, 0.8],
}
APEX = Landmark(name="apex", kind="point", points_mm=((0.0, 0.0, 0.0),))


def of(openings, landmarks=(APEX,)):
    return landmarks_with_defects(SimpleNamespace(landmarks=landmarks, quality={"openings": openings}))


def test_a_stated_opening_is_a_ring_as_wide_as_its_area():
    apex, ring = of([STATED])
    assert apex is APEX
    assert (ring.name, ring.kind) == ("left ventricle - right ventricle", "ring")
    assert ring.points_mm == ((1.0, 2.0, 3.0),)
    assert ring.radius_mm == pytest.approx(5.0, abs=0.01)
    np.testing.assert_allclose(ring.axis, (0.0, 0.6, 0.8))


def test_two_of_one_pair_have_names_of_their_own_and_one_with_a_landmark_is_not_doubled():
    away = STATED | {"middle_mm": [30.0, 2.0, 3.0]}
    assert [one.name for one in of([STATED, away])[1:]] == [
        "left ventricle - right ventricle",
        "left ventricle - right ventricle 2",
    ]
    defect = Landmark(
        name="perimembranous defect", kind="ring", points_mm=((2.0, 2.0, 3.0),), axis=(0.0, 0.0, 1.0), radius_mm=4.0
    )
    assert of([STATED], (defect,)) == (defect,)


@pytest.mark.parametrize(
    "other",
    [
        {"verdict": "expected"},
        {"axis": None},
        {"axis": [0.0, 0.0, 0.0]},
        {"middle_mm": [1.0]},
        {"middle_mm": [np.nan, 0.0, 0.0]},
        {"area_mm2": 0.0},
    ],
)
def test_what_is_not_known_well_is_left_out(other):
    assert of([STATED | other]) == (APEX,)


def test_a_case_of_an_older_build_has_none():
    assert of(None) == (APEX,)
    old = {name: value for name, value in STATED.items() if name not in ("middle_mm", "axis")}
    assert of([old]) == (APEX,)


@pytest.mark.parametrize(
    "between", [["Herz-Kammer ä", "x" * 80], ["ä (rest)", "(b)"], ["ä"], [], [7, None], "lv", None]
)
def test_whatever_the_cavities_are_called_it_has_a_name(between):
    assert 0 < len(of([STATED | {"between": between}])[1].name) <= 64


@pytest.mark.parametrize("openings", [7, "stated", {"verdict": "stated"}, [None, 7, "stated", []]])
def test_figures_that_no_build_writes_are_left_out(openings):
    assert of(openings) == (APEX,)
