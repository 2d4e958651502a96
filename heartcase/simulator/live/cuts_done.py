"""What was done by now in a session that runs: its cuts, the heart when nothing held it open, what a recording has."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import get_args

from heartcase.schemas.arrays import Bool, Float32
from heartcase.schemas.recording.commands import Act, Cut
from heartcase.schemas.recording.suture_commands import Excise, PlacePatch, PlaceRow, PlaceStitch
from heartcase.schemas.recording.tool_commands import Snip
from heartcase.simulator.incisions.held_open import ShownHeart
from heartcase.simulator.lattice.model import LatticeModel
from heartcase.simulator.session.frame import Frame
from heartcase.simulator.session.operating_session import OperatingSession
from heartcase.simulator.surface.deform import SurfaceModel, deform

__all__ = ["MARKED", "ActMarks", "CutsDone", "Kept", "Moment"]

_ACTS = get_args(Act)
MARKED: dict[type, str] = {
    Cut: "cut", Snip: "cut", Excise: "excision", PlacePatch: "patch", PlaceStitch: "stitch", PlaceRow: "stitch",
}  # fmt: skip
"""Acts that one wants to find again, and what they are called."""


@dataclass(frozen=True, eq=False)
class Moment:
    """Where the heart was, so that its surface can be worked out when it is asked for."""

    model: LatticeModel
    """The lattice."""
    surface: SurfaceModel
    """The surface over it."""
    displacement: Float32
    """Displacement of the nodes [cells, grid axes], shape (node_count, 3)."""
    is_cut_face: Bool | None = None
    """Which triangles are walls of cuts, shape (triangle_count,); None where nothing is cut or it is not asked for."""

    @cached_property
    def heart(self) -> ShownHeart:
        """The surface then."""
        return ShownHeart.of(self.surface, deform(self.model, self.surface, self.displacement), self.is_cut_face)


class CutsDone:
    """Cuts of a session so far, kept up with it frame by frame.

    ``act_count`` acts are done; ``cuts`` are those of them, in their order, the same tuple while nothing changes.
    ``unheld`` is the moment when it was last seen cut with no instrument in it; None where it was not seen so.
    """

    def __init__(self) -> None:
        self.cuts: tuple[Cut, ...] = ()
        self.unheld: Moment | None = None
        self._unheld_cuts: tuple[Cut, ...] = ()
        self.act_count = self._counted = 0
        self._last: int | None = None

    def note(self, session: OperatingSession, frame: Frame) -> None:
        """Take in where the session is; ``frame`` shows it."""
        position = session.position
        known = self.cuts
        entries, counted = session.entries, self._counted
        # it may have been gone back, and on another way, since the last time
        if position < counted or (counted and entries.origin(counted - 1) != self._last):
            known, counted, self.act_count = (), 0, 0
        # only what came since the last time is looked at, where nothing was taken back
        self.act_count += len(entries.places_of(_ACTS, counted, position))
        new = [entries[at].command for at in entries.places_of(Cut, counted, position)]
        self._counted = position
        self._last = entries.origin(position - 1) if position else None
        found = known + tuple(one for one in new if isinstance(one, Cut))
        if found != self.cuts:
            self.cuts = found
        if self.cuts[: len(self._unheld_cuts)] != self._unheld_cuts:
            self.unheld, self._unheld_cuts = None, ()
        surface = session.simulation.surface
        if self.cuts and not frame.instruments and surface is not None:
            self.unheld = Moment(frame.model, surface, frame.state.displacement)
            self._unheld_cuts = self.cuts


class ActMarks:
    """Where on the time line cuts, patches and stitches of a session are: what one wants to find again.

    ``marks`` are their steps and what they are, ``cut``, ``patch`` or ``stitch``, also of what is known ahead after
    going back; the same tuple while nothing changes.
    """

    def __init__(self) -> None:
        self.marks: tuple[tuple[int, str], ...] = ()
        self._key: tuple[int, ...] = ()

    def note(self, session: OperatingSession) -> None:
        """Take in what the session knows now."""
        entries = session.entries
        places = entries.places_of(tuple(MARKED))
        key = tuple(entries.origin(at) for at in places)
        if key != self._key:
            self._key = key
            found = [entries[at] for at in places]
            self.marks = tuple((one.step, MARKED[type(one.command)]) for one in found)


class Kept:
    """What of a session a finished recording has."""

    def __init__(self) -> None:
        self._count = 0
        self._last: int | None = None

    def note(self, session: OperatingSession) -> None:
        """A recording of it was finished."""
        self._count = len(session.entries)
        self._last = session.entries.origin(self._count - 1) if self._count else None

    def is_all_of(self, session: OperatingSession) -> bool:
        """Whether all acts that are known are in a recording, or there are none."""
        if session.is_as_recorded:
            return True
        entries, count = session.entries, self._count
        is_same = len(entries) >= count and (count == 0 or entries.origin(count - 1) == self._last)
        return is_same and not entries.places_of(_ACTS, count)
