"""Parting a lattice: cells, nodes and springs of its own for each piece that a sheet leaves.

A cell of which a sheet leaves two pieces becomes two cells in one place. Each has its own share of coverage, moments
and mass, and its own copy of those nodes that it does not reach through uncut tissue. So stiffness and mass stay whole
up to the cut, in every force law; nothing moves when tissue is cut, as copies lie and go where their node does; and as
a cell's frequency does not depend on its coverage, the time step stays as long as it was.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from heartcase.schemas.arrays import Float32, Float64, Int8, Int32, Int64
from heartcase.schemas.errors import SimulationError
from heartcase.simulator.cutting.blade_sheet import Links, Sheet
from heartcase.simulator.cutting.crossings import SAMPLES
from heartcase.simulator.cutting.piece_frequency import bounded_moments
from heartcase.simulator.cutting.pieces import Pieces, find_pieces
from heartcase.simulator.cutting.tissue_samples import SAMPLE_PLACES, TissueSamples
from heartcase.simulator.lattice.model import CELL_SPRINGS, LatticeModel
from heartcase.simulator.lattice.state import State

__all__ = ["PartedLattice", "part"]

_SAMPLE_VARIANCE = 1.0 / 12.0 / SAMPLES**2
"""Of the tissue that a sample stands for, along each axis [edges squared]."""


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
        _together([sheet.links() for sheet in sheets]),
        _together([sheet.links_beyond() for sheet in sheets]),
    )
    return _parted(model, find_pieces(model, tissue, links, beyond))


def _together(links: Sequence[Links]) -> Links:
    nothing = np.zeros(0, np.int64)
    x, y, z = (np.unique(np.concatenate([nothing, *(each[axis] for each in links)])) for axis in range(3))
    return x, y, z


def _parted(model: LatticeModel, pieces: Pieces) -> PartedLattice:
    is_first = np.zeros(pieces.counts.sum(), np.bool_)
    is_first[pieces.first] = True
    of_cell = np.repeat(pieces.cells, pieces.counts)
    # The first piece keeps the cell's number, and the first copy the node's.
    cell_origin = np.concatenate([np.arange(model.cell_count), of_cell[~is_first]])
    corners = model.cell_corners[cell_origin].astype(np.int64)
    rows = np.concatenate([of_cell[is_first], model.cell_count + np.arange((~is_first).sum())])
    copies = np.zeros_like(corners)
    copies[rows] = np.concatenate([pieces.copies[is_first], pieces.copies[~is_first]])
    is_copied = copies > 0
    made, number = np.unique(np.stack([corners[is_copied], copies[is_copied]], axis=1), axis=0, return_inverse=True)
    corners[is_copied] = model.node_count + number.ravel()
    node_origin = np.concatenate([np.arange(model.node_count), made[:, 0]])

    coverage, moments = _shares(model, pieces)
    cell_coverage = model.cell_coverage[cell_origin]
    cell_moments = model.cell_moments[cell_origin]
    order = np.concatenate([np.flatnonzero(is_first), np.flatnonzero(~is_first)])
    is_parted = np.repeat(pieces.counts > 1, pieces.counts)[order]
    cell_coverage[rows[is_parted]] = coverage[order[is_parted]]
    cell_moments[rows[is_parted]] = bounded_moments(model.law, moments[order[is_parted]])

    stiffness, density = model.cell_stiffness[cell_origin], model.cell_density[cell_origin]
    corners = corners.astype(np.int32)
    springs = _springs(model, node_origin, corners, cell_coverage.astype(np.float64) * stiffness)
    parted = replace(
        model,
        cells=model.cells[cell_origin],
        cell_corners=corners,
        cell_coverage=cell_coverage,
        cell_stiffness=stiffness,
        cell_density=density,
        cell_moments=cell_moments,
        cell_shares=model.cell_shares[cell_origin],
        cell_is_whole=np.ones(len(cell_origin), np.bool_),
        node_index=model.node_index[node_origin],
        node_mass=_masses(model, node_origin, corners, cell_coverage.astype(np.float64) * density),
        node_is_fixed=model.node_is_fixed[node_origin],
        spring_nodes=springs[0],
        spring_direction=springs[1],
        spring_weight=springs[2],
    )
    return PartedLattice(parted, node_origin.astype(np.int32), cell_origin.astype(np.int32), pieces)


def _shares(model: LatticeModel, pieces: Pieces) -> tuple[Float32, Float64]:
    """Coverage and moments of each piece: those of its cell, shared out as its samples are."""
    piece = pieces.samples + pieces.first[:, None]
    is_tissue = pieces.samples >= 0
    number = piece[is_tissue]
    piece_count = int(pieces.counts.sum())
    place = np.broadcast_to(SAMPLE_PLACES, (*piece.shape, 3))[is_tissue]
    x, y, z = place.T
    terms = (x, y, z, x * x + _SAMPLE_VARIANCE, y * y + _SAMPLE_VARIANCE, z * z + _SAMPLE_VARIANCE, y * z, x * z, x * y)
    sizes = np.bincount(number, minlength=piece_count)
    sums = np.stack([np.bincount(number, term, minlength=piece_count) for term in terms], axis=1)
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
    second = np.clip(moments[:, 3:6], first**2 + _SAMPLE_VARIANCE, 0.5)
    return np.concatenate([first, second, np.clip(moments[:, 6:], -0.5, 0.5)], axis=1)


def _masses(model: LatticeModel, node_origin: Int64, corners: Int32, cell_mass: Float64) -> Float32:
    """Mass of each node: that of the uncut lattice's, shared out among its copies."""
    of_node = np.bincount(corners.ravel(), np.repeat(cell_mass, 8), minlength=len(node_origin))
    whole = np.bincount(node_origin, of_node)[node_origin]
    mass: Float32 = (model.node_mass[node_origin] * (of_node / whole)).astype(np.float32)
    return mass


def _springs(
    model: LatticeModel, node_origin: Int64, corners: Int32, stiffness: Float64
) -> tuple[Int32, Int8, Float32]:
    """Both nodes, direction and stiffness of each spring, by lower node, then direction.

    They are those of the uncut lattice, shared out among their copies.
    """
    pairs, share, direction = CELL_SPRINGS
    node_count = len(node_origin)
    # Where no node has a copy all stays as it was.
    has_copies = np.zeros(model.node_count, np.bool_)
    has_copies[node_origin[model.node_count :]] = True
    near = has_copies[node_origin[corners]].any(axis=1)
    ends = corners[near][:, pairs].astype(np.int64)
    keys = ((ends[..., 0] * 9 + direction) * node_count + ends[..., 1]).ravel()
    shares = (stiffness[near, None] * share).ravel()
    is_shared = has_copies[node_origin[ends]].any(axis=2).ravel()
    used, number = np.unique(keys[is_shared], return_inverse=True)
    weight = np.bincount(number.ravel(), shares[is_shared])
    uncut = model.spring_nodes[:, 0].astype(np.int64) * 9 + model.spring_direction
    origin = np.searchsorted(uncut, node_origin[used // (9 * node_count)] * 9 + used // node_count % 9)
    whole = np.bincount(origin, weight)[origin]
    shared = model.spring_weight[origin] * (weight / whole)

    kept = ~has_copies[model.spring_nodes].any(axis=1)
    kept_keys = uncut[kept] * node_count + model.spring_nodes[kept, 1]
    keys = np.concatenate([kept_keys, used])
    order = np.argsort(keys, kind="stable")
    keys = keys[order]
    nodes = np.stack([keys // (9 * node_count), keys % node_count], axis=1)
    weights = np.concatenate([model.spring_weight[kept], shared.astype(np.float32)])[order]
    return nodes.astype(np.int32), (keys // node_count % 9).astype(np.int8), weights
