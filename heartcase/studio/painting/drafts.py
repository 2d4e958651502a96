"""A draft that is dropped on a page: streamed into the recipe's folder, checked, and written as ``[[markers]]``.

What is sent is the length of a header (uint32, little-endian), the header (JSON) and the files, one behind the other.
No name of a file is taken over: what was dropped may be named like a patient. Of parts (.stl), whose names say what
they are, the label's name is taken.
"""

from __future__ import annotations

import contextlib
import math
import os
import shutil
import tempfile
from collections.abc import AsyncIterator
from pathlib import Path, PurePath
from typing import Annotated, Any, BinaryIO

from pydantic import Field, ValidationError

from heartcase.pipeline.formats.volumes.raw_volume import at_most
from heartcase.pipeline.markers.load_markers import load_markers
from heartcase.schemas.base import Model
from heartcase.schemas.errors import UsageError, problems_from_validation
from heartcase.schemas.geometry import Geometry
from heartcase.schemas.labels import LabelTable
from heartcase.schemas.recipe.recipe import MarkerFile
from heartcase.schemas.recipe.settings import Convention
from heartcase.schemas.strict_json import parse_json

__all__ = ["DRAFT_SIZE_MAX", "Draft", "receive_draft"]

DRAFT_SIZE_MAX = 1 << 30
"""Bytes that all files of a draft may have together."""
_HEADER_MAX = 1 << 18
_SUFFIXES = (".seg.nrrd", ".nii.gz", ".mrk.json", ".nrrd", ".nii", ".mha", ".dcm")
"""Of files that are taken alone, the longer ones first."""
_PART = ".stl"
_DICOM_MAGIC = slice(128, 132)


_VALUES_PER_VOXEL = 8
_VALUES_LEAST = 1 << 26
_TOO_MANY = (
    f"the file claims more values than {_VALUES_PER_VOXEL} times the scan's voxels (and than 67 million): crop it to "
    "the scan, or resample it onto it"
)


def value_count_max(geometry: Geometry) -> int:
    """Values that a draft may have, unpacked: those of a grid twice as fine, or of several layers; more on small scans.

    Parameters
    ----------
    geometry
        The scan's lattice.
    """
    return max(_VALUES_PER_VOXEL * math.prod(geometry.size), _VALUES_LEAST)


class _File(Model):
    """A file that follows."""

    name: Annotated[str, Field(min_length=1, max_length=1024)]
    """What it is called where it comes from."""
    size: Annotated[int, Field(ge=1, le=DRAFT_SIZE_MAX)]
    """Its bytes."""


class _Header(Model):
    """What is dropped, and how it is to be taken."""

    files: Annotated[tuple[_File, ...], Field(min_length=1, max_length=250)]
    """The files, in the order in which they follow."""
    core_mm: Annotated[float, Field(gt=0.0, le=50.0)] | None = None
    """How deep inside its labels a draft counts, mm; all of it does when left out."""
    background: bool = False
    """Whether background is what has no label."""
    convention: Convention | None = None
    """What values stand for where the file does not say."""
    ignores_others: bool = False
    """Whether what is no label is left out; else the draft is refused."""


class Draft:
    """What was dropped, in a folder of its own beside the recipe, until it is added or refused.

    Parameters
    ----------
    folder
        The new folder.
    header
        What it holds, and how it is to be taken.
    """

    def __init__(self, folder: Path, header: _Header) -> None:
        self._folder = folder
        self._header = header

    def discard(self) -> None:
        """Take away what was not added."""
        shutil.rmtree(self._folder, ignore_errors=True)

    def marker_file(self, path: str) -> dict[str, Any]:
        """What the recipe says of it."""
        header = self._header
        points = path.endswith(".mrk.json")
        said: dict[str, Any] = {"path": path}
        if header.core_mm is not None and not points:
            said["core_mm"] = header.core_mm
            said |= {"background": True} if header.background else {}
        said |= {"convention": header.convention} if header.convention is not None and not points else {}
        return said | ({"others": "ignore"} if header.ignores_others else {})

    def checked(self, table: LabelTable, geometry: Geometry, whole: Geometry | None) -> Path:
        """The file, or the folder of parts, under a name that the readers know it by.

        Parameters
        ----------
        table, geometry, whole
            Labels and lattices that it must go with, as of
            :func:`heartcase.pipeline.markers.load_markers.load_markers`.

        Raises
        ------
        HeartcaseError
            It cannot be taken; every problem.
        """
        ready = self._as_parts(table) if self._is_of_parts else self._as_file()
        file = MarkerFile.model_validate(self.marker_file(ready.name))
        with at_most(value_count_max(whole or geometry), _TOO_MANY):
            load_markers([file], (), table, geometry, self._folder, whole=whole)
        return ready

    def added_to(self, directory: Path, ready: Path) -> str:
        """Its name in the recipe's folder, where nothing had that name before."""
        suffix = "" if ready.is_dir() else ready.name.removeprefix("draft")
        for number in range(1, 10_000):
            target = directory / f"draft_{number}{suffix}"
            # a link's name is never taken over, nor what it leads to
            if os.path.lexists(target):
                continue
            ready.rename(target)
            return target.name
        raise UsageError("there are too many drafts in the recipe's folder", place="draft")

    @property
    def _is_of_parts(self) -> bool:
        return all(file.name.lower().endswith(_PART) for file in self._header.files)

    def _as_file(self) -> Path:
        if len(self._header.files) > 1:
            raise UsageError("drop one file, or the parts of one heart as .stl files", place="draft")
        name, source = PurePath(self._header.files[0].name).name.lower(), self._folder / "0"
        suffix = next((one for one in _SUFFIXES if name.endswith(one)), None)
        if suffix is None:
            with source.open("rb") as file:
                suffix = ".dcm" if file.read(_DICOM_MAGIC.stop)[_DICOM_MAGIC] == b"DICM" else None
        if suffix is None:
            raise UsageError(
                "this kind of file is not taken: give a label volume (.nii, .nii.gz, .nrrd, .mha), a DICOM SEG, parts "
                "as .stl, or points (.mrk.json)",
                place="draft",
            )
        return source.rename(self._folder / f"draft{suffix}")

    def _as_parts(self, table: LabelTable) -> Path:
        parts = self._folder / "parts"
        parts.mkdir()
        unknown, taken = [], set()
        for number, file in enumerate(self._header.files):
            label = table.find(PurePath(file.name.replace("\\", "/")).name[: -len(_PART)])
            if label is None:
                unknown.append(number + 1)
            elif label.value in taken:
                raise UsageError(f"two of the parts are named like {label.name}", place="draft")
            else:
                taken.add(label.value)
                (self._folder / str(number)).rename(parts / f"{label.name}{_PART}")
        if unknown and not (taken and self._header.ignores_others):
            listed = ", ".join(str(number) for number in unknown)
            raise UsageError(f"part {listed} is named like no label: name the files like structures", place="draft")
        return parts


async def receive_draft(stream: AsyncIterator[bytes], directory: Path) -> Draft:
    """Write what is sent into a new folder; what is wrong leaves nothing behind.

    Parameters
    ----------
    stream
        What is sent.
    directory
        The recipe's folder.

    Raises
    ------
    UsageError
        It is not what its header says, or too large.
    """
    try:
        folder = Path(tempfile.mkdtemp(prefix=".heartcase-draft-", dir=directory))
    except OSError as error:
        raise UsageError(f"the recipe's folder cannot be written: {error.strerror}", place="draft") from None
    try:
        return Draft(folder, await _receive(stream, folder))
    except BaseException:
        shutil.rmtree(folder, ignore_errors=True)
        raise


async def _receive(stream: AsyncIterator[bytes], folder: Path) -> _Header:
    waiting, header = bytearray(), None
    number, left, total = 0, 0, 0
    with contextlib.ExitStack() as closing:
        file: BinaryIO | None = None
        async for chunk in stream:
            total += len(chunk)
            if total > DRAFT_SIZE_MAX + _HEADER_MAX:
                raise UsageError(f"a draft may have {DRAFT_SIZE_MAX >> 20} MiB at most", place="draft")
            waiting += chunk
            if header is None:
                header = _taken_header(waiting)
                if header is None:
                    continue
            while waiting:
                if left == 0:
                    if number == len(header.files):
                        raise UsageError("more was sent than was announced", place="draft")
                    left = header.files[number].size
                    file = closing.enter_context((folder / str(number)).open("xb"))
                    number += 1
                some = waiting[:left]
                _write(file, some)
                del waiting[: len(some)]
                left -= len(some)
    if header is None or number < len(header.files) or left:
        raise UsageError("less was sent than was announced: drop it again", place="draft")
    return header


def _write(file: BinaryIO | None, data: bytearray) -> None:
    try:
        if file is not None:
            file.write(data)
    except OSError as error:
        raise UsageError(f"the draft cannot be written: {error.strerror}", place="draft") from None


def _taken_header(waiting: bytearray) -> _Header | None:
    """Take the header from the front of what has come; None while it is not all there."""
    if len(waiting) < 4:
        return None
    length = int.from_bytes(waiting[:4], "little")
    if length > _HEADER_MAX:
        raise UsageError("the header is too long", place="draft")
    if len(waiting) < 4 + length:
        return None
    try:
        header = _Header.model_validate(parse_json(bytes(waiting[4 : 4 + length])))
    except ValidationError as error:
        raise UsageError(problems_from_validation(error, place="draft")) from None
    except (ValueError, RecursionError):
        raise UsageError("the header is not valid JSON", place="draft") from None
    if sum(file.size for file in header.files) > DRAFT_SIZE_MAX:
        raise UsageError(f"a draft may have {DRAFT_SIZE_MAX >> 20} MiB at most", place="draft")
    del waiting[: 4 + length]
    return header
