"""What pieces have of their cells, and springs among those that stay as they were: kernels of parting a lattice."""

from __future__ import annotations

import numpy as np

from heartcase.compiling.kernel import kernel
from heartcase.simulator.cutting.bit_masks.shares import add_sample

__all__ = ["add_up_samples", "merge_springs", "nearest_of_each", "spring_places"]


@kernel
def add_up_samples(samples, first, places, spread, sizes, sums):
    """Add up samples of each piece, and x, y, z, xx, yy, zz, yz, xz, xy over them; zeros at first.

    Parameters
    ----------
    samples
        Piece of each sample in its cell, or -1, shape (count, SAMPLES^3).
    first
        First piece of each cell, shape (count,).
    places
        Of the samples from the middle of a cell, shape (SAMPLES^3, 3).
    spread
        Variance of the tissue that a sample stands for, along each axis.
    sizes, sums
        Of the pieces, shapes (piece_count,) and (piece_count, 9), written.
    """
    for row in range(len(samples)):
        for sample in range(samples.shape[1]):
            if samples[row, sample] < 0:
                continue
            piece = first[row] + samples[row, sample]
            sizes[piece] += 1
            add_sample(places, sample, spread, sums, piece)


@kernel
def nearest_of_each(points, others, squares):
    """Write the square of the distance from each point to the nearest of others; infinity where there are none."""
    for point in range(len(points)):
        least = np.inf
        for other in range(len(others)):
            x = points[point, 0] - others[other, 0]
            y = points[point, 1] - others[other, 1]
            z = points[point, 2] - others[other, 2]
            least = min(least, x * x + y * y + z * z)
        squares[point] = least


@kernel
def spring_places(first, directions, lower, wanted, places):
    """Write the place of the springs from some nodes along some directions among all, which are in their order.

    Parameters
    ----------
    first
        First spring from each node, and the last end, shape (node_count + 1,).
    directions
        Of all springs, shape (spring_count,).
    lower, wanted
        Node and direction of each spring that is looked for, shape (count,).
    places
        Shape (count,), written.
    """
    for number in range(len(lower)):
        place = first[lower[number]]
        while directions[place] != wanted[number]:
            place += 1
        places[number] = place


@kernel
def merge_springs(nodes, directions, weights, has_copies, keys, added, new_nodes, new_directions, new_weights):
    """Write the springs that stay and those that are added, by lower node, direction and higher node.

    Parameters
    ----------
    nodes, directions, weights
        Springs of a lattice in this order.
    has_copies
        Nodes whose springs go, shape (node_count,).
    keys, added
        Lower node, direction and higher node of the springs that are added, in this order, shape (added_count, 3), and
        their stiffness.
    new_nodes, new_directions, new_weights
        Room for all; written.

    Returns
    -------
    int
        How many there are.
    """
    count, place = 0, 0
    for spring in range(len(nodes) + 1):
        is_last = spring == len(nodes)
        if not is_last:
            lower, higher, direction = nodes[spring, 0], nodes[spring, 1], directions[spring]
            if has_copies[lower] or has_copies[higher]:
                continue
        while place < len(keys):
            if not is_last and (
                keys[place, 0] > lower
                or (keys[place, 0] == lower and keys[place, 1] > direction)
                or (keys[place, 0] == lower and keys[place, 1] == direction and keys[place, 2] > higher)
            ):
                break
            new_nodes[count, 0], new_nodes[count, 1] = keys[place, 0], keys[place, 2]
            new_directions[count] = keys[place, 1]
            new_weights[count] = added[place]
            place += 1
            count += 1
        if not is_last:
            new_nodes[count, 0], new_nodes[count, 1] = lower, higher
            new_directions[count] = direction
            new_weights[count] = weights[spring]
            count += 1
    return count
