"""Which GPU the tests of ``make gpu`` run on, or why they cannot."""

from __future__ import annotations

import sys

from numba import cuda

if __name__ == "__main__":
    if not cuda.is_available():
        sys.exit(
            "make gpu: no NVIDIA GPU was found, or no driver (nvidia-smi), or no numba-cuda (pip install '.[cuda]')"
        )
    device = cuda.get_current_device()
    name = device.name.decode() if isinstance(device.name, bytes) else device.name
    print(f"{name}, {device.MULTIPROCESSOR_COUNT} multiprocessors")
