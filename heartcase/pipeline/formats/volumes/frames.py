"""One volume of a file that holds several: times of a heartbeat, as 4-D NIfTI, NRRD and MetaImage files have them."""

from __future__ import annotations

import math
import zlib
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, BinaryIO

import numpy as np
import numpy.typing as npt

from heartcase.pipeline.formats.volumes.nearest_time import listed_times, nearest_time
from heartcase.pipeline.warnings import CaseWarning
from heartcase.schemas.errors import ScanError

__all__ = ["FrameChoice", "FrameFound", "InflatedStream", "fully", "pick_frame", "read_frame"]

FRAME_LIMIT = 100_000
CHUNK = 2**22
ZLIB_OR_GZIP = zlib.MAX_WBITS | 32


@dataclass(frozen=True)
class FrameChoice:
    """Which volume the user wants; nothing where the file is to hold one."""

    frame: int | None = None
    """Its number, from 0."""
    time_ms: float | None = None
    """The nearest to this time, ms."""


@dataclass(frozen=True)
class FrameFound:
    """Which volume it is."""

    number: int
    """From 0."""
    time_ms: float | None
    """Its time, where the file says it, ms."""
    notes: tuple[CaseWarning, ...] = ()
    """What a reader should know of how it was chosen."""


def pick_frame(count: int, times_ms: Sequence[float] | None, choice: FrameChoice) -> FrameFound:
    """Choose one of several volumes.

    Parameters
    ----------
    count
        How many there are, two or more.
    times_ms
        The time of each, where the file says it.
    choice
        What is wanted.

    Raises
    ------
    ScanError
        Nothing is chosen, or what is not there: it lists the frames.
    """
    if count > FRAME_LIMIT:
        raise ScanError(f"the header claims {count} volumes: the file is damaged, export it again")
    times = tuple(times_ms) if times_ms is not None else None
    said = f", at {listed_times(times)} ms" if times is not None else ""
    by_time = " (or the time with --trigger-time MS, or trigger_time_ms)" if times is not None else ""
    remedy = f"choose one with --frame N, or frame in the recipe's [scan]{by_time}"
    if choice.frame is not None and choice.time_ms is not None:
        raise ScanError("both a frame and a time are given: give one of them (frame and trigger_time_ms in [scan])")
    if choice.time_ms is not None:
        if times is None:
            raise ScanError(
                f"the file holds {count} volumes but does not say when each is, with its unit, so that no time can "
                f"choose: use --frame N, or frame in the recipe's [scan], from 0 to {count - 1}"
            )
        notes: list[CaseWarning] = []
        time = nearest_time(times, choice.time_ms, "trigger", notes)
        return FrameFound(times.index(time), time, tuple(notes))
    if choice.frame is None:
        raise ScanError(f"the file is 4-D and holds {count} volumes (frames 0 to {count - 1}{said}): {remedy}")
    if choice.frame >= count:
        raise ScanError(f"there is no frame {choice.frame}, they are 0 to {count - 1}{said}: {remedy}")
    return FrameFound(choice.frame, times[choice.frame] if times is not None else None)


def read_frame(
    read: Callable[[int], bytes], size: Sequence[int], axis: int, frame: int, dtype: np.dtype[Any]
) -> npt.NDArray[Any]:
    """The values of one volume out of a stream that holds all of them, without keeping the others.

    Parameters
    ----------
    read
        Gives so many bytes of the stream, or raises.
    size
        Number of values along each of the four axes, the fastest first.
    axis
        Which of them counts the volumes.
    frame
        Number of the volume, from 0.
    dtype
        Type of a value.

    Returns
    -------
    ndarray
        Shape [z, y, x]. The stream is read to the end of the values.
    """
    inner, count, outer = math.prod(size[:axis]), size[axis], math.prod(size[axis + 1 :])
    values = np.empty((outer, inner), dtype=dtype)
    part = inner * dtype.itemsize
    if part * count > CHUNK:
        for row in range(outer):
            _skip(read, frame * part)
            values[row] = np.frombuffer(read(part), dtype=dtype)
            _skip(read, (count - 1 - frame) * part)
    else:
        rows = CHUNK // (part * count)
        for start in range(0, outer, rows):
            there = min(rows, outer - start)
            block = np.frombuffer(read(there * count * part), dtype=dtype).reshape(there, count, inner)
            values[start : start + there] = block[:, frame]
    x, y, z = (length for number, length in enumerate(size) if number != axis)
    return values.reshape(z, y, x)


def _skip(read: Callable[[int], bytes], count: int) -> None:
    while count > 0:
        count -= len(read(min(count, CHUNK)))


def fully(stream: Any, error: str) -> Callable[[int], bytes]:
    """What reads so many bytes of a stream, and raises a ScanError with these words where they are not there."""

    def read(count: int) -> bytes:
        found = bytes(stream.read(count))
        if len(found) < count:
            raise ScanError(error)
        return found

    return read


class InflatedStream:
    """What is packed in a zlib or gzip stream, a part at a time."""

    def __init__(self, packed: BinaryIO) -> None:
        self._packed = packed
        self._inflater = zlib.decompressobj(ZLIB_OR_GZIP)
        self._ready = b""

    def read(self, count: int) -> bytes:
        """The next bytes; fewer at the end of the stream, or where it is cut short."""
        parts, missing = [], count
        while missing > 0:
            if self._ready:
                parts.append(self._ready[:missing])
                self._ready = self._ready[missing:]
                missing -= len(parts[-1])
                continue
            source = self._inflater.unconsumed_tail or self._packed.read(2**16)
            if self._inflater.eof or not source:
                break
            self._ready = self._inflater.decompress(source, max(missing, 2**16))
        return b"".join(parts)

    @property
    def is_whole(self) -> bool:
        """Whether the stream was read to its end, and its checksum is right."""
        return self._inflater.eof
