"""Whether a folder holds all that the studio needs on Windows, by what can be seen without running it."""

from __future__ import annotations

import ast
import base64
import csv
import hashlib
import importlib.metadata
import sys
from collections.abc import Iterator
from pathlib import Path

from packaging.requirements import Requirement
from packaging.utils import canonicalize_name

__all__ = ["PATH_LENGTH_MAX", "problems_of"]

PATH_LENGTH_MAX = 180
"""Longest path inside the folder: Windows refuses more than 260 characters, with the user's own folder before it."""
_OTHER_PLATFORMS = (".so", ".dylib")
_ENVIRONMENT = {
    "os_name": "nt",
    "sys_platform": "win32",
    "platform_system": "Windows",
    "platform_machine": "AMD64",
    "platform_python_implementation": "CPython",
    "implementation_name": "cpython",
}


def problems_of(packages: Path, *, python_version: str, wanted: Requirement) -> list[str]:
    """What is missing or wrong in a folder of installed packages; empty where nothing is.

    Looked at: every distribution that ``wanted`` needs on Windows is there in a version that fits; every file that a
    distribution lists is there, with the hash that it states; compiled modules are those of Windows and of this Python;
    every import at the top of a heartcase module finds a module; no two names differ in case alone, and none is too
    long.

    Parameters
    ----------
    packages
        The ``site-packages`` of the folder.
    python_version
        As ``3.12``.
    wanted
        What was asked for, as ``heartcase[studio]``.
    """
    every = importlib.metadata.distributions(path=[str(packages)])
    found = {str(canonicalize_name(one.name)): one for one in sorted(every, key=lambda one: one.name)}
    problems = [*_missing_distributions(found, wanted, python_version)]
    for one in found.values():
        problems += _wrong_files(packages, one)
    files = sorted(path.relative_to(packages) for path in packages.rglob("*") if path.is_file())
    problems += _wrong_names(files)
    problems += _foreign_modules(files, python_version)
    problems += _missing_imports(packages)
    return problems


def _missing_distributions(
    found: dict[str, importlib.metadata.Distribution], wanted: Requirement, python_version: str
) -> Iterator[str]:
    environment = {**_ENVIRONMENT, "python_version": python_version, "python_full_version": f"{python_version}.0"}
    waiting, seen = [(wanted, "the studio")], set()
    while waiting:
        requirement, who = waiting.pop()
        name = canonicalize_name(requirement.name)
        key = (name, frozenset(requirement.extras))
        one = found.get(name)
        if one is None:
            yield f"{requirement.name} is missing: {who} needs it"
            continue
        if not requirement.specifier.contains(one.version, prereleases=True):
            yield f"{requirement.name} is {one.version}: {who} needs {requirement.specifier}"
        if key in seen:
            continue
        seen.add(key)
        for text in one.requires or ():
            needed = Requirement(text)
            extras = requirement.extras or {""}
            if needed.marker is None or any(needed.marker.evaluate(environment | {"extra": e}) for e in extras | {""}):
                waiting.append((needed, requirement.name))


def _wrong_files(packages: Path, distribution: importlib.metadata.Distribution) -> Iterator[str]:
    record = distribution.read_text("RECORD")
    if record is None:
        yield f"{distribution.name} has no list of its files (RECORD)"
        return
    for name, stated, _ in csv.reader(record.splitlines()):
        path = packages / name
        if name.startswith("../") or not stated:
            continue
        if not path.is_file():
            yield f"{name} of {distribution.name} is missing"
            continue
        kind, _, digest = stated.partition("=")
        seen = base64.urlsafe_b64encode(hashlib.new(kind, path.read_bytes()).digest()).rstrip(b"=").decode()
        if seen != digest:
            yield f"{name} of {distribution.name} is not the file that its list states"


def _wrong_names(files: list[Path]) -> Iterator[str]:
    seen: dict[str, Path] = {}
    for path in files:
        other = seen.setdefault(path.as_posix().lower(), path)
        if other != path:
            yield f"{path} and {other} are one file on Windows"
        if len(path.as_posix()) > PATH_LENGTH_MAX:
            yield f"{path} is longer than {PATH_LENGTH_MAX} characters"


def _foreign_modules(files: list[Path], python_version: str) -> Iterator[str]:
    tags = (f"cp{python_version.replace('.', '')}-win_amd64", "abi3", "")
    for path in files:
        name = path.name
        if name.endswith(_OTHER_PLATFORMS):
            yield f"{path} is compiled for another system"
        elif name.endswith(".pyd"):
            # module.pyd, or module.TAG.pyd
            tag = name.removesuffix(".pyd").partition(".")[2]
            if tag not in tags:
                yield f"{path} is compiled for another Python ({tag})"


def _missing_imports(packages: Path) -> Iterator[str]:
    """Imports at the top of heartcase's modules; those inside functions may belong to extras that are not here."""
    top = {path.name.partition(".")[0] for path in packages.iterdir()}
    for path in sorted((packages / "heartcase").rglob("*.py")):
        tree = ast.parse(path.read_text(encoding="utf-8"))
        for node in tree.body:
            names = []
            if isinstance(node, ast.Import):
                names = [alias.name for alias in node.names]
            elif isinstance(node, ast.ImportFrom) and node.level == 0 and node.module:
                names = [node.module]
            for name in names:
                first = name.partition(".")[0]
                is_there = first in sys.stdlib_module_names or first in top
                if not is_there or (first == "heartcase" and not _is_module(packages, name)):
                    yield f"{path.relative_to(packages)} imports {name}, which is not there"


def _is_module(packages: Path, name: str) -> bool:
    path = packages.joinpath(*name.split("."))
    return path.with_suffix(".py").is_file() or (path / "__init__.py").is_file()
