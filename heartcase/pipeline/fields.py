"""Reading the structures' distance fields between voxels: who owns a point, and how far the tissue's border is.

The tissue field of a point is half the difference between the lowest tissue field and the lowest void field there.
Where a tissue meets a cavity the two are each other's negative, so it is the signed distance to their common face; in
the gaps that three smooth fields leave where three structures meet, it still has exactly one zero crossing.
"""

from __future__ import annotations

from dataclasses import dataclass

import numba
import numpy as np
import numpy.typing as npt

from heartcase.pipeline.data import Structures
from heartcase.schemas.geometry import Geometry

__all__ = ["Ownership", "ownership_at_points", "ownership_on_lattice"]

Float32 = npt.NDArray[np.float32]
Float64 = npt.NDArray[np.float64]
UInt8 = npt.NDArray[np.uint8]


@dataclass(frozen=True)
class Ownership:
    """The tissue field and the nearest structures, on a lattice or at points."""

    tissue_mm: Float32
    """Signed distance to the tissue's border, mm, negative in tissue."""
    void_label: UInt8
    """Label of the void (cavity or background) whose field is lowest."""
    tissue_label: UInt8
    """Label of the tissue whose field is lowest."""


def ownership_on_lattice(structures: Structures, lattice: Geometry) -> Ownership:
    """Evaluate the fields at every point of a lattice parallel to the structures' own.

    Parameters
    ----------
    structures
        The fields.
    lattice
        Points to evaluate at; any spacing and origin, axes parallel to the fields'. Points outside take the value
        of the nearest point of the fields' lattice.

    Returns
    -------
    Ownership
        Arrays of shape ``lattice.shape``.
    """
    start = structures.geometry.world_to_index(lattice.index_to_world((0.0, 0.0, 0.0)))
    steps = np.linalg.inv(structures.geometry.index_to_world_matrix) @ lattice.index_to_world_matrix
    step = np.diag(steps).copy()
    if not np.allclose(steps, np.diag(step), atol=1e-6 * np.abs(step).max()):
        raise ValueError("the lattice must be parallel to the fields' own")
    stack, values, tissue_count = _stack(structures)
    tissue = np.empty(lattice.shape, np.float32)
    void_label = np.empty(lattice.shape, np.uint8)
    tissue_label = np.empty(lattice.shape, np.uint8)
    _evaluate_lattice(stack, values, tissue_count, start, step, tissue, void_label, tissue_label)
    return Ownership(tissue, void_label, tissue_label)


def ownership_at_points(structures: Structures, points_mm: npt.ArrayLike) -> Ownership:
    """Evaluate the fields at world points, shape (n, 3) in mm; arrays of shape (n,)."""
    index = np.ascontiguousarray(structures.geometry.world_to_index(points_mm)).reshape(-1, 3)
    stack, values, tissue_count = _stack(structures)
    tissue = np.empty(len(index), np.float32)
    void_label = np.empty(len(index), np.uint8)
    tissue_label = np.empty(len(index), np.uint8)
    _evaluate_points(stack, values, tissue_count, index, tissue, void_label, tissue_label)
    return Ownership(tissue, void_label, tissue_label)


def _stack(structures: Structures) -> tuple[Float32, UInt8, int]:
    """All fields as one array (structure, z, y, x): tissues first, each group by ascending value."""
    present = structures.distance_mm
    tissues = [value for value in structures.table.tissue_values if value in present]
    voids = [value for value in structures.table.void_values if value in present]
    if not voids:
        raise ValueError("the structures hold no background field")
    stack = np.stack([present[value] for value in (*tissues, *voids)])
    return stack, np.array(tissues + voids, np.uint8), len(tissues)


@numba.njit(cache=True, nogil=True)
def _evaluate_one(stack, values, tissue_count, x, y, z):  # type: ignore[no-untyped-def]
    count, nz, ny, nx = stack.shape
    x = min(max(x, 0.0), nx - 1.0)
    y = min(max(y, 0.0), ny - 1.0)
    z = min(max(z, 0.0), nz - 1.0)
    i = min(int(x), max(nx - 2, 0))
    j = min(int(y), max(ny - 2, 0))
    k = min(int(z), max(nz - 2, 0))
    i1 = min(i + 1, nx - 1)
    j1 = min(j + 1, ny - 1)
    k1 = min(k + 1, nz - 1)
    fx = x - i
    fy = y - j
    fz = z - k
    lowest_tissue = np.inf
    lowest_void = np.inf
    tissue = np.uint8(0)
    void = np.uint8(0)
    for s in range(count):
        f = stack[s]
        c00 = f[k, j, i] * (1.0 - fx) + f[k, j, i1] * fx
        c01 = f[k, j1, i] * (1.0 - fx) + f[k, j1, i1] * fx
        c10 = f[k1, j, i] * (1.0 - fx) + f[k1, j, i1] * fx
        c11 = f[k1, j1, i] * (1.0 - fx) + f[k1, j1, i1] * fx
        value = (c00 * (1.0 - fy) + c01 * fy) * (1.0 - fz) + (c10 * (1.0 - fy) + c11 * fy) * fz
        if s < tissue_count:
            if value < lowest_tissue:
                lowest_tissue = value
                tissue = values[s]
        elif value < lowest_void:
            lowest_void = value
            void = values[s]
    if tissue_count == 0:
        return np.float32(abs(lowest_void)), void, tissue
    return np.float32(0.5 * (lowest_tissue - lowest_void)), void, tissue


@numba.njit(cache=True, nogil=True, parallel=True)
def _evaluate_lattice(stack, values, tissue_count, start, step, tissue, void_label, tissue_label):  # type: ignore[no-untyped-def]
    nz, ny, nx = tissue.shape
    for k in numba.prange(nz):
        for j in range(ny):
            for i in range(nx):
                one = _evaluate_one(
                    stack, values, tissue_count, start[0] + i * step[0], start[1] + j * step[1], start[2] + k * step[2]
                )
                tissue[k, j, i] = one[0]
                void_label[k, j, i] = one[1]
                tissue_label[k, j, i] = one[2]


@numba.njit(cache=True, nogil=True, parallel=True)
def _evaluate_points(stack, values, tissue_count, index, tissue, void_label, tissue_label):  # type: ignore[no-untyped-def]
    for p in numba.prange(len(index)):
        one = _evaluate_one(stack, values, tissue_count, index[p, 0], index[p, 1], index[p, 2])
        tissue[p] = one[0]
        void_label[p] = one[1]
        tissue_label[p] = one[2]
