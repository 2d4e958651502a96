"""The scans of recipes that make their own: written once, and again when the recipe or the phantom changes."""

from __future__ import annotations

import json
import os
from pathlib import Path
from typing import Any

from heartcase.phantom.version import PHANTOM_VERSION
from heartcase.pipeline.data import Scan
from heartcase.pipeline.formats.write_images import write_scan
from heartcase.schemas.bundle.placing import refuse_inside_case
from heartcase.schemas.errors import UsageError
from heartcase.schemas.files import TEMPORARY_PREFIX, atomic_write, remove_leftovers, sha256_of_file
from heartcase.schemas.recipe.phantom_scan import PhantomScan
from heartcase.schemas.recipe.recipe import ScanSource

__all__ = ["ensure_scan", "note_scan", "scan_is_made"]


def scan_is_made(source: ScanSource, directory: Path) -> bool:
    """Whether a recipe's scan lies there as it would be made now; true of one that is not made at all."""
    if source.phantom is None:
        return True
    path = directory / source.path
    note = _read_note(path)
    sha256 = note.pop("scan_sha256", None)
    return note == _made_from(source.phantom) and path.is_file() and sha256_of_file(path) == sha256


def ensure_scan(source: ScanSource, directory: Path) -> bool:
    """Make a recipe's scan, where it is one that is made and does not lie there yet; true where it was made now.

    Beside the scan lies ``NAME.made.json``, which says what it was made from.

    Parameters
    ----------
    source
        ``[scan]`` of the recipe.
    directory
        Where the recipe's relative paths start.

    Raises
    ------
    UsageError
        Another file has its place, which is left as it is, its place is in a case, or it cannot be written.
    """
    if scan_is_made(source, directory):
        return False
    assert source.phantom is not None
    path = directory / source.path
    refuse_inside_case(path, place="scan.path")
    if path.exists() and _read_note(path).get("scan_sha256") != sha256_of_file(path):
        raise UsageError(
            f"a file that was not made for this recipe lies where its scan goes ({path.name}): move it, or change path",
            place="scan.path",
        )
    # Only where a scan is made: the phantom's anatomy takes half a second to load.
    from heartcase.phantom.scan import made_scan

    scan = made_scan.made_scan(source.phantom)
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        remove_leftovers(path.parent)
        unfinished = path.with_name(f"{TEMPORARY_PREFIX}{os.getpid()}-{path.name}")
        write_scan(Scan(scan.values, scan.geometry, scan.modality), unfinished)
        # A scan without its note would count as somebody else's: killed here, there is no scan, and it is made again.
        path.unlink(missing_ok=True)
        note_scan(path, source.phantom, content=unfinished)
        unfinished.replace(path)
    except OSError as error:
        reason = (error.strerror or "the system gives no reason").lower()
        raise UsageError(f"the scan cannot be written: {reason}", place="scan.path") from None
    return True


def note_scan(path: Path, settings: PhantomScan | None, *, content: Path | None = None) -> None:
    """Say beside a scan what it was made from, so that it counts as made for a recipe that asks for the same.

    Parameters
    ----------
    path
        Where the scan is, or will be.
    settings
        What it was made from; None, where that cannot be said, removes the note of the scan that was there before.
    content
        The file that will be moved there; None where it is there already.
    """
    if settings is None:
        _note(path).unlink(missing_ok=True)
        return
    note = _made_from(settings) | {"scan_sha256": sha256_of_file(content or path)}
    atomic_write(_note(path), json.dumps(note, indent=1, sort_keys=True).encode())


def _note(path: Path) -> Path:
    return path.with_name(f"{path.name}.made.json")


def _read_note(path: Path) -> dict[str, Any]:
    try:
        note = json.loads(_note(path).read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return {}
    return note if isinstance(note, dict) else {}


def _made_from(settings: PhantomScan) -> dict[str, Any]:
    return {"phantom_version": PHANTOM_VERSION, "phantom": json.loads(settings.model_dump_json())}
