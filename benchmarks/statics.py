"""Static equilibria of a lattice: stiffness put together cell by cell and spring by spring, and Newton's method.

Everything is in grid units. A degree of freedom is 3 node + axis; held ones keep their displacement exactly, for their
columns are moved to the right-hand side.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import numpy.typing as npt
import scipy.sparse as sp
from scipy.sparse.linalg import SuperLU, splu

from heartcase.schemas.arrays import Float64, Intp
from heartcase.simulator.forces.cell_forces import MODES, mean_gradients, mean_slopes, own_forces_at_corners, stretching
from heartcase.simulator.forces.reference import elastic_forces
from heartcase.simulator.lattice.model import LatticeModel

Held = tuple[Intp, Float64]
"""Degrees of freedom that are led, and their displacement [cells], shape (count,) each."""

_STEP = 1e-5
"""Step of the differences [cells]: with it they are exact to about 1e-10 of the stiffness."""


class NoEquilibriumError(RuntimeError):
    """Newton's method did not get there."""


def stiffness(model: LatticeModel, displacement: npt.ArrayLike | None = None) -> sp.csc_array:
    """Minus the derivative of the forces by the displacements [k], shape (3 node_count, 3 node_count).

    Parameters
    ----------
    model
        The lattice, without explicit springs.
    displacement
        Where to take it [cells], shape (node_count, 3); at rest when left out.
    """
    u = np.zeros((model.node_count, 3)) if displacement is None else np.asarray(displacement, dtype=np.float64)
    size = 3 * model.node_count
    rows, columns, values = zip(_spring_parts(model, u), _cell_parts(model, u), strict=True)
    entries = (np.concatenate(values), (np.concatenate(rows), np.concatenate(columns)))
    own = sp.csc_array(sp.coo_array(entries, shape=(size, size)))
    return own + _shared_part(model, u) if model.shares_strain else own


def factorised(matrix: sp.csc_array) -> SuperLU:
    """Factors of a symmetric matrix."""
    options = {"SymmetricMode": True}
    return splu(sp.csc_matrix(matrix), permc_spec="MMD_AT_PLUS_A", diag_pivot_thresh=0.0, options=options)


def solve_linear(matrix: sp.csc_array, load: npt.ArrayLike, held: Held) -> tuple[Float64, Float64]:
    """Displacement under a load with some degrees of freedom led, and what leads them, shape (n, 3) each.

    The second is the force that holds each node beyond the load, zero at free ones up to rounding.
    """
    f = np.asarray(load, dtype=np.float64).ravel()
    u = np.zeros(len(f))
    u[held[0]] = held[1]
    free = np.setdiff1d(np.arange(len(f)), held[0])
    rest = f - matrix @ u
    u[free] = factorised(matrix[free][:, free]).solve(rest[free])
    return u.reshape(-1, 3), (matrix @ u - f).reshape(-1, 3)


def solve_newton(
    forces: Callable[[Float64], Float64],
    tangent: Callable[[Float64], sp.csc_array],
    load: npt.ArrayLike,
    held_at: Callable[[float], Held],
    step_count: int,
    tolerance: float = 1e-8,
) -> tuple[Float64, Float64]:
    """Displacement in equilibrium at any strain, and what leads the held nodes, shape (n, 3) each.

    Load and led displacements grow together in steps. A step starts from its linear solution; Newton's steps are
    halved until the residual falls.

    Parameters
    ----------
    forces
        Inner forces at a displacement, both of shape (n, 3).
    tangent
        Minus their derivative, shape (3 n, 3 n).
    load
        Force on each node in the end, shape (n, 3); its direction stays.
    held_at
        What is led at a part, 0 to 1, of the way: always the same degrees of freedom.
    step_count
        Load steps.
    tolerance
        Largest residual over the largest inner force at which a step is done.

    Raises
    ------
    NoEquilibriumError
        A step does not converge.
    """
    f = np.asarray(load, dtype=np.float64)
    u = np.zeros(f.shape)
    degrees = held_at(0.0)[0]
    free = np.setdiff1d(np.arange(f.size), degrees)
    before = 0.0
    for part in np.linspace(0.0, 1.0, step_count + 1)[1:]:
        matrix = tangent(u)
        jump = np.zeros(f.size)
        jump[degrees] = held_at(part)[1] - u.ravel()[degrees]
        rest = ((part - before) * f + before * f + forces(u)).ravel() - matrix @ jump
        jump[free] = factorised(matrix[free][:, free]).solve(rest[free])
        u = u + jump.reshape(-1, 3)
        u = _corrected(forces, tangent, part * f, u, free, tolerance)
        before = part
    return u, -(forces(u) + f)


def _corrected(
    forces: Callable[[Float64], Float64],
    tangent: Callable[[Float64], sp.csc_array],
    f: Float64,
    u: Float64,
    free: Intp,
    tolerance: float,
) -> Float64:
    """Newton's steps with held nodes where they are."""
    inner = forces(u)
    for _ in range(40):
        residual = (f + inner).ravel()[free]
        size = float(np.linalg.norm(residual))
        if not np.isfinite(size):
            break
        if np.abs(residual).max() <= tolerance * np.abs(inner).max():
            return u
        step = np.zeros(u.size)
        step[free] = factorised(tangent(u)[free][:, free]).solve(residual)
        step = step.reshape(-1, 3)
        for halving in range(12):
            trial = u + step / 2**halving
            trial_inner = forces(trial)
            if np.linalg.norm((f + trial_inner).ravel()[free]) < (1.0 - 0.1 / 2**halving) * size:
                break
        u, inner = trial, trial_inner
    raise NoEquilibriumError("a load step did not converge: take smaller ones")


def equilibrium(
    model: LatticeModel, load: npt.ArrayLike, held_at: Callable[[float], Held], step_count: int = 0
) -> tuple[Float64, Float64]:
    """Displacement of a lattice [cells] and what leads its held nodes [grid units], shape (node_count, 3) each.

    Small strain without load steps, else any strain.
    """
    if not step_count:
        return solve_linear(stiffness(model), load, held_at(1.0))
    return solve_newton(lambda u: elastic_forces(model, u), lambda u: stiffness(model, u), load, held_at, step_count)


def _spring_parts(model: LatticeModel, u: Float64) -> tuple[Intp, Intp, Float64]:
    """Rows, columns and values of the springs' stiffness: w ((1 - rest/length)(I - n n^T) + n n^T)."""
    acting = np.flatnonzero(model.acting_weight)
    lower, higher = model.spring_nodes[acting].T
    d = model.spring_offset[acting] + u[higher] - u[lower]
    length = np.sqrt((d * d).sum(axis=1))
    slack = 1.0 - model.spring_length[acting] / length
    n = d / length[:, None]
    along = n[:, :, None] * n[:, None, :]
    block = model.acting_weight[acting].astype(float)[:, None, None] * (
        slack[:, None, None] * (np.eye(3) - along) + along
    )
    parts = [_spread(a, b, sign * block) for a, b, sign in _pairs(lower, higher)]
    rows, columns, values = (np.concatenate(part) for part in zip(*parts, strict=True))
    return rows, columns, values


def _pairs(lower: npt.NDArray[Any], higher: npt.NDArray[Any]) -> list[tuple[npt.NDArray[Any], npt.NDArray[Any], float]]:
    return [(lower, lower, 1.0), (higher, higher, 1.0), (lower, higher, -1.0), (higher, lower, -1.0)]


def _spread(a: npt.NDArray[Any], b: npt.NDArray[Any], block: Float64) -> tuple[Intp, Intp, Float64]:
    axes = np.arange(3)
    rows = np.broadcast_to(3 * a[:, None, None] + axes[:, None], block.shape)
    columns = np.broadcast_to(3 * b[:, None, None] + axes, block.shape)
    return rows.ravel(), columns.ravel(), block.ravel()


def _cell_parts(model: LatticeModel, u: Float64) -> tuple[Intp, Intp, Float64]:
    """Rows, columns and values of the cells' stiffness, by central differences of each cell's forces by itself."""
    count = model.cell_count
    here = u[model.cell_corners]
    matrix = np.empty((count, 24, 24))
    for column in range(24):
        ends = []
        for sign in (1.0, -1.0):
            pushed = here.copy()
            pushed[:, column // 3, column % 3] += sign * _STEP
            ends.append(own_forces_at_corners(model, pushed).reshape(count, 24))
        matrix[:, :, column] = (ends[1] - ends[0]) / (2.0 * _STEP)
    degrees = (3 * model.cell_corners[:, :, None] + np.arange(3)).reshape(count, 24)
    rows = np.broadcast_to(degrees[:, :, None], matrix.shape).ravel()
    columns = np.broadcast_to(degrees[:, None, :], matrix.shape).ravel()
    return rows, columns, matrix.ravel()


def _shared_part(model: LatticeModel, u: Float64) -> sp.csc_array:
    """Stiffness of the mean strain around the nodes: the mean's derivative on both sides of the stretching's own."""
    slopes = mean_slopes(model.cell_moments.astype(np.float64))
    # Derivative of a cell's F by its corners' displacements along one axis: gradient (3) by corner (8).
    each = np.einsum("mc,mk->ck", MODES[:3], np.eye(3)) + np.einsum("ac,nak->nck", MODES[3:], slopes)
    shared = model.shared_stiffness.astype(np.float64)
    mean, stiffness = mean_gradients(model, u[model.cell_corners])
    parts = shared / np.maximum(stiffness[model.cell_corners], np.finfo(float).tiny)
    shape = (model.cell_count, 8, 3, 8, 3)  # cell, corner with the mean, axis of F, corner that moves, gradient
    values = np.broadcast_to((parts[:, :, None, None, None] * each[:, None, None, :, :]), shape)
    axis = np.arange(3)[:, None, None]
    rows = 9 * model.cell_corners[:, :, None, None, None] + 3 * axis + np.arange(3)
    columns = 3 * model.cell_corners[:, None, None, :, None] + axis
    places = (np.broadcast_to(rows, shape).ravel(), np.broadcast_to(columns, shape).ravel())
    derivative = sp.csr_array((values.ravel(), places), shape=(9 * model.node_count, 3 * model.node_count))
    blocks = np.empty((model.node_count, 9, 9))
    for column in range(9):
        step = np.zeros(9)
        step[column] = _STEP
        ends = [stretching(model.law, mean + sign * step.reshape(3, 3))[1] for sign in (1.0, -1.0)]
        blocks[:, :, column] = (ends[0] - ends[1]).reshape(-1, 9) / (2.0 * _STEP)
    blocks *= stiffness[:, None, None]
    block_rows = 9 * np.arange(model.node_count)[:, None, None] + np.arange(9)[:, None]
    block_columns = 9 * np.arange(model.node_count)[:, None, None] + np.arange(9)
    where = (np.broadcast_to(block_rows, blocks.shape).ravel(), np.broadcast_to(block_columns, blocks.shape).ravel())
    middle = sp.csr_array((blocks.ravel(), where), shape=(9 * model.node_count,) * 2)
    return sp.csc_array(derivative.T @ (middle @ derivative))
