"""The axes of the phantom's heart, in patient LPS, as it lies when it is not mirrored."""

from __future__ import annotations

import numpy as np

__all__ = ["LONG_AXIS", "SEPTUM_AXIS", "UPWARD_AXIS"]

LONG_AXIS = np.array([0.66, -0.50, -0.56]) / np.linalg.norm([0.66, -0.50, -0.56])
"""From the base of the left ventricle to its apex."""
_TOWARDS_RIGHT = np.array([-0.55, -0.80, -0.10])
SEPTUM_AXIS = (_TOWARDS_RIGHT - (_TOWARDS_RIGHT @ LONG_AXIS) * LONG_AXIS) / np.linalg.norm(
    _TOWARDS_RIGHT - (_TOWARDS_RIGHT @ LONG_AXIS) * LONG_AXIS
)
"""From the left ventricle through the septum to the right one."""
UPWARD_AXIS = np.cross(SEPTUM_AXIS, LONG_AXIS)
"""Across both, upwards."""
