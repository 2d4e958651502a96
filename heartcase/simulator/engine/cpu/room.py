"""Zeros for the CPU engine's arrays."""

from __future__ import annotations

import mmap
from math import prod
from typing import Any

import numpy as np

from heartcase.schemas.arrays import Float32

__all__ = ["aligned", "untouched"]


def aligned(shape: tuple[int, ...]) -> Float32:
    """Zeros that start on a cache line: a vector load across two lines costs double."""
    line, size = 16, prod(shape)
    room = np.zeros(size + line, np.float32)
    shift = -(room.ctypes.data // room.itemsize) % line
    return room[shift : shift + size].reshape(shape)


def untouched(shape: tuple[int, ...], kind: Any = np.float32) -> Any:
    """Zeros, on a cache line too, that cost nothing before they are written: most of them never are.

    The allocator clears memory that was used before, all of it.
    """
    size = prod(shape)
    if not size:
        return np.zeros(shape, kind)
    byte_count = size * np.dtype(kind).itemsize
    if hasattr(mmap, "MAP_PRIVATE"):
        room = mmap.mmap(-1, byte_count, flags=mmap.MAP_PRIVATE | mmap.MAP_ANONYMOUS)
    else:
        room = mmap.mmap(-1, byte_count)
    return np.frombuffer(room, kind).reshape(shape)
