"""What was marked where strokes went, so that they can be taken back: to any depth, in little memory.

The last stroke is kept as it is, since it may go on. Those before are kept as runs of voxels that follow on each other
and held the same value; and the oldest in a file that has no name, once all together are more than memory should hold.
"""

from __future__ import annotations

import tempfile
from dataclasses import dataclass
from typing import IO

import numpy as np

from heartcase.schemas.arrays import Int64, UInt8

__all__ = ["StrokeNotes"]

MOST_BYTES = 1 << 26
"""Of runs that are kept in memory."""


@dataclass(frozen=True)
class _InFile:
    """Where the runs of a stroke lie."""

    start: int
    length: int


class StrokeNotes:
    """For each stroke the voxels that it went over, and the value that each was marked with before: a stack."""

    def __init__(self) -> None:
        self._last: tuple[Int64, UInt8] | None = None
        self._packed: list[bytes | _InFile] = []
        self._file: IO[bytes] | None = None
        self._in_file = 0
        """How many of the packed ones, the first, lie in the file."""
        self._bytes = 0

    def __len__(self) -> int:
        """Number of strokes."""
        return len(self._packed) + (self._last is not None)

    @property
    def bytes_in_memory(self) -> int:
        """Bytes of what is kept, without the last stroke and what lies in the file."""
        return self._bytes

    def push(self, voxels: Int64, before: UInt8) -> None:
        """Note a stroke.

        Parameters
        ----------
        voxels
            Flat indices, int64, each once.
        before
            Value of each, uint8.
        """
        if self._last is not None:
            packed = _packed(*self._last)
            self._packed.append(packed)
            self._bytes += len(packed)
        self._last = (voxels, before)
        while self._bytes > MOST_BYTES:
            self._move_out()

    def extend(self, voxels: Int64, before: UInt8) -> None:
        """Add to the last stroke voxels that it had not gone over."""
        last_voxels, last_before = self.pop()
        self._last = (np.concatenate((last_voxels, voxels)), np.concatenate((last_before, before)))

    def pop(self) -> tuple[Int64, UInt8]:
        """Voxels and values of the last stroke, which is forgotten.

        Raises
        ------
        IndexError
            There is none.
        """
        if self._last is not None:
            last, self._last = self._last, None
            return last
        packed = self._packed.pop()
        if isinstance(packed, _InFile):
            file, self._in_file = self._spill, self._in_file - 1
            file.seek(packed.start)
            data = file.read(packed.length)
            file.truncate(packed.start)
            return _unpacked(data)
        self._bytes -= len(packed)
        return _unpacked(packed)

    @property
    def _spill(self) -> IO[bytes]:
        if self._file is None:
            # gone with the process; nobody else can open it
            self._file = tempfile.TemporaryFile(prefix="heartcase-")  # noqa: SIM115
        return self._file

    def _move_out(self) -> None:
        data = self._packed[self._in_file]
        if isinstance(data, _InFile):
            return
        start = self._spill.seek(0, 2)
        self._spill.write(data)
        self._packed[self._in_file] = _InFile(start, len(data))
        self._in_file += 1
        self._bytes -= len(data)


def _packed(voxels: Int64, before: UInt8) -> bytes:
    """Runs: first voxels (int32), lengths (int32), values."""
    order = np.argsort(voxels, kind="stable")
    voxels, before = voxels[order], before[order]
    is_first = np.ones(len(voxels), np.bool_)
    is_first[1:] = (np.diff(voxels) != 1) | (np.diff(before) != 0)
    first = np.flatnonzero(is_first)
    lengths = np.diff(first, append=len(voxels))
    return voxels[first].astype(np.int32).tobytes() + lengths.astype(np.int32).tobytes() + before[first].tobytes()


def _unpacked(data: bytes) -> tuple[Int64, UInt8]:
    count = len(data) // 9
    first = np.frombuffer(data, np.int32, count).astype(np.int64)
    lengths = np.frombuffer(data, np.int32, count, 4 * count)
    values = np.frombuffer(data, np.uint8, count, 8 * count)
    within = np.arange(lengths.sum()) - np.repeat(np.cumsum(lengths) - lengths, lengths)
    return np.repeat(first, lengths) + within, np.repeat(values, lengths)
