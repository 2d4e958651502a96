"""The made-up identifier of a case, and the key file that ties it to a patient.

The identifier is on every output. Whom it belongs to is written down only where the user asks for it: in a key file
that stays with whoever may know, outside the case.
"""

from __future__ import annotations

import hashlib
import json
import os
from pathlib import Path

from heartcase.schemas.errors import UsageError
from heartcase.schemas.files import atomic_write, exclusive

__all__ = ["add_to_key_file", "check_key_file", "made_up_case_id"]

_ALPHABET = "0123456789ABCDEFGHJKMNPQRSTVWXYZ"
"""Digits and capitals without those that are misread for others (Crockford's base 32)."""
_GROUPS = (4, 4, 4)


def made_up_case_id(name: str, scan_sha256: str) -> str:
    """Make an identifier such as ``HC-7K3M-9QXD-04TB`` for a case whose recipe states none.

    Parameters
    ----------
    name
        Name of the case.
    scan_sha256
        Hash of the scan's intensities and geometry: no header, so nothing of a patient goes in.

    Returns
    -------
    str
        60 bits of a hash of both: the same case has the same identifier wherever it is built.
    """
    number = int.from_bytes(hashlib.sha256(f"{name}\n{scan_sha256}".encode()).digest(), "big")
    groups = []
    for length in _GROUPS:
        letters = ""
        for _ in range(length):
            number, digit = divmod(number, len(_ALPHABET))
            letters += _ALPHABET[digit]
        groups.append(letters)
    return "-".join(("HC", *groups))


def check_key_file(key_file: Path, case: Path) -> None:
    """Refuse a place for the key file before any work is done.

    Raises
    ------
    UsageError
        It would lie inside the case, where it would be passed on with it, or is a directory.
    """
    place = "--key-file"
    if case.resolve() in (key_file.resolve(), *key_file.resolve().parents):
        raise UsageError("must not lie inside the case: it would be passed on with it", place=place)
    if key_file.is_dir():
        raise UsageError("is a directory: give a file name, for instance keys.jsonl", place=place)
    if not key_file.absolute().parent.is_dir():
        raise UsageError("its folder does not exist: make it first", place=place)


def add_to_key_file(key_file: Path, case_id: str, identity: dict[str, str]) -> bool:
    """Write down whom a case belongs to, as one JSON line; returns whether the line is new.

    Parameters
    ----------
    key_file
        Made, readable by its owner only, where it is not there. Other lines stay as they are.
    case_id
        Identifier of the case.
    identity
        What the scan says of the patient; see :func:`heartcase.pipeline.formats.dicom_identity.identity_of`.

    Raises
    ------
    UsageError
        The file cannot be written.
    """
    line = (
        json.dumps({"case_id": case_id, **identity}, ensure_ascii=False, sort_keys=True).encode(
            errors="surrogateescape"
        )
        + b"\n"
    )
    try:
        with exclusive(key_file.absolute().parent):
            before = key_file.read_bytes() if key_file.exists() else b""
            if line in before.splitlines(keepends=True):
                return False
            if before and not before.endswith(b"\n"):
                before += b"\n"
            mask = os.umask(0o077)
            try:
                atomic_write(key_file, before + line)
            finally:
                os.umask(mask)
    except OSError as error:
        raise UsageError(f"cannot be written: {error.strerror}", place="--key-file") from None
    return True
