"""Haptic devices that a page can start: those of other packages, and one that is made up."""

from __future__ import annotations

import numpy as np

from heartcase.schemas.arrays import Float64
from heartcase.schemas.errors import UsageError
from heartcase.simulator.haptics.device import DeviceSpec, device_names

__all__ = ["MADE_UP", "device_of", "known_devices"]

MADE_UP = "simulated"
"""A hand without a device: closes on the tissue, pulls it to the eye and round, and lets go, again and again."""
_OWN = ("mouse", "trajectory")
"""Devices that come with heartcase, and are none to be held."""
_WAY_MM = 8.0
_ROUND_S = 8.0
_ROUNDS = 450
_CORNERS = (
    # part of a round, along x, y, z in parts of the way, whether the button is down
    (0.0, (0.0, 0.0, 0.0), False),
    (0.1, (0.0, 0.0, 0.0), True),
    (0.35, (0.0, -1.0, 0.0), True),
    (0.5, (0.5, -1.0, 0.5), True),
    (0.65, (-0.5, -1.0, 0.0), True),
    (0.85, (0.0, 0.0, 0.0), False),
)


def known_devices() -> tuple[str, ...]:
    """Names of the devices that a page can start."""
    return (*(name for name in device_names() if name not in _OWN), MADE_UP)


def device_of(name: str, centre_mm: Float64) -> DeviceSpec:
    """A device, whose way has its middle at a place of the heart.

    Parameters
    ----------
    name
        One of :func:`known_devices`. That of another package is opened with ``centre_mm``.
    centre_mm
        The place, LPS mm, shape (3,).

    Raises
    ------
    UsageError
        There is no device of this name.
    """
    if name not in known_devices():
        known = ", ".join(known_devices())
        raise UsageError(f"there is no haptic device {name!r}: choose from {known}", place="device")
    if name != MADE_UP:
        return DeviceSpec(name, {"centre_mm": tuple(centre_mm.tolist())})
    rounds = np.arange(_ROUNDS)[:, None]
    times = (_ROUND_S * (rounds + np.array([part for part, _, _ in _CORNERS]))).ravel()
    places = np.tile(_WAY_MM * np.array([way for _, way, _ in _CORNERS]), (_ROUNDS, 1)) + centre_mm
    closed = np.tile([is_down for _, _, is_down in _CORNERS], _ROUNDS)
    return DeviceSpec("trajectory", {"times_s": times, "positions_mm": places, "closed": closed})
