"""Recordings of a case as plans: figures of each as it was held open, side by side, worked out by a process beside."""

from __future__ import annotations

import contextlib
import os
import signal
import threading
from collections.abc import Callable, Sequence
from dataclasses import replace
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any

from heartcase.schemas.bundle.manifest import manifest_bytes
from heartcase.schemas.errors import HeartcaseError, Problem, SimulationError
from heartcase.schemas.recording.reader import open_recording
from heartcase.simulator.background.figures_worker import LiveFigures
from heartcase.simulator.background.recorded_figures import figures_of_recording
from heartcase.simulator.incisions.figures import ranked
from heartcase.simulator.load import load_case
from heartcase.studio.message_words import problem_facts
from heartcase.studio.messages import text_message
from heartcase.studio.operating.beside import Beside
from heartcase.studio.operating.live_figures import finite, told_figures

__all__ = ["NEAREST_LEAST_MM", "ComparedPlans"]

NEAREST_LEAST_MM = 2.0
"""A plan that comes nearer to a vessel is put behind all others, mm: as of ``heartcase compare-incisions``."""
REACHES = True
"""Whether the reach of the tip is worked out, which takes most of the time."""
_ENDED = "what works out figures has ended: compare again"
_LAST = ("is_too_near", "is_inverted")
"""Why a plan is put behind all others."""
_NICE = 10

Found = LiveFigures | tuple[Problem, ...]


class ComparedPlans:
    """The recordings that are compared, and what is known of each.

    Parameters
    ----------
    case
        The case's folder.
    out
        Folder of its recordings.
    heard
        Called by a thread when there is something new.
    """

    def __init__(self, case: Path, out: Path, heard: Callable[[], None]) -> None:
        self._case, self._out, self._heard = case, out, heard
        self._names: tuple[str, ...] = ()
        self._known: dict[str, tuple[object, Found, float | None]] = {}
        self._is_working = False
        self._lock = threading.Lock()
        self._beside = Beside("plans")

    def compare(self, names: Sequence[str]) -> None:
        """Compare these recordings; what is known already is not worked out again."""
        self.close()
        with self._lock:
            self._names = tuple(dict.fromkeys(names))
            self._known = {name: one for name, one in self._known.items() if one[0] == self._state_of(name)}
            wanted = [name for name in self._names if name not in self._known]
            self._is_working = bool(wanted)
        if wanted:
            self._beside.start(_serve, str(self._case), REACHES, talk=lambda line: self._run(line, wanted))
        self._heard()

    def close(self) -> None:
        """Leave what is being worked out."""
        self._beside.end()
        with self._lock:
            self._is_working = False

    @property
    def is_comparing(self) -> bool:
        """Whether recordings are compared, or were."""
        with self._lock:
            return bool(self._names)

    def message(self) -> str:
        """What pages are told."""
        with self._lock:
            known = {name: self._known[name][1] for name in self._names if name in self._known}
            shown_s = {name: one[2] for name, one in self._known.items()}
            names, is_working = self._names, self._is_working
        found = {name: one for name, one in known.items() if isinstance(one, LiveFigures)}
        problems = {
            name: [problem_facts(each.place, each.message) for each in one]
            for name, one in known.items()
            if isinstance(one, tuple)
        }
        defects: list[dict[str, Any]] = []
        for defect in dict.fromkeys(defect for one in found.values() for defect in one.defects):
            plans = {name: one.defects[defect] for name, one in found.items() if defect in one.defects}
            defects.append(
                {
                    "name": defect,
                    "figures": {name: told_figures(figures) for name, figures in plans.items()},
                    "ranked": _ranked(plans),
                }
            )
        about = {
            name: {
                "incision": one.name,
                "time_s": one.time_s,
                "inverted_cell_count": one.inverted_cell_count,
                "hand_force_n": one.hand_force_n,
                "shown_s": shown_s[name],
                "problems": [problem_facts(each.place, each.message) for each in one.problems],
            }
            for name, one in found.items()
        }
        facts = {"names": names, "is_working": is_working, "about": about, "defects": defects, "problems": problems}
        return text_message("plans", **finite(facts))

    def _run(self, line: Connection, wanted: list[str]) -> None:
        with contextlib.suppress(EOFError, OSError):
            for name in wanted:
                state = self._state_of(name)
                line.send(str(self._out / name))
                answer, shown_s = line.recv()
                with self._lock:
                    self._known[name] = state, answer, shown_s
                self._heard()
        if self._beside.is_left:
            # it was left for another comparison, or for good
            return
        with self._lock:
            self._is_working = False
            for name in wanted:
                # not a state that a recording can have: it is tried again when it is asked for again
                self._known.setdefault(name, ("ended", (Problem("plans", _ENDED),), None))
        self._heard()

    def _state_of(self, name: str) -> object:
        """What a recording and the case are by now: another one is worked out anew."""
        try:
            log = max(one.stat().st_mtime_ns for one in (self._out / name).iterdir())
            return log, manifest_bytes(self._case)
        except (OSError, ValueError, HeartcaseError):
            return None


def _ranked(plans: dict[str, Any]) -> list[dict[str, Any]]:
    """Places and scores of plans, the best first; none where a figure is no number."""
    try:
        order = ranked([replace(one, name=name) for name, one in plans.items()], nearest_least_mm=NEAREST_LEAST_MM)
    except SimulationError:
        return []
    return [
        {"name": one.figures.name, "place": one.place, "score": one.score} | {key: getattr(one, key) for key in _LAST}
        for one in order
    ]


def _serve(line: Connection, path: str, reaches: bool) -> None:
    """The process: load the case, and answer with the figures of each recording that it is sent."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    if hasattr(os, "nice"):
        with contextlib.suppress(OSError):
            os.nice(_NICE)
    case = None
    with contextlib.suppress(EOFError, OSError):
        while True:
            where = Path(line.recv())
            try:
                case = case or load_case(Path(path), needs=("surface", "tissue"))
                recording = open_recording(where, partial=True)
                found = figures_of_recording(case, recording, reaches=reaches)
                line.send((found, None if recording.is_whole else recording.seconds))
            except HeartcaseError as error:
                folders = {str(where.parent), path}
                line.send((tuple(Problem(one.place, _without(folders, one.message)) for one in error.problems), None))


def _without(folders: set[str], text: str) -> str:
    for folder in sorted(folders, key=len, reverse=True):
        text = text.replace(folder, "case")
    return text
