"""Folders of this machine as the start page shows them: none outside of those that the studio was started with."""

from __future__ import annotations

import gzip
import os
import zlib
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from heartcase.pipeline.formats.volumes.nifti_intent import INTENT_AT, LABEL_INTENT
from heartcase.schemas.bundle.format import MANIFEST_NAME
from heartcase.schemas.errors import UsageError

__all__ = ["ENTRY_COUNT_MAX", "OUTSIDE", "Roots"]

ENTRY_COUNT_MAX = 500
"""Entries of a folder that are shown at most."""
OUTSIDE = "outside"
"""Place of the problem that a path leads out of all folders: the page says in its language what to do."""
_LOOKED_AT_MAX = 20_000
"""Entries of a folder that are looked at, at most."""
_SCANS = (".nii", ".nii.gz", ".nrrd", ".nhdr", ".mha", ".mhd")
_SEGMENTATIONS = (".seg.nrrd", ".seg.nhdr")
_DICOM = (".dcm", ".dicom", ".ima")
_ORDER = ("recipe", "case", "folder", "scan", "zip", "dicom")
_DICOM_START = 128
_FIRST_BYTES = 4096


@dataclass(frozen=True)
class Roots:
    """Folders that may be looked into.

    Parameters
    ----------
    folders
        The folders, resolved.
    begin
        Where the start page begins, in one of them; the first when left out.
    """

    folders: tuple[Path, ...]
    begin: Path | None = None

    @classmethod
    def of(cls, folders: Sequence[Path]) -> Roots:
        """Those of these folders that are there and have a name that is text, each once, and none in another one."""
        found: list[Path] = []
        for folder in dict.fromkeys(one.resolve() for one in folders):
            if folder.is_dir() and _is_text(str(folder)) and not any(folder.is_relative_to(one) for one in found):
                found.append(folder)
        return cls(tuple(found))

    def beginning_in(self, folder: Path) -> Roots:
        """The same, beginning in a folder inside of one, where that holds anything that can be opened."""
        try:
            begin = self.inside(folder)
            is_full = begin.is_dir() and bool(_entries(begin)[0])
        except UsageError:
            return self
        return replace(self, begin=begin) if is_full else self

    def inside(self, path: str | Path) -> Path:
        """A path with its links followed.

        Raises
        ------
        UsageError
            It leads out of all folders that may be looked into, or there is nothing.
        """
        try:
            found = Path(path).expanduser()
            found = (found if found.is_absolute() else self.folders[0] / found).resolve()
            is_inside = any(found.is_relative_to(one) for one in self.folders)
            is_there = is_inside and found.exists()
        except (OSError, ValueError, RuntimeError, IndexError):
            raise UsageError("this is no path: check its spelling", place="path") from None
        if not is_inside:
            raise UsageError(
                "this lies outside of the folders that the studio was started with: end heartcase, and start it with "
                'that folder: heartcase studio "THE FOLDER"',
                place=OUTSIDE,
            )
        if not is_there:
            raise UsageError("there is nothing at this path: check its spelling", place="path")
        return found

    def named(self, folder: Path) -> str | None:
        """A folder as the page is told it unasked: from the name of one of these on; None for one elsewhere."""
        for root in self.folders:
            if folder.is_relative_to(root):
                words = (Path(root.name or root.anchor) / folder.relative_to(root)).as_posix()
                return words if _is_text(words) else None
        return None

    def listing(self, path: str | Path | None) -> dict[str, Any]:
        """What a folder holds that the studio opens, as plain data; where the page begins if no path is given.

        Raises
        ------
        UsageError
            It cannot be looked into.
        """
        if not self.folders:
            raise UsageError("there is no folder to look into: start heartcase studio with one", place="path")
        folder = (self.begin or self.folders[0]) if path is None else self.inside(path)
        chosen = None
        if not folder.is_dir():
            folder, chosen = folder.parent, folder.name
        found, is_cut = _entries(folder)
        # a slice is no scan: the files are counted, and their series are listed together
        single = [one for one in found if one[0] != "dicom"]
        parent = folder.parent
        return {
            "path": str(folder),
            "chosen": chosen,
            "parent": str(parent) if any(parent.is_relative_to(one) for one in self.folders) else None,
            "roots": [str(one) for one in self.folders],
            "entries": [{"name": name, "kind": kind} for kind, name in single[:ENTRY_COUNT_MAX]],
            "more": max(len(single) - ENTRY_COUNT_MAX, 0),
            "dicom_count": len(found) - len(single),
            "is_cut": is_cut,
        }


def _entries(folder: Path) -> tuple[list[tuple[str, str]], bool]:
    """Kind and name of what can be opened, and whether there is more than is looked at."""
    found: list[tuple[str, str]] = []
    try:
        with os.scandir(folder) as entries:
            for number, entry in enumerate(entries):
                if number == _LOOKED_AT_MAX:
                    return _ordered(found), True
                # a name that is no text cannot be sent, nor asked for
                if entry.name.startswith(".") or not _is_text(entry.name):
                    continue
                kind = _kind(entry)
                if kind is not None:
                    found.append((kind, entry.name))
    except OSError as error:
        reason = (error.strerror or "the system gives no reason").lower()
        raise UsageError(f"this folder cannot be read: {reason}", place="path") from None
    return _ordered(found), False


def _ordered(found: list[tuple[str, str]]) -> list[tuple[str, str]]:
    return sorted(found, key=lambda one: (_ORDER.index(one[0]), one[1].lower()))


def _is_text(name: str) -> bool:
    return name.isprintable() and not any("\ud800" <= letter <= "\udfff" for letter in name)


def _kind(entry: os.DirEntry[str]) -> str | None:
    """What an entry is; None for what the studio does not open."""
    name = entry.name.lower()
    try:
        if entry.is_dir():
            is_case = name.endswith(".case") or (Path(entry.path) / MANIFEST_NAME).is_file()
            return "case" if is_case else "folder"
        if not entry.is_file():
            # whoever opens a pipe waits for one who writes into it
            return None
        if name.endswith(".toml"):
            return "recipe" if b"heartcase_recipe" in _first_bytes(entry.path) else None
        if name.endswith(_SCANS):
            return None if _holds_labels(entry.path, name) else "scan"
        if name.endswith(".zip"):
            return "zip"
        if name.endswith(_DICOM):
            return "dicom"
        if "." not in name or name.rpartition(".")[2].isdigit():
            return "dicom" if _first_bytes(entry.path)[_DICOM_START : _DICOM_START + 4] == b"DICM" else None
    except OSError:
        # it may be gone, or closed to this user
        return None
    return None


def _holds_labels(path: str, name: str) -> bool:
    """Whether a volume says that it holds labels, such as the truth beside a synthetic scan: it is no scan."""
    if name.endswith(_SEGMENTATIONS):
        return True
    if not name.endswith((".nii", ".nii.gz")):
        return False
    opened = gzip.open if name.endswith(".gz") else open
    try:
        with opened(path, "rb") as file:
            header = file.read(INTENT_AT + 2)
    except (OSError, EOFError, zlib.error):
        # opening it says what is wrong
        return False
    written = header[INTENT_AT:]
    return any(int.from_bytes(written, order) == LABEL_INTENT for order in ("little", "big"))


def _first_bytes(path: str) -> bytes:
    with open(path, "rb") as file:
        return file.read(_FIRST_BYTES)
