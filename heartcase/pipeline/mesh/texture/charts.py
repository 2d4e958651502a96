"""Charts of a surface: parts that can be laid flat with little stretch.

Charts grow triangle by triangle from a seed while the normals stay within a cone around the chart's mean normal, and
are then projected along it: nothing is stretched by more than 1 / cos(45 degrees). A projection can still fold over
itself where a chart winds around; such triangles are taken out and start charts of their own. Small charts, which
would cost a gutter each, then join a neighbour where one cone of the same width holds both.
"""

from __future__ import annotations

import numba
import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from heartcase.compiling.calls import copied
from heartcase.compiling.kernel import kernel, loop_kernel
from heartcase.pipeline.kernels.vectors import put
from heartcase.pipeline.mesh.triangles.half_edges import opposites
from heartcase.schemas.arrays import Float64, Int32

__all__ = ["cut_into_charts", "project"]


CONE_COSINE = float(np.cos(np.radians(45.0)))
MERGE_TRIANGLES = 40
"""Charts of at most so many triangles are given to a neighbour where one cone holds both."""
MERGE_ROUNDS = 3
CONE_STEPS = 12
"""Steps towards the axis of the narrowest cone around two charts."""


def cut_into_charts(vertices: Float64, triangles: Int32) -> tuple[Int32, Float64]:
    """Cut a closed mesh into charts.

    Parameters
    ----------
    vertices, triangles
        A closed manifold mesh.

    Returns
    -------
    chart : Int32
        Chart of each triangle, shape (triangle_count,).
    axes : Float64
        Unit axis along which each chart is projected, shape (chart_count, 3).
    """
    corner = vertices[triangles]
    doubled = np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0])
    area = np.linalg.norm(doubled, axis=1)
    normal = doubled / np.maximum(area, 1e-30)[:, None]
    opposite = opposites(triangles)
    chart = np.full(len(triangles), -1, np.int32)
    length = np.linalg.norm(vertices[np.roll(triangles, -1, axis=1)] - vertices[triangles], axis=2).ravel()
    axes = np.empty((0, 3))
    for turn in range(MERGE_ROUNDS + 1):
        while (chart < 0).any():
            before = len(axes)
            axes = _grow(normal, area, opposite, chart, axes, CONE_COSINE)
            _evict(vertices, triangles, chart, axes, before)
        if turn == MERGE_ROUNDS or not _merge(normal, length, opposite, chart, axes, MERGE_TRIANGLES, CONE_COSINE):
            break
        _evict(vertices, triangles, chart, axes, 0)
    return _connected(chart, axes, opposite)


@kernel
def _merge(normal, length, opposite, chart, axes, most, cosine):
    """Give charts of at most ``most`` triangles to a neighbour where one cone holds both; returns whether any went.

    A chart costs a gutter all around, and most small ones are what growing and taking out overlaps has left over. The
    smallest go first, to the neighbour with the longest common border that can take them; ``chart`` and ``axes`` are
    changed in place.
    """
    count = len(axes)
    size = np.zeros(count, np.int32)
    head = np.full(count, -1, np.int32)
    following = np.full(len(chart), -1, np.int32)
    for t in range(len(chart) - 1, -1, -1):
        size[chart[t]] += 1
        following[t] = head[chart[t]]
        head[chart[t]] = t
    border = np.zeros(count)
    beside = np.empty(count, np.int32)
    axis = np.empty(3)
    any_given = False
    for giver in np.argsort(size, kind="mergesort"):
        if size[giver] == 0 or size[giver] > most:
            continue
        found = 0
        t = head[giver]
        while t >= 0:
            for k in range(3):
                other = chart[opposite[3 * t + k] // 3]
                if other != giver:
                    if border[other] == 0.0:
                        beside[found] = other
                        found += 1
                    border[other] += length[3 * t + k]
            t = following[t]
        given = False
        while not given:
            taker = -1
            for n in range(found):
                other = beside[n]
                if border[other] > 0.0 and (taker < 0 or border[other] > border[taker]):
                    taker = other
            if taker < 0:
                break
            border[taker] = 0.0
            given = _one_cone(normal, following, head[giver], head[taker], axes[taker], cosine, axis)
            if given:
                last = head[giver]
                chart[last] = taker
                while following[last] >= 0:
                    last = following[last]
                    chart[last] = taker
                following[last] = head[taker]
                head[taker] = head[giver]
                head[giver] = -1
                size[taker] += size[giver]
                size[giver] = 0
                axes[taker] = axis
                any_given = True
        for n in range(found):
            border[beside[n]] = 0.0
    return any_given


@copied
def _one_cone(normal, following, giver, taker, start, cosine, axis):
    """Whether a cone around some axis holds all normals of two lists; the axis is put into ``axis``.

    The cone around ``start`` holds those of the taker.

    The axis goes towards the normal that is farthest from it, by ever smaller steps (Badoiu and Clarkson, Smaller
    core-sets for balls, SODA 2003).
    """
    put(start, axis)
    for step in range(CONE_STEPS):
        worst = 2.0
        farthest = -1
        # the cone to begin with is the taker's own
        for side in range(1 if step == 0 else 2):
            t = giver if side == 0 else taker
            while t >= 0:
                c = normal[t, 0] * axis[0] + normal[t, 1] * axis[1] + normal[t, 2] * axis[2]
                if c < worst:
                    worst = c
                    farthest = t
                t = following[t]
        if worst >= cosine:
            return True
        if worst < -cosine:
            return False
        if step == 0:
            # normals of one cone are no farther apart than it is wide
            t = taker
            while t >= 0:
                c = (
                    normal[t, 0] * normal[farthest, 0]
                    + normal[t, 1] * normal[farthest, 1]
                    + normal[t, 2] * normal[farthest, 2]
                )
                if c < 2.0 * cosine * cosine - 1.0 - 1e-9:
                    return False
                t = following[t]
        share = 1.0 / (step + 2.0)
        total = 0.0
        for k in range(3):
            axis[k] += share * (normal[farthest, k] - axis[k])
            total += axis[k] * axis[k]
        if total < 1e-12:
            return False
        for k in range(3):
            axis[k] /= np.sqrt(total)
    return False


def _connected(chart: Int32, axes: Float64, opposite: Int32) -> tuple[Int32, Float64]:
    """Make each connected piece a chart of its own: pieces that only meet in the picture need a gutter."""
    owner, other = np.arange(len(opposite)) // 3, opposite // 3
    same = chart[owner] == chart[other]
    links = coo_array((np.ones(int(same.sum()), np.int8), (owner[same], other[same])), shape=(len(chart), len(chart)))
    count, piece = connected_components(links, directed=False)
    old = np.empty(count, np.int32)
    old[piece] = chart
    return piece.astype(np.int32), axes[old]


@kernel
def _grow(normal, area, opposite, chart, axes, cosine):
    """Grow charts over all triangles without one; new charts follow those there are. Returns all axes.

    A chart grows three times: around its running mean, then twice around the mean that the last time led to.
    """
    count = len(normal)
    queue = np.empty(count, np.int32)
    seen = np.full(count, -1, np.int32)
    new_axes = np.empty((count + len(axes), 3))
    new_axes[: len(axes)] = axes
    number = len(axes)
    trial = 0
    for seed in range(count):
        if chart[seed] >= 0:
            continue
        axis = normal[seed].copy()
        for turn in range(3):
            trial += 1
            total = np.zeros(3)
            first, last = 0, 1
            queue[0] = seed
            seen[seed] = trial
            while first < last:
                t = queue[first]
                first += 1
                total += normal[t] * area[t]
                if turn == 0:
                    length = np.sqrt((total * total).sum())
                    if length > 0.0:
                        axis = total / length
                for k in range(3):
                    o = opposite[3 * t + k] // 3
                    if seen[o] == trial or chart[o] >= 0:
                        continue
                    if (normal[o] * axis).sum() >= cosine:
                        seen[o] = trial
                        queue[last] = o
                        last += 1
            if turn < 2:
                length = np.sqrt((total * total).sum())
                mean = total / length if length > 0.0 else normal[seed].copy()
                toward = (mean * normal[seed]).sum()
                if toward < cosine:
                    # the seed itself must stay in the cone
                    away = mean - toward * normal[seed]
                    reach = np.sqrt((away * away).sum())
                    if reach > 0.0:
                        mean = cosine * normal[seed] + np.sqrt(1.0 - cosine * cosine) / reach * away
                    else:
                        mean = normal[seed].copy()
                axis = mean
        for q in range(last):
            chart[queue[q]] = number
        new_axes[number] = axis
        number += 1
    return new_axes[:number]


def _frames(axes: Float64) -> tuple[Float64, Float64]:
    """Two unit vectors at right angles to each axis, right-handed with it, shape (n, 3) each."""
    helper = np.eye(3)[np.abs(axes).argmin(axis=1)]
    right = np.cross(helper, axes)
    right /= np.linalg.norm(right, axis=1)[:, None]
    return right, np.cross(axes, right)


def project(points: Float64, axes: Float64, chart: Int32) -> Float64:
    """Points of charts along their axes onto the picture: to the right, and DOWN, as seen against the axis."""
    right, up = _frames(axes)
    flat = np.empty((len(points), 2))
    _project(np.ascontiguousarray(points), right, up, chart, flat)
    return flat


@loop_kernel
def _project(points, right, up, chart, flat):
    for n in numba.prange(len(points)):
        c = chart[n]
        x, y = 0.0, 0.0
        for k in range(3):
            x += points[n, k] * right[c, k]
            y -= points[n, k] * up[c, k]
        flat[n, 0], flat[n, 1] = x, y


def _evict(vertices: Float64, triangles: Int32, chart: Int32, axes: Float64, first_new: int) -> None:
    """Take triangles that overlap an earlier one of their chart out of it (chart -1)."""
    members = np.flatnonzero(chart >= first_new)
    order = members[np.argsort(chart[members], kind="stable")]
    start = np.searchsorted(chart[order], np.arange(first_new, len(axes) + 1))
    corners = vertices[triangles[order].ravel()]
    flat = project(corners, axes, np.repeat(chart[order], 3)).reshape(-1, 3, 2)
    is_over = np.zeros(len(flat), np.bool_)
    _note_overlapping(flat, start, is_over)
    chart[order[is_over]] = -1


@copied
def _cross_2d(ax, ay, bx, by, cx, cy):
    return (bx - ax) * (cy - ay) - (by - ay) * (cx - ax)


@copied
def _triangles_overlap(a, b, slack):
    """Whether two triangles share more than ``slack`` of an edge's height (separating axes: their edges)."""
    for first in range(2):
        one = a if first == 0 else b
        two = b if first == 0 else a
        turn = _cross_2d(one[0, 0], one[0, 1], one[1, 0], one[1, 1], one[2, 0], one[2, 1])
        sign = 1.0 if turn > 0.0 else -1.0
        for k in range(3):
            m = (k + 1) % 3
            length = np.hypot(one[m, 0] - one[k, 0], one[m, 1] - one[k, 1])
            apart = True
            for j in range(3):
                side = sign * _cross_2d(one[k, 0], one[k, 1], one[m, 0], one[m, 1], two[j, 0], two[j, 1])
                if side > slack * length:
                    apart = False
                    break
            if apart:
                return False
    return True


@copied
def _find_overlapping(flat, begin, end, out):
    """Mark the triangles of one chart that overlap a kept one of lower rank in it, by a hash grid."""
    low_x, low_y, high_x, high_y, reach = np.inf, np.inf, -np.inf, -np.inf, 0.0
    box = np.empty((end - begin, 4))
    for n in range(end - begin):
        t = begin + n
        x0, x1 = min(flat[t, 0, 0], flat[t, 1, 0], flat[t, 2, 0]), max(flat[t, 0, 0], flat[t, 1, 0], flat[t, 2, 0])
        y0, y1 = min(flat[t, 0, 1], flat[t, 1, 1], flat[t, 2, 1]), max(flat[t, 0, 1], flat[t, 1, 1], flat[t, 2, 1])
        box[n, 0], box[n, 1], box[n, 2], box[n, 3] = x0, x1, y0, y1
        low_x, high_x = min(low_x, x0), max(high_x, x1)
        low_y, high_y = min(low_y, y0), max(high_y, y1)
        reach += max(x1 - x0, y1 - y0)
    cell = max(reach / (end - begin), 1e-12) * 1.5
    columns = int((high_x - low_x) / cell) + 1
    rows = int((high_y - low_y) / cell) + 1
    while columns * rows > 16 * (end - begin) + 64:
        cell *= 1.5
        columns = int((high_x - low_x) / cell) + 1
        rows = int((high_y - low_y) / cell) + 1
    head = np.full(columns * rows, -1, np.int32)
    entry_count = 0
    place = np.empty((end - begin, 4), np.int32)
    for n in range(end - begin):
        place[n, 0], place[n, 1] = int((box[n, 0] - low_x) / cell), int((box[n, 1] - low_x) / cell)
        place[n, 2], place[n, 3] = int((box[n, 2] - low_y) / cell), int((box[n, 3] - low_y) / cell)
        entry_count += (place[n, 1] - place[n, 0] + 1) * (place[n, 3] - place[n, 2] + 1)
    following = np.empty(entry_count, np.int32)
    holder = np.empty(entry_count, np.int32)
    entry = 0
    slack = 1e-6 * cell
    for n in range(end - begin):
        i0, i1, j0, j1 = place[n]
        hit = False
        for j in range(j0, j1 + 1):
            for i in range(i0, i1 + 1):
                e = head[j * columns + i]
                while e >= 0 and not hit:
                    other = holder[e]
                    if (
                        box[n, 0] < box[other, 1]
                        and box[other, 0] < box[n, 1]
                        and box[n, 2] < box[other, 3]
                        and box[other, 2] < box[n, 3]
                    ):
                        hit = _triangles_overlap(flat[begin + n], flat[begin + other], slack)
                    e = following[e]
                if hit:
                    break
            if hit:
                break
        if hit:
            out[begin + n] = True
            continue
        for j in range(j0, j1 + 1):
            for i in range(i0, i1 + 1):
                holder[entry] = n
                following[entry] = head[j * columns + i]
                head[j * columns + i] = entry
                entry += 1


@loop_kernel
def _note_overlapping(flat, start, is_over):
    """Note the triangles that overlap a kept one of lower rank in the same chart."""
    for c in numba.prange(len(start) - 1):
        if start[c + 1] - start[c] > 1:
            _find_overlapping(flat, start[c], start[c + 1], is_over)
