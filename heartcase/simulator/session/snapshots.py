"""Snapshots along a history: many of late, fewer the longer ago, so that going back is quick and memory bounded."""

from __future__ import annotations

from dataclasses import dataclass

from heartcase.schemas.errors import SimulationError
from heartcase.simulator.snapshot import Snapshot

__all__ = ["Snapshots"]

SHARE = 0.125
"""Gap between snapshots that is allowed, in parts of how long ago they are."""


@dataclass
class Snapshots:
    """Snapshots by their position in a history: the number of its entries that were done by then.

    The first stays. Of others one goes when, without it, the gap is no longer than ``every_steps`` or an eighth of its
    age: some eight for each time that the history grows by a factor of e.
    """

    every_steps: float
    """Steps between snapshots of late; no snapshot but the first where this is infinite."""

    def __post_init__(self) -> None:
        if not self.every_steps >= 0.0:
            raise SimulationError("the time between snapshots must be 0 or more", place="snapshot_every_s")
        self._kept: dict[int, Snapshot] = {}

    def __len__(self) -> int:
        """How many there are."""
        return len(self._kept)

    @property
    def wants_any(self) -> bool:
        """Whether more than the first is kept."""
        return self.every_steps != float("inf")

    def add(self, position: int, snapshot: Snapshot) -> None:
        """Keep one; older ones may go."""
        self._kept[position] = snapshot
        self._thin(snapshot.state.step_count)

    def is_due(self, position: int, step: int) -> bool:
        """Whether it is long enough since the one before."""
        return step - self._kept[self.last_before(position)].state.step_count >= self.every_steps

    @property
    def positions(self) -> frozenset[int]:
        """Where there is one."""
        return frozenset(self._kept)

    def last_before(self, position: int) -> int:
        """The last position, up to this one, that has one."""
        return max(kept for kept in self._kept if kept <= position)

    def at(self, position: int) -> Snapshot:
        """The one at a position."""
        return self._kept[position]

    def forget_after(self, position: int) -> None:
        """Drop those of entries that are no more."""
        self._kept = {kept: snapshot for kept, snapshot in self._kept.items() if kept <= position}

    def _thin(self, now: int) -> None:
        positions = sorted(self._kept)
        steps = [self._kept[position].state.step_count for position in positions]
        before = 0
        for number in range(1, len(positions) - 1):
            gap, age = steps[number + 1] - steps[before], now - steps[number + 1]
            if gap <= max(self.every_steps, SHARE * age) and age > 0:
                del self._kept[positions[number]]
            else:
                before = number
