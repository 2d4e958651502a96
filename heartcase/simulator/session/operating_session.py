"""The operating session: commands in, frames out. Scripts, recordings, windows and pages are clients of it.

Its history is a list of entries: commands, and rows of steps, each with the step at which it was given. What a session
comes to follows from that list alone, to the byte, so that going back is a snapshot and the entries since.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from functools import lru_cache
from typing import Protocol, get_args

from heartcase.schemas.arguments import finite_number, whole_number
from heartcase.schemas.errors import RecordingError, SimulationError
from heartcase.schemas.recording.branches import Branch, Branches
from heartcase.schemas.recording.commands import (
    STEPS_MAX,
    Act,
    Advance,
    Cut,
    Done,
    Entry,
    GoTo,
    Halt,
    Mark,
    Navigation,
    Redo,
    Rewind,
    Snip,
    Undo,
)
from heartcase.schemas.recording.kept_entries import KeptEntries
from heartcase.simulator.session.coming_blades import ComingBlades
from heartcase.simulator.session.frame import Frame, Refusal, TopologyChange, instrument_frames
from heartcase.simulator.session.perform import perform, refuse_others, resolved
from heartcase.simulator.session.snapshots import Snapshots
from heartcase.simulator.simulation import Simulation
from heartcase.simulator.snapshot import Snapshot

__all__ = ["SNAPSHOT_EVERY_S", "Deviation", "OperatingSession", "SessionLog", "StoredStates"]

SNAPSHOT_EVERY_S = 0.25
"""Simulated time between snapshots of late, s."""

_ACTS = get_args(Act)
# rows of as many steps are one object: a history of hours has many of them
_row = lru_cache(maxsize=1024)(lambda steps: Advance(steps=steps))
_COMMANDS = get_args(Done | Navigation)


@dataclass(frozen=True)
class Deviation:
    """Where a session did not come to what was recorded."""

    step: int
    """Step of the recorded state."""
    distance_mm: float
    """Furthest that a node is from where it was, mm."""


class StoredStates(Protocol):
    """States of a recording, by their position in its history."""

    def last_before(self, position: int) -> int | None:
        """The last position, up to this one, at which one was stored; None where there is none."""

    def snapshot(self, position: int) -> Snapshot:
        """The moment that was stored there, ready to be restored."""

    def deviation(self, position: int, simulation: Simulation) -> Deviation | None:
        """How the simulation, being there, differs from what was stored; None where it does not, or nothing was."""


class SessionLog(Protocol):
    """What writes down a session while it runs."""

    def append(self, entry: Entry) -> None:
        """An entry was done."""

    def go_to(self, position: int) -> None:
        """The session went back, or on, to where so many entries are done."""

    def keep(self, position: int, simulation: Simulation) -> None:
        """Steps were taken: a state may be stored."""


def _steps(steps: int, *, least: int) -> int:
    """A number of steps as an int, or SimulationError."""
    return whole_number(steps, "steps", least=least, most=STEPS_MAX, error=SimulationError)


class OperatingSession:
    """A simulation that is operated on: commands in, frames out, with a history.

    Clients give commands with :meth:`do`, which refuses by raising, or :meth:`take`, which tells what was refused in
    the frame. Giving one after going back leaves what had come after: it is kept as a branch, see :meth:`take_up`.

    ``entries`` are all that is known, ``position`` is how many of them are done, ``simulation`` is where that led, and
    ``deviations`` are where a session that repeats a recording did not come to what was stored.

    Parameters
    ----------
    simulation
        What is operated on, from its state now on. From here on it is the session's: reading from it is harmless, but
        what changes it must come as a command.
    snapshot_every_s
        Simulated time between snapshots of late, s; they are fewer the longer ago. Infinite keeps the start alone.

    Raises
    ------
    SimulationError
        The time between snapshots is negative.
    """

    def __init__(self, simulation: Simulation, *, snapshot_every_s: float = SNAPSHOT_EVERY_S) -> None:
        self.simulation = simulation
        self.entries = KeptEntries()
        self.position = 0
        self.deviations: list[Deviation] = []
        self.log: SessionLog | None = None
        self._on_the_way: Advance | None = None
        self._snapshots = Snapshots(snapshot_every_s / simulation.step_s)
        self._snapshots.add(0, simulation.snapshot())
        self._stored: StoredStates | None = None
        self._stored_end = 0
        self._shown_model = simulation.model
        self._changes: list[TopologyChange] = []
        self._coming = ComingBlades()
        self._branches = Branches()
        self._refused: list[Refusal] = []

    @property
    def step_count(self) -> int:
        """Steps taken since the start."""
        return self.simulation.step_count

    @property
    def start(self) -> Snapshot:
        """The moment at which the session began."""
        return self._snapshots.at(0)

    @property
    def start_step(self) -> int:
        """Step at which the session began."""
        return self.start.state.step_count

    @property
    def is_on_the_way(self) -> bool:
        """Whether it was left between the beginning and the end of a row of steps, by :meth:`go_to`."""
        return self._on_the_way is not None

    @property
    def is_as_recorded(self) -> bool:
        """Whether it came from a recording, and all that is known is in it."""
        return self._stored is not None and self._stored_end == len(self.entries)

    @property
    def end_step(self) -> int:
        """Last step that is known: behind the current one after going back."""
        if self.position == len(self.entries):
            return self.step_count
        return self.entries[-1].end_step

    @property
    def branches(self) -> tuple[Branch, ...]:
        """What was left when the session went on another way, the latest first; not what a recording has."""
        return self._branches.shown

    @property
    def marks(self) -> tuple[tuple[str, int], ...]:
        """Named moments so far: name and step."""
        done = (self.entries[at] for at in self.entries.places_of(Mark, end=self.position))
        return tuple((entry.command.name, entry.step) for entry in done if isinstance(entry.command, Mark))

    def do(self, command: Done | Navigation) -> None:
        """Do a command now.

        Raises
        ------
        SimulationError
            It is no command, or cannot be done, and nothing has changed; or of steps, the simulation broke down: the
            state before them was restored, and instruments stay where they were.
        """
        refuse_others(command, _COMMANDS)
        if isinstance(command, Cut | Snip):
            self.make_cuts(wait=True)
        match command:
            case Undo():
                self.undo()
            case Redo():
                self.redo()
            case Rewind():
                self.rewind(command.seconds)
            case GoTo():
                self.go_to(command.step)
            case _:
                self._do_now(command)

    def advance(self, steps: int, *, surface: bool = False) -> Frame:
        """Take steps, and show what came of them.

        Parameters
        ----------
        steps
            How many; at least 1.
        surface
            Whether the frame shows the visible surface.

        Raises
        ------
        SimulationError
            ``steps`` is no whole number, or less than 1; or the simulation broke down: the state before the steps was
            restored, and instruments stay where they were.
        """
        row = _row(_steps(steps, least=1))
        self.make_cuts()
        self._do_now(row)
        return self.frame(surface=surface)

    def begin_cut(self, command: Cut) -> None:
        """Begin a cut that is made as soon as it is worked out: motion goes on meanwhile.

        It meets the tissue as it is now. It is made, and stands in the history, before the first steps for which it is
        ready; that moment is recorded, so that a replay makes it then. Going back or on makes it before. One is worked
        out at a time; what a blade of one name goes on with meanwhile, from where it ended, becomes one cut.

        Raises
        ------
        SimulationError
            It is no cut, or cannot be made. What turns out only when it is worked out is told in a frame as refused.
        """
        refuse_others(command, (Cut,))
        begun = resolved(self.simulation, command)
        assert isinstance(begun, Cut)
        self._coming.add(self.simulation, command, begun)
        self._coming.start(self.simulation)

    def make_cuts(self, *, wait: bool = False) -> None:
        """Make the cuts that were begun and are ready; with ``wait`` all of them."""
        while (command := self._coming.start(self.simulation)) is not None:
            # What another change of the lattice made void need not be waited for.
            if not (wait or self.simulation.is_cut_ready or not self.simulation.coming_cuts):
                return
            self._coming.done()
            try:
                self._do_now(command)
            except SimulationError as error:
                self._refused.append(Refusal(command, error.problems))

    def take(
        self, commands: Iterable[Done | Navigation], steps: int = 0, *, surface: bool = False, cuts_soon: bool = False
    ) -> Frame:
        """Do commands, then take steps: what a client does for each of its frames.

        It raises nothing that a command or a breakdown causes: the frame tells it.

        Parameters
        ----------
        commands
            In this order; one that is refused is told in the frame, and the rest are done.
        steps
            How many steps; none leaves the time where it is.
        surface
            Whether the frame shows the visible surface.
        cuts_soon
            Whether cuts are begun (:meth:`begin_cut`) instead of made, so that no frame waits for them.

        Raises
        ------
        SimulationError
            What is given is no command, or no number of steps.
        """
        steps = _steps(steps, least=0)
        self.make_cuts()
        for command in commands:
            refuse_others(command, _COMMANDS)
            try:
                if cuts_soon and isinstance(command, Cut):
                    self.begin_cut(command)
                else:
                    self.do(command)
            except SimulationError as error:
                self._refused.append(Refusal(command, error.problems))
        breakdown = None
        if steps:
            try:
                self._do_now(_row(steps))
            except SimulationError as error:
                breakdown = error.problems[0].message
        return self.frame(surface=surface, breakdown=breakdown)

    def frame(self, *, surface: bool = False, breakdown: str | None = None) -> Frame:
        """What there is to show now, with the visible ``surface`` where asked for; ``breakdown`` is passed on."""
        simulation = self.simulation
        changes, refused = tuple(self._changes), tuple(self._refused)
        self._changes.clear()
        self._refused.clear()
        return Frame(
            step=self.step_count,
            time_s=simulation.time_s,
            model=simulation.model,
            state=simulation.state,
            surface=simulation.surface_now() if surface else None,
            instruments=instrument_frames(simulation),
            topology=changes,
            refused=refused,
            stitches={stitch.name: simulation.stitch_state(stitch) for stitch in simulation.stitches},
            patches={patch.name: simulation.patch_state(patch) for patch in simulation.patches},
            breakdown=breakdown,
            coming_cuts=len(self._coming),
        )

    def undo(self, *, together: bool = False) -> None:
        """Take back the last act and all that came after it: grabs, probes, springs; leading and moving are no acts.

        Parameters
        ----------
        together
            Whether acts that were given at one moment, one right after the other, are taken back as one, such as hands
            that hold an incision open.

        Raises
        ------
        SimulationError
            There is no act to take back.
        """
        self.make_cuts(wait=True)
        acts = self.entries.places_of(_ACTS, end=self.position)
        if not acts:
            raise SimulationError("there is nothing to take back", place="undo")
        first = acts.pop()
        while together and acts and acts[-1] == first - 1:
            first = acts.pop()
        self._go_to(first)

    def redo(self, *, together: bool = False) -> None:
        """Do again what was taken back last, up to the next act: the same, to the byte.

        Parameters
        ----------
        together
            As of :meth:`undo`.

        Raises
        ------
        SimulationError
            Nothing was taken back, or something else was done since.
        """
        self.make_cuts(wait=True)
        if self.position == len(self.entries):
            raise SimulationError("there is nothing to do again", place="redo")
        done = self.position + 1
        later = self.entries.places_of(_ACTS, done)
        while together and later and later[0] == done:
            done = later.pop(0) + 1
        self._go_to(later[0] if later else len(self.entries))

    def rewind(self, seconds: float) -> None:
        """Go back so far in simulated time, s, or to the start where that is later.

        Raises
        ------
        SimulationError
            The time is no finite number, or below 0.
        """
        seconds = finite_number(seconds, "seconds", least=0.0, error=SimulationError)
        self.go_to(max(self.start_step, self.step_count - round(seconds / self.simulation.step_s)))

    def go_to(self, step: int) -> None:
        """Go to a step, back or on, of what is known; what was given at that step is done by then.

        Raises
        ------
        SimulationError
            The step is not known.
        """
        step = whole_number(step, "step", error=SimulationError)
        self.make_cuts(wait=True)
        first, last = self.start_step, self.end_step
        if not first <= step <= last:
            raise SimulationError(f"step {step} is not known: there are {first} to {last}", place="step")
        self._go_to(self.entries.first_beyond(step))
        if self.step_count < step:
            row = self.entries[self.position].command
            assert isinstance(row, Advance)
            part = Advance(steps=step - self.step_count, of=row.of or row.steps)
            self._perform(part)
            self._on_the_way = part

    def play(self, to_step: int | None = None, *, surface: bool = False) -> Iterator[Frame]:
        """Do again, entry by entry, what is known from here on, with a frame for each row of steps.

        Where the session comes from a recording, what it comes to is compared with each state that was stored; see
        ``deviations``.

        Parameters
        ----------
        to_step
            Where to end; at the end of what is known when left out.
        surface
            Whether the frames show the visible surface.

        Raises
        ------
        SimulationError
            The step is not known, or earlier than where the session is.
        """
        self.make_cuts(wait=True)
        to_step = self.end_step if to_step is None else whole_number(to_step, "step", error=SimulationError)
        if not self.step_count <= to_step <= self.end_step:
            message = f"step {to_step} cannot be played to: there are {self.step_count} to {self.end_step}"
            raise SimulationError(message, place="step")
        if self._on_the_way is not None:
            self.go_to(min(self.entries[self.position].end_step, to_step))
            yield self.frame(surface=surface)
        while self.position < len(self.entries) and self.entries[self.position].end_step <= to_step:
            command = self.entries[self.position].command
            self._go_to(self.position + 1)
            if isinstance(command, Advance):
                yield self.frame(surface=surface)
        if self.step_count < to_step:
            self.go_to(to_step)
            yield self.frame(surface=surface)

    def skip_towards(self, position: int) -> bool:
        """Go on towards where so many entries are done as far as a snapshot or a stored state leads, without a step.

        Parameters
        ----------
        position
            Entries that are done there; no more than are known.

        Returns
        -------
        bool
            Whether there was one: what comes next is the same, to the byte, as without this.
        """
        if self._on_the_way is not None or (found := self._snapshot_before(position)) <= self.position:
            return False
        self._go_to(found)
        return True

    def snapshot_positions(self) -> frozenset[int]:
        """Places in the history, by the number of entries done, of which there is a snapshot."""
        return self._snapshots.positions

    def snapshot_at(self, position: int) -> Snapshot:
        """The snapshot of one of these places."""
        return self._snapshots.at(position)

    def forget_ahead(self) -> None:
        """Drop what is known from here on for good: it is no branch."""
        if self.position < len(self.entries):
            self._branches.forget(self.position)
            self._drop_ahead(self.step_count, keeps=False)

    def take_up(self, number: int) -> None:
        """Go back to where a branch begins; what it holds is known ahead from there, and to be done again.

        What is known ahead now is left, and so a branch from here on.

        Parameters
        ----------
        number
            Of one of ``branches``.

        Raises
        ------
        SimulationError
            There is no such branch.
        """
        self.make_cuts(wait=True)
        self._take_up(self._branches.at(whole_number(number, "branch", error=SimulationError)))
        # not before: it might be one of the oldest itself
        self._branches.trim()

    def _take_up(self, branch: Branch) -> None:
        if branch.on is not None:
            # its beginning lies on another one
            self._take_up(self._branches.at(branch.on))
        position = branch.position
        self._go_to(position)
        if position < len(self.entries):
            self._drop_ahead(self.step_count)
        self._branches.take(branch.number)
        for entry in branch.entries:
            self.entries.append(entry)
            if (log := self.log) is not None:
                log.append(entry)
        if (log := self.log) is not None:
            log.go_to(position)

    def load_history(self, entries: Iterable[Entry], stored: StoredStates) -> None:
        """Take over what a recording holds as what is known; the session stays at its start.

        Parameters
        ----------
        entries
            What was done.
        stored
            States on the way, to begin from and to compare with.

        Raises
        ------
        RecordingError
            The session has a history already.
        """
        if self.entries:
            raise RecordingError("the session has a history already: load a recording into a new one", place="session")
        self.entries = KeptEntries(entries)
        self._stored, self._stored_end = stored, len(self.entries)
        self._compare()

    def _do_now(self, command: Done) -> None:
        """Do a command that goes into the history; what was known behind it is left, if it is done."""
        command = resolved(self.simulation, command)
        step, snapshots = self.step_count, self._snapshots
        before = self.simulation.snapshot() if isinstance(command, _ACTS) and snapshots.wants_any else None
        try:
            self._perform(command)
        except SimulationError:
            # A breakdown halts the instruments: a replay must do so too.
            if isinstance(command, Advance) and (self.simulation.instruments or self.simulation.stitches):
                self._append(step, Halt())
            raise
        if before is not None and self._on_the_way is None:
            snapshots.forget_after(self.position)
            snapshots.add(self.position, before)
        self._append(step, command)
        if isinstance(command, Advance) and snapshots.is_due(self.position, self.step_count):
            snapshots.add(self.position, self.simulation.snapshot())

    def _append(self, step: int, command: Done) -> None:
        """Put what was done into the history."""
        if self.position < len(self.entries):
            self._drop_ahead(step)
            self._branches.trim()
        self._write(Entry(step=step, command=command))

    def _drop_ahead(self, step: int, *, keeps: bool = True) -> None:
        """Leave what is known from here on; between the ends of a row, the row ends here, at this step."""
        part, self._on_the_way = self._on_the_way, None
        if keeps:
            self._branches.keep(self.entries, self.position, is_recorded=self.is_as_recorded)
        self.entries.drop_from(self.position)
        self._snapshots.forget_after(self.position)
        self._stored_end = min(self._stored_end, self.position)
        if part is not None:
            # the simulation may be beyond its end already: there is no state of that to keep
            self._write(Entry(step=step - part.steps, command=part), keeps_state=False)

    def _write(self, entry: Entry, *, keeps_state: bool = True) -> None:
        self.entries.append(entry)
        self.position += 1
        # A log that cannot be written any more leaves the session meanwhile.
        if (log := self.log) is not None:
            log.append(entry)
            if keeps_state and isinstance(entry.command, Advance):
                log.keep(self.position, self.simulation)

    def _go_to(self, position: int) -> None:
        """Go to where so many entries of the history are done."""
        has_moved = position != self.position
        if self._on_the_way is not None or not self._is_near(position):
            self._restore_before(position)
        while self.position < position:
            self._perform(self.entries[self.position].command)
            self.position += 1
            self._compare()
            if self._snapshots.is_due(self.position, self.step_count):
                self._snapshots.add(self.position, self.simulation.snapshot())
        if has_moved and self.log is not None:
            self.log.go_to(position)

    def _is_near(self, position: int) -> bool:
        """Whether going on from here is no longer than from a snapshot."""
        if self.position > position:
            return False
        return position == self.position + 1 or self._snapshot_before(position) <= self.position

    def _snapshot_before(self, position: int) -> int:
        stored = None if self._stored is None else self._stored.last_before(min(position, self._stored_end))
        return max(self._snapshots.last_before(position), -1 if stored is None else stored)

    def _restore_before(self, position: int) -> None:
        kept, found = self._snapshots.last_before(position), self._snapshot_before(position)
        if found > kept and self._stored is not None:
            snapshot = self._stored.snapshot(found)
            self._snapshots.add(found, snapshot)
        else:
            snapshot = self._snapshots.at(found)
        self.simulation.restore(snapshot)
        self._on_the_way = None
        self.position = found
        self._note_change("history")

    def _perform(self, command: Done) -> None:
        perform(self.simulation, command)
        self._note_change(command.kind)

    def _note_change(self, kind: str) -> None:
        model = self.simulation.model
        if model is not self._shown_model:
            self._shown_model = model
            self._changes.append(TopologyChange.to(model, kind))

    def _compare(self) -> None:
        if self._stored is None or self.position > self._stored_end:
            return
        found = self._stored.deviation(self.position, self.simulation)
        if found is not None:
            self.deviations.append(found)
