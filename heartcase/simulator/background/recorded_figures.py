"""Figures of the incision of a recording, at the last moment when the most that ever held it open did."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from math import inf

from heartcase.schemas.errors import SimulationError
from heartcase.schemas.recording.commands import (
    BringProbe,
    BringScissors,
    CloseForceps,
    CloseGrab,
    CloseRetractor,
    Cut,
    Entry,
    OpenGrab,
    WithdrawProbe,
    WithdrawScissors,
)
from heartcase.schemas.recording.reader import Recording
from heartcase.schemas.scripts.incision_plans import ShaftSettings
from heartcase.simulator.background.figures_worker import LiveFigures, figures_of
from heartcase.simulator.incisions.stated_defects import landmarks_with_defects
from heartcase.simulator.live.cuts_done import Moment
from heartcase.simulator.live.live_frame import moment_of
from heartcase.simulator.load import Case
from heartcase.simulator.session.operating_session import OperatingSession
from heartcase.simulator.session.replay import load_session

__all__ = ["figures_of_recording", "moments_of_incision"]

_HOLDS = CloseGrab | CloseForceps | CloseRetractor
_COMES = BringProbe | BringScissors
_GOES = OpenGrab | WithdrawProbe | WithdrawScissors


def moments_of_incision(entries: Sequence[Entry]) -> tuple[int, int | None]:
    """When an incision was last held by the most that ever held it, and when it was last free before that.

    Both are numbers of entries that are done by then. What was never held is taken at its end; None where it was at no
    moment free of instruments.

    Parameters
    ----------
    entries
        What was done.

    Raises
    ------
    SimulationError
        Nothing was cut.
    """
    holding: set[str] = set()
    others: set[str] = set()
    is_cut, most = False, 0
    held: int | None = None
    free: list[int] = []
    for number, entry in enumerate((*entries, None)):
        if is_cut and len(holding) >= max(most, 1):
            held, most = number, len(holding)
        if is_cut and not holding and not others:
            free.append(number)
        command = None if entry is None else entry.command
        if isinstance(command, Cut):
            is_cut = True
        elif isinstance(command, _HOLDS):
            holding.add(command.name)
        elif isinstance(command, _COMES):
            others.add(command.name)
        elif isinstance(command, _GOES):
            holding.discard(command.name)
            others.discard(command.name)
    if not is_cut:
        raise SimulationError("nothing is cut in it: there is no incision", place="recording")
    moment = len(entries) if held is None else held
    return moment, max((one for one in free if one <= moment), default=None)


def figures_of_recording(
    case: Case,
    recording: Recording,
    *,
    incision: int = 0,
    shaft: ShaftSettings | None = None,
    reaches: bool = True,
) -> LiveFigures:
    """Figures of one of the cuts of a recording as it was held open.

    Parameters
    ----------
    case
        The case that was recorded, loaded with its surface and tissue.
    recording
        The recording.
    incision
        Which of the cuts, from 0; the last where there are fewer.
    shaft, reaches
        As of :func:`heartcase.simulator.background.figures_worker.figures_of`.

    Raises
    ------
    HeartcaseError
        It is of another case, or nothing is cut in it.
    """
    held, free = moments_of_incision(recording.entries[: recording.position])
    unheld = None if free is None else _at(case, recording, free)
    session = _at(case, recording, held)
    cuts = tuple(one.command for one in session.entries if isinstance(one.command, Cut))
    live = replace(moment_of(session), cuts=cuts, unheld=None if unheld is None else _moment(unheld))
    start = load_session(recording, case.model, surface=case.surface, tissue=case.tissue, snapshot_every_s=inf)
    whole = _moment(start).heart
    landmarks = landmarks_with_defects(case.manifest)
    return figures_of(live, whole, landmarks, min(incision, len(cuts) - 1), shaft=shaft, reaches=reaches)


def _at(case: Case, recording: Recording, position: int) -> OperatingSession:
    """A session where so many entries of a recording are done."""
    part = replace(recording, position=position)
    session = load_session(part, case.model, surface=case.surface, tissue=case.tissue, snapshot_every_s=inf)
    session.go_to(session.end_step)
    return session


def _moment(session: OperatingSession) -> Moment:
    simulation = session.simulation
    assert simulation.surface is not None
    return Moment(simulation.model, simulation.surface, simulation.state.displacement.copy())
