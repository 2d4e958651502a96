"""A tour's commands run on a session without anybody who looks: to check a tour, and for the file that replays it."""

from __future__ import annotations

from collections.abc import Callable, Iterable

from heartcase.schemas.errors import SimulationError
from heartcase.schemas.recording.commands import LeadGrab, MoveProbe
from heartcase.schemas.touring.tour import Wait
from heartcase.simulator.live.goals import Goals
from heartcase.simulator.live.instrument_places import places_mm
from heartcase.simulator.session.frame import Frame
from heartcase.simulator.session.operating_session import OperatingSession
from heartcase.simulator.touring.staging import Timed

__all__ = ["run_timed"]


def run_timed(
    session: OperatingSession,
    timed: Iterable[Timed],
    *,
    frame_s: float = 0.025,
    on_frame: Callable[[Frame], None] | None = None,
) -> None:
    """Give commands, and take steps where time goes by; what is led goes no faster than by hand.

    Parameters
    ----------
    session
        What is operated on.
    timed
        Commands, and time that goes by.
    frame_s
        Simulated time of a frame, s.
    on_frame
        Told each frame, with its surface.

    Raises
    ------
    SimulationError
        A command cannot be done, or the simulation broke down.
    """
    goals = Goals()
    step_s = session.simulation.step_s
    steps = max(1, round(frame_s / step_s))
    for one in timed:
        if isinstance(one, Wait):
            left = max(1, round(one.seconds / step_s))
            while left > 0:
                taken = min(steps, left)
                left -= taken
                given = goals.commands(places_mm(session.simulation), taken * step_s)
                frame = session.take(given, taken, surface=on_frame is not None)
                if frame.breakdown is not None:
                    raise SimulationError(frame.breakdown, place="tour")
                if on_frame is not None:
                    on_frame(frame)
        elif isinstance(one, LeadGrab | MoveProbe):
            goals.set(one)
        else:
            session.do(one)
