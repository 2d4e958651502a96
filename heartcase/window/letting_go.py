"""Which instrument lets go, and by which command."""

from __future__ import annotations

from heartcase.schemas.recording.commands import Done, OpenGrab, WithdrawProbe
from heartcase.schemas.recording.tool_commands import WithdrawScissors
from heartcase.window.live import LiveFrame

__all__ = ["letting_go"]


def letting_go(live: LiveFrame, name: str | None = None) -> Done | None:
    """The command with which an instrument lets go, or is taken away; None where there is none.

    Parameters
    ----------
    live
        The moment.
    name
        The instrument; the one that holds since last when left out.
    """
    instruments = live.frame.instruments
    if name is None:
        holding = [one.name for one in live.held] or list(instruments)
        name = holding[-1] if holding else None
    if name is None or name not in instruments:
        return None
    kind = instruments[name].kind
    if kind == "probe":
        return WithdrawProbe(name=name)
    return WithdrawScissors(name=name) if kind == "scissors" else OpenGrab(name=name)
