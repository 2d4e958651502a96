"""What NRRD and MetaImage share: a header of text lines before the values, which may be in a data file beside it."""

from __future__ import annotations

from pathlib import Path

from heartcase.pipeline.formats.volumes.raw_volume import DAMAGED, require_file
from heartcase.schemas.errors import ScanError

__all__ = [
    "HEADER_LIMIT",
    "MILLIMETRES",
    "NOT_MILLIMETRES",
    "NO_KNOWN_TYPE",
    "NO_SPACING",
    "integers_of",
    "local_data_file",
    "start_of_file",
]

HEADER_LIMIT = 2**22
"""Longest text header that is read, bytes."""
MILLIMETRES = frozenset({"", "mm", "millimeter", "millimeters", "millimetre", "millimetres"})
"""Words for the unit of lengths, in small letters; a header without one means millimetres."""
NOT_MILLIMETRES = "the positions are not in millimetres: convert the scan to millimetres and export it again"
NO_KNOWN_TYPE = "the header gives no known type of values: export the file again"
NO_SPACING = (
    "the header does not give the voxel spacing of every axis as a number above zero: export the file again, with its "
    "spacing"
)


def start_of_file(path: Path) -> bytes:
    """As many bytes from the start of a file as a header may have.

    Raises
    ------
    ScanError
        There is no such file, or nothing is in it.
    """
    require_file(path)
    with path.open("rb") as file:
        return file.read(HEADER_LIMIT)


def local_data_file(path: Path, name: str) -> Path:
    """The data file that a detached header names, which must be beside it: a header must not reach other files.

    Raises
    ------
    ScanError
        It names several files or one elsewhere, or there is none.
    """
    if name.upper().startswith("LIST") or "%" in name:
        raise ScanError("the slices are in separate files: export the scan as one file")
    if name != Path(name).name or "\\" in name:
        raise ScanError("the header names a data file in another folder: put both files into one folder")
    data = path.parent / name
    try:
        require_file(data)
    except ScanError:
        raise ScanError("the data file that belongs to this header is missing or empty: put it beside it") from None
    return data


def integers_of(text: str) -> tuple[int, ...]:
    """Whole numbers of a header's line.

    Raises
    ------
    ScanError
        It holds anything else.
    """
    try:
        return tuple(int(word) for word in text.split())
    except ValueError:
        raise ScanError(DAMAGED) from None
