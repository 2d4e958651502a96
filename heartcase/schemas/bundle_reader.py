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
from operator import index
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
from pydantic import TypeAdapter, ValidationError

from heartcase.schemas.bundle import (
    ARRAYS,
    FORMAT_NAME,
    FORMAT_VERSION,
    MANIFEST_NAME,
    CaseManifest,
    FileEntry,
    FileRole,
)
from heartcase.schemas.coordinates import Coordinates
from heartcase.schemas.errors import BundleError, Problem, problems_from_validation

__all__ = [
    "KNOWN_EXTENSIONS",
    "OpenBundle",
    "inspect_files",
    "open_bundle",
    "read_manifest",
    "salvaged_manifest",
    "stated_problems",
]

KNOWN_EXTENSIONS: frozenset[str] = frozenset()
"""Extensions of the format that this version understands."""

MANIFEST_SIZE_MAX = 16 << 20
HEADER_SIZE_MAX = 1 << 20

_DTYPES = {"int32": "I32", "int16": "I16", "float32": "F32", "uint8": "U8"}

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
    is_consistent: bool = True
    """Whether all arrays agree on these sizes; only :func:`inspect_files` returns cases where they do not."""

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
        wanted = [spec.name for spec in ARRAYS[role]] if names is None else list(names)
        loaded = {name: self.inspect_array(role, name) for name in wanted}
        problems = [problem for _, found in loaded.values() for problem in found]
        if problems:
            raise BundleError(problems)
        return {name: array for name, (array, _) in loaded.items()}

    def inspect_array(self, role: FileRole, name: str) -> tuple[npt.NDArray[Any], list[Problem]]:
        """Map one array into memory, read-only, and say what is wrong with its values."""
        array = _map_array(self.path(role), *self.headers[role].arrays[name])
        return array, list(self._value_problems(role, {name: array}))

    def _value_problems(self, role: FileRole, loaded: dict[str, npt.NDArray[Any]]) -> Iterable[Problem]:
        known = np.zeros(256, dtype=bool)
        table = getattr(self.manifest, "labels", None)
        known[slice(None) if table is None else list(table.values)] = True
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
    bundle, problems = inspect_files(directory, read_manifest(directory))
    problems += stated_problems(bundle)
    if problems:
        raise BundleError(problems)
    return bundle


def inspect_files(directory: Path, manifest: CaseManifest) -> tuple[OpenBundle, list[Problem]]:
    """Look at the files that a manifest lists: sizes and array layouts.

    Returns
    -------
    OpenBundle, list of Problem
        The case with the parts whose layout is sound, and what is wrong with the others or between them.
    """
    problems: list[Problem] = []
    headers: dict[FileRole, _Header] = {}
    counts: dict[str, int] = {}
    seen: set[FileRole] = set()
    is_consistent = True
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
                misfits = _count_problems(entry.role, header, counts)
                is_consistent &= not misfits
                problems += misfits
                problems += _listing_problems(entry, header, manifest.format_version)
    if FileRole.GRID not in seen:
        problems.append(Problem("files", "the case has no grid"))
    return OpenBundle(directory, manifest, headers, counts, is_consistent), problems


def stated_problems(bundle: OpenBundle) -> Iterable[Problem]:
    """What the manifest states must fit the files and the format."""
    for name in ("node_count", "cell_count"):
        stated = getattr(bundle.manifest.simulation, name)
        if bundle.counts.get(name, stated) != stated:
            yield Problem(f"simulation.{name}", f"says {stated}, but the grid has {bundle.counts[name]}")
    yield from _coordinate_problems(bundle.manifest)
    if FileRole.SCAN in bundle.headers:
        yield from _scan_problems(bundle.manifest, bundle.headers[FileRole.SCAN])


def read_manifest(directory: Path) -> CaseManifest:
    """Read and check ``case.json`` alone.

    Raises
    ------
    BundleError
        It is not there, not ours, of an unknown version, or wrong; all problems at once.
    """
    data, content = _manifest_data(directory)
    try:
        return CaseManifest.model_validate_json(json.dumps(data) if _is_newer_minor(data) else content)
    except ValidationError as error:
        problems = problems_from_validation(error, place=MANIFEST_NAME)
        if _is_newer_minor(data):
            newer = f"the case is of version {data['format_version']}, newer than {FORMAT_VERSION} of this heartcase"
            problems = (Problem("format_version", f"{newer}: use the version that wrote it"), *problems)
        raise BundleError(problems) from None


def salvaged_manifest(directory: Path) -> CaseManifest | None:
    """What is sound of a manifest that :func:`read_manifest` refuses; None where nothing can be said.

    Keys that are wrong are left out of the model altogether, of ``files`` the entries that are wrong.
    """
    try:
        data, _ = _manifest_data(directory)
    except BundleError:
        return None
    sound: dict[str, Any] = {}
    for name, field in CaseManifest.model_fields.items():
        adapter: TypeAdapter[Any] = TypeAdapter(field.rebuild_annotation())
        given = data.get(name)
        if name == "files":
            adapter = TypeAdapter(FileEntry)
            entries = [_valid(adapter, entry) for entry in given] if isinstance(given, list) else []
            sound[name] = tuple(entry for entry in entries if entry is not None)
        elif (value := _valid(adapter, given)) is not None:
            sound[name] = value
    return CaseManifest.model_construct(_fields_set=None, **sound)


def _valid(adapter: TypeAdapter[Any], value: Any) -> Any:
    try:
        return adapter.validate_json(json.dumps(value))
    except (ValidationError, ValueError):
        return None


def _manifest_data(directory: Path) -> tuple[dict[str, Any], bytes]:
    """The manifest as plain JSON, without what a newer minor version adds, and its bytes."""
    file = directory / MANIFEST_NAME
    if not directory.exists():
        raise BundleError("there is nothing at this path", place="case")
    if not file.is_file():
        raise BundleError(f"this is not a case: it holds no {MANIFEST_NAME}; for a scan, take info", place="case")
    if file.stat().st_size > MANIFEST_SIZE_MAX:
        raise BundleError(f"is larger than {MANIFEST_SIZE_MAX >> 20} MiB and was not read", place=MANIFEST_NAME)
    try:
        content = file.read_bytes()
        data = json.loads(content, object_pairs_hook=_without_repeats)
    except (ValueError, RecursionError):
        raise BundleError("is not valid JSON: the case is damaged, build it again", place=MANIFEST_NAME) from None
    if not isinstance(data, dict) or data.get("format") != FORMAT_NAME:
        raise BundleError(f"does not say that it is a {FORMAT_NAME}", place=MANIFEST_NAME)
    _refuse_unknown(data)
    return data, content


def _without_repeats(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    """A JSON object whose keys differ: readers would disagree on which of two equal keys counts."""
    found = dict(pairs)
    if len(found) != len(pairs):
        raise ValueError("a key stands twice")
    return found


def _refuse_unknown(data: dict[str, Any]) -> None:
    """Refuse versions and extensions that this reader does not know; drop unknown keys of a newer minor version."""
    version = str(data.get("format_version", ""))
    major, ours = version.partition(".")[0], FORMAT_VERSION.partition(".")[0]
    problems = []
    if major != ours:
        problems.append(Problem("format_version", f"{version!r} is not {ours}.x: use the version that wrote the case"))
    extensions = data.get("required_extensions", [])
    if isinstance(extensions, list):
        unknown = sorted(str(name) for name in extensions if str(name) not in KNOWN_EXTENSIONS)
        problems += [Problem("required_extensions", f"{name!r} is not known to this version") for name in unknown]
    if problems:
        raise BundleError(problems)
    if _is_newer_minor(data):
        _drop_unknown_keys(data)


def _is_newer_minor(data: dict[str, Any]) -> bool:
    minor, ours = (str(version).partition(".")[2] for version in (data.get("format_version"), FORMAT_VERSION))
    # Python refuses to convert thousands of digits.
    return minor.isdecimal() and (len(minor) > 9 or int(minor) > int(ours))


def _drop_unknown_keys(data: dict[str, Any]) -> None:
    """Drop what a newer minor version may add: keys anywhere, and files with a role of their own."""
    if isinstance(data.get("files"), list):
        known = set(FileRole)
        data["files"] = [
            entry
            for entry in data["files"]
            if not isinstance(entry, dict) or not isinstance(entry.get("role"), str) or entry["role"] in known
        ]
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
            data = json.loads(stream.read(length), object_pairs_hook=_without_repeats)
            entries = {name: entry for name, entry in data.items() if name != "__metadata__"}
            spans = {
                name: (entry["dtype"], tuple(map(index, entry["shape"])), *map(index, entry["data_offsets"]))
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
        dtype, shape, *offsets = spans[spec.name]
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


def _listing_problems(entry: FileEntry, header: _Header, version: str) -> Iterable[Problem]:
    """What the manifest says of a file's arrays must be what the file's own header says."""
    listed = {array.name: array for array in entry.arrays}
    must_list = version != "1.0"
    if version == FORMAT_VERSION:
        for name in sorted(set(listed) - set(header.arrays)):
            yield Problem(f"{entry.role.value}.{name}", "is listed in case.json, but the format has no such array")
    if len(listed) != len(entry.arrays):
        yield Problem(f"files.{entry.role.value}", "lists an array twice in case.json")
    for name, (dtype, shape, offset) in header.arrays.items():
        where = f"{entry.role.value}.{name}"
        if name not in listed:
            if must_list:
                yield Problem(where, "is not in the list of arrays of case.json")
            continue
        said = (listed[name].dtype, listed[name].shape, listed[name].offset)
        for what, stated, found in zip(("type", "shape", "offset"), said, (dtype, shape, offset), strict=True):
            if stated != found:
                yield Problem(where, f"has {what} {found} in its file, but {stated} in case.json")


def _coordinate_problems(manifest: CaseManifest) -> Iterable[Problem]:
    """The axes are part of the format: a case that states others would be shown turned or mirrored."""
    ours = {frame.name: frame for frame in Coordinates().frames}
    if manifest.coordinates.axes != Coordinates().axes:
        yield Problem("coordinates.axes", "are not left, back, head: world space is patient LPS")
    for number, frame in enumerate(manifest.coordinates.frames, start=1):
        if frame.name in ours and frame != ours[frame.name]:
            yield Problem(f"coordinates.frames[{number}]", f"are not the axes that the format fixes for {frame.name}")
    if manifest.gltf_from_lps != ours["gltf"].from_lps_mm:
        yield Problem("gltf_from_lps", "is not the matrix that the format fixes: the case would be turned or mirrored")


def _scan_problems(manifest: CaseManifest, header: _Header) -> Iterable[Problem]:
    shape = header.arrays["intensity"][1]
    if shape != manifest.scan_geometry.shape:
        yield Problem("scan.intensity", f"has shape {list(shape)}, not {list(manifest.scan_geometry.shape)}")
    if manifest.scan_values is None:
        yield Problem("scan_values", "are missing: the numbers of the scan part stand for nothing without them")


def _map_array(path: Path, dtype: str, shape: tuple[int, ...], offset: int) -> npt.NDArray[Any]:
    little = np.dtype(dtype).newbyteorder("<")
    if math.prod(shape) == 0:
        return np.empty(shape, little)
    return np.memmap(path, dtype=little, mode="r", offset=offset, shape=shape)
