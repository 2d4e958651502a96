"""How quick elements are where threads and explicit springs tie them: around these alone, as it is along cuts.

A vibration that is quicker than all that the tissue around it can do fades within a cell or two. So a lattice in which
nodes are tied together has as its highest frequency what it has without, or that of what lies around the tied nodes
(``tests/simulator/dynamics/test_tied_frequency.py`` has it beside that of the whole).
"""

from __future__ import annotations

import numpy as np
from scipy.sparse import coo_array, csr_array

from heartcase.simulator.dynamics.spectrum import largest_eigenvalue
from heartcase.simulator.lattice.loose_nodes import loose_first, with_loose_nodes
from heartcase.simulator.lattice.model import LatticeModel
from heartcase.simulator.lattice.sub_lattice import cells_around, sub_lattice
from heartcase.simulator.lattice.tethers import Tethers

__all__ = ["rate_where_tied", "ties_of"]

_RINGS = 1
"""Cells around those with tied nodes that are reckoned with."""
_SHORTFALL = 0.05
"""Most that the eigenvalue falls short, as a part of it: 2.5% of a step."""


def rate_where_tied(model: LatticeModel, tethers: Tethers) -> float:
    """omega^2 that elements do not exceed where they are tied together [1 / unit of time^2]; 0 where nothing is.

    Every thread and explicit spring counts as if it resisted movements of its ends in all directions with its whole
    stiffness: none ever resists more, however it is stretched and turned.

    Parameters
    ----------
    model
        The lattice, with explicit springs, and loose nodes.
    tethers
        Threads in it.
    """
    if not tethers.count and not model.explicit.count:
        return 0.0
    ties, first = ties_of(model, tethers), loose_first(model)
    is_tied = np.zeros(model.node_count, np.bool_)
    is_tied[ties.indices] = True
    is_tied[first:] = False
    around, nodes = sub_lattice(model, cells_around(model, is_tied, _RINGS))
    if model.loose_count:
        around = with_loose_nodes(around, model.node_mass[first:])
        nodes = np.append(nodes, np.arange(first, model.node_count))
    return largest_eigenvalue(around, shortfall=_SHORTFALL, ties=ties[:, nodes]).upper


def ties_of(model: LatticeModel, tethers: Tethers) -> csr_array:
    """Threads and explicit springs as :func:`heartcase.simulator.dynamics.spectrum.largest_eigenvalue` takes them."""
    explicit = model.explicit
    root = np.sqrt(np.concatenate([tethers.stiffness, explicit.stiffness]).astype(np.float64))
    count, thread_count = len(root), tethers.count
    ends = np.tile([-1.0, 1.0], (explicit.count, 1))
    share = np.concatenate([tethers.shares.astype(np.float64).ravel(), ends.ravel()])
    of_tie = np.concatenate(
        [np.repeat(np.arange(thread_count), tethers.nodes.shape[1]), np.repeat(np.arange(thread_count, count), 2)]
    )
    node = np.concatenate([tethers.nodes.ravel(), explicit.nodes.ravel()])
    ties = coo_array((root[of_tie] * share, (of_tie, node)), shape=(count, model.node_count)).tocsr()
    ties.eliminate_zeros()
    return ties
