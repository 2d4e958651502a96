"""What a library holds and what of it is to be built: recipes, their stamps, and the records of earlier builds.

A stamp is the hash of the recipe's text, of size and time of every file that it reads, and of the versions of software,
stages and phantom. Where it is that of the record, and the case's files are those that the build wrote, nothing is
opened. A stamp that changed says only that the case has to be looked at: what is computed again is decided by hashes
of contents, in the cache (:mod:`heartcase.pipeline.artifacts.cache`).
"""

from __future__ import annotations

import contextlib
import hashlib
import json
import os
import re
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

from heartcase import __version__
from heartcase.phantom.version import PHANTOM_VERSION
from heartcase.pipeline.stages.table import stage_versions
from heartcase.schemas.bundle.format import WarningGrade
from heartcase.schemas.errors import HeartcaseError, MissingPathError, Problem, RecipeError, UsageError
from heartcase.schemas.files import atomic_write, is_there
from heartcase.schemas.recipe.recipe import Recipe, parse_recipe, read_recipe_text
from heartcase.schemas.scripts.incision_plans import IncisionPlans
from heartcase.schemas.scripts.script import SimulationScript

__all__ = [
    "CaseRecord",
    "LibraryCase",
    "files_written",
    "is_up_to_date",
    "plan_library",
    "read_record",
    "skipped_words",
    "write_record",
]

RECORDS = ".heartcase-library"
"""Folder of the records, beside the cases."""
RECORD_VERSION = 2
Known = dict[str, list[str]]
"""Hash of a recipe's text -> name of its case, then the files that it reads."""
_HEADERS = (".mhd", ".nhdr", ".hdr", ".img")


@dataclass(frozen=True)
class LibraryCase:
    """A recipe of a library."""

    name: str
    """Name of its case; of the file where it has none."""
    recipe: Path
    """Its file."""
    stamp: str
    """What it would be built from, 64 hexadecimal digits; empty where it cannot be built."""
    problems: tuple[Problem, ...] = ()
    """Why it cannot be built."""


@dataclass(frozen=True)
class CaseRecord:
    """What became of a case when it was last built."""

    name: str
    """Name of the case."""
    stamp: str
    """What it was built from."""
    problems: tuple[tuple[str, str], ...] = ()
    """Place and message of what kept it from being built; empty where it was."""
    seconds: float = 0.0
    """How long it took, s."""
    stage_seconds: dict[str, float] | None = None
    """Stage -> seconds that it took, now or when its output was computed; ``scan`` where a synthetic one was made."""
    reused: tuple[str, ...] = ()
    """Stages whose output was in the cache."""
    warnings: tuple[str, ...] = ()
    """What the user must know of the case."""
    warning_grades: tuple[WarningGrade, ...] = ()
    """How much each matters: ``anatomy``, ``look`` or ``note``, as in the manifest; empty where it is not known."""
    memory_peak_mb: float | None = None
    """Most memory that the worker held while it built, 10^6 bytes; None where the system does not say."""
    files: tuple[tuple[str, int, int], ...] = ()
    """Path below the output folder, size in bytes and time of last change in ns of what was written."""

    def timed(self, seconds: float, memory_peak_mb: float | None) -> CaseRecord:
        """The record with what building it took.

        Parameters
        ----------
        seconds
            How long it took, s.
        memory_peak_mb
            Most memory that the worker held, 10^6 bytes; None where the system does not say.
        """
        return replace(self, seconds=round(seconds, 2), memory_peak_mb=memory_peak_mb)


def plan_library(directory: Path | str, *, skip: Callable[[str], None] = lambda name: None) -> tuple[LibraryCase, ...]:
    """The recipes below a folder, by name; those that cannot be built say why.

    TOML files that are no recipes, and what lies in hidden folders, are passed over. Name and inputs of sound recipes
    are kept in the user's own cache folder and not beside the cases, as a path may be named after a patient.

    Parameters
    ----------
    directory
        The folder.
    skip
        Is told each TOML file that has no ``heartcase_recipe`` and is no script and no plan either, by its path below
        the folder: a recipe in which that key is misspelt is one.

    Raises
    ------
    UsageError
        There is no such folder, or no recipe in it.
    """
    directory = Path(directory)
    if not (is_there(directory) and directory.is_dir()):
        raise MissingPathError("there is no such folder: give the one that holds the recipes", place="DIR")
    kept = _known_file(directory)
    known = _read_known(kept)
    sound: Known = {}
    skipped: list[str] = []
    found = (_planned(path, directory, known, sound, skipped) for path in _toml_files(directory))
    cases = [case for case in found if case is not None]
    if sound != known:
        with contextlib.suppress(OSError):
            _write_whole(kept, {"software": __version__, "recipes": sound})
    for name in skipped:
        skip(name)
    if not cases:
        also = f" ({skipped_words(skipped)})" if skipped else ""
        raise UsageError(
            f"no recipe was found in this folder or below{also}: write one with  heartcase new SCAN", place="DIR"
        )
    # Upper and lower case make one folder on Windows and macOS.
    count = Counter(case.name.casefold() for case in cases)

    def one_of_several(case: LibraryCase) -> LibraryCase:
        same = [one for one in cases if one.name.casefold() == case.name.casefold()]
        files = sorted(one.recipe.relative_to(directory).as_posix() for one in same)
        but = ", but for upper and lower case" if len({one.name for one in same}) > 1 else ""
        message = f"{len(files)} recipes have this name{but} ({', '.join(files)}): give each its own"
        return replace(case, stamp="", problems=(*case.problems, Problem("name", message)))

    named = (one_of_several(case) if count[case.name.casefold()] > 1 else case for case in cases)
    return tuple(sorted(named, key=lambda case: (case.name, case.recipe)))


def skipped_words(names: Sequence[str]) -> str:
    """Which TOML files were skipped and why, in one line."""
    return f"skipped: {', '.join(names)} ({'they have' if len(names) > 1 else 'it has'} no heartcase_recipe = 1)"


def is_up_to_date(case: LibraryCase, out: Path) -> bool:
    """Whether a case was built from what it would be built from now, and lies there as it was written."""
    record = read_record(case.name, out)
    if record is None or record.problems or not case.stamp or record.stamp != case.stamp:
        return False
    return bool(record.files) and record.files == files_written(out, [name for name, _, _ in record.files])


def files_written(out: Path, names: list[str]) -> tuple[tuple[str, int, int], ...]:
    """Size and time of files below a folder, by path; those that are not there are left out."""
    return tuple((name, *stat) for name in sorted(names) if (stat := _size_and_time(out / name)) is not None)


def read_record(name: str, out: Path) -> CaseRecord | None:
    """The record of a case; None where there is none that can be read."""
    try:
        data = json.loads(_record_path(name, out).read_text(encoding="utf-8"))
        if data.pop("record_version") != RECORD_VERSION:
            return None
        for field in ("problems", "files"):
            data[field] = tuple(tuple(row) for row in data[field])
        for field in ("reused", "warnings"):
            data[field] = tuple(data.get(field, ()))
        data["warning_grades"] = tuple(WarningGrade(one) for one in data.get("warning_grades", ()))
        return CaseRecord(**data)
    except (OSError, ValueError, TypeError, KeyError, AttributeError):
        return None


def write_record(record: CaseRecord, out: Path) -> None:
    """Write the record of a case, whole or not at all."""
    _write_whole(_record_path(record.name, out), {"record_version": RECORD_VERSION, **asdict(record)})


def _write_whole(path: Path, data: dict[str, Any]) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    atomic_write(path, json.dumps(data, indent=1).encode())


def _record_path(name: str, out: Path) -> Path:
    return out / RECORDS / f"{name}.json"


def _toml_files(directory: Path) -> Iterator[Path]:
    for folder, below, files in os.walk(directory):
        below[:] = sorted(name for name in below if not name.startswith(".") and not name.endswith(".case"))
        yield from (Path(folder) / name for name in sorted(files) if name.endswith(".toml"))


def _planned(path: Path, directory: Path, known: Known, sound: Known, skipped: list[str]) -> LibraryCase | None:
    fallback = path.relative_to(directory).with_suffix("").as_posix().replace("/", "-")
    try:
        text = read_recipe_text(path)
        if "heartcase_recipe" not in text:
            if not _is_script_or_plans(text):
                skipped.append(path.relative_to(directory).as_posix())
            return None
        sha256 = hashlib.sha256(text.encode()).hexdigest()
        row = known.get(sha256)
        if row is None or not all((path.parent / one).exists() for one in row[1:]):
            recipe = parse_recipe(text)
            missing = recipe.missing_files(path.parent)
            if missing:
                raise RecipeError(missing)
            row = [recipe.name, *(one for _, one in recipe.input_files)]
        sound[sha256] = row
        name, *inputs = row
        return LibraryCase(name, path, _stamp(sha256, inputs, path.parent))
    except HeartcaseError as error:
        return LibraryCase(fallback, path, "", error.problems)
    except OSError as error:
        message = f"it cannot be read: {(error.strerror or 'the system gives no reason').lower()}"
        return LibraryCase(fallback, path, "", (Problem("recipe", message),))


def _is_script_or_plans(text: str) -> bool:
    """Whether a TOML file that is no recipe says as much of what only scripts and plans say as of a recipe."""
    keys = set(re.findall(r"^\s*\[{0,2}\s*(\w+)", text, re.MULTILINE))
    of_recipes, of_others = set(Recipe.model_fields), {*SimulationScript.model_fields, *IncisionPlans.model_fields}
    said = len(keys & (of_others - of_recipes))
    return said > 0 and said >= len(keys & (of_recipes - of_others))


def _known_file(directory: Path) -> Path:
    base = os.environ.get("XDG_CACHE_HOME") or os.environ.get("LOCALAPPDATA") or os.path.expanduser("~/.cache")
    which = hashlib.sha256(os.fsencode(directory.resolve())).hexdigest()[:16]
    return Path(base) / "heartcase" / f"recipes-{which}.json"


def _read_known(path: Path) -> Known:
    """Name and inputs of the recipes that this heartcase found to be sound, by the hash of their text."""
    try:
        data = json.loads(path.read_text(encoding="utf-8"))
        recipes = data["recipes"] if data["software"] == __version__ else {}
        return {str(sha256): [str(one) for one in row] for sha256, row in recipes.items() if row}
    except (OSError, ValueError, TypeError, KeyError, AttributeError):
        return {}


def _stamp(recipe_sha256: str, inputs: list[str], directory: Path) -> str:
    stats = [[path, *_stats_of(directory / path)] for path in inputs]
    from_what: list[Any] = [__version__, stage_versions(), PHANTOM_VERSION, recipe_sha256, stats]
    return hashlib.sha256(json.dumps(from_what, sort_keys=True).encode()).hexdigest()


def _stats_of(path: Path) -> list[Any]:
    """Size and time of a file, or of every file in a folder, by name; a header's data may be in any file beside it."""
    if path.suffix.lower() in _HEADERS:
        return [[file.name, _size_and_time(file)] for file in sorted(path.parent.iterdir()) if file.is_file()]
    if not path.is_dir():
        return [_size_and_time(path)]
    files = (Path(folder) / name for folder, _, names in os.walk(path) for name in names)
    return [[file.relative_to(path).as_posix(), _size_and_time(file)] for file in sorted(files)]


def _size_and_time(path: Path) -> tuple[int, int] | None:
    try:
        status = path.stat()
    except OSError:
        return None
    return status.st_size, status.st_mtime_ns
