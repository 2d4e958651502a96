"""From an older version of a file's format to the newest, one version at a time.

A version is raised by registering how a file of the version before becomes one of it; the newest version is the one
that the last migration leads to. Older files are brought up to date in memory whenever they are read, so a recipe of
any version builds; ``heartcase upgrade`` says what that changes and writes it down.
"""

from __future__ import annotations

import copy
import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any

from heartcase import __version__
from heartcase.schemas.errors import HeartcaseError, RecipeError, ScriptError

__all__ = ["BUNDLE_CHANGES", "PLANS", "RECIPE", "SCRIPT", "TOUR", "Migration", "VersionedFormat", "bundle_changes"]


@dataclass(frozen=True)
class Migration:
    """How a file of one version becomes one of the next."""

    words: tuple[str, ...]
    """What that changes, a plain sentence each."""
    change: Callable[[dict[str, Any]], dict[str, Any]]
    """Takes the file's data, returns it changed; the version is set for it."""


@dataclass(frozen=True)
class VersionedFormat:
    """A kind of TOML file that says which version of its format it is of."""

    name: str
    """What it is called in a message."""
    key: str
    """Its key at the top of the file."""
    error: type[HeartcaseError]
    """What is raised about such a file."""
    migrations: dict[int, Migration] = field(default_factory=dict)
    """Version -> how a file of it becomes one of the next."""

    @property
    def newest(self) -> int:
        """The version that this heartcase writes."""
        return max(self.migrations, default=0) + 1

    def version_of(self, data: Mapping[str, Any]) -> int | None:
        """The version that a file states, 1 where it states none; None where that is no version at all."""
        version = data.get(self.key, 1)
        is_version = isinstance(version, int) and not isinstance(version, bool) and version >= 1
        return version if is_version else None

    def migrated(self, data: Mapping[str, Any]) -> tuple[dict[str, Any], tuple[str, ...]]:
        """Bring a file's data to the newest version.

        Parameters
        ----------
        data
            What the TOML file holds; not changed. One that states no sensible version comes back as it is.

        Returns
        -------
        tuple
            The data, and what was changed in plain words.

        Raises
        ------
        HeartcaseError
            The file is of a version that this heartcase does not know.
        """
        result = copy.deepcopy(dict(data))
        version = self.version_of(result)
        if version is None:
            return result, ()
        if version > self.newest:
            raise self.error(self._too_new(data, version), place=self.key)
        words: list[str] = []
        for old in range(version, self.newest):
            migration = self.migrations[old]
            result = {**migration.change(result), self.key: old + 1}
            words += migration.words
        return result, tuple(words)

    def _too_new(self, data: Mapping[str, Any], version: int) -> str:
        lock = data.get("lock")
        writer = lock.get("software_version") if isinstance(lock, dict) else None
        get = "get a newer heartcase"
        if isinstance(writer, str) and re.fullmatch(r"[0-9][0-9A-Za-z.+!-]{0,30}", writer):
            get = f"get heartcase {writer}, which wrote it, or a newer one"
        return (
            f"this {self.name} is of version {version}, but heartcase {__version__} reads versions up to "
            f"{self.newest}: {get}"
        )


RECIPE = VersionedFormat("recipe", "heartcase_recipe", RecipeError)
"""Versions of the case recipe."""

SCRIPT = VersionedFormat("simulation script", "heartcase_script", ScriptError)
"""Versions of the simulation script."""

PLANS = VersionedFormat("file of incision plans", "heartcase_plans", ScriptError)
"""Versions of the file of incision plans."""

TOUR = VersionedFormat("guided tour", "heartcase_tour", ScriptError)
"""Versions of the guided tour."""

BUNDLE_CHANGES: dict[str, tuple[str, ...]] = {
    "1.1": (
        "the manifest describes every array (type, shape, unit, place in the file), so that a reader in another "
        "language needs no table of its own",
        "the arrays start at multiples of 64 bytes, so that they can be mapped into memory as they are",
        "the manifest states the conventions of its coordinates",
        "the case has an identifier that is on every output",
        "the filtered scan can be a part of the case, for a simulator that shows slices",
    ),
    "1.2": (
        "every triangle of the surface has a kind: endocardium, epicardium, a vessel's inside or outside, a device, a "
        "defect's rim, a cut face; the GLB has a primitive for each",
        "the surface can come in coarser levels of detail, each with its own normal map and mapping",
    ),
    "1.3": ("the grid says where in each cell the tissue lies, by its moments",),
    "1.4": (
        "a case says what it teaches, its diagnoses with their codes, its origin and its licence",
        "a polyline that is a planned incision has a depth",
        "a case says how much each of its warnings matters",
    ),
    "1.5": (
        "a label that is a septum grown between two cavities says which two, and its triangles are of a kind of their "
        "own",
    ),
}
"""Minor version of the bundle's format -> what it added."""


def bundle_changes(old: str, new: str) -> tuple[tuple[str, str], ...]:
    """What each minor version after ``old``, up to ``new``, added: (version, sentence); both as ``x.y``."""

    def number(version: str) -> tuple[int, ...]:
        return tuple(int(part) for part in version.split("."))

    between = sorted((v for v in BUNDLE_CHANGES if number(old) < number(v) <= number(new)), key=number)
    return tuple((version, sentence) for version in between for sentence in BUNDLE_CHANGES[version])
