"""What lets go or is taken out, and by which command."""

from __future__ import annotations

import numpy as np

from heartcase.schemas.recording.commands import Done, OpenGrab, TakeOutPatch, TakeOutStitch, WithdrawProbe
from heartcase.schemas.recording.tool_commands import WithdrawScissors
from heartcase.simulator.live.live_frame import LiveFrame
from heartcase.simulator.live.rays import CutPlane
from heartcase.simulator.live.tool import Held

__all__ = ["letting_go", "removable"]


def removable(live: LiveFrame, plane: CutPlane | None = None) -> list[Held]:
    """All that can be pointed at to let it go or take it out: instruments, stitches, patches, each with its middle.

    Stitches and patches are left out where they lie beyond a ``plane`` that hides them; of those hidden in part
    the middle of the rest counts.
    """
    frame, still = live.frame, np.zeros(3)
    found = [Held(name, one.center_mm, still) for name, one in frame.instruments.items()]
    sewn = {name: one.places_mm for name, one in frame.stitches.items()}
    sewn |= {name: one.vertices_mm for name, one in frame.patches.items()}
    for name, places in sewn.items():
        shown = places if plane is None else places[plane.keeps(places)]
        if len(shown):
            found.append(Held(name, shown.mean(axis=0), still))
    return found


def letting_go(live: LiveFrame, name: str | None = None) -> Done | None:
    """The command with which something lets go, or is taken out; None where there is none.

    Parameters
    ----------
    live
        The moment.
    name
        An instrument, stitch (all of its row) or patch; the instrument that holds since last when left out.
    """
    frame = live.frame
    if name is None:
        holding = [one.name for one in live.held] or list(frame.instruments)
        name = holding[-1] if holding else None
    if name is None:
        return None
    if name in frame.stitches:
        return TakeOutStitch(name=frame.stitches[name].row or name)
    if name in frame.patches:
        return TakeOutPatch(name=name)
    if name not in frame.instruments:
        return None
    kind = frame.instruments[name].kind
    if kind == "probe":
        return WithdrawProbe(name=name)
    return WithdrawScissors(name=name) if kind == "scissors" else OpenGrab(name=name)
