"""Pauses of a session that is played: stretches in which nothing is held or done, which need not be watched."""

from __future__ import annotations

from heartcase.schemas.recording.suture_commands import DrawStitch
from heartcase.simulator.session.operating_session import OperatingSession

__all__ = ["PAUSE_S", "SHOWN_S", "pause_end"]

PAUSE_S = 2.0
"""Nothing is a pause that is no longer, simulated s."""
SHOWN_S = 0.5
"""How much of a pause is shown at its beginning, where tissue may still move, and at its end, simulated s."""


def pause_end(session: OperatingSession) -> int | None:
    """Where a pause that the session is in is shown again, as the number of entries that are done there.

    Parameters
    ----------
    session
        A session of which more is known than is done.

    Returns
    -------
    int or None
        None where it is in no pause, or at its beginning or end.
    """
    entries, position = session.entries, session.position
    if session.simulation.instruments or session.is_on_the_way or position >= len(entries):
        return None
    step_s = session.simulation.step_s
    # what is led needs an instrument, and all else is found without reading
    later, earlier = entries.places_of(object, position), entries.places_of(object, end=position)
    stop = later[0] if later else len(entries)
    began = entries[earlier[-1]].step if earlier else session.start_step
    ended = entries[stop].step if later else session.end_step
    if (ended - began) * step_s <= PAUSE_S or (session.step_count - began) * step_s < SHOWN_S:
        return None
    shown = entries.first_beyond(ended - round(SHOWN_S / step_s))
    # a thread can be drawn while nothing is held
    if shown <= position or entries.has_any((DrawStitch,), position, stop):
        return None
    return shown
