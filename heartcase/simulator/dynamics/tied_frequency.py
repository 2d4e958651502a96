"""How quick elements are where threads and explicit springs tie them: around these alone, as it is along cuts.

A vibration that is quicker than all that the tissue around it can do fades within a cell or two. So a lattice in which
nodes are tied together has as its highest frequency what it has without, or that of what lies around the tied nodes
(``tests/simulator/dynamics/test_tied_frequency.py`` has it beside that of the whole).
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from heartcase.simulator.dynamics.spectrum import Ties, largest_eigenvalue
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
    is_tied[ties.nodes] = True
    is_tied[first:] = False
    around, nodes = sub_lattice(model, cells_around(model, is_tied, _RINGS))
    if model.loose_count:
        around = with_loose_nodes(around, model.node_mass[first:])
        nodes = np.append(nodes, np.arange(first, model.node_count))
    number = np.empty(model.node_count, np.int64)
    number[nodes] = np.arange(len(nodes))
    ties = replace(ties, nodes=number[ties.nodes])
    return largest_eigenvalue(around, shortfall=_SHORTFALL, ties=ties).upper


def ties_of(model: LatticeModel, tethers: Tethers) -> Ties:
    """Threads and explicit springs as :func:`heartcase.simulator.dynamics.spectrum.largest_eigenvalue` takes them."""
    explicit, thread_count = model.explicit, tethers.count
    root = np.sqrt(np.concatenate([tethers.stiffness, explicit.stiffness]).astype(np.float64))
    of_threads = np.repeat(np.arange(thread_count), tethers.nodes.shape[1])
    of_springs = thread_count + np.repeat(np.arange(explicit.count), 2)
    number = np.concatenate([of_threads, of_springs])
    nodes = np.concatenate([tethers.nodes.ravel(), explicit.nodes.ravel()]).astype(np.int64)
    ends = np.tile([-1.0, 1.0], explicit.count)
    shares = root[number] * np.concatenate([tethers.shares.ravel().astype(np.float64), ends])
    kept = shares != 0.0
    return Ties(number[kept], nodes[kept], shares[kept])
