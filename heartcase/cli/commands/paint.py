"""``heartcase paint``: an interactive segmentation for a viewer, over lines of JSON."""

from __future__ import annotations

import base64
import json
import sys
import time
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import click
from pydantic import Field, TypeAdapter, ValidationError

from heartcase.cli.shared.output import working
from heartcase.cli.shared.output_path import OutputPath
from heartcase.schemas.base import Model
from heartcase.schemas.errors import HeartcaseError, Problem, UsageError, problems_from_validation
from heartcase.schemas.recipe.settings import Stroke
from heartcase.schemas.strict_json import parse_json

if TYPE_CHECKING:
    from heartcase.pipeline.building.session_file import RecipeSession
    from heartcase.pipeline.watershed.boxes import Box

__all__ = ["command"]


class _Paint(Stroke):
    do: Literal["paint"]


class _Step(Model):
    do: Literal["undo", "redo", "changed", "save", "quit"]


class _SaveAs(Model):
    do: Literal["save_as"]
    path: Annotated[str, Field(min_length=1)]


class _Suggest(Model):
    do: Literal["suggest"]
    count: Annotated[int, Field(ge=1, le=100)] = 5


class _Slice(Model):
    do: Literal["slice"]
    axis: Literal["i", "j", "k"]
    index: Annotated[int, Field(ge=0)]


class _Box(Model):
    do: Literal["box"]
    low: tuple[int, int, int]
    high: tuple[int, int, int]


_Request = _Paint | _Step | _SaveAs | _Suggest | _Slice | _Box
_REQUEST: TypeAdapter[_Request] = TypeAdapter(Annotated[_Request, Field(discriminator="do")])
_SHAPE = 'one JSON object in one line, such as {"do": "undo"}'


_HELP = """\
Paint on RECIPE's scan: one JSON object a line in, one JSON object a line out; for viewers to drive.

\b
{"do": "paint", "label": "aorta", "radius_mm": 2, "points_mm": [[0, 0, 0]]}
{"do": "paint", "erase": true, "radius_mm": 2, "points_mm": [[0, 0, 0]]}
{"do": "undo"}   {"do": "redo"}   {"do": "changed"}
{"do": "slice", "axis": "k", "index": 40}
{"do": "box", "low": [0, 0, 0], "high": [9, 9, 9]}
{"do": "suggest", "count": 5}
{"do": "save"}   {"do": "save_as", "path": "other.toml"}   {"do": "quit"}

Positions are patient LPS mm, boxes voxel indices (i, j, k), both ends included. Labels come as base64 of a byte a
voxel, i fastest. The end of the input ends it too; strokes that were not saved are lost then.
"""


@click.command(help=_HELP)
@click.argument("recipe", type=OutputPath())
@click.option(
    "--out",
    type=OutputPath(is_folder=True),
    default=Path(),
    help="Where the case goes, with the build's cache; here by default.",
)
def command(recipe: Path, out: Path) -> None:
    """Paint on a recipe's scan."""
    from heartcase.pipeline.building.session_file import open_session

    with working("opening"):
        opened = open_session(recipe, out=out)
    geometry = opened.session.geometry
    _answer(
        {
            "size": geometry.size,
            "spacing_mm": geometry.spacing_mm,
            "index_to_world": geometry.affine.tolist(),
            "labels": {label.name: label.value for label in opened.session.table},
            "unmarked": 255,
        }
    )
    for line in sys.stdin.buffer:
        if not line.strip():
            continue
        start = time.perf_counter()
        answer: dict[str, Any] | None
        try:
            answer = _obey(opened, line)
        except HeartcaseError as error:
            answer = {"problems": [{"place": problem.place, "message": problem.message} for problem in error.problems]}
        if answer is None:
            return
        _answer(answer | {"milliseconds": round(1e3 * (time.perf_counter() - start), 3)})


def _answer(data: dict[str, Any]) -> None:
    click.echo(json.dumps({"ok": "problems" not in data} | data, ensure_ascii=False, allow_nan=False))


def _request(line: bytes) -> _Request:
    """What a line asks for."""
    try:
        data = parse_json(line.rstrip())
    except UnicodeDecodeError:
        raise UsageError("is not UTF-8 text: write it as UTF-8", place="request") from None
    except ValueError as error:
        where = f" at character {error.pos + 1}" if isinstance(error, json.JSONDecodeError) else f" ({error})"
        raise UsageError(f"is not valid JSON{where}: give {_SHAPE}", place="request") from None
    if not isinstance(data, dict):
        raise UsageError(f"must be {_SHAPE}", place="request")
    try:
        # without "do" it is told which ones there are
        return _REQUEST.validate_python({"do": None} | data)
    except ValidationError as error:
        raise UsageError(problems_from_validation(error, place="request")) from None


def _obey(opened: RecipeSession, line: bytes) -> dict[str, Any] | None:
    """Carry a request out; what to answer, or None to end."""
    request = _request(line)
    session = opened.session
    if isinstance(request, _Paint):
        return _changed(session.paint(Stroke.model_validate(request.model_dump(exclude={"do"}))))
    if isinstance(request, _Suggest):
        return session.suggest(count=request.count).as_json(session.table)
    if isinstance(request, _Slice):
        return _labels(session.labels_of_slice(request.axis, request.index))
    if isinstance(request, _SaveAs):
        return {"stroke_count": opened.save_as(Path(request.path))}
    if isinstance(request, _Box):
        ends = list(zip(request.low, request.high, session.geometry.size, strict=True))
        if any(not 0 <= low <= high < size for low, high, size in ends):
            raise UsageError(Problem("box", "low must not be above high, and both must lie in the scan"))
        i, j, k = (slice(low, high + 1) for low, high, _ in ends)
        return _labels(session.labels_of_box((k, j, i)))
    match request.do:
        case "undo":
            return _changed(session.undo())
        case "redo":
            return _changed(session.redo())
        case "changed":
            return _changed(session.take_changed())
        case "save":
            return {"stroke_count": opened.save()}
        case "quit":
            return None


def _changed(box: Box | None) -> dict[str, Any]:
    if box is None:
        return {"changed": None}
    return {"changed": {"low": [s.start for s in box[::-1]], "high": [s.stop - 1 for s in box[::-1]]}}


def _labels(labels: Any) -> dict[str, Any]:
    return {"size": labels.shape[::-1], "labels": base64.b64encode(labels.tobytes()).decode("ascii")}
