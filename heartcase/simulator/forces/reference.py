"""The forces written as their formulas, in float64: the oracle of every kernel."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from heartcase.schemas.arrays import Float64
from heartcase.simulator.forces.cell_forces import cell_energies, cell_forces
from heartcase.simulator.lattice.model import LatticeModel

__all__ = ["elastic_energy", "elastic_forces", "spring_forces"]


def elastic_forces(model: LatticeModel, displacement: npt.ArrayLike) -> Float64:
    """Forces of springs and cells on every node [grid units], shape (node_count, 3); displacements in cells."""
    return spring_forces(model, displacement) + cell_forces(model, displacement)


def spring_forces(model: LatticeModel, displacement: npt.ArrayLike) -> Float64:
    """Force of all springs on every node (thesis 8.2): w (length - rest) d / length, summed over its springs.

    Parameters
    ----------
    model
        The lattice.
    displacement
        Displacement of the nodes [cells], shape (node_count, 3).

    Returns
    -------
    ndarray
        Forces [grid units of force], float64, shape (node_count, 3). Two nodes on one spot do not push each other:
        there is no direction to push in.
    """
    lower, higher = model.spring_nodes.T
    d, length = _springs(model, displacement)
    tension = model.acting_weight * (length - model.spring_length)
    pull = np.divide(tension, length, out=np.zeros_like(length), where=length > 0)[:, None] * d
    force = np.zeros((model.node_count, 3))
    for axis in range(3):
        force[:, axis] += np.bincount(lower, pull[:, axis], minlength=model.node_count)
        force[:, axis] -= np.bincount(higher, pull[:, axis], minlength=model.node_count)
    if model.explicit.count:
        force += model.explicit.forces(model.node_index, displacement)
    return force


def elastic_energy(model: LatticeModel, displacement: npt.ArrayLike) -> float:
    """Energy in springs, half the sum of w (length - rest)^2, and cells [grid units of energy]."""
    _, length = _springs(model, displacement)
    _, stretch = model.explicit.pull(model.node_index, displacement)
    explicit = 0.5 * np.sum(model.explicit.stiffness * stretch**2)
    springs = 0.5 * np.sum(model.acting_weight * (length - model.spring_length) ** 2)
    return float(springs + explicit + cell_energies(model, displacement).sum())


def _springs(model: LatticeModel, displacement: npt.ArrayLike) -> tuple[Float64, Float64]:
    u = np.asarray(displacement, dtype=np.float64)
    lower, higher = model.spring_nodes.T
    d = model.spring_offset + (u[higher] - u[lower])
    return d, np.sqrt((d * d).sum(axis=1))
