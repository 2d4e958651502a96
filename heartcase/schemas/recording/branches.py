"""What came after a moment of a session, and was left when it went on another way: it can be gone back to."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import get_args

from heartcase.schemas.errors import SimulationError
from heartcase.schemas.recording.commands import Act, Advance, Done, Halt, Mark
from heartcase.schemas.recording.kept_entries import KeptEntries

__all__ = ["MOST_BRANCHES", "Branch", "Branches"]

MOST_BRANCHES = 20
"""The oldest ones go first, but for those that others lie on."""

_DONE_BY_HAND = tuple(kind for kind in get_args(Done) if kind not in (Advance, Halt, Mark))
"""What would be missed; time that goes by, and its marks, come again by themselves."""


@dataclass(frozen=True, eq=False)
class Branch:
    """A way that was left."""

    number: int
    """By which it is gone back to; no other branch of the session has, or had, the same."""
    start_step: int
    """Step at which it begins."""
    end_step: int
    """Last step of it."""
    position: int
    """How many entries of the history come before it."""
    entries: KeptEntries
    """Its own entries."""
    on: int | None
    """Number of the branch that its beginning lies on; None where it lies on the session's history as it is."""
    has_acts: bool
    """Whether anything was done on it, beside time that went by."""
    acts: tuple[type, ...]
    """Kinds of the acts on it, in their order."""


class Branches:
    """The branches of a session. Each begins on the history as it is, or on another branch."""

    def __init__(self) -> None:
        self._known: dict[int, Branch] = {}
        self._count = 0
        self.shown: tuple[Branch, ...] = ()
        """Those on which anything was done, the latest first; the same tuple while nothing changes."""

    def keep(self, entries: KeptEntries, position: int, *, is_recorded: bool) -> None:
        """The history goes on another way from a position: what it knows beyond is a branch from here on.

        Where nothing was done there, or a recording has it, it is not kept.
        """
        later = [one for one in self._known.values() if one.on is None and one.position > position]
        has_acts = not is_recorded and entries.has_any(_DONE_BY_HAND, position, len(entries))
        if not (has_acts or later):
            return
        tail = KeptEntries(entries[position:])
        self._count += 1
        acts = tuple(type(tail[at].command) for at in tail.places_of(get_args(Act)))
        made = Branch(self._count, tail[0].step, tail[-1].end_step, position, tail, None, has_acts, acts)
        self._known[made.number] = made
        for one in later:
            self._known[one.number] = replace(one, on=made.number)
        self._tell()

    def trim(self) -> None:
        """Forget the oldest ones where there are more than :data:`MOST_BRANCHES`, but for those that others lie on."""
        while len(self._known) > MOST_BRANCHES:
            bearing = {one.on for one in self._known.values()}
            del self._known[min(number for number in self._known if number not in bearing)]
        self._tell()

    def forget(self, position: int) -> None:
        """The history beyond a position is dropped for good: branches that begin there have no beginning any more."""
        gone = {one.number for one in self._known.values() if one.on is None and one.position > position}
        while more := {one.number for one in self._known.values() if one.on in gone} - gone:
            gone |= more
        self._known = {number: one for number, one in self._known.items() if number not in gone}
        self._tell()

    def at(self, number: int) -> Branch:
        """A branch by its number.

        Raises
        ------
        SimulationError
            There is none.
        """
        if number not in self._known:
            raise SimulationError("there is no such branch any more: look at the list again", place="branch")
        return self._known[number]

    def take(self, number: int) -> None:
        """A branch is part of the history again, and no branch any more."""
        del self._known[number]
        self._known = {key: replace(one, on=None) if one.on == number else one for key, one in self._known.items()}
        self._tell()

    def _tell(self) -> None:
        shown = sorted((one for one in self._known.values() if one.has_acts), key=lambda one: -one.number)
        if [one.number for one in shown] != [one.number for one in self.shown]:
            self.shown = tuple(shown)
