"""Recording a session while it runs: what is done is on disk at once, so that a killed program leaves what it had."""

from __future__ import annotations

import contextlib
import os
import shutil
from collections.abc import Callable, Iterator
from dataclasses import asdict, dataclass
from hashlib import sha256
from pathlib import Path
from types import TracebackType
from typing import BinaryIO

import numpy as np

from heartcase import __version__
from heartcase.schemas.bundle.format import CaseManifest
from heartcase.schemas.bundle.placing import refuse_inside_case
from heartcase.schemas.errors import HeartcaseError, Problem, RecordingError
from heartcase.schemas.files import atomic_write
from heartcase.schemas.recording.commands import Entry
from heartcase.schemas.recording.header import (
    HEADER_NAME,
    LOG_NAME,
    RecordingEnd,
    RecordingHeader,
    RecordingParent,
    header_bytes,
    header_hash,
)
from heartcase.schemas.recording.log import GoToLine, Line, StateLine, sealed
from heartcase.simulator.session.operating_session import OperatingSession
from heartcase.simulator.session.stored import lattice_sha256, snapshot_bytes
from heartcase.simulator.simulation import Simulation
from heartcase.simulator.snapshot import Snapshot

__all__ = ["STATE_EVERY_S", "Recorder"]

STATE_EVERY_S = 1.0
"""Simulated time between stored states, s."""


@dataclass(frozen=True)
class _Written:
    """The lines of the log that are whole on disk, and what they say: replaced as one, whenever it is interrupted."""

    line_count: int
    size: int
    """Their bytes."""
    link: str
    """Of the last of them."""
    end_step: int
    """Step at which they end."""
    state_count: int
    """States that they name."""


class Recorder:
    """Writes a session into a folder, from its start on, until it is finished.

    ::

        lowest = case.surface.rest_mm[case.surface.rest_mm[:, 2].argmin()]  # nearest the feet
        with Recorder(session, "pull.recording", case=case.manifest):
            session.do(CloseGrab(name="lift", center_mm=lowest))
            session.advance(100)

    Every command is on disk when it is done. Leaving the block finishes the recording, also where an error ends it;
    where it is broken off, as by Ctrl-C, it ends with what was done by then.
    ``error`` is why it could not be written any more; None while it can.

    Parameters
    ----------
    session
        The session; what it did before is written first.
    path
        The folder, ``NAME.recording``; nothing may be there yet.
    case
        What the case says of itself, for its name and identifier.
    state_every_s
        Simulated time between stored states, s: what a replay is compared with, and may begin from.
    parent
        Where the session took over from another recording: what its ``branch_at`` gives.
    failed
        Called when it cannot be written any more, as on a full disk: the recording has ended then, and the session goes
        on. When left out, what is done raises a :class:`RecordingError` then, and the session is of no more use.

    Raises
    ------
    RecordingError
        There is something at the path, its folder does not exist or cannot be written, the session began with a
        lattice that was cut or joined, the case is another, the time between states is not above 0, or the session was
        never at the step where it took over. Nothing is left at the path but what was there.
    UsageError
        The path lies in a case.
    """

    def __init__(
        self,
        session: OperatingSession,
        path: Path | str,
        *,
        case: CaseManifest | None = None,
        state_every_s: float = STATE_EVERY_S,
        parent: RecordingParent | None = None,
        failed: Callable[[RecordingError], None] | None = None,
    ) -> None:
        if session.log is not None:
            raise RecordingError("the session is being recorded already", place="recording")
        start = session.start
        if start.model.explicit.count or not start.model.cell_is_whole.all() or start.cuts is not None:
            raise RecordingError("the session began with a lattice that was cut or joined: record from before that")
        _check(session, case, state_every_s, parent)
        self.path = Path(path)
        self._session = session
        self._state_steps = max(1.0, state_every_s / session.simulation.step_s)
        self._state_step = start.state.step_count
        self._is_stored = self._is_sealed = False
        self._header = _header(session.simulation, start, case, parent)
        self._written = _Written(0, 0, header_hash(self._header), start.state.step_count, 0)
        self.error: RecordingError | None = None
        self._failed: Callable[[RecordingError], None] | None = None
        self._log: BinaryIO | None = None
        self._make_folder()
        try:
            with self._writing():
                atomic_write(self.path / HEADER_NAME, header_bytes(self._header))
                self._log = (self.path / LOG_NAME).open("xb")
                self._write_past()
        except RecordingError:
            self.discard()
            raise
        self._failed = failed
        session.log = self

    def append(self, entry: Entry) -> None:
        """Write down what was done."""
        with self._writing():
            self._write(entry, entry.end_step)
        self._is_stored = False

    def go_to(self, position: int) -> None:
        """Write down that the session went back, or on."""
        with self._writing():
            self._write(GoToLine(to=position), self._session.step_count)
        self._state_step = self._session.step_count
        self._is_stored = False

    def keep(self, position: int, simulation: Simulation) -> None:
        """Store the state of the ``simulation``, where so many entries (``position``) are done, if it is time."""
        if self._log is not None and simulation.step_count - self._state_step >= self._state_steps:
            with self._writing():
                self._store(simulation.snapshot())

    def finish(self) -> None:
        """Store the last state, and seal the recording; a second time does nothing."""
        if self._log is None:
            return
        session = self._session
        with self._writing():
            if not (self._is_stored or session.is_on_the_way):
                self._store(session.simulation.snapshot())
            self._seal(session.step_count)

    @property
    def seconds(self) -> float:
        """Simulated time from the session's start to where what is written ends, s."""
        return (self._written.end_step - self._header.start_step) * self._header.step_s

    def break_off(self) -> None:
        """Seal what was done by now where the session was interrupted in the middle of something.

        Nothing of that is in the recording, nor any state of now: what is repeated is what stands in the log.
        """
        if self._is_sealed or self.error is not None:
            return
        with self._writing():
            self._close()
            os.truncate(self.path / LOG_NAME, self._written.size)
            (self.path / _state_name(self._written.state_count)).unlink(missing_ok=True)
            self._seal(self._written.end_step)

    def end_early(self, error: BaseException) -> None:
        """Finish, or break off where what ended the session may have left it in the middle of something.

        Where that cannot be written, ``self.error`` says so and nothing is raised: what is told is the ``error``.
        """
        with contextlib.suppress(RecordingError):
            if isinstance(error, HeartcaseError):
                self.finish()
            else:
                self.break_off()

    def discard(self) -> None:
        """Stop, and leave nothing behind."""
        with contextlib.suppress(OSError):
            self._close()
        with contextlib.suppress(OSError):
            shutil.rmtree(self.path)

    def __enter__(self) -> Recorder:
        """The recorder itself, which is at work already."""
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """Finish, or end early."""
        if error is None:
            self.finish()
        else:
            self.end_early(error)

    def _seal(self, step: int) -> None:
        self._close()
        end = RecordingEnd(line_count=self._written.line_count, log_hash=self._written.link, step=step)
        atomic_write(self.path / HEADER_NAME, header_bytes(self._header.model_copy(update={"end": end})))
        self._is_sealed = True

    def _make_folder(self) -> None:
        refuse_inside_case(self.path, place="out")
        try:
            self.path.mkdir()
        except FileExistsError:
            raise RecordingError("there is something at this path already: take another name", place="out") from None
        except ValueError:
            raise RecordingError("the path holds a character that no path may hold", place="out") from None
        except FileNotFoundError:
            raise RecordingError("the folder of this path does not exist: make it first", place="out") from None
        except OSError as error:
            raise _unwritable(error) from None

    @contextlib.contextmanager
    def _writing(self) -> Iterator[None]:
        """What the system refuses ends the recording: told to who wants to hear of it, or raised."""
        try:
            yield
        except OSError as error:
            with contextlib.suppress(OSError):
                self._close()
            self.error = _unwritable(error)
            if self._failed is None:
                raise self.error from None
            self._failed(self.error)

    def _write_past(self) -> None:
        """What the session did before it was recorded, with some of its snapshots."""
        session = self._session
        self._store(session.start)
        kept = session.snapshot_positions()
        for number, entry in enumerate(session.entries, start=1):
            self.append(entry)
            if number in kept and entry.end_step - self._state_step >= self._state_steps:
                self._store(session.snapshot_at(number))
        if session.position < len(session.entries):
            self.go_to(session.position)

    def _store(self, snapshot: Snapshot) -> None:
        content = snapshot_bytes(snapshot)
        name = _state_name(self._written.state_count)
        atomic_write(self.path / name, content)
        step = snapshot.state.step_count
        line = StateLine(step=step, file=name, size=len(content), sha256=sha256(content).hexdigest())
        self._write(line, self._written.end_step)
        self._state_step, self._is_stored = step, True

    def _write(self, line: Line, end_step: int) -> None:
        """Write a line after which the log ends at this step."""
        if self._log is None:
            return
        written = self._written
        content, link = sealed(line, written.link)
        self._log.write(content)
        self._log.flush()
        size, states = written.size + len(content), written.state_count + isinstance(line, StateLine)
        self._written = _Written(written.line_count + 1, size, link, end_step, states)

    def _close(self) -> None:
        self._session.log = None
        log, self._log = self._log, None
        if log is not None:
            with contextlib.suppress(OSError):
                os.fsync(log.fileno())
            log.close()


def _check(
    session: OperatingSession, case: CaseManifest | None, state_every_s: float, parent: RecordingParent | None
) -> None:
    """Refuse what a recording would say wrongly of its session."""
    model, problems = session.start.model, []
    if case is not None:
        is_same = case.simulation.node_count == model.node_count - model.loose_count
        if not (is_same and np.allclose(case.grid_geometry.affine, model.geometry.affine, atol=1e-3)):
            problems.append(
                Problem("case", f"the session moves another lattice than that of {case.name!r}: give its own")
            )
    if not state_every_s > 0.0:
        problems.append(Problem("state_every_s", f"{state_every_s:g} s between states: give more than 0"))
    first, last = session.start.state.step_count, session.step_count
    if parent is not None and not first <= parent.step <= last:
        problems.append(
            Problem("parent", f"the session went from step {first} to {last} and took over at none like {parent.step}")
        )
    if problems:
        raise RecordingError(problems)


def _state_name(number: int) -> str:
    return f"state-{number:06d}.safetensors"


def _unwritable(error: OSError) -> RecordingError:
    return RecordingError(f"cannot be written: {error.strerror or type(error).__name__}", place="recording")


def _header(
    simulation: Simulation, start: Snapshot, case: CaseManifest | None, parent: RecordingParent | None
) -> RecordingHeader:
    return RecordingHeader(
        software_version=__version__,
        case_name=None if case is None else case.name,
        case_id=None if case is None else case.case_id,
        lattice_sha256=lattice_sha256(start.model),
        tissue_sha256=simulation.nothing_cut().tissue.sha256,
        node_count=start.model.node_count,
        cell_mm=start.model.cell_mm,
        law=asdict(start.model.law),
        step_s=simulation.step_s,
        pace=simulation.pace,
        damping_per_s=simulation.damping_per_s,
        gravity_m_s2=simulation.gravity_m_s2,
        backend=simulation.backend,
        sleep_mm=simulation.sleep_mm,
        start_step=start.state.step_count,
        parent=parent,
    )
