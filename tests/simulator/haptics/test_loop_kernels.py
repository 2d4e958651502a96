"""The servo loop's kernel beside its oracle in NumPy, update by update."""

from __future__ import annotations

import numpy as np
from hypothesis import example, given, settings
from hypothesis import strategies as st

from heartcase.simulator.haptics.coupling import TissueSample
from heartcase.simulator.haptics.device import DeviceReading
from heartcase.simulator.haptics.loop import LoopNumbers, first_state, servo_update
from heartcase.simulator.haptics.poses import ToolPose, turn_by
from heartcase.simulator.haptics.settings import ServoSettings

UPDATES = 60


def some_turn(rng: np.random.Generator, size: float) -> np.ndarray:
    axis = rng.normal(size=3)
    return turn_by(size * axis / np.linalg.norm(axis))


def assert_alike(one, other):
    """Up to some roundings of numbers of their size: forces are differences of larger ones."""
    np.testing.assert_allclose(one, other, rtol=1e-9, atol=1e-10)


@settings(max_examples=60, deadline=None)
@given(
    seed=st.integers(0, 2**32 - 1),
    turn=st.sampled_from([0.0, 1e-10, 1e-3, 0.5, np.pi - 1e-3, np.pi - 1e-6]),
    speed=st.sampled_from([0.0, 0.01, 5.0]),
    stiffness=st.sampled_from([0.0, 0.5, 50.0]),
    late=st.sampled_from([0.0, 0.004, 0.03]),
)
@example(seed=0, turn=np.pi - 1e-6, speed=0.0, stiffness=50.0, late=0.0)
def test_the_kernel_is_the_oracle(seed, turn, speed, stiffness, late):
    rng = np.random.default_rng(seed)
    limits = ServoSettings(stiffness_n_m=float(rng.uniform(100, 2000)), force_limit_n=float(rng.uniform(0.5, 5)))
    hand = ToolPose(rng.normal(size=3), some_turn(rng, 1.0))
    state, numbers = first_state(0.0, DeviceReading(hand)), LoopNumbers(0.0, DeviceReading(hand), limits)
    time_s, seen = 0.0, set()
    sample = None
    for update in range(UPDATES):
        time_s += float(rng.choice([0.0, 1e-5, 1e-3, 1.2e-3, 0.02], p=[0.05, 0.05, 0.6, 0.25, 0.05]))
        gap = np.stack([speed * rng.normal(size=3), 0.1 * speed * rng.normal(size=3)])
        hand = hand.moved_by(gap)
        if update == 20:  # the hand is turned against the tool at once
            hand = ToolPose(hand.position_mm, some_turn(rng, turn) @ state.tool.pose.turn)
        if update % 4 == 3:
            pose = ToolPose(hand.position_mm + rng.normal(size=3), some_turn(rng, 0.2) @ hand.turn)
            load = rng.normal(size=(2, 3)) * np.array([[2.0], [60.0]])
            sample = TissueSample(time_s - late * rng.random(), pose, load, stiffness * np.array([1.0, 900.0]))
        reading = DeviceReading(hand, gap / 1e-3 * rng.random())
        waited_s = rng.choice([None, 0.0, 1e-4, 1.0])
        state = servo_update(numbers.state, time_s, reading, sample, limits, waited_s=waited_s)
        numbers.update(time_s, reading, None if sample is None else sample.row(), waited_s)
        now = numbers.state
        assert now.time_s == state.time_s
        assert_alike(now.part, state.part)
        for one, other in ((now.hand, state.hand), (now.tool.pose, state.tool.pose)):
            assert_alike(one.position_mm, other.position_mm)
            assert_alike(one.turn, other.turn)
        assert_alike(now.tool.motion * 1e-3, state.tool.motion * 1e-3)
        assert_alike(now.within, state.within)
        assert_alike(now.load, state.load)
        np.testing.assert_array_equal(numbers.load, now.load)
        assert_alike(
            [now.account.put_in_mj, now.account.got_back_mj], [state.account.put_in_mj, state.account.got_back_mj]
        )
        np.testing.assert_array_equal(now.earlier, state.earlier)
        assert numbers.energy_mj == now.account.energy_mj
        seen.add(state.part > 0.0)
    assert seen == {False, True} or late > 0.0


def test_nothing_is_put_out_before_the_first_state():
    reading = DeviceReading(ToolPose.at(np.zeros(3)))
    numbers = LoopNumbers(0.0, reading, ServoSettings())
    for tick in range(1, 10):
        numbers.update(1e-3 * tick, DeviceReading(ToolPose.at(np.array([0.1 * tick, 0.0, 0.0]))), None)
        np.testing.assert_array_equal(numbers.load, 0.0)
    assert 0.5 < numbers.pose[0] < 0.9  # the tool follows the hand
