"""The errors of heartcase, in one hierarchy.

::

    HeartcaseError              every error that is not a bug
    ├── UsageError              the command line or a call was given the wrong things
    │   └── MissingPathError    there is nothing at a path
    ├── ScanError               a scan cannot be read
    ├── MarkerError             markers cannot be read or do not fit the scan
    ├── RecipeError             a recipe is wrong
    ├── StageError              a stage of the pipeline cannot do what is asked
    ├── BundleError             a case bundle is broken, or cannot be written
    ├── ScriptError             a simulation script is wrong
    ├── SimulationError         the simulation was asked for, or came to, something impossible
    ├── RecordingError          a recording is broken, of another case, or does not repeat what it recorded
    ├── MissingExtraError       an optional part of heartcase is not installed
    └── UnsupportedVersionError a library is of a version that was not tested

An error carries every problem that was found, each with its place. The command line prints them a line each
and exits with ``exit_code``; anything else is a bug, told without its own text, which might name a patient.
"""

from __future__ import annotations

import difflib
from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any, get_args

from pydantic import BaseModel, ValidationError
from pydantic_core import ErrorDetails

__all__ = [
    "BundleError",
    "HeartcaseError",
    "MarkerError",
    "MissingExtraError",
    "MissingPathError",
    "ModelProblems",
    "Problem",
    "RecipeError",
    "RecordingError",
    "ScanError",
    "ScriptError",
    "SimulationError",
    "StageError",
    "UnsupportedVersionError",
    "UsageError",
    "problems_from_validation",
]


PLACE_LENGTH_MAX = 200
MESSAGE_LENGTH_MAX = 1500


def _line(text: str, length_max: int) -> str:
    """One printable line of limited length."""
    shown = "".join(letter if letter.isprintable() else "?" for letter in text)
    return shown if len(shown) <= length_max else shown[: length_max - 4] + " ..."


@dataclass(frozen=True, order=True)
class Problem:
    """One thing that is wrong: where it is, and what it is with what to do about it.

    Attributes
    ----------
    place
        File role, stage, setting (``walls.smoothing_mm``), label or slice. Never a patient's file name.
    message
        What is wrong and what to do, in one line of plain words.
    """

    place: str
    message: str

    def __post_init__(self) -> None:
        # Both may quote a file that somebody else made: nothing in it may steer a terminal or flood it.
        object.__setattr__(self, "place", _line(self.place, PLACE_LENGTH_MAX))
        object.__setattr__(self, "message", _line(self.message, MESSAGE_LENGTH_MAX))

    def __str__(self) -> str:
        return f"{self.place}: {self.message}" if self.place else self.message


class HeartcaseError(Exception):
    """Base of every error that a user can cause and mend.

    Parameters
    ----------
    problems
        One message, one :class:`Problem`, or all the problems that were found.
    place
        Place of the problem when ``problems`` is a plain message.
    """

    exit_code = 1

    def __init__(self, problems: str | Problem | Iterable[Problem], *, place: str = "") -> None:
        if isinstance(problems, str):
            problems = Problem(place, problems)
        if isinstance(problems, Problem):
            problems = (problems,)
        self.problems: tuple[Problem, ...] = tuple(problems)
        super().__init__("\n".join(str(problem) for problem in self.problems))


class UsageError(HeartcaseError):
    """The command line or a call was given the wrong things."""

    exit_code = 2


class MissingPathError(UsageError):
    """There is nothing at a path: every command ends with the same code then, whatever it wanted there."""

    exit_code = 1


class ScanError(HeartcaseError):
    """A scan cannot be read."""


class MarkerError(HeartcaseError):
    """Markers cannot be read, or do not fit the scan."""


class RecipeError(HeartcaseError):
    """A recipe is wrong."""


class StageError(HeartcaseError):
    """A stage of the pipeline cannot do what is asked."""


class BundleError(HeartcaseError):
    """A case bundle is broken, or cannot be written."""


class ScriptError(HeartcaseError):
    """A simulation script is wrong."""


class SimulationError(HeartcaseError):
    """The simulation was asked for, or came to, something impossible."""


class RecordingError(HeartcaseError):
    """A recording is broken, of another case, or does not repeat what it recorded; or a command is none."""


def how_to_install(extra: str) -> str:
    """The command that brings an extra of the package, which is on no index: from a checkout or a wheel."""
    return f"run  pip install '.[{extra}]'  in heartcase's checkout, or  pip install 'THE.whl[{extra}]'  with its wheel"


class MissingExtraError(HeartcaseError):
    """An optional part of heartcase is not installed.

    Parameters
    ----------
    feature
        What was asked for, as it starts a sentence.
    extra
        The extra of the package that brings it: ``prepare``, ``cuda``, ``library``.
    """

    def __init__(self, feature: str, extra: str) -> None:
        super().__init__(f"{feature} needs an optional part: {how_to_install(extra)}")


class UnsupportedVersionError(HeartcaseError, ImportError):
    """A library that heartcase leans on is installed in a version that it was not tested with."""


class ModelProblems(ValueError):
    """Raised inside a schema model's validator: several problems at once, each with its place in the model."""

    def __init__(self, problems: Iterable[Problem]) -> None:
        self.problems = tuple(problems)
        super().__init__("; ".join(str(problem) for problem in self.problems))


def problems_from_validation(
    error: ValidationError, *, place: str = "", model: type[BaseModel] | None = None
) -> tuple[Problem, ...]:
    """Turn a pydantic error into problems with dotted places, such as ``strokes[2].points_mm``.

    Where the ``model`` that refused is given, an unknown setting is told with the one that was probably meant.
    """
    problems: list[Problem] = []
    for detail in error.errors(include_url=False):
        dotted = _dotted(_along(model, detail["loc"])[1], place)
        cause = detail.get("ctx", {}).get("error")
        message = detail["msg"].removeprefix("Value error, ")
        if isinstance(cause, ModelProblems):
            problems += [Problem(_joined(dotted, inner.place), inner.message) for inner in cause.problems]
            continue
        if detail["type"] == "too_short" and any(problem.place.startswith(f"{dotted}[") for problem in problems):
            continue
        limits = detail.get("ctx", {})
        kind = detail["type"]
        if kind in _PLAIN_WORDS:
            message = _PLAIN_WORDS[kind].format(**limits)
        if kind in ("union_tag_invalid", "union_tag_not_found"):
            problems.append(_kind_problem(detail, dotted))
            continue
        if kind == "string_pattern_mismatch" and limits.get("pattern") in _PATTERN_WORDS:
            message = f"{message}: {_PATTERN_WORDS[limits['pattern']]}"
        if kind == "extra_forbidden":
            near = _meant(model, detail["loc"])
            message = f"unknown setting: did you mean {near!r}?" if near else _UNKNOWN
        elif kind == "missing":
            message = "is missing: add it"
        elif isinstance(detail["input"], str | int | float | bool) and not _is_path(detail["input"]):
            message += f" (found {detail['input']!r})"
        problems.append(Problem(dotted, message))
    return tuple(problems)


_UNKNOWN = "unknown setting: check its spelling, or remove it"


def _meant(model: type[BaseModel] | None, location: tuple[int | str, ...]) -> str | None:
    """The setting beside an unknown one whose name is nearest to it; None where none is near."""
    models, _ = _along(model, location[:-1])
    near = difflib.get_close_matches(str(location[-1]), [name for one in models for name in one.model_fields], n=1)
    return near[0] if near else None


def _along(
    model: type[BaseModel] | None, location: tuple[int | str, ...]
) -> tuple[list[type[BaseModel]], tuple[int | str, ...]]:
    """The models that may stand at a place, and the place as the file has it.

    pydantic names the kind that tells alternatives apart as a part of the place; in the file it is a setting beside.
    """
    models = [model] if model is not None else []
    written: list[int | str] = []
    for part in location:
        fields = [one.model_fields[part] for one in models if isinstance(part, str) and part in one.model_fields]
        kinds = [one for one in models if isinstance(part, str) and _is_kind(one, part)]
        if fields:
            models = [inner for field in fields for inner in _models_in(field.annotation)]
        elif kinds:
            models = kinds
            continue
        # Else a place in a list, or a key of a table.
        written.append(part)
    return models, tuple(written)


def _models_in(annotation: Any) -> list[type[BaseModel]]:
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        return [annotation]
    return [model for inner in get_args(annotation) for model in _models_in(inner)]


def _is_kind(model: type[BaseModel], tag: str) -> bool:
    return any(tag in get_args(field.annotation) for field in model.model_fields.values())


_PLAIN_WORDS = {
    "int_parsing": "must be a whole number",
    "int_type": "must be a whole number",
    "int_from_float": "must be a whole number",
    "float_parsing": "must be a number",
    "float_type": "must be a number",
    "finite_number": "must be a finite number",
    "bool_parsing": "must be true or false, without quotes",
    "bool_type": "must be true or false, without quotes",
    "tuple_type": "must be a list in [brackets]",
    "list_type": "must be a list in [brackets]",
    "dict_type": "must be a table of names with values",
    "model_type": "must be a table of names with values",
    "model_attributes_type": "must be a table of names with values",
    "string_type": 'must be text in "quotes"',
    "greater_than": "must be above {gt:g}",
    "greater_than_equal": "must be at least {ge:g}",
    "less_than": "must be below {lt:g}",
    "less_than_equal": "must be at most {le:g}",
    "too_short": "must hold at least {min_length} of them, not {actual_length}",
    "too_long": "must hold at most {max_length} of them, not {actual_length}",
    "string_too_short": "must not be empty",
    "literal_error": "must be {expected}",
    "enum": "must be {expected}",
    "string_pattern_mismatch": "holds characters that are not allowed here",
    "string_too_long": "must not be longer than {max_length} characters",
}
"""Type of pydantic's error -> message, with the limits in braces."""


_PATTERN_WORDS = {
    r"^[A-Za-z0-9][A-Za-z0-9 _.()+-]*$": "take letters a to z without accents, digits, spaces and _ . ( ) + -, and "
    "begin with a letter or a digit",
    r"^#[0-9a-fA-F]{6}$": "a colour is # and six digits from 0 to f, such as #d41515",
    r"^[A-Z0-9](-?[A-Z0-9]){2,31}$": "take capital letters, digits and single hyphens, such as HC-0001",
    r"^[0-9]{6,18}$": "a SNOMED CT code is 6 to 18 digits",
    r"^[a-z0-9][a-z0-9_.-]{0,127}$": "it is a file name, never a path",
    r"^[0-9a-f]{64}$": "it is 64 digits from 0 to f",
}
"""Pattern -> what it allows, in words."""


def _kind_problem(detail: ErrorDetails, dotted: str) -> Problem:
    """That a table does not say, or says wrongly, which of several kinds it is."""
    limits = detail["ctx"]
    key = str(limits["discriminator"]).strip("'")
    place = _joined(dotted, key)
    if "expected_tags" not in limits:
        return Problem(place, "is missing: add it")
    found = detail["input"].get(key) if isinstance(detail["input"], dict) else None
    shown = f" (found {found!r})" if isinstance(found, str | int | float) and not _is_path(found) else ""
    first, _, last = str(limits["expected_tags"]).rpartition(", ")
    return Problem(place, f"must be {first} or {last}{shown}" if first else f"must be {last}{shown}")


def _is_path(value: str | int | float | bool) -> bool:
    """Whether a value may be a path, which may be named after a patient and is not quoted."""
    return isinstance(value, str) and ("/" in value or "\\" in value)


def _joined(outer: str, inner: str) -> str:
    return f"{outer}.{inner}" if outer and inner else outer or inner


def _dotted(location: tuple[int | str, ...], place: str) -> str:
    dotted = place
    for part in location:
        if isinstance(part, int):
            dotted += f"[{part + 1}]"
        # What pydantic adds where a name itself is wrong, and not what stands under it.
        elif part != "[key]":
            dotted = _joined(dotted, part)
    return dotted
