"""Figures of a state that are taken every frame: elastic energy, cells turned inside out."""

from __future__ import annotations

import numpy as np

from heartcase.compiling.kernel import kernel
from heartcase.schemas.arrays import Bool, Float, Int8, Int32
from heartcase.schemas.bundle.lattice import CORNER_OFFSETS
from heartcase.simulator.forces.cell_energies import energies_in_cells
from heartcase.simulator.lattice.model import DIRECTIONS, LatticeModel

__all__ = ["elastic_energy_of", "inverted_cells"]


_LENGTHS = np.linalg.norm(DIRECTIONS, axis=1)
_CORNERS = CORNER_OFFSETS.astype(np.float64)


def elastic_energy_of(model: LatticeModel, displacement: Float) -> float:
    """Energy in springs and cells [grid units], in float64: that of the reference, without the cells that have none."""
    moved = np.asarray(displacement)
    _, stretch = model.explicit.pull(model.node_index, displacement)
    explicit = 0.5 * np.sum(model.explicit.stiffness * stretch**2)
    lattice = _spring_energy(model.spring_nodes, model.spring_direction, model.acting_weight, moved)
    cells = None
    if not model.law.acts_in_cells:
        cells = np.zeros(model.cell_count, dtype=np.bool_)
        if model.law.has_corner_guard:
            _mark_flat(model.cell_corners, moved, model.law.corner_floor, cells)
    return float(lattice + explicit + energies_in_cells(model, moved, cells).sum())


def inverted_cells(model: LatticeModel, displacement: Float) -> Bool:
    """Cells that are turned inside out at one of their corners, shape (cell_count,).

    The volume spanned by the three edges at a corner is one at rest; not above zero means that the corner has been
    pushed through the opposite side.
    """
    inverted = np.zeros(model.cell_count, dtype=np.bool_)
    _mark_flat(model.cell_corners, np.asarray(displacement), 0.0, inverted)
    return inverted


@kernel
def _spring_energy(nodes: Int32, direction: Int8, weight: Float, displacement: Float) -> float:
    total = 0.0
    for spring in range(len(nodes)):
        lower, higher = nodes[spring, 0], nodes[spring, 1]
        squared = 0.0
        for axis in range(3):
            d = DIRECTIONS[direction[spring], axis] + (
                np.float64(displacement[higher, axis]) - np.float64(displacement[lower, axis])
            )
            squared += d * d
        stretch = np.sqrt(squared) - _LENGTHS[direction[spring]]
        total += weight[spring] * stretch * stretch
    return 0.5 * total


@kernel
def _mark_flat(cell_corners: Int32, displacement: Float, volume_most: float, flat: Bool) -> None:
    """Mark the cells that have a corner of at most a volume."""
    edges = np.empty((3, 3))
    # Edges that differ by at most this from rest in each component span a volume of at least (1 - 3 x this)^3.
    spread_most = (1.0 - volume_most ** (1.0 / 3.0)) / 3.0 - 1e-6
    for cell in range(len(cell_corners)):
        spread = 0.0
        for axis in range(3):
            first = displacement[cell_corners[cell, 0], axis]
            least, most = first, first
            for c in range(1, 8):
                moved = displacement[cell_corners[cell, c], axis]
                least, most = min(least, moved), max(most, moved)
            # Not a number is no reason to pass over a cell.
            spread = max(spread, most - least) if most - least <= spread_most else np.inf
        if spread <= spread_most:
            continue
        for c in range(8):
            here = cell_corners[cell, c]
            for number in range(3):
                other = c ^ (1 << number)
                there = cell_corners[cell, other]
                sign = -1.0 if c & (1 << number) else 1.0
                for axis in range(3):
                    rest = _CORNERS[other, axis] - _CORNERS[c, axis]
                    change = np.float64(displacement[there, axis]) - np.float64(displacement[here, axis])
                    edges[number, axis] = sign * (rest + change)
            volume = (
                edges[0, 0] * (edges[1, 1] * edges[2, 2] - edges[1, 2] * edges[2, 1])
                - edges[0, 1] * (edges[1, 0] * edges[2, 2] - edges[1, 2] * edges[2, 0])
                + edges[0, 2] * (edges[1, 0] * edges[2, 1] - edges[1, 1] * edges[2, 0])
            )
            if volume <= volume_most:
                flat[cell] = True
