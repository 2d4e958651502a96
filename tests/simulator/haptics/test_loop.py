"""The servo loop: it gives out no energy, its force is limited, continuous, true to the tissue, and gone with it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from heartcase.schemas.errors import SimulationError
from heartcase.simulator.haptics.coupling import TissueSample, Tool, advance_tool, stiffness_seen
from heartcase.simulator.haptics.device import DeviceReading
from heartcase.simulator.haptics.loop import first_state, servo_update
from heartcase.simulator.haptics.poses import ToolPose
from heartcase.simulator.haptics.settings import STALL_S, ServoSettings
from tests.simulator.haptics.late_tissue import closed_path, run, spring, wall

SETTINGS = ServoSettings()
NOTHING_MJ = 1e-12
"""Rounding of sums, mJ."""


def sample_at(time_s: float, force_n) -> TissueSample:
    return TissueSample(time_s, ToolPose.at(np.zeros(3)), np.array([force_n, np.zeros(3)]), np.zeros(2))


@pytest.mark.parametrize("tissue", [spring, wall])
@pytest.mark.parametrize("n_mm", [0.2, 0.8, 5.0])
def test_a_closed_path_gives_out_no_energy(tissue, n_mm):
    for seed in range(4):
        path = closed_path(seed, seconds=1.0)
        assert run(path, tissue(seed, n_mm), seconds=1.0, seed=seed).given_mj <= NOTHING_MJ


@pytest.mark.slow
def test_a_thousand_closed_paths_give_out_no_energy():
    for seed in range(1000):
        rng = np.random.default_rng(seed)
        path = closed_path(
            seed, seconds=1.0, hz=rng.uniform(0.5, 10.0), mm=rng.uniform(0.5, 15.0), rad=rng.uniform(0, 1)
        )
        tissue = (spring, wall)[seed % 2](seed, 10.0 ** rng.uniform(-1, 1))
        assert run(path, tissue, seconds=1.0, seed=seed).given_mj <= NOTHING_MJ, seed


def test_without_account_and_coupling_the_same_paths_give_out_much():
    given = [
        run(closed_path(seed, seconds=1.0), spring(seed, 0.8), seconds=1.0, seed=seed, is_naive=True).given_mj
        for seed in range(4)
    ]
    assert min(given) > 10.0


@pytest.mark.parametrize("n_mm", [0.2, 5.0])
def test_force_and_torque_are_limited_and_continuous(n_mm):
    for seed in range(3):
        path = closed_path(seed, seconds=1.0, mm=15.0, rad=1.0)
        found = run(path, spring(seed, n_mm), seconds=1.0, seed=seed)
        size = np.linalg.norm(found.loads, axis=2)
        limits = SETTINGS.limits.ravel()
        assert (size <= limits * (1 + 1e-12)).all()
        assert n_mm < 1.0 or size[:, 0].max() > 0.99 * limits[0]
        seconds = np.diff(found.times_s)[:, None]
        fade = limits / (SETTINGS.none_from_s - SETTINGS.full_for_s)
        change = np.linalg.norm(np.diff(found.loads, axis=0), axis=2)
        assert (change <= (SETTINGS.slew.ravel() + fade) * seconds + 1e-9).all()


def test_a_slow_hand_feels_the_tissue():
    """Pressed in by 4 mm within a second, and held: force of the spring at the tool, and tool behind the hand."""

    def path(time_s):
        return np.array([0.0, 0.0, -4.0 * np.clip(time_s, 0, 1), 0, 0, 0])

    def tissue(pose):
        return np.stack([-0.3 * pose.position_mm, np.zeros(3)])

    found = run(path, tissue, seconds=2.0, segments=lambda _: 0.008, ticks=lambda _: 0.001)
    truth = 0.3 / (0.3 + 0.4) * 0.4 * 4.0
    moving = (found.times_s > 0.2) & (found.times_s < 1.0)
    expected = truth * np.minimum(found.times_s, 1.0)
    np.testing.assert_allclose(found.loads[-1, 0], [0, 0, truth], atol=1e-3)
    assert np.abs(found.loads[moving, 0, 2] - expected[moving]).max() < 0.03 * truth
    np.testing.assert_allclose(found.tools[-1, 2], -4.0 + truth / 0.4, atol=1e-2)


def test_a_hand_in_free_space_feels_nothing():
    found = run(closed_path(3, seconds=1.0), lambda pose: np.zeros((2, 3)), seconds=1.0, segments=lambda _: 0.008)
    assert np.linalg.norm(found.loads[:, 0], axis=1).max() < 0.01


@pytest.mark.parametrize("n_mm", [0.1, 1.0, 3.0, 6.0])
def test_a_hand_that_is_held_still_against_stiff_tissue_does_not_tremble(n_mm):
    """States 15 ms late: without the stiffness that the states show, this loop would swing."""

    def path(time_s):
        return np.array([0.0, 0.0, -min(time_s / 0.2, 1.0) * 2.0, 0, 0, 0])

    def tissue(pose):
        return np.stack([-n_mm * pose.position_mm, np.zeros(3)])

    free = ServoSettings(force_limit_n=100.0, slew_n_s=1e5, full_for_s=0.017, none_from_s=0.0188)
    even = {"seconds": 1.5, "segments": lambda _: 0.015, "ticks": lambda _: 0.001}
    found = run(path, tissue, settings=free, **even)
    late = found.times_s > 1.2
    truth = n_mm / (n_mm + 0.4) * 0.4 * 2.0
    np.testing.assert_allclose(found.loads[late, 0, 2], truth, rtol=0.02)
    ignorant = run(path, tissue, settings=replace(free, tissue_stiffness_n_m=1.0), **even)
    swings = np.ptp(ignorant.loads[late, 0, 2]) > 0.1 * truth
    assert swings == (n_mm > 0.4)


def test_the_force_is_gone_20_ms_after_the_last_state_and_comes_back_without_a_jump():
    state = first_state(0.0, DeviceReading(ToolPose.at(np.zeros(3))))
    reading = DeviceReading(ToolPose.at(np.zeros(3)))
    sample, forces, times = None, [], []
    for tick in range(1, 1500):
        time_s = 1e-3 * tick
        if not 0.6 < time_s < 1.0 and tick % 5 == 0:
            sample = sample_at(time_s, (0.0, 0.0, 2.0))
        state = servo_update(state, time_s, reading, sample, SETTINGS)
        forces.append(state.load[0, 2])
        times.append(time_s)
    forces, times = np.array(forces), np.array(times)
    before = np.searchsorted(times, 0.6)
    np.testing.assert_allclose(forces[before - 1], 2.0, rtol=1e-3)
    assert (forces[(times >= 0.6 + STALL_S) & (times < 0.999)] == 0.0).all()
    fade_n_s = 2.0 / (SETTINGS.none_from_s - SETTINGS.full_for_s)
    assert np.abs(np.diff(forces)).max() <= (SETTINGS.slew_n_s + fade_n_s) * 1e-3
    back = forces[times > 1.0]
    # 2% of the force in an update at most: the part rises, and meanwhile the tissue takes hold of the tool again.
    assert np.diff(back).max() <= 0.02 * 2.0
    assert back[0] <= 0.02 * 2.0
    np.testing.assert_allclose(back[-1], 2.0, rtol=1e-3)


def test_no_force_before_the_first_state():
    state = first_state(0.0, DeviceReading(ToolPose.at(np.zeros(3))))
    moved = DeviceReading(ToolPose.at(np.array([5.0, 0.0, 0.0])), np.zeros((2, 3)))
    for tick in range(1, 50):
        state = servo_update(state, 1e-3 * tick, moved, None, SETTINGS)
        np.testing.assert_array_equal(state.load, 0.0)
    np.testing.assert_allclose(state.tool.pose.position_mm, [5.0, 0.0, 0.0], atol=1e-6)


def test_the_coupling_settles_where_hand_and_tissue_are_in_balance():
    hand = ToolPose.at(np.array([3.0, 0.0, 0.0]))
    tool = Tool.resting(ToolPose.at(np.zeros(3)))
    tissue = TissueSample(0.0, ToolPose.at(np.zeros(3)), np.zeros((2, 3)), np.array([0.6, 0.0]))
    for _ in range(200):
        tool, load = advance_tool(tool, hand, np.zeros((2, 3)), tissue, SETTINGS)
    np.testing.assert_allclose(tool.pose.position_mm, [3.0 * 0.4 / 1.0, 0, 0], rtol=1e-6)
    np.testing.assert_allclose(load[0], [-0.4 * 1.8, 0, 0], rtol=1e-6)


def test_stiffness_is_that_of_a_spring_and_unknown_where_nothing_moved():
    rng = np.random.default_rng(1)
    gaps = rng.normal(size=(10, 2, 3)) * np.array([1.0, 0.1])[:, None]
    loads = -gaps * np.array([0.7, 150.0])[:, None]
    np.testing.assert_allclose(stiffness_seen(gaps, loads, 30.0), [0.7, 150.0])
    assert stiffness_seen(1e-4 * gaps, loads, 30.0) is None
    np.testing.assert_array_equal(stiffness_seen(gaps, -loads, 30.0), 0.0)


@pytest.mark.parametrize("ahead_s", [1e-9, 2e-4, 5e-4])
def test_the_stated_limits_of_stability_are_those_of_the_sampled_spring_and_damper(ahead_s):
    """Colgate and Schenkel's condition, evaluated on the pulse transfer function itself, which comes late."""
    settings = ServoSettings(stiffness_n_m=900.0, bandwidth_hz=80.0, ahead_s=ahead_s)
    T, K, B = settings.period_s, 0.9, float(settings.damping[0, 0])
    w = np.linspace(1e-3, np.pi, 20001) / T
    z = np.exp(1j * w * T)
    pulse = (K + B * (z - 1) / (T * z)) * np.exp(-1j * w * ahead_s)
    needed = 0.5 * T / (1 - np.cos(w * T)) * ((1 - 1 / z) * pulse).real
    assert settings.device_damping_n_s_m * 1e-3 >= needed.max()
    if ahead_s < 1e-6:
        assert settings.device_damping_n_s_m * 1e-3 == pytest.approx(needed.max(), rel=1e-5)
    assert settings.passive_below_hz == pytest.approx(w[needed > 0.0].min() / (2 * np.pi), rel=1e-3)


def test_settings_that_cannot_be_are_told_together():
    with pytest.raises(SimulationError) as found:
        ServoSettings(stiffness_n_m=-1.0, rise_s=float("nan"))
    assert {problem.place for problem in found.value.problems} == {"stiffness_n_m", "rise_s"}
    with pytest.raises(SimulationError, match="ahead_s: must be at most half of the period"):
        ServoSettings(ahead_s=6e-4)
    with pytest.raises(SimulationError, match="none_from_s"):
        ServoSettings(none_from_s=0.02)
    with pytest.raises(SimulationError, match="quarter"):
        ServoSettings(bandwidth_hz=300.0)
