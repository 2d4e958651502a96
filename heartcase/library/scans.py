"""The scans of recipes that make their own: written once, and again when the recipe or the phantom changes."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from heartcase.phantom.made_scan import made_scan
from heartcase.phantom.version import PHANTOM_VERSION
from heartcase.pipeline.data import Scan
from heartcase.pipeline.write import write_scan
from heartcase.schemas.errors import UsageError
from heartcase.schemas.files import atomic_write
from heartcase.schemas.phantom_scan import PhantomScan
from heartcase.schemas.recipe import ScanSource

__all__ = ["ensure_scan", "note_scan", "scan_is_made"]


def scan_is_made(source: ScanSource, directory: Path) -> bool:
    """Whether a recipe's scan lies there as it would be made now; true of one that is not made at all."""
    if source.phantom is None:
        return True
    path = directory / source.path
    try:
        return path.is_file() and json.loads(_note(path).read_text(encoding="utf-8")) == _made_from(source)
    except (OSError, ValueError):
        return False


def ensure_scan(source: ScanSource, directory: Path) -> bool:
    """Make a recipe's scan, where it is one that is made and does not lie there yet; true where it was made now.

    Beside the scan lies ``NAME.made.json``, which says what it was made from.

    Raises
    ------
    UsageError
        Another file has its place, which is left as it is, or it cannot be written.
    """
    if scan_is_made(source, directory):
        return False
    assert source.phantom is not None
    path = directory / source.path
    if path.exists() and not _note(path).exists():
        raise UsageError(
            f"a file that was not made for this recipe lies where its scan goes ({path.name}): move it, or change path",
            place="scan.path",
        )
    scan = made_scan(source.phantom)
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        _note(path).unlink(missing_ok=True)
        # Between the two writes a crash leaves a note without a scan, or an empty note: both are made again.
        atomic_write(_note(path), b"{}")
        write_scan(Scan(scan.values, scan.geometry, scan.modality), path)
        note_scan(path, source.phantom)
    except OSError as error:
        reason = (error.strerror or "the system gives no reason").lower()
        raise UsageError(f"the scan cannot be written: {reason}", place="scan.path") from None
    return True


def note_scan(path: Path, settings: PhantomScan) -> None:
    """Say beside a scan what it was made from, so that it counts as made for a recipe that asks for the same."""
    made_from = {"phantom_version": PHANTOM_VERSION, "phantom": json.loads(settings.model_dump_json())}
    atomic_write(_note(path), json.dumps(made_from, indent=1, sort_keys=True).encode())


def _note(path: Path) -> Path:
    return path.with_name(f"{path.name}.made.json")


def _made_from(source: ScanSource) -> dict[str, Any]:
    assert source.phantom is not None
    return {"phantom_version": PHANTOM_VERSION, "phantom": json.loads(source.phantom.model_dump_json())}
