"""Checking a case bundle to the last byte: what ``heartcase validate`` does."""

from __future__ import annotations

import re
from collections.abc import Iterable
from dataclasses import replace
from pathlib import Path
from typing import Any

from heartcase.schemas.bundle.containers import labels_problems, render_problems, safetensors_problems
from heartcase.schemas.bundle.format import LEVEL_MAX, MANIFEST_NAME, CaseManifest, FileRole
from heartcase.schemas.bundle.manifest import listed_files, read_manifest, salvaged_manifest, stated
from heartcase.schemas.bundle.reader import OpenBundle, inspect_files, stated_problems, why_no_file
from heartcase.schemas.bundle.surfaces import mapping_problems, picking_problems, surface_problems
from heartcase.schemas.bundle.values import Arrays, figure_problems, grid_problems
from heartcase.schemas.errors import BundleError, Problem
from heartcase.schemas.files import LOCK_NAME, TEMPORARY_PREFIX, is_there, sha256_of_file

__all__ = ["check_bundle"]

_CHECKED_ANYWAY = {"fixed", "cell_label"}
"""Arrays that no wrong value in them can upset the checks against others."""


def check_bundle(path: Path | str) -> tuple[Problem, ...]:
    """Check everything about a case, hashes and values included; returns every problem, none when it is sound.

    Whatever is wrong, the rest is still checked as far as it can be: a manifest with wrong keys by those that are
    right, a part with a wrong array by the others.
    """
    directory = Path(path)
    problems: list[Problem] = []
    manifest: CaseManifest | None
    try:
        manifest = read_manifest(directory)
    except BundleError as error:
        problems += error.problems
        manifest = salvaged_manifest(directory)
    if not is_there(directory):
        return tuple(problems)
    is_salvaged = bool(problems)
    listed = listed_files(directory)
    problems += _hash_problems(directory, listed)
    problems += _stray_problems(directory, {name for name, *_ in listed})
    if manifest is None:
        return tuple(dict.fromkeys(problems))
    bundle, found = inspect_files(directory, manifest)
    if is_salvaged:
        # Entries that are themselves wrong are told of already, and may be of the grid.
        found = [problem for problem in found if problem.place != "files"]
    problems += [*found, *stated_problems(bundle), *figure_problems(manifest)]
    parts, found = _parts(bundle)
    problems += found
    for check in (grid_problems, picking_problems):
        problems += check(manifest, parts)
    for level in range(LEVEL_MAX + 1):
        # The surface's checks know one level: a coarser one is shown to them as if it were the finest.
        at_level = parts | {role: parts.get(role.at(level), {}) for role in (FileRole.SURFACE, FileRole.MAPPING)}
        found = [*surface_problems(manifest, at_level), *mapping_problems(manifest, at_level)]
        if _is_there(bundle, FileRole.RENDER.at(level)):
            found += render_problems(manifest, bundle.path(FileRole.RENDER.at(level)), at_level)
        problems += [_at_level(problem, level) for problem in found]
    for role, layout in bundle.headers.items():
        problems += safetensors_problems(bundle.path(role), role, layout, stated(manifest, "format_version"))
    if _is_there(bundle, FileRole.LABELS):
        problems += labels_problems(manifest, bundle.path(FileRole.LABELS))
    return tuple(dict.fromkeys(problems))


def _at_level(problem: Problem, level: int) -> Problem:
    """A problem of the surface's parts, at the level where it was found."""
    names = problem.place.split(".")
    roles = {role.value: role.at(level).value for role in FileRole if role.level == 0}
    return replace(problem, place=".".join(roles.get(name, name) for name in names))


def _parts(bundle: OpenBundle) -> tuple[dict[FileRole, Arrays], list[Problem]]:
    """The arrays that can be checked against each other, and what is wrong with the values of the others."""
    parts: dict[FileRole, Arrays] = {}
    problems: list[Problem] = []
    for role, layout in bundle.headers.items():
        parts[role] = {}
        for name in layout.arrays:
            array, found = bundle.inspect_array(role, name)
            problems += found
            if (not found or name in _CHECKED_ANYWAY) and f"{role.value}.{name}" not in bundle.misfits:
                parts[role][name] = array
    return parts, problems


def _is_there(bundle: OpenBundle, role: FileRole) -> bool:
    return bundle.has(role) and bundle.path(role).is_file() and not bundle.path(role).is_symlink()


def _hash_problems(directory: Path, listed: list[tuple[str, str, Any, str]]) -> Iterable[Problem]:
    """Of all files that the manifest names, also those of a newer version and those of entries that are wrong."""
    for name, role, _, sha256 in listed:
        file = directory / name
        if (reason := why_no_file(file)) is not None:
            yield Problem(f"files.{role}", reason)
        elif sha256_of_file(file) != sha256:
            yield Problem(f"files.{role}", f"the content of {name} was changed: build the case again")


def _stray_problems(directory: Path, listed: set[str]) -> Iterable[Problem]:
    """Whatever else lies in the folder is passed on with the case, though nobody has checked it; never named."""
    try:
        strays = [
            path
            for path in directory.iterdir()
            if path.name not in {*listed, MANIFEST_NAME, LOCK_NAME} and not _is_leftover(path)
        ]
    except OSError:
        return
    if strays:
        count = f"{len(strays)} file{'s' * (len(strays) > 1)} or folder{'s' * (len(strays) > 1)}"
        yield Problem("files", f"{count} that case.json does not list, hidden ones too, lie in the case: take them out")


def _is_leftover(path: Path) -> bool:
    """What a build that was killed left behind: files not finished, or of the case before, named by their content."""
    if path.is_symlink() or not path.is_file():
        return False
    roles = "|".join(role.value for role in FileRole)
    named = re.fullmatch(rf"(?:{roles})-([0-9a-f]{{16}})\.(?:safetensors|glb|seg\.nrrd)", path.name)
    return path.name.startswith(TEMPORARY_PREFIX) or (named is not None and sha256_of_file(path).startswith(named[1]))
