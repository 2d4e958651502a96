"""The visible surface of a cut lattice: split along the sheets, tied to it, with all that the kernels need to move it.

All follows from the uncut surface and the list of sheets: taking the last one back gives the same bytes.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from heartcase.schemas.arrays import Bool, Float32, Float64, Int32, Int64
from heartcase.simulator.cutting.blade_sheet import Sheet
from heartcase.simulator.cutting.parted_lattice import PartedLattice
from heartcase.simulator.mesh_arrangement.arrange import NOTHING_CROSSES, Crossings, crossings
from heartcase.simulator.surface.deform import SurfaceModel
from heartcase.simulator.surface_splitting.cuttable_surface import CuttableSurface
from heartcase.simulator.surface_splitting.facing_kernels import corner_angles, sum_directions
from heartcase.simulator.surface_splitting.hanging import hung_surface
from heartcase.simulator.surface_splitting.lips_and_walls import SplitMesh, split_mesh
from heartcase.simulator.surface_splitting.surface_binding import Seen, tie_split

__all__ = ["SplitSurface", "split_surface"]

_ONE_PLACE = 1e-6
"""Vertices that are nearer to one another are in one place [cells]."""


@dataclass(frozen=True)
class SplitWork:
    """What was found when a surface was split."""

    cuttable: CuttableSurface | None
    """The uncut surface."""
    sheets: tuple[Sheet, ...]
    """What it was split along."""
    crossings: Crossings
    seen: Seen | None
    other: Int64
    """Vertices of the uncut surface that follow their nodes otherwise than there."""

    def is_begun(self, cuttable: CuttableSurface, sheets: tuple[Sheet, ...]) -> bool:
        """Whether a split along some sheets goes on from this one."""
        is_of_same = self.cuttable is cuttable and len(self.sheets) <= len(sheets)
        return is_of_same and all(one is other for one, other in zip(self.sheets, sheets, strict=False))


_NO_WORK = SplitWork(None, (), NOTHING_CROSSES, None, np.zeros(0, np.int64))


@dataclass(frozen=True)
class SplitSurface:
    """A surface that was split. Vertices of the uncut surface keep their numbers; new ones follow.

    At a lip the surface and the cut face each have a vertex, which move as one, so that the edge between them is sharp.
    """

    surface: SurfaceModel
    """It, over the cut lattice."""
    weld: Int32
    """Lowest vertex that is one with each, shape (vertex_count,): the surface is closed and manifold over these."""
    triangle_origin: Int32
    """Triangle of the uncut surface that each is a part of, or -1 for cut faces, shape (triangle_count,)."""
    triangle_sheet: Int32
    """Sheet that made each cut face, or -1, shape (triangle_count,)."""
    triangle_part: Int32
    """Number of what each triangle hangs together with, shape (triangle_count,)."""
    vertex_cells: Int32
    """Cell of the cut lattice whose corners a vertex is tied to, where it is new or follows other nodes than before;
    else -1, shape (vertex_count,)."""
    on_triangle: Int32
    """Triangle of the uncut surface on which each new vertex of a lip lies, else -1, shape (vertex_count,)."""
    on_weights: Float32
    """Barycentric place there, shape (vertex_count, 3)."""
    uv_mm: Float32
    """Texture coordinates of cut faces: places on the sheet laid out flat, mm; else 0, shape (vertex_count, 2)."""

    work: SplitWork | None = field(default=None, repr=False, compare=False)
    """What was found for it, from which a split with more sheets goes on."""

    @property
    def triangle_is_cut_face(self) -> Bool:
        """Whether a triangle is a new wall, shape (triangle_count,)."""
        return self.triangle_origin < 0

    def carried(self, values: Any, cut_face: Any) -> Any:
        """What the triangles of the uncut surface have, such as label, kind or colour, for those of this one.

        Parameters
        ----------
        values
            One for each triangle of the uncut surface, shape (uncut_triangle_count, ...).
        cut_face
            That of cut faces.
        """
        values = np.asarray(values)
        found = values[self.triangle_origin]
        found[self.triangle_is_cut_face] = np.asarray(cut_face).astype(values.dtype)
        return found


def split_surface(
    cuttable: CuttableSurface, parted: PartedLattice, sheets: Sequence[Sheet], before: SplitSurface | None = None
) -> SplitSurface:
    """Split a surface along sheets and tie it to the lattice that they cut.

    Parameters
    ----------
    cuttable
        The uncut surface.
    parted
        The cut lattice (:func:`heartcase.simulator.cutting.parted_lattice.part` with the same sheets).
    sheets
        What the blade swept, at rest.
    before
        The surface split along the first of these sheets, from which it goes on: the same bytes, and sooner.
    """
    sheets = tuple(sheets)
    work = None if before is None else before.work
    if work is None or not work.is_begun(cuttable, sheets):
        work = _NO_WORK
    crossing = crossings(cuttable.mesh, sheets, work.crossings, len(work.sheets))
    mesh = crossing.mesh
    split = split_mesh(cuttable.mesh, crossing)
    outward, normals = _directions(cuttable, split)
    ties, seen = tie_split(
        cuttable.model,
        parted,
        mesh,
        split,
        cuttable.tied,
        (cuttable.normals, outward),
        work.seen,
    )
    surface, is_other = hung_surface(cuttable, parted, split, ties, normals)
    count, old_count = split.vertex_count, split.old_count
    cells, weld = np.full(count, -1, np.int32), np.arange(count, dtype=np.int32)
    cells[ties.changed] = ties.cells[: len(ties.changed)]
    cells[old_count:] = ties.cells[len(ties.changed) :]
    weld[old_count:] = split.new_weld
    on_triangle, on_weights = np.full(count, -1, np.int32), np.zeros((count, 3), np.float32)
    on_triangle[old_count:], on_weights[old_count:] = split.new_on_triangle, split.new_on_weights
    uv_mm = np.zeros((count, 2), np.float32)
    uv_mm[old_count:] = split.new_flat * cuttable.model.cell_mm
    return SplitSurface(
        surface=surface,
        weld=weld,
        triangle_origin=split.triangle_origin,
        triangle_sheet=split.triangle_sheet,
        triangle_part=split.triangle_part,
        vertex_cells=cells,
        on_triangle=on_triangle,
        on_weights=on_weights,
        uv_mm=uv_mm,
        work=SplitWork(cuttable, sheets, crossing, seen, np.flatnonzero(is_other)),
    )


def _directions(cuttable: CuttableSurface, split: SplitMesh) -> tuple[Float64, Float64]:
    """Direction out of the tissue at each new vertex, and its normal; unit vectors, grid axes."""
    first_row, new_count = len(split.triangles) - len(split.facing), len(split.new_places)
    triangles, shape = split.triangles[first_row:], (len(split.facing), 3)
    sines, cosines, is_short = np.empty(shape), np.empty(shape), np.empty(shape, np.bool_)
    corner_angles(triangles, split.uncut_places, split.new_places, _ONE_PLACE, sines, cosines, is_short)
    # By the angle at the corner: how a side is divided into triangles does not count.
    angles = np.arctan2(sines, cosines)
    angles += 0.3  # a side that is too thin counts, too
    outward, normals = np.empty((new_count, 3)), np.empty((new_count, 3))
    sum_directions(
        triangles,
        split.facing,
        angles,
        is_short,
        split.triangle_origin[first_row:] >= 0,
        split.new_weld,
        (split.new_on_triangle, split.new_on_weights),
        (cuttable.normals, cuttable.mesh.triangles),
        outward,
        normals,
    )
    return outward, normals
