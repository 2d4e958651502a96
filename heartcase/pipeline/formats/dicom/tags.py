"""Reading single tags of a DICOM data set without trusting what they hold."""

from __future__ import annotations

import decimal
import logging
import re
import warnings
from collections.abc import Collection, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import IO, Any

import numpy as np
import pydicom
from pydicom.datadict import keyword_for_tag

from heartcase.pipeline.formats.dicom.archive import SourceFile
from heartcase.pipeline.formats.dicom.file_meta import check_deflated

__all__ = [
    "Header",
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
        check_deflated(stream)
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
        check_deflated(stream)
        dataset = pydicom.dcmread(stream, force=True)
    if not hasattr(dataset, "file_meta") or "TransferSyntaxUID" not in dataset.file_meta:
        dataset.ensure_file_meta()
        dataset.file_meta.TransferSyntaxUID = pydicom.uid.ImplicitVRLittleEndian
    return dataset


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
