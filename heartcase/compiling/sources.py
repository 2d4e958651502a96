"""Which source a compiled kernel came from: its module, and all of heartcase that this module imports.

numba compiles functions and constants of other modules into a kernel, and an intrinsic emits what its module says. So
the stamp of a kernel covers every module that its own one reaches through imports; the others do not matter to it.
"""

from __future__ import annotations

import hashlib
import os
import re
from functools import cache
from importlib.util import resolve_name
from pathlib import Path

__all__ = ["imported_modules", "source_stamp"]

_ROOT = Path(__file__).parents[1]
_IMPORT = re.compile(
    r"^[ \t]*(?:from[ \t]+([.\w]+)[ \t]+import[ \t]+(\([^)]*\)|[^\n]*)|import[ \t]+([^\n]*))", re.MULTILINE
)
_NAME = re.compile(r"[.\w]+")


@cache
def source_stamp(path: str) -> bytes:
    """Digest of a source file and of all modules of its package that it reaches through imports.

    Parameters
    ----------
    path
        The file. One outside the package is taken with what it imports from the package.

    Returns
    -------
    bytes
        SHA-256, the same whatever folder the package lies in.
    """
    file = Path(path).resolve()
    inside = file.relative_to(_ROOT.parent) if file.is_relative_to(_ROOT) else Path(file.name)
    own = _read(str(file), ".".join(inside.with_suffix("").parts))
    reached = {"": own}
    waiting = list(own[1])
    while waiting:
        name = waiting.pop()
        if name not in reached:
            reached[name] = _read(_files()[name], name)
            waiting += reached[name][1]
    digest = hashlib.sha256()
    for name in sorted(reached):
        digest.update(name.encode() + b"\0" + reached[name][0])
    return digest.digest()


def imported_modules(source: str, module: str) -> tuple[str, ...]:
    """Names of heartcase's modules that a source imports anywhere; sorted.

    Parameters
    ----------
    source
        Python source.
    module
        Its own dotted name, for relative imports.

    Returns
    -------
    tuple
        Also members of modules, by dotted name: which of them are modules only the files can tell.
    """
    package = module.rpartition(".")[0]
    found: set[str] = set()
    for origin, members, plain in _IMPORT.findall(source):
        if _ROOT.name not in (plain or origin) and not origin.startswith("."):
            continue
        if plain:
            found |= {one.split()[0] for one in plain.split(",") if one.split()}
            continue
        base = resolve_name(origin, package) if origin.startswith(".") and package else origin
        found.add(base)
        found |= {f"{base}.{name}" for name in _NAME.findall(members)}
    return tuple(sorted(name for name in found if name.split(".")[0] == _ROOT.name))


@cache
def _files() -> dict[str, str]:
    """The package's modules: name -> file."""
    found: dict[str, str] = {}
    folders = [(str(_ROOT), _ROOT.name)]
    while folders:
        folder, name = folders.pop()
        with os.scandir(folder) as entries:
            for entry in entries:
                stem, kind = os.path.splitext(entry.name)
                if entry.name == "__init__.py":
                    found.setdefault(name, entry.path)
                elif kind == ".py":
                    found[f"{name}.{stem}"] = entry.path
                elif not kind and stem.isidentifier() and entry.is_dir(follow_symlinks=False):
                    folders.append((entry.path, f"{name}.{stem}"))
    return found


@cache
def _read(file: str, module: str) -> tuple[bytes, tuple[str, ...]]:
    """Digest of a module's file, and which modules it imports; read once, as Python itself reads a module once."""
    with open(file, "rb") as opened:
        content = opened.read()
    is_package = os.path.basename(file) == "__init__.py" and not module.endswith(".__init__")
    names = imported_modules(content.decode(), f"{module}.__init__" if is_package else module)
    return hashlib.sha256(content).digest(), tuple(name for name in names if name in _files())
