"""How arcs divide triangles: kernels.

A triangle, here a facet, has nodes on its edges, and arcs between nodes. What they divide it into, its faces, follows
from the order of the arcs around each node alone, which is known without numbers wherever one or two arcs end. So every
edge of a face is the edge of one face, and each face is a disc: whatever is glued along them has no hole. What hangs
together with no edge of the facet is joined to the face around it by a bridge that both of its sides cross.
"""

from __future__ import annotations

from math import atan2, pi

import numpy as np

from heartcase.compiling.kernel import kernel
from heartcase.simulator.lattice.disjoint_sets import root_of
from heartcase.simulator.mesh_arrangement.polygons import flip, triangulate, turn

__all__ = ["divide_facets"]

_FLIPPED_MAX = 256
"""Triangles of a face up to which its edges are turned for better ones."""


@kernel(cached=False)
def _turned(angle):
    """The angle between 0 and a whole turn."""
    return angle % (2.0 * pi)


@kernel(cached=False)
def _link_around(node, boundary_count, half_count, origin, angle, turns, following):
    """Say for each half-edge that comes to a node which one its face goes on with."""
    around = np.empty(half_count, np.int64)
    keys = np.empty(half_count)
    count = 0
    base = angle[node] if node < boundary_count else 0.0
    for half in range(boundary_count, half_count):
        if origin[half] != node:
            continue
        key = _turned(turns[half] - base)
        at = count
        while at > 0 and keys[at - 1] > key:
            keys[at], around[at] = keys[at - 1], around[at - 1]
            at -= 1
        keys[at], around[at] = key, half
        count += 1
    if node < boundary_count:
        before = (node - 1) % boundary_count
        following[before] = around[count - 1] if count else node
    for n in range(count):
        twin = ((around[n] - boundary_count) ^ 1) + boundary_count
        if n > 0:
            following[twin] = around[n - 1]
        else:
            following[twin] = node if node < boundary_count else around[count - 1]


@kernel(cached=False)
def _trace(half_count, following, cycle):
    """Number the cycles of half-edges."""
    cycle[:half_count] = -1
    count = 0
    for start in range(half_count):
        if cycle[start] >= 0:
            continue
        half = start
        while cycle[half] < 0:
            cycle[half] = count
            half = following[half]
        count += 1
    return count


@kernel(cached=False)
def _turning(start, boundary_count, following, angle):
    """How far a cycle turns in all: a whole turn left around a face from within, right from without."""
    total = 0.0
    half = start
    while True:
        after = following[half]
        change = _turned(angle[after] - angle[half] + pi) - pi
        is_back = half >= boundary_count and after == ((half - boundary_count) ^ 1) + boundary_count
        total += -pi if is_back else change
        half = after
        if half == start:
            return total


@kernel(cached=False)
def _faces_way(half, way, boundary_count, following, angle):
    """Whether the corner at the start of a half-edge opens to a direction."""
    before = half
    while following[before] != half:
        before = following[before]
    opening = _turned(angle[before] + pi - angle[half])
    if opening == 0.0:
        opening = 2.0 * pi
    return _turned(way - angle[half]) <= opening


@kernel(cached=False)
def _corner_at(node, start, way, boundary_count, origin, following, angle):
    """Half-edge of a cycle that starts at a node, where it opens to a direction; -1 if none starts there."""
    found = -1
    half = start
    while True:
        if origin[half] == node:
            if found < 0:
                found = half
            if _faces_way(half, way, boundary_count, following, angle):
                return half
        half = following[half]
        if half == start:
            return found


@kernel(cached=False)
def _bridge_end(node, half, origin, target, following, places):
    """Node of the face of a half-edge that is seen from a node on the left of it, looking along x."""
    here = places[node]
    a, b = places[origin[half]], places[target[half]]
    share = (here[1] - a[1]) / (b[1] - a[1])
    hit = np.array([a[0] + share * (b[0] - a[0]), here[1]])
    end = origin[half] if a[0] > b[0] else target[half]
    corner = places[end]
    chosen, steepest = end, np.inf
    at = half
    while True:
        other = origin[at]
        p = places[other]
        if other != node and p[0] > here[0]:
            one, two, three = turn(here, hit, p), turn(hit, corner, p), turn(corner, here, p)
            if (one >= 0.0 and two >= 0.0 and three >= 0.0) or (one <= 0.0 and two <= 0.0 and three <= 0.0):
                steep = abs(p[1] - here[1]) / (p[0] - here[0])
                if steep < steepest:
                    chosen, steepest = other, steep
        at = following[at]
        if at == half:
            return chosen


@kernel(cached=False)
def _hit(node, is_done, parents, half_count, origin, target, places):
    """Nearest half-edge upwards that a ray along x from a node comes to, of what was joined already; -1 if none."""
    here = places[node]
    found, nearest = -1, np.inf
    for half in range(half_count):
        a, b = places[origin[half]], places[target[half]]
        if not (a[1] <= here[1] < b[1]) or not is_done[root_of(parents, origin[half])]:
            continue
        at = a[0] + (here[1] - a[1]) / (b[1] - a[1]) * (b[0] - a[0])
        if at >= here[0] and at < nearest:
            found, nearest = half, at
    return found


@kernel(cached=False)
def _join_loose(node_count, boundary_count, half_count, origin, target, places, angle, following, cycle, joined):
    """Bridge what hangs together with no edge of the facet; returns the new number of half-edges.

    Pairs of half-edges that start in the same corner of a face are written to ``joined``, two for each bridge.
    """
    parents = np.arange(node_count)
    for half in range(half_count):
        parents[root_of(parents, origin[half])] = root_of(parents, target[half])
    is_done = np.zeros(node_count, np.bool_)
    is_done[root_of(parents, 0)] = True
    plain_count = half_count
    while True:
        # What reaches farthest along x comes first: whatever a ray from it comes to was joined before.
        node, most = -1, -np.inf
        for one in range(node_count):
            if not is_done[root_of(parents, one)] and places[one, 0] > most:
                node, most = one, places[one, 0]
        if node < 0:
            return half_count
        outer, least = -1, np.inf
        cycle_count = _trace(half_count, following, cycle)
        seen = np.zeros(cycle_count, np.bool_)
        for half in range(plain_count):
            if root_of(parents, origin[half]) != root_of(parents, node) or seen[cycle[half]]:
                continue
            seen[cycle[half]] = True
            turning = _turning(half, boundary_count, following, angle)
            if turning < least:
                outer, least = half, turning
        # The node may be within the rim, where all lie in one place: then another of the same place is on it.
        inner = _corner_at(node, outer, 0.0, boundary_count, origin, following, angle)
        if inner < 0:
            inner = outer
            node = origin[outer]
        hit = _hit(node, is_done, parents, plain_count, origin, target, places)
        if hit < 0:
            hit = 0
            end = origin[0]
        else:
            end = _bridge_end(node, hit, origin, target, following, places)
        way = atan2(places[node, 1] - places[end, 1], places[node, 0] - places[end, 0])
        outside = _corner_at(end, hit, way, boundary_count, origin, following, angle)
        before_outside, before_inner = outside, inner
        while following[before_outside] != outside:
            before_outside = following[before_outside]
        while following[before_inner] != inner:
            before_inner = following[before_inner]
        there, back = half_count, half_count + 1
        origin[there], target[there], angle[there] = end, node, way
        origin[back], target[back], angle[back] = node, end, way + pi
        following[before_outside], following[there] = there, inner
        following[before_inner], following[back] = back, outside
        row = half_count - plain_count
        joined[row, 0], joined[row, 1] = outside, there
        joined[row + 1, 0], joined[row + 1, 1] = inner, back
        half_count += 2
        is_done[root_of(parents, node)] = True


@kernel
def divide_facets(
    corners,
    places,
    edge_first,
    edge_nodes,
    edge_shares,
    arc_first,
    arc_nodes,
    arc_places,
    arc_ways,
    arc_turns,
    halves,
    joined,
    triangles,
    face_facet,
):
    """Divide facets into faces, and these into triangles.

    Each half-edge of a face stands for the corner that it starts from. Numbers of half-edges go on from facet to facet:
    first its outline, corner by corner with the nodes on its edges, then two for each arc, then two for each bridge.

    Parameters
    ----------
    corners, places
        Nodes of each facet, shape (facet_count, 3), and their places in its plane, counter-clockwise, (facet_count, 3,
        2).
    edge_first, edge_nodes, edge_shares
        Where the nodes on each edge begin, shape (3 facet_count + 1,); the nodes, in order from corner to corner; how
        far along they lie.
    arc_first, arc_nodes, arc_places, arc_ways, arc_turns
        Where the arcs of each facet begin, shape (facet_count + 1,); both nodes of each; their places, shape
        (arc_count, 2, 2); the direction, in which the arc is straight, shape (arc_count, 2); and the angle in the order
        around each end, or not a number where the direction's is meant.
    halves
        Node, face, following half-edge and twin's kind of each half-edge, shape (room, 4), written: the last is the
        number of the arc times 2, plus 1 if the half-edge goes backwards; -1 - 3 facet - side for the outline; and
        a number below all those for bridges.
    joined
        Pairs of half-edges that start in one corner of a face, shape (room, 2), written.
    triangles
        Half-edges of the three corners of each triangle, shape (room, 3), written.
    face_facet
        Facet of each face, shape (room,), written.

    Returns
    -------
    half_count, joined_count, face_count, triangle_count
        How many rows were written, and how many faces there are.
    """
    half_total, joined_total, face_total, triangle_total = 0, 0, 0, 0
    facet_count = len(corners)
    for facet in range(facet_count):
        first_arc, last_arc = arc_first[facet], arc_first[facet + 1]
        arc_count = last_arc - first_arc
        outline = 3 + edge_first[3 * facet + 3] - edge_first[3 * facet]
        if outline == 3 and arc_count == 0:
            # Nothing divides it: one face, and that is one triangle.
            for side in range(3):
                row = half_total + side
                halves[row, 0], halves[row, 1] = corners[facet, side], face_total
                halves[row, 2], halves[row, 3] = half_total + (side + 1) % 3, -1 - 3 * facet - side
                triangles[triangle_total, side] = row
            face_facet[face_total] = facet
            half_total, face_total, triangle_total = half_total + 3, face_total + 1, triangle_total + 1
            continue
        room = outline + 4 * arc_count
        nodes, at = np.empty(outline + 2 * arc_count, np.int64), np.empty((outline + 2 * arc_count, 2))
        origin, target = np.empty(room, np.int64), np.empty(room, np.int64)
        angle, turns = np.empty(room), np.empty(room)
        following, cycle = np.empty(room, np.int64), np.empty(room, np.int64)
        kind = np.full(room, -1 - 3 * facet_count, np.int64)
        pairs = np.empty((2 * arc_count, 2), np.int64)

        count = 0
        for side in range(3):
            a, b = places[facet, side], places[facet, (side + 1) % 3]
            way = atan2(b[1] - a[1], b[0] - a[0])
            nodes[count] = corners[facet, side]
            at[count] = a
            angle[count], kind[count] = way, -1 - 3 * facet - side
            count += 1
            for n in range(edge_first[3 * facet + side], edge_first[3 * facet + side + 1]):
                nodes[count] = edge_nodes[n]
                for axis in range(2):
                    at[count, axis] = a[axis] + edge_shares[n] * (b[axis] - a[axis])
                angle[count], kind[count] = way, -1 - 3 * facet - side
                count += 1
        for n in range(outline):
            origin[n], target[n] = n, (n + 1) % outline
        half_count = outline
        for arc in range(first_arc, last_arc):
            for end in range(2):
                local = 0
                while local < count and nodes[local] != arc_nodes[arc, end]:
                    local += 1
                if local == count:
                    nodes[count] = arc_nodes[arc, end]
                    at[count] = arc_places[arc, end]
                    count += 1
                origin[half_count + end], target[half_count + 1 - end] = local, local
            way = atan2(arc_ways[arc, 1], arc_ways[arc, 0])
            angle[half_count], angle[half_count + 1] = way, way + pi
            one, other = arc_turns[arc, 0], arc_turns[arc, 1]
            turns[half_count] = way if np.isnan(one) else one
            turns[half_count + 1] = way + pi if np.isnan(other) else other
            kind[half_count], kind[half_count + 1] = 2 * arc, 2 * arc + 1
            half_count += 2
        for node in range(count):
            _link_around(node, outline, half_count, origin, angle, turns, following)
        plain_count = half_count
        half_count = _join_loose(count, outline, half_count, origin, target, at, angle, following, cycle, pairs)
        for n in range(half_count - plain_count):
            joined[joined_total, 0], joined[joined_total, 1] = half_total + pairs[n, 0], half_total + pairs[n, 1]
            joined_total += 1
        face_count = _trace(half_count, following, cycle)
        corner_nodes, corner_places = np.empty(half_count, np.int64), np.empty((half_count, 2))
        for half in range(half_count):
            corner_nodes[half], corner_places[half] = nodes[origin[half]], at[origin[half]]
            row = half_total + half
            halves[row, 0], halves[row, 1] = nodes[origin[half]], face_total + cycle[half]
            halves[row, 2], halves[row, 3] = half_total + following[half], kind[half]
        polygon = np.empty(half_count, np.int64)
        written = triangle_total
        for face in range(face_count):
            face_facet[face_total + face] = facet
            start = 0
            while cycle[start] != face:
                start += 1
            size, half = 0, start
            while True:
                polygon[size] = half
                size += 1
                half = following[half]
                if half == start:
                    break
            begin = triangle_total
            triangle_total = triangulate(polygon, size, corner_nodes, corner_places, triangles, begin)
            if triangle_total - begin <= _FLIPPED_MAX:
                flip(triangles, begin, triangle_total, corner_nodes, corner_places)
        triangles[written:triangle_total] += half_total
        half_total += half_count
        face_total += face_count
    return half_total, joined_total, face_total, triangle_total
