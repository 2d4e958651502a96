"""Which GPU the tests of ``make gpu`` run on, or why they cannot."""

from __future__ import annotations

import sys

from numba import cuda


def device_told() -> str:
    """The GPU's name and size."""
    device = cuda.get_current_device()
    name = device.name.decode() if isinstance(device.name, bytes) else device.name
    return f"{name}, {device.MULTIPROCESSOR_COUNT} multiprocessors"


if __name__ == "__main__":
    if not cuda.is_available():
        sys.exit(
            "make gpu: no NVIDIA GPU was found, or no driver (nvidia-smi), or no numba-cuda (pip install '.[cuda]')"
        )
    print(device_told())
