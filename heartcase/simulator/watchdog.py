"""What tells that a simulation has left physics behind."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from heartcase.simulator.model import LatticeModel
from heartcase.simulator.state import State

__all__ = ["RUNAWAY_CELLS_PER_STEP", "find_trouble", "inverted_cells"]

RUNAWAY_CELLS_PER_STEP = 1.0
"""A free node that moves further than this in one step is past all physics."""


def find_trouble(state: State, step: float, led: npt.NDArray[np.bool_]) -> str | None:
    """What is wrong with a state, in words; None when nothing is.

    Parameters
    ----------
    state
        State to look at.
    step
        Time step [units of time].
    led
        Nodes that a hand leads: they may be as quick as the hand, shape (node_count,).
    """
    if not (np.isfinite(state.velocity).all() and np.isfinite(state.displacement).all()):
        return "a position is not a number any more"
    travel = np.abs(state.velocity[~led]).max(initial=0.0) * step
    return "a node moved more than a cell in one step" if travel > RUNAWAY_CELLS_PER_STEP else None


def inverted_cells(model: LatticeModel, displacement: npt.NDArray[np.floating]) -> npt.NDArray[np.bool_]:
    """Cells that are turned inside out at one of their corners, shape (cell_count,).

    The volume spanned by the three edges at a corner is one at rest; not above zero means that the corner has been
    pushed through the opposite side. Springs alone do not turn it back.
    """
    position = model.node_index + displacement.astype(np.float64)
    corner = position[model.cell_corners]
    inverted = np.zeros(model.cell_count, dtype=bool)
    for c in range(8):
        edge = [(corner[:, c ^ bit] - corner[:, c]) * (-1 if c & bit else 1) for bit in (1, 2, 4)]
        inverted |= np.einsum("cx,cx->c", np.cross(edge[0], edge[1]), edge[2]) <= 0.0
    return inverted
