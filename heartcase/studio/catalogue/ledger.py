"""What the catalogue wrote into its folder: so that a page is made once, and nothing of anybody else is touched.

A ledger file stands for each case, and one for the site. It names every file with its hash before the file is
written, so that also after a crash the catalogue knows its own.
"""

from __future__ import annotations

import contextlib
import hashlib
import json
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from heartcase.schemas.errors import UsageError
from heartcase.schemas.files import atomic_write, sha256_of_file

__all__ = ["LEDGER", "SITE", "Ledger", "Page", "is_ours", "is_unchanged", "read_ledgers", "remove_page", "write_page"]

LEDGER = ".heartcase-catalogue"
"""Folder of the ledgers, in the site."""
SITE = "_site"
"""Ledger of what belongs to no case; no case can have this name."""
_VERSION = 1

Content = Mapping[str, bytes]
"""Path below the site's folder, with slashes -> content of the file."""


@dataclass(frozen=True)
class Page:
    """What a ledger file says: of a case, or of the site."""

    stamp: str = ""
    """What it was made from; empty while it is being written."""
    card: dict[str, Any] | None = None
    """What the index says of the case; None for the site, and for a case that is refused."""
    problems: tuple[tuple[str, str], ...] = ()
    """Place and message of what keeps the case out."""
    files: dict[str, str] = field(default_factory=dict)
    """Path of each file that was written, or was about to be -> SHA-256 of its content."""
    times: dict[str, list[int]] = field(default_factory=dict)
    """Path -> size in bytes and time of last change in ns, as it was written."""
    warnings: tuple[tuple[str, str], ...] = ()
    """Place and message of what its page goes without, such as a tour that is wrong."""


Ledger = dict[str, Page]
"""Name of a case, or :data:`SITE` -> what was written for it."""


def read_ledgers(site: Path) -> Ledger:
    """All ledgers of a site; those that cannot be read count as not there."""
    found = {}
    for path in sorted((site / LEDGER).glob("*.json")):
        with contextlib.suppress(OSError, ValueError, TypeError, KeyError, AttributeError):
            data = json.loads(path.read_text(encoding="utf-8"))
            if data.pop("ledger_version") != _VERSION:
                continue
            for kind in ("problems", "warnings"):
                data[kind] = tuple((str(place), str(message)) for place, message in data.get(kind, ()))
            page = Page(**data)
            if all(_is_below(one) for one in page.files) and _is_card(page.card, path.stem):
                found[path.stem] = page
    return found


def is_unchanged(site: Path, page: Page) -> bool:
    """Whether every file of a page lies there as it was written."""
    return page.times.keys() == page.files.keys() and all(
        _size_and_time(site / path) == times for path, times in page.times.items()
    )


def write_page(site: Path, name: str, content: Content, before: Page | None, after: Page) -> Page:
    """Write the files of a page, those that changed, and its ledger; what it no longer has is removed.

    Parameters
    ----------
    site
        Folder of the site.
    name
        Name of the case, or :data:`SITE`.
    content
        Its files.
    before
        Its ledger until now.
    after
        Stamp, card, problems and warnings for the ledger.

    Returns
    -------
    Page
        The ledger as written.

    Raises
    ------
    UsageError
        A file that the catalogue did not write is in the way.
    """
    old = before.files if before is not None else {}
    hashes = {path: hashlib.sha256(data).hexdigest() for path, data in content.items()}
    for path in content:
        if path not in old and (site / path).exists() and sha256_of_file(site / path) != hashes[path]:
            raise UsageError(
                f"{path} is there already, and the catalogue did not write it: move it away, or give another folder",
                place="OUT",
            )
    if all(_is_there(site / path, hashes[path]) for path in content) and before is not None:
        times = {path: _size_and_time(site / path) or [] for path in content}
        page = replace(after, files=hashes, times=times)
    else:
        _write_ledger(site, name, Page(files={**old, **hashes}))
        for path, data in content.items():
            if not _is_there(site / path, hashes[path]):
                (site / path).parent.mkdir(parents=True, exist_ok=True)
                atomic_write(site / path, data)
        times = {path: _size_and_time(site / path) or [] for path in content}
        page = replace(after, files=hashes, times=times)
    for path, sha256 in old.items():
        if path not in content:
            _remove(site, path, sha256)
    if page != before:
        _write_ledger(site, name, page)
    return page


def remove_page(site: Path, name: str, page: Page) -> None:
    """Remove what was written for a case that is gone, files that somebody has changed since excepted."""
    for path, sha256 in page.files.items():
        _remove(site, path, sha256)
    with contextlib.suppress(OSError):
        (site / LEDGER / f"{name}.json").unlink()


def is_ours(site: Path) -> bool:
    """Whether a folder is a site of the catalogue, or may become one: it is not there, or empty."""
    return not site.exists() or (site / LEDGER).is_dir() or (site.is_dir() and not any(site.iterdir()))


def _write_ledger(site: Path, name: str, page: Page) -> None:
    path = site / LEDGER / f"{name}.json"
    path.parent.mkdir(parents=True, exist_ok=True)
    data = {"ledger_version": _VERSION, **page.__dict__}
    atomic_write(path, json.dumps(data, indent=1, ensure_ascii=False).encode())


def _remove(site: Path, path: str, sha256: str) -> None:
    if _is_there(site / path, sha256):
        (site / path).unlink()


def _is_there(path: Path, sha256: str) -> bool:
    return path.is_file() and not path.is_symlink() and sha256_of_file(path) == sha256


def _is_card(card: Any, name: str) -> bool:
    """Whether a card is one that the index can show; somebody may have changed the ledger."""
    if card is None:
        return True
    titles, diagnoses = card["titles"], card["diagnoses"]
    return card["name"] == name and isinstance(titles["en"], str) and all(one["name"] for one in diagnoses)


def _is_below(path: str) -> bool:
    parts = path.split("/")
    return all(part not in ("", ".", "..") and "\\" not in part and ":" not in part for part in parts)


def _size_and_time(path: Path) -> list[int] | None:
    try:
        status = path.lstat()
    except OSError:
        return None
    return [status.st_size, status.st_mtime_ns]
