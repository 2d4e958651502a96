"""Where the arrays of a case's safetensors files lie, by the file's own header and by the manifest.

A header is bounded before it is parsed, and no place in it is used before it is known to lie in the file.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass, field
from operator import index
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from heartcase.schemas.bundle.format import ARRAYS, FORMAT_VERSION, VERSION_WITHOUT_SEPTA, FileEntry, FileRole
from heartcase.schemas.errors import Problem
from heartcase.schemas.strict_json import parse_json

__all__ = ["HEADER_SIZE_MAX", "Layout", "count_problems", "listing_problems", "map_array", "read_layout"]

HEADER_SIZE_MAX = 1 << 20
"""A header that is larger, in bytes, is not parsed."""

_DTYPES = {"int32": "I32", "int16": "I16", "float32": "F32", "uint8": "U8"}


@dataclass(frozen=True)
class Layout:
    """Where each array of a safetensors file lies."""

    arrays: dict[str, tuple[str, tuple[int, ...], int]] = field(default_factory=dict)
    """Sound arrays: name -> numpy dtype, shape, offset in the file in bytes."""
    others: dict[str, tuple[int, int]] = field(default_factory=dict)
    """Whatever else the header names, padding too: name -> first byte and end in the file, not checked."""
    metadata: Any = None
    """What the header holds under ``__metadata__``."""


def read_layout(file: Path, role: FileRole, version: str | None) -> tuple[Layout, list[Problem]]:
    """Read the layout of a safetensors file: length of the header (8 bytes, little-endian), JSON, then the data.

    ``version`` is the format's, None where it is not known: an array that came later is not missed.

    Returns
    -------
    Layout, list of Problem
        The arrays that are as the format has them, and what is wrong with the others.
    """
    place = f"files.{role.value}"
    size = file.stat().st_size
    with file.open("rb") as stream:
        length = int.from_bytes(stream.read(8), "little")
        if size < 8 or length > min(HEADER_SIZE_MAX, size - 8):
            return Layout(), [Problem(place, "its header is too long or cut off: the file is damaged")]
        try:
            data = parse_json(stream.read(length))
            spans = {
                name: (entry["dtype"], tuple(map(index, entry["shape"])), *map(index, entry["data_offsets"]))
                for name, entry in data.items()
                if name != "__metadata__"
            }
        except (ValueError, KeyError, TypeError, AttributeError):
            return Layout(), [Problem(place, "its header cannot be read: the file is damaged")]
    problems: list[Problem] = []
    layout = Layout(metadata=data.get("__metadata__"))
    start = 8 + length
    for spec in ARRAYS[role]:
        where = f"{role.value}.{spec.name}"
        if spec.name not in spans:
            if spec.is_in(version):
                problems.append(Problem(where, "is missing"))
            continue
        dtype, shape, *offsets = spans.pop(spec.name)
        begin, end = offsets if len(offsets) == 2 else (0, -1)
        if dtype != _DTYPES[spec.dtype]:
            problems.append(Problem(where, f"must be {spec.dtype}, not {dtype}"))
        elif len(shape) != len(spec.shape) or any(
            n < 0 or (isinstance(want, int) and n != want) for n, want in zip(shape, spec.shape, strict=True)
        ):
            problems.append(Problem(where, f"has shape {list(shape)}, not {list(spec.shape)}"))
        elif not 0 <= begin <= end <= size - start or end - begin != math.prod(shape) * np.dtype(spec.dtype).itemsize:
            problems.append(Problem(where, "lies outside the file or has the wrong length"))
        else:
            layout.arrays[spec.name] = (spec.dtype, shape, start + begin)
    for name, (_, _, *offsets) in spans.items():
        layout.others[name] = (start + offsets[0], start + offsets[1]) if len(offsets) == 2 else (0, -1)
    return layout, problems


def count_problems(role: FileRole, layout: Layout, counts: dict[str, int]) -> list[Problem]:
    """Arrays whose sizes differ from those of ``counts``, by name; sizes that are not in it yet are added."""
    problems = []
    for spec in ARRAYS[role]:
        _, shape, _ = layout.arrays.get(spec.name, ("", (), 0))
        for name, n in zip(spec.shape, shape, strict=False):
            if isinstance(name, str) and counts.setdefault(name, n) != n:
                problems.append(Problem(f"{role.value}.{spec.name}", f"has {n} rows where {name} is {counts[name]}"))
    return problems


def listing_problems(entry: FileEntry, layout: Layout, version: str | None) -> Iterable[Problem]:
    """What the manifest says of a file's arrays must be what the file's own header says.

    ``version`` is the format's, None where it is not known.
    """
    listed = {array.name: array for array in entry.arrays}
    known = {spec.name for spec in ARRAYS[entry.role]}
    must_list = version not in (None, "1.0")
    if version in (VERSION_WITHOUT_SEPTA, FORMAT_VERSION):
        for name in sorted(set(listed) - known):
            yield Problem(f"{entry.role.value}.{name}", "is listed in case.json, but the format has no such array")
    if len(listed) != len(entry.arrays):
        yield Problem(f"files.{entry.role.value}", "lists an array twice in case.json")
    for name, (dtype, shape, offset) in layout.arrays.items():
        where = f"{entry.role.value}.{name}"
        if name not in listed:
            if must_list:
                yield Problem(where, "is not in the list of arrays of case.json")
            continue
        said = (listed[name].dtype, listed[name].shape, listed[name].offset)
        for what, stated, found in zip(("type", "shape", "offset"), said, (dtype, shape, offset), strict=True):
            if stated != found:
                yield Problem(where, f"has {what} {found} in its file, but {stated} in case.json")


def map_array(path: Path, dtype: str, shape: tuple[int, ...], offset: int) -> npt.NDArray[Any]:
    """Map an array of a file into memory, read-only and little-endian."""
    little = np.dtype(dtype).newbyteorder("<")
    if math.prod(shape) == 0:
        return np.empty(shape, little)
    return np.memmap(path, dtype=little, mode="r", offset=offset, shape=shape)
