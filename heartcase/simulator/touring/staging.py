"""What a step of a tour shows on a case, and the commands that it gives, with the time between them."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from heartcase.schemas.arrays import Float64
from heartcase.schemas.errors import HeartcaseError, Problem, ScriptError
from heartcase.schemas.recording.commands import (
    BringProbe,
    CloseGrab,
    Cut,
    Done,
    DrawStitch,
    LeadGrab,
    MoveProbe,
    OpenGrab,
    PlacePatch,
    PlaceRow,
    TieStitch,
    parse_command,
)
from heartcase.schemas.scripts.incision_plans import LipHands, PlannedCut
from heartcase.schemas.scripts.script import GrabAction
from heartcase.schemas.touring.names import CUT_FACES_NAME, grown_septa, labels_meant, tour_problems
from heartcase.schemas.touring.places import Beside, known_name, numbered
from heartcase.schemas.touring.tour import (
    CloseAlong,
    OpenAlong,
    PassThrough,
    PatchOver,
    SessionAct,
    Tour,
    TourAct,
    TourView,
    Wait,
)
from heartcase.simulator.incisions.planned import blade_poses, lip_hands
from heartcase.simulator.incisions.rim import defect_rim
from heartcase.simulator.live.shapes import CUT_FACES
from heartcase.simulator.touring.case_places import CasePlaces

__all__ = ["StagedPlane", "StagedScene", "StagedView", "Timed", "staged_scenes", "timed_commands"]

_EYE_HEIGHT = 0.94
"""Cosine between the line of sight and the body's axis above which the patient's front is up in the picture."""
_PARTS = 10
"""In so many parts an instrument is led where a tour says how long that takes."""
_OUTLINE_POINTS = 24
_ALONG = 0.3
"""A direction whose part within a plane is shorter than this is nearly at right angles to it."""
_EDGE = 0.42
"""From the middle of the view to where a plane is led by, in its width."""
_THREAD = 0.9
"""Length to which a thread is drawn, over the distance of its places at rest."""
_SETTLE_S = 0.1

Timed = Done | Wait
"""A command, or time that goes by."""


@dataclass(frozen=True)
class StagedView:
    """A view in numbers, LPS."""

    target_mm: tuple[float, float, float]
    """What is in the middle."""
    towards: tuple[float, float, float]
    """From there to the eye, unit length."""
    up: tuple[float, float, float]
    """What is up in the picture, unit length, at right angles."""
    width_mm: float
    """How much is seen from the upper to the lower edge, mm."""


@dataclass(frozen=True)
class StagedPlane:
    """A plane that opens the picture, LPS."""

    normal: tuple[float, float, float]
    """Towards what is removed, unit length."""
    point_mm: tuple[float, float, float]
    """A point of it, at the edge of the view: where it is led by, out of the way of what is looked at."""


@dataclass(frozen=True)
class StagedScene:
    """A scene in numbers."""

    view: StagedView | None
    """From where one looks; None where it stays."""
    hidden: tuple[int, ...]
    """Numbers of the structures that are not shown."""
    plane: StagedPlane | None
    """A plane that opens the picture."""
    stretch: bool
    """Whether colours show stretch."""


def staged_scenes(tour: Tour, places: CasePlaces) -> tuple[StagedScene, ...]:
    """What each step shows on a case.

    Raises
    ------
    ScriptError
        The case lacks what the tour names: all problems at once.
    """
    manifest = places.case.manifest
    problems = list(tour_problems(tour, manifest.landmarks, manifest.labels))
    if problems:
        raise ScriptError(problems)
    found: list[StagedScene] = []
    view: StagedView | None = None
    for number, step in enumerate(tour.steps, start=1):
        scene = step.scene
        try:
            view = view if scene.view is None else _view(scene.view, places)
            plane = None
            if scene.cut_plane is not None:
                through = scene.cut_plane.through
                assert through is not None or view is not None
                point = np.array(view.target_mm) if through is None and view is not None else places.point(through)
                named = through.near if isinstance(through, Beside) else through
                ring = places.landmark(named) if isinstance(named, str) else None
                # on which side of a ring a place is does not depend on how far beside it the plane lies
                start = point if ring is None else places.point(ring.name)
                normal = places.direction(scene.cut_plane.removes, start, ring)
                plane = StagedPlane(_numbers(normal), _numbers(_handle(point, normal, view)))
        except HeartcaseError as error:
            problems += [Problem(f"line {step.line} (step {number})", one.message) for one in error.problems]
            continue
        found.append(StagedScene(view, _hidden(scene.show, scene.hide, places), plane, scene.stretch))
    if problems:
        raise ScriptError(problems)
    return tuple(found)


def timed_commands(tour: Tour, number: int, places: CasePlaces) -> tuple[Timed, ...]:
    """The commands that a step's acts stand for, and the time between them.

    Parameters
    ----------
    tour
        The tour; :func:`staged_scenes` finds nothing wrong with it.
    number
        The step, from 0.
    places
        Places of the case.

    Raises
    ------
    HeartcaseError
        The case lacks what they name, such as a hole where a ring is.
    """
    opened: dict[str, OpenAlong] = {}
    found: list[Timed] = []
    for at, step in enumerate(tour.steps[: number + 1]):
        for act in step.acts:
            if at == number:
                if isinstance(act, CloseAlong) and act.landmark.lower() in opened:
                    found += _letting_go(opened[act.landmark.lower()], places, act.seconds)
                found += _timed(act, places)
            if isinstance(act, OpenAlong):
                opened[act.landmark.lower()] = act
            elif isinstance(act, CloseAlong):
                opened.pop(act.landmark.lower(), None)
    return tuple(found)


def _timed(act: TourAct, places: CasePlaces) -> Iterator[Timed]:
    match act:
        case Wait():
            yield act
        case SessionAct():
            command = parse_command(numbered(act.command, lambda one: places.point(one).tolist(), places.way))
            assert isinstance(command, Done)
            yield command
        case OpenAlong():
            yield from _opening(act, places)
        case CloseAlong():
            yield from _closing(act, places)
        case PatchOver():
            yield from _patching(act, places)
        case PassThrough():
            yield from _passing(act, places)


def _opening(act: OpenAlong, places: CasePlaces) -> Iterator[Timed]:
    line = places.line(act.landmark)
    mark = places.landmark(act.landmark)
    assert mark is not None
    cell_mm = places.case.model.cell_mm
    cut = PlannedCut(name=mark.name, landmark=mark.name)
    poses = blade_poses(cut, line, places.case.manifest.landmarks, cell_mm=cell_mm)
    yield Cut(name=mark.name, poses_mm=poses, at_rest=True)
    yield Wait(kind="wait", seconds=_SETTLE_S)
    hands = _hands(act, places)
    for hand in hands:
        assert hand.position_mm is not None
        yield CloseGrab(name=hand.name, center_mm=hand.position_mm, radius_mm=hand.radius_mm)
    if hands:
        yield from _led(hands, act.seconds, np.linspace(0.0, 1.0, _PARTS + 1)[1:])


def _closing(act: CloseAlong, places: CasePlaces) -> Iterator[Timed]:
    line = places.line(act.landmark)
    mark = places.landmark(act.landmark)
    assert mark is not None
    beside = max(2.0, 0.75 * places.case.model.cell_mm)
    count = max(2, min(8, round(line.length_mm / 8.0)))
    pairs = []
    for part in np.linspace(0.08, 0.92, count):
        point, _, across = line.at(float(part))
        pairs.append((_numbers(point + beside * across), _numbers(point - beside * across)))
    name = f"{mark.name} suture"
    yield PlaceRow(name=name, places_mm=tuple(pairs), spacing_mm=act.spacing_mm, running=True, at_rest=True)
    yield DrawStitch(name=name, length_mm=_THREAD * 2.0 * beside)
    yield Wait(kind="wait", seconds=act.seconds)
    yield TieStitch(name=name)
    yield Wait(kind="wait", seconds=0.5 * act.seconds)


def _hands(act: OpenAlong, places: CasePlaces) -> tuple[GrabAction, ...]:
    """Hands on both lips of an incision, and where each is led."""
    if act.hands_per_lip == 0:
        return ()
    hands = LipHands(hands_per_lip=act.hands_per_lip, spread_mm=act.spread_mm, lift_mm=act.lift_mm)
    made = lip_hands(
        hands, places.line(act.landmark), places.rest_mm, cell_mm=places.case.model.cell_mm, open_s=act.seconds
    )
    mark = places.landmark(act.landmark)
    assert mark is not None
    return tuple(one.model_copy(update={"name": f"{mark.name} {one.name}"[:64]}) for one in made)


def _led(hands: tuple[GrabAction, ...], seconds: float, parts: Float64) -> Iterator[Timed]:
    for part in parts.tolist():
        for hand in hands:
            x, y, z = hand.path[-1].offset_mm
            yield LeadGrab(name=hand.name, offset_mm=(part * x, part * y, part * z))
        yield Wait(kind="wait", seconds=seconds / len(parts))


def _letting_go(act: OpenAlong, places: CasePlaces, seconds: float) -> Iterator[Timed]:
    """Bring the lips of an incision back, and let go."""
    hands = _hands(act, places)
    if hands:
        yield from _led(hands, seconds, np.linspace(1.0, 0.0, _PARTS + 1)[1:])
    for hand in hands:
        yield OpenGrab(name=hand.name)


def _patching(act: PatchOver, places: CasePlaces) -> Iterator[Timed]:
    mark = places.landmark(act.landmark)
    assert mark is not None
    rim = defect_rim(places.tree, mark, places.point(act.side))
    middle, axis = rim.points_mm.mean(axis=0), places.axis(mark)
    chosen = np.linspace(0, len(rim.points_mm), _OUTLINE_POINTS, endpoint=False).astype(int)
    out = rim.points_mm[chosen] - middle
    out -= np.outer(out @ axis, axis)
    points = rim.points_mm[chosen] + act.beside_mm * out / np.linalg.norm(out, axis=1, keepdims=True)
    outline = tuple(_numbers(point) for point in points)
    yield PlacePatch(name=act.name, outline_mm=outline, at_rest=True, spacing_mm=act.spacing_mm, scale=act.scale)
    yield Wait(kind="wait", seconds=act.seconds)


def _passing(act: PassThrough, places: CasePlaces) -> Iterator[Timed]:
    mark = places.landmark(act.landmark)
    assert mark is not None
    middle, ring_mm = places.point(mark.name), places.radius_mm(mark)
    axis = places.direction(act.side, middle, mark)
    radius = act.radius_mm or 0.6 * ring_mm
    start = middle + (act.from_mm or 2.5 * ring_mm) * axis
    end = middle - (act.to_mm or 1.5 * ring_mm) * axis
    yield BringProbe(name=act.name, center_mm=_numbers(start), semi_axes_mm=(radius, radius, radius))
    for part in np.linspace(0.0, 1.0, _PARTS + 1)[1:]:
        yield MoveProbe(name=act.name, center_mm=_numbers(start + part * (end - start)))
        yield Wait(kind="wait", seconds=act.seconds / _PARTS)


def _handle(point: Float64, normal: Float64, view: StagedView | None) -> Float64:
    """A point of a plane at the lower edge of the view."""
    if view is None:
        return point
    at = np.array(view.target_mm) + (normal @ (point - np.array(view.target_mm))) * normal
    for down in (-np.array(view.up), np.cross(view.up, view.towards)):
        along = down - (down @ normal) * normal
        size = float(np.linalg.norm(along))
        if size > _ALONG:
            found: Float64 = at + _EDGE * view.width_mm / size * along
            return found
    return point


def _view(view: TourView, places: CasePlaces) -> StagedView:
    at = places.middle_mm if view.at is None else places.point(view.at)
    mark = places.landmark(view.at) if isinstance(view.at, str) else None
    from_ = "front" if view.from_ is None else view.from_
    if view.square and mark is not None and mark.kind == "polyline":
        towards = places.line(mark.name).at(0.5)[1]
    elif view.square and mark is not None:
        towards, beside = places.axis(mark), places.direction(from_, at, mark)
        if towards @ beside < 0.0:
            towards = -towards
    else:
        towards = places.direction(from_, at)
    head = np.array([0.0, 0.0, 1.0])
    if abs(towards @ head) > _EYE_HEIGHT:
        head = np.array([0.0, -1.0, 0.0])
    up = head - (head @ towards) * towards
    width = view.width_mm or 0.86 * places.size_mm
    return StagedView(_numbers(at), _numbers(towards), _numbers(up / np.linalg.norm(up)), float(width))


def _hidden(show: tuple[str, ...] | None, hide: tuple[str, ...] | None, places: CasePlaces) -> tuple[int, ...]:
    labels = places.case.manifest.labels
    named = hide if hide is not None else show
    if named is None:
        return ()
    own = [name for name in named if known_name(name, (CUT_FACES_NAME,)) is None]
    found = {value for name in own for value in labels_meant(name, labels)}
    if hide is not None:
        return tuple(sorted(found | ({CUT_FACES} if len(own) < len(named) else set())))
    # walls of incisions are shown with whatever is cut
    return tuple(sorted({label.value for label in labels} - found - set(grown_septa(own, labels))))


def _numbers(vector: Float64) -> tuple[float, float, float]:
    x, y, z = vector.tolist()
    return x, y, z
