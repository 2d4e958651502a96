"""Cuts that are worked out ahead, in a thread of their own, while the tissue moves on.

What a cut leaves follows from the sheets at rest alone: the parted lattice, the split surface, and what moves and shows
them. How the tissue moves is carried over when the cut is made. So it may be worked out at any time before, and makes
no difference to a bit of what follows: it is only there sooner.
"""

from __future__ import annotations

import threading
from collections import deque
from collections.abc import Callable
from concurrent.futures import Future, wait
from dataclasses import dataclass

import numpy as np

from heartcase.schemas.arrays import Float64
from heartcase.simulator.cutting.cuts import Cuts, Step, cut_further
from heartcase.simulator.engine.backends import Backend, Engine, make_engine
from heartcase.simulator.lattice.loose_nodes import without_loose_nodes
from heartcase.simulator.lattice.model import LatticeModel
from heartcase.simulator.surface.deform import PickingModel
from heartcase.simulator.surface_splitting.cuttable_surface import CuttableSurface
from heartcase.simulator.surface_splitting.free_parts import cut_picking
from heartcase.simulator.surface_splitting.split_surface import SplitSurface, split_surface

__all__ = ["CutTissue", "CutsAhead", "cut_tissue"]


@dataclass(frozen=True)
class CutTissue:
    """What a cut leaves, apart from how it moves."""

    before: LatticeModel
    """The lattice that was cut, with explicit springs."""
    model: LatticeModel
    """The lattice that is left."""
    cuts: Cuts
    """All that was cut of it."""
    step: Step
    """How nodes go over."""
    split: SplitSurface | None
    """The split surface, where there is one."""
    picking: PickingModel | None
    """The one-to-one surface, where it is wanted."""
    engine: Engine | None
    """What moves it, at rest; None where it must be made by the thread that uses it."""


def cut_tissue(
    model: LatticeModel,
    cuts: Cuts,
    points: Float64,
    *,
    cuttable: CuttableSurface | None,
    has_picking: bool,
    backend: Backend,
    split_before: SplitSurface | None = None,
    engine_before: Engine | None = None,
) -> CutTissue:
    """Cut a lattice further, with all that follows it.

    Parameters
    ----------
    model, cuts, points
        As of :func:`heartcase.simulator.cutting.cuts.cut_further`.
    cuttable
        The surface over the uncut lattice, where there is one.
    has_picking
        Whether the one-to-one surface is wanted.
    backend
        What moves it.
    split_before
        What was split for the cuts until now, from which the surface goes on.
    engine_before
        What moves the lattice now, where there is that.

    Raises
    ------
    SimulationError
        Springs of the lattice were removed one by one.
    """
    left, further, step = cut_further(model, cuts, points)
    split = None
    if cuttable is not None and further.parted is not None:
        split = split_surface(cuttable, further.parted, further.sheets, split_before)
    picking = cut_picking(without_loose_nodes(left), further.excised) if has_picking else None
    # A device belongs to the thread that talks to it.
    engine = None
    if backend != "cuda":
        engine = make_engine(left, backend, engine_before)
        # It is kept with the cuts: whoever takes the first step after them would wait for it.
        _ = further.rate_along
    return CutTissue(model, left, further, step, split, picking, engine)


@dataclass(frozen=True)
class _Coming:
    """A cut that is being worked out."""

    points: Float64
    """Points of the blade at each pose [cells]."""
    before: Future[CutTissue] | Cuts | None
    """The cut that comes before it, or what is cut by now."""
    tissue: Future[CutTissue]
    """What it leaves."""


class CutsAhead:
    """Cuts that are being worked out, in the order in which they will be made."""

    def __init__(self) -> None:
        self._coming: deque[_Coming] = deque()

    def __len__(self) -> int:
        """Cuts that were begun and not made."""
        return len(self._coming)

    @property
    def is_ready(self) -> bool:
        """Whether the next cut need not be waited for."""
        return bool(self._coming) and self._coming[0].tissue.done()

    def begin(
        self,
        points: Float64,
        model: LatticeModel,
        cuts: Cuts | None,
        nothing_cut: Cuts,
        engine: Engine,
        work: Callable[[LatticeModel, Cuts, Float64, Engine | None], CutTissue],
    ) -> None:
        """Begin to work out a cut, behind all that were begun before.

        Parameters
        ----------
        points
            Points of the blade at each pose [cells].
        model, cuts
            The lattice now, and what was cut of it.
        nothing_cut
            What a first cut begins with.
        engine
            What moves the lattice now.
        work
            Works it out, given a lattice, what was cut of it, the points, and what moves the lattice.
        """
        last = self._coming[-1].tissue if self._coming else None

        def further() -> CutTissue:
            if last is None:
                return work(model, nothing_cut if cuts is None else cuts, points, engine)
            found = last.result()
            return work(found.model, found.cuts, points, found.engine)

        future: Future[CutTissue] = Future()
        self._coming.append(_Coming(points, cuts if last is None else last, future))
        # A thread for each: none is left when all are done.
        threading.Thread(target=_work_out, args=(future, last, further), name="heartcase-cut").start()

    def take(self, points: Float64, model: LatticeModel, cuts: Cuts | None) -> CutTissue | None:
        """What the next cut leaves, if it is this one; otherwise none that was begun counts any more.

        Parameters
        ----------
        points
            Points of the blade at each pose [cells].
        model, cuts
            The lattice now, and what was cut of it.

        Raises
        ------
        SimulationError
            It cannot be cut.
        """
        if not self._coming:
            return None
        first = self._coming.popleft()
        try:
            if np.array_equal(first.points, points, equal_nan=True) and _cuts_before(first) is cuts:
                found = first.tissue.result()
                # Springs may have been removed one by one meanwhile, and patches laid in or taken out.
                if found.before.spring_nodes is model.spring_nodes and _has_same_nodes(found.before, model):
                    return found
        except Exception:
            self.forget()
            raise
        self.forget()
        return None

    def forget(self) -> None:
        """Leave what was begun."""
        for coming in self._coming:
            coming.tissue.cancel()
        self._coming.clear()


def _work_out(future: Future[CutTissue], last: Future[CutTissue] | None, work: Callable[[], CutTissue]) -> None:
    if last is not None:
        wait([last])
    if not future.set_running_or_notify_cancel():
        return
    try:
        future.set_result(work())
    except BaseException as error:
        future.set_exception(error)


def _cuts_before(coming: _Coming) -> Cuts | None:
    return coming.before.result().cuts if isinstance(coming.before, Future) else coming.before


def _has_same_nodes(one: LatticeModel, other: LatticeModel) -> bool:
    return np.array_equal(one.node_index, other.node_index) and np.array_equal(one.node_mass, other.node_mass)
