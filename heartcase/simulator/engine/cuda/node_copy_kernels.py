"""The CUDA kernels that copy between nodes in their order and the lanes that they lie in."""

from __future__ import annotations

import numpy as np
from numba import cuda

from heartcase.simulator.engine.cuda.intrinsics import load_four, store_four

__all__ = ["gather_nodes", "scatter_nodes", "write_inverse_mass"]

_U = np.uint32
_O = np.float32(0.0)


@cuda.jit
def gather_nodes(by_lane, first, node_lane, by_node):
    """Copy x, y, z of the vectors by lane, from vector ``first`` on, to the nodes, shape (node_count, 3)."""
    node = cuda.grid(1)
    if node < node_lane.shape[0]:
        vector = load_four(by_lane, _U(first + node_lane[node]))
        by_node[node, 0], by_node[node, 1], by_node[node, 2] = vector[0], vector[1], vector[2]


@cuda.jit
def scatter_nodes(count, nodes, displacement_of, velocity_of, node_lane, first, displacement, velocity):
    """Write displacements and velocities of ``count`` nodes, shape (at least count, 3) each, into their lanes."""
    number = cuda.grid(1)
    if number < count:
        lane = node_lane[nodes[number]]
        u, v = displacement_of[number], velocity_of[number]
        store_four(displacement, _U(first + lane), u[0], u[1], u[2], _O)
        store_four(velocity, lane, v[0], v[1], v[2], load_four(velocity, lane)[3])


@cuda.jit
def write_inverse_mass(inverse_mass, node_lane, velocity):
    """Write the nodes' inverse masses, shape (node_count,), into their lanes."""
    node = cuda.grid(1)
    if node < node_lane.shape[0]:
        velocity[4 * node_lane[node] + 3] = inverse_mass[node]
