"""Locking a recipe: every setting written down, so that no later default changes a case silently.

A setting that a recipe leaves out has a default, or a rule that finds it from the scan. :func:`resolve_recipe` applies
both, for a build as for a lock, so the two cannot differ.
"""

from __future__ import annotations

import hashlib
import os
from collections.abc import Iterator
from pathlib import Path

from heartcase import __version__
from heartcase.pipeline.case_id import made_up_case_id
from heartcase.pipeline.cautions import anatomy
from heartcase.pipeline.data import Scan
from heartcase.pipeline.runner import STAGE_VERSIONS
from heartcase.pipeline.stages import region_of_scan
from heartcase.schemas.errors import Problem, RecipeError
from heartcase.schemas.files import sha256_of_file
from heartcase.schemas.lock import RecipeLock, defaulted_settings, settings_of, unset_settings, without_settings
from heartcase.schemas.recipe import Part, Recipe, parse_recipe
from heartcase.schemas.toml import toml_text, toml_value

__all__ = [
    "check_lock",
    "lock_recipe",
    "recipe_text",
    "resolve_recipe",
    "setting_changes",
    "stage_changes",
    "unlocked_recipe",
]

DETACHED_SUFFIXES = (".nhdr", ".mhd")
"""Headers whose values are in another file."""


def resolve_recipe(recipe: Recipe, scan: Scan) -> Recipe:
    """The recipe with every setting filled in that a rule finds from the scan or from other settings.

    Parameters
    ----------
    recipe
        Any recipe; a resolved one comes back the same.
    scan
        The scan's region of interest: see :func:`heartcase.pipeline.stages.region_of_scan`.
    """
    from heartcase.pipeline.filter import resolve_filter
    from heartcase.pipeline.grid import resolve_grid
    from heartcase.pipeline.walls import resolve_walls

    return recipe.model_copy(
        update={
            "case_id": recipe.case_id or made_up_case_id(recipe.name, scan.values_sha256),
            "labels": recipe.table.labels,
            "filter": resolve_filter(recipe.filter, scan.geometry),
            "walls": resolve_walls(recipe.walls, scan.geometry, recipe.table),
            "grid": resolve_grid(recipe.grid),
        }
    )


def lock_recipe(recipe: Recipe, *, directory: Path, out: Path) -> Recipe:
    """Fill in everything that a recipe leaves out, and write down what it was locked with.

    Parameters
    ----------
    recipe
        The recipe; a locked one is locked anew.
    directory
        Where its relative paths start.
    out
        Where those of the locked recipe start.

    Raises
    ------
    HeartcaseError
        The scan or a marker file is not there or cannot be read.
    """
    missing = recipe.missing_files(directory)
    if missing:
        raise RecipeError(missing)
    scan = region_of_scan(recipe, directory)
    resolved = resolve_recipe(recipe, scan)
    kept = recipe.lock.defaulted if recipe.lock else ()
    if "labels" in recipe.model_fields_set:
        # The places below count labels as the resolved table has them.
        recipe = recipe.model_copy(update={"labels": recipe.table.labels})
    defaulted = (*kept, *(place for place in _defaulted(recipe) if place not in kept))
    lock = RecipeLock(
        software_version=__version__,
        stages=STAGE_VERSIONS,
        scan_sha256=scan.values_sha256,
        markers_sha256=tuple(_file_sha256(directory / marker.path) for marker in recipe.markers),
        segmentation_sha256=_segmentation_sha256(recipe, directory),
        defaulted=defaulted,
        unset=_but_the_lock(unset_settings(resolved)),
    )
    locked = resolved.model_copy(update={"lock": lock})
    if directory.resolve() != out.resolve():
        locked = _with_paths_from(locked, directory, out)
    return parse_recipe(recipe_text(locked))


def recipe_text(recipe: Recipe) -> str:
    """A recipe as TOML, every setting stated; settings without a value are left out."""
    return toml_text(recipe.model_dump(mode="json", exclude_none=True))


def unlocked_recipe(recipe: Recipe) -> Recipe:
    """The recipe before it was locked: what the lock filled in is left to the defaults and rules of this version.

    Raises
    ------
    RecipeError
        Without them it is no recipe any more: somebody edited the lock.
    """
    places = {"lock", *(recipe.lock.defaulted if recipe.lock else ())}
    return parse_recipe(toml_text(without_settings(recipe.model_dump(mode="json", exclude_none=True), places)))


def setting_changes(locked: Recipe, today: Recipe) -> tuple[Problem, ...]:
    """Settings that a lock holds at one value and that would take another today, each with both values.

    Parameters
    ----------
    locked
        A locked recipe.
    today
        The same recipe unlocked; where it is not resolved, what a rule would find is left out.
    """
    then, now = dict(settings_of(locked)), dict(settings_of(today))
    is_resolved = today.case_id is not None
    changes = []
    for place in (*then, *(place for place in now if place not in then)):
        old, new = then.get(place), now.get(place)
        is_left_to_a_rule = new is None and not is_resolved
        if old != new and place.partition(".")[0] != "lock" and not is_left_to_a_rule:
            said = ["nothing" if value is None else toml_value(value) for value in (old, new)]
            changes.append(Problem(place, f"{said[0]} in the lock, {said[1]} today"))
    return tuple(changes)


def stage_changes(versions: dict[str, int]) -> dict[str, tuple[int, int | None]]:
    """Stages whose version differs: name -> (the version then, the version now or None where there is none)."""
    return {
        stage: (version, STAGE_VERSIONS.get(stage))
        for stage, version in versions.items()
        if STAGE_VERSIONS.get(stage) != version
    }


def check_lock(recipe: Recipe, directory: Path, scan: Scan, *, accept_inputs: bool = False) -> tuple[str, ...]:
    """Compare a locked recipe with the software, the scan and the files that it is built with.

    Parameters
    ----------
    recipe
        The recipe; nothing is said about one that is not locked.
    directory
        Where its relative paths start.
    scan
        The scan's region of interest.
    accept_inputs
        Only warn where the scan or a file is another one than when the recipe was locked.

    Returns
    -------
    tuple of str
        Warnings: stages whose version differs, settings that the lock does not have, and inputs that were accepted.

    Raises
    ------
    RecipeError
        The scan, a marker file or the segmentation is another one.
    """
    if recipe.lock is None:
        return ()
    differing = tuple(_differing_inputs(recipe, recipe.lock, directory, scan))
    if differing and not accept_inputs:
        remedy = "put back the one it was locked with, lock the recipe again, or build with --accept-inputs"
        raise RecipeError(Problem(problem.place, f"{problem.message}: {remedy}") for problem in differing)
    warnings: list[str] = []
    changed = {stage: pair for stage, pair in stage_changes(recipe.lock.stages).items() if _is_used(stage, recipe)}
    if changed:
        then = ", ".join(f"{stage} {old}" for stage, (old, _) in changed.items())
        now = ", ".join(f"{stage} {'is gone' if new is None else new}" for stage, (_, new) in changed.items())
        warnings.append(
            anatomy(
                f"the recipe was locked with other stage versions ({then}; now {now}): the case may differ from the "
                f"one that was locked; heartcase {recipe.lock.software_version} has them"
            )
        )
    values = dict(settings_of(recipe))
    for place in _defaulted(recipe):
        stated = f"the default, {toml_value(values[place])}" if values.get(place) is not None else "the default"
        warnings.append(f"the lock does not have {place}, which takes {stated}: lock the recipe again to keep it")
    warnings += [anatomy(f"{problem.place}: {problem.message}") for problem in differing]
    return tuple(warnings)


def _defaulted(recipe: Recipe) -> tuple[str, ...]:
    """Settings that the recipe does not state."""
    return _but_the_lock(defaulted_settings(recipe))


def _but_the_lock(places: tuple[str, ...]) -> tuple[str, ...]:
    return tuple(place for place in places if place.partition(".")[0] != "lock")


def _is_used(stage: str, recipe: Recipe) -> bool:
    if stage == "markers":
        return recipe.segment.method == "watershed"
    if stage == "edit":
        return bool(recipe.edits)
    return stage not in ("surface", "map") or Part.SURFACE in recipe.parts


def _differing_inputs(recipe: Recipe, lock: RecipeLock, directory: Path, scan: Scan) -> Iterator[Problem]:
    if scan.values_sha256 != lock.scan_sha256:
        then, now = lock.stages.get("read"), STAGE_VERSIONS["read"]
        reader = f" (the reader went from version {then} to {now}, which may be why)" if then != now else ""
        yield Problem("scan", f"its values or its place are not those that the recipe was locked with{reader}")
    if len(recipe.markers) != len(lock.markers_sha256):
        yield Problem(
            "markers", f"there are {len(recipe.markers)} files, not the {len(lock.markers_sha256)} at locking"
        )
    for n, (marker, sha256) in enumerate(zip(recipe.markers, lock.markers_sha256, strict=False), start=1):
        if (directory / marker.path).exists() and _file_sha256(directory / marker.path) != sha256:
            yield Problem(f"markers[{n}]", "the file is not the one that the recipe was locked with")
    if not recipe.missing_files(directory) and _segmentation_sha256(recipe, directory) != lock.segmentation_sha256:
        yield Problem("segment.file", "the segmentation is not the one that the recipe was locked with")


def _segmentation_sha256(recipe: Recipe, directory: Path) -> str | None:
    is_read = recipe.segment.method == "labels" and recipe.segment.file is not None
    return _file_sha256(directory / str(recipe.segment.file)) if is_read else None


def _file_sha256(path: Path) -> str:
    """Hash of a file, or of all files of a folder whatever they are called."""
    if path.is_dir():
        digests = sorted(sha256_of_file(file) for file in path.rglob("*") if file.is_file())
        return hashlib.sha256("".join(digests).encode()).hexdigest()
    if path.suffix.lower() in DETACHED_SUFFIXES:
        from heartcase.pipeline.read import read_labels

        return hashlib.sha256(path.read_bytes() + read_labels(path).values.tobytes()).hexdigest()
    return sha256_of_file(path)


def _with_paths_from(recipe: Recipe, directory: Path, out: Path) -> Recipe:
    """The recipe with its relative paths starting at another directory."""

    def moved(path: str) -> str:
        if Path(path).is_absolute():
            return path
        try:
            return Path(os.path.relpath(directory.resolve() / path, out.resolve())).as_posix()
        except ValueError:  # another drive
            return (directory.resolve() / path).as_posix()

    update = {
        "scan": recipe.scan.model_copy(update={"path": moved(recipe.scan.path)}),
        "markers": tuple(one.model_copy(update={"path": moved(one.path)}) for one in recipe.markers),
    }
    if recipe.segment.file is not None:
        update["segment"] = recipe.segment.model_copy(update={"file": moved(recipe.segment.file)})
    return recipe.model_copy(update=update)
