"""What was done by now in a session that runs: its cuts, the heart when nothing held it open, what a recording has."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import get_args

from heartcase.schemas.arrays import Float32
from heartcase.schemas.recording.commands import Act, Cut, Entry
from heartcase.simulator.incisions.held_open import ShownHeart
from heartcase.simulator.lattice.model import LatticeModel
from heartcase.simulator.session.frame import Frame
from heartcase.simulator.session.operating_session import OperatingSession
from heartcase.simulator.surface.deform import SurfaceModel, deform

__all__ = ["CutsDone", "Kept", "Moment"]

_ACTS = get_args(Act)


@dataclass(frozen=True, eq=False)
class Moment:
    """Where the heart was, so that its surface can be worked out when it is asked for."""

    model: LatticeModel
    """The lattice."""
    surface: SurfaceModel
    """The surface over it."""
    displacement: Float32
    """Displacement of the nodes [cells, grid axes], shape (node_count, 3)."""

    @cached_property
    def heart(self) -> ShownHeart:
        """The surface then."""
        return ShownHeart.of(self.surface, deform(self.model, self.surface, self.displacement))


class CutsDone:
    """Cuts of a session so far, kept up with it frame by frame.

    ``cuts`` are those that are done, in their order; the same tuple while nothing changes. ``unheld`` is the moment
    when it was last seen cut with no instrument in it; None where it was not seen so.
    """

    def __init__(self) -> None:
        self.cuts: tuple[Cut, ...] = ()
        self.unheld: Moment | None = None
        self._unheld_cuts: tuple[Cut, ...] = ()
        self._counted = 0

    def note(self, session: OperatingSession, frame: Frame) -> None:
        """Take in where the session is; ``frame`` shows it."""
        position = session.position
        known = self.cuts
        if position < self._counted:
            known, self._counted = (), 0
        new = tuple(one.command for one in session.entries[self._counted : position] if isinstance(one.command, Cut))
        self._counted = position
        found = known + new
        if found != self.cuts:
            self.cuts = found
        if self.cuts[: len(self._unheld_cuts)] != self._unheld_cuts:
            self.unheld, self._unheld_cuts = None, ()
        surface = session.simulation.surface
        if self.cuts and not frame.instruments and surface is not None:
            self.unheld = Moment(frame.model, surface, frame.state.displacement)
            self._unheld_cuts = self.cuts


class Kept:
    """What of a session a finished recording has."""

    def __init__(self) -> None:
        self._count = 0
        self._last: Entry | None = None

    def note(self, session: OperatingSession) -> None:
        """A recording of it was finished."""
        self._count = len(session.entries)
        self._last = session.entries[-1] if session.entries else None

    def is_all_of(self, session: OperatingSession) -> bool:
        """Whether all acts that are known are in a recording, or there are none."""
        if session.is_as_recorded:
            return True
        entries, count = session.entries, self._count
        is_same = len(entries) >= count and (count == 0 or entries[count - 1] is self._last)
        return is_same and not any(isinstance(one.command, _ACTS) for one in entries[count:])
