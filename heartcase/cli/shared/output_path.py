"""The type of every argument and option that says where something is written."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any

import click

from heartcase.schemas.bundle.placing import refuse_inside_case
from heartcase.schemas.errors import UsageError

__all__ = ["OutputPath"]


class OutputPath(click.Path):
    """A path to write to; one in the folder of a case is refused before any work is done.

    Parameters
    ----------
    is_case
        Whether a case is written there, which may replace another one.
    is_folder
        Whether it is a folder, which is made where it is not there: a file in its way is refused.
    dir_okay
        As of click.
    """

    def __init__(self, *, is_case: bool = False, is_folder: bool = False, dir_okay: bool = True) -> None:
        super().__init__(path_type=Path, readable=False, dir_okay=dir_okay)
        self.is_case, self.is_folder = is_case, is_folder

    def convert(self, value: str | os.PathLike[str], param: click.Parameter | None, ctx: click.Context | None) -> Any:
        """The path; UsageError where it must not be written to."""
        path = Path(os.fsdecode(super().convert(value, param, ctx)))
        place = _place_of(param)
        refuse_inside_case(path, place=place, is_case=self.is_case)
        if self.is_folder:
            _refuse_file(path, place)
        return path


def _place_of(param: click.Parameter | None) -> str:
    if param is None:
        return ""
    return next((name for name in param.opts if name.startswith("--")), param.human_readable_name)


def _refuse_file(folder: Path, place: str) -> None:
    """UsageError where a file stands in the place of a folder, or of one above it."""
    if os.path.exists(folder) and not os.path.isdir(folder):
        raise UsageError("this is a file: give the folder that all is to go into", place=place)
    if any(os.path.isfile(above) for above in folder.parents):
        raise UsageError("a part of this path is a file: give a folder", place=place)
