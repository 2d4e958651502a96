"""What a page does with what it has in hand, and with the session: requests that ask nothing of other pages."""

from __future__ import annotations

from collections.abc import Awaitable, Callable
from typing import Any

from heartcase.schemas.arrays import Float64
from heartcase.schemas.errors import RecordingError, UsageError
from heartcase.studio.operating.requests import (
    Act,
    Along,
    CutOpen,
    Hide,
    HoldOpen,
    Keep,
    LetGo,
    Look,
    Planned,
    Play,
    Point,
    Recordings,
    Rename,
    Resize,
    Run,
    Take,
    TakeUp,
    Wheel,
)
from heartcase.studio.operating.stage import Stage
from heartcase.studio.operating.viewer import Viewer

__all__ = ["OwnAct", "act", "met"]

OwnAct = (
    Point
    | Act
    | Take
    | Resize
    | Wheel
    | LetGo
    | Along
    | Run
    | TakeUp
    | Play
    | Keep
    | Recordings
    | Hide
    | CutOpen
    | Planned
    | HoldOpen
    | Rename
)
"""Requests of which no other page must hear."""


async def act(
    request: OwnAct, viewer: Viewer, stage: Stage, run: Callable[[Callable[[], Any]], Awaitable[Any]]
) -> dict[str, Any]:
    """Carry a request out; what else its answer says.

    Parameters
    ----------
    request
        What is asked.
    viewer
        Who asks.
    stage
        What it looks at.
    run
        Runs what takes long in a thread of its own.

    Raises
    ------
    HeartcaseError
        It cannot be done.
    """
    hands, live = viewer.hands, stage.live
    match request:
        case Point():
            return {"used": await run(lambda: _point(request, viewer))}
        case Act():
            live.do(request.command)
        case Take():
            if request.tool and request.tool not in hands.tools:
                raise UsageError(f"there is no tool {request.tool!r}", place="tool")
            hands.take(request.tool)
        case Resize():
            hands.resize(request.steps)
        case Wheel():
            return {"used": hands.wheel(request.notches)}
        case LetGo():
            if request.everything:
                return {"used": hands.let_go_of_all()}
            look = request.pointer
            pointer = None if look is None else await run(lambda: viewer.pointer(look))
            return {"used": hands.let_go(pointer)}
        case Along():
            along = {
                "undo": hands.undo,
                "redo": hands.redo,
                "back": hands.rewind,
                "tie": hands.tie,
                "abandon": hands.abandon,
            }
            along.get(request.do, hands.put_down)()
        case Run():
            live.pause(request.paused)
        case TakeUp():
            hands.take_up(request.branch)
        case Play():
            hands.play(request.speed, skips=request.skips)
        case Keep(do="spare"):
            stage.spare_a_processor()
        case Keep(do="record"):
            if live.newest.recording is not None:
                raise RecordingError("it is recorded already", place="record")
            await run(stage.record)
        case Keep():
            live.stop_recording()
        case Recordings():
            return await _recordings(stage, run)
        case Hide():
            viewer.hidden = frozenset(request.structures)
        case CutOpen():
            viewer.cut_open(request.plane)
        case Planned():
            await run(lambda: stage.cut_planned(request.incision))
        case HoldOpen():
            await run(lambda: stage.hold_open(request.incision))
        case Rename():
            await run(lambda: stage.rename(request.name, request.to))
            return await _recordings(stage, run)
    return {}


async def _recordings(stage: Stage, run: Callable[[Callable[[], Any]], Awaitable[Any]]) -> dict[str, Any]:
    return {"recordings": await run(stage.recordings), "unfinished": await run(stage.unfinished)}


def met(viewer: Viewer, look: Look | None) -> Float64:
    """Where a page's look meets the heart, LPS mm, shape (3,).

    Raises
    ------
    UsageError
        It meets nothing.
    """
    place = None if look is None else viewer.met_mm(look)
    if place is None:
        raise UsageError("the heart is not in the middle of the picture: turn it there first", place="device")
    return place


def _point(request: Point, viewer: Viewer) -> bool:
    """Use the tool in hand there; whether there was a use for it."""
    hands = viewer.hands
    if request.do != "press" and not hands.is_used:
        return False
    pointer = viewer.pointer(request.pointer)
    return {"press": hands.press, "drag": hands.drag, "release": hands.release}[request.do](pointer)
