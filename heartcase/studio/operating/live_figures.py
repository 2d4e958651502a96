"""Figures of the incision that is held open, as pages are told them."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import asdict
from math import isfinite
from typing import Any

from heartcase.schemas.landmarks import Landmark
from heartcase.simulator.background.figures_worker import FiguresWorker, LiveFigures
from heartcase.simulator.incisions.figures import IncisionFigures
from heartcase.simulator.live.live_frame import LiveFrame
from heartcase.studio.message_words import problem_facts
from heartcase.studio.messages import problems_of, text_message
from heartcase.studio.operating.incisions import Incisions

__all__ = ["ShownFigures", "finite", "told_figures"]


class ShownFigures:
    """Works out figures while a page shows them.

    ``incision`` says which of the cuts, from 0.

    Parameters
    ----------
    incisions, landmarks
        Incisions of the case, and its landmarks.
    heard
        Called by a thread when there are new figures.
    """

    def __init__(self, incisions: Incisions, landmarks: tuple[Landmark, ...], heard: Callable[[], None]) -> None:
        self.incision = 0
        self._incisions, self._landmarks, self._heard = incisions, landmarks, heard
        self._worker: FiguresWorker | None = None

    def show(self, is_wanted: bool) -> None:
        """Begin to work them out, or leave it; where it ended by itself it begins anew."""
        worker = self._worker
        if worker is not None and (not is_wanted or worker.has_ended):
            worker.close()
            self._worker = worker = None
        if is_wanted and worker is None:
            self._worker = FiguresWorker(self._incisions.whole, self._landmarks, heard=self._heard)

    def ask(self, live: LiveFrame) -> None:
        """Work out this moment next."""
        # another thread may leave it meanwhile
        worker = self._worker
        if worker is not None:
            worker.ask(live, self.incision)

    def ask_for_reach(self) -> None:
        """Work out the reach of the tip, too, when time stands."""
        worker = self._worker
        if worker is not None:
            worker.ask_for_reach()

    def message(self, live: LiveFrame) -> str:
        """What a page is told now.

        Parameters
        ----------
        live
            The moment that it is shown.
        """
        worker = self._worker
        newest = None if worker is None or not live.cuts else worker.newest
        error = None if worker is None else worker.error
        return text_message(
            "figures",
            cuts=[cut.name for cut in live.cuts],
            is_reaching=worker is not None and worker.is_reaching,
            found=None if newest is None else finite(_told(newest)),
            problems=[] if error is None else problems_of(error),
        )


def _told(found: LiveFigures) -> dict[str, Any]:
    return {
        "step": found.step,
        "time_s": found.time_s,
        "incision": found.incision,
        "name": found.name,
        "defects": [
            {"name": name, "rim_found": found.rim_found.get(name), "figures": told_figures(figures)}
            for name, figures in found.defects.items()
        ],
        "hand_force_n": found.hand_force_n,
        "inverted_cell_count": found.inverted_cell_count,
        "has_reach": found.has_reach,
        "problems": [problem_facts(one.place, one.message) for one in found.problems],
    }


def told_figures(figures: IncisionFigures) -> dict[str, Any]:
    """Figures as a page is told them: what is not known, or no finite number, is None."""
    facts = asdict(figures) | {"nearest_vessel_mm": figures.nearest_vessel_mm, "worst_stitch": figures.worst_stitch}
    del facts["stitches"]
    found: dict[str, Any] = finite(facts)
    return found


def finite(value: Any) -> Any:
    """Plain data, however nested, in which each number that is not finite is None: JSON has no word for it."""
    if isinstance(value, Mapping):
        return {name: finite(one) for name, one in value.items()}
    if isinstance(value, list | tuple):
        return [finite(one) for one in value]
    return None if isinstance(value, float) and not isfinite(value) else value
