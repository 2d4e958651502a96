"""Parting a lattice: cells, nodes and springs of its own for each piece that a sheet leaves.

A cell of which a sheet leaves two pieces becomes two cells in one place. Each has its own share of coverage, moments
and mass, and its own copy of those nodes that it does not reach through uncut tissue. So stiffness and mass stay whole
up to the cut, in every force law; nothing moves when tissue is cut, as copies lie and go where their node does; and as
a cell's frequency does not depend on its coverage, the time step stays as long as it was.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Any, NamedTuple

import numpy as np

from heartcase.schemas.arrays import Bool, Float32, Float64, Int8, Int32, Int64
from heartcase.schemas.errors import SimulationError
from heartcase.simulator.cutting.blade_sheet import Links, Sheet
from heartcase.simulator.cutting.further_pieces import FoundPieces
from heartcase.simulator.cutting.parting_kernels import add_up_samples, merge_springs, spring_places
from heartcase.simulator.cutting.piece_frequency import bounded_moments
from heartcase.simulator.cutting.pieces import Pieces, find_pieces
from heartcase.simulator.cutting.tissue_samples import SAMPLE_PLACES, SAMPLE_VARIANCE, TissueSamples
from heartcase.simulator.lattice.model import CELL_SPRINGS, LatticeModel
from heartcase.simulator.lattice.state import State

__all__ = ["PartedLattice", "links_together", "part"]


@dataclass(frozen=True)
class PartedLattice:
    """A lattice that was cut, and what it was made of."""

    model: LatticeModel
    """Cells and nodes of the uncut lattice keep their numbers; pieces and copies follow."""
    node_origin: Int32
    """Node of the uncut lattice that each node is, or is a copy of, shape (node_count,)."""
    cell_origin: Int32
    """Cell of the uncut lattice that each cell is, or is a piece of, shape (cell_count,)."""
    pieces: Pieces
    """Pieces of the uncut cells around the sheets."""
    found: FoundPieces | None = field(default=None, repr=False, compare=False)
    """What a further sheet goes on from; None where all was done at once."""

    def carried(self, state: State) -> State:
        """A state of the uncut lattice: copies lie, and go, where their node does."""
        return state.of_nodes(self.node_origin)


def part(model: LatticeModel, sheets: Sequence[Sheet], tissue: TissueSamples) -> PartedLattice:
    """Part a lattice along all sheets at once; the order in which they were swept does not matter.

    Parameters
    ----------
    model
        The uncut lattice.
    sheets
        What the blade swept, at rest.
    tissue
        Samples of the tissue.

    Raises
    ------
    SimulationError
        Springs of the lattice were removed: what they held together is not known.
    """
    if not model.cell_is_whole.all():
        raise SimulationError("springs of this lattice were removed: cut it by sheets only", place="cut")
    links, beyond = (
        links_together([sheet.links for sheet in sheets]),
        links_together([sheet.links_beyond for sheet in sheets]),
    )
    return _parted(model, find_pieces(model, tissue, links, beyond))


def links_together(links: Sequence[Links]) -> Links:
    """The links of several lists, each once, ascending."""
    nothing = np.zeros(0, np.int64)
    x, y, z = (np.unique(np.concatenate([nothing, *(each[axis] for each in links)])) for axis in range(3))
    return x, y, z


def _parted(model: LatticeModel, pieces: Pieces) -> PartedLattice:
    is_first = np.zeros(pieces.counts.sum(), np.bool_)
    is_first[pieces.first] = True
    of_cell = np.repeat(pieces.cells, pieces.counts)
    # The first piece keeps the cell's number, and the first copy the node's.
    added = of_cell[~is_first]
    rows = np.concatenate([of_cell[is_first], model.cell_count + np.arange(len(added))])
    copies = np.concatenate([pieces.copies[is_first], pieces.copies[~is_first]])
    around = model.cell_corners[np.concatenate([of_cell[is_first], added])].astype(np.int64)
    is_copied = copies > 0
    most = int(copies.max(initial=0)) + 1
    made, number = np.unique(around[is_copied] * most + copies[is_copied], return_inverse=True)
    around[is_copied] = model.node_count + number.ravel()
    nodes = made // most

    def with_pieces(values: Any) -> Any:
        return np.concatenate([values, values[added]])

    corners = with_pieces(model.cell_corners)
    corners[rows] = around
    node_origin = np.concatenate([np.arange(model.node_count, dtype=np.int32), nodes.astype(np.int32)])
    cell_origin = np.concatenate([np.arange(model.cell_count, dtype=np.int32), added.astype(np.int32)])

    coverage, moments = _shares(model, pieces)
    cell_coverage, cell_moments = with_pieces(model.cell_coverage), with_pieces(model.cell_moments)
    order = np.concatenate([np.flatnonzero(is_first), np.flatnonzero(~is_first)])
    is_parted = np.repeat(pieces.counts > 1, pieces.counts)[order]
    cell_coverage[rows[is_parted]] = coverage[order[is_parted]]
    cell_moments[rows[is_parted]] = bounded_moments(model.law, moments[order[is_parted]])

    stiffness, density = with_pieces(model.cell_stiffness), with_pieces(model.cell_density)
    near = _near_copies(model, node_origin, corners, rows)
    of_near = cell_coverage[near.cells].astype(np.float64)
    springs = _springs(model, near, of_near * stiffness[near.cells])
    parted = replace(
        model,
        cells=with_pieces(model.cells),
        cell_corners=corners,
        cell_coverage=cell_coverage,
        cell_stiffness=stiffness,
        cell_density=density,
        cell_moments=cell_moments,
        cell_shares=with_pieces(model.cell_shares),
        cell_is_whole=np.ones(len(cell_origin), np.bool_),
        node_index=np.concatenate([model.node_index, model.node_index[nodes]]),
        node_mass=_masses(model, near, of_near * density[near.cells]),
        node_is_fixed=np.concatenate([model.node_is_fixed, model.node_is_fixed[nodes]]),
        spring_nodes=springs[0],
        spring_direction=springs[1],
        spring_weight=springs[2],
    )
    return PartedLattice(parted, node_origin, cell_origin, pieces)


class _NearCopies(NamedTuple):
    """Cells around nodes of which there are copies: only there masses and springs are shared out."""

    node_origin: Int32
    """Node of the uncut lattice that each node is, or is a copy of, shape (node_count,)."""
    has_copies: Bool
    """Nodes of the uncut lattice of which there are copies, shape (uncut node count,)."""
    cells: Int64
    """Cells around these and their copies, ascending, shape (count,)."""
    corners: Int32
    """Their corners, shape (count, 8)."""


def _near_copies(model: LatticeModel, node_origin: Int32, corners: Int32, rows: Int64) -> _NearCopies:
    """What lies around copies, among the cells of all pieces, whose numbers are given in ascending order."""
    has_copies = np.zeros(model.node_count, np.bool_)
    has_copies[node_origin[model.node_count :]] = True
    cells = rows[has_copies[node_origin[corners[rows]]].any(axis=1)]
    return _NearCopies(node_origin, has_copies, cells, corners[cells])


def _shares(model: LatticeModel, pieces: Pieces) -> tuple[Float32, Float64]:
    """Coverage and moments of each piece: those of its cell, shared out as its samples are."""
    piece_count = int(pieces.counts.sum())
    sizes, sums = np.zeros(piece_count, np.int64), np.zeros((piece_count, 9))
    add_up_samples(pieces.samples, pieces.first, SAMPLE_PLACES, SAMPLE_VARIANCE, sizes, sums)
    of_cell = np.repeat(np.arange(len(pieces.cells)), pieces.counts)
    cell_sizes = np.bincount(of_cell, sizes, minlength=len(pieces.cells))
    cell_sums = np.stack([np.bincount(of_cell, column, minlength=len(pieces.cells)) for column in sums.T], axis=1)
    coverage = model.cell_coverage[pieces.cells[of_cell]] * (sizes / cell_sizes[of_cell])
    # What the samples say of the whole cell is a little off: each piece is moved by as much.
    known = model.cell_moments[pieces.cells].astype(np.float64)
    moments = sums / sizes[:, None] + (known - cell_sums / cell_sizes[:, None])[of_cell]
    return coverage.astype(np.float32), _possible(moments)


def _possible(moments: Float64) -> Float64:
    """Moments of tissue that lies in its cell and has a shape."""
    first = np.clip(moments[:, :3], -0.5, 0.5)
    second = np.clip(moments[:, 3:6], first**2 + SAMPLE_VARIANCE, 0.5)
    return np.concatenate([first, second, np.clip(moments[:, 6:], -0.5, 0.5)], axis=1)


def _masses(model: LatticeModel, near: _NearCopies, cell_mass: Float64) -> Float32:
    """Mass of each node: that of the uncut lattice's, shared out among its copies."""
    nodes, number = np.unique(near.corners, return_inverse=True)
    of_node = np.bincount(number.ravel(), np.repeat(cell_mass, 8))
    is_shared = near.has_copies[near.node_origin[nodes]]
    nodes, of_node = nodes[is_shared], of_node[is_shared]
    origin = near.node_origin[nodes]
    _, which = np.unique(origin, return_inverse=True)
    whole = np.bincount(which.ravel(), of_node)[which.ravel()] if len(nodes) else of_node
    mass = np.concatenate([model.node_mass, np.zeros(len(near.node_origin) - model.node_count, np.float32)])
    mass[nodes] = (model.node_mass[origin] * (of_node / whole)).astype(np.float32)
    return mass


def _springs(model: LatticeModel, near: _NearCopies, stiffness: Float64) -> tuple[Int32, Int8, Float32]:
    """Both nodes, direction and stiffness of each spring, by lower node, then direction.

    They are those of the uncut lattice, shared out among their copies. Where no node has a copy all stays as it was.
    """
    pairs, share, direction = CELL_SPRINGS
    node_count = len(near.node_origin)
    ends = near.corners[:, pairs].astype(np.int64)
    keys = ((ends[..., 0] * 9 + direction) * node_count + ends[..., 1]).ravel()
    shares = (stiffness[:, None] * share).ravel()
    is_shared = near.has_copies[near.node_origin[ends]].any(axis=2).ravel()
    used, number = np.unique(keys[is_shared], return_inverse=True)
    weight = np.bincount(number.ravel(), shares[is_shared], minlength=len(used))
    lower, way, higher = used // (9 * node_count), used // node_count % 9, used % node_count
    origin = np.empty(len(used), np.int64)
    spring_places(model.first_springs, model.spring_direction, near.node_origin[lower], way, origin)
    _, which = np.unique(origin, return_inverse=True)
    whole = np.bincount(which.ravel(), weight)[which.ravel()] if len(used) else weight
    shared = (model.spring_weight[origin] * (weight / whole)).astype(np.float32)

    room = model.spring_count + len(used)
    nodes, directions, weights = np.empty((room, 2), np.int32), np.empty(room, np.int8), np.empty(room, np.float32)
    count = merge_springs(
        model.spring_nodes,
        model.spring_direction,
        model.spring_weight,
        near.has_copies,
        np.stack([lower, way, higher], axis=1),
        shared,
        nodes,
        directions,
        weights,
    )
    return nodes[:count], directions[:count], weights[:count]
