"""What is asked of numbers and of surfaces that a simulation is given."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

from heartcase.schemas.errors import Problem, SimulationError
from heartcase.simulator.cutting.tissue_samples import TissueSamples
from heartcase.simulator.instruments.placing import is_point
from heartcase.simulator.lattice.model import LatticeModel
from heartcase.simulator.surface.deform import PickingModel, SurfaceModel

__all__ = ["check_fit", "checked_gravity"]

GRAVITY_MOST = 1e4
"""A thousand times that of the earth, m/s2."""


def checked_gravity(gravity_m_s2: npt.ArrayLike) -> tuple[float, float, float]:
    """An acceleration, LPS axes, m/s2.

    Raises
    ------
    SimulationError
        It is not three numbers of up to 10,000.
    """
    if not is_point(gravity_m_s2) or np.abs(np.asarray(gravity_m_s2, dtype=float)).max() > GRAVITY_MOST:
        raise SimulationError(
            f"gravity is three numbers along LPS, m/s2, of up to {GRAVITY_MOST:g}, such as (0, 0, -9.81)",
            place="gravity_m_s2",
        )
    x, y, z = np.asarray(gravity_m_s2, dtype=float).tolist()
    return x, y, z


def check_fit(model: LatticeModel, surface: Any, picking: Any, tissue: Any) -> None:
    """Refuse surfaces and samples that are not of a lattice: kernels would read beside its nodes.

    Raises
    ------
    SimulationError
        One is of another kind than its name says, or its nodes lie elsewhere in this lattice.
    """
    problems = []
    kinds = (("surface", surface, SurfaceModel), ("picking", picking, PickingModel), ("tissue", tissue, TissueSamples))
    for name, given, kind in kinds:
        if given is not None and not isinstance(given, kind):
            problems.append(Problem(name, f"this is a {type(given).__name__}: give the {name} of load_case"))
    if not problems:
        if surface is not None and not _hangs_on(model, surface):
            problems.append(Problem("surface", _of_another(model)))
        if picking is not None and not _lies_on(model, picking):
            problems.append(Problem("picking", _of_another(model)))
    if problems:
        raise SimulationError(problems)


def _of_another(model: LatticeModel) -> str:
    return f"this is of another lattice than the given one of {model.node_count:,} nodes: load both from one case"


def _hangs_on(model: LatticeModel, surface: SurfaceModel) -> bool:
    """Whether the triangles that vertices hang on have the edges that they have in a lattice."""
    nodes = surface.triangle_nodes
    if nodes.size and not (nodes.min() >= 0 and nodes.max() < model.node_count):
        return False
    corners = model.node_index[nodes]
    return bool((np.abs(corners[:, 1:] - corners[:, :1] - surface.edges) < 1e-3).all())


def _lies_on(model: LatticeModel, picking: PickingModel) -> bool:
    """Whether the vertices lie at rest where their nodes do."""
    nodes = picking.nodes
    if nodes.size and not (nodes.min() >= 0 and nodes.max() < model.node_count):
        return False
    away = model.rest_positions_mm()[nodes] - picking.rest_mm
    return bool((np.abs(away) < 1e-2 * model.cell_mm).all())
