"""Distances and labels of a divided flat minimum, mended some voxels at a time where something was painted or erased.

What a stroke changes is found from it outwards, in the order of the distances, and all else in the flat stays
(Ramalingam and Reps, Journal of Algorithms 21, 1996): a stroke in a million flat voxels costs what it changes. First
the voxels that an erased one led to are *withdrawn*, then the labels spread. Both stop after some voxels and go on
later; between, a voxel has the label of before until its turn comes. What is painted meanwhile joins in; before
anything is erased, what is not done yet is taken back.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from heartcase.pipeline.data import UNMARKED
from heartcase.pipeline.watershed.flat_minima.mending_kernels import feed, spread, take_back, withdraw
from heartcase.schemas.arrays import Int32, Int64, UInt8, UInt16

__all__ = ["ALL", "Mended", "Mending"]

ALL = 2**62
"""More voxels than there are."""


@dataclass(frozen=True)
class Mended:
    """What comes of mending some voxels."""

    voxels: Int64
    """Flat indices of the voxels whose labels change."""
    labels: UInt8
    """The new label of each."""
    count: int
    """Number of voxels that had their turn."""
    is_too_far: bool
    """Whether a distance cannot be noted: the flat has to be divided anew."""


class Mending:
    """What of a divided flat minimum has still to be mended.

    Parameters
    ----------
    shape
        Of the volume: (z, y, x).
    cost
        Of all voxels, one-dimensional.
    axis_cost
        Cost of a step along z, y and x.
    distance
        Distance of each voxel of divided flats, int32, shape (voxels,); 0 outside of them. It is written to: while this
        is busy the distances that are foretold are negative.
    farthest
        No larger distance is noted.
    """

    def __init__(
        self, shape: tuple[int, int, int], cost: UInt16, axis_cost: Int64, distance: Int32, farthest: int
    ) -> None:
        self._ways = shape, cost, axis_cost
        self._distance, self._farthest = distance, farthest
        self._waiting, self._withdrawn = np.zeros(64, np.int64), np.zeros(64, np.int64)
        self._fed: list[tuple[Int64, UInt8]] = []
        self._journal: list[tuple[Int64, UInt8]] = []

    @property
    def waiting_count(self) -> int:
        """Number of voxels that wait for their turn."""
        return int(self._waiting[0] + self._withdrawn[0])

    @property
    def is_busy(self) -> bool:
        """Whether anything has still to be mended."""
        return self.waiting_count > 0

    def feed(self, voxels: Int64, before: UInt8, painted: UInt8, marks: UInt8) -> tuple[Int64, UInt8]:
        """Begin with voxels that were painted or erased; those whose marks change at once, and the new ones.

        Parameters
        ----------
        voxels
            Flat indices, each once. None of them may be erased while this is busy.
        before
            What each was painted with before; 255 where it was not.
        painted
            Labels of the painted voxels as they are now; 255 elsewhere.
        marks
            Labels from before.
        """
        self._fed.append((voxels, before))
        self._waiting, self._withdrawn, *noted = feed(
            self._ways[0], voxels, painted, marks, self._distance, self._waiting, self._withdrawn
        )
        self._note(*noted)
        changed = voxels[(painted[voxels] != UNMARKED) & (painted[voxels] != marks[voxels])]
        return changed, painted[changed]

    def go_on(self, painted: UInt8, marks: UInt8, most: int) -> Mended:
        """Mend so many voxels, at most; ``marks`` stays as it was."""
        self._waiting, self._withdrawn, withdrawn_count, *noted = withdraw(
            *self._ways, marks, self._distance, self._waiting, self._withdrawn, most
        )
        self._note(*noted)
        if self._withdrawn[0]:
            return Mended(np.empty(0, np.int64), np.empty(0, np.uint8), withdrawn_count, is_too_far=False)
        self._waiting, voxels, labels, spread_count, is_too_far, *noted = spread(
            *self._ways, painted, marks, self._distance, self._waiting, self._farthest, most - withdrawn_count
        )
        self._note(*noted)
        return Mended(voxels, labels, withdrawn_count + spread_count, is_too_far)

    def take_back(self, marks: UInt8) -> tuple[tuple[Int64, UInt8], tuple[Int64, UInt8]]:
        """Be as before all that was fed; ``marks`` stays as it was, and this has done its work.

        Returns
        -------
        tuple
            Voxels whose marks change by that, and the marks; and the voxels that had been fed, with what they were
            painted with before, of each first what was fed first.
        """
        pieces = [take_back(*noted, marks, self._distance) for noted in reversed(self._journal)]
        changed, now = (np.concatenate(one) for one in zip(*pieces, strict=True))
        labels = marks[changed]
        # of several, what was taken back first
        marks[changed[::-1]] = now[::-1]
        voxels, before = (np.concatenate(one) for one in zip(*self._fed, strict=True))
        return (changed, labels), (voxels, before)

    def _note(self, noted: Int64, marks: UInt8) -> None:
        if len(noted):
            self._journal.append((noted, marks))
