"""Lines in pictures: where they lie, how wide they are, and that borders of labels run half way between the points."""

import numpy as np
import pytest
from contourpy import contour_generator
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from heartcase.pipeline.report.outlines import _borders, draw_lines, draw_outlines


@settings(max_examples=30, deadline=None)
@given(st.floats(12.0, 30.0), st.floats(12.0, 68.0), st.floats(50.0, 68.0), st.floats(12.0, 68.0), st.floats(2.0, 6.0))
def test_a_line_covers_what_is_within_half_its_width(ax, ay, bx, by, width):
    picture = np.zeros((80, 80, 3), np.uint8)
    draw_lines(picture, np.array([[ax, ay, bx, by]]), "#ffffff", width=width)
    # The same at ten by ten places in each pixel, by the distance from a densely sampled line.
    part = (np.arange(10) - 4.5) / 10.0
    row, column = np.meshgrid(*[(np.arange(80.0)[:, None] + part).ravel()] * 2, indexing="ij")
    along, across = np.array([bx - ax, by - ay]), np.array([column - ax, row - ay])
    share = np.clip((along[:, None, None] * across).sum(axis=0) / max(along @ along, 1e-12), 0.0, 1.0)
    distance = np.hypot(across[0] - share * along[0], across[1] - share * along[1])
    covered = (distance <= width / 2.0).reshape(80, 10, 80, 10).mean(axis=(1, 3))
    assert np.abs(picture[..., 0] / 255.0 - covered).max() < 0.2
    assert picture[..., 0].sum() / 255.0 == pytest.approx(covered.sum(), rel=0.06)
    assert (picture[..., 0] == picture[..., 2]).all()


def test_where_pieces_of_a_line_meet_it_is_no_thicker():
    whole, pieces = np.full((2, 20, 60, 3), 255, np.uint8)
    draw_lines(whole, np.array([[5.0, 9.3, 55.0, 11.8]]), "#204060", width=2.5)
    between = np.stack([np.linspace(5.0, 55.0, 11), np.linspace(9.3, 11.8, 11)], axis=1)
    draw_lines(pieces, np.concatenate([between[:-1], between[1:]], axis=1), "#204060", width=2.5)
    assert np.abs(whole.astype(int) - pieces).max() <= 1
    assert tuple(whole[10, 20]) == (0x20, 0x40, 0x60)


def test_what_is_beyond_the_picture_is_left_out():
    picture = np.zeros((10, 12, 3), np.uint8)
    draw_lines(picture, np.array([[-50.0, 4.0, 80.0, 4.0], [3.0, 900.0, 3.0, 800.0]]), "#ff0000", width=2.0)
    assert (picture[4, :, 0] == 255).all()
    assert picture[7:].sum() == 0
    draw_lines(picture, np.zeros((0, 4)), "#00ff00", width=2.0)
    assert picture[..., 1].sum() == 0


labelled = hnp.arrays(
    np.uint8, hnp.array_shapes(min_dims=2, max_dims=2, min_side=2, max_side=9), elements=st.integers(0, 3)
)


@settings(max_examples=60, deadline=None)
@given(labelled)
def test_borders_are_those_of_an_independent_contour(labels):
    rows, columns = labels.shape
    x, y = np.linspace(3.0, 40.0, columns), np.linspace(7.0, 90.0, rows) ** 1.1
    inside = labels == 2
    pieces = _borders(labels, 2, x, y)
    lines = contour_generator(x, y, inside.astype(float)).lines(0.5)
    # Contours of a point that is cut off by itself may be joined either way in a cell: the points are the same.
    wanted = np.concatenate([np.concatenate([line[:-1], line[1:]], axis=1) for line in lines] or [np.zeros((0, 4))])
    ends = [np.sort(np.round(both.reshape(-1, 2), 6), axis=0) for both in (pieces, wanted)]
    assert len(pieces) == len(wanted)
    assert np.array_equal(*ends)
    saddles = (
        (inside[1:, 1:] == inside[:-1, :-1])
        & (inside[1:, :-1] == inside[:-1, 1:])
        & (inside[1:, 1:] != inside[1:, :-1])
    )
    if not saddles.any():
        lengths = [np.sort(np.hypot(both[:, 2] - both[:, 0], both[:, 3] - both[:, 1])) for both in (pieces, wanted)]
        assert np.allclose(*lengths)


def test_later_labels_lie_on_top_and_others_have_no_border():
    labels = np.zeros((20, 20), np.uint8)
    labels[:, :10], labels[:, 10:] = 1, 2
    labels[:3, :3] = 7
    for order in ((1, 2), (2, 1)):
        picture = np.zeros((100, 100, 3), np.uint8)
        at = np.arange(20) * 5.0
        draw_outlines(picture, labels, {value: ("#ff0000", "#0000ff")[value - 1] for value in order}, x=at, y=at)
        top = 0 if order[-1] == 1 else 2
        # The border of both is at column 47.5.
        assert picture[50, 47, top] > 200
        assert picture[50, 47, 2 - top] < 60
        assert picture[..., 1].sum() == 0
