"""Tags of the surface's triangles: the void in front, the tissue behind, or a cut end."""

from __future__ import annotations

from dataclasses import dataclass

import numba
import numpy as np

from heartcase.compiling.calls import copied
from heartcase.compiling.kernel import loop_kernel
from heartcase.compiling.tuple_addresses import lend
from heartcase.pipeline.data import Structures
from heartcase.pipeline.fields.point_kernels import evaluate_owner, scratch
from heartcase.pipeline.fields.reader import FieldReader
from heartcase.pipeline.mesh.extraction.extract import FullMesh
from heartcase.pipeline.mesh.triangles.half_edges import connected_parts, opposites
from heartcase.schemas.arrays import Bool, Float64, Int32, Int64, UInt8
from heartcase.schemas.geometry import Geometry

__all__ = ["CUT", "TriangleTags", "cut_faces", "shorter_borders", "tag_keys", "tag_triangles"]


CUT = 256
"""Key of a cut face; other keys are labels."""
ISLAND_TRIANGLES = 8
ISLAND_ROUNDS = 4
BORDER_ROUNDS = 4
"""So many triangles may a border give way by."""
LEAST_GAIN_MM = 1e-6
CUT_COSINE = 0.9
CHUNK = 1024


@dataclass(frozen=True)
class TriangleTags:
    """What lies on both sides of each triangle."""

    void: UInt8
    """Label of the void in front; 0 on cut faces."""
    tissue: UInt8
    """Label of the tissue behind."""
    is_cut: Bool
    """Whether the triangle closes tissue that the volume's border or an end marker cuts."""


def tag_triangles(reader: FieldReader, vertices: Float64, triangles: Int32, lattice: Geometry) -> TriangleTags:
    """Look a third of a lattice cell to both sides of each triangle; islands take their neighbours' tag.

    Borders between tags, which the triangles' middles make jagged, are shortened (:func:`shorter_borders`).

    Parameters
    ----------
    reader
        The structures.
    vertices, triangles
        A closed manifold mesh, world mm.
    lattice
        The lattice that it was extracted on: its outer faces are those of the volume.
    """
    void, tissue = np.empty(len(triangles), np.uint8), np.empty(len(triangles), np.uint8)
    to_index = np.ascontiguousarray(np.linalg.inv(reader.structures.geometry.affine)[:3])
    way = min(lattice.spacing_mm) / 3.0
    _look(reader.layout, reader.tables, to_index, way, vertices, triangles, void, tissue)
    beside = opposites(triangles)
    is_cut = cut_faces(reader.structures, vertices, triangles, lattice)
    key = _without_islands(np.where(is_cut, CUT, void.astype(np.int64)), vertices, triangles, beside)
    behind = _without_islands(tissue.astype(np.int64), vertices, triangles, beside)
    key = shorter_borders(key, key == CUT, vertices, triangles, beside)
    behind = shorter_borders(behind, key == CUT, vertices, triangles, beside)
    return TriangleTags(np.where(key == CUT, 0, key).astype(np.uint8), behind.astype(np.uint8), key == CUT)


def shorter_borders(tag: Int64, is_kept: Bool, vertices: Float64, triangles: Int32, opposite: Int32) -> Int64:
    """Tags with which the borders between them are shorter.

    A triangle takes the tag of a neighbour where that makes the border shorter at once, the lengths of its edges
    counted: of neighbours that would, the one that gains most (ties: the lower number). So a border gives way by a
    triangle in each of a few rounds, and no part of it grows longer.

    Parameters
    ----------
    tag
        Shape (triangle_count,).
    is_kept
        Triangles whose tag stays and is not handed on, shape (triangle_count,).
    vertices, triangles
        A closed manifold mesh.
    opposite
        Opposite half-edges, shape (3 triangle_count,).

    Returns
    -------
    Int64
        Shape (triangle_count,).
    """
    tag = tag.copy()
    beside = opposite.reshape(-1, 3) // 3
    corners = vertices[triangles]
    length = np.linalg.norm(np.roll(corners, -1, axis=1) - corners, axis=2)
    for _ in range(BORDER_ROUNDS):
        at = np.flatnonzero((tag[beside] != tag[:, None]).any(axis=1) & ~is_kept)
        own, around, edge = tag[at][:, None], tag[beside[at]], length[at]
        shared = np.where(around[:, None] == around[:, :, None], edge[:, None], 0.0).sum(axis=2)
        gain = shared - np.where(around == own, edge, 0.0).sum(axis=1)[:, None]
        gain[(around == own) | is_kept[beside[at]]] = -np.inf
        best = gain.argmax(axis=1)
        rows = np.arange(len(at))
        most = np.zeros(len(tag))
        most[at] = np.where(gain[rows, best] > LEAST_GAIN_MM, gain[rows, best], 0.0)
        rivals = most[beside[at]]
        is_first = (rivals < most[at][:, None]) | ((rivals == most[at][:, None]) & (beside[at] > at[:, None]))
        taken = (most[at] > 0.0) & is_first.all(axis=1)
        if not taken.any():
            break
        tag[at[taken]] = around[rows, best][taken]
    return tag


def tag_keys(mesh: FullMesh, is_cut: Bool, opposite: Int32) -> Int64:
    """Key of each triangle of the full mesh, from the void that its vertices were found beside.

    The label of two vertices counts, of three labels the first; islands take their neighbours' key. It costs no look
    at the fields, and differs from :func:`tag_triangles` only where two voids meet.

    Parameters
    ----------
    mesh
        The mesh.
    is_cut
        From :func:`cut_faces`.
    opposite
        Opposite half-edges.

    Returns
    -------
    Int64
        The void's label, or :data:`CUT`, shape (triangle_count,).
    """
    label = mesh.void_label[mesh.triangles]
    most = np.where(label[:, 1] == label[:, 2], label[:, 1], label[:, 0]).astype(np.int64)
    return _without_islands(np.where(is_cut, CUT, most), mesh.vertices_mm, mesh.triangles, opposite)


def cut_faces(structures: Structures, vertices: Float64, triangles: Int32, lattice: Geometry) -> Bool:
    """Triangles in an outer face of the volume, or in the disc of an end marker, that face outward there.

    Parameters
    ----------
    structures
        With the end markers.
    vertices, triangles
        A mesh, world mm.
    lattice
        The lattice that it was extracted on.
    """
    is_cut = np.empty(len(triangles), np.bool_)
    to_lattice = np.ascontiguousarray(np.linalg.inv(lattice.affine)[:3])
    direction = np.ascontiguousarray(lattice.direction_matrix, np.float64)
    size, near = np.array(lattice.size, np.int64), 0.5 * min(lattice.spacing_mm)
    _find_cuts(to_lattice, direction, size, _planes(structures), near, vertices, triangles, is_cut)
    return is_cut


def _planes(structures: Structures) -> Float64:
    """Point, unit axis and radius of each end marker."""
    rows = [
        (*point, *(np.array(axis) / np.linalg.norm(axis)), radius) for point, axis, radius in structures.fixed_planes
    ]
    return np.array(rows, np.float64).reshape(-1, 7)


@copied
def _is_cut(centre, normal, to_lattice, direction, size, planes, near):
    """Whether a triangle lies in an outer face of the volume, or in an end marker's disc, and faces outward there."""
    for axis in range(3):
        at = to_lattice[axis, 3]
        along = 0.0
        for k in range(3):
            at += to_lattice[axis, k] * centre[k]
            along += normal[k] * direction[k, axis]
        if (at < -0.25 and along < -CUT_COSINE) or (at > size[axis] - 0.75 and along > CUT_COSINE):
            return True
    for n in range(len(planes)):
        height = 0.0
        along = 0.0
        square = 0.0
        for k in range(3):
            away = centre[k] - planes[n, k]
            height += away * planes[n, 3 + k]
            along += normal[k] * planes[n, 3 + k]
            square += away * away
        beside = square - height * height
        if abs(height) < near and along > CUT_COSINE and beside <= planes[n, 6] * planes[n, 6]:
            return True
    return False


@copied
def _middle(vertices, triangle, centre, normal):
    """Centre and unit normal of a triangle."""
    a, b, c = vertices[triangle[0]], vertices[triangle[1]], vertices[triangle[2]]
    for k in range(3):
        centre[k] = (a[k] + b[k] + c[k]) / 3.0
    normal[0] = (b[1] - a[1]) * (c[2] - a[2]) - (b[2] - a[2]) * (c[1] - a[1])
    normal[1] = (b[2] - a[2]) * (c[0] - a[0]) - (b[0] - a[0]) * (c[2] - a[2])
    normal[2] = (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0])
    length = max(np.sqrt(normal[0] ** 2 + normal[1] ** 2 + normal[2] ** 2), 1e-30)
    for k in range(3):
        normal[k] /= length


@loop_kernel
def _find_cuts(to_lattice, direction, size, planes, near, vertices, triangles, is_cut):
    for chunk in numba.prange((len(triangles) + CHUNK - 1) // CHUNK):
        centre, normal = np.empty(3), np.empty(3)
        for t in range(chunk * CHUNK, min((chunk + 1) * CHUNK, len(triangles))):
            _middle(vertices, triangles[t], centre, normal)
            is_cut[t] = _is_cut(centre, normal, to_lattice, direction, size, planes, near)


@loop_kernel
def _look(layout, tables, to_index, way, vertices, triangles, void, tissue):
    fields, walls = lend(layout), lend(tables)
    for chunk in numba.prange((len(triangles) + CHUNK - 1) // CHUNK):
        spare = scratch(fields)
        centre, normal, index = np.empty(3), np.empty(3), np.empty(3)
        for t in range(chunk * CHUNK, min((chunk + 1) * CHUNK, len(triangles))):
            _middle(vertices, triangles[t], centre, normal)
            for side in range(2):
                step = way if side == 0 else -way
                for k in range(3):
                    index[k] = to_index[k, 3]
                    for m in range(3):
                        index[k] += to_index[k, m] * (centre[m] + step * normal[m])
                owner = evaluate_owner(fields, walls, index[0], index[1], index[2], spare)
                if side == 0:
                    void[t] = owner[1]
                else:
                    tissue[t] = owner[2]


def _without_islands(key: Int64, vertices: Float64, triangles: Int32, opposite: Int32) -> Int64:
    """Give islands of few triangles the tag with which they share the longest border (ties: the lower)."""
    key = key.copy()
    for _ in range(ISLAND_ROUNDS):
        part, sizes = connected_parts(key, opposite)
        small = sizes < ISLAND_TRIANGLES
        inside = np.flatnonzero(small[part])
        edge = (3 * inside[:, None] + np.arange(3)).ravel()
        other = opposite[edge] // 3
        # an island beside an island waits for the next round
        rim = (key[other] != key[edge // 3]) & ~small[part[other]]
        edge, other = edge[rim], other[rim]
        if not len(edge):
            break
        islands, row = np.unique(part[edge // 3], return_inverse=True)
        tags, column = np.unique(key[other], return_inverse=True)
        tail, head = triangles[edge // 3, edge % 3], triangles[edge // 3, (edge % 3 + 1) % 3]
        border = np.zeros((len(islands), len(tags)))
        np.add.at(border, (row, column), np.linalg.norm(vertices[head] - vertices[tail], axis=1))
        value = np.full(len(sizes), -1, np.int64)
        value[islands] = tags[border.argmax(axis=1)]
        new = value[part[inside]]
        key[inside] = np.where(new >= 0, new, key[inside])
    return key
