"""What triangles cross, against the same question asked in fractions."""

from __future__ import annotations

from fractions import Fraction

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from heartcase.schemas.bundle.lattice import lattice_keys
from heartcase.schemas.errors import SimulationError
from heartcase.simulator.cutting.blade_sheet import Sheet, crossed_links
from heartcase.simulator.cutting.crossings import QUANTA, SAMPLES

PITCH = QUANTA // SAMPLES
SMALL = Fraction(1, 1 << 40)
MOVED = (SMALL**3, SMALL, SMALL**2)
"""A real movement of the samples, so small that only where they lie on a triangle it decides."""

# Corners on and beside the samples' lines and planes, so that every kind of tie is there.
numbers = st.integers(-3, 9).map(lambda half: half * PITCH // 2) | st.integers(-3 * PITCH, 9 * PITCH)
corners = st.lists(st.tuples(numbers, numbers, numbers), min_size=3, max_size=3)


def oracle(triangle, axis: int) -> list[tuple[int, int, int]]:
    """Links of samples -1 to 5 whose moved ends lie on two sides of a triangle, inside its outline."""
    b, c = (axis + 1) % 3, (axis + 2) % 3
    p, q, r = ([Fraction(int(x)) for x in corner] for corner in triangle)

    def area(m, n, at):
        return (n[b] - m[b]) * (at[c] - m[c]) - (n[c] - m[c]) * (at[b] - m[b])

    def place(index):
        return [PITCH * Fraction(int(i)) + PITCH // 2 + moved for i, moved in zip(index, MOVED, strict=True)]

    normal = [
        (q[(a + 1) % 3] - p[(a + 1) % 3]) * (r[(a + 2) % 3] - p[(a + 2) % 3])
        - (q[(a + 2) % 3] - p[(a + 2) % 3]) * (r[(a + 1) % 3] - p[(a + 1) % 3])
        for a in range(3)
    ]
    found = []
    for index in np.ndindex(14, 14, 14):
        index = [i - 4 for i in index]
        start = place(index)
        sides = {area(p, q, start) > 0, area(q, r, start) > 0, area(r, p, start) > 0}
        if normal[axis] == 0 or len(sides) == 2:
            continue
        end = place([i + (a == axis) for a, i in enumerate(index)])
        before, after = (sum(n * (x - y) for n, x, y in zip(normal, at, p, strict=True)) for at in (start, end))
        if (before > 0) != (after > 0):
            found.append(tuple(index))
    return found


@settings(max_examples=60, deadline=None)
@given(corners, st.integers(0, 2))
def test_links_that_a_triangle_crosses_are_those_in_fractions(triangle, axis):
    wanted = np.array(oracle(triangle, axis), dtype=np.int64).reshape(-1, 3)
    found = crossed_links(np.array([triangle], dtype=np.int64), axis)
    assert found.tolist() == sorted(lattice_keys(wanted).tolist())


@settings(deadline=None)
@given(st.lists(st.tuples(numbers, numbers, numbers), min_size=4, max_size=4), st.integers(0, 2))
def test_a_closed_surface_is_left_as_often_as_it_is_entered(tetrahedron, axis):
    """Whatever its corners lie on: each row of samples crosses the four sides of a tetrahedron twice, or never."""
    a, b, c, d = tetrahedron
    sides = np.array([(a, c, b), (a, b, d), (b, c, d), (c, a, d)], dtype=np.int64)
    rows = crossed_links(sides, axis)
    index = np.stack([rows & (1 << 21) - 1, rows >> 21 & (1 << 21) - 1, rows >> 42], axis=1)
    _, counts = np.unique(np.delete(index, axis, axis=1), axis=0, return_counts=True)
    assert set(counts.tolist()) <= {2}


def test_a_triangle_that_is_too_long_for_64_bits_is_taken_in_parts():
    long = Sheet.of_triangles([[[0, 0, 0], [1000, 0, 0.5], [0, 1000, 0.25]]])
    assert len(long.triangles) == 64
    assert np.ptp(long.triangles, axis=1).max() <= 128 * QUANTA
    # n x 1000 / SAMPLES rows in each of two directions, half of a square.
    assert len(crossed_links(long.triangles, 2)) == pytest.approx((1000 * SAMPLES) ** 2 / 2, rel=1e-3)


@pytest.mark.parametrize("poses", [[[0.0, 0.0, 0.0]], np.zeros((2, 1, 3)), np.zeros((1, 2, 3)), np.zeros((2, 2, 2))])
def test_a_blade_needs_two_points_in_two_poses(poses):
    with pytest.raises(SimulationError, match="two points or more in two poses"):
        Sheet.swept(poses)


def test_a_blade_whose_points_are_no_numbers_is_refused():
    poses = np.zeros((2, 2, 3))
    poses[1, 1, 2] = np.nan
    with pytest.raises(SimulationError, match="three finite numbers"):
        Sheet.swept(poses)
