"""A session that runs in a thread of its own: commands go in at any time, and the newest frame can be had at any time.

It keeps real time where the machine can. Where it cannot, it takes as many steps a frame as there is time for, and time
goes slower: what is shown stays fluid, and nothing is left out.
"""

from __future__ import annotations

import threading
import time
from collections import deque
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import Future
from dataclasses import replace
from pathlib import Path
from typing import get_args

import numba

from heartcase.schemas.bundle.format import CaseManifest
from heartcase.schemas.errors import HeartcaseError, Problem, RecordingError, SimulationError
from heartcase.schemas.recording.commands import (
    BringProbe,
    Cut,
    Done,
    LeadGrab,
    MoveProbe,
    Navigation,
    OpenGrab,
    Redo,
    Undo,
    WithdrawProbe,
)
from heartcase.simulator.live.cuts_done import ActMarks, CutsDone, Kept
from heartcase.simulator.live.goals import SOFT_SPEED_MM_S, Goals, places_mm
from heartcase.simulator.live.live_frame import LiveFrame, moment_of
from heartcase.simulator.live.pauses import pause_end
from heartcase.simulator.session.frame import Frame
from heartcase.simulator.session.operating_session import OperatingSession
from heartcase.simulator.session.recorder import Recorder

__all__ = ["FRAME_S", "Live"]

FRAME_S = 1.0 / 40.0
"""Time from frame to frame where the machine keeps up, s."""
Taker = Callable[[OperatingSession, int, Callable[[float], list[Done]]], Frame]
"""Takes so many steps of a session; what leads its instruments for so many seconds is asked for."""
_NAVIGATION = get_args(Navigation)
_STEPS_LEAST = 0.4
"""Part of a frame's steps that is taken however long they take: time goes on."""
_STEPS_DOWN, _STEPS_UP = 0.7, 1.15
"""How much fewer, or more, steps a frame may take than the one before."""
_MEASURED_S = 1.0
"""Over how long the pace is measured, s."""
_JOIN_S = 60.0
"""How long a frame may take at most to end before its thread is given up, s: a rewind works out some seconds again."""


class Live:
    """Runs a session in a thread of its own.

    ``newest`` is the frame to show, and ``take_messages`` gives what a user should read. All methods may be called from
    any thread; ``close`` ends the thread, and finishes a recording. ``played_speed`` is that of playing, ``has_ended``
    says that the thread is done with the session.

    Parameters
    ----------
    session
        The session, with a surface. From :meth:`start` to :meth:`close` nobody else may use it.
    manifest
        What the case says of itself, for recordings.
    frame_s
        Time from frame to frame where the machine keeps up, s.
    slowest
        How many times longer a frame may take where it does not: the time is for steps.
    shows_surface
        Whether frames have the surface; what places it itself does without.
    heard
        Called by the session's thread whenever there is a new frame, or the thread ended; it must return at once.
    """

    def __init__(
        self,
        session: OperatingSession,
        *,
        manifest: CaseManifest | None = None,
        frame_s: float = FRAME_S,
        slowest: float = 2.5,
        shows_surface: bool = True,
        heard: Callable[[], None] = lambda: None,
    ) -> None:
        self.session = session
        self.error: BaseException | None = None
        self._manifest = manifest
        self._frame_s = frame_s
        self._slowest = slowest
        self._shows_surface = shows_surface
        self._heard = heard
        self._goals = Goals()
        self._leaving: dict[str, Done] = {}
        self._asked: deque[Done | Navigation | Callable[[], None]] = deque()
        self._messages: deque[Problem] = deque()
        self._wake = threading.Condition()
        self._is_closing = False
        self.has_ended = False
        self._thread: threading.Thread | None = None
        self._recorder: Recorder | None = None
        self._played: Iterator[Frame] | None = None
        self.played_speed = 1.0
        self._skips = False
        self._mode = "running"
        self._steps_most = frame_s / session.simulation.step_s
        self._ticked: float | None = None
        self._part = 0.0
        self._past: deque[tuple[float, int]] = deque()
        self._cuts_done = CutsDone()
        self._act_marks = ActMarks()
        self._kept = Kept()
        self._taker: Taker | None = None
        self.newest = self._published(session.frame(surface=self._shows_surface))

    def start(self) -> None:
        """Begin to run."""
        self._thread = threading.Thread(target=self._run, name="physics", daemon=True)
        self._thread.start()

    def close(self) -> None:
        """End the thread after the frame that it is at, and finish what is recorded; a second time does nothing."""
        with self._wake:
            self._is_closing = True
            self._wake.notify_all()
        if self._thread is not None:
            self._thread.join(_JOIN_S)
            self._thread = None
        else:
            self._end()

    def do(self, *commands: Done | Navigation) -> None:
        """Ask for commands; they are done before the next steps. What is refused is told as a message."""
        self._ask(commands)

    def asked(self, command: Done | Navigation | None) -> Future[None]:
        """Ask for a command; what comes of it: done, or the error for which it was refused. A cut is begun.

        None asks for nothing: it comes when all that was asked for before is done.

        One that is cancelled before it is its turn is not done.
        """
        found: Future[None] = Future()

        def work() -> None:
            # Whoever asked may have given it up by now.
            if not found.set_running_or_notify_cancel():
                return
            try:
                if command is not None:
                    self._do(command)
            except BaseException as error:
                found.set_exception(error)
                if not isinstance(error, HeartcaseError):
                    raise
            else:
                found.set_result(None)

        self._ask([work])
        return found

    def lead(self, command: LeadGrab | MoveProbe, speed_mm_s: float) -> None:
        """Lead an instrument there no faster than so, mm for each simulated second."""
        self._ask([lambda: self._goals.set(command, speed_mm_s)])

    def pause(self, is_paused: bool) -> None:
        """Let time stand, or go on from here: then what was known ahead is a branch after the next steps."""
        self._ask([lambda: self._set_mode("paused" if is_paused else "running")])

    def take_up(self, branch: int) -> None:
        """Go back to where a branch begins, with what it holds known ahead, and let time stand there.

        Parameters
        ----------
        branch
            Its number.
        """
        self._ask([lambda: self._take_up(branch)])

    def forget_ahead(self) -> None:
        """Drop what is known from here on for good."""
        self._ask([self.session.forget_ahead])

    def play(self, speed: float = 1.0, *, skips: bool = False) -> None:
        """Do again what is known from here on, and then pause; an act takes over.

        Parameters
        ----------
        speed
            Simulated time for each time that goes by, above 0; where the machine is slower than that, as fast as it is.
        skips
            Whether stretches are passed over in which nothing is held or done for more than 2 s, all but half a second
            at each end. What has no state stored on the way is stepped through, as fast as the machine can.
        """
        self._ask([lambda: self._begin_to_play(speed, skips)])

    def record(self, path: Path) -> None:
        """Record into a folder, from the session's start on, until :meth:`stop_recording` or :meth:`close`."""
        self._ask([lambda: self._begin_to_record(path)])

    def make_cuts(self) -> None:
        """Make the cuts that were begun, also while time stands."""
        self._ask([lambda: self.session.make_cuts(wait=True)])

    def settle(self, seconds: float) -> None:
        """Wait until all is done that was asked for by now, but no longer than so, s."""
        self._ask([(done := threading.Event()).set])
        done.wait(seconds)

    def stop_recording(self) -> None:
        """Finish the recording."""
        self._ask([self._finish_recording])

    def let_go_softly(self, name: str) -> None:
        """Nobody leads an instrument any more: it stays, is brought back to where it came from slowly, and lets go.

        Parameters
        ----------
        name
            A hand or a probe. Where there is none of that name nothing happens.
        """
        self._ask([lambda: self._begin_to_leave(name)])

    @property
    def is_leaving(self) -> bool:
        """Whether something lets go softly and is not done with it."""
        return bool(self._leaving) or bool(self._asked)

    @property
    def is_kept(self) -> bool:
        """Whether all acts of the history are in a finished recording, or there are none; branches do not count."""
        return self._kept.is_all_of(self.session)

    def take_by(self, taker: Taker | None) -> None:
        """Let the steps of each frame be taken by another, as for a haptic device; by the session itself for None."""
        self._ask([lambda: setattr(self, "_taker", taker)])

    def tell(self, said: Problem) -> None:
        """Let a user read this; what it is about is its place."""
        self._messages.append(said)

    def take_messages(self) -> list[Problem]:
        """What there is to be read since the last time; not all of it is wrong."""
        found = []
        while self._messages:
            found.append(self._messages.popleft())
        return found

    def spare_a_processor(self) -> None:
        """Leave a processor to what draws: threads of a step that wait for one another would wait for it each time."""
        self._ask([lambda: numba.set_num_threads(max(1, numba.get_num_threads() - 1))])

    def tick(self) -> None:
        """One frame: do what was asked for, take steps, publish. The thread does nothing else; tests do it without."""
        self._leave()
        has_work = self._do_asked()
        if self._mode == "playing":
            self._play_on()
        elif self._mode == "running":
            began = time.perf_counter()
            steps = self._steps_due(self._frame_s if self._ticked is None else began - self._ticked)
            self._ticked = began
            frame = self._taken(steps)
            for refusal in frame.refused:
                self._messages.extend(refusal.problems)
            if frame.breakdown is not None:
                self._goals.drop()
                self._messages.append(Problem("simulation", frame.breakdown))
            self._measure()
            self._publish(frame)
            self._learn(time.perf_counter() - began)
        elif has_work:
            self._publish(self.session.frame(surface=self._shows_surface))

    def _taken(self, steps: int) -> Frame:
        simulation = self.session.simulation
        if self._taker is not None:
            return self._taker(
                self.session, steps, lambda seconds: self._goals.commands(places_mm(simulation), seconds)
            )
        motions = self._goals.commands(places_mm(simulation), steps * simulation.step_s)
        return self.session.take(motions, steps, surface=self._shows_surface)

    def _ask(self, what: Iterable[Done | Navigation | Callable[[], None]]) -> None:
        with self._wake:
            self._asked.extend(what)
            self._wake.notify_all()

    def _run(self) -> None:
        try:
            due = time.perf_counter()
            while not self._is_closing:
                self.tick()
                due = max(due + self._frame_s, time.perf_counter())
                with self._wake:
                    while not self._is_closing:
                        left = due - time.perf_counter()
                        if left <= 0.0 and (self._mode != "paused" or self._asked):
                            break
                        self._wake.wait(max(left, 0.0) if self._mode != "paused" or left > 0.0 else None)
        except BaseException as error:
            self.error = error
        finally:
            try:
                self._end()
            except BaseException as error:
                self.error = self.error or error
            finally:
                self._heard()

    def _end(self) -> None:
        """Make what was begun, and finish what is recorded: no thread and no half-written file is left."""
        try:
            if self.session.frame().coming_cuts:
                self.session.make_cuts(wait=True)
        finally:
            self._finish_recording()
            self.has_ended = True

    def _do_asked(self) -> bool:
        """Do what was asked for; whether there was anything."""
        with self._wake:
            asked = list(self._asked)
            self._asked.clear()
        for one in asked:
            try:
                self._do(one)
            except HeartcaseError as error:
                self._messages.extend(error.problems)
        return bool(asked)

    def _do(self, one: Done | Navigation | Callable[[], None]) -> None:
        if not isinstance(one, Done | Navigation):
            one()
        elif isinstance(one, LeadGrab | MoveProbe):
            self._goals.set(one)
        elif isinstance(one, _NAVIGATION):
            self._goals.drop()
            self._set_mode("paused")
            # who looks on takes what came at one moment for one act
            if isinstance(one, Undo):
                self.session.undo(together=True)
            elif isinstance(one, Redo):
                self.session.redo(together=True)
            else:
                self.session.do(one)
        elif isinstance(one, Cut):
            # It is made when it is worked out: no frame waits for it.
            self._set_mode("running")
            self.session.begin_cut(one)
        else:
            if isinstance(one, OpenGrab | WithdrawProbe):
                self._goals.drop(one.name)
                if all(each.name != one.name for each in self.session.simulation.instruments):
                    # It never took hold: that was told.
                    return
            self.session.do(one)
            self._set_mode("running")

    def _take_up(self, branch: int) -> None:
        self._goals.drop()
        self._set_mode("paused")
        self.session.take_up(branch)

    def _set_mode(self, mode: str) -> None:
        if mode != self._mode:
            self._past.clear()
            self._ticked = None
        self._mode, self._played = mode, None

    def _begin_to_play(self, speed: float, skips: bool) -> None:
        self._goals.drop()
        self._set_mode("playing")
        self.played_speed, self._skips = speed, skips
        self._played = self.session.play(surface=self._shows_surface)

    def _play_on(self) -> None:
        """Do again the next row of steps, in its own time over the speed."""
        assert self._played is not None
        idle_end = pause_end(self.session) if self._skips else None
        if idle_end is not None and self.session.skip_towards(idle_end):
            self._past.clear()
        began, before = time.perf_counter(), self.session.step_count
        try:
            frame = next(self._played, None)
        except SimulationError as error:
            self._messages.extend(error.problems)
            frame = None
        if frame is None:
            self._set_mode("paused")
            frame = self.session.frame(surface=self._shows_surface)
        else:
            seconds = (self.session.step_count - before) * self.session.simulation.step_s
            spare = seconds / self.played_speed - (time.perf_counter() - began) - self._frame_s
            if spare > 0.0 and idle_end is None:
                time.sleep(min(spare, 1.0))
            self._measure()
        self._publish(frame)

    def _steps_due(self, elapsed_s: float) -> int:
        """How many steps the next frame takes: as much time as went by, or as many as there is time for."""
        step_s = self.session.simulation.step_s
        most_s = self._slowest * self._frame_s
        wanted = min(max(elapsed_s, self._frame_s), most_s) / step_s + self._part
        steps = max(1, int(min(wanted, self._steps_most)))
        self._part = min(wanted - steps, 1.0)
        return steps

    def _learn(self, took_s: float) -> None:
        """Let the next frame take more steps or fewer, by how long this one took with all else that it does."""
        real_time, longest = self._frame_s / self.session.simulation.step_s, self._slowest * self._frame_s
        change = min(max(longest / max(took_s, 1e-6), _STEPS_DOWN), _STEPS_UP)
        self._steps_most = min(max(self._steps_most * change, _STEPS_LEAST * real_time), self._slowest * real_time)

    def _measure(self) -> None:
        now = time.perf_counter()
        self._past.append((now, self.session.step_count))
        while len(self._past) > 2 and now - self._past[0][0] > _MEASURED_S:
            self._past.popleft()

    def _begin_to_record(self, path: Path) -> None:
        self._finish_recording()
        self._recorder = Recorder(self.session, path, case=self._manifest, failed=self._drop_recorder)
        self._messages.append(Problem("", f"recording into {path.name}"))

    def _finish_recording(self) -> None:
        recorder, self._recorder = self._recorder, None
        if recorder is not None:
            recorder.finish()
            if recorder.error is None:
                self._kept.note(self.session)
                self._messages.append(Problem("", f"recorded in {recorder.path.name}"))

    def _drop_recorder(self, error: RecordingError) -> None:
        """The recording ended by itself, and the session goes on."""
        self._recorder = None
        self._messages.extend(
            replace(problem, message=f"{problem.message}; the recording ended with what was done by then")
            for problem in error.problems
        )

    def _begin_to_leave(self, name: str) -> None:
        simulation = self.session.simulation
        self._goals.drop(name)
        if any(grab.name == name for grab in simulation.grabs):
            self._goals.set(LeadGrab(name=name, offset_mm=(0.0, 0.0, 0.0)), SOFT_SPEED_MM_S)
            self._leaving[name] = OpenGrab(name=name)
        elif any(probe.name == name for probe in simulation.probes):
            known, end = self.session.entries, self.session.position
            came = known.last_of(BringProbe, lambda entry: getattr(entry.command, "name", None) == name, end)
            if came is not None and isinstance(came[1].command, BringProbe):
                self._goals.set(MoveProbe(name=name, center_mm=came[1].command.center_mm), SOFT_SPEED_MM_S)
            self._leaving[name] = WithdrawProbe(name=name)

    def _leave(self) -> None:
        """Ask those to let go that nobody leads any more and that have come to where they are let go."""
        if self._mode == "running":
            for name in [name for name in self._leaving if name not in self._goals]:
                self._ask([self._leaving.pop(name)])

    def _publish(self, frame: Frame) -> None:
        self.newest = self._published(frame)
        self._heard()

    def _published(self, frame: Frame) -> LiveFrame:
        session, factor, rate = self.session, None, None
        if len(self._past) > 1:
            (began, first), (ended, last) = self._past[0], self._past[-1]
            rate = (last - first) / max(ended - began, 1e-9)
            factor = rate * session.simulation.step_s
        self._cuts_done.note(session, frame)
        self._act_marks.note(session)
        return replace(
            moment_of(session, frame),
            mode=self._mode,
            real_time_factor=factor,
            steps_per_second=rate,
            recording=None if self._recorder is None else self._recorder.path.name,
            act_count=self._cuts_done.act_count,
            cuts=self._cuts_done.cuts,
            unheld=self._cuts_done.unheld,
            marks=self._act_marks.marks,
            branches=self.session.branches,
        )
