"""CUDA kernels run on a device where there is one, else in numba's simulator: chosen before numba is loaded."""

import ctypes
import os


def _has_driver() -> bool:
    try:
        ctypes.CDLL("nvcuda.dll" if os.name == "nt" else "libcuda.so.1")
    except OSError:
        return False
    return True


if not _has_driver():
    os.environ.setdefault("NUMBA_ENABLE_CUDASIM", "1")
