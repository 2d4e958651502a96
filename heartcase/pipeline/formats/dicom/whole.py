"""Telling a whole DICOM object that is no image from the remains of a damaged image.

The elements of its data set are walked from the first to the last (PS3.5 chapter 7): the last one must end where the
file ends. pydicom takes the end of a file for the end of a data set, wherever it comes.
"""

from __future__ import annotations

import io
import zlib
from typing import IO, Any

from pydicom.uid import UID_dictionary

from heartcase.pipeline.formats.dicom.file_meta import DEFLATED, INFLATED_LIMIT, LONG, UNDEFINED, read_file_meta
from heartcase.pipeline.formats.dicom.tags import text_of

__all__ = ["is_other_object"]

DICOMDIR = "1.2.840.10008.1.3.10"
"""Media storage directory: it has no SOP class of its own in its data set."""
BIG_ENDIAN = b"1.2.840.10008.1.2.2"
ITEM, ITEM_END, SEQUENCE_END = (0xFFFE, 0xE000), (0xFFFE, 0xE00D), (0xFFFE, 0xE0DD)
DEEPEST = 64
"""Sequences in sequences that are followed."""


class _CutShort(Exception):
    """The file ends within an element."""


def is_other_object(stream: IO[bytes], header: Any, *, media_class: str) -> bool:
    """Whether a file with the DICOM preamble is a whole object that is no image.

    Parameters
    ----------
    stream
        The file, at its start.
    header
        Values of its tags by keyword.
    media_class
        SOP class that the file meta information states; may be empty.

    Returns
    -------
    bool
        False for a data set that is cut short, empty, or without the identity that every object has, and for one of a
        kind that must hold an image.
    """
    if media_class == DICOMDIR:
        return True
    kind = text_of(header, "SOPClassUID")
    if not kind or not text_of(header, "SOPInstanceUID") or media_class not in ("", kind):
        return False
    if "Image Storage" in UID_dictionary.get(kind, ("",))[0]:
        return False
    return _ends_with_the_file(stream)


def _ends_with_the_file(stream: IO[bytes]) -> bool:
    body: IO[bytes] = stream
    try:
        place, syntax = read_file_meta(stream)
    except ValueError:
        return False
    if syntax == DEFLATED:
        stream.seek(place)
        inflater = zlib.decompressobj(-zlib.MAX_WBITS)
        try:
            body, place = io.BytesIO(inflater.decompress(stream.read(), INFLATED_LIMIT)), 0
        except zlib.error:
            return False
        if not inflater.eof:
            return False
    size = body.seek(0, io.SEEK_END)
    body.seek(place)
    # the first element tells by its letters whether value representations are written
    letters = body.read(6)[4:6]
    body.seek(place)
    is_explicit = letters.isalpha() and letters.isupper()
    try:
        _Walk(body, size, is_explicit=is_explicit, is_big=syntax == BIG_ENDIAN).data_set(size)
    except (_CutShort, RecursionError):
        return False
    return True


class _Walk:
    """Goes from element to element, and looks at no value."""

    def __init__(self, stream: IO[bytes], size: int, *, is_explicit: bool, is_big: bool) -> None:
        self.stream, self.size, self.is_explicit = stream, size, is_explicit
        self.order: Any = "big" if is_big else "little"

    def data_set(self, end: int | None, depth: int = 0) -> None:
        """The elements up to ``end``, or up to the delimiter of an item."""
        if depth > DEEPEST:
            raise _CutShort
        while end is None or self.stream.tell() < end:
            tag, kind, length = self._head()
            if end is None and tag == ITEM_END:
                return
            if length != UNDEFINED:
                self._skip(length)
            elif kind in (b"OB", b"OW", b"OF", b"OD"):
                self._fragments()
            else:
                self._items(depth + 1, is_explicit=self.is_explicit and kind != b"UN")

    def _head(self) -> tuple[tuple[int, int], bytes, int]:
        start = self._bytes(8)
        tag = self._number(start[:2]), self._number(start[2:4])
        if not self.is_explicit or tag[0] == 0xFFFE:
            return tag, b"", self._number(start[4:])
        if start[4:6] in LONG:
            return tag, start[4:6], self._number(self._bytes(4))
        return tag, start[4:6], self._number(start[6:])

    def _items(self, depth: int, *, is_explicit: bool) -> None:
        kept, self.is_explicit = self.is_explicit, is_explicit
        while (head := self._head())[0] != SEQUENCE_END:
            if head[0] != ITEM:
                raise _CutShort
            if head[2] == UNDEFINED:
                self.data_set(None, depth)
            else:
                self._skip(head[2])
        self.is_explicit = kept

    def _fragments(self) -> None:
        while (head := self._head())[0] != SEQUENCE_END:
            if head[0] != ITEM:
                raise _CutShort
            self._skip(head[2])

    def _skip(self, length: int) -> None:
        if self.stream.tell() + length > self.size:
            raise _CutShort
        self.stream.seek(length, io.SEEK_CUR)

    def _bytes(self, count: int) -> bytes:
        found = self.stream.read(count)
        if len(found) < count:
            raise _CutShort
        return found

    def _number(self, part: bytes) -> int:
        return int.from_bytes(part, self.order)
