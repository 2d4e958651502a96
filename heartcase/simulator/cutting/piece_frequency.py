"""Elements of pieces that are no quicker than the time step allows.

A lone spring cell has the same highest frequency whatever its coverage. An element has more where its tissue fills
one end of its cell, as pieces do: up to four times the omega^2. A piece with more than QUICKER times that of a whole
cell is taken for tissue that reaches further into its cell; uniform strain stays exact, and its mass is what it was.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from heartcase.schemas.arrays import Float64
from heartcase.schemas.bundle.lattice import FULL_MOMENTS
from heartcase.simulator.forces.cell_forces import own_forces_at_corners
from heartcase.simulator.lattice.force_law import ForceLaw
from heartcase.simulator.lattice.model import make_model

__all__ = ["QUICKER", "bounded_moments", "lone_cell_eigenvalues"]

QUICKER = 1.5
"""Largest omega^2 of a piece over the bound of a lone cell; half a cell has 1.19.

With 1.25 a bar of six cells that is cut half through is up to 9% stiffer, with more than 1.5 at most 0.5% softer."""
_STEP = 1e-5
"""Step of the differences [cells]."""
_PARTS = 8
"""Of the way from a piece's own moments to those of a full cell that are tried."""


def lone_cell_eigenvalues(law: ForceLaw, moments: Float64) -> Float64:
    """Largest omega^2 of lone elements at rest [k/m], shape (count,), from their moments, shape (count, 9)."""
    cells = np.stack([2 * np.arange(len(moments)), *[np.zeros(len(moments), int)] * 2], axis=1)
    model = make_model(cells, moments=moments, law=replace(law, shares_strain=False))
    stiffness = np.empty((len(moments), 24, 24))
    for degree in range(24):
        u = np.zeros((len(moments), 8, 3))
        u[:, degree // 3, degree % 3] = _STEP
        # Twice the odd part, so that the error is of third order.
        force = own_forces_at_corners(model, u) - own_forces_at_corners(model, -u)
        stiffness[:, :, degree] = force.reshape(-1, 24) / (-2.0 * _STEP)
    largest = np.linalg.eigvalsh((stiffness + np.swapaxes(stiffness, 1, 2)) / 2.0)[:, -1]
    return 8.0 * largest.astype(np.float64)


def bounded_moments(law: ForceLaw, moments: Float64) -> Float64:
    """Moments of pieces, shape (count, 9), so changed that none has more than QUICKER times a lone cell's bound."""
    if not law.is_element or not len(moments):
        return moments
    bounded = moments.copy()
    quick = np.flatnonzero(lone_cell_eigenvalues(law, moments) > QUICKER * law.rest_bound)
    for part in range(1, _PARTS + 1):
        if not len(quick):
            break
        share = part / _PARTS
        bounded[quick] = (1.0 - share) * moments[quick] + share * FULL_MOMENTS
        quick = quick[lone_cell_eigenvalues(law, bounded[quick]) > QUICKER * law.rest_bound]
    return bounded
