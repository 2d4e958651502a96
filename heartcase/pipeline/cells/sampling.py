"""The distance fields sampled inside each cell of the simulation grid: coverage, labels, and the void's pieces.

Every cell holds ``factor`` samples along each axis, so that the sample lattice is about as fine as the scan and every
sample belongs to one cell. Arrays of cells are indexed ``[k, j, i]``, arrays of samples ``[z, y, x]``.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numba
import numpy as np

from heartcase.compiling.calls import called, copied
from heartcase.compiling.kernel import kernel, loop_kernel
from heartcase.pipeline.data import Structures
from heartcase.pipeline.fields.reader import FieldReader, ownership_on_lattice
from heartcase.schemas.arrays import Bool, Float32, Float64, UInt8, UInt16
from heartcase.schemas.geometry import Geometry

__all__ = ["CellSamples", "VoidPieces", "cell_lattice", "sample_cells", "sample_factor", "tissue_part", "void_pieces"]


@dataclass(frozen=True)
class CellSamples:
    """The fields at the samples of every cell, and what follows from them per cell."""

    geometry: Geometry
    """Lattice of the cells, right-handed."""
    factor: int
    """Samples along each edge of a cell."""
    tissue_mm: Float32
    """Signed distance to the tissue's border at the samples, mm, negative in tissue."""
    void_label: UInt8
    """Nearest void label at the samples."""
    inside: tuple[Float64, Float64, Float64]
    """Part of each sample that lies in the scanned volume, along z, y and x."""
    coverage: Float32
    """Fraction of each cell that is tissue, shape ``geometry.shape``."""
    cell_label: UInt8
    """Tissue label that fills most of each cell; 0 where there is no tissue."""

    @property
    def cell_mm(self) -> float:
        """Edge of a cell, mm."""
        return self.geometry.spacing_mm[0]

    @property
    def inside_mask(self) -> Bool:
        """Whether a sample lies in the scanned volume."""
        z, y, x = (weights > 0.0 for weights in self.inside)
        mask: Bool = z[:, None, None] & y[None, :, None] & x[None, None, :]
        return mask

    @property
    def tissue(self) -> Bool:
        """Tissue at the samples."""
        mask: Bool = (self.tissue_mm < 0.0) & self.inside_mask
        return mask

    @property
    def void(self) -> Bool:
        """Cavity or background at the samples, inside the scanned volume."""
        mask: Bool = (self.tissue_mm >= 0.0) & self.inside_mask
        return mask


@dataclass(frozen=True)
class VoidPieces:
    """The 6-connected pieces of void within each cell alone."""

    piece: UInt16
    """Number of the piece within its cell at each sample, from 1 in raster order; 0 in tissue and outside."""
    count: UInt16
    """Pieces of each cell."""
    main: UInt16
    """The largest piece of each cell (ties: the first); 0 where there is none."""
    main_label: UInt8
    """Void label that fills most of the largest piece (ties: the lowest)."""


def cell_lattice(volume: Geometry, cell_mm: float) -> Geometry:
    """Lattice of cubic cells that covers a volume, from the volume's lower corner on.

    A left-handed volume is counted backwards along k, so that the cells are right-handed. The last cell of an axis
    may reach beyond the volume.

    Parameters
    ----------
    volume
        The lattice of the fields; its voxels, not its points, fill the volume.
    cell_mm
        Edge of a cell, mm.
    """
    if not volume.is_right_handed:
        volume = volume.flipped(2)
    extent = np.array(volume.spacing_mm) * np.array(volume.size)
    size = np.maximum(np.ceil(extent / cell_mm - 1e-6).astype(int), 1)
    corner = volume.index_to_world((-0.5, -0.5, -0.5))
    return Geometry.of(
        shape=tuple(int(n) for n in size[::-1]),
        origin_mm=corner + volume.direction_matrix @ np.full(3, 0.5 * cell_mm),
        spacing_mm=(cell_mm, cell_mm, cell_mm),
        direction=volume.direction,
    )


def sample_factor(volume: Geometry, cell_mm: float) -> int:
    """Samples per cell edge that are at least as fine as the finest spacing of the scan, and at least two."""
    return max(2, math.ceil(cell_mm / min(volume.spacing_mm) - 1e-6))


def sample_cells(structures: Structures | FieldReader, lattice: Geometry, factor: int) -> CellSamples:
    """Sample the fields inside each cell and measure how much of it is tissue.

    A sample stands for a small cube; the tissue's part of it is taken as linear in the mean of the field over it,
    which is exact for a border along the axes and without bias for any other, curved ones included.

    Parameters
    ----------
    structures
        The fields, or their reader.
    lattice
        Cells, from :func:`cell_lattice`.
    factor
        Samples along each edge of a cell.
    """
    reader = FieldReader.of(structures)
    owner = ownership_on_lattice(reader, lattice.refined(factor))
    inside = _inside(reader.structures.geometry, lattice, factor)
    coverage = np.zeros(lattice.shape, np.float32)
    cell_label = np.zeros(lattice.shape, np.uint8)
    width = lattice.spacing_mm[0] / factor
    _measure(owner.tissue_mm, owner.tissue_label, *inside, factor, width, coverage, cell_label)
    return CellSamples(lattice, factor, owner.tissue_mm, owner.void_label, inside, coverage, cell_label)


def void_pieces(samples: CellSamples) -> VoidPieces:
    """Label the void within each cell: two sides of a thin wall are two pieces of the same cell."""
    shape = samples.geometry.shape
    piece = np.zeros(samples.tissue_mm.shape, np.uint16)
    count = np.zeros(shape, np.uint16)
    main = np.zeros(shape, np.uint16)
    main_label = np.zeros(shape, np.uint8)
    _label_pieces(samples.void, samples.void_label, samples.factor, piece, count, main, main_label)
    return VoidPieces(piece, count, main, main_label)


def _inside(volume: Geometry, lattice: Geometry, factor: int) -> tuple[Float64, Float64, Float64]:
    weights = []
    for axis in (2, 1, 0):
        extent = volume.spacing_mm[axis] * volume.size[axis]
        sample = lattice.spacing_mm[axis] / factor
        lower = np.arange(lattice.size[axis] * factor) * sample
        part = np.clip((extent - lower) / sample, 0.0, 1.0)
        weights.append(np.where(part > 1e-6, part, 0.0))
    return weights[0], weights[1], weights[2]


@copied
def _mean_in_sample(tissue_mm, z, y, x, width):
    """Mean of the field over a sample: its centre's value and 1/24 of the second differences, where it is smooth."""
    value = tissue_mm[z, y, x]
    if abs(value) > width:
        return value
    nz, ny, nx = tissue_mm.shape
    bend = tissue_mm[max(z - 1, 0), y, x] + tissue_mm[min(z + 1, nz - 1), y, x] - 2.0 * value
    bend += tissue_mm[z, max(y - 1, 0), x] + tissue_mm[z, min(y + 1, ny - 1), x] - 2.0 * value
    bend += tissue_mm[z, y, max(x - 1, 0)] + tissue_mm[z, y, min(x + 1, nx - 1)] - 2.0 * value
    # A larger bend is the ridge in the middle of a thin wall, not a curved border.
    return value + bend / 24.0 if abs(bend) < 0.7 * width else value


@kernel
def tissue_part(tissue_mm, z, y, x, width):
    """Part of a sample that is tissue, 0 to 1: linear in the mean of the field over it. ``width`` is its edge, mm."""
    return min(max(0.5 - _mean_in_sample(tissue_mm, z, y, x, width) / width, 0.0), 1.0)


@called
def _measure_layer(tissue_mm, tissue_label, wz, wy, wx, s, width, coverage, cell_label, k):
    """Measure a layer of cells."""
    nj, ni = coverage.shape[1:]
    share = np.zeros(256)
    for j in range(nj):
        for i in range(ni):
            total = 0.0
            for z in range(k * s, k * s + s):
                for y in range(j * s, j * s + s):
                    for x in range(i * s, i * s + s):
                        part = tissue_part(tissue_mm, z, y, x, width) * wz[z] * wy[y] * wx[x]
                        if part > 0.0:
                            total += part
                            share[tissue_label[z, y, x]] += part
            if total > 0.0:
                best = 0
                for label in range(256):
                    if share[label] > share[best]:
                        best = label
                share[:] = 0.0
                cell_label[k, j, i] = best
                coverage[k, j, i] = min(total / (s * s * s), 1.0)


@loop_kernel
def _measure(tissue_mm, tissue_label, wz, wy, wx, s, width, coverage, cell_label):
    for k in numba.prange(len(coverage)):
        _measure_layer(tissue_mm, tissue_label, wz, wy, wx, s, width, coverage, cell_label, k)


@called
def _label_layer(void, void_label, s, piece, count, main, main_label, k):
    """Label the pieces in a layer of cells."""
    nj, ni = count.shape[1:]
    stack = np.empty(s * s * s, np.int64)
    share = np.zeros(256, np.int64)
    for j in range(nj):
        for i in range(ni):
            z0, y0, x0 = k * s, j * s, i * s
            found = 0
            largest = 0
            for start in range(s * s * s):
                z, y, x = z0 + start // (s * s), y0 + start // s % s, x0 + start % s
                if not void[z, y, x] or piece[z, y, x] != 0:
                    continue
                found += 1
                piece[z, y, x] = found
                stack[0] = start
                top = 1
                size = 0
                while top > 0:
                    top -= 1
                    at = stack[top]
                    size += 1
                    for step in range(6):
                        a, b, c = at // (s * s), at // s % s, at % s
                        move = 1 if step % 2 else -1
                        if step < 2:
                            a += move
                        elif step < 4:
                            b += move
                        else:
                            c += move
                        if min(a, b, c) < 0 or max(a, b, c) >= s:
                            continue
                        if void[z0 + a, y0 + b, x0 + c] and piece[z0 + a, y0 + b, x0 + c] == 0:
                            piece[z0 + a, y0 + b, x0 + c] = found
                            stack[top] = (a * s + b) * s + c
                            top += 1
                if size > largest:
                    largest = size
                    main[k, j, i] = found
            count[k, j, i] = found
            if found == 0:
                continue
            share[:] = 0
            for z in range(z0, z0 + s):
                for y in range(y0, y0 + s):
                    for x in range(x0, x0 + s):
                        if piece[z, y, x] == main[k, j, i]:
                            share[void_label[z, y, x]] += 1
            best = 0
            for label in range(256):
                if share[label] > share[best]:
                    best = label
            main_label[k, j, i] = best


@loop_kernel
def _label_pieces(void, void_label, s, piece, count, main, main_label):
    for k in numba.prange(len(count)):
        _label_layer(void, void_label, s, piece, count, main, main_label, k)
