"""Looking for corners that are about to turn inside out, in the middle of a launch.

All threads of the grid look through the cells together and decide alike, so that the host need not wait for the device
between two looks: a launch goes on until what it found is no longer for its kernel.
"""

from __future__ import annotations

import numpy as np
from numba import cuda

from heartcase.simulator.engine.cuda.intrinsics import load_four, wait_at_grid_barrier
from heartcase.simulator.forces.cell_math import make_cell_math
from heartcase.simulator.lattice.moduli import LOOK_BELOW

__all__ = ["any_corner_is_flat", "cell_functions", "corners_of"]

_U = np.uint32
_O = np.float32(0.0)
_LOOK = np.float32(LOOK_BELOW)


@cuda.jit(device=True)
def _positive_part(value):
    return value if value > _O else _O


cell_functions = make_cell_math(cuda.jit(device=True), _positive_part)
"""The functions of one cell, for kernels on a device."""
_corner_lack = cell_functions.corner_lack


@cuda.jit(device=True)
def _corner(displacement, buffer, corner_lane, place):
    u = load_four(displacement, _U(buffer + corner_lane[place]))
    return u[0], u[1], u[2]


@cuda.jit(device=True)
def corners_of(displacement, buffer, corner_lane, cell, count):
    """Displacements of the eight corners of a cell; ``buffer`` is where the displacements begin."""
    return (
        _corner(displacement, buffer, corner_lane, _U(cell)),
        _corner(displacement, buffer, corner_lane, _U(count + cell)),
        _corner(displacement, buffer, corner_lane, _U(2 * count + cell)),
        _corner(displacement, buffer, corner_lane, _U(3 * count + cell)),
        _corner(displacement, buffer, corner_lane, _U(4 * count + cell)),
        _corner(displacement, buffer, corner_lane, _U(5 * count + cell)),
        _corner(displacement, buffer, corner_lane, _U(6 * count + cell)),
        _corner(displacement, buffer, corner_lane, _U(7 * count + cell)),
    )


@cuda.jit(device=True)
def any_corner_is_flat(displacement, buffer, corner_lane, numbers, arrivals, expected, look):
    """Whether a corner of a cell that has stiffness is below LOOK_BELOW; all threads of the grid ask, and wait.

    Parameters
    ----------
    arrivals
        The barrier's count, and the last look that found one, uint32, shape (2,).
    expected
        What the count is to reach.
    look
        The look's number in this launch, from one on.
    """
    count = _U(corner_lane.shape[0] // 8)
    for cell in range(cuda.grid(1), count, cuda.gridsize(1)):
        u = corners_of(displacement, buffer, corner_lane, _U(cell), count)
        if _corner_lack(u, _LOOK) * numbers[_U(cell)] > _O:
            arrivals[1] = look
    wait_at_grid_barrier(arrivals, expected)
    return arrivals[1] == look
