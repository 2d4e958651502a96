"""Where files may be written: never into the folder of a case, which holds the case's own files and nothing else."""

from __future__ import annotations

import os
from pathlib import Path

from heartcase.schemas.bundle.format import MANIFEST_NAME
from heartcase.schemas.errors import UsageError

__all__ = ["refuse_inside_case"]


def refuse_inside_case(path: Path | str, *, place: str, is_case: bool = False) -> None:
    """Refuse a path that is to be written to where it is the folder of a case, or lies in one at any depth.

    A file more would make the case unsound and end its approval, and one of the case's own would be overwritten.

    Parameters
    ----------
    path
        Where something is to be written; links are followed.
    place
        What an error names.
    is_case
        Whether a case is written, which may be put in the place of another one.

    Raises
    ------
    UsageError
        It is such a path.
    """
    path = Path(path)
    if any(_lies_in_case(one, is_case=is_case) for one in _places(path)):
        raise UsageError(
            "this is the folder of a case, or lies in one, where nothing but the case's own files may be: "
            "choose another place",
            place=place,
        )


def _places(path: Path) -> tuple[Path, ...]:
    """Where a path leads to, and where it stands itself: a link is replaced by what is written over it."""
    try:
        return Path(os.path.realpath(path)), Path(os.path.realpath(path.parent)) / path.name
    except ValueError:
        # what no path may hold lies nowhere: whoever writes there says so
        return ()


def _lies_in_case(path: Path, *, is_case: bool) -> bool:
    folders = path.parents if is_case else (path, *path.parents)
    return any(os.path.isfile(folder / MANIFEST_NAME) for folder in folders)
