"""Structures that are locked: what others paint must leave every voxel of them as it is."""

from __future__ import annotations

from collections.abc import Collection

import numpy as np

from heartcase.pipeline.data import UNMARKED
from heartcase.pipeline.watershed.boxes import Box
from heartcase.schemas.arrays import UInt8

__all__ = ["Locks"]


class Locks:
    """Which labels are locked, and where they are.

    Parameters
    ----------
    values
        Label values.
    labels
        Label of every voxel now, uint8, shape [z, y, x].
    """

    def __init__(self, values: Collection[int], labels: UInt8) -> None:
        self.values = frozenset(values)
        """Label values."""
        self._is_locked = np.zeros(256, np.bool_)
        self._is_locked[sorted(self.values)] = True
        self._held: UInt8 = np.where(self._is_locked[labels], labels, np.uint8(UNMARKED))

    def changed_by(self, value: int, labels: UInt8, box: Box | None) -> dict[int, int]:
        """Locked labels of which voxels changed: label value -> how many were lost or won.

        Parameters
        ----------
        value
            Label that was painted, which may change itself; 255 or above where something was erased.
        labels
            Label of every voxel now.
        box
            Where some changed; None where none did.
        """
        if box is None:
            return {}
        now, held = labels[box], self._held[box]
        # unlocked labels are held as unmarked, and one that is not locked any more is no loss
        differs = np.where(self._is_locked[now], now, np.uint8(UNMARKED)) != held
        if not differs.any():
            return {}
        counts = np.bincount(now[differs], minlength=256) + np.bincount(held[differs], minlength=256)
        return {one: int(counts[one]) for one in sorted(self.values - {value}) if counts[one]}

    def hold(self, labels: UInt8, box: Box | None) -> None:
        """What holds in a box now is what is locked."""
        if box is not None:
            self._held[box] = np.where(self._is_locked[labels[box]], labels[box], np.uint8(UNMARKED))
