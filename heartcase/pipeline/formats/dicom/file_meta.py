"""The file meta information of a DICOM file: where it ends, and how what follows is written (PS3.10, section 7.1).

Its elements are gone through, as a reader does: the length that it states may be wrong, or missing.
"""

from __future__ import annotations

import zlib
from collections.abc import Callable
from typing import IO, NamedTuple

__all__ = ["DEFLATED", "INFLATED_LIMIT", "LONG", "UNDEFINED", "FileMeta", "check_deflated", "read_file_meta"]

DEFLATED = b"1.2.840.10008.1.2.1.99"
INFLATED_LIMIT = 2**31
"""Bytes to which a deflated file may expand."""
LONG = frozenset((b"OB", b"OD", b"OF", b"OL", b"OV", b"OW", b"SQ", b"SV", b"UC", b"UN", b"UR", b"UT", b"UV"))
"""Value representations whose length has four bytes after two that are reserved (PS3.5, section 7.1.2)."""
UNDEFINED = 0xFFFFFFFF
_UID_MOST = 64


class FileMeta(NamedTuple):
    """What is to be known before the data set is read."""

    end: int
    """Byte at which the data set begins."""
    syntax: bytes
    """Transfer syntax that is stated; empty where none is."""


def read_file_meta(stream: IO[bytes]) -> FileMeta:
    """Go through the file meta information, from the stream's start; leaves the stream anywhere.

    Raises
    ------
    ValueError
        Its elements do not follow one another.
    """
    syntax, place = b"", 132 if stream.read(132)[128:] == b"DICM" else 0
    while True:
        stream.seek(place)
        head = stream.read(12)
        if len(head) < 8 or head[:2] != b"\x02\x00":
            return FileMeta(place, syntax)
        is_long = head[4:6] in LONG
        length = int.from_bytes(head[8:12] if is_long else head[6:8], "little")
        value = place + (12 if is_long else 8)
        if not head[4:6].isalpha() or length == UNDEFINED:
            raise ValueError("the file meta information is damaged")
        if head[2:4] == b"\x10\x00":
            stream.seek(value)
            syntax = stream.read(min(length, _UID_MOST)).strip(b"\0 ")
        place = value + length


def _within_the_limit(size: int) -> None:
    if size > INFLATED_LIMIT:
        raise ValueError("expands beyond the limit")


def check_deflated(stream: IO[bytes], allowed: Callable[[int], None] = _within_the_limit) -> None:
    """Look how far a deflated data set expands, before all of it is read; leaves the stream at its start.

    Parameters
    ----------
    stream
        A file, at its start.
    allowed
        Called with each count of bytes that there are at least; raises where they are too many. When left out, those
        above INFLATED_LIMIT are.

    Raises
    ------
    ValueError
        The file meta information is damaged, or there are too many.
    """
    meta = read_file_meta(stream)
    if meta.syntax == DEFLATED:
        stream.seek(meta.end)
        inflater, size = zlib.decompressobj(-zlib.MAX_WBITS), 0
        while (block := stream.read(65536)) and not inflater.eof:
            while block and not inflater.eof:
                size += len(inflater.decompress(block, 2**24))
                block = inflater.unconsumed_tail
                allowed(size)
    stream.seek(0)
