"""Which triangles of a split surface hang together, patch by patch: kernels.

The uncut surface is divided into patches, each of triangles that lie in one block and hang together by vertices. A
patch of which no triangle is cut hangs together as it did: only its rim counts, the vertices that others have as well.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from heartcase.compiling.kernel import kernel
from heartcase.schemas.arrays import Int32, Int64
from heartcase.simulator.lattice.disjoint_sets import join_two, root_of

__all__ = ["Patches", "make_patches", "number_split_parts"]


class Patches(NamedTuple):
    """Triangles of the uncut surface that lie together."""

    of_triangle: Int32
    """Patch of each triangle, shape (triangle_count,); numbered by their first triangles."""
    first: Int64
    """Where each patch begins in ``members``, shape (patch_count + 1,)."""
    members: Int32
    """Triangles of each patch, ascending, shape (triangle_count,)."""
    rim_first: Int64
    """Where each patch begins in ``rims``, shape (patch_count + 1,)."""
    rims: Int32
    """Vertices of each patch that others have, too."""


@kernel
def _patch_triangles(vertices, triangles, shift, of_triangle):
    """Write the patch of each triangle; returns how many patches there are."""
    count = len(triangles)
    parents = np.arange(count)
    last, before = np.full(len(vertices), -1), np.empty((count, 3), np.int64)
    for one in range(count):
        here = vertices[triangles[one, 0]]
        for corner in range(3):
            vertex = triangles[one, corner]
            at = last[vertex]
            before[one, corner] = at
            last[vertex] = 3 * one + corner
            while at >= 0:
                other = vertices[triangles[at // 3, 0]]
                if (
                    here[0] >> shift == other[0] >> shift
                    and here[1] >> shift == other[1] >> shift
                    and here[2] >> shift == other[2] >> shift
                ):
                    join_two(parents, one, at // 3)
                at = before[at // 3, at % 3]
    patch_count = 0
    for one in range(count):
        if parents[one] == one:
            of_triangle[one] = patch_count
            patch_count += 1
        else:
            of_triangle[one] = of_triangle[root_of(parents, one)]
    return patch_count


@kernel
def _list_rims(triangles, of_triangle, members, vertex_count, rim_first, rims):
    """List the vertices of each patch that others have, too; counts alone where there is no room."""
    only, seen = np.full(vertex_count, -1, np.int32), np.full(vertex_count, -1, np.int32)
    for one in range(len(triangles)):
        for corner in range(3):
            vertex, patch = triangles[one, corner], of_triangle[one]
            if only[vertex] == -1:
                only[vertex] = patch
            elif only[vertex] != patch:
                only[vertex] = -2
    count = 0
    for one in members:
        patch = of_triangle[one]
        for corner in range(3):
            vertex = triangles[one, corner]
            if only[vertex] == -2 and seen[vertex] != patch:
                seen[vertex] = patch
                if count < len(rims):
                    rims[count] = vertex
                count += 1
        rim_first[patch + 1] = count
    return count


def make_patches(vertices: Int64, triangles: Int64, shift: int) -> Patches:
    """Divide a surface into patches.

    Parameters
    ----------
    vertices, triangles
        Places in whole numbers, shape (vertex_count, 3), and vertex numbers, shape (triangle_count, 3).
    shift
        Blocks have 2^shift along each edge.
    """
    of_triangle = np.zeros(len(triangles), np.int32)
    patch_count = _patch_triangles(vertices, triangles, shift, of_triangle)
    members = np.argsort(of_triangle, kind="stable").astype(np.int32)
    first = np.append(0, np.cumsum(np.bincount(of_triangle, minlength=patch_count))).astype(np.int64)
    rim_first = np.zeros(patch_count + 1, np.int64)
    rims = np.zeros(0, np.int32)
    for _ in range(2):
        rims = np.empty(_list_rims(triangles, of_triangle, members, len(vertices), rim_first, rims), np.int32)
    _list_rims(triangles, of_triangle, members, len(vertices), rim_first, rims)
    return Patches(of_triangle, first, members, rim_first, rims)


@kernel(cached=False)
def _welded(vertex, weld, old_count):
    return np.int64(vertex) if vertex < old_count else np.int64(weld[vertex - old_count])


@kernel
def number_split_parts(triangles, patches, crossed, added, weld, old_count, part):
    """Number what hangs together of a split surface, by the first triangle of each; returns how many parts there are.

    Parameters
    ----------
    triangles, patches
        Of the uncut surface.
    crossed
        Triangles of it that are not there any more, ascending.
    added
        Vertices of those that are there instead, shape (added_count, 3).
    weld, old_count
        Lowest vertex that is one with each new one, shape (new_count,), and the number of vertices before these.
    part
        Number of each triangle that is left, then of the added, int32, shape (triangle_count,); written.
    """
    patch_count, vertex_count = len(patches.first) - 1, old_count + len(weld)
    parents = np.arange(vertex_count + patch_count)
    is_touched = np.zeros(patch_count, np.bool_)
    for one in crossed:
        is_touched[patches.of_triangle[one]] = True
    for patch in range(patch_count):
        if not is_touched[patch]:
            for n in range(patches.rim_first[patch], patches.rim_first[patch + 1]):
                join_two(parents, vertex_count + patch, np.int64(patches.rims[n]))
    is_crossed = np.zeros(len(triangles), np.bool_)
    for one in crossed:
        is_crossed[one] = True
    for patch in range(patch_count):
        if is_touched[patch]:
            for n in range(patches.first[patch], patches.first[patch + 1]):
                one = patches.members[n]
                if not is_crossed[one]:
                    join_two(parents, triangles[one, 0], triangles[one, 1])
                    join_two(parents, triangles[one, 0], triangles[one, 2])
    for n in range(len(added)):
        one = _welded(added[n, 0], weld, old_count)
        join_two(parents, one, _welded(added[n, 1], weld, old_count))
        join_two(parents, one, _welded(added[n, 2], weld, old_count))
    # One part alone is the rule.
    whole, is_one = -1, True
    for patch in range(patch_count):
        if not is_touched[patch]:
            root = root_of(parents, vertex_count + patch)
            is_one = is_one and (whole < 0 or root == whole)
            whole = root
            continue
        for n in range(patches.first[patch], patches.first[patch + 1]):
            one = patches.members[n]
            if not is_crossed[one]:
                root = root_of(parents, triangles[one, 0])
                is_one = is_one and (whole < 0 or root == whole)
                whole = root
    for n in range(len(added)):
        root = root_of(parents, _welded(added[n, 0], weld, old_count))
        is_one = is_one and (whole < 0 or root == whole)
        whole = root
    if is_one:
        part[:] = 0
        return 1 if len(part) else 0
    numbers = np.full(len(parents), -1, np.int32)
    count, at = 0, 0
    for one in range(len(triangles)):
        if is_crossed[one]:
            continue
        patch = patches.of_triangle[one]
        root = root_of(parents, triangles[one, 0] if is_touched[patch] else vertex_count + patch)
        if numbers[root] < 0:
            numbers[root] = count
            count += 1
        part[at] = numbers[root]
        at += 1
    for n in range(len(added)):
        root = root_of(parents, _welded(added[n, 0], weld, old_count))
        if numbers[root] < 0:
            numbers[root] = count
            count += 1
        part[at] = numbers[root]
        at += 1
    return count
