"""Some cells of a lattice as a lattice of their own."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from heartcase.schemas.arrays import Bool, Int64
from heartcase.simulator.lattice.explicit_springs import ExplicitSprings
from heartcase.simulator.lattice.model import LatticeModel

__all__ = ["cells_around", "sub_lattice"]


def sub_lattice(model: LatticeModel, cells: Int64) -> tuple[LatticeModel, Int64]:
    """Some cells, their nodes with all the mass that they have, and the springs between these.

    Explicit springs and loose nodes are left behind.

    Parameters
    ----------
    model
        The lattice.
    cells
        Numbers of the cells, ascending.

    Returns
    -------
    model
        The lattice of these cells.
    nodes
        Number that each of its nodes had, ascending.
    """
    nodes = np.unique(model.cell_corners[cells].astype(np.int64))
    number = np.full(model.node_count, -1, np.int32)
    number[nodes] = np.arange(len(nodes))
    springs = np.flatnonzero((number[model.spring_nodes] >= 0).all(axis=1))
    left = replace(
        model,
        cells=model.cells[cells],
        cell_corners=number[model.cell_corners[cells]],
        cell_coverage=model.cell_coverage[cells],
        cell_stiffness=model.cell_stiffness[cells],
        cell_density=model.cell_density[cells],
        cell_moments=model.cell_moments[cells],
        cell_shares=model.cell_shares[cells],
        cell_is_whole=model.cell_is_whole[cells],
        node_index=model.node_index[nodes],
        node_mass=model.node_mass[nodes],
        node_is_fixed=model.node_is_fixed[nodes],
        spring_nodes=number[model.spring_nodes[springs]],
        spring_direction=model.spring_direction[springs],
        spring_weight=model.spring_weight[springs],
        explicit=ExplicitSprings.none(),
        loose_count=0,
    )
    return left, nodes


def cells_around(model: LatticeModel, nodes: Bool, ring_count: int) -> Int64:
    """Cells with a corner at some nodes, and so many rings of cells around those, ascending.

    Parameters
    ----------
    model
        The lattice.
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
    return cells
