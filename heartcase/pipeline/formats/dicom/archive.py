"""A zipped DICOM folder, as archives and web portals hand it out, read where it is.

Nothing is unpacked onto the disk: an entry is read into memory when it is needed, so no name in the archive is ever a
path, and nothing of the patient is left behind. What an archive may claim is bounded before any of it is read.
"""

from __future__ import annotations

import io
import stat
import zipfile
from dataclasses import dataclass, field
from pathlib import Path, PurePosixPath
from typing import IO

from heartcase.schemas.errors import ScanError
from heartcase.schemas.files import is_there

__all__ = ["FILE_LIMIT", "ArchivedFile", "SourceFile", "archived_files", "is_archive"]

FILE_LIMIT = 100_000
"""Files that a folder or an archive may hold."""
FILE_BYTES = 2**32
"""Largest file that an archive may hold, bytes."""
TOTAL_BYTES = 2**36
"""Bytes that all files of an archive may have together."""
RATIO_LIMIT = 200
"""Times by which an archive may expand: images with nothing but padding shrink by less."""
RATIO_FREE_BYTES = 2**28
"""Bytes that it may have in any case."""
MARKS = (b"PK\x03\x04", b"PK\x05\x06")
"""How an archive starts, with files and without."""
METHODS = (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED, zipfile.ZIP_BZIP2, zipfile.ZIP_LZMA)
DAMAGED = "the archive is cut short or damaged: copy it again"


@dataclass(frozen=True)
class ArchivedFile:
    """A file in an archive, with as much of a path's interface as the readers use."""

    archive: zipfile.ZipFile = field(repr=False, compare=False)
    """Stays open as long as one of its files is held."""
    name: str
    """Its name in there; goes into no message."""
    size: int
    """Bytes."""

    @property
    def suffix(self) -> str:
        """Ending of the name, with its dot."""
        return PurePosixPath(self.name).suffix

    def open(self, mode: str = "rb") -> IO[bytes]:
        """The content, read whole and checked, as a stream.

        Raises
        ------
        OSError
            It is damaged.
        """
        return io.BytesIO(self.read_bytes())

    def read_bytes(self) -> bytes:
        """The content.

        Raises
        ------
        OSError
            It is damaged.
        """
        try:
            return self.archive.read(self.name)
        except Exception:  # zipfile and its decompressors raise errors of every kind on damaged archives
            raise OSError(DAMAGED) from None


SourceFile = Path | ArchivedFile


def is_archive(path: Path) -> bool:
    """Whether this is a file that is a zip archive, or is named like one."""
    if not (is_there(path) and path.is_file()):
        return False
    if path.suffix.lower() == ".zip":
        return True
    try:
        with path.open("rb") as stream:
            return stream.read(4) in MARKS
    except OSError:
        return False


def archived_files(path: Path) -> list[SourceFile]:
    """The files of an archive, in the order in which those of the unpacked folder would be looked at.

    Parameters
    ----------
    path
        The archive.

    Returns
    -------
    list
        Every file in it; archives in it are not opened.

    Raises
    ------
    ScanError
        It is damaged, encrypted, holds links or names that lead out of it, or would expand beyond what a scan needs.
    """
    try:
        archive = zipfile.ZipFile(path)
        entries = [entry for entry in archive.infolist() if not entry.is_dir()]
    except Exception:  # as above
        raise ScanError(DAMAGED) from None
    if len(entries) > FILE_LIMIT:
        raise ScanError(f"there are more than {FILE_LIMIT} files in this archive: give that of the scan alone")
    total = sum(entry.file_size for entry in entries)
    packed = sum(entry.compress_size for entry in entries)
    largest = max((entry.file_size for entry in entries), default=0)
    is_bomb = total > max(RATIO_FREE_BYTES, RATIO_LIMIT * min(packed, path.stat().st_size))
    if is_bomb or total > TOTAL_BYTES or largest > FILE_BYTES:
        raise ScanError(
            "the archive would expand to far more than a scan needs: if it is one, unpack it, and give the folder"
        )
    if any(entry.flag_bits & 1 for entry in entries):
        raise ScanError("the archive is encrypted: unpack it with its password, and give the folder")
    if any(entry.compress_type not in METHODS for entry in entries):
        raise ScanError("the archive is packed in a way that is not read: unpack it, and give the folder")
    names = [PurePosixPath(entry.filename.replace("\\", "/")) for entry in entries]
    is_link = any(stat.S_ISLNK(entry.external_attr >> 16) for entry in entries)
    leads_out = any(name.is_absolute() or ".." in name.parts or ":" in name.parts[0] for name in names if name.parts)
    if is_link or leads_out or len(set(names)) < len(names):
        raise ScanError(
            "the archive holds links, names that lead out of it, or two files of one name, as no archive of a scan "
            "does: have it made again"
        )
    order = sorted(range(len(entries)), key=lambda n: _walking_order(names[n]))
    return [ArchivedFile(archive, entries[n].filename, entries[n].file_size) for n in order]


def _walking_order(name: PurePosixPath) -> tuple[tuple[int, str], ...]:
    """Sorts as a walk through folders does: the files of a folder by name, then those of its folders."""
    return (*((1, folder) for folder in name.parts[:-1]), (0, name.name))
