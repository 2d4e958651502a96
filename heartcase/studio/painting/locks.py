"""Which structures are locked: what pages keep beside the recipe, which says nothing of it."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path

from heartcase.pipeline.markers.session import SegmentationSession
from heartcase.schemas.errors import UsageError
from heartcase.schemas.files import atomic_write

__all__ = ["lock_again", "lock_labels"]


def lock_labels(session: SegmentationSession, names: Sequence[str], file: Path) -> None:
    """Lock structures, and no others; they are locked after the next start, too.

    Parameters
    ----------
    session
        What is painted on.
    names
        Names of labels.
    file
        Where they are remembered.

    Raises
    ------
    UsageError
        There is no such label.
    """
    labels = [(name, session.table.find(name)) for name in names]
    unknown = [name for name, label in labels if label is None]
    if unknown:
        raise UsageError(f"there is no label {unknown[0]!r}", place="lock")
    found = {label.value: label.name for _, label in labels if label is not None}
    session.lock(found.keys())
    try:
        file.parent.mkdir(parents=True, exist_ok=True)
        atomic_write(file, json.dumps({"locked": sorted(found.values())}).encode())
    except OSError:
        # they are locked as long as the server runs
        return


def lock_again(session: SegmentationSession, file: Path) -> None:
    """Lock what was locked before; nothing where that is not known."""
    try:
        names = json.loads(file.read_bytes())["locked"]
        labels = [session.table.find(name) for name in names if isinstance(name, str)]
    except (OSError, ValueError, KeyError, TypeError):
        return
    session.lock([label.value for label in labels if label is not None])
