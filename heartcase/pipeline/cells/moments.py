"""First and second moments of the tissue in each cell, from the samples that give the coverage."""

from __future__ import annotations

import math

import numpy as np

from heartcase.compiling.calls import copied
from heartcase.compiling.kernel import kernel
from heartcase.pipeline.cells.sampling import CellSamples, tissue_part
from heartcase.schemas.arrays import Float32, Int32
from heartcase.schemas.bundle.lattice import FULL_MOMENTS

__all__ = ["cell_moments"]


def cell_moments(samples: CellSamples, cells: Int32) -> Float32:
    """Means of x, y, z, xx, yy, zz, yz, xz, xy over the tissue of cells.

    Each sample counts by its part that is tissue, so all of them together are the coverage. A sample that the border
    cuts is cut by a plane: its tissue is a slab at the side where the field falls, as thick as the part.

    Parameters
    ----------
    samples
        The fields in the cells.
    cells
        Index (i, j, k) of each cell, int32, shape (cell_count, 3).

    Returns
    -------
    numpy.ndarray
        From the cell's centre along the grid's axes [edges], float32, shape (cell_count, 9). Those of a full cell
        where the samples hold no tissue: cells that a repair added.
    """
    moments = np.tile(FULL_MOMENTS, (len(cells), 1))
    width = samples.cell_mm / samples.factor
    _add_up(samples.tissue_mm, *samples.inside, samples.factor, width, np.ascontiguousarray(cells), moments)
    return moments


@copied
def _outward(below, value, above):
    """Growth of the field along an axis towards the nearer void, and that less the growth to the other side.

    The two differ only in a layer of tissue that is thinner than a sample: it has void to both sides.
    """
    up, down = max(above - value, 0.0), max(below - value, 0.0)
    return (up if up >= down else -down), up - down


@kernel
def _add_up(tissue_mm, wz, wy, wx, s, width, cells, moments):
    nz, ny, nx = tissue_mm.shape
    place = np.empty(3)
    box = np.empty(3)
    growth = np.empty(3)
    side = np.empty(3)
    first = np.empty(3)
    second = np.empty((3, 3))
    for c in range(len(cells)):
        i, j, k = cells[c]
        total = 0.0
        first[:] = 0.0
        second[:] = 0.0
        for z in range(k * s, k * s + s):
            for y in range(j * s, j * s + s):
                for x in range(i * s, i * s + s):
                    part = tissue_part(tissue_mm, z, y, x, width)
                    weight = part * wz[z] * wy[y] * wx[x]
                    if weight <= 0.0:
                        continue
                    growth[:] = 0.0
                    side[:] = 0.0
                    if part < 1.0:
                        value = tissue_mm[z, y, x]
                        low, high = tissue_mm[z, y, max(x - 1, 0)], tissue_mm[z, y, min(x + 1, nx - 1)]
                        growth[0], side[0] = _outward(low, value, high)
                        low, high = tissue_mm[z, max(y - 1, 0), x], tissue_mm[z, min(y + 1, ny - 1), x]
                        growth[1], side[1] = _outward(low, value, high)
                        low, high = tissue_mm[max(z - 1, 0), y, x], tissue_mm[min(z + 1, nz - 1), y, x]
                        growth[2], side[2] = _outward(low, value, high)
                        length = math.sqrt(growth[0] ** 2 + growth[1] ** 2 + growth[2] ** 2)
                        if length > 0.0:
                            growth /= length
                            side /= length
                    # The last sample of an axis may reach beyond the scanned volume: what is inside is a box.
                    box[0], box[1], box[2] = wx[x], wy[y], wz[z]
                    place[0], place[1], place[2] = x - i * s, y - j * s, z - k * s
                    thinner = (part * part - 1.0) / 12.0
                    shift = 0.5 * (1.0 - part)
                    total += weight
                    for a in range(3):
                        place[a] += 0.5 * box[a] - 0.5 * s - shift * side[a] * box[a]
                        first[a] += weight * place[a]
                    for a in range(3):
                        for b in range(a, 3):
                            spread = thinner * growth[a] * growth[b]
                            if a == b:
                                spread += 1.0 / 12.0
                            second[a, b] += weight * (place[a] * place[b] + spread * box[a] * box[b])
        # A full cell keeps its moments to the last digit.
        if total == 0.0 or total == float(s * s * s):
            continue
        for a in range(3):
            moments[c, a] = first[a] / (total * s)
            moments[c, 3 + a] = second[a, a] / (total * s * s)
        moments[c, 6] = second[1, 2] / (total * s * s)
        moments[c, 7] = second[0, 2] / (total * s * s)
        moments[c, 8] = second[0, 1] / (total * s * s)
