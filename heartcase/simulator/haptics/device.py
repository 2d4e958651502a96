"""What a haptic device is: it is read, and a force is written to it. By name, from here or from other packages."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field
from importlib import import_module
from importlib.metadata import entry_points
from inspect import signature
from math import isfinite
from typing import Any, Protocol

import numpy as np

from heartcase.schemas.arrays import Float64
from heartcase.schemas.errors import HeartcaseError, SimulationError, UsageError
from heartcase.simulator.haptics.poses import ToolPose

__all__ = [
    "DEVICE_GROUP",
    "DeviceReading",
    "DeviceSpec",
    "HapticDevice",
    "NamedDevice",
    "device_names",
    "open_device",
]

DEVICE_GROUP = "heartcase_haptic_devices"
"""Entry points of other packages: name -> ``module:class``, with the extra of that package that it needs."""

_OWN = {
    "trajectory": "heartcase.simulator.haptics.trajectory_device:TrajectoryDevice",
    "mouse": "heartcase.simulator.haptics.mouse_device:MouseDevice",
}


@dataclass(frozen=True)
class DeviceReading:
    """What a device says of the hand on it."""

    pose: ToolPose
    """Where its tip is and how it is turned: LPS, mm."""
    motion: Float64 = field(default_factory=lambda: np.zeros((2, 3)))
    """How it moves: mm/s, rad/s, LPS axes, shape (2, 3)."""
    buttons: tuple[bool, ...] = ()
    """Which of its buttons are down, the first that of closing."""


class HapticDevice(Protocol):
    """A device that a hand is on.

    The loop reads and writes it once an update, from one thread of a process of its own. Both must return at once.
    """

    def read(self, time_s: float) -> DeviceReading:
        """Pose, motion and buttons now; ``time_s`` is the time since the loop began, s."""

    def write(self, force_n: Float64, torque_n_mm: Float64) -> None:
        """Put a force, N, and a torque, N mm, on the hand until the next, LPS axes, shape (3,) each."""

    def close(self) -> None:
        """Take all force away, and give the device back."""


@dataclass(frozen=True)
class DeviceSpec:
    """Which device, and what it is opened with: what is handed to the process that opens it."""

    name: str
    """Name in the registry."""
    options: Mapping[str, Any] = field(default_factory=dict)
    """What its class is called with."""


def device_names() -> tuple[str, ...]:
    """Names of the devices that there are, here and in other packages."""
    return tuple(sorted({*_OWN, *(point.name for point in entry_points(group=DEVICE_GROUP))}))


def open_device(spec: DeviceSpec) -> HapticDevice:
    """Open a device; only now its module is imported.

    Raises
    ------
    UsageError
        There is no device of this name, it does not take these options, or it is another package's, and needs a
        library that is not installed.
    """
    if spec.name in _OWN:
        module, _, name = _OWN[spec.name].partition(":")
        return _made(spec, getattr(import_module(module), name))
    point = next((point for point in entry_points(group=DEVICE_GROUP) if point.name == spec.name), None)
    if point is None:
        known = ", ".join(device_names())
        raise UsageError(f"there is no haptic device {spec.name!r}: choose from {known}", place="device")
    try:
        found = point.load()
    except ModuleNotFoundError:
        package = point.dist.name if point.dist is not None else "its package"
        extras = f"[{','.join(point.extras)}]" if point.extras else ""
        message = f"the haptic device {spec.name} needs a library that is not installed: install {package}{extras}"
        raise UsageError(message, place="device") from None
    return _made(spec, found)


def _made(spec: DeviceSpec, kind: Callable[..., HapticDevice]) -> HapticDevice:
    """The device, once it is known that its class takes the options."""
    try:
        wanted = signature(kind)
    except (TypeError, ValueError):  # a class that is not Python's says nothing of what it takes
        return kind(**spec.options)
    try:
        wanted.bind(**spec.options)
    except TypeError as error:
        takes = ", ".join(wanted.parameters) or "none"
        message = f"the haptic device {spec.name} does not take these options: {error}; its options are: {takes}"
        raise UsageError(message, place="device") from None
    return kind(**spec.options)


_SHAPES = (("pose.position_mm", (3,)), ("pose.turn", (3, 3)), ("motion", (2, 3)))


class NamedDevice:
    """A device whose failures name it, and whose readings are looked at before anything is led by them.

    Parameters
    ----------
    spec
        Which device; it is opened.

    Raises
    ------
    HeartcaseError
        It cannot be opened.
    """

    def __init__(self, spec: DeviceSpec) -> None:
        self.name = spec.name
        try:
            self._device = open_device(spec)
        except HeartcaseError:
            raise
        except Exception as error:
            raise self._failure(error) from error

    def read(self, time_s: float) -> DeviceReading:
        """What the device says; SimulationError where it fails, or says what is no reading."""
        try:
            reading = self._device.read(time_s)
        except Exception as error:
            raise self._failure(error) from error
        if not isinstance(reading, DeviceReading) or not isinstance(reading.pose, ToolPose):
            found = reading if not isinstance(reading, DeviceReading) else reading.pose
            wanted = "DeviceReading" if found is reading else "ToolPose in its DeviceReading"
            raise self._wrong(f"returned a {type(found).__name__} and must return a {wanted}")
        for (name, shape), value in zip(
            _SHAPES, (reading.pose.position_mm, reading.pose.turn, reading.motion), strict=True
        ):
            if not _are_numbers(value, shape):
                raise self._wrong(f"returned a {name} that is not finite numbers of shape {shape}")
        if not isinstance(reading.buttons, Iterable):
            raise self._wrong("returned buttons that are no tuple of true and false")
        return reading

    def write(self, force_n: Float64, torque_n_mm: Float64) -> None:
        """Put a force and a torque on the hand; SimulationError where the device fails."""
        try:
            self._device.write(force_n, torque_n_mm)
        except Exception as error:
            raise self._failure(error) from error

    def close(self) -> None:
        """Take all force away, and give the device back."""
        self._device.close()

    def _failure(self, error: Exception) -> SimulationError:
        # What the system says of a file names the file.
        said = error.strerror if isinstance(error, OSError) and error.strerror else str(error)
        return SimulationError(
            f"the haptic device {self.name} failed with {type(error).__name__}: {said or 'no words'}"
        )

    def _wrong(self, message: str) -> SimulationError:
        return SimulationError(f"the haptic device {self.name} {message}: its driver is to be mended")


def _are_numbers(value: Any, shape: tuple[int, ...]) -> bool:
    """Whether a value is finite numbers of a shape; quick, as it is asked in every update of the loop."""
    try:
        array = np.asarray(value, dtype=float)
    except (TypeError, ValueError):
        return False
    return array.shape == shape and isfinite(sum(array.ravel().tolist()))
