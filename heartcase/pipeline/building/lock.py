"""Locking a recipe: every setting is written down, so that no later default changes a case silently.

A setting that a recipe leaves out has a default, or a rule that finds it from the scan. :func:`resolve_recipe` applies
both, for a build as for a lock, so the two cannot differ.
"""

from __future__ import annotations

import hashlib
import json
import os
import tempfile
from collections.abc import Iterator
from pathlib import Path

from heartcase import __version__
from heartcase.pipeline.data import Scan
from heartcase.pipeline.formats.volumes.raw_volume import placed
from heartcase.pipeline.stages import table
from heartcase.pipeline.stages.read import region_of_scan
from heartcase.pipeline.stages.resolve import resolve_recipe
from heartcase.pipeline.stages.table import stage_versions
from heartcase.pipeline.warnings import CaseWarning, anatomy
from heartcase.schemas.errors import HeartcaseError, MarkerError, Problem, RecipeError
from heartcase.schemas.files import sha256_of_file
from heartcase.schemas.recipe.lock import RecipeLock, defaulted_settings, settings_of, unset_settings, without_settings
from heartcase.schemas.recipe.recipe import Recipe, parse_recipe
from heartcase.schemas.recipe.settings import EndMarker
from heartcase.schemas.toml import toml_text, toml_value

__all__ = [
    "changed_files",
    "check_lock",
    "lock_recipe",
    "recipe_text",
    "setting_changes",
    "stage_changes",
    "unlocked_recipe",
]


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
    found_count = recipe.lock.found_end_count if recipe.lock else None
    if recipe.walls_to_grow.find_ends:
        found = _found_ends(recipe, directory)
        resolved, found_count = resolved.model_copy(update={"ends": (*recipe.ends, *found)}), len(found)
    if "labels" in recipe.model_fields_set:
        # The places below count labels as the resolved table has them.
        recipe = recipe.model_copy(update={"labels": recipe.table.labels})
    defaulted = (*kept, *(place for place in _defaulted(recipe) if place not in kept))
    finished = _segmentation_file(recipe, directory)
    lock = RecipeLock(
        software_version=__version__,
        stages=stage_versions(),
        scan_sha256=scan.values_sha256,
        markers_sha256=tuple(
            _input_sha256(f"markers[{n}]", directory / marker.path) for n, marker in enumerate(recipe.markers, start=1)
        ),
        segmentation_sha256=None if finished is None else _input_sha256("segment.file", finished),
        found_end_count=found_count,
        defaulted=defaulted,
        unset=_but_the_lock(unset_settings(resolved)),
    )
    locked: Recipe = resolved.model_copy(update={"lock": lock})
    if directory.resolve() != out.resolve():
        locked = _with_paths_from(locked, directory, out)
    locked = parse_recipe(recipe_text(locked))
    signed = lock.model_copy(update={"settings_sha256": _settings_sha256(locked)})
    return parse_recipe(recipe_text(locked.model_copy(update={"lock": signed})))


def _found_ends(recipe: Recipe, directory: Path) -> tuple[EndMarker, ...]:
    """The vessel ends that a build of the recipe would find."""
    from heartcase.pipeline.building.recipe_ends import ends_at_locking
    from heartcase.pipeline.vessel_ends.discs import end_marker

    with tempfile.TemporaryDirectory() as cache:
        return tuple(end_marker(end) for end in ends_at_locking(recipe, directory, Path(cache)))


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
    count = recipe.lock.found_end_count if recipe.lock else None
    stated = recipe.model_copy(update={"ends": recipe.ends[: len(recipe.ends) - (count or 0)]})
    return parse_recipe(toml_text(without_settings(stated.model_dump(mode="json", exclude_none=True), places)))


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
        stage: (version, stage_versions().get(stage))
        for stage, version in versions.items()
        if stage_versions().get(stage) != version
    }


def check_lock(recipe: Recipe, directory: Path, scan: Scan, *, accept_inputs: bool = False) -> tuple[CaseWarning, ...]:
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
    tuple of CaseWarning
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
    warnings: list[CaseWarning] = []
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
    if recipe.lock.settings_sha256 not in (None, _settings_sha256(recipe)):
        warnings.append(anatomy("the locked recipe was edited after it was locked: lock it again to keep the change"))
    values = dict(settings_of(recipe))
    for place in _defaulted(recipe):
        stated = f"the default, {toml_value(values[place])}" if values.get(place) is not None else "the default"
        warnings.append(
            CaseWarning(f"the lock does not have {place}, which takes {stated}: lock the recipe again to keep it")
        )
    warnings += [anatomy(f"{problem.place}: {problem.message}") for problem in differing]
    return tuple(warnings)


def _defaulted(recipe: Recipe) -> tuple[str, ...]:
    """Settings that the recipe does not state."""
    return _but_the_lock(defaulted_settings(recipe))


def _but_the_lock(places: tuple[str, ...]) -> tuple[str, ...]:
    return tuple(place for place in places if place.partition(".")[0] != "lock")


def _is_used(stage: str, recipe: Recipe) -> bool:
    """Whether a build of the recipe runs the stage; one that is gone was run."""
    known = {one.name: one for one in table.STAGES}.get(stage)
    return known is None or (known.is_part(recipe) and known.has_work(recipe))


def _differing_inputs(recipe: Recipe, lock: RecipeLock, directory: Path, scan: Scan) -> Iterator[Problem]:
    """The scan's region of interest and the files that are not those of the lock."""
    if scan.values_sha256 != lock.scan_sha256:
        then, now = lock.stages.get("read"), stage_versions()["read"]
        reader = f" (the reader went from version {then} to {now}, which may be why)" if then != now else ""
        yield Problem("scan", f"its values or its place are not those that the recipe was locked with{reader}")
    yield from changed_files(recipe, directory)


def changed_files(recipe: Recipe, directory: Path) -> Iterator[Problem]:
    """Marker files and the segmentation of a locked recipe that are not those that it was locked with.

    Parameters
    ----------
    recipe
        The recipe; one that is not locked has none.
    directory
        Where its relative paths start.

    Yields
    ------
    Problem
        For each that is another one or is damaged. What is not there is left to :meth:`Recipe.missing_files`.
    """
    lock = recipe.lock
    if lock is None:
        return
    if len(recipe.markers) != len(lock.markers_sha256):
        yield Problem(
            "markers", f"there are {len(recipe.markers)} files, not the {len(lock.markers_sha256)} at locking"
        )
    for n, (marker, sha256) in enumerate(zip(recipe.markers, lock.markers_sha256, strict=False), start=1):
        yield from _difference(f"markers[{n}]", "the file", directory / marker.path, sha256)
    finished = _segmentation_file(recipe, directory)
    yield from _difference("segment.file", "the segmentation", finished, lock.segmentation_sha256)


def _difference(place: str, what: str, path: Path | None, sha256: str | None) -> Iterator[Problem]:
    if path is not None and not path.exists():
        return
    try:
        today = None if path is None else _input_sha256(place, path)
    except MarkerError:
        yield Problem(place, f"{what}, or the data file that its header names, is missing or damaged")
        return
    if today != sha256:
        yield Problem(place, f"{what} is not the one that the recipe was locked with")


def _settings_sha256(recipe: Recipe) -> str:
    """Hash of what the file states, so that settings that a later version adds do not count as edited."""
    stated = recipe.model_dump(mode="json", exclude={"lock"}, exclude_unset=True, exclude_none=True)
    return hashlib.sha256(toml_text(stated).encode()).hexdigest()


def _segmentation_file(recipe: Recipe, directory: Path) -> Path | None:
    """The finished segmentation, where the recipe takes one."""
    file = recipe.segment.finished_file
    return None if file is None else directory / file


def _input_sha256(place: str, path: Path) -> str:
    """Hash of all that is read when this file or folder is: MarkerError where it cannot be told what that is."""
    from heartcase.pipeline.formats.labels.stl_parts import holds_parts
    from heartcase.pipeline.formats.read_scan import detached_data_file

    if holds_parts(path):
        # a part is called by its file's name, so parts that swap their names are other parts
        parts = [file for file in path.iterdir() if file.suffix.lower() == ".stl" and file.is_file()]
        return _sha256_of_all(sorted((file.name, sha256_of_file(file)) for file in parts))
    if path.is_dir():
        return _sha256_of_all(sorted(("", sha256_of_file(file)) for file in path.rglob("*") if file.is_file()))
    try:
        data = detached_data_file(path)
    except HeartcaseError as error:
        raise placed(error, place, MarkerError) from None
    header = sha256_of_file(path)
    return header if data is None else _sha256_of_all([("", header), ("", sha256_of_file(data))])


def _sha256_of_all(named: list[tuple[str, str]]) -> str:
    return hashlib.sha256(json.dumps(named).encode()).hexdigest()


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
