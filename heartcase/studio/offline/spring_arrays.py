"""A case's lattice of springs as arrays for the page's own engine (``page/webgpu``)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from heartcase.schemas.arrays import Float32, Int16, Int32
from heartcase.schemas.errors import SimulationError
from heartcase.simulator.dynamics.step_size import default_step
from heartcase.simulator.lattice.model import DIRECTIONS, LatticeModel

__all__ = ["SpringArrays", "spring_arrays"]


@dataclass(frozen=True)
class SpringArrays:
    """What the page's engine needs, in grid units: cells, the mass of a full cell, k of the stiffest tissue."""

    node_index: Int16
    """Rest position of each node [cells], shape (node_count, 3)."""
    inverse_mass: Float32
    """Inverse mass, zero where a node is fixed, shape (node_count,)."""
    higher: Int32
    """Node at the higher end of the spring from each node along each direction, -1 for none, shape (9, node_count)."""
    weight: Float32
    """Stiffness of that spring [k], zero for none, shape (9, node_count)."""
    cell_corners: Int32
    """Nodes of each cell's corners, shape (cell_count, 8)."""
    guard_scale: Float32
    """Stiffness with which corners of each cell push back [k/h], shape (cell_count,)."""
    facts: dict[str, float]
    """Step, unit of time and damping in s and 1/s, shear modulus [k/h], corner floor [cells], cell edge in mm,
    unit of force in N."""


def spring_arrays(model: LatticeModel, *, damping_per_s: float, step_s: float | None = None) -> SpringArrays:
    """The arrays of a lattice that is neither cut nor sewn.

    Parameters
    ----------
    model
        The lattice, with springs at a ratio of 1/4.
    damping_per_s
        c in a = f/m - c v, 1/s.
    step_s
        Time step, s; the default step where left out.

    Raises
    ------
    SimulationError
        The law is not that of springs alone, or something else than the lattice's springs acts.
    """
    law = model.law
    if law.is_element or law.has_volume_term:
        raise SimulationError("the page steps springs at a ratio of 1/4 only: load the case with that law", place="law")
    if model.explicit.count or model.loose_count or not model.cell_is_whole.all():
        raise SimulationError("the page steps whole tissue only, neither cut nor sewn", place="model")
    lower, higher = model.spring_nodes.T
    others = np.full((len(DIRECTIONS), model.node_count), -1, np.int32)
    weight = np.zeros(others.shape, np.float32)
    others[model.spring_direction, lower] = higher
    weight[model.spring_direction, lower] = model.spring_weight
    guard = model.corner_guard_scale if law.has_corner_guard else np.zeros(model.cell_count, np.float32)
    return SpringArrays(
        node_index=model.node_index.astype(np.int16),
        inverse_mass=model.inverse_mass,
        higher=others,
        weight=weight,
        cell_corners=model.cell_corners,
        guard_scale=guard,
        facts={
            "stepS": default_step(model) if step_s is None else step_s,
            "timeS": model.units.time_s,
            "dampingPerS": damping_per_s,
            "shear": law.shear_modulus,
            "cornerFloor": law.corner_floor,
            "cellMm": model.cell_mm,
            "forceN": model.units.force_n,
        },
    )
