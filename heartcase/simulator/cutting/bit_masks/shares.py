"""What pieces have of their cells, and copies of their nodes: coverage, moments, masses and springs: kernels."""

from __future__ import annotations

import numpy as np

from heartcase.compiling.kernel import kernel
from heartcase.simulator.cutting.bit_masks.rows import cell_of, set_of

__all__ = [
    "add_sample",
    "merge_near_springs",
    "near_rows",
    "near_springs",
    "share_cells",
    "share_masses",
    "write_corners",
]


@kernel(cached=False)
def add_sample(places, sample, spread, sums, piece):
    """Add x, y, z, xx, yy, zz, yz, xz, xy of a sample to the sums of a piece."""
    x, y, z = places[sample, 0], places[sample, 1], places[sample, 2]
    sums[piece, 0] += x
    sums[piece, 1] += y
    sums[piece, 2] += z
    sums[piece, 3] += x * x + spread
    sums[piece, 4] += y * y + spread
    sums[piece, 5] += z * z + spread
    sums[piece, 6] += y * z
    sums[piece, 7] += x * z
    sums[piece, 8] += x * y


@kernel
def write_corners(around, counts, first, copies, corners, numbers, cell_count, new_corners, added):
    """Write the nodes at the corners of all pieces, and the cell of each that is no first piece.

    Parameters
    ----------
    around, counts, first, copies
        Cells around the sheets, how many pieces each has, the first of each, and the copies at their corners.
    corners
        Of the uncut lattice, shape (cell_count, 8).
    numbers
        Number of the first further copy of each node.
    cell_count
        Cells of the uncut lattice.
    new_corners, added
        Of all cells, and of each further piece; written.
    """
    for cell in range(len(counts)):
        for piece in range(counts[cell]):
            row = cell_of(around, first, cell_count, cell, piece)
            if piece > 0:
                added[row - cell_count] = around.cells[cell]
            for corner in range(8):
                node, copy = corners[around.cells[cell], corner], copies[first[cell] + piece, corner]
                new_corners[row, corner] = node if copy == 0 else numbers[node] + copy - 1


@kernel
def share_cells(
    around, stemmed, counts, first, is_same, of_known, known_first, cell_count, places, spread, known, model, now
):
    """Write coverage of the pieces of cells that were parted, and say which moments are left to write.

    Parameters
    ----------
    around, stemmed, counts, first
        Cells, sets, how many pieces each has, and the first of each.
    is_same, of_known, known_first
        Whether a cell's pieces are as they were, its row before, and the first piece of each before.
    cell_count
        Cells of the uncut lattice.
    places, spread
        Of samples from the middle of a cell, shape (SAMPLES^3, 3); variance of what a sample stands for on each axis.
    known, model, now
        Coverage and moments of the lattice before, of the uncut lattice, and now, which is written.

    Returns
    -------
    tuple
        Cells of the cut lattice whose moments changed, and what they are: (count,), (count, 9).
    """
    total = 0
    for cell in range(len(counts)):
        if counts[cell] > 1 and not is_same[cell]:
            total += counts[cell]
    changed, moments = np.empty(total, np.int64), np.empty((total, 9))
    sizes, sums, whole = np.empty(512, np.int64), np.empty((512, 9)), np.empty(9)
    at = 0
    for cell in range(len(counts)):
        if counts[cell] == 1:
            continue
        if is_same[cell]:
            before = of_known[cell]
            for piece in range(counts[cell]):
                row = cell_of(around, first, cell_count, cell, piece)
                old = row if piece == 0 else cell_count + known_first[before] - before + piece - 1
                now[0][row] = known[0][old]
                now[1][row] = known[1][old]
            continue
        size = 0
        whole[:] = 0.0
        for piece in range(counts[cell]):
            sizes[piece] = 0
            sums[piece] = 0.0
            found = set_of(around, stemmed, cell, piece)
            for sample in range(512):
                if not found[sample // 64] >> (sample % 64) & 1:
                    continue
                sizes[piece] += 1
                add_sample(places, sample, spread, sums, piece)
            size += sizes[piece]
            for number in range(9):
                whole[number] += sums[piece, number]
        # What the samples say of the whole cell is a little off: each piece is moved by as much.
        for piece in range(counts[cell]):
            row = cell_of(around, first, cell_count, cell, piece)
            now[0][row] = np.float32(np.float64(model[0][around.cells[cell]]) * (sizes[piece] / size))
            changed[at] = row
            for number in range(9):
                off = np.float64(model[1][around.cells[cell], number]) - whole[number] / size
                moments[at, number] = sums[piece, number] / sizes[piece] + off
            # Moments of tissue that lies in its cell and has a shape.
            for number in range(9):
                value = moments[at, number]
                low = -0.5 if number < 3 or number > 5 else moments[at, number - 3] * moments[at, number - 3] + spread
                moments[at, number] = min(max(value, low), 0.5)
            at += 1
    return changed, moments


@kernel
def near_rows(around, counts, first, corners, node_copies, cell_count):
    """Cells of the cut lattice, ascending, at whose corners is a node of which there are copies."""
    rows, number = np.empty(first[-1], np.int64), 0
    for is_further in range(2):
        for cell in range(len(counts)):
            is_near = False
            for corner in range(8):
                is_near |= node_copies[corners[around.cells[cell], corner]] > 1
            if is_near:
                for piece in range(1 if is_further else 0, counts[cell] if is_further else 1):
                    rows[number] = cell_of(around, first, cell_count, cell, piece)
                    number += 1
    return rows[:number]


@kernel
def share_masses(rows, corners, coverage, density, node_copies, numbers, mass):
    """Share masses of nodes out among their copies; those of uncut nodes are given, and changed.

    Parameters
    ----------
    rows, corners
        Cells near copies, ascending, and corners of all cells.
    coverage, density
        Of all cells.
    node_copies, numbers
        How many nodes each uncut one became, and the first further copy of each.
    mass
        Of all nodes; written.
    """
    node_count = len(node_copies)
    of_node = np.zeros(len(mass))
    for row in rows:
        share = np.float64(coverage[row]) * np.float64(density[row])
        for corner in range(8):
            of_node[corners[row, corner]] += share
    for node in range(node_count):
        if node_copies[node] == 1:
            continue
        whole, own = of_node[node], np.float64(mass[node])
        for copy in range(node_copies[node] - 1):
            whole += of_node[numbers[node] + copy]
        mass[node] = np.float32(own * (of_node[node] / whole))
        for copy in range(node_copies[node] - 1):
            at = numbers[node] + copy
            mass[at] = np.float32(own * (of_node[at] / whole))


@kernel
def near_springs(rows, corners, coverage, stiffness, node_origin, node_copies, cell_springs):
    """Springs at nodes of which there are copies, by lower node, direction and higher node, and what hangs on each.

    Parameters
    ----------
    rows, corners, coverage, stiffness
        Cells near copies, ascending; corners, coverage and stiffness of all cells.
    node_origin, node_copies
        Uncut node of each node, and how many nodes each of these became.
    cell_springs
        Lower and higher corner of a cell's springs, their share of its stiffness, and their direction.

    Returns
    -------
    tuple
        Lower node, direction and higher node of each, shape (count, 3), and its stiffness before it is scaled.
    """
    pairs, share, direction = cell_springs
    spring_count = len(pairs)
    table_row = np.full(len(node_origin), -1, np.int32)
    table = np.full((8 * len(rows), 9), -1, np.int32)
    room = spring_count * len(rows)
    higher, weight, following = np.empty(room, np.int32), np.empty(room), np.empty(room, np.int32)
    row_count, count = 0, 0
    is_copied = np.empty(8, np.bool_)
    for cell in rows:
        for corner in range(8):
            is_copied[corner] = node_copies[node_origin[corners[cell, corner]]] > 1
        whole = np.float64(coverage[cell]) * np.float64(stiffness[cell])
        for spring in range(spring_count):
            low, high = pairs[spring, 0], pairs[spring, 1]
            if not (is_copied[low] or is_copied[high]):
                continue
            lower, other, way = corners[cell, low], corners[cell, high], direction[spring]
            if table_row[lower] < 0:
                table_row[lower] = row_count
                row_count += 1
            before, at = -1, table[table_row[lower], way]
            while at >= 0 and higher[at] < other:
                before, at = at, following[at]
            if at >= 0 and higher[at] == other:
                weight[at] += whole * share[spring]
                continue
            higher[count], weight[count], following[count] = other, whole * share[spring], at
            if before < 0:
                table[table_row[lower], way] = count
            else:
                following[before] = count
            count += 1
    keys, weights, number = np.empty((count, 3), np.int64), np.empty(count), 0
    for lower in range(len(node_origin)):
        if table_row[lower] < 0:
            continue
        for way in range(9):
            at = table[table_row[lower], way]
            while at >= 0:
                keys[number, 0], keys[number, 1], keys[number, 2] = lower, way, higher[at]
                weights[number] = weight[at]
                number += 1
                at = following[at]
    return keys, weights


@kernel(cached=False)
def _keep(kept, start, stop, new, count):
    """Write numbers that stay as they are."""
    # From zero on, so that it is compiled to a plain copy.
    source, target = kept[start:stop], new[count : count + stop - start]
    for number in range(len(source)):
        target[number] = source[number]


@kernel(cached=False)
def _add(count, at, near, model, new):
    """Write a spring near copies, and count it."""
    keys, weights, places, wholes = near
    # Both nodes as one number: they are copied so much the quicker.
    new[0][count] = keys[at, 2] << 32 | keys[at, 0]
    new[1][count] = keys[at, 1]
    new[2][count] = np.float32(np.float64(model[2][places[at]]) * (weights[at] / wholes[at]))
    return count + 1


@kernel
def merge_near_springs(model, first, node_origin, node_copies, keys, weights, new):
    """Write the springs that stay and those near copies, scaled so that the copies of each have what it had.

    Parameters
    ----------
    model, first
        Both nodes of the uncut lattice's springs as one number, the lower in its lower half, their directions and
        stiffness; and the first from each node.
    node_origin, node_copies
        Uncut node of each node, and how many nodes each of these became.
    keys, weights
        Springs near copies as of :func:`near_springs`.
    new
        Room for nodes, directions and stiffness of all; written.

    Returns
    -------
    int
        How many there are.
    """
    node_count = len(node_copies)
    places, wholes = np.empty(len(keys), np.int64), np.empty(len(keys))
    row_of = np.full(node_count, -1, np.int32)
    table, rows = np.zeros((len(keys), 9)), 0
    for number in range(len(keys)):
        origin, way = node_origin[keys[number, 0]], keys[number, 1]
        if row_of[origin] < 0:
            row_of[origin] = rows
            rows += 1
        table[row_of[origin], way] += weights[number]
        place = first[origin]
        while model[1][place] != way:
            place += 1
        places[number] = place
    for number in range(len(keys)):
        wholes[number] = table[row_of[node_origin[keys[number, 0]]], keys[number, 1]]
    near, (nodes, directions, stiffness), (new_nodes, new_directions, new_stiffness) = (
        (keys, weights, places, wholes),
        model,
        new,
    )
    count, at, done = 0, 0, 0
    for node in range(node_count):
        if node_copies[node] == 1 and not (at < len(keys) and keys[at, 0] == node):
            continue
        # All from nodes between stay as they are.
        start = first[node]
        _keep(nodes, done, start, new_nodes, count)
        _keep(directions, done, start, new_directions, count)
        _keep(stiffness, done, start, new_stiffness, count)
        count += start - done
        done = first[node + 1]
        for spring in range(start, done):
            if node_copies[node] > 1 or node_copies[nodes[spring] >> 32] > 1:
                continue
            while at < len(keys) and keys[at, 0] == node and keys[at, 1] < directions[spring]:
                count = _add(count, at, near, model, new)
                at += 1
            new_nodes[count], new_directions[count] = nodes[spring], directions[spring]
            new_stiffness[count] = stiffness[spring]
            count += 1
        while at < len(keys) and keys[at, 0] == node:
            count = _add(count, at, near, model, new)
            at += 1
    start = len(nodes)
    _keep(nodes, done, start, new_nodes, count)
    _keep(directions, done, start, new_directions, count)
    _keep(stiffness, done, start, new_stiffness, count)
    count += start - done
    while at < len(keys):
        count = _add(count, at, near, model, new)
        at += 1
    return count
