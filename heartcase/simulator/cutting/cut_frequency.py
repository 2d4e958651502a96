"""How quick elements are along the cuts: pieces that hang on little vibrate by themselves, and hardly reach further.

A vibration that is quicker than all that the tissue around it can do fades within a cell or two. So the highest
frequency of a lattice that was cut is that of the lattice before, or that of what lies around the cuts, as a lattice of
its own whose nodes have all their mass (``tests/simulator/cutting/test_cut_frequency.py`` has it beside that of the
whole). To work that out takes milliseconds, and seconds for the whole.
"""

from __future__ import annotations

import numpy as np

from heartcase.simulator.cutting.parted_lattice import PartedLattice
from heartcase.simulator.dynamics.spectrum import largest_eigenvalue
from heartcase.simulator.lattice.sub_lattice import cells_around, sub_lattice

__all__ = ["rate_along_cuts"]

_RINGS = 1
"""Cells around those with copied nodes that are reckoned with."""
_SHORTFALL = 0.05
"""Most that the eigenvalue falls short, as a part of it: 2.5% of a step."""


def rate_along_cuts(parted: PartedLattice) -> float:
    """omega^2 at rest that elements around the cuts do not exceed [1 / unit of time^2]; 0 where nothing was parted."""
    copy_count = np.bincount(parted.node_origin)
    is_copied = copy_count[parted.node_origin] > 1
    if not is_copied.any():
        return 0.0
    around, _ = sub_lattice(parted.model, cells_around(parted.model, is_copied, _RINGS))
    return largest_eigenvalue(around, shortfall=_SHORTFALL).upper
