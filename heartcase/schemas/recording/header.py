"""The header of a recording, ``recording.json``: of which case it is, and how its simulation was set."""

from __future__ import annotations

import json
import re
from hashlib import sha256
from pathlib import Path
from typing import Annotated, Any, Final, Literal

from pydantic import Field, ValidationError

from heartcase.schemas.base import CaseId, Model, Name, OneOf, Vector3
from heartcase.schemas.errors import RecordingError, problems_from_validation
from heartcase.schemas.files import is_there
from heartcase.schemas.recording.commands import COMMANDS_VERSION
from heartcase.schemas.strict_json import parse_json

__all__ = [
    "FORMAT_NAME",
    "FORMAT_VERSION",
    "HEADER_NAME",
    "LOG_NAME",
    "RecordingEnd",
    "RecordingHeader",
    "RecordingParent",
    "header_bytes",
    "header_hash",
    "read_header",
]

FORMAT_NAME: Final = "heartcase-recording"
FORMAT_VERSION = "1.1"
HEADER_NAME = "recording.json"
LOG_NAME = "log.jsonl"
HEADER_SIZE_MAX = 1 << 20
"""A header that is larger, in bytes, is not read."""

Hash = Annotated[str, Field(pattern=r"^[0-9a-f]{64}$")]
_Positive = Annotated[float, Field(gt=0.0)]
_NotNegative = Annotated[float, Field(ge=0.0)]


_LawSetting = Annotated[str | bool | float, OneOf("text, true, false, or a finite number")]


class RecordingParent(Model):
    """Where a recording that took over from another one began to differ."""

    log_hash: Hash
    """Hash of the other's log: its last link."""
    step: Annotated[int, Field(ge=0)]
    """Step at which it took over."""


class RecordingEnd(Model):
    """What is known only when a recording was finished."""

    line_count: Annotated[int, Field(ge=0)]
    """Lines of the log."""
    log_hash: Hash
    """Link of the last line."""
    step: Annotated[int, Field(ge=0)]
    """Step at which the session was when it was finished."""


class RecordingHeader(Model):
    """``recording.json``."""

    format: Literal["heartcase-recording"] = FORMAT_NAME
    """Always ``heartcase-recording``."""
    format_version: Annotated[str, Field(pattern=r"^[0-9]{1,6}\.[0-9]{1,6}$")] = FORMAT_VERSION
    """Readers refuse a newer one."""
    commands_version: Annotated[int, Field(ge=1)] = COMMANDS_VERSION
    """Version of the commands; readers refuse a newer one."""
    software_version: Annotated[str, Field(min_length=1, max_length=64)]
    """Version of heartcase that recorded."""
    case_name: Name | None = None
    """Name of the case."""
    case_id: CaseId | None = None
    """Made-up identifier of the case."""
    lattice_sha256: Hash
    """Hash of the lattice: a recording goes with the case that has the same."""
    tissue_sha256: Hash | None = None
    """Hash of the tissue that blades cut: where in its cells it lies. None where it fills its cells."""
    node_count: Annotated[int, Field(ge=1)]
    """Nodes at the start."""
    cell_mm: _Positive
    """Edge of a cell, mm."""
    law: dict[Annotated[str, Field(pattern=r"^[a-z_]{1,32}$")], _LawSetting]
    """The force law: its settings by name."""
    step_s: _Positive
    """Time step, s."""
    pace: Annotated[float, Field(ge=1.0)] = 1.0
    """How many times as long steps were where they might be."""
    damping_per_s: _NotNegative
    """Damping, 1/s."""
    gravity_m_s2: Vector3
    """Gravity, LPS axes, m/s2."""
    backend: Annotated[str, Field(pattern=r"^[a-z_]{1,32}$")]
    """What stepped: the same bytes are promised on the same backend."""
    sleep_mm: _NotNegative
    """Movement that might be left out, mm."""
    start_step: Annotated[int, Field(ge=0)] = 0
    """Step at which the session began."""
    parent: RecordingParent | None = None
    """The recording that this one took over from."""
    end: RecordingEnd | None = None
    """Written when the recording is finished; missing where the process was killed."""


def header_bytes(header: RecordingHeader) -> bytes:
    """The header as a file."""
    return (json.dumps(header.model_dump(mode="json"), indent=2, sort_keys=True) + "\n").encode()


def header_hash(header: RecordingHeader) -> str:
    """What the log's chain of hashes begins with: hash of all in the header but its end."""
    # Of version 1.0, which had no pace, the hash stays what it was.
    said = header.model_dump(mode="json", exclude={"end"} if header.pace != 1.0 else {"end", "pace"})
    return sha256(json.dumps(said, sort_keys=True, separators=(",", ":")).encode()).hexdigest()


def read_header(directory: Path) -> RecordingHeader:
    """Read and check ``recording.json``.

    Raises
    ------
    RecordingError
        It is not there, not ours, of a newer version, or wrong.
    """
    data = _read(directory)
    if not isinstance(data, dict) or data.get("format") != FORMAT_NAME:
        raise RecordingError(
            f"does not say that it is a {FORMAT_NAME}: name a folder that heartcase record, or a session, wrote",
            place=HEADER_NAME,
        )
    _refuse_newer(data)
    try:
        return RecordingHeader.model_validate_json(json.dumps(data))
    except ValidationError as error:
        problem = problems_from_validation(error, place=HEADER_NAME)[0]
        raise RecordingError(f"{problem.message}: the recording is damaged", place=problem.place) from None


def _read(directory: Path) -> Any:
    file = directory / HEADER_NAME
    if not is_there(directory):
        raise RecordingError("there is nothing at this path: check its spelling", place="recording")
    if file.is_symlink() or not file.is_file():
        raise RecordingError(f"this is not a recording: it holds no {HEADER_NAME}", place="recording")
    try:
        if file.stat().st_size > HEADER_SIZE_MAX:
            raise RecordingError("is too large and was not read: the recording is damaged", place=HEADER_NAME)
        return parse_json(file.read_bytes())
    except (OSError, ValueError):
        raise RecordingError("cannot be read as JSON: the recording is damaged", place=HEADER_NAME) from None


def _refuse_newer(data: dict[str, Any]) -> None:
    version, commands = data.get("format_version"), data.get("commands_version", 1)
    is_newer = isinstance(commands, int) and not isinstance(commands, bool) and commands > COMMANDS_VERSION
    if isinstance(version, str) and (found := re.fullmatch(r"([0-9]{1,6})\.([0-9]{1,6})", version)):
        ours = tuple(int(part) for part in FORMAT_VERSION.split("."))
        is_newer = is_newer or (int(found[1]), int(found[2])) > ours
    if is_newer:
        writer = data.get("software_version")
        get = "get a newer heartcase"
        if isinstance(writer, str) and re.fullmatch(r"[0-9][0-9A-Za-z.+!-]{0,30}", writer):
            get = f"get heartcase {writer}, which recorded it, or a newer one"
        raise RecordingError(
            f"this recording is of a newer version than this heartcase reads: {get}", place=HEADER_NAME
        )
