"""Reading ``case.json``: bounded, strict, and, of a wrong one, all that is right in it."""

from __future__ import annotations

import json
import re
from collections.abc import Iterable
from pathlib import Path
from typing import Any

from pydantic import TypeAdapter, ValidationError

from heartcase.schemas.base import Model
from heartcase.schemas.bundle.coordinates import Coordinates, Frame
from heartcase.schemas.bundle.format import (
    FORMAT_NAME,
    FORMAT_VERSION,
    MANIFEST_NAME,
    CaseManifest,
    FileEntry,
    FileRole,
    Material,
    SimulationFigures,
)
from heartcase.schemas.errors import BundleError, Problem, problems_from_validation
from heartcase.schemas.files import is_there
from heartcase.schemas.geometry import Geometry
from heartcase.schemas.labels import Label, LabelTable
from heartcase.schemas.landmarks import Landmark
from heartcase.schemas.strict_json import parse_json

__all__ = [
    "FILE_NAME",
    "KNOWN_EXTENSIONS",
    "MANIFEST_SIZE_MAX",
    "listed_files",
    "manifest_bytes",
    "nothing_there",
    "raw_manifest",
    "read_manifest",
    "salvaged_manifest",
    "stated",
]

KNOWN_EXTENSIONS: frozenset[str] = frozenset()
"""Extensions of the format that this version understands."""

MANIFEST_SIZE_MAX = 16 << 20
"""A manifest that is larger, in bytes, is not read."""

FILE_NAME = re.compile(r"[a-z0-9][a-z0-9_.-]{0,127}")
"""A file's name inside a case; never a path."""

_CASE_NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9 _.()+-]{0,63}\.case")
"""The name of a case's folder as builds write it: the recipe's name, which no patient's may be."""

_GEOMETRIES = ("scan_geometry", "grid_geometry")
_LISTS: dict[str, type[Model]] = {
    "files": FileEntry,
    "frames": Frame,
    "labels": Label,
    "landmarks": Landmark,
    "materials": Material,
}
_TABLES: dict[str, type[Model]] = {
    "coordinates": Coordinates,
    "grid_geometry": Geometry,
    "labels": LabelTable,
    "scan_geometry": Geometry,
    "simulation": SimulationFigures,
}
_WRONG = object()
_ALWAYS_WRITTEN = ("origin_mm", "spacing_mm", "direction")


def read_manifest(directory: Path) -> CaseManifest:
    """Read and check ``case.json`` alone.

    Raises
    ------
    BundleError
        It is not there, not ours, of an unknown version, or wrong; all problems at once.
    """
    data, content = _manifest_data(directory)
    problems = list(_omissions(data))
    try:
        manifest = CaseManifest.model_validate_json(json.dumps(data) if _is_newer_minor(data) else content)
    except ValidationError as error:
        problems += problems_from_validation(error, place=MANIFEST_NAME)
        if _is_newer_minor(data):
            newer = f"the case is of version {data['format_version']}, newer than {FORMAT_VERSION} of this heartcase"
            problems.insert(0, Problem("format_version", f"{newer}: use the version that wrote it"))
        raise BundleError(problems) from None
    if problems:
        raise BundleError(problems)
    return manifest


def raw_manifest(directory: Path) -> dict[str, Any]:
    """The manifest as plain JSON, with all that a newer version added; empty where it cannot be read."""
    try:
        data = parse_json(manifest_bytes(directory))
    except (BundleError, ValueError):
        return {}
    return data if isinstance(data, dict) else {}


def listed_files(directory: Path) -> list[tuple[str, str, Any, str]]:
    """Name, role, size and hash of each file that a manifest lists, roles of newer versions too.

    Entries without a name that is one, a role or a hash are left out.
    """
    entries = raw_manifest(directory).get("files")
    found = []
    for one in entries if isinstance(entries, list) else []:
        said = [one.get(key) for key in ("name", "role", "sha256")] if isinstance(one, dict) else [None]
        if all(isinstance(text, str) for text in said) and FILE_NAME.fullmatch(one["name"]):
            found.append((one["name"], one["role"][:32], one.get("size"), one["sha256"]))
    return found


def salvaged_manifest(directory: Path) -> CaseManifest | None:
    """What is sound of a manifest that :func:`read_manifest` refuses; None where nothing can be said.

    What is wrong has no attribute: take :func:`stated` to look at it. Of lists only the wrong entries are missing, of
    the geometries, the coordinates, the label table and the figures only the wrong keys.
    """
    try:
        data, _ = _manifest_data(directory)
    except BundleError:
        return None
    for name in _GEOMETRIES:
        if isinstance(data.get(name), dict):
            data[name] = dict.fromkeys(_ALWAYS_WRITTEN) | data[name]
    manifest: CaseManifest = _salvaged(CaseManifest, data)
    manifest.__dict__.setdefault("files", ())
    return manifest


def stated(manifest: CaseManifest, path: str) -> Any:
    """What a manifest, perhaps a salvaged one, says under a dotted path; None where it says nothing sound."""
    found: Any = manifest
    for name in path.split("."):
        found = getattr(found, name, None)
    if isinstance(found, Geometry) and set(found.__dict__) != set(Geometry.model_fields):
        return None
    return found


def _salvaged(model: type[Any], data: dict[str, Any]) -> Any:
    sound: dict[str, Any] = {}
    wrong = _wrong_keys(model, data)
    for name, field in model.model_fields.items():
        if name not in data:
            if not field.is_required():
                sound[name] = field.default
            continue
        given = data[name]
        value = _WRONG if name in wrong else _valid(TypeAdapter(field.rebuild_annotation()), given)
        if value is _WRONG and name in _TABLES and isinstance(given, dict):
            value = _salvaged(_TABLES[name], given)
        elif value is _WRONG and name in _LISTS and isinstance(given, list):
            value = tuple(one for entry in given if (one := _salvaged_item(_LISTS[name], entry)) is not _WRONG)
        if value is not _WRONG:
            sound[name] = value
    # The defaults that model_construct fills in would speak for what is wrong.
    found = model.model_construct()
    found.__dict__.clear()
    found.__dict__.update(sound)
    return found


def _wrong_keys(model: type[Any], data: dict[str, Any]) -> set[Any]:
    """Keys that the model itself refuses: the type of a field does not know what its validators do."""
    try:
        model.model_validate_json(json.dumps(data))
    except ValidationError as error:
        return {detail["loc"][0] for detail in error.errors(include_url=False) if detail["loc"]}
    return set()


def _salvaged_item(model: type[Any], entry: Any) -> Any:
    value = _valid(TypeAdapter(model), entry)
    # Half an entry of a file is of no use, and places in the other lists are told by their numbers.
    is_partial = value is _WRONG and model is not FileEntry and isinstance(entry, dict)
    return _salvaged(model, entry) if is_partial else value


def _valid(adapter: TypeAdapter[Any], value: Any) -> Any:
    try:
        return adapter.validate_json(json.dumps(value))
    except (ValidationError, ValueError):
        return _WRONG


def nothing_there(path: Path) -> str:
    """Words for a path with nothing at it: of a case its name, and where builds put cases; never a folder."""
    if _CASE_NAME.fullmatch(path.name) is None:
        return "there is nothing at this path: check its spelling"
    return (
        f"there is nothing at this path: no {path.name} is in that folder; check its spelling, and where it was built: "
        "'heartcase build' writes into the folder of --out, and into the current one without it"
    )


def manifest_bytes(directory: Path) -> bytes:
    """The bytes of ``case.json``.

    Raises
    ------
    BundleError
        It is not there, no plain file, or too large.
    """
    file = directory / MANIFEST_NAME
    if not is_there(directory):
        raise BundleError(nothing_there(directory), place="case")
    if file.is_symlink():
        raise BundleError("is a link and not a file: the case is damaged, build it again", place=MANIFEST_NAME)
    if not file.is_file():
        raise BundleError(f"this is not a case: it holds no {MANIFEST_NAME}; for a scan, take info", place="case")
    if file.stat().st_size > MANIFEST_SIZE_MAX:
        raise BundleError(f"is larger than {MANIFEST_SIZE_MAX >> 20} MiB and was not read", place=MANIFEST_NAME)
    try:
        return file.read_bytes()
    except OSError:
        raise BundleError("cannot be read: build the case again", place=MANIFEST_NAME) from None


def _manifest_data(directory: Path) -> tuple[dict[str, Any], bytes]:
    """The manifest as plain JSON, without what a newer minor version adds, and its bytes."""
    content = manifest_bytes(directory)
    try:
        data = parse_json(content)
    except ValueError:
        raise BundleError("is not valid JSON: the case is damaged, build it again", place=MANIFEST_NAME) from None
    if not isinstance(data, dict) or data.get("format") != FORMAT_NAME:
        raise BundleError(
            f"does not say that it is a {FORMAT_NAME}: name the folder NAME.case that a build wrote",
            place=MANIFEST_NAME,
        )
    _refuse_unknown(data)
    return data, content


def _omissions(data: dict[str, Any]) -> Iterable[Problem]:
    """Keys that have a default and must be written all the same: without them a case would be turned or moved."""
    for name in _GEOMETRIES:
        if isinstance(data.get(name), dict):
            for key in _ALWAYS_WRITTEN:
                if key not in data[name]:
                    yield Problem(f"{MANIFEST_NAME}.{name}.{key}", "is missing: add it")
    if data.get("format_version") != "1.0" and "coordinates" not in data:
        yield Problem(f"{MANIFEST_NAME}.coordinates", "is missing: add it")


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
        _drop_unknown(data)


def _is_newer_minor(data: dict[str, Any]) -> bool:
    minor, ours = (str(version).partition(".")[2] for version in (data.get("format_version"), FORMAT_VERSION))
    # Python refuses to convert thousands of digits.
    return minor.isdecimal() and (len(minor) > 9 or int(minor) > int(ours))


def _drop_unknown(data: dict[str, Any]) -> None:
    """Drop what a newer minor version may add: keys anywhere, files with a role and frames with a name of their own."""
    if isinstance(data.get("files"), list):
        data["files"] = [entry for entry in data["files"] if not _has_unknown_role(entry)]
    coordinates = data.get("coordinates")
    if isinstance(coordinates, dict) and isinstance(coordinates.get("frames"), list):
        known = {frame.name for frame in Coordinates().frames}
        coordinates["frames"] = [
            frame
            for frame in coordinates["frames"]
            if not isinstance(frame, dict) or not isinstance(frame.get("name"), str) or frame["name"] in known
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


def _has_unknown_role(entry: Any) -> bool:
    """Whether an entry is sound but for its role; a wrong one stays, to be refused."""
    if not isinstance(entry, dict) or not isinstance(entry.get("role"), str) or entry["role"] in set(FileRole):
        return False
    facts = {key: entry[key] for key in ("name", "size", "sha256") if key in entry}
    return _valid(TypeAdapter(FileEntry), facts | {"role": FileRole.GRID.value}) is not _WRONG
