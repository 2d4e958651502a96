"""Contacts of blood of two labels with no tissue between: faces, their area, their connected components.

The contact is found over the faces between voxels, then over those of sub-voxels near them. Faces make a staircase,
which has up to 1.73 times the area of the smooth border (1.5 times on average over all directions). So each face
counts only as much as it faces along the border's normal, which comes from the faces around it: exact for a plane,
convergent for a curved border (Lachaud, Coeurjolly, Levallois, Robust and convergent curvature and normal estimators
with digital integral invariants, in Modern Approaches to Discrete Curvature, Springer 2017).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import cc3d
import numpy as np
from scipy.sparse import csr_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree

from heartcase.pipeline.data import Segmentation, Structures
from heartcase.pipeline.fields.reader import FieldReader, ownership_at_points
from heartcase.schemas.arrays import Bool, Float64, Int64, Intp, UInt8
from heartcase.schemas.geometry import Geometry
from heartcase.schemas.labels import BACKGROUND, LabelTable, Role

__all__ = ["Contact", "Extent", "faces_between", "find_contact", "without_tissue"]


FINE_MM = 0.6
"""Contacts are measured on voxels divided to about this size, into no more than ``MOST_FINE`` along each edge."""
MOST_FINE = 3
NEIGHBOUR = 1.45
"""Faces are neighbours when their centres are no farther apart than this, in voxels: they share at least a corner."""
NORMAL_STEPS = 8
"""Steps from neighbour to neighbour over which a face's normal is averaged."""
POCKET_SHARE = 0.1
"""A piece with less than this part of a label's voxels may be what a patch cuts off: blood that leads nowhere."""
MOST_PROBES = 32
"""Points between the centres of two voxels at which tissue is looked for, at most."""
PLACES_MOST = 8
"""Patches whose places are told."""
CHUNK = 50_000
"""Voxels or faces that are looked at together: bounds the memory."""


class Extent(NamedTuple):
    """How large a contact is and where."""

    area_mm2: float
    """Area of the smooth border, mm2."""
    patches: int
    """Pieces that do not touch."""
    centers_mm: tuple[tuple[float, float, float], ...]
    """Of the largest patches, largest first, the point of each that is nearest to its mean, world mm."""
    reach_mm: float
    """Distance from the first of these to the farthest face of that patch."""

    @property
    def center_mm(self) -> tuple[float, float, float]:
        """That of the largest patch."""
        return self.centers_mm[0]


@dataclass(frozen=True)
class Contact:
    """Faces between voxels of two cavities."""

    index: Float64
    """Centres as continuous indices (i, j, k), shape (n, 3)."""
    axis: Int64
    """Axis across each face: 0 i, 1 j, 2 k; shape (n,)."""
    first: Int64
    """Label before the face along its axis, shape (n,)."""
    second: Int64
    """Label behind it, shape (n,)."""
    geometry: Geometry
    """The lattice of the voxels."""

    def __getitem__(self, chosen: Bool) -> Contact:
        return Contact(self.index[chosen], self.axis[chosen], self.first[chosen], self.second[chosen], self.geometry)

    @property
    def points_mm(self) -> Float64:
        """Centres of the faces, world mm, shape (n, 3)."""
        return self.geometry.index_to_world(self.index)

    @property
    def pairs(self) -> Int64:
        """The two labels of each face, the lower first, shape (n, 2)."""
        return np.sort(np.stack([self.first, self.second], axis=1), axis=1)

    def patches(self) -> list[Contact]:
        """Its pieces that do not touch, in the order of their first faces; there must be at least one face."""
        neighbours = cKDTree(self.index).query_pairs(NEIGHBOUR, output_type="ndarray")
        count, patch = connected_components(_graph(neighbours, len(self.index)), directed=False)
        return [self[patch == n] for n in range(count)]

    def extent(self) -> Extent:
        """Measure the faces together; there must be at least one, and all of one pair."""
        neighbours = cKDTree(self.index).query_pairs(NEIGHBOUR, output_type="ndarray")
        patches, patch = connected_components(_graph(neighbours, len(self.index)), directed=False)
        area = self._areas_mm2(neighbours)
        sizes = np.bincount(patch, weights=area, minlength=patches)
        points_mm, centers = self.points_mm, []
        for n in np.argsort(-sizes, kind="stable")[:PLACES_MOST]:
            points = points_mm[patch == n]
            middle = np.average(points, axis=0, weights=area[patch == n])
            x, y, z = points[np.argmin(np.linalg.norm(points - middle, axis=1).round(6))].tolist()
            centers.append((x, y, z))
        largest = points_mm[patch == np.argmax(sizes)]
        reach = float(np.linalg.norm(largest - centers[0], axis=1).max())
        return Extent(float(area.sum()), int(patches), tuple(centers), reach)

    def _areas_mm2(self, neighbours: Intp) -> Float64:
        """Each face's share of the smooth border, shape (n,), above zero."""
        spacing = np.array(self.geometry.spacing_mm)
        face_mm2 = float(np.prod(spacing)) / spacing[self.axis]
        own = np.arange(len(self.axis))
        vector = np.zeros((len(own), 3))
        vector[own, self.axis] = np.where(self.first < self.second, face_mm2, -face_mm2)
        one, other = neighbours.T
        # Both sides of a sheet one voxel thick are neighbours too; together they would have no normal.
        same_side = np.einsum("ij,ij->i", vector[one], vector[other]) >= 0.0
        step = _graph(neighbours[same_side], len(own))
        normal = vector
        for _ in range(NORMAL_STEPS):
            normal = normal + step @ normal
        share: Float64 = np.abs(normal[own, self.axis]) / np.linalg.norm(normal, axis=1)
        return face_mm2 * share


def find_contact(
    structures: Structures, labels: Segmentation, lines_mm: Sequence[tuple[Float64, Float64]] = ()
) -> Contact:
    """Find where blood of different labels touches.

    Parameters
    ----------
    structures
        The final structures, after edits and end cuts.
    labels
        The label of every voxel of their lattice, walls included.
    lines_mm
        Lines from point to point, each shape (3,) in world mm, along which an opening narrower than a voxel is looked
        for as well.

    Returns
    -------
    Contact
        On a lattice finer than the voxels, by axis, then in the order of the volume. No tissue lies between the
        voxels of a face, however thin it is. In a heart with patches, blood that a patch cuts off from the rest of
        its label does not count: a patch closes a canal also where it does not lie in the middle of it.
    """
    coarse = labels.geometry
    near = _voxels_near(labels, lines_mm)
    if len(near) == 0:
        return faces_between(np.zeros((1, 1, 1), np.uint8), coarse, _blood_pairs(labels.table))
    factor = int(np.clip(math.ceil(float(np.mean(coarse.spacing_mm)) / FINE_MM), 1, MOST_FINE))
    low, size = near.min(axis=0), np.ptp(near, axis=0) + 1
    box = _box(structures, low - 1, low + size + 1)
    values = np.zeros(tuple((factor * size)[::-1]), np.uint8)
    offsets = np.array(list(np.ndindex(factor, factor, factor)))
    for start in range(0, len(near), CHUNK):
        part = near[start : start + CHUNK, None]
        owner = ownership_at_points(box, coarse.index_to_world(part + (offsets + 0.5) / factor - 0.5))
        i, j, k = (factor * (part - low) + offsets).reshape(-1, 3).T
        # Where a patch meets the rim of its hole neither may own a point, and the distance to tissue is zero there.
        values[k, j, i] = np.where(owner.tissue_mm <= 0.0, BACKGROUND, owner.void_label)
    first = factor * low
    nz, ny, nx = values.shape
    fine = coarse.refined(factor).cropped((int(first[0]), int(first[1]), int(first[2])), (nx, ny, nz))
    contact = without_tissue(faces_between(values, fine, _blood_pairs(labels.table)), box)
    is_patched = any(structures.table[value].role is Role.DEVICE for value in structures.values)
    return _without_pockets(contact, labels) if is_patched else contact


def _voxels_near(labels: Segmentation, lines_mm: Sequence[tuple[Float64, Float64]]) -> Int64:
    """Voxels to look at closely, as indices (i, j, k), shape (n, 3), in the order of the volume."""
    geometry = labels.geometry
    size = np.array(geometry.size)
    faces = faces_between(labels.labels, geometry, _blood_pairs(labels.table))
    seeds = [np.floor(faces.index), np.ceil(faces.index)]
    for start, end in lines_mm:
        count = math.ceil(float(np.linalg.norm(end - start)) / min(geometry.spacing_mm)) + 1
        line = geometry.world_to_index(start + np.linspace(0.0, 1.0, count)[:, None] * (end - start))
        seeds.append(np.round(line[np.all((line > -0.5) & (line < size - 0.5), axis=1)]))
    voxels = np.concatenate(seeds).astype(np.int64)
    near = np.zeros(geometry.shape, np.bool_)
    for offset in np.ndindex(3, 3, 3):
        i, j, k = np.clip(voxels + np.array(offset) - 1, 0, size - 1).T
        near[k, j, i] = True
    return np.stack(np.unravel_index(np.flatnonzero(near), near.shape)[::-1], axis=1)


def _blood_pairs(table: LabelTable) -> Bool:
    """Pairs of values that are blood of two labels, shape (256, 256)."""
    is_blood = np.zeros(256, np.bool_)
    is_blood[list(table.blood_values)] = True
    pairs: Bool = np.logical_and.outer(is_blood, is_blood) & ~np.eye(256, dtype=np.bool_)
    return pairs


def faces_between(values: UInt8, geometry: Geometry, is_wanted: Bool) -> Contact:
    """Find all faces between voxels of two values that are wanted together.

    Parameters
    ----------
    values
        Value of each voxel, shape [z, y, x].
    geometry
        Their lattice.
    is_wanted
        Whether a face between these two values counts, shape (256, 256).

    Returns
    -------
    Contact
        By axis, then in the order of the volume.
    """
    index, axes, first, second = [], [], [], []
    for axis in range(3):
        before: list[slice] = [slice(None)] * 3
        behind = list(before)
        before[2 - axis], behind[2 - axis] = slice(None, -1), slice(1, None)
        one, other = values[tuple(before)], values[tuple(behind)]
        flat = np.flatnonzero(one != other)
        flat = flat[is_wanted[one.ravel()[flat], other.ravel()[flat]]]
        where = np.unravel_index(flat, one.shape)
        middles = np.stack(where[::-1], axis=1).astype(np.float64)
        middles[:, axis] += 0.5
        index.append(middles)
        axes.append(np.full(len(middles), axis, np.int64))
        first.append(one[where].astype(np.int64))
        second.append(other[where].astype(np.int64))
    return Contact(np.concatenate(index), np.concatenate(axes), np.concatenate(first), np.concatenate(second), geometry)


def without_tissue(contact: Contact, structures: Structures | FieldReader) -> Contact:
    """The faces without a wall or a patch, thinner than a voxel, between the centres beside them."""
    if len(contact.axis) == 0:
        return contact
    reader = FieldReader.of(structures)
    thinnest = reader.structures.thinnest_layer_mm or math.inf
    count = int(np.clip(math.ceil(2.0 * max(contact.geometry.spacing_mm) / thinnest), 3, MOST_PROBES))
    steps = (np.arange(count) + 0.5) / count - 0.5
    parts = []
    for start in range(0, len(contact.axis), CHUNK):
        unit = np.eye(3)[contact.axis[start : start + CHUNK]]
        probes = contact.index[start : start + CHUNK] + steps[:, None, None] * unit
        tissue_mm = ownership_at_points(reader, contact.geometry.index_to_world(probes)).tissue_mm
        parts.append((tissue_mm.reshape(count, -1) > 0.0).all(axis=0))
    return contact[np.concatenate(parts)]


def _without_pockets(contact: Contact, labels: Segmentation) -> Contact:
    """The faces with a large piece of its label within a voxel on both sides."""
    table, size = labels.table, np.array(labels.geometry.size)
    is_blood = np.zeros(256, np.bool_)
    is_blood[list(table.blood_values)] = True
    pieces = cc3d.connected_components(np.where(is_blood[labels.labels], labels.labels, 0), connectivity=6)
    counts = np.bincount(pieces.ravel())
    totals = np.bincount(labels.labels.ravel(), minlength=256)
    kept = np.ones(len(contact.axis), np.bool_)
    for values, side in ((contact.first, -0.5), (contact.second, 0.5)):
        beside = contact.index + side * np.eye(3)[contact.axis]
        voxel = np.round(labels.geometry.world_to_index(contact.geometry.index_to_world(beside))).astype(np.int64)
        is_large = np.zeros(len(kept), np.bool_)
        for step in (np.zeros(3, np.int64), *np.eye(3, dtype=np.int64), *-np.eye(3, dtype=np.int64)):
            i, j, k = np.clip(voxel + step, 0, size - 1).T
            same = labels.labels[k, j, i] == values
            is_large |= same & (counts[pieces[k, j, i]] >= POCKET_SHARE * totals[values])
        kept &= is_large
    return contact[kept]


def _box(structures: Structures, low: Int64, high: Int64) -> Structures:
    """The part of the structures between two indices (i, j, k), the second excluded: all that is read there."""
    start = np.maximum(low, 0)
    i, j, k = (int(value) for value in start)
    nx, ny, nz = (int(value) for value in np.minimum(high, structures.geometry.size) - start)
    part = (slice(k, k + nz), slice(j, j + ny), slice(i, i + nx))
    return replace(
        structures,
        distance_mm={value: field[part] for value, field in structures.distance_mm.items()},
        geometry=structures.geometry.cropped((i, j, k), (nx, ny, nz)),
    )


def _graph(neighbours: Intp, count: int) -> Any:
    """Symmetric adjacency matrix, its rows in order so that sums do not depend on the search."""
    one, other = neighbours.T
    ends = (np.concatenate([one, other]), np.concatenate([other, one]))
    graph = csr_array((np.ones(len(ends[0])), ends), shape=(count, count))
    graph.sort_indices()
    return graph
