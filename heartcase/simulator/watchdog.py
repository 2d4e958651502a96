"""What tells that a simulation has left physics behind."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from heartcase.simulator.state import State

__all__ = ["RUNAWAY_CELLS_PER_STEP", "find_trouble"]

RUNAWAY_CELLS_PER_STEP = 10.0
"""A free node that moves further than this in one step (some 100 m/s) is past all physics: tissue that was stretched to
twice its length and let go reaches one or two."""


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
    return "a node moved more than ten cells in one step" if travel > RUNAWAY_CELLS_PER_STEP else None
