"""How far tissue is stretched and what stress that takes: per cell, at its worst place, as colours of a surface."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from heartcase.schemas.arrays import Bool, Float64, Int32, UInt8
from heartcase.schemas.errors import SimulationError
from heartcase.simulator.forces.cell_forces import cell_gradients, stretching, volume_stress
from heartcase.simulator.lattice.model import CELL_SPRINGS, DIRECTIONS, LatticeModel
from heartcase.simulator.lattice.moduli import ForceLaw

__all__ = ["Peak", "Strain", "cell_strain", "peak", "values_at_nodes", "values_at_vertices", "vertex_colours"]

_COLOURS = np.array(
    [[48, 64, 160], [60, 130, 200], [110, 190, 190], [200, 220, 150], [250, 220, 90], [245, 150, 50], [190, 30, 40]]
)
"""From little to much: dark blue over pale green and yellow to dark red."""


@dataclass(frozen=True)
class Strain:
    """Stretch and stress of each cell."""

    stretches: Float64
    """Principal stretches, the largest first [1], shape (cell_count, 3); the last is below 0 in a cell inside out."""
    stress_kpa: Float64
    """Principal Cauchy stresses, the largest first, kPa, shape (cell_count, 3): the tissue's, not the mean over a
    cell that it fills in part."""
    is_known: Bool
    """Whether the cell is whole: of one whose springs were cut nothing is said, shape (cell_count,)."""


@dataclass(frozen=True)
class Peak:
    """The largest of some values, and where."""

    value: float
    """The value."""
    cell: int
    """Number of the cell."""
    place_mm: Float64
    """Middle of the cell now, LPS mm, shape (3,)."""
    high: float
    """What 99% of the tissue, by volume, stay below: a peak beside an instrument is a matter of the grid."""


def cell_strain(model: LatticeModel, displacement: npt.ArrayLike) -> Strain:
    """Stretch and stress of all cells, by their mean deformation gradients and the model's law.

    Elements that share strain are looked at by their own deformation.

    Parameters
    ----------
    model
        The lattice.
    displacement
        Displacement of the nodes [cells], shape (node_count, 3).
    """
    F = cell_gradients(model, np.asarray(displacement, dtype=float)[model.cell_corners])
    values: Float64 = np.linalg.svd(F, compute_uv=False).astype(np.float64)
    J = np.linalg.det(F)
    values[:, 2] *= np.where(J < 0.0, -1.0, 1.0)
    P = _first_stress(model.law, F)
    with np.errstate(divide="ignore", invalid="ignore"):
        cauchy = np.einsum("nik,njk->nij", P, F) / J[:, None, None]
    # A cell that is flat has no stress that means anything.
    cauchy[~np.isfinite(cauchy).all(axis=(1, 2))] = 0.0
    principal = np.linalg.eigvalsh((cauchy + np.swapaxes(cauchy, 1, 2)) / 2)[:, ::-1]
    unit_kpa = model.units.force_n / model.units.length_m**2 * 1e-3
    stress = principal * (model.cell_stiffness.astype(float) * unit_kpa)[:, None]
    return Strain(values, stress, model.cell_is_whole.copy())


def peak(model: LatticeModel, displacement: npt.ArrayLike, values: Float64, is_known: Bool) -> Peak:
    """The largest value of the cells, and where it is.

    Parameters
    ----------
    model
        The lattice.
    displacement
        Displacement of the nodes [cells], shape (node_count, 3).
    values
        One for each cell, shape (cell_count,).
    is_known
        Which cells count, shape (cell_count,).

    Raises
    ------
    SimulationError
        None counts.
    """
    counted = np.flatnonzero(is_known)
    if not len(counted):
        raise SimulationError("no cell counts: give at least one", place="is_known")
    cell = int(counted[np.argmax(values[counted])])
    corners = model.cell_corners[cell]
    middle = (model.node_index[corners] + np.asarray(displacement, dtype=float)[corners]).mean(axis=0)
    order = counted[np.argsort(values[counted], kind="stable")]
    filled = np.cumsum(model.cell_coverage[order].astype(float))
    high = values[order[int(np.searchsorted(filled, 0.99 * filled[-1]))]]
    return Peak(float(values[cell]), cell, model.geometry.index_to_world(middle - 0.5), float(high))


def values_at_nodes(model: LatticeModel, values: Float64, is_known: Bool) -> Float64:
    """Means around the nodes of what cells have, by the tissue in them, shape (node_count,); 0 where none is known.

    Parameters
    ----------
    model
        The lattice.
    values
        One for each cell, shape (cell_count,).
    is_known
        Which cells count, shape (cell_count,).
    """
    weight = np.where(is_known, model.cell_coverage, 0.0).astype(float)
    corners, node_count = model.cell_corners.ravel(), model.node_count
    total = np.bincount(corners, np.repeat(weight, 8), minlength=node_count)
    summed = np.bincount(corners, np.repeat(weight * np.where(is_known, values, 0.0), 8), minlength=node_count)
    return np.divide(summed, total, out=np.zeros(node_count), where=total > 0.0)


def values_at_vertices(triangle_nodes: Int32, weights: npt.ArrayLike, at_nodes: Float64) -> Float64:
    """What the vertices of a surface have of what nodes have, shape (vertex_count,).

    Parameters
    ----------
    triangle_nodes
        Nodes that each vertex hangs on, shape (vertex_count, 3).
    weights
        Their weights, shape (vertex_count, 3).
    at_nodes
        Value of each node, shape (node_count,).
    """
    mean: Float64 = np.einsum("vi,vi->v", np.asarray(weights, dtype=float), at_nodes[triangle_nodes])
    return mean


def vertex_colours(values: Float64, lowest: float, highest: float) -> UInt8:
    """Colours of values, from dark blue over yellow to dark red, shape (count, 3).

    Parameters
    ----------
    values
        Values, shape (count,).
    lowest, highest
        Values of the first and the last colour; what lies beyond has these.

    Raises
    ------
    SimulationError
        The highest is not above the lowest.
    """
    if not lowest < highest:
        raise SimulationError("the highest value must be above the lowest", place="highest")
    place = np.clip((values - lowest) / (highest - lowest), 0.0, 1.0) * (len(_COLOURS) - 1)
    channels = [np.interp(place, np.arange(len(_COLOURS)), _COLOURS[:, channel]) for channel in range(3)]
    colours: UInt8 = np.rint(np.stack(channels, axis=1)).astype(np.uint8)
    return colours


def _first_stress(law: ForceLaw, F: Float64) -> Float64:
    """First Piola-Kirchhoff stress per covered stiffness [k/h], shape (count, 3, 3)."""
    if law.is_element:
        return stretching(law, F)[1]
    P = np.zeros_like(F)
    _, shares, direction = CELL_SPRINGS
    for share, rest in zip(shares, DIRECTIONS[direction].astype(float), strict=True):
        d = F @ rest
        length = np.linalg.norm(d, axis=1)
        tension = np.divide(length - np.linalg.norm(rest), length, out=np.zeros_like(length), where=length > 0.0)
        P += (law.shear_modulus * share * tension)[:, None, None] * d[:, :, None] * rest
    return P + volume_stress(law, F) if law.has_volume_term else P
