"""Closed surfaces over blocks, and what a split surface has to be."""

from __future__ import annotations

import numpy as np
from hypothesis import strategies as st
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components

from heartcase.simulator.cutting.blade_sheet import Sheet
from heartcase.simulator.lattice.model import LatticeModel, make_model
from heartcase.simulator.surface.deform import SurfaceModel, make_surface
from heartcase.simulator.surface_splitting.free_parts import parts_of_lattice

FACES = np.array([(0, 4, 6, 2), (1, 3, 7, 5), (0, 1, 5, 4), (2, 6, 7, 3), (0, 2, 3, 1), (4, 5, 7, 6)])
STEPS = np.array([(-1, 0, 0), (1, 0, 0), (0, -1, 0), (0, 1, 0), (0, 0, -1), (0, 0, 1)])


def box(counts, size, *, jitter=0.0, seed=0):
    """A box of some size [cells] with its sides divided into so many squares, each of two triangles."""
    numbers, places, triangles = {}, [], []

    def vertex(index):
        if index not in numbers:
            numbers[index] = len(places)
            places.append(np.array(index) / counts * size)
        return numbers[index]

    for axis in range(3):
        a, b = (axis + 1) % 3, (axis + 2) % 3
        for side in (0, counts[axis]):
            for p, q in np.ndindex(counts[a], counts[b]):
                quad = []
                for i, j in ((p, q), (p + 1, q), (p + 1, q + 1), (p, q + 1)):
                    index = [0, 0, 0]
                    index[axis], index[a], index[b] = side, i, j
                    quad.append(vertex(tuple(index)))
                quad = quad if side else quad[::-1]
                triangles += [[quad[0], quad[1], quad[2]], [quad[0], quad[2], quad[3]]]
    places = np.array(places)
    if jitter:
        places = places + np.random.default_rng(seed).normal(0, jitter, places.shape)
    return places, np.array(triangles)


def block(shape, **options) -> LatticeModel:
    cells = np.stack(np.meshgrid(*[np.arange(n) for n in shape], indexing="ij"), axis=-1).reshape(-1, 3)
    return make_model(cells[np.lexsort(cells.T)], **options)


def hung(model: LatticeModel, places, triangles, *, curvature=0) -> SurfaceModel:
    """A surface that follows the nearest outer face of a lattice, vertex by vertex."""
    there = {tuple(cell) for cell in model.cells.tolist()}
    halves = [
        corners[list(half)]
        for cell, corners in zip(model.cells, model.cell_corners, strict=True)
        for step, face in zip(STEPS, FACES, strict=True)
        if tuple((cell + step).tolist()) not in there
        for half in (face[[0, 1, 2]], face[[0, 2, 3]])
    ]
    halves = np.array(halves)
    corners = model.node_index[halves].astype(float)
    middles = corners.mean(axis=1)
    chosen = ((places[:, None] - middles) ** 2).sum(axis=2).argmin(axis=1)
    p, q, r = np.moveaxis(corners[chosen], 1, 0)
    weights = np.full((len(places), 3), 1 / 3)
    T = (q - p) / np.linalg.norm(q - p, axis=1)[:, None]
    N = np.cross(T, r - p)
    N /= np.linalg.norm(N, axis=1)[:, None]
    basis = np.stack([T, N, np.cross(N, T)], axis=1)
    offset = np.einsum("vbx,vx->vb", basis, places - middles[chosen])
    return make_surface(
        model,
        triangle_nodes=halves[chosen].astype(np.int32),
        weights=weights.astype(np.float32),
        offset_mm=(offset * model.cell_mm).astype(np.float32),
        normal=np.tile(np.array([0, 1, 0], np.float32), (len(places), 1)),
        curvature=np.full(len(places), curvature, np.uint8),
        triangles=triangles.astype(np.int32),
    )


def volume(places, triangles) -> float:
    p, q, r = np.moveaxis(places[triangles], 1, 0)
    return float(np.einsum("tx,tx->", p, np.cross(q, r)) / 6)


def part_volumes(places, triangles, parts):
    p, q, r = np.moveaxis(places[triangles], 1, 0)
    return np.bincount(parts, np.einsum("tx,tx->t", p, np.cross(q, r)) / 6)


def check_closed(triangles) -> None:
    """Each edge in two triangles, once each way; around each vertex one circle of triangles."""
    assert (triangles != np.roll(triangles, 1, axis=1)).all()
    starts, ends = triangles.astype(np.int64), np.roll(triangles, -1, axis=1).astype(np.int64)
    key, back = (starts << 32 | ends).ravel(), (ends << 32 | starts).ravel()
    assert len(np.unique(key)) == len(key)
    order = np.argsort(key)
    at = order[np.minimum(np.searchsorted(key, back, sorter=order), len(key) - 1)]
    np.testing.assert_array_equal(key[at], back)
    corner = np.arange(triangles.size)
    after = (np.arange(triangles.size).reshape(-1, 3)[:, [1, 2, 0]]).ravel()
    # Along each edge the corner at its start is that at the end of the other triangle's.
    joined = coo_matrix((np.ones(len(key)), (corner, after[at])), (len(key), len(key)))
    count, _ = connected_components(joined, directed=False)
    assert count == len(np.unique(triangles))


def check_ties(model, found, uncut) -> None:
    """Nodes are corners of one piece; no part of the surface follows what another does."""
    surface = found.surface
    changed = np.flatnonzero(found.vertex_cells >= 0)
    corners = model.cell_corners[found.vertex_cells[changed]]
    nodes = surface.triangle_nodes[changed]
    assert (corners[:, None, :] == nodes[:, :, None]).any(axis=2).all()
    kept = np.flatnonzero(found.vertex_cells < 0)
    np.testing.assert_array_equal(surface.triangle_nodes[kept], uncut.triangle_nodes[kept])
    of_node = np.zeros(model.node_count, int)
    of_node[model.cell_corners] = parts_of_lattice(model)[:, None]
    used = [np.unique(surface.triangles[found.triangle_part == n]) for n in range(found.triangle_part.max() + 1)]
    follows = of_node[surface.triangle_nodes]
    of_parts = [follows[vertices].ravel() for vertices in used]
    most = [np.bincount(parts).argmax() for parts in of_parts]
    for parts, own in zip(of_parts, most, strict=True):
        assert set(parts.tolist()) & set(most) == {own}
    np.testing.assert_array_equal(surface.triangle_nodes[found.weld], surface.triangle_nodes)


@st.composite
def sheets(draw, low=-0.5, high=4.5):
    """Blades swept anywhere, on halves or on whole numbers, smoothly or not."""
    kind = draw(st.integers(0, 2))
    number = [
        st.floats(low, high),
        st.integers(int(2 * low), int(2 * high)).map(lambda n: n / 2),
        st.integers(int(np.ceil(low)), int(high)).map(float),
    ][kind]
    found = []
    for _ in range(draw(st.integers(1, 3))):
        poses, points = draw(st.integers(2, 4)), draw(st.integers(2, 3))
        if draw(st.booleans()):
            blade = np.array(draw(st.lists(st.tuples(number, number, number), min_size=points, max_size=points)))
            ways = np.array(draw(st.lists(st.tuples(number, number, number), min_size=poses, max_size=poses)))
            found.append(Sheet.swept(blade[None] + ways[:, None] - 1.5))
        else:
            corner = st.tuples(number, number, number)
            rows = st.lists(corner, min_size=points, max_size=points)
            found.append(Sheet.swept(draw(st.lists(rows, min_size=poses, max_size=poses))))
    return found


def plane(axis: int, place: float, low=-1.0, high=9.0) -> Sheet:
    """A sheet across an axis."""
    corners = np.zeros((2, 2, 3))
    corners[..., axis] = place
    corners[:, :, (axis + 1) % 3] = [[low, high], [low, high]]
    corners[:, :, (axis + 2) % 3] = [[low, low], [high, high]]
    return Sheet.swept(corners)
