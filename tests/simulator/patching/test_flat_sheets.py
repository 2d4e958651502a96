"""Sheets over outlines: triangles that fill them, least area, and flat without stretch where that is possible."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from heartcase.schemas.errors import SimulationError
from heartcase.simulator.patching.flat_sheets import flat_sheet, resampled
from heartcase.simulator.patching.triangulation import signed_area, triangulated

ANGLE = np.arange(20) / 20 * 2 * np.pi
CIRCLE = np.stack([6 * np.cos(ANGLE), 6 * np.sin(ANGLE), np.zeros(20)], axis=1)


def turned(points, seed):
    """Points turned and moved at random."""
    rng = np.random.default_rng(seed)
    turn = np.linalg.qr(rng.normal(size=(3, 3)))[0]
    return points @ turn.T + rng.normal(size=3) * 50


def areas(points, triangles):
    """Area of each triangle, with its sign in the plane."""
    one, other = points[triangles[:, 1]] - points[triangles[:, 0]], points[triangles[:, 2]] - points[triangles[:, 0]]
    if points.shape[1] == 3:
        return 0.5 * np.linalg.norm(np.cross(one, other), axis=1)
    return 0.5 * (one[:, 0] * other[:, 1] - one[:, 1] * other[:, 0])


@settings(max_examples=60, deadline=None)
@given(st.integers(8, 40), st.integers(0, 2**32 - 1))
def test_triangles_fill_an_outline_once_and_are_delaunay(count, seed):
    """Outlines around a point, smooth and not: areas add up, all point up, and no vertex lies in another's circle."""
    rng = np.random.default_rng(seed)
    angle = 2 * np.pi * np.arange(count) / count
    wave = sum(rng.uniform(-0.12, 0.12) * np.cos(k * angle + rng.uniform(0, 6)) for k in (1, 2, 3))
    rim = (1 + wave)[:, None] * np.stack([np.cos(angle), np.sin(angle)], axis=1)
    vertices, triangles = triangulated(rim, 2 * np.pi / count)
    area = areas(vertices, triangles)
    assert (area > 0).all()
    assert area.sum() == pytest.approx(signed_area(rim), rel=1e-9)
    np.testing.assert_array_equal(vertices[:count], rim)
    corners = vertices[triangles]
    one, other = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    square = np.stack([(one**2).sum(axis=1), (other**2).sum(axis=1)], axis=1)
    middle = 0.5 * np.linalg.solve(np.stack([one, other], axis=1), square[..., None])[..., 0]
    away = np.linalg.norm(vertices[None, count:] - (corners[:, 0] + middle)[:, None], axis=2)
    assert (away >= np.linalg.norm(middle, axis=1)[:, None] * (1 - 1e-3)).all()


@pytest.mark.parametrize("seed", range(4))
def test_a_flat_outline_is_laid_out_as_it_is(seed):
    sheet = flat_sheet(turned(CIRCLE, seed))
    assert sheet.stretch_least == pytest.approx(1.0, abs=1e-6)
    assert sheet.stretch_most == pytest.approx(1.0, abs=1e-6)
    assert sheet.area_mm2 == pytest.approx(10 * 36 * np.sin(2 * np.pi / 20), rel=1e-6)
    assert sheet.perimeter_mm == pytest.approx(20 * 12 * np.sin(np.pi / 20), rel=1e-6)
    assert flat_sheet(turned(CIRCLE, seed), scale=0.9).area_mm2 == pytest.approx(0.81 * sheet.area_mm2, rel=1e-9)
    np.testing.assert_allclose(sheet.spanned_mm[:20], turned(CIRCLE, seed))
    flat, spanned = (areas(points, sheet.triangles) for points in (sheet.flat_mm, sheet.spanned_mm))
    np.testing.assert_allclose(flat, spanned, rtol=1e-5)


def test_the_sheet_over_a_saddle_has_least_area_and_cannot_lie_flat():
    """What it is stretched by grows with the square of the saddle's height, as its curvature both ways does."""
    distortions = []
    for height in (0.4, 0.8):
        saddle = CIRCLE + np.stack([0 * ANGLE, 0 * ANGLE, height * np.cos(2 * ANGLE)], axis=1)
        sheet = flat_sheet(saddle)
        least = areas(sheet.spanned_mm, sheet.triangles).sum()
        for seed in range(20):
            moved = sheet.spanned_mm.copy()
            moved[20:] += 0.05 * np.random.default_rng(seed).normal(size=moved[20:].shape)
            assert areas(moved, sheet.triangles).sum() > least
        assert sheet.stretch_least < 1 < sheet.stretch_most
        distortions.append(sheet.stretch_most - sheet.stretch_least)
    assert distortions[1] / distortions[0] == pytest.approx(4.0, rel=0.1)


@pytest.mark.parametrize("seed", range(2))
def test_an_outline_that_winds_is_laid_out_too(seed):
    """A ribbon that winds around a cylinder: seen from its front it crosses itself; it is as long as it lies flat."""
    radius, width, turns, climb = 10.0, 4.0, 0.8, 3.0
    arc = np.linspace(-1.0, 1.0, 33) * np.pi * turns
    side = np.stack([radius * np.sin(arc), climb * arc, radius * np.cos(arc)], axis=1)
    across = np.array([0.0, width, 0.0])
    middle = 0.5 * across
    rim = np.concatenate([side - middle, side[-1:], side[::-1] + middle, side[:1]])
    sheet = flat_sheet(turned(rim, seed))
    along, around = 2 * np.pi * turns * np.hypot(radius, climb), 2 * np.pi * turns * radius
    assert sheet.perimeter_mm == pytest.approx(2 * (along + width), rel=0.02)
    # Between both arcs it is a little nearer to the cylinder's axis than they are.
    assert 0.95 * around * width < sheet.area_mm2 < around * width
    assert 0.93 < sheet.stretch_least < sheet.stretch_most < 1.07


def test_an_outline_is_resampled_evenly():
    square = resampled([(0, 0, 0), (8, 0, 0), (8, 8, 0), (0, 8, 0)], 2.1)
    assert len(square) == 15
    ways = np.linalg.norm(np.roll(square, -1, axis=0) - square, axis=1)
    assert (ways <= 32 / 15 + 1e-12).all()
    assert len(resampled([(0, 0, 0), (1, 0, 0), (0, 1, 0)], 50.0)) == 6


def test_outlines_that_are_no_loop_are_refused():
    eight = CIRCLE.copy()
    eight[:, 1] = 3 * np.sin(2 * ANGLE)
    for outline, message in (
        (eight, "no area|crosses itself"),
        (CIRCLE * (1, 0, 1), "no area"),
        (CIRCLE[[0, 5, 2, 7, 4, 9, 14, 18]], "crosses itself"),
        (CIRCLE[np.r_[0, 0:20]], "in one place"),
    ):
        with pytest.raises(SimulationError, match=message):
            flat_sheet(outline)
