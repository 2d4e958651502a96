"""The picture of several histograms: every curve where its numbers say, ticks at round values, all names in the key."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from heartcase.pipeline.report.histogram import Curve, _pieces, _ticks, histogram_picture

EDGES = np.linspace(0.0, 12.0, 13)


def frame(picture):
    """Left, right, top and bottom of the axes: the longest dark row and column."""
    dark = picture.max(axis=2) < 80
    bottom, left = int(dark.sum(axis=1).argmax()), int(dark[:300].sum(axis=0).argmax())
    columns, rows = np.flatnonzero(dark[bottom]), np.flatnonzero(dark[:, left])
    return left, columns[-1], rows[0], bottom


def test_the_highest_step_of_a_curve_stands_where_its_number_says():
    heights = np.array([0.0, 0, 3, 8, 20, 6, 1, 0, 0, 0, 0, 0])
    picture = histogram_picture([Curve("one", "#ff0000", heights)], EDGES, across="thickness", up="area")
    assert picture.shape == (340, 800, 3)
    left, right, top, bottom = frame(picture)
    red = (picture[..., 0].astype(int) - picture[..., 1] > 150) & (np.arange(800) < 600)
    rows, columns = np.nonzero(red)
    high = columns[rows <= rows.min() + 1]
    per_mm = (right - left) / 12.0
    assert (high.min() - left) / per_mm == pytest.approx(4.0, abs=0.08)
    assert (high.max() - left) / per_mm == pytest.approx(5.0, abs=0.08)
    # 20 of the 21 that the frame shows; of a step of 8 the row in its middle.
    assert (bottom - rows.min() - 1) / (bottom - top) == pytest.approx(20.0 / 21.0, abs=0.01)
    middle = round(left + 3.5 * per_mm)
    assert (bottom - np.flatnonzero(red[:, middle])[0] - 1) / (bottom - top) == pytest.approx(8.0 / 21.0, abs=0.01)


def test_every_curve_has_its_colour_and_its_name_in_the_key():
    colours = ("#ff0000", "#00aa00", "#0000ff", "#aa00aa")
    curves = [Curve("a name of some length", one, np.arange(12.0)[::-1]) for one in colours]
    picture = histogram_picture(curves, EDGES, across="x", up="y").astype(int)
    key = picture[:100, 500:]
    found = [np.abs(key - [int(one[n : n + 2], 16) for n in (1, 3, 5)]).max(axis=2) < 8 for one in colours]
    rows = [np.flatnonzero(one.any(axis=1)).mean() for one in found]
    assert all(one.sum() > 15 for one in found)
    assert np.diff(rows) == pytest.approx([17.0] * 3, abs=1.0)
    # Names end before the picture does.
    assert (picture[:280, 788:] == 255).all()


def test_nothing_to_draw_is_an_empty_frame():
    picture = histogram_picture([], EDGES, across="x", up="y")
    left, right, top, bottom = frame(picture)
    assert (picture[top + 2 : bottom - 2, left + 2 : right] == 255).all()
    flat = histogram_picture([Curve("none", "#ff0000", np.zeros(12))], EDGES, across="x", up="y")
    assert frame(flat) == (left, right, top, bottom)


@given(st.floats(0.01, 5e4))
def test_ticks_are_round_evenly_spaced_and_not_too_many(high):
    ticks = _ticks(0.0, high)
    assert ticks[0] == 0.0
    assert 3 <= len(ticks) <= 10
    assert ticks[-1] <= high * (1 + 1e-9)
    step = ticks[1]
    assert np.allclose(np.diff(ticks), step)
    assert f"{step:e}"[0] in "125"


def test_dashes_follow_the_path_and_have_their_length():
    path = np.array([[0.0, 0.0], [10.0, 0.0], [10.0, 40.0], [10.0, 40.0], [50.0, 40.0]])
    for number, (line, gap) in ((1, (9.0, 4.0)), (2, (2.5, 4.0))):
        pieces = _pieces(path, number)
        lengths = np.hypot(pieces[:, 2] - pieces[:, 0], pieces[:, 3] - pieces[:, 1])
        assert lengths.sum() == pytest.approx(90.0 * line / (line + gap), abs=line)
        straight = (pieces[:, 0] == pieces[:, 2]) | (pieces[:, 1] == pieces[:, 3])
        assert straight.all()
    assert len(_pieces(path, 0)) == 4
