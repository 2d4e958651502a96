"""How quick elements are along the cuts: pieces that hang on little vibrate by themselves, and hardly reach further.

A vibration that is quicker than all that the tissue around it can do fades within a cell or two. So the highest
frequency of a lattice that was cut is that of the lattice before, or that of what lies around the cuts, as a lattice of
its own whose nodes have all their mass (``tests/simulator/cutting/test_cut_frequency.py`` has it beside that of the
whole). To work that out takes milliseconds, and seconds for the whole.
"""

from __future__ import annotations

import numpy as np

from heartcase.schemas.arrays import Bool
from heartcase.simulator.cutting.parted_lattice import PartedLattice
from heartcase.simulator.dynamics.spectrum import largest_eigenvalue
from heartcase.simulator.lattice.model import LatticeModel
from heartcase.simulator.lattice.sub_lattice import sub_lattice

__all__ = ["cells_around", "rate_along_cuts"]

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
    return largest_eigenvalue(cells_around(parted.model, is_copied, _RINGS), shortfall=_SHORTFALL).upper


def cells_around(model: LatticeModel, nodes: Bool, ring_count: int) -> LatticeModel:
    """Elements around some nodes, and so many rings of cells around those, as a lattice whose nodes keep their mass.

    Parameters
    ----------
    model
        A lattice of elements, of which no springs were removed.
    nodes
        True for each of the nodes, shape (node_count,).
    ring_count
        Rings of cells.
    """
    is_near, cells = nodes, np.zeros(0, np.int64)
    for _ in range(ring_count + 1):
        cells = np.flatnonzero(is_near[model.cell_corners].any(axis=1))
        is_near = np.zeros(model.node_count, np.bool_)
        is_near[model.cell_corners[cells]] = True
    return sub_lattice(model, cells)[0]
