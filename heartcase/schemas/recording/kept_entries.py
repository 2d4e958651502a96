"""The entries of a session's history: late ones at hand, older ones in a file, so that hours take little memory.

A hand that is led adds some sixty entries a second. As objects they take about 1 KB each; so all but the last are
written, in blocks of JSON lines as in a log, into a nameless file of the system's temporary folder, and read from there
when a session goes back that far.
"""

from __future__ import annotations

import contextlib
import tempfile
import threading
import weakref
from bisect import bisect_left, bisect_right
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from typing import BinaryIO, cast, overload

from heartcase.schemas.errors import RecordingError
from heartcase.schemas.recording.commands import Advance, Entry, LeadGrab, MoveProbe
from heartcase.schemas.recording.suture_commands import DrawStitch
from heartcase.schemas.recording.tool_commands import PlaceScissors, SqueezeForceps

__all__ = ["BLOCK", "KeptEntries"]

BLOCK = 512
"""Entries that are put into the file together; up to twice as many are at hand."""
_FREQUENT = (Advance, LeadGrab, MoveProbe, SqueezeForceps, PlaceScissors, DrawStitch)
"""What comes with every frame: of all else the places are known without reading."""


@dataclass(frozen=True)
class _Block:
    """Entries that were put away."""

    end_step: int
    """Step after the last of them."""
    place: int
    """Where in the file they begin."""
    size: int
    """Bytes there."""
    kinds: frozenset[type]
    """Which commands they are."""
    content: bytes | None = None
    """The bytes, where the file could not be written."""


class KeptEntries(Sequence[Entry]):
    """A history's entries: appended and dropped at the end, read anywhere. Threads may read while one writes.

    Parameters
    ----------
    entries
        What is known to begin with.
    block
        Entries that are put into the file together.
    """

    def __init__(self, entries: Iterable[Entry] = (), *, block: int = BLOCK) -> None:
        self._block = block
        self._blocks: list[_Block] = []
        self._late: list[Entry] = []
        self._rare: list[int] = []
        self._rare_kinds: list[type] = []
        self._appended = 0
        self._runs: list[tuple[int, int]] = []
        self._file: BinaryIO | None = None
        self._read: tuple[_Block, list[bytes]] | None = None
        self._lock = threading.RLock()
        for entry in entries:
            self.append(entry)

    def __len__(self) -> int:
        """How many there are."""
        with self._lock:
            return len(self._blocks) * self._block + len(self._late)

    @overload
    def __getitem__(self, at: int) -> Entry: ...

    @overload
    def __getitem__(self, at: slice) -> list[Entry]: ...

    def __getitem__(self, at: int | slice) -> Entry | list[Entry]:
        """One of them, or a list of several.

        Raises
        ------
        RecordingError
            The file cannot be read any more.
        """
        with self._lock:
            if isinstance(at, slice):
                return [self._one(number) for number in range(*at.indices(len(self)))]
            number = range(len(self))[at]
            return self._one(number)

    def __eq__(self, other: object) -> bool:
        """Whether a sequence has the same entries."""
        if not isinstance(other, Sequence):
            return NotImplemented
        return len(self) == len(other) and all(mine == its for mine, its in zip(self, other, strict=True))

    __hash__ = None  # type: ignore[assignment]

    def append(self, entry: Entry) -> None:
        """Add one at the end."""
        with self._lock:
            number = len(self)
            if not self._runs:
                self._runs.append((number, self._appended))
            self._late.append(entry)
            self._appended += 1
            if not isinstance(entry.command, _FREQUENT):
                self._rare.append(number)
                self._rare_kinds.append(type(entry.command))
            if len(self._late) >= 2 * self._block:
                self._put_away()

    def drop_from(self, position: int) -> None:
        """Drop all but the first ``position``."""
        with self._lock:
            if position >= len(self):
                return
            # the last that stay are at hand again
            while self._blocks and position <= len(self._blocks) * self._block:
                self._late[:0] = self._entries_of(len(self._blocks) - 1)
                self._blocks.pop()
                self._read = None
            del self._late[position - len(self._blocks) * self._block :]
            rare = bisect_left(self._rare, position)
            del self._rare[rare:], self._rare_kinds[rare:]
            self._runs = [run for run in self._runs if run[0] < position]
            self._runs.append((position, self._appended))

    def origin(self, position: int) -> int:
        """A number that the entry at a position has, and no other that ever was there or elsewhere in this history."""
        with self._lock:
            first, count = self._runs[bisect_right(self._runs, (position, self._appended)) - 1]
            return count + position - first

    def places_of(self, kinds: type | tuple[type, ...], start: int = 0, end: int | None = None) -> list[int]:
        """Positions of commands of these kinds, of those from ``start`` to before ``end``.

        Of what is led with every frame none is found: it is not looked for.
        """
        with self._lock:
            wanted = range(
                bisect_left(self._rare, start), len(self._rare) if end is None else bisect_left(self._rare, end)
            )
            return [self._rare[n] for n in wanted if issubclass(self._rare_kinds[n], kinds)]

    def last_of(
        self, kinds: type | tuple[type, ...], is_it: Callable[[Entry], bool], end: int | None = None
    ) -> tuple[int, Entry] | None:
        """Position and entry of the last command of these kinds, before ``end``, for which something holds, or None.

        In one go: what another thread drops meanwhile is either still there or not.
        """
        with self._lock:
            for number in reversed(self.places_of(kinds, end=end)):
                entry = self._one(number)
                if is_it(entry):
                    return number, entry
            return None

    def has_any(self, kinds: tuple[type, ...], start: int, end: int) -> bool:
        """Whether a command of these kinds stands from ``start`` to before ``end``."""
        with self._lock:
            if self.places_of(kinds, start, end):
                return True
            while start < min(end, len(self)):
                number, within = divmod(start, self._block)
                stop = min(end, (number + 1) * self._block)
                known = self._blocks[number].kinds if number < len(self._blocks) else None
                places = range(start, min(stop, len(self)))
                # a block that has none of them is not read
                is_read = known is None or any(issubclass(kind, kinds) for kind in known)
                if is_read and any(isinstance(self._one(at).command, kinds) for at in places):
                    return True
                start += self._block - within
            return False

    def first_beyond(self, step: int) -> int:
        """Position of the first entry that ends after a step; how many there are where none does."""
        with self._lock:
            number = bisect_right(self._blocks, step, key=lambda block: block.end_step)
            first = number * self._block
            entries = self._entries_of(number) if number < len(self._blocks) else self._late
            return first + bisect_right(entries, step, key=lambda entry: entry.end_step)

    def _one(self, number: int) -> Entry:
        block, within = divmod(number, self._block)
        if block < len(self._blocks):
            return Entry.model_validate_json(self._lines_of(block)[within])
        return self._late[number - len(self._blocks) * self._block]

    def _entries_of(self, number: int) -> list[Entry]:
        return [Entry.model_validate_json(line) for line in self._lines_of(number)]

    def _lines_of(self, number: int) -> list[bytes]:
        block = self._blocks[number]
        if self._read is None or self._read[0] is not block:
            content = block.content
            if content is None:
                content = self._read_back(block)
            self._read = block, content.split(b"\n")
        return self._read[1]

    def _read_back(self, block: _Block) -> bytes:
        try:
            file = cast(BinaryIO, self._file)
            file.seek(block.place)
            content = file.read(block.size)
        except (OSError, ValueError):
            content = b""
        if len(content) != block.size:
            raise RecordingError("what was done earlier cannot be read any more: begin anew", place="history")
        return content

    def _put_away(self) -> None:
        """Put the first of those at hand into the file; what the system refuses stays in memory as bytes."""
        early, self._late = self._late[: self._block], self._late[self._block :]
        content = b"\n".join(entry.model_dump_json(exclude_none=True).encode() for entry in early)
        last = self._blocks[-1] if self._blocks else None
        place = 0 if last is None else last.place + (last.size if last.content is None else 0)
        kinds = frozenset(type(entry.command) for entry in early)
        block = _Block(early[-1].end_step, place, len(content), kinds)
        try:
            if self._file is None:
                self._file = self._opened()
            self._file.seek(place)
            if self._file.write(content) != len(content):
                raise OSError
        except OSError:
            block = replace(block, content=content)
        self._blocks.append(block)

    def _opened(self) -> BinaryIO:
        # held for as long as the history is
        file = cast(BinaryIO, tempfile.TemporaryFile(prefix="heartcase-", buffering=0))  # noqa: SIM115
        weakref.finalize(self, _closed, file)
        return file


def _closed(file: BinaryIO) -> None:
    with contextlib.suppress(OSError):
        file.close()
