"""What tells that a simulation has left physics behind."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
from numba import njit

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
    fastest = _largest(state.velocity)
    if not np.isfinite(fastest + _largest(state.displacement)):
        return "a position is not a number any more"
    if fastest * step > RUNAWAY_CELLS_PER_STEP and led.any():
        fastest = _largest(state.velocity[~led])
    return "a node moved more than ten cells in one step" if fastest * step > RUNAWAY_CELLS_PER_STEP else None


def _largest(values: npt.NDArray[np.float32]) -> float:
    """Largest absolute value, or what is not finite, if there is any."""
    bits = _largest_bits(np.ascontiguousarray(values).view(np.int32).ravel())
    return float(np.int32(bits).view(np.float32))


@njit(cache=True, nogil=True)  # type: ignore[untyped-decorator]
def _largest_bits(bits: npt.NDArray[np.int32]) -> int:
    """Largest of the bits but the sign: they sort as the numbers do, and a maximum of integers is a vector's work."""
    largest = np.int32(0)
    for bit in bits:
        largest = max(largest, np.int32(bit & 0x7FFFFFFF))
    return int(largest)
