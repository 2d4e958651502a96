"""Whether a case is approved, looked up again and again: its bytes are only read where something has changed."""

from __future__ import annotations

from pathlib import Path

from heartcase.schemas.bundle.approval import approval_log, approval_state
from heartcase.schemas.bundle.format import MANIFEST_NAME
from heartcase.schemas.errors import BundleError

__all__ = ["WatchedApproval"]

_Seen = tuple[int, int, int] | None
"""Which file it is, its size and when it was changed; None where there is none."""


class WatchedApproval:
    """The approval of a case, which may be given or withdrawn meanwhile.

    Parameters
    ----------
    case
        The case's folder.
    """

    def __init__(self, case: Path) -> None:
        self._case = case
        self._seen: tuple[_Seen, _Seen] | None = None
        self._is_approved = False

    def is_approved(self) -> bool:
        """Whether it is approved now, as it lies there; not where the system lets nobody look at it."""
        seen = (_seen(approval_log(self._case)), _seen(self._case / MANIFEST_NAME))
        if seen != self._seen:
            try:
                self._is_approved = approval_state(self._case).state == "approved"
            except BundleError:
                self._is_approved = False
            self._seen = seen
        return self._is_approved


def _seen(path: Path) -> _Seen:
    try:
        found = path.stat()
    except OSError:
        return None
    return found.st_ino, found.st_size, found.st_mtime_ns
