"""Devices by name, the recorded hand, the mouse, and the hand-over between processes."""

from __future__ import annotations

import sys
import threading
from dataclasses import replace
from importlib.metadata import EntryPoint

import numpy as np
import pytest

from heartcase.schemas.errors import SimulationError, UsageError
from heartcase.simulator.haptics import device as devices
from heartcase.simulator.haptics.device import DeviceReading, DeviceSpec, NamedDevice, device_names, open_device
from heartcase.simulator.haptics.hand_over import Ring, shared_memory
from heartcase.simulator.haptics.mouse_device import MouseDevice, MouseFeed, PointerPlane
from heartcase.simulator.haptics.poses import ToolPose
from heartcase.simulator.haptics.trajectory_device import TrajectoryDevice

PLANE = PointerPlane((10.0, 20.0, 30.0), (0.0, 1.0, 0.0), (0.0, 0.0, -1.0), 0.25)


def test_devices_are_opened_by_name():
    assert {"mouse", "trajectory"} <= set(device_names())
    opened = open_device(DeviceSpec("trajectory", {"times_s": [0.0], "positions_mm": [[1.0, 2.0, 3.0]]}))
    np.testing.assert_array_equal(opened.read(5.0).pose.position_mm, [1.0, 2.0, 3.0])
    with pytest.raises(UsageError, match=r"'robot'.*mouse, trajectory"):
        open_device(DeviceSpec("robot"))


def test_devices_of_other_packages_are_imported_only_when_asked_for(monkeypatch, tmp_path):
    (tmp_path / "other_driver.py").write_text("class Stylus:\n    def __init__(self, port): self.port = port\n")
    (tmp_path / "broken_driver.py").write_text("import a_library_that_is_not_there\n")
    monkeypatch.syspath_prepend(str(tmp_path))
    points = [
        EntryPoint("stylus", "other_driver:Stylus", devices.DEVICE_GROUP),
        EntryPoint("arm", "broken_driver:Arm [arm]", devices.DEVICE_GROUP),
    ]
    monkeypatch.setattr(devices, "entry_points", lambda group: points)
    assert {"arm", "stylus"} <= set(device_names())
    assert "other_driver" not in sys.modules
    assert open_device(DeviceSpec("stylus", {"port": 3})).port == 3
    with pytest.raises(UsageError, match=r"install its package\[arm\]"):
        open_device(DeviceSpec("arm"))


def test_a_recorded_hand_goes_in_straight_lines_and_stays_at_its_end():
    hand = TrajectoryDevice(
        [1.0, 2.0, 4.0], [[0, 0, 0], [2, 0, 0], [2, 4, 0]], [[0, 0, 0], [0, 0, 1], [0, 0, 1]], [False, True, False]
    )
    reading = hand.read(1.5)
    np.testing.assert_allclose(reading.pose.position_mm, [1, 0, 0])
    np.testing.assert_allclose(reading.motion, [[2, 0, 0], [0, 0, 1]], atol=1e-12)
    assert [hand.read(at).buttons for at in (0.0, 1.9, 2.0, 9.0)] == [(False,), (False,), (True,), (False,)]
    np.testing.assert_array_equal(hand.read(9.0).motion, 0.0)
    np.testing.assert_array_equal(hand.read(9.0).pose.position_mm, [2, 4, 0])


def test_all_that_is_wrong_with_a_recorded_hand_is_told():
    with pytest.raises(UsageError) as found:
        TrajectoryDevice([1.0, 1.0], [[0, 0, 0]], [[0, 0, np.nan], [0, 0, 0]], [True])
    assert [problem.place for problem in found.value.problems] == ["times_s", "positions_mm", "rotations_rad", "closed"]


def test_the_mouse_is_a_tip_on_a_plane_that_follows_without_leaps():
    feed = MouseFeed()
    feed.pointer(0.0, 0.0)
    mouse = MouseDevice(feed.memory, PLANE, follow_s=0.02)
    np.testing.assert_array_equal(mouse.read(0.0).pose.position_mm, PLANE.origin_mm)
    feed.pointer(40.0, 8.0, depth_mm=5.0, is_down=True)
    places = np.array([mouse.read(1e-3 * tick).pose.position_mm for tick in range(1, 400)])
    target = np.array([10.0 - 5.0, 20.0 + 10.0, 30.0 - 2.0])
    np.testing.assert_allclose(places[-1], target, atol=1e-4)
    assert mouse.read(0.4).buttons == (True,)
    steps = np.diff(places, axis=0)
    way = np.linalg.norm(target - PLANE.origin_mm)
    # A critically damped spring is quickest at way / (e follow_s), and never goes beyond.
    assert np.linalg.norm(steps, axis=1).max() <= way / (np.e * 0.02) * 1e-3
    assert (steps @ (target - PLANE.origin_mm) >= -1e-12).all()
    mouse.write(np.array([0.0, 1.0, 0.0]), np.zeros(3))
    np.testing.assert_array_equal(mouse.force_n, [0, 1, 0])


def test_the_mouses_motion_is_that_of_its_tip():
    feed = MouseFeed()
    feed.pointer(0.0, 0.0)
    mouse = MouseDevice(feed.memory, PLANE)
    mouse.read(0.0)
    feed.pointer(100.0, 0.0)
    before, after = mouse.read(0.010), mouse.read(0.0101)
    slope = (after.pose.position_mm - before.pose.position_mm) / 1e-4
    np.testing.assert_allclose(slope, (before.motion[0] + after.motion[0]) / 2, rtol=1e-3)


def test_a_plane_must_be_square():
    with pytest.raises(UsageError, match="right angles"):
        PointerPlane((0, 0, 0), (1, 0, 0), (1, 1, 0), 1.0)


def test_a_row_that_is_half_written_is_not_read():
    memory = shared_memory(4, 3)
    ring = Ring(memory, 4, 3)
    assert ring.latest() is None
    assert ring.last(4).shape == (0, 3)
    for number in range(1, 7):
        assert ring.write(np.full(3, float(number))) == number
    assert ring.latest()[0] == 6
    np.testing.assert_array_equal(ring.last(10)[:, 0], [3.0, 4.0, 5.0, 6.0])
    reader = Ring(memory, 4, 3)
    reader._rows[6 % 4, 2] = 99.0
    number, row = reader.latest()
    assert number == 5
    np.testing.assert_array_equal(row, 5.0)
    np.testing.assert_array_equal(reader.last(10)[:, 0], [3.0, 4.0, 5.0])


def test_rows_are_whole_while_another_writes():
    ring = Ring(memory := shared_memory(2, 50), 2, 50)
    ends = threading.Event()

    def write() -> None:
        number = 0
        while not ends.is_set():
            number += 1
            ring.write(np.full(50, float(number)))

    writer = threading.Thread(target=write)
    writer.start()
    reader, numbers = Ring(memory, 2, 50), []
    while len(numbers) < 2000:
        found = reader.latest()
        if found is not None:
            assert (found[1] == found[0]).all()
            numbers.append(found[0])
    ends.set()
    writer.join()
    assert numbers == sorted(numbers)


def test_options_that_a_device_does_not_take_are_named_with_those_that_it_takes():
    with pytest.raises(UsageError, match=r"trajectory does not take .*'speed'; its options are: times_s, positions_mm"):
        open_device(DeviceSpec("trajectory", {"times_s": [0.0], "positions_mm": [[1.0, 2.0, 3.0]], "speed": 1}))
    with pytest.raises(UsageError, match=r"mouse does not take .*'memory'"):
        open_device(DeviceSpec("mouse"))


READING = DeviceReading(ToolPose.at((1.0, 2.0, 3.0)), buttons=(True,))


@pytest.mark.parametrize(
    ("said", "told"),
    [
        (RuntimeError("usb gone"), "failed with RuntimeError: usb gone"),
        (OSError(5, "Input/output error", "/home/ada lovelace/port"), r"failed with OSError: Input/output error$"),
        (None, "returned a NoneType and must return a DeviceReading"),
        ((1.0, 2.0, 3.0), "returned a tuple and must return a DeviceReading"),
        (DeviceReading((1.0, 2.0, 3.0)), "returned a tuple and must return a ToolPose in its DeviceReading"),
        (DeviceReading(ToolPose(np.array([np.nan, 0, 0]), np.eye(3))), r"pose\.position_mm that is not finite"),
        (DeviceReading(ToolPose(np.zeros(2), np.eye(3))), r"pose\.position_mm .*shape \(3,\)"),
        (DeviceReading(ToolPose(np.zeros(3), np.zeros(3))), r"pose\.turn .*shape \(3, 3\)"),
        (replace(READING, motion=np.full((2, 3), np.inf)), "motion that is not finite"),
        (replace(READING, motion="fast"), "motion that is not finite"),
        (replace(READING, buttons=True), "buttons"),
    ],
)
def test_a_device_that_fails_or_says_what_is_no_reading_is_named(monkeypatch, said, told):
    class Stylus:
        def read(self, time_s):
            if isinstance(said, Exception):
                raise said
            return said

        def write(self, force_n, torque_n_mm):
            raise RuntimeError("usb gone")

        def close(self):
            pass

    monkeypatch.setattr(devices, "open_device", lambda spec: Stylus())
    device = NamedDevice(DeviceSpec("stylus"))
    with pytest.raises(SimulationError, match=f"haptic device stylus .*{told}"):
        device.read(0.0)
    with pytest.raises(SimulationError, match="haptic device stylus failed with RuntimeError: usb gone"):
        device.write(np.zeros(3), np.zeros(3))


def test_a_reading_of_lists_is_one(monkeypatch):
    plain = DeviceReading(ToolPose([1.0, 2.0, 3.0], np.eye(3)), [[0.0] * 3] * 2, [True])

    class Stylus:
        def read(self, time_s):
            return plain

    monkeypatch.setattr(devices, "open_device", lambda spec: Stylus())
    assert NamedDevice(DeviceSpec("stylus")).read(0.0) is plain


def test_a_device_that_cannot_be_opened_is_named_with_its_words(monkeypatch):
    def opened(spec):
        raise RuntimeError("no usb")

    monkeypatch.setattr(devices, "open_device", opened)
    with pytest.raises(SimulationError, match="haptic device stylus failed with RuntimeError: no usb"):
        NamedDevice(DeviceSpec("stylus"))
