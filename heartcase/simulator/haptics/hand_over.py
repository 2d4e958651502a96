"""Numbers handed from one process to another without a lock: the writer never waits, the reader takes the newest whole.

A ring of rows in shared memory. Each row carries its number and a check over all its bits, so that a row that is being
written while it is read is told from a whole one in whatever order a processor makes writes visible; the reader then
takes the row before. With two rows it is a double buffer.
"""

from __future__ import annotations

import multiprocessing
from typing import Any

import numpy as np

from heartcase.schemas.arrays import Float64, Int64

__all__ = ["Ring", "shared_memory"]

_HEAD = 1
_EXTRA = 2


def shared_memory(row_count: int, width: int) -> Any:
    """Memory for a ring, to be handed to processes as they start."""
    return multiprocessing.get_context("spawn").RawArray("d", _HEAD + row_count * (width + _EXTRA))


class Ring:
    """The last rows that were written. One writer, any number of readers.

    Parameters
    ----------
    memory
        What :func:`shared_memory` gave for the same numbers.
    row_count
        Rows that are kept, at least 2.
    width
        Numbers in a row.
    """

    def __init__(self, memory: Any, row_count: int, width: int) -> None:
        numbers = np.frombuffer(memory, dtype=np.float64)
        self._newest: Int64 = numbers[:_HEAD].view(np.int64)
        self._rows = numbers[_HEAD:].reshape(row_count, width + _EXTRA)
        self._bits: Int64 = self._rows.view(np.int64)
        self._scratch = np.empty(width + _EXTRA)
        self._scratch_bits: Int64 = self._scratch.view(np.int64)

    @property
    def written_count(self) -> int:
        """Rows written since the start."""
        return int(self._newest[0])

    def write(self, values: Float64) -> int:
        """Write a row; its number, from 1, is returned."""
        number = self.written_count + 1
        self._scratch_bits[0] = number
        self._scratch[1:-1] = values
        self._scratch_bits[-1] = np.bitwise_xor.reduce(self._scratch_bits[:-1])
        self._bits[number % len(self._bits)] = self._scratch_bits
        self._newest[0] = number
        return number

    def latest(self) -> tuple[int, Float64] | None:
        """Number and values of the newest whole row; None before the first."""
        newest = self.written_count
        for number in range(newest, max(newest - len(self._rows), 0), -1):
            row = self._whole(number)
            if row is not None:
                return number, row
        return None

    def last(self, count: int) -> Float64:
        """The newest rows in the order in which they were written, those that are whole; shape (up to count, width)."""
        newest = self.written_count
        numbers = np.arange(max(newest - min(count, len(self._rows)), 0) + 1, newest + 1)
        bits = self._bits[numbers % len(self._bits)]
        is_whole = (bits[:, 0] == numbers) & (np.bitwise_xor.reduce(bits, axis=1) == 0)
        rows: Float64 = bits[is_whole, 1:-1].view(np.float64)
        return rows

    def _whole(self, number: int) -> Float64 | None:
        bits = self._bits[number % len(self._bits)].copy()
        if bits[0] != number or np.bitwise_xor.reduce(bits) != 0:
            return None
        row: Float64 = bits[1:-1].view(np.float64)
        return row
