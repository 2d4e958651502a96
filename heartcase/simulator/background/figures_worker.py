"""Figures of an incision while it is held open, worked out by a process beside the steps, which go before it."""

from __future__ import annotations

import contextlib
import multiprocessing
import os
import signal
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from multiprocessing.connection import Connection

import numba
import numpy as np

from heartcase.schemas.arrays import Float32
from heartcase.schemas.errors import HeartcaseError, Problem
from heartcase.schemas.landmarks import Landmark
from heartcase.schemas.recording.commands import Cut
from heartcase.schemas.scripts.incision_plans import LookingSettings, ShaftSettings
from heartcase.simulator.dynamics.measures import inverted_cells
from heartcase.simulator.incisions.blade_line import incision_of_blade
from heartcase.simulator.incisions.figures import IncisionFigures
from heartcase.simulator.incisions.held_open import Incision, ShownHeart, seen_through
from heartcase.simulator.lattice.model import LatticeModel
from heartcase.simulator.live.cuts_done import Moment
from heartcase.simulator.live.live_frame import LiveFrame

__all__ = ["HELD_BY", "FiguresWorker", "LiveFigures", "figures_of"]

EVERY_S = 0.5
"""Least time between two moments whose figures are worked out, s."""
_REST, _REST_MAX_S = 2.0, 2.0
"""Least time between them, in parts of how long the figures of the last one took, and at most, s: so the process works
a third of the time in motion."""
HELD_BY = ("grab", "forceps", "retractor")
"""Kinds of instruments whose force counts as that of holding open."""
_NICE = 10
"""How far the process stands behind what steps."""
_END_S = 2.0


@dataclass(frozen=True)
class LiveFigures:
    """Figures of an incision at a moment of a session."""

    step: int
    """The moment."""
    time_s: float
    """The same, simulated s."""
    incision: int
    """Which of the cuts of that moment, from 0."""
    name: str
    """The incision's name."""
    defects: dict[str, IncisionFigures]
    """Name of each defect -> figures; of a case without defects one entry without a name."""
    rim_found: dict[str, float]
    """Name of each defect -> part of its rim that was found on the surface [1]."""
    hand_force_n: dict[str, float]
    """Name of each instrument that holds -> force on it, N."""
    inverted_cell_count: int
    """Cells that are inside out: the largest stretch and stress mean nothing where there are some."""
    has_reach: bool
    """Whether the reach of the tip was worked out."""
    problems: tuple[Problem, ...] = ()
    """Defects of which there are no figures, and why."""


@dataclass(frozen=True)
class _Question:
    """A moment whose figures are wanted. What the process knows from the question before is None."""

    step: int
    time_s: float
    incision: int
    cut: Cut | None
    whole: ShownHeart | None
    """Surface before anything was cut."""
    landmarks: tuple[Landmark, ...] | None
    model: LatticeModel | None
    displacement: Float32
    held: ShownHeart
    """The surface now; without what stays the same where it is that of the question before."""
    is_same_surface: bool
    unheld: ShownHeart | None
    keeps_unheld: bool
    """Whether ``unheld`` is that of the question before."""
    hand_force_n: dict[str, float]
    stitch_forces_n: tuple[float, ...]
    reaches: bool


def figures_of(
    live: LiveFrame,
    whole: ShownHeart,
    landmarks: tuple[Landmark, ...],
    incision: int = 0,
    *,
    shaft: ShaftSettings | None = None,
    reaches: bool = True,
) -> LiveFigures:
    """Figures of one of the cuts of a moment, worked out here and now.

    Parameters
    ----------
    live
        The moment.
    whole
        The surface before anything was cut.
    landmarks
        Landmarks of the case.
    incision
        Which of its cuts, from 0.
    shaft
        The instrument that is moved through the opening; the one of plans that say nothing of it when left out.
    reaches
        Whether the reach of its tip is worked out.

    Raises
    ------
    SimulationError
        What was cut is no incision.
    """
    return _Reckoner(shaft or ShaftSettings()).answer(_question(live, whole, landmarks, incision, reaches=reaches))


def _question(
    live: LiveFrame, whole: ShownHeart, landmarks: tuple[Landmark, ...], incision: int, *, reaches: bool
) -> _Question:
    frame = live.frame
    is_cut_face = None if live.triangle_origin is None else live.triangle_origin < 0
    return _Question(
        step=frame.step,
        time_s=frame.time_s,
        incision=incision,
        cut=live.cuts[incision],
        whole=whole,
        landmarks=landmarks,
        model=frame.model,
        displacement=frame.state.displacement,
        held=Moment(frame.model, live.surface, frame.state.displacement, is_cut_face).heart,
        is_same_surface=False,
        unheld=None if live.unheld is None else live.unheld.heart,
        keeps_unheld=False,
        hand_force_n={
            name: float(np.linalg.norm(one.force_n)) for name, one in frame.instruments.items() if one.kind in HELD_BY
        },
        stitch_forces_n=tuple(one.force_n for one in frame.stitches.values()),
        reaches=reaches,
    )


class _Reckoner:
    """Answers questions, and remembers what the next one need not say again."""

    def __init__(self, shaft: ShaftSettings) -> None:
        self._shaft = shaft
        self._incision: Incision | None = None
        self._problems: list[Problem] = []
        self._whole: ShownHeart | None = None
        self._landmarks: tuple[Landmark, ...] = ()
        self._model: LatticeModel | None = None
        self._held: ShownHeart | None = None
        self._unheld: ShownHeart | None = None

    def answer(self, asked: _Question) -> LiveFigures:
        self._whole = asked.whole or self._whole
        self._landmarks = self._landmarks if asked.landmarks is None else asked.landmarks
        self._model = asked.model or self._model
        self._unheld = self._unheld if asked.keeps_unheld else asked.unheld
        assert self._whole is not None
        assert self._model is not None
        held = asked.held
        if asked.is_same_surface and self._held is not None:
            before = self._held
            held = replace(
                held,
                rest_mm=before.rest_mm,
                triangles=before.triangles,
                is_cut_face=before.is_cut_face,
                known=before.carrier,
            )
        self._held = held
        if asked.cut is not None:
            cut = asked.cut
            self._incision, self._problems = incision_of_blade(
                cut.name, np.array(cut.poses_mm), self._whole, self._landmarks
            )
        assert self._incision is not None
        found, _ = seen_through(
            self._incision,
            self._model,
            asked.displacement,
            held,
            closed=self._whole,
            cut=self._unheld,
            landmarks=self._landmarks,
            looking=LookingSettings(),
            shaft=self._shaft,
            retraction_n=max(asked.hand_force_n.values(), default=None),
            stitch_forces_n=asked.stitch_forces_n,
            reaches=asked.reaches,
        )
        return LiveFigures(
            step=asked.step,
            time_s=asked.time_s,
            incision=asked.incision,
            name=self._incision.name,
            defects={name: one.figures for name, one in found.items()},
            rim_found={rim.name: rim.part_found for rim in self._incision.rims},
            hand_force_n=asked.hand_force_n,
            inverted_cell_count=int(inverted_cells(self._model, asked.displacement).sum()),
            has_reach=asked.reaches,
            problems=tuple(self._problems),
        )


class FiguresWorker:
    """Works out figures of the newest moment that it was given, one after another, in a process of its own.

    ``newest`` are the last figures, None before the first and where nothing is cut; ``error`` is why there are no more.
    The reach of the tip takes seconds: it is worked out once after :meth:`ask_for_reach`, for the next moment that
    stands.

    Parameters
    ----------
    whole
        The surface before anything is cut.
    landmarks
        Landmarks of the case.
    heard
        Called by a thread when there are new figures; it must return at once.
    shaft
        As of :func:`figures_of`.
    """

    def __init__(
        self,
        whole: ShownHeart,
        landmarks: tuple[Landmark, ...],
        *,
        heard: Callable[[], None] = lambda: None,
        shaft: ShaftSettings | None = None,
    ) -> None:
        self.newest: LiveFigures | None = None
        self.error: HeartcaseError | None = None
        self._whole, self._landmarks, self._heard = whole, landmarks, heard
        self._wake = threading.Condition()
        self._live: LiveFrame | None = None
        self._incision = 0
        self._wants_reach = self._is_closing = False
        context = multiprocessing.get_context("spawn")
        self._line, its_line = context.Pipe()
        self._process = context.Process(
            target=_serve, args=(its_line, shaft or ShaftSettings()), daemon=True, name="heartcase-figures"
        )
        self._process.start()
        its_line.close()
        self._thread = threading.Thread(target=self._run, name="figures", daemon=True)
        self._thread.start()

    def ask(self, live: LiveFrame, incision: int = 0) -> None:
        """Work out this moment next; one that waits is left out. ``incision`` says which of its cuts, from 0."""
        with self._wake:
            self._live, self._incision = live, incision
            self._wake.notify_all()

    def ask_for_reach(self) -> None:
        """Work out the reach of the tip, too, for the next moment asked for that stands."""
        with self._wake:
            self._wants_reach = True

    @property
    def is_reaching(self) -> bool:
        """Whether the reach of the tip was asked for and is not known yet."""
        return self._wants_reach

    @property
    def has_ended(self) -> bool:
        """Whether it ended by itself."""
        return not (self._thread.is_alive() and self._process.is_alive())

    def close(self) -> None:
        """End thread and process."""
        with self._wake:
            self._is_closing = True
            self._wake.notify_all()
        # it may be in the middle of something that nobody waits for any more
        self._process.terminate()
        self._thread.join()
        self._process.join(_END_S)
        self._line.close()

    def _run(self) -> None:
        known: _Question | None = None
        told: tuple[int, int, bool, object] | None = None
        rest_until = 0.0
        while True:
            with self._wake:
                while not self._is_closing and (self._live is None or time.monotonic() < rest_until):
                    self._wake.wait(None if self._live is None else max(rest_until - time.monotonic(), 0.0))
                if self._is_closing:
                    return
                live, number = self._live, self._incision
                self._live = None
            assert live is not None
            if not live.cuts:
                if self.newest is not None:
                    self.newest = None
                    self._heard()
                continue
            number = min(number, len(live.cuts) - 1)
            reaches = self._wants_reach and live.mode == "paused"
            asks = live.frame.step, number, reaches, live.frame.model
            if told is not None and asks[:2] == told[:2] and asks[3] is told[3] and reaches <= told[2]:
                continue
            began = time.monotonic()
            question = _question(live, self._whole, self._landmarks, number, reaches=reaches)
            try:
                self._line.send(_what_is_new(question, known))
                answer = self._line.recv()
            except (EOFError, OSError):
                if not self._is_closing:
                    self.error = HeartcaseError("what works out figures has ended: hide and show them again")
                    self._heard()
                return
            if reaches:
                self._wants_reach = False
            if isinstance(answer, LiveFigures):
                known, told, self.newest, self.error = question, asks, answer, None
            else:
                known, self.error = None, HeartcaseError(answer)
            self._heard()
            took_s = time.monotonic() - began
            rest_until = time.monotonic() + min(max(EVERY_S, _REST * took_s), _REST_MAX_S)


def _what_is_new(asked: _Question, before: _Question | None) -> _Question:
    """The question without what the one before said."""
    if before is None:
        return asked
    is_same = asked.held.rest_mm is before.held.rest_mm
    held = asked.held
    if is_same:
        held = replace(held, rest_mm=held.rest_mm[:0], triangles=held.triangles[:0], is_cut_face=None)
    return replace(
        asked,
        held=held,
        is_same_surface=is_same,
        cut=None if asked.cut is before.cut else asked.cut,
        whole=None,
        landmarks=None,
        model=None if asked.model is before.model else asked.model,
        unheld=None if asked.unheld is before.unheld else asked.unheld,
        keeps_unheld=asked.unheld is before.unheld,
    )


def _serve(line: Connection, shaft: ShaftSettings) -> None:
    """The process: answer what is asked until nobody asks any more."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    if hasattr(os, "nice"):
        with contextlib.suppress(OSError):
            os.nice(_NICE)
    reckoner = _Reckoner(shaft)
    with contextlib.suppress(EOFError, OSError), np.errstate(all="ignore"):
        while True:
            question: _Question = line.recv()
            # where time stands all processors are free
            numba.set_num_threads(numba.config.NUMBA_NUM_THREADS if question.reaches else 1)
            try:
                line.send(reckoner.answer(question))
            except HeartcaseError as error:
                line.send(error.problems)
