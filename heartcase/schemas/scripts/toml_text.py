"""Scripts and plans as TOML text: read from a file, and checked against a model, all problems at once."""

from __future__ import annotations

import os
import tomllib
from collections.abc import Callable
from pathlib import Path
from typing import Any, TypeVar

from pydantic import BaseModel, ValidationError

from heartcase.schemas.errors import ScriptError, problems_from_validation
from heartcase.schemas.files import is_there
from heartcase.schemas.migrate import VersionedFormat
from heartcase.schemas.toml_problems import toml_problem

__all__ = ["checked_toml", "text_of"]

M = TypeVar("M", bound=BaseModel)


def text_of(path: Path | str, place: str) -> str:
    """The text of a file.

    Raises
    ------
    ScriptError
        At ``place``: there is no such file, it is a folder, or it is no UTF-8 text.
    """
    if os.path.isdir(path):
        raise ScriptError("this is a folder: give the file", place=place)
    try:
        return Path(path).read_text(encoding="utf-8")
    except (OSError, ValueError):
        if not is_there(path):
            raise ScriptError("there is no such file; check the path", place=place) from None
        raise ScriptError("the file cannot be read as UTF-8 text", place=place) from None


def checked_toml(
    text: str, model: type[M], form: VersionedFormat, place: str, wrong: Callable[[dict[str, Any]], str | None]
) -> M:
    """What TOML text says, brought to the newest version of its format.

    Parameters
    ----------
    text
        The text.
    model
        What it must be.
    form
        Its format.
    place
        What problems of all of it are told of.
    wrong
        Why some data is of another kind altogether; None where it is not.

    Raises
    ------
    ScriptError
        With every problem that was found.
    """
    try:
        data = tomllib.loads(text)
    except tomllib.TOMLDecodeError as error:
        raise ScriptError(toml_problem(text, error), place=place) from None
    message = wrong(data)
    if message is not None:
        raise ScriptError(message, place=place)
    try:
        return model.model_validate(form.migrated(data)[0])
    except ValidationError as error:
        raise ScriptError(problems_from_validation(error, model=model)) from None
