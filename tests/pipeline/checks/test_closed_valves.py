"""Atria and great arteries that are open to no ventricle, in balls and boxes whose gaps are known."""

import numpy as np
import pytest

from heartcase.pipeline.bundle.assembly import labels_of
from heartcase.pipeline.checks.closed_valves import closed_valve_warnings
from heartcase.pipeline.checks.openings import find_openings
from heartcase.pipeline.warning_words import recognised
from heartcase.pipeline.warnings import WarningGrade
from heartcase.schemas.labels import Label, LabelTable, Role
from tests.pipeline.checks.test_openings import structures_of
from tests.pipeline.lattices import LATTICES, lattice, points_of


def boxes(names, gaps_mm, kind="even"):
    """Boxes of 12 x 12 x 10 mm one above another, with muscle in the gaps; structures of them, from the feet up."""
    geometry = lattice(kind, 52.0)
    points = points_of(geometry)
    is_across = (np.abs(points[..., 0]) < 6.0) & (np.abs(points[..., 1]) < 6.0)
    is_near = (np.abs(points[..., :2]) < 9.0).all(axis=-1) & (np.abs(points[..., 2]) < 24.0)
    labels, bottom = np.where(is_near, len(names) + 1, 0), -20.0
    for number, gap in enumerate((*gaps_mm, 0.0), start=1):
        labels[is_across & (points[..., 2] >= bottom) & (points[..., 2] < bottom + 10.0)] = number
        bottom += 10.0 + gap
    table = [Label(value=number, name=name, role=Role.BLOOD) for number, name in enumerate(names, start=1)]
    muscle = Label(value=len(names) + 1, name="myocardium", role=Role.MYOCARDIUM)
    return structures_of(labels, geometry, LabelTable(labels=(*table, muscle)))


def told(structures):
    labels = labels_of(structures)
    return closed_valve_warnings(labels, find_openings(structures, labels))


@pytest.mark.parametrize("kind", LATTICES)
def test_an_atrium_that_does_not_meet_its_ventricle_is_told_with_the_gap_and_the_place(kind):
    (one,) = told(boxes(("right ventricle", "right atrium"), (6.0,), kind))
    assert (one.code, one.grade) == ("valve-closed", WarningGrade.LOOK)
    assert one.text.startswith("the right atrium is open to no ventricle")
    found = recognised(one.text)
    assert found is not None
    assert (found.values["one"], found.values["other"]) == ("right atrium", "right ventricle")
    # Between the centres of voxels: a voxel more than the gap.
    assert 6.0 - 0.5 <= float(found.values["gap"]) <= 6.0 + 3.0
    ((x, y, z),) = one.places_mm
    assert abs(z - (-7.0)) < 1.5
    assert max(abs(x), abs(y)) < 6.5


def test_what_is_open_to_a_ventricle_is_not_told_whichever_ventricle_it_is():
    assert not told(boxes(("right ventricle", "right atrium"), (0.0,)))
    assert not told(boxes(("right ventricle", "aorta"), (0.0,)))
    assert not told(boxes(("left ventricle", "pulmonary artery"), (0.0,)))


def test_an_artery_behind_a_closed_valve_is_told_and_what_opens_beside_it_is_not():
    (one,) = told(boxes(("left atrium", "left ventricle", "aorta"), (0.0, 4.0)))
    assert "the aorta is open to no ventricle" in one.text
    both = told(boxes(("right atrium", "right ventricle", "pulmonary artery"), (5.0, 5.0)))
    assert [line.text.split(" is open")[0] for line in both] == ["the right atrium", "the pulmonary artery"]


def test_nothing_is_said_of_a_model_without_a_ventricle_or_of_what_does_not_open_to_one():
    assert not told(boxes(("superior vena cava", "right atrium"), (4.0,)))
    assert not told(boxes(("left ventricle", "superior vena cava"), (4.0,)))
