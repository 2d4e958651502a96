"""Which corners of faces are one vertex of the split surface: kernels.

Around each edge of the arrangement its faces stand in a circle, with tissue or void between two that follow one
another. What bounds the same tissue is glued. So each side of each face is glued to one other along each edge, and what
comes out is closed, whatever faces there are.
"""

from __future__ import annotations

import numpy as np

from heartcase.compiling.kernel import kernel

__all__ = ["glue_around", "join_sets", "number_parts"]


@kernel(cached=False)
def _root(parents, one):
    while parents[one] != one:
        parents[one] = parents[parents[one]]
        one = parents[one]
    return one


@kernel(cached=False)
def _join(parents, one, other):
    """The lowest member stands for both."""
    one, other = _root(parents, one), _root(parents, other)
    if one < other:
        parents[other] = one
    else:
        parents[one] = other


@kernel
def join_sets(parents, pairs):
    """Join the sets of pairs of members, and let each member know its set."""
    for n in range(len(pairs)):
        _join(parents, pairs[n, 0], pairs[n, 1])
    for one in range(len(parents)):
        parents[one] = _root(parents, one)


@kernel
def glue_around(first, is_circle, halves, backwards, copies, following, parents, partner):
    """Glue what follows one another around each edge.

    Parameters
    ----------
    first, is_circle
        Where the half-edges at each edge begin, shape (edge_count + 1,), and whether the last is followed by the first.
    halves, backwards, copies
        Half-edges in their order around the edge; whether each runs against it; and which copy of its face, 0 or 1,
        looks back and which looks ahead, shape (count, 2).
    following
        The half-edge that follows each in its face.
    parents
        Sets of corners, shape (2 half_count,): first those of all faces' copy 0, then of copy 1; joined.
    partner
        Half-edge, with its copy, that each is glued to, shape (2 half_count,); written.
    """
    half_count = len(following)
    for edge in range(len(first) - 1):
        count = first[edge + 1] - first[edge]
        for n in range(count if is_circle[edge] else count - 1):
            one, other = first[edge] + n, first[edge] + (n + 1) % count
            a, b = halves[one], halves[other]
            of_a, of_b = copies[one, 1] * half_count, copies[other, 0] * half_count
            partner[of_a + a], partner[of_b + b] = of_b + b, of_a + a
            start_a, end_a = of_a + a, of_a + following[a]
            start_b, end_b = of_b + b, of_b + following[b]
            if backwards[one] == backwards[other]:
                _join(parents, start_a, start_b)
                _join(parents, end_a, end_b)
            else:
                _join(parents, start_a, end_b)
                _join(parents, end_a, start_b)


@kernel
def number_parts(triangles, vertex_count):
    """Number of what each triangle hangs together with, by the first triangle of each, int32, shape (triangle_count,)."""
    parents = np.arange(vertex_count)
    for n in range(len(triangles)):
        _join(parents, triangles[n, 0], triangles[n, 1])
        _join(parents, triangles[n, 0], triangles[n, 2])
    numbers = np.full(vertex_count, -1, np.int32)
    part = np.empty(len(triangles), np.int32)
    count = 0
    for n in range(len(triangles)):
        root = _root(parents, triangles[n, 0])
        if numbers[root] < 0:
            numbers[root] = count
            count += 1
        part[n] = numbers[root]
    return part
