"""Reading the structures between voxels: the label at a point, and the distance to the tissue's border.

The stored fields are interpolated; walls and reshapings are then worked out at the point (see
:class:`~heartcase.pipeline.data.Structures`), so a wall or a patch thinner than a voxel is as thick as it should be.

With T the lowest tissue field and V the lowest void field there, the tissue field is the greater in size of T and -V
where the two agree in sign: the depth below the void in tissue, the distance to tissue in the void. Where they do
not, in the hairline gaps and overlaps that interpolated fields leave where three structures meet, it is T - V, so it
is continuous and its zero level is where tissue and void are equally near.
"""

from __future__ import annotations

from dataclasses import dataclass
from threading import Lock

import numba
import numpy as np
import numpy.typing as npt

from heartcase.compiling.kernel import loop_kernel
from heartcase.compiling.tuple_addresses import lend
from heartcase.pipeline.data import Structures
from heartcase.pipeline.fields.lattice_kernels import evaluate_lattice
from heartcase.pipeline.fields.layout import FieldLayout, layout_of, varying_walls
from heartcase.pipeline.fields.point_kernels import evaluate_owner, scratch
from heartcase.pipeline.fields.wall_thickness import ThicknessArrays
from heartcase.pipeline.kernels.parallel import every_other
from heartcase.schemas.arrays import Float32, Float64, UInt8
from heartcase.schemas.geometry import Geometry

__all__ = [
    "FieldReader",
    "Ownership",
    "forget_layout",
    "ownership_at_points",
    "ownership_on_lattice",
    "steps_through",
]


CHUNK = 4096


@dataclass(frozen=True)
class Ownership:
    """The tissue field and the nearest structures, on a lattice or at points."""

    tissue_mm: Float32
    """Signed distance to the tissue's border, mm, negative in tissue."""
    void_label: UInt8
    """Label of the void (cavity or background) whose field is lowest."""
    tissue_label: UInt8
    """Label of the tissue whose field is lowest."""


@dataclass(frozen=True)
class FieldReader:
    """Structures in the order in which kernels read them: make it once where they are read again and again."""

    structures: Structures
    """What is read."""
    layout: FieldLayout
    """For kernels: stored fields, walls and reshapings."""
    tables: ThicknessArrays
    """For kernels: walls that vary."""

    @classmethod
    def of(cls, structures: Structures | FieldReader) -> FieldReader:
        """Reader of some structures; a reader is returned as it is. Structures stay laid out while they exist."""
        if isinstance(structures, FieldReader):
            return structures
        with _LAYING_OUT:
            if _LAID_OUT not in structures.worked_out:
                structures.worked_out[_LAID_OUT] = layout_of(structures), varying_walls(structures)
            layout, tables = structures.worked_out[_LAID_OUT]
        return cls(structures, layout, tables)

    def serves(self, structures: Structures) -> None:
        """Take what is laid out for other structures too: those of the same fields, walls and reshapings."""
        structures.worked_out[_LAID_OUT] = self.layout, self.tables


_LAID_OUT = "layout and tables"
_LAYING_OUT = Lock()


def forget_layout(structures: Structures) -> None:
    """Free what structures are laid out as, which takes as much memory as their fields; a reader lays them out anew."""
    structures.worked_out.pop(_LAID_OUT, None)


def ownership_on_lattice(structures: Structures | FieldReader, lattice: Geometry) -> Ownership:
    """Evaluate the structures at every point of a lattice parallel to their own.

    Parameters
    ----------
    structures
        The structures, or their reader.
    lattice
        Points to evaluate at; any spacing and origin, axes parallel to the fields'. Points outside take the value
        of the nearest point of the fields' lattice.

    Returns
    -------
    Ownership
        Arrays of shape ``lattice.shape``.
    """
    reader = FieldReader.of(structures)
    start, step = steps_through(reader.structures.geometry, lattice)
    tissue = np.empty(lattice.shape, np.float32)
    void_label = np.empty(lattice.shape, np.uint8)
    tissue_label = np.empty(lattice.shape, np.uint8)
    evaluate_lattice(reader.layout, reader.tables, start, step, tissue, void_label, tissue_label)
    return Ownership(tissue, void_label, tissue_label)


def steps_through(geometry: Geometry, lattice: Geometry) -> tuple[Float64, Float64]:
    """Index of a lattice's first point among a geometry's voxels, and the steps to the next along i, j, k.

    Raises
    ------
    ValueError
        They are not parallel.
    """
    start: Float64 = geometry.world_to_index(lattice.index_to_world((0.0, 0.0, 0.0)))
    steps = np.linalg.inv(geometry.index_to_world_matrix) @ lattice.index_to_world_matrix
    step: Float64 = np.diag(steps).copy()
    if not np.allclose(steps, np.diag(step), atol=1e-6 * np.abs(step).max()):
        raise ValueError("the lattice must be parallel to the fields' own")
    return start, step


def ownership_at_points(structures: Structures | FieldReader, points_mm: npt.ArrayLike) -> Ownership:
    """Evaluate structures, or their reader, at world points, shape (n, 3) in mm; arrays of shape (n,)."""
    reader = FieldReader.of(structures)
    index = np.ascontiguousarray(reader.structures.geometry.world_to_index(points_mm)).reshape(-1, 3)
    tissue = np.empty(len(index), np.float32)
    void_label = np.empty(len(index), np.uint8)
    tissue_label = np.empty(len(index), np.uint8)
    _evaluate_points(reader.layout, reader.tables, index, tissue, void_label, tissue_label)
    return Ownership(tissue, void_label, tissue_label)


@loop_kernel
def _evaluate_points(layout, tables, index, tissue, void_label, tissue_label):
    chunks = (len(index) + CHUNK - 1) // CHUNK
    fields, walls = lend(layout), lend(tables)
    for number in numba.prange(chunks):
        chunk = every_other(number, chunks)
        spare = scratch(fields)
        for p in range(chunk * CHUNK, min((chunk + 1) * CHUNK, len(index))):
            one = evaluate_owner(fields, walls, index[p, 0], index[p, 1], index[p, 2], spare)
            tissue[p] = one[0]
            void_label[p] = one[1]
            tissue_label[p] = one[2]
