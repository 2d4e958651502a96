"""Reading single tags of a DICOM data set without trusting what they hold."""

from __future__ import annotations

import decimal
import logging
import re
import warnings
import zlib
from collections.abc import Callable, Collection, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import IO, Any

import numpy as np
import pydicom
from pydicom.datadict import keyword_for_tag

from heartcase.pipeline.formats.dicom.archive import SourceFile

__all__ = [
    "INFLATED_LIMIT",
    "Header",
    "check_deflated",
    "decimals_of",
    "has_preamble",
    "numbers_of",
    "quiet_pydicom",
    "read_data_set",
    "read_header",
    "seconds_of",
    "sequence_of",
    "text_of",
    "values_of",
    "words_of",
]

DEFLATED = b"1.2.840.10008.1.2.1.99"
INFLATED_LIMIT = 2**31
"""Bytes to which a deflated file may expand."""
_LONG = frozenset([b"OB", b"OD", b"OF", b"OL", b"OV", b"OW", b"SQ", b"SV", b"UC", b"UN", b"UR", b"UT", b"UV"])
"""Value representations whose lengths are written in four bytes (DICOM PS3.5, section 7.1.2)."""


@contextmanager
def quiet_pydicom() -> Iterator[None]:
    """Keep pydicom's warnings, which quote the tags that they complain about, from being shown or logged."""
    logger = logging.getLogger("pydicom")
    was_disabled = logger.disabled
    logger.disabled = True
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            yield
    finally:
        logger.disabled = was_disabled


def has_preamble(stream: IO[bytes]) -> bool | None:
    """True with the DICOM preamble, False for a bare data set, None for anything else; rewinds the stream."""
    start = stream.read(132)
    stream.seek(0)
    if start[128:] == b"DICM":
        return True
    return False if start[:2] in (b"\x08\x00", b"\x02\x00") and len(start) == 132 else None


@dataclass(frozen=True)
class Header:
    """What the head of a file holds."""

    values: dict[str, Any]
    """Values of the wanted tags by keyword; None for one that cannot be read."""
    has_preamble: bool
    """Whether the file starts with the DICOM preamble, so that it is sure to be one."""
    media_class: str
    """SOP class that the file meta information states; empty where it states none."""


def read_header(file: SourceFile, tags: list[str]) -> Header | None:
    """The named tags that a file holds, read up to its pixels; None where it does not start as DICOM does."""
    with file.open("rb") as stream:
        preamble = has_preamble(stream)
        if preamble is None:
            return None
        check_deflated(stream, _allow)
        dataset = pydicom.dcmread(stream, stop_before_pixels=True, specific_tags=list(tags), force=not preamble)
    media_class = text_of(getattr(dataset, "file_meta", None) or {}, "MediaStorageSOPClassUID")
    return Header(values_of(dataset), preamble, media_class)


def values_of(dataset: Any, keywords: Collection[str] | None = None) -> dict[str, Any]:
    """The values of a data set by keyword, all or those that are named; None for one that cannot be read.

    A dict, since looking up the many tags that are not there is slow in a data set.
    """
    values: dict[str, Any] = {}
    for tag in tuple(dataset.keys()):
        keyword = keyword_for_tag(tag)
        if keywords is None or keyword in keywords:
            try:
                values[keyword] = dataset[tag].value
            except Exception:  # pydicom raises errors of every kind on damaged files
                values[keyword] = None
    return values


def read_data_set(file: SourceFile) -> Any:
    """A whole file; one without file meta information is taken as implicit little endian, DICOM's default."""
    with file.open("rb") as stream:
        check_deflated(stream, _allow)
        dataset = pydicom.dcmread(stream, force=True)
    if not hasattr(dataset, "file_meta") or "TransferSyntaxUID" not in dataset.file_meta:
        dataset.ensure_file_meta()
        dataset.file_meta.TransferSyntaxUID = pydicom.uid.ImplicitVRLittleEndian
    return dataset


def check_deflated(stream: IO[bytes], allowed: Callable[[int], None]) -> None:
    """Look how far a deflated data set expands, before all of it is read; leaves the stream at its start.

    Parameters
    ----------
    stream
        A file, at its start.
    allowed
        Called with each count of bytes that there are at least; raises where they are too many.

    Raises
    ------
    ValueError
        The elements of the file meta information do not follow one another.
    """
    start, is_deflated = _meta_end(stream)
    if is_deflated:
        stream.seek(start)
        inflater, size = zlib.decompressobj(-zlib.MAX_WBITS), 0
        while (block := stream.read(65536)) and not inflater.eof:
            while block and not inflater.eof:
                size += len(inflater.decompress(block, 2**24))
                block = inflater.unconsumed_tail
                allowed(size)
    stream.seek(0)


def _meta_end(stream: IO[bytes]) -> tuple[int, bool]:
    """Where the file meta information ends, and whether it says that what follows is deflated.

    Its elements are gone through, as a reader does: the length that it states may be wrong, or missing.
    """
    is_deflated, place = False, 132 if stream.read(132)[128:] == b"DICM" else 0
    while True:
        stream.seek(place)
        head = stream.read(12)
        if len(head) < 8 or head[:2] != b"\x02\x00":
            return place, is_deflated
        is_long = head[4:6] in _LONG
        length = int.from_bytes(head[8:12] if is_long else head[6:8], "little")
        value = place + (12 if is_long else 8)
        if not head[4:6].isalpha() or length == 2**32 - 1:
            raise ValueError("the file meta information is damaged")
        if head[2:4] == b"\x10\x00":
            stream.seek(value)
            is_deflated = stream.read(min(length, 64)).strip(b"\0 ") == DEFLATED
        place = value + length


def _allow(size: int) -> None:
    if size > INFLATED_LIMIT:
        raise ValueError("expands beyond the limit")


def sequence_of(holder: Any, keyword: str) -> Any:
    """The items of a sequence; None where there is none."""
    if holder is None:
        return None
    try:
        return holder.get(keyword)
    except Exception:  # pydicom raises errors of every kind on damaged files
        return None


def text_of(header: Any, keyword: str) -> str:
    """The text of a tag; empty where it is missing or holds anything else."""
    try:
        value = header.get(keyword)
        return value.strip() if isinstance(value, str) else ""
    except Exception:  # as above
        return ""


def words_of(header: Any, keyword: str) -> tuple[str, ...]:
    """The texts of a tag with several values."""
    try:
        value = header.get(keyword)
        parts = [value] if isinstance(value, str) else list(value or ())
        return tuple(part.strip() for part in parts if isinstance(part, str))
    except Exception:  # as above
        return ()


def numbers_of(header: Any, keyword: str, count: int) -> tuple[float, ...] | None:
    """The numbers of a tag; None where it is missing, has another count, or holds anything else."""
    try:
        value = header.get(keyword)
        if value is None or isinstance(value, str):
            return None
        numbers = tuple(float(part) for part in (value if count > 1 else [value]))
    except Exception:  # as above
        return None
    return numbers if len(numbers) == count and bool(np.isfinite(numbers).all()) else None


def decimals_of(header: Any, keyword: str) -> tuple[int, ...]:
    """Decimals in which each number of a tag is written, as decimal strings are; empty where that is not known."""
    try:
        texts = [str(part.original_string).strip() for part in header.get(keyword)]
        return tuple(max(0, -int(decimal.Decimal(text).as_tuple().exponent)) for text in texts)
    except Exception:  # as above
        return ()


def seconds_of(header: Any, keyword: str) -> float | None:
    """A time of day, HHMMSS.FFFFFF, in seconds; None where it is missing or holds anything else."""
    match = re.fullmatch(r"([01]\d|2[0-3])([0-5]\d)([0-5]\d(?:\.\d{1,6})?)", text_of(header, keyword))
    return None if match is None else 3600.0 * int(match[1]) + 60.0 * int(match[2]) + float(match[3])
