"""Rotations against SciPy's, and the re-alignment in time."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from heartcase.schemas.errors import UsageError
from heartcase.simulator.haptics.alignment import Alignment, pose_at, segment_times
from heartcase.simulator.haptics.poses import ToolPose, rotation_between, turn_by, vector_of


@pytest.mark.parametrize("angle", [0.0, 1e-10, 1e-5, 0.3, 3.0, np.pi - 1e-5, np.pi - 1e-9, np.pi])
def test_rotations_are_those_of_scipy(angle):
    for axis in np.vstack([np.eye(3), -np.eye(3), np.random.default_rng(2).normal(size=(20, 3))]):
        vector = angle * axis / np.linalg.norm(axis)
        turn = Rotation.from_rotvec(vector).as_matrix()
        np.testing.assert_allclose(turn_by(vector), turn, atol=1e-12)
        np.testing.assert_allclose(turn_by(vector_of(turn)), turn, atol=1e-7)
        assert np.linalg.norm(vector_of(turn)) == pytest.approx(angle, abs=1e-7)


def test_a_gap_leads_from_one_pose_to_the_other():
    one, other = (
        ToolPose(np.array(p), turn_by(np.array(r))) for p, r in (((1, 2, 3), (1, 0, 2)), ((0, 5, 1), (0, 1, 0)))
    )
    moved = one.moved_by(one.gap_to(other))
    np.testing.assert_allclose(moved.position_mm, other.position_mm)
    np.testing.assert_allclose(moved.turn, other.turn, atol=1e-12)
    np.testing.assert_allclose(rotation_between(one.turn, one.turn), 0.0, atol=1e-15)


def test_poses_between_are_in_a_straight_line_and_turn_evenly():
    times, positions = np.array([1.0, 2.0]), np.array([[0.0, 0, 0], [4.0, 0, 0]])
    turns = np.stack([np.eye(3), turn_by(np.array([0, 0, 1.2]))])
    middle = pose_at(times, positions, turns, 1.25)
    np.testing.assert_allclose(middle.position_mm, [1.0, 0, 0])
    np.testing.assert_allclose(middle.turn, Rotation.from_rotvec([0, 0, 0.3]).as_matrix(), atol=1e-12)
    np.testing.assert_array_equal(pose_at(times, positions, turns, 0.0).position_mm, positions[0])
    np.testing.assert_array_equal(pose_at(times, positions, turns, 9.0).position_mm, positions[1])


def segments_of(lengths_s, part_count):
    """Times that the parts of all segments take, and those at which they really run."""
    alignment, now, taken, real = Alignment(0.0, 0.0, 0.0), 0.0, [], []
    for length_s in lengths_s:
        now += length_s
        alignment, times = segment_times(alignment, now, part_count)
        assert (times <= now + 1e-12).all()
        taken += times.tolist()
        real += [now + 0.3 * length_s + 0.6 * length_s * (part + 1) / part_count for part in range(part_count)]
    return np.array(taken), np.array(real)


def test_steps_take_even_times_of_a_hand_though_they_run_unevenly():
    """Thesis figures 10.4 and 10.6: a hand of even speed, steps with pauses for the surface, segments of any length."""
    lengths_s = np.random.default_rng(4).uniform(0.02, 0.04, 400)
    taken, real = segments_of(lengths_s, 5)
    even, uneven = (np.diff(times)[500:] for times in (taken, real))
    assert (even >= 0.0).all()
    spread, spread_real, spread_lengths = (one.std() / one.mean() for one in (even, uneven, lengths_s))
    assert spread < 0.2 * spread_real
    assert spread < 0.5 * spread_lengths
    # They lag a segment and a half behind at most, for good.
    now = np.repeat(np.cumsum(lengths_s), 5)
    assert (now - taken)[500:].max() < 3.0 * 0.03


def test_even_segments_become_exactly_even_steps():
    taken, _ = segments_of(np.full(600, 0.03), 3)
    np.testing.assert_allclose(np.diff(taken)[-300:], 0.01, rtol=1e-3)


def test_after_a_stall_the_hands_way_is_left_out():
    lengths_s = np.concatenate([np.full(100, 0.02), [3.0], np.full(100, 0.02)])
    taken, _ = segments_of(lengths_s, 2)
    behind = np.repeat(np.cumsum(lengths_s), 2) - taken
    assert behind[-1] < 0.05
    assert (np.diff(taken) >= 0.0).all()


@pytest.mark.parametrize("position", [(np.nan, 0, 0), (0, 0), "here", None, [[0, 0, 0]]])
def test_a_pose_is_at_three_finite_numbers(position):
    with pytest.raises(UsageError, match="position_mm: must be three finite numbers"):
        ToolPose.at(position)
