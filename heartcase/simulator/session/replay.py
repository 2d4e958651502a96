"""A session that repeats a recording: played, looked at anywhere, and taken over."""

from __future__ import annotations

import math
from typing import Any, cast, get_args

import numpy as np

from heartcase.schemas.errors import Problem, RecordingError, UsageError
from heartcase.schemas.recording.commands import Cut
from heartcase.schemas.recording.reader import Recording
from heartcase.simulator.cutting.tissue_samples import TissueSamples
from heartcase.simulator.engine.backends import Backend
from heartcase.simulator.lattice.model import LatticeModel
from heartcase.simulator.lattice.moduli import ForceLaw
from heartcase.simulator.session.operating_session import SNAPSHOT_EVERY_S, OperatingSession
from heartcase.simulator.session.stored import RecordedStates, lattice_sha256
from heartcase.simulator.simulation import Simulation
from heartcase.simulator.surface.deform import PickingModel, SurfaceModel

__all__ = ["FRAMES_MAX", "check_frame_count", "frame_steps", "load_session", "refuse_deviation"]

FRAMES_MAX = 3000
"""Frames that a recording is shown in at most."""


def load_session(
    recording: Recording,
    model: LatticeModel,
    *,
    surface: SurfaceModel | None = None,
    picking: PickingModel | None = None,
    tissue: TissueSamples | None = None,
    backend: Backend | None = None,
    snapshot_every_s: float = SNAPSHOT_EVERY_S,
) -> OperatingSession:
    """A session at the start of a recording, which knows all that was done in it.

    Its ``play`` repeats the recording and compares with every stored state, ``go_to`` takes a short way to any step by
    the stored states, and any command takes over.

    Parameters
    ----------
    recording
        What :func:`heartcase.schemas.recording.reader.open_recording` gave.
    model
        The lattice of the case that was recorded, under any law: the recording states its own.
    surface, picking
        Surfaces that follow it, where they are wanted.
    tissue
        Where in its cells the tissue lies, as it was given to the simulation that was recorded.
    backend
        What steps; the recording's own when left out. Another one does not give the same bytes.
    snapshot_every_s
        Simulated time between snapshots of late, s.

    Raises
    ------
    RecordingError
        It is of another case, of a law or backend that there is not, or its first state is damaged.
    SimulationError
        The simulation cannot be set up as it was.
    """
    header = recording.header
    if lattice_sha256(model) != header.lattice_sha256:
        of = f"'{header.case_name}'" if header.case_name else "another"
        raise RecordingError(
            f"this recording is of the case {of} with {header.node_count:,} nodes, and the case given is not the same "
            f"({model.node_count:,} nodes): give the case that was recorded, not built anew in another way",
            place="case",
        )
    chosen = backend or header.backend
    problems = []
    if chosen not in get_args(Backend):
        problems.append(Problem("backend", f"there is no backend {chosen!r} in this heartcase"))
    if 0 not in recording.states:
        problems.append(Problem("recording", "its first state is missing: nothing can be repeated"))
    if problems:
        raise RecordingError(problems)
    simulation = Simulation(
        model.with_law(_law_of(recording)),
        surface=surface,
        picking=picking,
        tissue=tissue,
        step_s=header.step_s,
        pace=header.pace,
        damping_per_s=header.damping_per_s,
        gravity_m_s2=header.gravity_m_s2,
        backend=cast("Backend", chosen),
        sleep_mm=header.sleep_mm,
    )
    nothing_cut = simulation.nothing_cut()
    if nothing_cut.tissue.sha256 != header.tissue_sha256 and any(
        isinstance(entry.command, Cut) for entry in recording.entries[: recording.position]
    ):
        where = "lies inside the case's surface" if header.tissue_sha256 else "fills its cells"
        raise RecordingError(
            f"this recording cuts tissue that {where}, and other tissue was given: load the case with "
            "needs=('tissue',) and give Case.tissue, or leave it out",
            place="tissue",
        )
    states = RecordedStates(recording, simulation.model, nothing_cut, step_s=header.step_s)
    simulation.restore(states.snapshot(0))
    if simulation.step_count != header.start_step:
        raise RecordingError("its first state is of another step: the recording is damaged", place="recording")
    session = OperatingSession(simulation, snapshot_every_s=snapshot_every_s)
    session.load_history(recording.entries[: recording.position], states)
    return session


def _law_of(recording: Recording) -> ForceLaw:
    """The law of a recording; one of a newer heartcase may have settings that are not known here."""
    settings: dict[str, Any] = dict(recording.header.law)
    try:
        return ForceLaw(**settings)
    except TypeError:
        raise RecordingError("the force law has settings that this heartcase does not know", place="law") from None


def refuse_deviation(session: OperatingSession) -> None:
    """RecordingError where a session that repeats a recording did not come to the same bytes."""
    if not session.deviations:
        return
    first = session.deviations[0]
    most = max(deviation.distance_mm for deviation in session.deviations)
    raise RecordingError(
        f"the replay is not what was recorded: from step {first.step} on it differs, by up to {first.distance_mm:.3g} "
        f"mm there and {most:.3g} mm in all; another heartcase or another kind of processor recorded it",
        place="replay",
    )


def check_frame_count(recording: Recording, frames_per_second: float) -> None:
    """Refuse a recording of too many frames.

    Raises
    ------
    UsageError
        There would be more than :data:`FRAMES_MAX`.
    """
    count = round(recording.seconds * frames_per_second) + 1
    if count > FRAMES_MAX:
        most = math.floor(10.0 * (FRAMES_MAX - 2) / recording.seconds) / 10.0
        advice = f"give {most:g} or less" if most > 0.0 else "show a shorter recording"
        raise UsageError(f"{count:,} frames are more than {FRAMES_MAX:,}: {advice}", place="--frames-per-second")


def frame_steps(session: OperatingSession, frames_per_second: float) -> list[int]:
    """Steps of the frames after the first; the end of a row of steps where one is near, which then is taken once."""
    start, end = session.start_step, session.end_step
    every = 1.0 / (frames_per_second * session.simulation.step_s)
    ends = np.unique([start, *(entry.end_step for entry in session.entries), end])
    wanted = np.unique([*np.round(np.arange(start + every, end, every)).astype(int), end])
    place = np.searchsorted(ends, wanted)
    near = np.stack([ends[np.maximum(place - 1, 0)], ends[np.minimum(place, len(ends) - 1)]])
    nearest = near[np.abs(near - wanted).argmin(axis=0), np.arange(len(wanted))]
    steps = np.where(np.abs(nearest - wanted) <= every / 4, nearest, wanted)
    found: list[int] = [int(step) for step in np.unique(steps) if step > start]
    return found
