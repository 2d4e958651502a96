"""What the C library does with memory that is given back."""

from __future__ import annotations

import contextlib
import ctypes
import sys

__all__ = ["allocate_from_one_heap"]

_M_ARENA_MAX = -8
"""Number of this parameter of ``mallopt`` in the GNU C library."""


def allocate_from_one_heap() -> None:
    """Have all threads of this process share one heap; where the C library is not GNU's, nothing changes.

    By itself each new thread may get a heap of its own, whose free pieces no other thread takes. A server that works
    each cut out in a thread of its own then grows, though nothing is kept (``python -m tests.studio.page.growth``).
    """
    if sys.platform != "linux":
        return
    with contextlib.suppress(OSError, AttributeError):
        ctypes.CDLL(None).mallopt(ctypes.c_int(_M_ARENA_MAX), ctypes.c_int(1))
