"""What is asked of vertices near sheets, in plain NumPy of all vertices: the oracle of what looks near sheets alone."""

from __future__ import annotations

import numpy as np

from heartcase.simulator.surface_splitting.gluing import join_sets
from heartcase.simulator.surface_splitting.hanging import _unit
from heartcase.simulator.surface_splitting.split_surface import _ONE_PLACE


def plain_directions(cuttable, split):
    """Direction out of the tissue at each new vertex, and its normal; unit vectors, grid axes."""
    old_count, count = len(cuttable.normals), len(split.places)
    rows = np.arange(len(split.triangles) - len(split.facing), len(split.triangles))
    triangles, facing = split.triangles[rows], split.facing
    # By the angle at the corner: how a side is divided into triangles does not count.
    corners = split.places[triangles]
    ahead, back = np.roll(corners, -1, axis=1) - corners, np.roll(corners, 1, axis=1) - corners
    angle = np.arctan2(np.linalg.norm(np.cross(ahead, back), axis=2), np.einsum("tcx,tcx->tc", ahead, back))
    angle += 0.3  # a side that is too thin counts, too
    weighted = facing[:, None, :] * angle[..., None]

    def summed(vertices):
        sums = [np.bincount(vertices.ravel(), weighted[..., axis].ravel(), minlength=count) for axis in range(3)]
        return np.stack(sums, axis=1)

    # Vertices in one place that hang together see what all of them see.
    one, other = split.weld[triangles], split.weld[np.roll(triangles, -1, axis=1)]
    alike = np.linalg.norm(ahead, axis=2) < _ONE_PLACE
    places = np.arange(count)
    join_sets(places, np.stack([one[alike], other[alike]], axis=1).astype(np.int64))
    own, together = summed(triangles), summed(places[split.weld[triangles]])[places[split.weld]]
    # Where both walls of a cut meet and cancel out, any of them.
    first = np.zeros((count, 3))
    first[triangles[::-1].ravel()] = np.repeat(facing[::-1], 3, axis=0)
    normals = _unit(own)
    normals = np.where(np.linalg.norm(normals, axis=1, keepdims=True) > 0, normals, first)
    on = np.flatnonzero(split.on_triangle >= 0)
    is_lip = np.zeros(count, np.bool_)
    is_lip[triangles[split.triangle_origin[rows] >= 0].ravel()] = True
    on = on[is_lip[on]]
    of_corners = cuttable.normals[cuttable.mesh.triangles[split.on_triangle[on]]]
    smooth = _unit(np.einsum("nc,ncx->nx", split.on_weights[on], of_corners))
    normals[on] = np.where(np.linalg.norm(smooth, axis=1, keepdims=True) > 0, smooth, normals[on])
    outward = _unit(together)
    for spare in (outward, np.array([0.0, 0.0, 1.0])):
        normals = np.where(np.linalg.norm(normals, axis=1, keepdims=True) > 0, normals, spare)
    return outward[old_count:], normals[old_count:]


def plain_towards_own_triangles(split, vertices):
    """Unit vectors from some vertices to the middle of their triangles, shape (count, 3): off a sheet that they lie on.

    On which side of it a vertex is, no place tells, but the triangles that it has.
    """
    row = np.full(len(split.places), -1)
    row[vertices] = np.arange(len(vertices))
    corners = row[split.triangles]
    triangle, corner = np.nonzero(corners >= 0)
    at = corners[triangle, corner]
    way = split.places[split.triangles[triangle]].mean(axis=1) - split.places[split.triangles[triangle, corner]]
    total = np.zeros((len(vertices), 3))
    np.add.at(total, at, way)
    length = np.linalg.norm(total, axis=1, keepdims=True)
    return np.divide(total, length, out=np.zeros_like(total), where=length > 0)


def plain_near_sheets(model, parted, places):
    """Vertices within two cells of those that a sheet comes to."""
    low = model.cells.min(axis=0) - 3
    size = model.cells.max(axis=0) + 4 - low
    touched = np.zeros(tuple(size), np.bool_)
    touched[tuple((model.cells[parted.pieces.cells] - low).T)] = True
    grown = touched
    for axis in range(3):
        moved = [np.roll(grown, step, axis=axis) for step in (-1, 1)]
        grown = grown | moved[0] | moved[1]
    index = np.clip(np.floor(places).astype(np.int64) - low, 0, size - 1)
    return np.flatnonzero(grown[tuple(index.T)])
