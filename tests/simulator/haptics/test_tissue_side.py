"""Instruments that a device leads in a simulation, and the loop in a process of its own."""

from __future__ import annotations

import time

import numpy as np
import pytest

from heartcase.schemas.errors import SimulationError, UsageError
from heartcase.simulator.forces.reference import elastic_energy
from heartcase.simulator.haptics.channel import Channel
from heartcase.simulator.haptics.device import DeviceReading, DeviceSpec
from heartcase.simulator.haptics.led import LedGrab, LedProbe
from heartcase.simulator.haptics.loop import first_state, servo_update
from heartcase.simulator.haptics.poses import ToolPose, turn_by
from heartcase.simulator.haptics.servo import HapticServo, run_loop
from heartcase.simulator.haptics.settings import ServoSettings
from heartcase.simulator.haptics.tissue_side import FeltInstrument, TissueSide
from heartcase.simulator.simulation import Simulation
from tests.simulator.haptics.late_tissue import closed_path, publish, work_on_hand
from tests.simulator.lattices import block, oblique_geometry

SETTINGS = ServoSettings()
DRIVER = """
import numpy as np
from heartcase import DeviceReading, ToolPose

class Stylus:
    def read(self, time_s):
        if time_s > 0.05:
            raise RuntimeError("usb gone")
        return DeviceReading(ToolPose.at(np.zeros(3)))
    def write(self, force_n, torque_n_mm): pass
    def close(self): pass
"""


def held_block(backend="reference"):
    """A block on a fixed base with a hand at its top, and a tool that is not at the hand's centre."""
    model = block(6, 5, 4, fix_base=True, geometry=oblique_geometry())
    simulation = Simulation(model, backend=backend, damping_per_s=30.0)
    top = model.rest_positions_mm()[model.node_index[:, 2] == 4].mean(axis=0)
    closed_at = ToolPose(top + np.array([3.0, -2.0, 1.0]), turn_by(np.array([0.2, 0.1, -0.4])))
    return simulation, closed_at, LedGrab(simulation, simulation.grab(top, 1.6 * model.cell_mm), closed_at)


def energy_with(simulation, led, pose) -> float:
    """Elastic energy, N mm, with the hand at a pose and everything else as it is."""
    led.follow(pose)
    moved = simulation.state.displacement.astype(float)
    moved[led.grab.nodes] = led.grab.displacement_at(led.grab.target)
    return elastic_energy(simulation.model, moved) * simulation.model.units.energy_j * 1e3


def test_force_and_torque_are_the_slopes_of_the_energy():
    simulation, closed_at, led = held_block()
    pose = closed_at.moved_by(np.array([[0.6, -0.3, 0.5], [0.05, -0.1, 0.08]]))
    led.follow(pose)
    simulation.step(30)
    load = led.load(pose)
    step = 1e-4
    for row, scale in enumerate((1.0, 0.1)):
        for axis in range(3):
            gap = np.zeros((2, 3))
            gap[row, axis] = step * scale
            rise = energy_with(simulation, led, pose.moved_by(gap)) - energy_with(simulation, led, pose.moved_by(-gap))
            assert load[row, axis] == pytest.approx(-rise / (2 * step * scale), rel=2e-3, abs=1e-4 * np.abs(load).max())


def test_the_hand_moves_with_the_tool_as_one_body():
    simulation, closed_at, led = held_block()
    before = simulation.positions_mm()[led.grab.nodes]
    pose = ToolPose(
        closed_at.position_mm + np.array([0.5, 0.2, 0.1]), turn_by(np.array([0.05, 0.1, 0.0])) @ closed_at.turn
    )
    led.follow(pose)
    simulation.step(20)
    in_tool = (before - closed_at.position_mm) @ closed_at.turn
    np.testing.assert_allclose(
        simulation.positions_mm()[led.grab.nodes], in_tool @ pose.turn.T + pose.position_mm, atol=1e-4
    )


def test_a_probe_is_moved_to_the_tool_and_feels_the_force():
    simulation, _, _ = held_block()
    probe = simulation.probe(simulation.model.rest_positions_mm().max(axis=0) + 50.0, 4.0)
    led = LedProbe(simulation, probe)
    pose = ToolPose.at(simulation.model.rest_positions_mm().max(axis=0) + 49.0)
    led.follow(pose)
    simulation.step(1)
    np.testing.assert_array_equal(led.load(pose), 0.0)
    np.testing.assert_allclose(simulation.model.geometry.index_to_world(probe.centre - 0.5), pose.position_mm)


def test_a_session_in_made_up_time_pulls_the_tissue_and_feels_it():
    """A hand that goes 2 mm in half a second and waits: the force is that of the tissue at the tool, a balance."""
    simulation, closed_at, led = held_block("cpu")
    channel, clock = Channel(), [0.0]
    side = TissueSide(clock=lambda: clock[0])
    side.felt.append(FeltInstrument(led, channel, SETTINGS))
    steps = round(0.004 / simulation.step_s)
    state = first_state(0.0, DeviceReading(closed_at))
    for tick in range(1500):
        clock[0] = 1e-3 * (tick + 1)
        if tick % 8 == 0:
            side.segment(2, lambda: simulation.step(steps))
        way = np.array([0.0, 2.0 * min(clock[0] / 0.5, 1.0), 0.0])
        reading = DeviceReading(ToolPose(closed_at.position_mm + way, closed_at.turn))
        number, tissue = channel.tissue()
        state = servo_update(state, clock[0], reading, tissue, SETTINGS)
        publish(channel, state, (True,), number)
    assert number == 2 * 187  # before the first segment nothing is known of the tool
    felt = channel.felt()
    assert felt.buttons == 1
    assert felt.sample_number == number
    assert np.linalg.norm(felt.force_n) > 0.05
    np.testing.assert_array_equal(felt.force_n, state.load[0])
    load = led.load(state.tool.pose)
    np.testing.assert_allclose(felt.force_n, load[0], rtol=0.02, atol=1e-3)
    gap = state.tool.pose.gap_to(reading.pose)
    np.testing.assert_allclose(felt.force_n, -0.4 * gap[0], rtol=1e-3, atol=1e-4)


@pytest.mark.parametrize("seed", range(3))
def test_a_closed_path_through_moving_tissue_gives_out_no_energy(seed):
    """Steps of a lattice that come late and unevenly, with its own swings; the hand goes round and comes back."""
    simulation, closed_at, led = held_block("cpu")
    rng, channel, clock = np.random.default_rng(seed), Channel(), [0.0]
    side = TissueSide(clock=lambda: clock[0])
    side.felt.append(FeltInstrument(led, channel, SETTINGS))
    steps = round(0.004 / simulation.step_s)
    path = closed_path(seed, seconds=1.0, mm=2.0, rad=0.1)

    def hand_at(time_s: float) -> ToolPose:
        now = path(time_s)
        return closed_at.moved_by(np.stack([now[:3], now[3:]]))

    state = first_state(0.0, DeviceReading(closed_at))
    given_mj, force_most, next_s = 0.0, 0.0, 0.0
    while clock[0] < 1.05:
        step_s = float(rng.choice([0.001, 0.001, 0.0012, 0.002]))
        clock[0] += step_s
        if clock[0] >= next_s:
            side.segment(2, lambda: simulation.step(steps))
            next_s = clock[0] + rng.uniform(0.004, 0.03)
        hand = hand_at(clock[0])
        moved = state.hand.gap_to(hand)
        given_mj += work_on_hand(state, hand_at, clock[0], SETTINGS)
        number, tissue = channel.tissue()
        state = servo_update(state, clock[0], DeviceReading(hand, moved / step_s), tissue, SETTINGS)
        publish(channel, state, (), number)
        force_most = max(force_most, float(np.linalg.norm(state.load[0])))
    assert given_mj <= 0.0
    # The account takes the hand to move evenly from one update to the next.
    assert state.account.energy_mj == pytest.approx(-given_mj, rel=0.02)
    assert force_most > 0.05


def test_the_loop_runs_beside_the_simulation_and_ends_when_told():
    simulation, closed_at, led = held_block("cpu")
    ends = closed_at.position_mm + np.array([[0, 0, 0], [0, 2.0, 0]])
    rotation = [[0.2, 0.1, -0.4]] * 2
    device = DeviceSpec("trajectory", {"times_s": [0.0, 0.2], "positions_mm": ends, "rotations_rad": rotation})
    second = DeviceSpec("trajectory", {"times_s": [0.0], "positions_mm": [[7.0, 8.0, 9.0]]})
    with HapticServo([device, second], SETTINGS, log_count=5000) as servo:
        channel, other = servo.channels
        side = TissueSide()
        side.felt.append(FeltInstrument(led, channel, SETTINGS))
        limit = time.monotonic() + 60.0
        while (
            channel.felt() is None or not np.linalg.norm(channel.felt().force_n) > 0.05
        ) and time.monotonic() < limit:
            side.segment(2, lambda: simulation.step(5))
            servo.check()
        assert np.linalg.norm(channel.felt().force_n) > 0.05
        number = channel.felt().sample_number
        while channel.felt().part > 0.0 and time.monotonic() < limit:
            time.sleep(0.005)
        np.testing.assert_array_equal(channel.felt().force_n, 0.0)
        np.testing.assert_array_equal(other.felt().pose.position_mm, [7.0, 8.0, 9.0])
        np.testing.assert_array_equal(other.felt().force_n, 0.0)
    log = servo.log()
    assert (np.diff(log[:, 0]) > 0.0).all()
    assert log[-1, 1] >= number
    with pytest.raises(SimulationError, match="has ended"):
        servo.check()


@pytest.mark.parametrize("count", [0, -1, 1.5, None])
def test_a_segment_has_at_least_one_part(count):
    with pytest.raises(UsageError, match="part_count: must be a whole number, at least 1"):
        TissueSide().segment(count, lambda: None)


def test_a_servo_takes_specs_of_devices_alone():
    with pytest.raises(UsageError) as found:
        HapticServo(["stylus", DeviceSpec("mouse"), None])
    assert [problem.place for problem in found.value.problems] == ["devices[1]", "devices[3]"]
    for one in ("stylus", DeviceSpec("mouse")):
        with pytest.raises(UsageError, match="is a list"):
            HapticServo(one)


def test_the_loop_tells_which_device_failed(tmp_path, monkeypatch):
    (tmp_path / "failing_driver.py").write_text(DRIVER)
    points = tmp_path / "failing_driver-1.dist-info"
    points.mkdir()
    (points / "METADATA").write_text("Metadata-Version: 2.1\nName: failing-driver\nVersion: 1\n")
    (points / "entry_points.txt").write_text("[heartcase_haptic_devices]\nstylus = failing_driver:Stylus\n")
    monkeypatch.syspath_prepend(str(tmp_path))
    with HapticServo([DeviceSpec("stylus")]) as servo:
        servo._process.join(60.0)
        with pytest.raises(
            SimulationError, match=r"has ended: the haptic device stylus failed .*: usb gone; make another"
        ):
            servo.check()


def test_a_device_that_cannot_be_opened_is_told():
    with pytest.raises(SimulationError, match=r"cannot run: .*'robot'"), HapticServo([DeviceSpec("robot")]):
        pass


def test_force_is_taken_away_when_a_device_fails():
    written = []

    class Failing:
        def read(self, time_s):
            if len(written) == 3:
                raise OSError("unplugged")
            return DeviceReading(ToolPose.at(np.zeros(3)))

        def write(self, force_n, torque_n_mm):
            written.append(force_n.copy())

        def close(self):
            written.append("closed")

    with pytest.raises(OSError, match="unplugged"):
        run_loop([Failing()], [Channel()], SETTINGS, lambda: False)
    assert written[-1] == "closed"
    np.testing.assert_array_equal(written[-2], 0.0)


def test_a_device_that_fails_leaves_no_other_one_pushing():
    log = {"one": [], "other": []}

    class Device:
        def __init__(self, name, fails):
            self.log, self.fails = log[name], fails

        def read(self, time_s):
            return DeviceReading(ToolPose.at(np.zeros(3)))

        def write(self, force_n, torque_n_mm):
            if self.fails and len(self.log) >= 2:
                raise OSError("unplugged")
            self.log.append(force_n.copy())

        def close(self):
            if self.fails:
                raise OSError("unplugged")
            self.log.append("closed")

    devices = [Device("one", True), Device("other", False)]
    with pytest.raises(OSError, match="unplugged"):
        run_loop(devices, [Channel(), Channel()], SETTINGS, lambda: False)
    assert log["other"][-1] == "closed"
    np.testing.assert_array_equal(log["other"][-2], 0.0)
