"""The highest frequency of a lattice at rest, which bounds the time step: by the method of Lanczos.

A few dozen products of the stiffness with a vector give a Ritz value that is never above the largest eigenvalue, and
hardly below. From a start drawn at random, it falls short by more than a fraction f of it after n steps with a
probability of at most 1.648 sqrt(N) exp(-sqrt(f) (2 n - 1)), N the number of unknowns (Kuczynski and Wozniakowski,
SIAM J. Matrix Anal. Appl. 13, 1992, theorem 4.2). Steps are taken until that is one in a thousand million.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import ceil, log, sqrt

import numpy as np
from numba import prange

from heartcase.compiling.kernel import loop_kernel
from heartcase.schemas.arrays import Float64, Int8, Int32, Int64
from heartcase.simulator.forces.cell_stiffness import CellStiffness
from heartcase.simulator.lattice.model import DIRECTIONS, LatticeModel

__all__ = ["Spectrum", "Ties", "largest_eigenvalue"]


SHORTFALL = 0.02
"""Most that the Ritz value falls short of the largest eigenvalue, as a part of it: 1% of the time step."""
MISSED = 1e-9
"""Probability that it falls short by more."""
_EXHAUSTED = 1e-12
"""Length of the next vector, over the largest entry so far, at which all frequencies of the start were found."""


@dataclass(frozen=True)
class Spectrum:
    """What is known of the largest eigenvalue omega^2 of stiffness over mass [1 / unit of time squared]."""

    lower: float
    """The largest Ritz value: the eigenvalue is not below."""
    upper: float
    """The eigenvalue is not above."""
    residual: float
    """An eigenvalue lies within this of ``lower``."""
    step_count: int
    """Steps of Lanczos that were taken."""


@dataclass(frozen=True)
class Ties:
    """What ties nodes together: each resists movements of its ends alike in all directions."""

    number: Int64
    """Tie, from 0 on, of each of its nodes, shape (any,)."""
    nodes: Int64
    """The node, the same."""
    shares: Float64
    """Share that it has in the tie, times the root of the tie's stiffness [k], the same."""

    def add_times(self, moved: Float64, inverse_root: Float64, product: Float64) -> None:
        """Add their stiffness times displacements, over the roots of the masses, (node_count, 3)."""
        for axis in range(3):
            pull = np.bincount(self.number, self.shares * moved[self.nodes, axis])[self.number]
            product[:, axis] += inverse_root * np.bincount(self.nodes, self.shares * pull, len(inverse_root))


def largest_eigenvalue(model: LatticeModel, *, shortfall: float = SHORTFALL, ties: Ties | None = None) -> Spectrum:
    """Bounds on the largest eigenvalue of a lattice at rest, without its fixed nodes and explicit springs.

    Parameters
    ----------
    model
        The lattice, without the springs that were cut.
    shortfall
        Most that ``lower`` falls short of ``upper``, as a part of it; above 0 and below 1.
    ties
        What ties nodes together besides.
    """
    free = ~model.node_is_fixed
    inverse_root = np.where(free, 1.0 / np.sqrt(model.node_mass.astype(np.float64)), 0.0)
    unknown_count = 3 * int(free.sum())
    if unknown_count == 0:
        return Spectrum(0.0, 0.0, 0.0, 0)
    step_most = ceil(0.5 * (1.0 + log(1.648 * sqrt(unknown_count) / MISSED) / sqrt(shortfall)))
    springs, cells = _springs_of_nodes(model), CellStiffness(model)
    vector = np.random.Generator(np.random.PCG64(0)).normal(size=(model.node_count, 3)) * free[:, None]
    vector /= _length(vector)
    before, product = np.zeros_like(vector), np.empty_like(vector)
    diagonal: list[float] = []
    beside: list[float] = []
    is_exhausted = False
    for _ in range(min(step_most, unknown_count)):
        moved = inverse_root[:, None] * vector
        _stiffness_times(*springs, inverse_root, moved, product)
        cells.add_times(moved, inverse_root, product)
        if ties is not None:
            ties.add_times(moved, inverse_root, product)
        diagonal.append(float((vector * product).sum()))
        product -= diagonal[-1] * vector
        if beside:
            product -= beside[-1] * before
        beside.append(_length(product))
        if beside[-1] <= _EXHAUSTED * max(diagonal):
            is_exhausted = True
            break
        product /= beside[-1]
        before, vector, product = vector, product, before
    values, vectors = np.linalg.eigh(np.diag(diagonal) + np.diag(beside[:-1], 1) + np.diag(beside[:-1], -1))
    lower = float(values[-1])
    residual = float(abs(beside[-1] * vectors[-1, -1]))
    # all unknowns were seen: nothing is left but rounding
    is_whole = is_exhausted or len(diagonal) == unknown_count
    return Spectrum(lower, lower / (1.0 - (1e-9 if is_whole else shortfall)), residual, len(diagonal))


def _length(vector: Float64) -> float:
    """Euclidean norm; that of a linear algebra library may depend on the number of threads."""
    return float(np.sqrt((vector * vector).sum()))


def _springs_of_nodes(model: LatticeModel) -> tuple[Int64, Int32, Int8, Float64]:
    """Where the springs of each node begin (and the last end); their other ends, directions and stiffness [k]."""
    ends = model.spring_nodes.T.ravel()
    order = np.argsort(ends, kind="stable")
    start = np.concatenate(([0], np.cumsum(np.bincount(ends, minlength=model.node_count))))
    other = model.spring_nodes[:, ::-1].T.ravel()[order]
    direction, weight = np.tile(model.spring_direction, 2)[order], np.tile(model.acting_weight, 2)[order]
    return start, np.ascontiguousarray(other), direction, weight.astype(np.float64)


@loop_kernel
def _stiffness_times(
    start: Int64,
    other: Int32,
    direction: Int8,
    weight: Float64,
    inverse_root: Float64,
    moved: Float64,
    product: Float64,
) -> None:
    """Write the stiffness of the springs at rest times displacements, over the roots of the masses, (node_count, 3)."""
    for node in prange(len(start) - 1):
        x, y, z = 0.0, 0.0, 0.0
        for spring in range(start[node], start[node + 1]):
            far = other[spring]
            # a direction and its opposite pull alike
            i, j, k = DIRECTIONS[direction[spring]]
            along = i * (moved[node, 0] - moved[far, 0])
            along += j * (moved[node, 1] - moved[far, 1])
            along += k * (moved[node, 2] - moved[far, 2])
            pull = weight[spring] * along / (i * i + j * j + k * k)
            x += pull * i
            y += pull * j
            z += pull * k
        product[node, 0] = inverse_root[node] * x
        product[node, 1] = inverse_root[node] * y
        product[node, 2] = inverse_root[node] * z
