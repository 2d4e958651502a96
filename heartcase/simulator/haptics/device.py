"""What a haptic device is: it is read, and a force is written to it. By name, from here or from other packages."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from importlib import import_module
from importlib.metadata import entry_points
from typing import Any, Protocol

import numpy as np

from heartcase.schemas.arrays import Float64
from heartcase.schemas.errors import UsageError
from heartcase.simulator.haptics.poses import ToolPose

__all__ = ["DEVICE_GROUP", "DeviceReading", "DeviceSpec", "HapticDevice", "device_names", "open_device"]

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
        There is no device of this name, or it is another package's, and needs a library that is not installed.
    """
    if spec.name in _OWN:
        module, _, name = _OWN[spec.name].partition(":")
        own: HapticDevice = getattr(import_module(module), name)(**spec.options)
        return own
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
    opened: HapticDevice = found(**spec.options)
    return opened
