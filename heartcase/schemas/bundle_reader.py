"""Opening a case bundle: checked, memory-mapped, only the parts that are asked for.

Nothing in a bundle is executed, no path in it is followed out of its directory, and a header is bounded before it is
parsed. :func:`open_bundle` reads the manifest and the headers; :meth:`OpenBundle.arrays` checks the values of what it
returns; :mod:`heartcase.schemas.bundle_check` checks everything, hashes included.
"""

from __future__ import annotations

import json
import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
from pydantic import ValidationError

from heartcase.schemas.bundle import ARRAYS, FORMAT_NAME, FORMAT_VERSION, MANIFEST_NAME, CaseManifest, FileRole
from heartcase.schemas.errors import BundleError, Problem, problems_from_validation

__all__ = ["KNOWN_EXTENSIONS", "OpenBundle", "open_bundle", "read_manifest"]

KNOWN_EXTENSIONS: frozenset[str] = frozenset()
"""Extensions of the format that this version understands."""

MANIFEST_SIZE_MAX = 16 << 20
HEADER_SIZE_MAX = 1 << 20

_DTYPES = {"int32": "I32", "float32": "F32", "uint8": "U8"}

_INDEX_ARRAYS: dict[tuple[FileRole, str], str] = {
    (FileRole.SURFACE, "triangles"): "vertex_count",
    (FileRole.SURFACE, "render_to_welded"): "vertex_count",
    (FileRole.MAPPING, "triangle_nodes"): "node_count",
    (FileRole.MAPPING, "nearest_node"): "node_count",
    (FileRole.PICKING, "nodes"): "node_count",
    (FileRole.PICKING, "triangles"): "picking_vertex_count",
}
_LABEL_ARRAYS = {"cell_label", "triangle_label", "triangle_tissue", "vertex_label"}
_LARGEST = {"cell_coverage": 1.0, "cell_stiffness": 1e6, "cell_density": 2e4}
_FLAG_ARRAYS = {"fixed", "curvature", "triangle_is_cut"}


@dataclass(frozen=True)
class _Header:
    """Where each array of a safetensors file lies."""

    arrays: dict[str, tuple[str, tuple[int, ...], int]]
    """Name -> numpy dtype, shape, offset in the file in bytes."""


@dataclass(frozen=True)
class OpenBundle:
    """A case that was opened: its manifest, and its arrays when asked for."""

    directory: Path
    """The bundle's directory."""
    manifest: CaseManifest
    """What the case says of itself."""
    headers: dict[FileRole, _Header]
    """Layout of each safetensors file."""
    counts: dict[str, int]
    """Sizes by name: ``node_count``, ``vertex_count`` and so on, as far as the parts are there."""

    def path(self, role: FileRole) -> Path:
        """Path of the file with this role.

        Raises
        ------
        BundleError
            The case was made without it.
        """
        entry = self.manifest.file(role)
        if entry is None:
            raise BundleError(
                f"the case has no part '{role.value}': add it to 'parts' of the recipe and build again", place="case"
            )
        return self.directory / entry.name

    def has(self, role: FileRole) -> bool:
        """Whether the case was made with this part."""
        return self.manifest.file(role) is not None

    def arrays(self, role: FileRole, names: Sequence[str] | None = None) -> dict[str, npt.NDArray[Any]]:
        """Map the arrays of a part into memory, read-only, and check their values.

        Parameters
        ----------
        role
            A part stored as safetensors; see :data:`heartcase.schemas.bundle.ARRAYS` for its arrays.
        names
            Which arrays; all when left out.

        Raises
        ------
        BundleError
            The part is absent, or values are out of range or not finite; all problems at once.
        """
        path = self.path(role)
        header = self.headers[role]
        wanted = [spec.name for spec in ARRAYS[role]] if names is None else list(names)
        loaded = {name: _map_array(path, *header.arrays[name]) for name in wanted}
        problems = list(self._value_problems(role, loaded))
        if problems:
            raise BundleError(problems)
        return loaded

    def _value_problems(self, role: FileRole, loaded: dict[str, npt.NDArray[Any]]) -> Iterable[Problem]:
        known = np.zeros(256, dtype=bool)
        known[list(self.manifest.labels.values)] = True
        for name, array in loaded.items():
            place = f"{role.value}.{name}"
            if array.size == 0:
                continue
            limit_name = _INDEX_ARRAYS.get((role, name))
            if limit_name is not None and limit_name in self.counts:
                limit = self.counts[limit_name]
                low, high = int(array.min()), int(array.max())
                if low < 0 or high >= limit:
                    yield Problem(place, f"numbers from {low} to {high}, but only 0 to {limit - 1} exist")
            elif array.dtype.kind == "f":
                if not np.isfinite(array).all():
                    yield Problem(place, "holds values that are not finite numbers")
            elif name in _LABEL_ARRAYS:
                if not known[array].all():
                    yield Problem(place, "holds label values that the label table does not have")
            elif name in _FLAG_ARRAYS and int(array.max()) > 1:
                yield Problem(place, "must be 0 or 1")
            if name in _LARGEST:
                if not (array > 0).all():
                    yield Problem(place, "must be above zero everywhere")
                if (array > _LARGEST[name]).any():
                    yield Problem(place, f"must not be above {_LARGEST[name]:g}")


def open_bundle(path: Path | str) -> OpenBundle:
    """Open a case: manifest, file sizes and array layouts are checked; no array is read.

    Raises
    ------
    BundleError
        With every problem that was found.
    """
    directory = Path(path)
    manifest = read_manifest(directory)
    problems: list[Problem] = []
    headers: dict[FileRole, _Header] = {}
    counts: dict[str, int] = {}
    seen: set[FileRole] = set()
    for entry in manifest.files:
        place = f"files.{entry.role.value}"
        file = directory / entry.name
        if entry.role in seen:
            problems.append(Problem(place, "is listed twice"))
            continue
        seen.add(entry.role)
        if file.is_symlink() or not file.is_file():
            problems.append(Problem(place, f"the file {entry.name} is missing: build the case again"))
            continue
        if file.stat().st_size != entry.size:
            problems.append(Problem(place, f"has {file.stat().st_size} bytes instead of {entry.size}: it was changed"))
            continue
        if entry.role in ARRAYS:
            header, found = _read_header(file, entry.role)
            problems += found
            if not found:
                headers[entry.role] = header
                problems += _count_problems(entry.role, header, counts)
    if FileRole.GRID not in seen:
        problems.append(Problem("files", "the case has no grid"))
    for name in ("node_count", "cell_count"):
        stated = getattr(manifest.simulation, name)
        if counts.get(name, stated) != stated:
            problems.append(Problem(f"simulation.{name}", f"says {stated}, but the grid has {counts[name]}"))
    if problems:
        raise BundleError(problems)
    return OpenBundle(directory, manifest, headers, counts)


def read_manifest(directory: Path) -> CaseManifest:
    """Read and check ``case.json`` alone.

    Raises
    ------
    BundleError
        It is not there, not ours, of an unknown version, or wrong; all problems at once.
    """
    file = directory / MANIFEST_NAME
    if not directory.exists():
        raise BundleError("there is nothing at this path", place="case")
    if not file.is_file():
        raise BundleError(f"this is not a case: it holds no {MANIFEST_NAME}; for a scan, take info", place="case")
    if file.stat().st_size > MANIFEST_SIZE_MAX:
        raise BundleError(f"is larger than {MANIFEST_SIZE_MAX >> 20} MiB and was not read", place=MANIFEST_NAME)
    try:
        data = json.loads(file.read_bytes())
    except (ValueError, RecursionError):
        raise BundleError("is not valid JSON: the case is damaged, build it again", place=MANIFEST_NAME) from None
    if not isinstance(data, dict) or data.get("format") != FORMAT_NAME:
        raise BundleError(f"does not say that it is a {FORMAT_NAME}", place=MANIFEST_NAME)
    _refuse_unknown(data)
    try:
        return CaseManifest.model_validate_json(json.dumps(data))
    except ValidationError as error:
        raise BundleError(problems_from_validation(error, place=MANIFEST_NAME)) from None


def _refuse_unknown(data: dict[str, Any]) -> None:
    """Refuse versions and extensions that this reader does not know; drop unknown keys of a newer minor version."""
    version = str(data.get("format_version", ""))
    major, _, minor = version.partition(".")
    ours, _, our_minor = FORMAT_VERSION.partition(".")
    problems = []
    if major != ours:
        problems.append(Problem("format_version", f"{version!r} is not {ours}.x: use the version that wrote the case"))
    extensions = data.get("required_extensions", [])
    if isinstance(extensions, list):
        unknown = sorted(str(name) for name in extensions if name not in KNOWN_EXTENSIONS)
        problems += [Problem("required_extensions", f"{name!r} is not known to this version") for name in unknown]
    if problems:
        raise BundleError(problems)
    if minor.isdecimal() and int(minor) > int(our_minor):
        _drop_unknown_keys(data)


def _drop_unknown_keys(data: dict[str, Any]) -> None:
    try:
        CaseManifest.model_validate_json(json.dumps(data))
    except ValidationError as error:
        for detail in error.errors(include_url=False):
            if detail["type"] != "extra_forbidden":
                continue
            inner: Any = data
            for part in detail["loc"][:-1]:
                inner = inner[part]
            inner.pop(detail["loc"][-1], None)


def _read_header(file: Path, role: FileRole) -> tuple[_Header, list[Problem]]:
    """Read the layout of a safetensors file: length of the header (8 bytes, little-endian), JSON, then the data."""
    place = f"files.{role.value}"
    size = file.stat().st_size
    with file.open("rb") as stream:
        length = int.from_bytes(stream.read(8), "little")
        if size < 8 or length > min(HEADER_SIZE_MAX, size - 8):
            return _Header({}), [Problem(place, "its header is too long or cut off: the file is damaged")]
        try:
            data = json.loads(stream.read(length))
            entries = {name: entry for name, entry in data.items() if name != "__metadata__"}
            spans = {
                name: (entry["dtype"], tuple(int(n) for n in entry["shape"]), *map(int, entry["data_offsets"]))
                for name, entry in entries.items()
            }
        except (ValueError, KeyError, TypeError, AttributeError, RecursionError):
            return _Header({}), [Problem(place, "its header cannot be read: the file is damaged")]
    problems: list[Problem] = []
    arrays: dict[str, tuple[str, tuple[int, ...], int]] = {}
    start = 8 + length
    for spec in ARRAYS[role]:
        where = f"{role.value}.{spec.name}"
        if spec.name not in spans:
            problems.append(Problem(where, "is missing"))
            continue
        dtype, shape, begin, *rest = spans[spec.name]
        end = rest[0] if len(rest) == 1 else -1
        if dtype != _DTYPES[spec.dtype]:
            problems.append(Problem(where, f"must be {spec.dtype}, not {dtype}"))
        elif len(shape) != len(spec.shape) or any(
            n < 0 or (isinstance(want, int) and n != want) for n, want in zip(shape, spec.shape, strict=True)
        ):
            problems.append(Problem(where, f"has shape {list(shape)}, not {list(spec.shape)}"))
        elif not 0 <= begin <= end <= size - start or end - begin != math.prod(shape) * np.dtype(spec.dtype).itemsize:
            problems.append(Problem(where, "lies outside the file or has the wrong length"))
        else:
            arrays[spec.name] = (spec.dtype, shape, start + begin)
    return _Header(arrays), problems


def _count_problems(role: FileRole, header: _Header, counts: dict[str, int]) -> list[Problem]:
    problems = []
    for spec in ARRAYS[role]:
        _, shape, _ = header.arrays[spec.name]
        for name, n in zip(spec.shape, shape, strict=True):
            if isinstance(name, str) and counts.setdefault(name, n) != n:
                problems.append(Problem(f"{role.value}.{spec.name}", f"has {n} rows where {name} is {counts[name]}"))
    return problems


def _map_array(path: Path, dtype: str, shape: tuple[int, ...], offset: int) -> npt.NDArray[Any]:
    little = np.dtype(dtype).newbyteorder("<")
    if math.prod(shape) == 0:
        return np.empty(shape, little)
    return np.memmap(path, dtype=little, mode="r", offset=offset, shape=shape)
