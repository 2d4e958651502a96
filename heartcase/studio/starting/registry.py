"""What is open in the studio: recipes and cases, each under a key that tells nothing about it."""

from __future__ import annotations

import asyncio
import base64
import hashlib
import hmac
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from heartcase.schemas.recording.header import HEADER_NAME
from heartcase.studio.building.building import Building
from heartcase.studio.offline.exported import fitting_page_of
from heartcase.studio.operating.theatre import Origin, Theatre
from heartcase.studio.pages import Place
from heartcase.studio.painting.workplace import Workplace

__all__ = ["Left", "Opened", "Registry"]

_KEY_LENGTH = 12


@dataclass(frozen=True)
class Opened:
    """Something that is open."""

    page: str
    """Which page shows it: ``prepare`` a recipe, ``operate`` a case."""
    key: str
    """Its key in addresses."""
    path: Path
    """Its file or folder; never told to a page."""
    places: Mapping[str, Place]
    """What a page of it is connected to, by the name of the socket."""

    @property
    def address(self) -> str:
        """Path of its page in this server's addresses."""
        return f"/{self.page}/{self.key}"


@dataclass(frozen=True)
class Left:
    """What a run of the studio leaves, for whoever ends it."""

    recipe_count: int = 0
    """Recipes that were opened; each holds its strokes."""
    case_count: int = 0
    """Cases that were opened to be operated on."""
    recordings: tuple[Path, ...] = ()
    """Recordings that were written meanwhile."""


class Registry:
    """What is open. All methods belong to one event loop, or come before it starts.

    Parameters
    ----------
    token
        Secret of this run: keys are made from it, so that nobody can guess one, and the same path has the same key.
    """

    def __init__(self, token: str) -> None:
        self._token = token
        self._opened: dict[str, Opened] = {}
        self._keys: dict[str, set[str]] = {"prepare": set(), "operate": set()}
        self._there: dict[Path, dict[Path, str]] = {}

    def open_recipe(self, path: Path, *, out: Path) -> Opened:
        """Open a recipe, or find it where it is open.

        Parameters
        ----------
        path
            The recipe's file. What is wrong in it is told to its pages.
        out
            Directory that its case is built in, with the build's cache.
        """
        key = self._key("prepare", path)
        if key not in self._opened:
            origin = Origin(path, f"/prepare/{key}")
            building = Building(path, out=out, operate=lambda case: self.open_case(case, origin=origin).address)
            places: dict[str, Place] = {"socket": Workplace(path, out=out), "building": building}
            self._opened[key] = Opened("prepare", key, path, places)
            self._keys["prepare"].add(key)
        return self._opened[key]

    def open_case(self, path: Path, *, out: Path | None = None, origin: Origin | None = None) -> Opened:
        """Open a case to be operated on, or find it where it is open.

        Parameters
        ----------
        path
            The case's folder. What is wrong with it is told to its pages.
        out
            Folder that recordings are put into, and taken from; beside the case when left out.
        origin
            The recipe that it is opened from: its pages lead back there, and show its scan.
        """
        key = self._key("operate", path)
        if key not in self._opened:
            folder = path.parent if out is None else out
            self._there.setdefault(folder.resolve(), _recordings(folder.resolve()))
            self._keys["operate"].add(key)
            # a second session on it, for two recordings side by side: it is begun when a page asks for it
            places = {name: Theatre(path, out=folder, page_of=fitting_page_of) for name in ("operating", "beside")}
            self._opened[key] = Opened("operate", key, path, places)
        place = self._opened[key].places["operating"]
        if origin is not None and isinstance(place, Theatre):
            place.origin = origin
        return self._opened[key]

    def find(self, page: str, key: str) -> Opened | None:
        """What is open under a key and shown by this page; None where there is nothing."""
        found = self._opened.get(key)
        return found if found is not None and found.page == page else None

    def place(self, line: str, key: str) -> Place | None:
        """What a socket of this name and key talks to; None where there is nothing."""
        found = self._opened.get(key)
        return None if found is None else found.places.get(line)

    def left(self) -> Left:
        """What was opened so far, and the recordings that have come since into the folders of the cases."""
        new: list[Path] = []
        for folder, before in self._there.items():
            now = _recordings(folder)
            # one that was there may have another name now
            renamed = {key for path, key in before.items() if path not in now}
            new += [path for path, key in now.items() if path not in before and key not in renamed]
        return Left(len(self._keys["prepare"]), len(self._keys["operate"]), tuple(sorted(new)))

    async def close(self) -> None:
        """Close all that is open; what is not saved yet is saved."""
        closing = [place.close() for opened in self._opened.values() for place in opened.places.values()]
        self._opened.clear()
        await asyncio.gather(*closing)

    def _key(self, page: str, path: Path) -> str:
        made = hmac.digest(
            self._token.encode(), f"{page}\0{path.resolve()}".encode(errors="surrogateescape"), hashlib.sha256
        )
        return base64.urlsafe_b64encode(made).decode()[:_KEY_LENGTH]


def _recordings(folder: Path) -> dict[Path, str]:
    """The recordings in a folder, and what tells whether one is the same under another name."""
    try:
        paths = [path for path in folder.iterdir() if path.suffix == ".recording"]
    except OSError:
        return {}
    return {path: _key_of(path) for path in paths}


def _key_of(recording: Path) -> str:
    try:
        return hashlib.sha256((recording / HEADER_NAME).read_bytes()).hexdigest()
    except OSError:
        return recording.name
