"""Whether vertices of the surface follow tissue on their own side of every wall, read from the fields alone."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import ndimage

from heartcase.pipeline.cells.picking import split_faces
from heartcase.pipeline.data import GridMap, SimulationGrid, Structures, Surface
from heartcase.pipeline.fields.reader import FieldReader, ownership_at_points, ownership_on_lattice
from heartcase.schemas.arrays import Bool, Float64, Int32, Int64, UInt8

BESIDE = 0.05
"""Cells outside a vertex or a face where the void beside it is looked up."""
BEYOND = 0.25
"""Cells beyond a face to which a way that comes from behind is followed where it ends in tissue."""
DEPTH = 0.1
"""Cells of tissue on the way that count as a wall: the decimated surface itself is off the fields by some of that."""
STEPS = 48
FINE = 4
"""Samples along a cell's edge for what hangs together."""


@dataclass(frozen=True)
class Sides:
    """Flags per vertex, shape (vertex_count,)."""

    inner: Bool
    """Tied to a face between tissue cells, which is on no side: it looks into no void."""
    other_void: Bool
    """The void beside the vertex is not the one that the face looks into, and the way between is not open."""
    across_wall: Bool
    """The way from the void beside the vertex to the reference point leads through tissue into void again."""
    across_gap: Bool
    """The tissue behind the vertex and the tissue of the face's cell do not hang together around the two."""

    @property
    def wrong(self) -> Bool:
        """On the wrong side in any way."""
        return self.other_void | self.across_wall | self.across_gap


def sides(structures: Structures, surface: Surface, grid: SimulationGrid, mapped: GridMap) -> Sides:
    """Look at the fields beside each vertex, beside its face, and on the way between."""
    reader = FieldReader.of(structures)
    cell_mm = grid.geometry.spacing_mm[0]
    positions = grid.node_positions_mm()
    face, is_inner = _faces_of(grid, mapped)
    centre = positions[grid.faces[face]].mean(axis=1)
    out = centre - grid.geometry.index_to_world(grid.cells[grid.face_cell[face]])
    out /= np.linalg.norm(out, axis=1, keepdims=True)
    vertices, normals = surface.vertices_mm.astype(float), surface.normals.astype(float)
    beside = vertices + BESIDE * cell_mm * normals
    reference = np.einsum("vc,vcx->vx", mapped.weights.astype(float), positions[mapped.triangle_nodes])
    from_behind = ((reference - beside) * out).sum(axis=1) > 0.0
    goes_on = from_behind & (_look(reader, reference)[0] < 0.0)
    end = reference + np.where(goes_on, BEYOND * cell_mm, 0.0)[:, None] * out
    parts = (np.arange(STEPS) + 0.5) / STEPS
    way = beside[:, None] + (end - beside)[:, None] * parts[None, :, None]
    field = _look(reader, way.reshape(-1, 3))[0].reshape(-1, STEPS) / cell_mm
    wall, void = field < -DEPTH, field >= 0.0
    before = np.maximum.accumulate(void, axis=1)
    after = np.maximum.accumulate(void[:, ::-1], axis=1)[:, ::-1]
    out_of_face = centre + BESIDE * cell_mm * out
    there = _look(reader, out_of_face)[1]
    asked = ~is_inner & ~_borders_on(reader, surface, beside, BESIDE * cell_mm, there)
    tissue = ownership_on_lattice(reader, grid.geometry.refined(FINE)).tissue_mm < 0.0
    behind = vertices - BESIDE * cell_mm * normals
    inside_cell = grid.geometry.index_to_world(grid.cells[grid.face_cell[face]])
    return Sides(
        inner=is_inner,
        other_void=_apart(grid, ~tissue, 6, beside, out_of_face, asked),
        across_wall=~is_inner & (wall & before & after).any(axis=1),
        across_gap=_apart(grid, tissue, 26, behind, inside_cell, ~is_inner),
    )


def _look(reader: FieldReader, points: Float64) -> tuple[Float64, UInt8]:
    """Distance to tissue, mm, and the void there; beyond the scanned volume all is void and outside."""
    owner = ownership_at_points(reader, points)
    geometry = reader.structures.geometry
    index = geometry.world_to_index(points)
    beyond = (np.maximum(-0.5 - index, index - np.array(geometry.size) + 0.5) * geometry.spacing_mm).max(axis=1)
    is_out = beyond > 0.0
    return np.where(is_out, beyond, owner.tissue_mm), np.where(is_out, 0, owner.void_label).astype(np.uint8)


def _borders_on(reader: FieldReader, surface: Surface, beside: Float64, out_mm: float, label: UInt8) -> Bool:
    """Whether a void is beside each vertex: along its normal, or before one of the triangles around it."""
    corners = surface.vertices_mm.astype(float)[surface.triangles]
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normal /= np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-30)
    borders = _look(reader, beside)[1] == label
    for c in range(3):
        near = 0.75 * corners[:, c] + 0.25 * corners.mean(axis=1) + out_mm * normal
        vertex = surface.triangles[:, c]
        borders[vertex[_look(reader, near)[1] == label[vertex]]] = True
    return borders


def _faces_of(grid: SimulationGrid, mapped: GridMap) -> tuple[Int64, Bool]:
    """Boundary face of each vertex, 0 and True where it follows none."""
    number = {tuple(three): n // 2 for n, three in enumerate(np.sort(split_faces(grid.faces), axis=1).tolist())}
    face = np.array([number.get(tuple(three), -1) for three in np.sort(mapped.triangle_nodes, axis=1).tolist()])
    return np.maximum(face, 0), face < 0


def _apart(grid: SimulationGrid, mask: Bool, neighbours: int, points: Float64, others: Float64, asked: Bool) -> Bool:
    """Where a mask near a point and in the cell of another one does not hang together around both.

    That is: within the cells of both, and one more to every side. Where the mask is not near, nothing is said.
    """
    structure = np.ones((3, 3, 3)) if neighbours == 26 else ndimage.generate_binary_structure(3, 1)
    shape = np.array(grid.geometry.shape)
    place = (grid.geometry.world_to_index(points) + 0.5)[:, ::-1]
    sample = np.clip(np.floor(place * FINE).astype(int), 0, FINE * shape - 1)
    goal = np.floor((grid.geometry.world_to_index(others) + 0.5)[:, ::-1]).astype(int)
    pairs, which = np.unique(np.stack((sample // FINE, np.clip(goal, 0, shape - 1)), 1), axis=0, return_inverse=True)
    apart = np.zeros(len(points), np.bool_)
    order = np.argsort(which.ravel(), kind="stable")
    ends = np.searchsorted(which.ravel()[order], np.arange(len(pairs) + 1))
    for n, (own, other) in enumerate(pairs):
        who = order[ends[n] : ends[n + 1]]
        who = who[asked[who]]
        if len(who) == 0 or (own == other).all():
            continue
        low = np.maximum((np.minimum(own, other) - 1) * FINE, 0)
        high = (np.maximum(own, other) + 2) * FINE
        labels = ndimage.label(mask[tuple(slice(a, b) for a, b in zip(low, high, strict=True))], structure)[0]
        theirs = _labels_in(labels, other * FINE - low, 1, FINE + 1)
        for v in who:
            mine = _labels_in(labels, sample[v] - low, 1, 2)
            apart[v] = bool(theirs) and bool(mine) and not mine & theirs
    return apart


def _labels_in(labels: Int32, at: Int64, before: int, after: int) -> set[int]:
    """Labels of pieces in a box around or from a sample on."""
    box = labels[tuple(slice(max(a - before, 0), a + after) for a in at)]
    return set(np.unique(box).tolist()) - {0}
