"""What was cut by now in a session that runs, and how the heart looked when nothing held it open."""

from __future__ import annotations

from heartcase.schemas.recording.commands import Cut
from heartcase.simulator.incisions.held_open import ShownHeart
from heartcase.simulator.session.frame import Frame
from heartcase.simulator.session.operating_session import OperatingSession

__all__ = ["CutsDone"]


class CutsDone:
    """Cuts of a session so far, kept up with it frame by frame.

    ``cuts`` are those that are done, in their order; the same tuple while nothing changes. ``unheld`` is the surface
    when it was last seen cut with no instrument in it; None where it was not seen so.
    """

    def __init__(self) -> None:
        self.cuts: tuple[Cut, ...] = ()
        self.unheld: ShownHeart | None = None
        self._unheld_cuts: tuple[Cut, ...] = ()
        self._counted = 0

    def note(self, session: OperatingSession, frame: Frame) -> None:
        """Take in where the session is; ``frame`` shows it with its surface."""
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
        if self.cuts and not frame.instruments and frame.surface is not None and surface is not None:
            self.unheld, self._unheld_cuts = ShownHeart.of(surface, frame.surface), self.cuts
