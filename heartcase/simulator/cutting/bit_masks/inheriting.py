"""From one cut to the next: which node each node comes from, and which of those now is the heaviest: kernels."""

from __future__ import annotations

import numpy as np

from heartcase.compiling.kernel import kernel
from heartcase.simulator.cutting.bit_masks.rows import cell_of, set_of
from heartcase.simulator.cutting.bit_masks.sample_bits import count

__all__ = ["changed_nodes", "heaviest_nodes", "held_nodes", "inherit_nodes"]


@kernel
def changed_nodes(around, counts, first, copies, is_same, of_known, known_first, known_copies, corners, node_count):
    """Nodes of the uncut lattice around which pieces, or the copies at their corners, are not as before."""
    result = np.zeros(node_count, np.bool_)
    for cell in range(len(counts)):
        for corner in range(8):
            is_other = not is_same[cell]
            if not is_other:
                start, old = first[cell], known_first[of_known[cell]]
                for piece in range(counts[cell]):
                    is_other |= copies[start + piece, corner] != known_copies[old + piece, corner]
            if is_other:
                result[corners[around.cells[cell], corner]] = True
    return result


@kernel
def inherit_nodes(now, before, of_known, is_changed, coverage, density, node_origin, origins_before, cell_count):
    """The node before that each node comes from, and those that come from several.

    Parameters
    ----------
    now, before
        Cells around the sheets, sets, how many pieces each has, the first of each, and corners of all cells.
    of_known
        Row before of each cell, or -1.
    is_changed
        Nodes of the uncut lattice around which something changed.
    coverage, density
        Of all cells now.
    node_origin, origins_before
        Uncut node of each node now, and of each copy before, ascending.
    cell_count
        Cells of the uncut lattice.

    Returns
    -------
    tuple
        Node before of each (node_count,); and of nodes that come from several: the node, what it comes from, and the
        share of its mass, shapes (count,).
    """
    around, stemmed, counts, first, corners = now
    known, known_stemmed, known_counts, known_first, known_corners = before
    node_count, all_nodes = len(is_changed), len(node_origin)
    result = node_origin.copy()
    was_copied, first_copy = np.zeros(node_count, np.bool_), np.zeros(node_count, np.int64)
    for copy in range(len(origins_before) - 1, -1, -1):
        was_copied[origins_before[copy]], first_copy[origins_before[copy]] = True, node_count + copy
    # What did not change comes from the copy of the same number.
    for copy in range(node_count, all_nodes):
        origin = node_origin[copy]
        if was_copied[origin] and not is_changed[origin]:
            number = copy - 1
            while number >= node_count and node_origin[number] == origin:
                number -= 1
            result[copy] = first_copy[origin] + copy - number - 1
    room, entries = 64, 0
    head = np.full(all_nodes, -1, np.int32)
    old_node, following = np.empty(room, np.int32), np.empty(room, np.int32)
    votes, masses = np.empty(room), np.empty(room)
    common = np.empty(512, np.int64)
    for is_further in range(2):
        for cell in range(len(counts)):
            is_asked = False
            for corner in range(8):
                node = corners[around.cells[cell], corner]
                node = node_origin[node]
                is_asked |= was_copied[node] and is_changed[node]
            if not is_asked:
                continue
            old_cell = of_known[cell]
            for piece in range(1 if is_further else 0, counts[cell] if is_further else 1):
                row = cell_of(around, first, cell_count, cell, piece)
                own, total = set_of(around, stemmed, cell, piece), 0
                for other in range(known_counts[old_cell]):
                    theirs, both = set_of(known, known_stemmed, old_cell, other), np.empty(8, np.int64)
                    for k in range(8):
                        both[k] = own[k] & theirs[k]
                    common[other] = count(both)
                    total += common[other]
                weight = np.float64(coverage[row]) * np.float64(density[row])
                for other in range(known_counts[old_cell]):
                    if common[other] == 0:
                        continue
                    old_row = cell_of(known, known_first, cell_count, old_cell, other)
                    mass = common[other] * weight / total
                    for corner in range(8):
                        node = corners[row, corner]
                        origin = node_origin[node]
                        if not (was_copied[origin] and is_changed[origin]):
                            continue
                        theirs_at = known_corners[old_row, corner]
                        last, at = -1, head[node]
                        while at >= 0 and old_node[at] < theirs_at:
                            last, at = at, following[at]
                        if at < 0 or old_node[at] != theirs_at:
                            if entries == room:
                                old_node, following = np.append(old_node, old_node), np.append(following, following)
                                votes, masses = np.append(votes, votes), np.append(masses, masses)
                                room *= 2
                            old_node[entries], following[entries] = theirs_at, at
                            votes[entries] = masses[entries] = 0.0
                            if last < 0:
                                head[node] = entries
                            else:
                                following[last] = entries
                            at = entries
                            entries += 1
                        votes[at] += common[other]
                        masses[at] += mass
    mixed, mixed_before = np.empty(entries, np.int64), np.empty(entries, np.int64)
    share, number = np.empty(entries), 0
    for node in range(all_nodes):
        at = head[node]
        if at < 0:
            continue
        best, start, whole = at, number, 0.0
        while at >= 0:
            if votes[at] > votes[best]:
                best = at
            mixed[number], mixed_before[number], share[number] = node, old_node[at], masses[at]
            whole += masses[at]
            number += 1
            at = following[at]
        result[node] = old_node[best]
        if number == start + 1:
            number = start
        for entry in range(start, number):
            share[entry] /= whole
    return result, mixed[:number].copy(), mixed_before[:number].copy(), share[:number].copy()


@kernel
def heaviest_nodes(mass, node_origin, origins_before, node_before, node_count):
    """The heaviest of the nodes now that come from each node before; else of the copies that its node has now.

    Parameters
    ----------
    mass, node_origin, node_before
        Of all nodes now: mass, uncut node, and the node before that it comes from.
    origins_before
        Uncut node of each copy before.
    node_count
        Nodes of the uncut lattice.
    """
    has_copies, heaviest = np.zeros(node_count, np.bool_), np.arange(node_count)
    for node in range(node_count, len(node_origin)):
        has_copies[node_origin[node]] = True
    for node in origins_before:
        has_copies[node] = True
    result = np.empty(node_count + len(origins_before), np.int64)
    for node in range(node_count, len(node_origin)):
        origin = node_origin[node]
        if mass[node] >= mass[heaviest[origin]]:
            heaviest[origin] = node
    result[:node_count] = heaviest
    for copy in range(len(origins_before)):
        result[node_count + copy] = heaviest[origins_before[copy]]
    is_set = np.zeros(len(result), np.bool_)
    for node in range(len(node_origin)):
        if node < node_count and not has_copies[node]:
            continue
        before = node_before[node]
        if not (is_set[before] and mass[node] < mass[result[before]]):
            result[before], is_set[before] = node, True
    return result


@kernel
def held_nodes(node_before, nodes, count_before):
    """Nodes that come from some nodes before, ascending, and the place of that node among those given."""
    number = np.full(count_before, -1, np.int32)
    for place in range(len(nodes)):
        number[nodes[place]] = place
    found, places, count = np.empty(len(node_before), np.int64), np.empty(len(node_before), np.int64), 0
    for node in range(len(node_before)):
        place = number[node_before[node]]
        if place >= 0:
            found[count], places[count] = node, place
            count += 1
    return found[:count].copy(), places[:count].copy()
