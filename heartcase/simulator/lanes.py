"""The nodes in lanes: how the CPU kernel lays out a lattice in memory.

Nodes are stored in blocks of 8 lanes: 8 neighbours along i, aligned, so that a vector instruction works on a whole
block and a neighbour along (i, j, k) is the lane at a fixed distance in the block of its row (j, k). Lanes without a
node have no mass and no springs: they cost time but change nothing. Blocks that follow each other along i lie side by
side; between such runs lies an empty block, so that the lane before a run's first and after its last is empty too.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from heartcase.schemas.lattice import lattice_keys
from heartcase.simulator.model import DIRECTIONS, LatticeModel

__all__ = ["LANE_COUNT", "ROWS", "LaneLayout", "lane_layout"]

LANE_COUNT = 8
"""Lanes of a block: one AVX register or two of NEON in float32. 16 leave more lanes of thin walls empty: slower."""

ROWS: npt.NDArray[np.int32] = np.array([(j, k) for k in (-1, 0, 1) for j in (-1, 0, 1)], dtype=np.int32)
"""Offset (j, k) of a block's own row (number 4) and of the eight rows around it, shape (9, 2)."""

_HEAD = 3 * LANE_COUNT
_EMPTY_START = LANE_COUNT


@dataclass(frozen=True)
class LaneLayout:
    """Where the nodes are in memory. Springs may be removed or change; the layout stays."""

    lane_count: int
    """Length of an array with one value per lane."""
    node_lane: npt.NDArray[np.int64]
    """Lane of each node, shape (node_count,)."""
    node_slot: npt.NDArray[np.int64]
    """Number of the node's block times 8 plus its place there, shape (node_count,)."""
    block_rows: npt.NDArray[np.int64]
    """First lane of the block at the same i in the nine ROWS of each block, shape (block_count, 9); an empty block
    where a row has none."""

    @property
    def block_count(self) -> int:
        """Number of blocks that hold a node."""
        return len(self.block_rows)

    def spring_weight(self, model: LatticeModel) -> npt.NDArray[np.float32]:
        """Stiffness of the spring from each lane along each of the nine DIRECTIONS [k], shape (9, lane_count)."""
        weight = np.zeros((len(DIRECTIONS), self.lane_count), np.float32)
        weight[model.spring_direction, self.node_lane[model.spring_nodes[:, 0]]] = model.spring_weight
        return weight

    def uniform_weight(self, model: LatticeModel) -> npt.NDArray[np.float32]:
        """Stiffness of all springs of a block's nodes, where each has 18 and all are alike, else 0 [k].

        Shape (block_count,).
        """
        ends = model.spring_nodes.ravel()
        both = np.repeat(model.spring_weight, 2)
        lowest = np.where(np.bincount(ends, minlength=model.node_count) == 2 * len(DIRECTIONS), np.inf, 0.0)
        highest = np.zeros(model.node_count)
        np.minimum.at(lowest, ends, both)
        np.maximum.at(highest, ends, both)
        first = np.flatnonzero(np.diff(self.node_slot // LANE_COUNT, prepend=-1))
        low, high = np.minimum.reduceat(lowest, first), np.maximum.reduceat(highest, first)
        return np.where(low == high, low, 0.0).astype(np.float32)

    def blocks_of(self, nodes: npt.NDArray[np.intp]) -> npt.NDArray[np.int64]:
        """Rows of the blocks that hold some nodes, shape (count, 9)."""
        return self.block_rows[np.unique(self.node_slot[nodes] // LANE_COUNT)]


def lane_layout(model: LatticeModel) -> LaneLayout:
    """Lay out a lattice in lanes."""
    blocks = model.node_index.copy()
    blocks[:, 0] //= LANE_COUNT
    keys = lattice_keys(blocks)
    first = np.flatnonzero(np.diff(keys, prepend=keys[0] - 1))
    used = keys[first]
    # A spring over a block's end is found through the block at the same i in the other's row: store that too.
    over = model.spring_nodes[np.diff(blocks[:, 0][model.spring_nodes], axis=1)[:, 0] != 0]
    lower, higher = blocks[over[:, 0]], blocks[over[:, 1]]
    beside_lower = np.column_stack([higher[:, 0], lower[:, 1:]])
    beside_higher = np.column_stack([lower[:, 0], higher[:, 1:]])
    stored = np.unique(np.concatenate([used, lattice_keys(beside_lower), lattice_keys(beside_higher)]))
    run = np.cumsum(np.diff(stored, prepend=stored[0] - 2) != 1)
    start = _HEAD + LANE_COUNT * (np.arange(len(stored)) + run - 1)
    lane_count = int(start[-1]) + 2 * LANE_COUNT

    node_block = np.searchsorted(stored, keys)
    place = model.node_index[:, 0] % LANE_COUNT
    node_lane = start[node_block] + place
    node_slot = LANE_COUNT * np.searchsorted(used, keys) + place

    rows = np.repeat(blocks[first, None, :], len(ROWS), axis=1)
    rows[:, :, 1:] += ROWS
    row_keys = lattice_keys(rows)
    nearest = np.minimum(np.searchsorted(stored, row_keys), len(stored) - 1)
    block_rows = np.where(stored[nearest] == row_keys, start[nearest], _EMPTY_START)

    return LaneLayout(lane_count=lane_count, node_lane=node_lane, node_slot=node_slot, block_rows=block_rows)
