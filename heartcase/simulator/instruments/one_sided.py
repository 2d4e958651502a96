"""What holds tissue on one side of all incisions: forceps and retractors."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from heartcase.schemas.arrays import Float64, Int64, Intp
from heartcase.simulator.instruments.grab import Grab
from heartcase.simulator.instruments.held_tissue import on_own_side
from heartcase.simulator.lattice.model import LatticeModel

__all__ = ["OneSidedGrab"]


@dataclass(eq=False)
class OneSidedGrab(Grab):
    """A grab that knows from which tissue it reached each node, and holds none across an incision from there."""

    roots: Float64 = field(default_factory=lambda: np.zeros((0, 3)))
    """Tissue at rest from which each node was reached [cells, frame of the nodes], shape (count, 3)."""

    def carry(self, nodes: Intp, place: Int64) -> None:
        """Hold other nodes from now on: those of a lattice that was cut further, each from the one at ``place``."""
        super().carry(nodes, place)
        self.roots = self.roots[place]

    def keep_side(self, model: LatticeModel, sheets: Float64) -> None:
        """Let go of what a further cut put onto the other side of it; all is kept where nothing else would be left.

        Parameters
        ----------
        model
            The lattice after the cut.
        sheets
            Triangles of all that was cut, at rest [cells, frame of the nodes], shape (triangle_count, 3, 3).
        """
        kept = np.flatnonzero(on_own_side(model, sheets, self.nodes, self.roots))
        if len(kept):
            self.carry(self.nodes[kept], kept)
