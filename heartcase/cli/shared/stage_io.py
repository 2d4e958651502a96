"""What the stage commands share: their options, settings from a recipe or the command line, inputs and outputs."""

from __future__ import annotations

import functools
import tomllib
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar, cast

import click
from pydantic import ValidationError

from heartcase.schemas.base import Model
from heartcase.schemas.errors import Problem, RecipeError, StageError, UsageError, problems_from_validation
from heartcase.schemas.files import atomic_write

if TYPE_CHECKING:
    from heartcase.pipeline.artifacts.serialise import History

__all__ = [
    "SCAN_SUFFIXES",
    "load_outputs",
    "save_output",
    "scan_options",
    "settings_of",
    "stage_options",
]

M = TypeVar("M", bound=Model)
F = TypeVar("F", bound=Callable[..., Any])

SCAN_SUFFIXES = (".nii", ".nii.gz", ".nrrd", ".mha")


def stage_options(function: F) -> F:
    """Add ``--recipe`` and ``--set`` to a stage command."""
    recipe = click.option(
        "--recipe", type=click.Path(path_type=Path, readable=False), help="Take the stage's settings from a recipe."
    )
    sets = click.option("--set", "sets", multiple=True, metavar="KEY=VALUE", help="Change one setting; repeatable.")
    return recipe(sets(function))


def scan_options(function: F) -> F:
    """Add the options of a command that takes a scan; they come as one argument, ``choice``, for ``read_scan``.

    It holds what was given and nothing else, so ``recipe.scan.choice | choice`` lets the command line win.
    """

    @functools.wraps(function)
    def collecting(*args: Any, **given: Any) -> Any:
        choice = {name: given.pop(name) for name in _SCAN_OPTIONS}
        # by identity: 0.0 equals False, and is a time
        stated = {name: value for name, value in choice.items() if value is not None and value is not False}
        return function(*args, choice=stated, **given)

    wrapped: Any = collecting
    for name, option in reversed(_SCAN_OPTIONS.items()):
        flags, settings = option
        wrapped = click.option(flags, name, **settings)(wrapped)
    return cast("F", wrapped)


_SCAN_OPTIONS: dict[str, tuple[str, dict[str, Any]]] = {
    "series": ("--series", {"help": "DICOM: which series of the folder, by its number or code, or its UID."}),
    "trigger_time_ms": (
        "--trigger-time",
        {"type": click.FloatRange(min=0.0), "metavar": "MS", "help": "The cardiac phase nearest to this time."},
    ),
    "echo_time_ms": (
        "--echo-time",
        {"type": click.FloatRange(min=0.0), "metavar": "MS", "help": "DICOM: the echo nearest to this echo time."},
    ),
    "frame": (
        "--frame",
        {"type": click.IntRange(min=0), "metavar": "N", "help": "NIfTI, NRRD, MetaImage: which volume, from 0."},
    ),
    "interpolate_missing": (
        "--interpolate-missing",
        {"is_flag": True, "help": "DICOM: fill missing slices from their neighbours."},
    ),
    "straighten_tilt": ("--straighten-tilt", {"is_flag": True, "help": "DICOM: straighten a tilted gantry's slices."}),
    "overlap": (
        "--overlap",
        {
            "type": click.Choice(("earlier", "later")),
            "help": "DICOM: which image to take where two acquisitions meet in one slice position.",
        },
    ),
}
"""Parameter of ``read_scan`` -> option of the command line."""


def settings_of(model: type[M], given: M | None, sets: tuple[str, ...]) -> M:
    """The recipe's settings, or the defaults, with the changes of ``--set``.

    Raises
    ------
    UsageError
        A change is not KEY=VALUE.
    RecipeError
        A key is unknown or a value is not allowed.
    """
    values: dict[str, Any] = given.model_dump(exclude_unset=True) if given is not None else {}
    problems = []
    for item in sets:
        key, equals, text = item.partition("=")
        if not equals:
            problems.append(Problem("--set", f"{item!r} is not KEY=VALUE"))
            continue
        try:
            values[key.strip()] = tomllib.loads(f"value = {text}")["value"]
        except tomllib.TOMLDecodeError:
            values[key.strip()] = text
    if problems:
        raise UsageError(problems)
    try:
        return model.model_validate(values)
    except ValidationError as error:
        raise RecipeError(problems_from_validation(error, place="settings")) from None


def load_outputs(wanted: Mapping[str, tuple[Path | None, type]]) -> list[Any]:
    """Outputs of stages, by the name of the argument: each the (path, kind); None where there is no path.

    Raises
    ------
    StageError
        Files that cannot be read, or are not those outputs: all of them, by the names of their arguments.
    """
    from heartcase.pipeline.artifacts.serialise import load_artifact

    found: list[Any] = []
    problems: list[Problem] = []
    for name, (path, kind) in wanted.items():
        try:
            found.append(load_artifact(path, kind) if path is not None else None)
        except StageError as error:
            problems += [Problem(name, problem.message) for problem in error.problems]
    if problems:
        raise StageError(problems)
    return found


def save_output(path: Path, output: Any, history: History | None = None) -> None:
    """Write a stage's output: ``.safetensors``, or an image format for scans and label volumes, without a history.

    Raises
    ------
    UsageError
        The ending is not one that this output can be written as.
    """
    from heartcase.pipeline.artifacts.serialise import artifact_to_bytes
    from heartcase.pipeline.data import Scan, Segmentation
    from heartcase.pipeline.formats.write_images import write_scan, write_segmentation

    if path.suffix == ".safetensors":
        atomic_write(path, artifact_to_bytes(output, history))
    elif isinstance(output, Scan) and path.name.endswith(SCAN_SUFFIXES):
        write_scan(output, path)
    elif isinstance(output, Segmentation) and path.name.endswith(SCAN_SUFFIXES):
        write_segmentation(output, path)
    else:
        images = isinstance(output, Scan | Segmentation)
        endings = ", ".join((".safetensors", *(SCAN_SUFFIXES if images else ())))
        raise UsageError(f"must end in one of: {endings}", place="OUTPUT")
    click.echo(f"wrote {path}", err=True)
