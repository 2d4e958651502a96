"""A guided tour: steps with text, a scene, what is done, and a question."""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator
from typing import Annotated, Any, Literal, get_args

from pydantic import Field, TypeAdapter, ValidationError, model_validator

from heartcase.schemas.base import Model, Name, PatchScale, PositiveMm
from heartcase.schemas.errors import HeartcaseError, Problem, problems_from_validation
from heartcase.schemas.migrate import TOUR
from heartcase.schemas.recording.commands import Done, parse_command
from heartcase.schemas.touring.places import Beside, Place, Towards, Way, direction_of_words, numbered
from heartcase.schemas.touring.text import Block, Question

__all__ = [
    "CloseAlong",
    "CutPlane",
    "OpenAlong",
    "PassThrough",
    "PatchOver",
    "Scene",
    "SessionAct",
    "Tour",
    "TourAct",
    "TourHead",
    "TourStep",
    "TourView",
    "Wait",
    "act_problems",
    "parse_act",
]

_Seconds = Annotated[float, Field(gt=0.0, le=20.0)]
_NOT_IN_TOURS = ("advance", "mark", "halt", "add_springs", "remove_springs")
_SESSION_KINDS = tuple(
    kind for kind in (one.model_fields["kind"].default for one in get_args(Done)) if kind not in _NOT_IN_TOURS
)


class TourHead(Model):
    """What stands at the top of a tour's file."""

    heartcase_tour: Annotated[int, Field(ge=1, json_schema_extra={"maximum": TOUR.newest})]
    """Version of the format: 1."""
    case: Name
    """Name of the case, as its recipe has it."""
    language: Annotated[str, Field(pattern=r"^[a-z]{2,3}(-[A-Za-z0-9]{2,8})*$")] = "en"
    """Language of its text."""


class TourView(Model):
    """From where one looks, at what."""

    at: Place | None = None
    """What is in the middle; the whole heart when left out."""
    from_: Annotated[Towards | None, Field(alias="from")] = None
    """Where the eye is: words such as ``front left``, the name of a place, or a direction from what is seen to the eye;
    from the front when left out."""
    square: bool = False
    """Whether one looks along the axis of a ring, from the side where the eye is; at an incision: straight at the
    wall, from outside."""
    width_mm: PositiveMm | None = None
    """How much is seen from the upper to the lower edge, mm; the whole heart when left out."""

    @model_validator(mode="after")
    def _check(self) -> TourView:
        if self.square and not isinstance(self.at, str):
            raise ValueError("square looks at a landmark: name one as at")
        return self


class CutPlane(Model):
    """A plane that opens the picture; it cuts no tissue."""

    through: Place | None = None
    """Where it lies; in the middle of the view when left out."""
    removes: Towards
    """On which side nothing is shown. Through a ring, or beside one, towards a place: along the ring's axis."""


class Scene(Model):
    """What a step shows. What is left out is as at the start; the view is that of the step before."""

    view: TourView | None = None
    """From where one looks."""
    show: Annotated[tuple[Name, ...], Field(min_length=1, max_length=64)] | None = None
    """Structures that are shown; no others are."""
    hide: Annotated[tuple[Name, ...], Field(min_length=1, max_length=64)] | None = None
    """Structures that are not shown."""
    cut_plane: CutPlane | None = None
    """A plane that opens the picture."""
    stretch: bool = False
    """Whether colours show how far the tissue is stretched."""

    @model_validator(mode="after")
    def _check(self) -> Scene:
        if self.show is not None and self.hide is not None:
            raise ValueError("give either show or hide")
        return self


class OpenAlong(Model):
    """Cut along a planned incision, and hold the lips apart with hands."""

    kind: Literal["open_along"]
    """Which act."""
    landmark: Name
    """A planned incision of the case."""
    hands_per_lip: Annotated[int, Field(ge=0, le=4)] = 2
    """Hands on each lip; none cuts only."""
    spread_mm: PositiveMm | None = None
    """How far each lip is led, mm; a quarter of the incision's length when left out."""
    lift_mm: Annotated[float, Field(ge=0.0, le=100.0)] | None = None
    """How far each is lifted out besides, mm; a fifth of the incision's length when left out."""
    seconds: _Seconds = 0.6
    """How long that takes, simulated s."""


class CloseAlong(Model):
    """Let the lips of an incision go, and sew it up with a running thread."""

    kind: Literal["close_along"]
    """Which act."""
    landmark: Name
    """The incision that was opened."""
    spacing_mm: PositiveMm = 3.0
    """Distance between stitches, mm."""
    seconds: _Seconds = 0.6
    """How long each part of it takes, simulated s."""


class PatchOver(Model):
    """Sew a patch over a hole."""

    kind: Literal["patch_over"]
    """Which act."""
    landmark: Name
    """The hole: a ring."""
    side: Name
    """On which side of it: that of this place."""
    name: Name = "patch"
    """Name of the patch."""
    beside_mm: Annotated[float, Field(ge=0.0, le=50.0)] = 2.0
    """How far beside the hole's edge it is sewn on, mm."""
    spacing_mm: PositiveMm = 2.5
    """Distance between the stitches of its rim, mm."""
    scale: PatchScale = 0.95
    """Its size over that of its outline; below 1 it is stretched."""
    seconds: _Seconds = 0.3
    """Time in which it comes to rest, simulated s."""


class PassThrough(Model):
    """Pass a probe through a hole, from one side to the other, where it stays."""

    kind: Literal["pass_through"]
    """Which act."""
    landmark: Name
    """The hole: a ring."""
    side: Name
    """From which side it comes: that of this place."""
    name: Name = "probe"
    """Name of the probe."""
    radius_mm: PositiveMm | None = None
    """Its radius, mm; 0.6 of the hole's when left out."""
    from_mm: PositiveMm | None = None
    """How far before the hole it begins, mm; 2.5 of the hole's radius when left out."""
    to_mm: PositiveMm | None = None
    """How far behind the hole it ends, mm; 1.5 of the hole's radius when left out."""
    seconds: _Seconds = 1.0
    """How long that takes, simulated s."""


class Wait(Model):
    """Let time go by."""

    kind: Literal["wait"]
    """Which act."""
    seconds: _Seconds
    """How long, simulated s."""


class SessionAct(Model):
    """A command of a session, as recordings have it; places may be names."""

    kind: Literal["command"] = "command"
    """Which act."""
    command: dict[str, Any]
    """The command's data."""


OwnAct = Annotated[OpenAlong | CloseAlong | PatchOver | PassThrough | Wait, Field(discriminator="kind")]
TourAct = OpenAlong | CloseAlong | PatchOver | PassThrough | Wait | SessionAct
"""What a step does."""
_OWN: TypeAdapter[Any] = TypeAdapter(OwnAct)
_OWN_KINDS = {"open_along", "close_along", "patch_over", "pass_through", "wait"}


class TourStep(Model):
    """One step."""

    title: Annotated[str, Field(min_length=1, max_length=120)]
    """Its heading."""
    line: Annotated[int, Field(ge=1)]
    """Line of the file in which it begins."""
    blocks: Annotated[tuple[Block, ...], Field(max_length=50)] = ()
    """Its text."""
    scene: Scene = Scene()
    """What it shows."""
    acts: Annotated[tuple[TourAct, ...], Field(max_length=50)] = ()
    """What it does, in this order."""
    question: Question | None = None
    """What it asks."""


class Tour(Model):
    """A guided tour of a case."""

    head: TourHead
    """What stands at its top."""
    title: Annotated[str, Field(min_length=1, max_length=120)]
    """Its title."""
    blocks: Annotated[tuple[Block, ...], Field(max_length=50)] = ()
    """What is said before the first step."""
    steps: Annotated[tuple[TourStep, ...], Field(min_length=1, max_length=50)]
    """Its steps."""


def parse_act(data: Any) -> TourAct:
    """What an entry of a step's ``do`` says.

    Raises
    ------
    HeartcaseError
        With every problem that was found in it.
    """
    if not isinstance(data, dict) or not isinstance(data.get("kind"), str):
        raise HeartcaseError('an act is a table with a kind, such as { kind = "wait", seconds = 1 }', place="kind")
    kind = data["kind"]
    if kind in _OWN_KINDS:
        try:
            found: TourAct = _OWN.validate_python(data)
        except ValidationError as error:
            raise HeartcaseError(_without_kind(problems_from_validation(error), kind)) from None
        return found
    if kind not in _SESSION_KINDS:
        known = ", ".join((*sorted(_OWN_KINDS), *_SESSION_KINDS))
        raise HeartcaseError(f"there is no act of this kind (found {kind!r}); there are: {known}", place="kind")
    problems = [problem for key, value in data.items() for problem in _place_problems(key, value)]
    try:
        # where a table that is wrong stands for a place, there is one
        parse_command(numbered(data, lambda _: (0.0, 0.0, 0.0), lambda _: (1.0, 0.0, 0.0)))
    except HeartcaseError as error:
        problems += _without_kind(error.problems, kind)
    if problems:
        raise HeartcaseError(problems)
    return SessionAct(command=data)


def _without_kind(problems: Iterable[Problem], kind: str) -> list[Problem]:
    """The problems, each at its place in the act."""
    prefix = re.compile(rf"^(command\.?)?({kind}\b\.?)?")
    return [Problem(prefix.sub("", one.place), one.message) for one in problems]


def act_problems(data: Any) -> tuple[Problem, ...]:
    """What is wrong with an entry of a step's ``do``."""
    try:
        parse_act(data)
    except HeartcaseError as error:
        return error.problems
    return ()


def _place_problems(place: str, value: Any) -> Iterator[Problem]:
    """What is wrong with the tables of a command that stand for places and ways."""
    if isinstance(value, list):
        for number, inner in enumerate(value, start=1):
            yield from _place_problems(f"{place}[{number}]", inner)
    elif isinstance(value, dict) and place.partition("[")[0].endswith("_mm"):
        is_way = place == "offset_mm"
        try:
            read = (Way if is_way else Beside).model_validate(value)
        except ValidationError as error:
            yield from problems_from_validation(error, place=place, model=Way if is_way else Beside)
            return
        if is_way and isinstance(read.towards, str) and direction_of_words(read.towards) is None and read.near is None:
            yield Problem(f"{place}.near", "a way towards a place needs near: the place that it begins at")
