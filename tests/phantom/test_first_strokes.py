"""From few to many short strokes."""

from collections import Counter
from itertools import pairwise

import numpy as np
import pytest

from heartcase.phantom.anatomy.heart import HeartPhantom
from heartcase.phantom.drawing.strokes import LONGEST_SHORT_STROKE_MM, first_strokes, random_strokes
from heartcase.schemas.errors import UsageError
from tests.phantom.test_strokes import segment_points

COUNTS = (1, 3, 10)


@pytest.fixture(scope="module")
def drawn():
    phantom = HeartPhantom.child()
    return phantom, {count: first_strokes(phantom, count) for count in COUNTS}


def length_mm(stroke):
    return float(np.linalg.norm(np.diff(np.array(stroke.points_mm), axis=0), axis=1).sum())


def test_every_label_gets_up_to_so_many_short_thin_strokes(drawn):
    phantom, sets = drawn
    for count, strokes in sets.items():
        counts = Counter(phantom.table[stroke.label].value for stroke in strokes)
        assert set(counts) == set(phantom.table.values)
        assert max(counts.values()) == count
        assert all(0.0 < stroke.radius_mm <= 2.0 for stroke in strokes)
        # Coordinates are rounded to 0.1 mm.
        assert all(length_mm(stroke) <= LONGEST_SHORT_STROKE_MM + 1.0 for stroke in strokes)


def test_fewer_strokes_are_among_more(drawn):
    _, sets = drawn
    for few, many in pairwise(COUNTS):
        assert set(sets[few]) < set(sets[many])


def test_strokes_stay_inside_their_structures(drawn):
    phantom, sets = drawn
    for stroke in sets[10]:
        value = phantom.table[stroke.label].value
        labels = phantom.truth.label(segment_points(np.array(stroke.points_mm)))
        allowed = [0, phantom.truth.table.wall_value(2)] if value == 0 else [value]
        assert np.isin(labels, allowed).all(), stroke.label


def test_the_first_stroke_is_nearer_to_the_middle_than_the_second(drawn):
    phantom, sets = drawn
    for label in phantom.table:
        points = [np.array(stroke.points_mm) for stroke in sets[10] if stroke.label == label.name]
        points = points or [
            np.array(stroke.points_mm) for stroke in sets[10] if phantom.table[stroke.label].value == label.value
        ]
        if len(points) < 2:
            continue
        dense = [segment_points(line, 1.0) for line in points]
        middle = np.concatenate(dense).mean(axis=0)
        off = [np.linalg.norm(line - middle, axis=1).mean() for line in dense]
        assert off[0] <= off[1] + 3.0, label.name


def test_no_stroke_at_all_is_refused():
    with pytest.raises(UsageError, match="at least one stroke"):
        first_strokes(HeartPhantom.child(), 0)


def test_random_strokes_are_some_of_the_ordered_ones_and_others_for_another_seed(drawn):
    phantom, _ = drawn
    every = set(first_strokes(phantom, 1000))
    some, same, other = (random_strokes(phantom, 3, seed) for seed in (1, 1, 2))
    assert some == same != other
    for strokes in (some, other):
        assert set(strokes) <= every
        assert len(set(strokes)) == len(strokes)
        assert max(Counter(stroke.label for stroke in strokes).values()) == 3
    with pytest.raises(UsageError, match="at least one stroke"):
        random_strokes(phantom, 0, 1)
