"""Which structures are locked: what pages keep beside the recipe, which says nothing of it."""

from __future__ import annotations

import json
from pathlib import Path

from heartcase.pipeline.markers.session import SegmentationSession
from heartcase.schemas.errors import UsageError
from heartcase.schemas.files import atomic_write

__all__ = ["keep_locks", "lock_again", "lock_label"]


def lock_label(session: SegmentationSession, name: str, *, is_locked: bool, file: Path) -> None:
    """Lock a structure, or unlock it; what is locked is so after the next start, too.

    Parameters
    ----------
    session
        What is painted on.
    name
        Name of a label.
    is_locked
        Whether it is locked then.
    file
        Where it is remembered.

    Raises
    ------
    UsageError
        There is no such label.
    """
    label = session.table.find(name)
    if label is None:
        raise UsageError(f"there is no label {name!r}", place="lock")
    session.lock(session.locked | {label.value} if is_locked else session.locked - {label.value})
    keep_locks(session, file)


def keep_locks(session: SegmentationSession, file: Path) -> None:
    """Remember in a file what is locked."""
    names = sorted(session.table[value].name for value in session.locked)
    try:
        file.parent.mkdir(parents=True, exist_ok=True)
        atomic_write(file, json.dumps({"locked": names}).encode())
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
