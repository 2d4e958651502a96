"""The watershed of heartcase.pipeline.watershed in plain Python: a flood in the order of the faces, and Kruskal."""

from __future__ import annotations

import heapq

import numpy as np

UNMARKED = 255
SIDES = ((-1, 0, 0), (0, -1, 0), (0, 0, -1), (0, 0, 1), (0, 1, 0), (1, 0, 0))


def neighbours(voxel, shape):
    """The six neighbours inside the volume, by ascending index."""
    for side in SIDES:
        near = tuple(int(a + b) for a, b in zip(voxel, side, strict=True))
        if all(0 <= a < n for a, n in zip(near, shape, strict=True)):
            yield near


class Order:
    """The strict order of the faces."""

    def __init__(self, height):
        self.height = height
        self.index = np.arange(height.size).reshape(height.shape)

    def rank(self, voxel):
        return float(self.height[voxel]), int(self.index[voxel])

    def face(self, one, other):
        higher, lower = sorted((one, other), key=self.rank, reverse=True)
        return (*self.rank(higher), *self.rank(lower))


def with_flats_divided(height, markers, cost=None, axis_cost=(1, 1, 1)):
    """Markers with each contested flat minimum divided by the shortest ways to marked voxels."""
    cost = np.ones(height.shape, int) if cost is None else cost.astype(int)

    def into(voxel, near):
        """Cost of the step into a voxel from its neighbour."""
        return int(cost[voxel] * axis_cost[np.flatnonzero(np.subtract(voxel, near))[0]])

    marked = markers.copy()
    index = np.arange(height.size).reshape(height.shape)
    seen = set()
    for start in np.ndindex(height.shape):
        if start in seen:
            continue
        flat, shore = {start}, [start]
        while shore:
            for near in neighbours(shore.pop(), height.shape):
                if height[near] == height[start] and near not in flat:
                    flat.add(near)
                    shore.append(near)
        seen |= flat
        is_minimum = all(height[near] >= height[start] for voxel in flat for near in neighbours(voxel, height.shape))
        painted = {voxel for voxel in flat if markers[voxel] != UNMARKED}
        if len(flat) == 1 or not is_minimum or len({int(markers[voxel]) for voxel in painted}) < 2:
            continue
        length, waiting = {}, [(1, voxel) for voxel in painted]
        while waiting:
            way, voxel = heapq.heappop(waiting)
            if voxel in length:
                continue
            length[voxel] = way
            for near in neighbours(voxel, height.shape):
                if near in flat:
                    heapq.heappush(waiting, (way + into(near, voxel), near))
        for voxel in sorted(flat - painted, key=lambda v: length[v]):
            near = [n for n in neighbours(voxel, height.shape) if n in flat]
            givers = [n for n in near if length[n] + into(voxel, n) == length[voxel]]
            marked[voxel] = marked[min(givers, key=lambda v: index[v])]
    return marked


def flood(height, markers, *costs):
    """Prim's algorithm: of all faces on the shore the lowest is flooded next."""
    order = Order(height)
    labels = with_flats_divided(height, markers, *costs)
    shore = []

    def join(voxel):
        for near in neighbours(voxel, height.shape):
            if labels[near] == UNMARKED:
                heapq.heappush(shore, (order.face(voxel, near), voxel, near))

    for voxel in np.argwhere(labels != UNMARKED):
        join(tuple(int(a) for a in voxel))
    while shore:
        _, voxel, near = heapq.heappop(shore)
        if labels[near] == UNMARKED:
            labels[near] = labels[voxel]
            join(near)
    return labels


def joined(height, markers, *costs):
    """Kruskal's algorithm: all faces in order, each joins two pieces unless both are labelled."""
    order = Order(height)
    labels = with_flats_divided(height, markers, *costs)
    piece = {voxel: {voxel} for voxel in np.ndindex(height.shape)}
    faces = [(order.face(v, n), v, n) for v in piece for n in neighbours(v, height.shape) if v < n]
    for _, one, other in sorted(faces):
        if piece[one] is piece[other]:
            continue
        named = [int(labels[v]) for v in (one, other)]
        if UNMARKED not in named:
            continue
        whole = piece[one] | piece[other]
        for voxel in whole:
            piece[voxel] = whole
            labels[voxel] = min(named)
    return labels
