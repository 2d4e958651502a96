"""What was opened last: a small file in the user's state folder. Its paths stay in the server."""

from __future__ import annotations

import contextlib
import hashlib
import json
import os
import sys
from collections.abc import Callable
from dataclasses import asdict, dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Any, Literal

from heartcase.schemas.errors import UsageError
from heartcase.schemas.files import atomic_write, exclusive

__all__ = ["Recent", "Work", "state_folder"]

COUNT_MAX = 12
"""Entries that are kept."""
_FILE = "studio.json"
_SIZE_MAX = 1 << 18


@dataclass(frozen=True)
class Work:
    """Something that was opened."""

    kind: Literal["recipe", "case"]
    """What it is."""
    path: str
    """Where it is."""
    out: str
    """Where the recipe's case is built; empty for a case."""
    name: str
    """Its name, as on every output."""
    opened: str
    """When, UTC."""

    @property
    def key(self) -> str:
        """What the page asks for it by: tells nothing of the path."""
        return hashlib.sha256(f"{self.kind}\0{self.path}".encode("utf-8", "surrogateescape")).hexdigest()[:16]


def state_folder() -> Path:
    """Where this user's programs keep what they remember."""
    if os.environ.get("XDG_STATE_HOME"):
        return Path(os.environ["XDG_STATE_HOME"]) / "heartcase"
    if sys.platform == "win32" and os.environ.get("LOCALAPPDATA"):
        return Path(os.environ["LOCALAPPDATA"]) / "heartcase"
    if sys.platform == "darwin":
        return Path.home() / "Library" / "Application Support" / "heartcase"
    return Path.home() / ".local" / "state" / "heartcase"


class Recent:
    """The list of what was opened last. What cannot be read or written is forgotten, and stops nothing.

    Parameters
    ----------
    folder
        Where its file is; made when it is needed.
    """

    def __init__(self, folder: Path) -> None:
        self._file = folder / _FILE

    def note(self, kind: Literal["recipe", "case"], path: Path, *, name: str, out: Path | None = None) -> None:
        """Remember that something was opened, now."""
        where = "" if out is None else str(out.resolve())
        now = datetime.now(UTC).strftime("%Y-%m-%dT%H:%M:%SZ")
        work = Work(kind, str(path.resolve()), where, name, now)
        self._change(lambda known: [work, *(one for one in known if one.key != work.key)][:COUNT_MAX])

    def forget(self, key: str) -> None:
        """Take an entry off the list; what it stands for stays where it is."""
        self._change(lambda known: [one for one in known if one.key != key])

    def entry(self, key: str) -> Work:
        """The entry with a key.

        Raises
        ------
        UsageError
            There is none.
        """
        for one in self._read():
            if one.key == key:
                return one
        raise UsageError("this is no longer in the list: load the page again", place="recent")

    def out_of(self, recipe: Path) -> Path | None:
        """Where a recipe's case was built when it was last open; None where that is not remembered."""
        path = str(recipe.resolve())
        found = next((one.out for one in self._read() if one.kind == "recipe" and one.path == path), "")
        return Path(found) if found else None

    def shown(self, named: Callable[[Path], str | None] = lambda _: None) -> list[dict[str, Any]]:
        """The list for the page, the last one first: no path is in it.

        Parameters
        ----------
        named
            What the page is told of the folder that an entry lies in; None for nothing.
        """
        return [
            {
                "key": one.key,
                "kind": one.kind,
                "name": one.name,
                "folder": named(Path(one.path).parent),
                "opened": one.opened,
                "is_there": os.path.exists(one.path),
            }
            for one in self._read()
        ]

    def _read(self) -> list[Work]:
        try:
            if self._file.stat().st_size > _SIZE_MAX:
                return []
            rows = json.loads(self._file.read_bytes())["opened"]
            found = [Work(**row) for row in rows]
            return [one for one in found if all(isinstance(value, str) for value in asdict(one).values())]
        except (OSError, ValueError, KeyError, TypeError):
            return []

    def _change(self, change: Callable[[list[Work]], list[Work]]) -> None:
        with contextlib.suppress(OSError):
            self._file.parent.mkdir(parents=True, exist_ok=True, mode=0o700)
            with exclusive(self._file.parent):
                data = {"opened": [asdict(one) for one in change(self._read())]}
                atomic_write(self._file, json.dumps(data, indent=1).encode("utf-8", "surrogateescape"))
                self._file.chmod(0o600)
