"""Who has approved a case, and whether it is still the case that was approved.

The approvals of ``NAME.case`` are in ``NAME.approvals.jsonl`` beside it, one JSON object a line, so the case's own
bytes stay. A line names the case by its *bundle hash*: the SHA-256 of ``case.json``, which lists the hash of every
other file. Each line carries the hash of the line before and its own, so a line that is edited, or taken out from
among others, is noticed; that the last lines are missing, or that the whole log was written anew, is not. A second
file with the last line's hash would not change that: who can cut the log can cut both. So the words of an approval say
it.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import Field, ValidationError

from heartcase import __version__
from heartcase.schemas.base import Model
from heartcase.schemas.bundle.check import check_bundle
from heartcase.schemas.bundle.format import MANIFEST_NAME
from heartcase.schemas.bundle.manifest import FILE_NAME, manifest_bytes, read_manifest
from heartcase.schemas.bundle.role_words import looks_like_a_name
from heartcase.schemas.errors import BundleError, Problem, UsageError, problems_from_validation
from heartcase.schemas.files import atomic_write, exclusive, sha256_of_file
from heartcase.schemas.strict_json import parse_json

__all__ = [
    "Approval",
    "ApprovalEntry",
    "approval_log",
    "approval_state",
    "approve_case",
    "bundle_sha256",
    "report_beside",
]

FIRST = "0" * 64
"""What stands for the line before the first."""
LOG_SIZE_MAX = 4 << 20
"""A log that is larger, in bytes, is not read."""

_Sha256 = Annotated[str, Field(pattern=r"^[0-9a-f]{64}$")]
_Words = r"^[^\x00-\x1f\x7f-\x9f\u2028-\u202e\u2066-\u2069]*$"


class ApprovalEntry(Model):
    """One line of the log."""

    action: Literal["approve", "withdraw"]
    """What was done."""
    role: Annotated[str, Field(min_length=1, max_length=100, pattern=_Words)]
    """What the reviewer is, such as ``consultant cardiologist``; not who."""
    time: Annotated[str, Field(pattern=r"^[0-9]{4}-[0-9]{2}-[0-9]{2}T[0-9]{2}:[0-9]{2}:[0-9]{2}Z$")]
    """When, UTC."""
    software_version: Annotated[str, Field(max_length=100, pattern=_Words)]
    """Version of heartcase that checked the case and wrote the line."""
    bundle_sha256: _Sha256
    """Which bytes were approved."""
    note: Annotated[str, Field(max_length=1000, pattern=_Words)] = ""
    """What else the reviewer wants to be known."""
    previous_sha256: _Sha256
    """Hash of the line before; zeros in the first."""
    sha256: _Sha256
    """Hash of the rest of this line, as compact JSON with its keys in order."""


@dataclass(frozen=True)
class Approval:
    """How a case stands."""

    state: Literal["draft", "approved", "changed since approval"]
    """``draft`` where nobody has approved it, the approval was withdrawn, or the log cannot be trusted."""
    entry: ApprovalEntry | None = None
    """The last line about these bytes; where they changed since an approval, the last approval."""
    entry_count: int = 0
    """Lines in the log."""
    problems: tuple[str, ...] = ()
    """What is wrong with the log, in plain words."""

    @property
    def words(self) -> str:
        """The state in one line."""
        entry = self.entry
        if self.problems:
            return f"draft: the approval log cannot be trusted ({self.problems[0]})"
        if entry is None:
            return "draft: nobody has approved this case"
        entries = f"{self.entry_count} entr{'y' if self.entry_count == 1 else 'ies'}"
        done = f"{entry.role} on {entry.time[:10]} ({entries} in its log"
        if self.state == "approved":
            # Each line seals those before it; nothing seals the end.
            return f"approved by {done}, which cannot show whether later ones, such as a withdrawal, were deleted)"
        if self.state == "changed since approval":
            return f"draft: the case was changed since it was approved by {done})"
        return f"draft: the approval was withdrawn by {done})"

    def as_dict(self) -> dict[str, Any]:
        """For JSON."""
        entry = self.entry.model_dump(mode="json") if self.entry else None
        return {
            "state": self.state,
            "words": self.words,
            "entry": entry,
            "entry_count": self.entry_count,
            "problems": list(self.problems),
        }


def approval_log(case: Path | str) -> Path:
    """Where the approvals of a case are: ``NAME.approvals.jsonl`` beside ``NAME.case``, wherever a link leads to it.

    Of a folder ``NAME`` without that ending, ``NAME.folder-approvals.jsonl``: it is another case.
    """
    case = Path(case).resolve()
    ending = "approvals" if case.suffix == ".case" else "folder-approvals"
    return case.with_name(f"{case.name.removesuffix('.case')}.{ending}.jsonl")


def bundle_sha256(case: Path | str) -> str:
    """Bundle hash of a case, once every file that its manifest lists has the size and the hash that it says.

    Raises
    ------
    BundleError
        A file is missing or was changed, or the manifest cannot be read.
    """
    case = Path(case)
    try:
        manifest = manifest_bytes(case)
        # The raw list: a reader of an older minor version leaves out files whose role it does not know.
        listed = [(entry["name"], entry["size"], entry["sha256"]) for entry in parse_json(manifest)["files"]]
    except (OSError, ValueError, KeyError, TypeError):
        raise BundleError("cannot be read: build the case again", place=MANIFEST_NAME) from None
    if not all(_is_as_listed(case, *entry) for entry in listed):
        raise BundleError("a file is missing or was changed: build the case again", place="files")
    return hashlib.sha256(manifest).hexdigest()


def report_beside(case: Path | str, sha256: str) -> Path | None:
    """The report that lies beside a case; None where there is none.

    Parameters
    ----------
    case
        The case's directory.
    sha256
        Its bundle hash.

    Raises
    ------
    BundleError
        It is about other bytes: a reviewer has seen another case.
    """
    case = Path(case).resolve()
    report = case.with_name(f"{case.name.removesuffix('.case')}.report.html")
    if not report.is_file():
        return None
    if sha256.encode() not in report.read_bytes():
        raise BundleError("the report beside the case is about another one: build the case again", place="report")
    return report


def _is_as_listed(case: Path, name: Any, size: Any, sha256: Any) -> bool:
    # The name as it stands: of a path only the last part would look like one.
    if not isinstance(name, str) or not FILE_NAME.fullmatch(name):
        return False
    file = case / name
    if file.is_symlink() or not file.is_file():
        return False
    try:
        return bool(file.stat().st_size == size and sha256_of_file(file) == sha256)
    except OSError:
        return False


def approval_state(case: Path | str) -> Approval:
    """Find out whether the bytes of a case are approved.

    The last line about exactly these bytes decides. A file that was changed, the manifest included, makes the case a
    draft; the same bytes, built again, are as they were. Hashes are only computed where something may be approved.

    Raises
    ------
    BundleError
        The system takes the path for none, or lets nobody look at it.
    """
    try:
        entries, problems = _read_log(approval_log(case))
    except (OSError, ValueError):
        raise BundleError("there can be no case at this path: check its spelling", place="case") from None
    if problems:
        return Approval("draft", None, len(entries), problems)
    approvals = [entry for entry in entries if entry.action == "approve"]
    if not approvals:
        return Approval("draft", entries[-1] if entries else None, len(entries))
    try:
        sha256 = bundle_sha256(case)
    except BundleError:
        return Approval("changed since approval", approvals[-1], len(entries))
    last = next((entry for entry in reversed(entries) if entry.bundle_sha256 == sha256), None)
    if last is None:
        return Approval("changed since approval", approvals[-1], len(entries))
    return Approval("approved" if last.action == "approve" else "draft", last, len(entries))


def approve_case(
    case: Path | str,
    *,
    role: str,
    note: str = "",
    withdraw: bool = False,
    expected_sha256: str | None = None,
    now: datetime | None = None,
) -> Approval:
    """Approve the bytes of a case, or withdraw their approval: append a line to the log.

    Parameters
    ----------
    case
        The case's directory.
    role
        What the reviewer is; not a name. Spaces around it are taken off.
    note
        Free text.
    withdraw
        Withdraw the approval of these bytes instead.
    expected_sha256
        Bundle hash of what the reviewer saw; a case that is another one by now is refused.
    now
        When; the present time when left out.

    Returns
    -------
    Approval
        The state after it.

    Raises
    ------
    BundleError
        The case is not sound; every problem at once. Only of an approval.
    UsageError
        The log was tampered with or cannot be written, the role or the note is not plain text, the role looks like a
        person's name, ``now`` is no date with a time, or there is no approval to withdraw.
    """
    problems = [
        Problem(name, f"must be text (found {found!r})")
        for name, found in (("role", role), ("note", note))
        if not isinstance(found, str)
    ]
    if now is not None and not isinstance(now, datetime):
        problems.append(Problem("now", f"must be a datetime, such as datetime.now(UTC) (found {now!r})"))
    if problems:
        raise UsageError(problems)
    case, role = Path(case), role.strip()
    if not any(letter.isalpha() for letter in role):
        raise UsageError("say in words what the reviewer is, such as: consultant cardiologist", place="role")
    if looks_like_a_name(role):
        raise UsageError(
            "this looks like a person's name, and the log goes with the case: say what the reviewer is, such as "
            "consultant cardiologist (in small letters, if it is no name)",
            place="role",
        )
    if withdraw:
        read_manifest(case)
    elif wrong := check_bundle(case):
        raise BundleError(wrong)
    log = approval_log(case)
    try:
        # The case's own lock: no build replaces the bytes between their hash and the line.
        with exclusive(case), exclusive(log.parent):
            entries, found = _read_log(log)
            if found:
                raise UsageError(
                    f"{'; '.join(found)}: move the log away, keep it, and approve again", place="approval log"
                )
            sha256 = _manifest_sha256(case) if withdraw else bundle_sha256(case)
            if expected_sha256 not in (None, sha256):
                raise UsageError("the case was changed while you looked at it: look again", place="CASE")
            last = next((entry for entry in reversed(entries) if entry.bundle_sha256 == sha256), None)
            if withdraw and (last is None or last.action != "approve"):
                raise UsageError("there is no approval of this case, as it is, to withdraw", place="CASE")
            entry = _entry(
                {
                    "action": "withdraw" if withdraw else "approve",
                    "role": role,
                    "time": (now or datetime.now(UTC)).astimezone(UTC).strftime("%Y-%m-%dT%H:%M:%SZ"),
                    "software_version": __version__,
                    "bundle_sha256": sha256,
                    "note": note,
                    "previous_sha256": entries[-1].sha256 if entries else FIRST,
                }
            )
            before = log.read_bytes() if entries else b""
            atomic_write(log, before + f"{_line(entry.model_dump(mode='json'))}\n".encode())
    except OSError as error:
        raise UsageError(f"cannot be written: {error.strerror}", place="approval log") from None
    return approval_state(case)


def _manifest_sha256(case: Path) -> str:
    return hashlib.sha256(manifest_bytes(case)).hexdigest()


def _entry(facts: Mapping[str, Any]) -> ApprovalEntry:
    try:
        return ApprovalEntry.model_validate({**facts, "sha256": _own_sha256(facts)})
    except ValidationError as error:
        raise UsageError(problems_from_validation(error)) from None


def _own_sha256(facts: Mapping[str, Any]) -> str:
    return hashlib.sha256(_line({key: facts[key] for key in facts if key != "sha256"}).encode()).hexdigest()


def _line(facts: Mapping[str, Any]) -> str:
    return json.dumps(facts, ensure_ascii=False, sort_keys=True, separators=(",", ":"))


def _read_log(log: Path) -> tuple[list[ApprovalEntry], tuple[str, ...]]:
    """The lines of a log that can be read, and what is wrong with it."""
    if not log.exists() and not log.is_symlink():
        return [], ()
    try:
        if log.is_symlink() or not log.is_file() or log.stat().st_size > LOG_SIZE_MAX:
            return [], (f"it is no plain file, or larger than {LOG_SIZE_MAX >> 20} MiB",)
        lines = log.read_text(encoding="utf-8").split("\n")
    except (OSError, UnicodeDecodeError):
        return [], ("it cannot be read as UTF-8 text",)
    entries: list[ApprovalEntry] = []
    problems = [] if lines[-1] == "" else ["its last line is cut off"]
    for number, line in enumerate(lines[:-1], start=1):
        entry = _parsed(line)
        if entry is None:
            problems.append(f"line {number} was changed")
        else:
            entries.append(entry)
    problems += _chain_problems(entries) if not problems else []
    return entries, tuple(problems)


def _parsed(line: str) -> ApprovalEntry | None:
    try:
        facts = json.loads(line)
        # A newer version may say more in a line; its hash covers that too.
        entry = ApprovalEntry.model_validate({key: facts[key] for key in ApprovalEntry.model_fields if key in facts})
    except (ValueError, TypeError, KeyError, RecursionError):
        return None
    return entry if entry.sha256 == _own_sha256(facts) and line == _line(facts) else None


def _chain_problems(entries: Sequence[ApprovalEntry]) -> list[str]:
    previous = FIRST
    problems = []
    for number, entry in enumerate(entries, start=1):
        if entry.previous_sha256 != previous:
            problems.append(f"a line before line {number} was taken out, put in or moved")
        previous = entry.sha256
    return problems
