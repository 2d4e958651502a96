"""Numbers of nodes in lanes that lie in banks: kernels that write and read them."""

from __future__ import annotations

from heartcase.compiling.kernel import kernel
from heartcase.schemas.arrays import Float32, Int32, Int64
from heartcase.simulator.engine.shared.lanes import BANK_LANES, LANE_COUNT

__all__ = ["copy_into_windows", "read_vectors", "write_vectors"]


@kernel
def write_vectors(node_lane: Int64, vectors: Float32 | Int32, array: Float32) -> None:
    """Write the three numbers of each node, shape (node_count, 3)."""
    for node in range(len(node_lane)):
        for axis in range(3):
            array[axis * BANK_LANES + node_lane[node]] = vectors[node, axis]


@kernel
def read_vectors(node_lane: Int64, array: Float32, vectors: Float32) -> None:
    """Read the three numbers of each node, shape (node_count, 3)."""
    for node in range(len(node_lane)):
        for axis in range(3):
            vectors[node, axis] = array[axis * BANK_LANES + node_lane[node]]


@kernel
def copy_into_windows(array: Float32, rows: Int64, which: int, numbers: Float32) -> None:
    """Copy a number of each window's lanes to one of those that it has, shape (any, any, 8)."""
    for window in range(len(rows)):
        start = rows[window, 4]
        for place in range(LANE_COUNT):
            numbers[window, which, place] = array[start + place]
