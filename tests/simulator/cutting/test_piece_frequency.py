"""Which pieces are quicker than the time step allows."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from heartcase.simulator.cutting.piece_frequency import QUICKER, bounded_moments
from heartcase.simulator.forces.cell_forces import own_forces_at_corners
from heartcase.simulator.forces.cell_stiffness import is_quicker
from heartcase.simulator.lattice.model import make_model
from heartcase.simulator.lattice.moduli import ForceLaw

LAWS = [ForceLaw("element"), ForceLaw("element", poissons_ratio=0.45, shares_strain=False)]


def largest_eigenvalues(law, moments):
    """Largest omega^2 of lone elements at rest [k/m]: by differences of the formulas' forces."""
    cells = np.stack([2 * np.arange(len(moments)), *[np.zeros(len(moments), int)] * 2], axis=1)
    model = make_model(cells, moments=moments, law=replace(law, shares_strain=False))
    stiffness = np.empty((len(moments), 24, 24))
    for degree in range(24):
        u = np.zeros((len(moments), 8, 3))
        u[:, degree // 3, degree % 3] = 1e-5
        # Twice the odd part, so that the error is of third order.
        force = own_forces_at_corners(model, u) - own_forces_at_corners(model, -u)
        stiffness[:, :, degree] = force.reshape(-1, 24) / -2e-5
    return 8.0 * np.linalg.eigvalsh((stiffness + np.swapaxes(stiffness, 1, 2)) / 2.0)[:, -1]


def moments_of_boxes(count, seed):
    """Moments of boxes of tissue within a cell, from slivers to full, shape (count, 9)."""
    draw = np.random.default_rng(seed)
    low, high = np.sort(draw.uniform(-0.5, 0.5, (2, count, 3)), axis=0)
    first, second = (low + high) / 2, (low**2 + low * high + high**2) / 3
    x, y, z = first.T
    return np.column_stack([first, second, y * z, x * z, x * y])


@pytest.mark.parametrize("law", LAWS)
def test_elements_above_a_bound_are_those_with_a_larger_eigenvalue(law):
    moments = moments_of_boxes(300, seed=1)
    largest = largest_eigenvalues(law, moments)
    assert largest.max() > 2.0 * law.rest_bound
    # Bounds a little beside each of some eigenvalues as well as those in use.
    bounds = [QUICKER * law.rest_bound, *(largest[::60] * (1 - 1e-6)), *(largest[::60] * (1 + 1e-6))]
    for bound in bounds:
        np.testing.assert_array_equal(is_quicker(law, moments, bound), largest > bound)


@pytest.mark.parametrize("law", LAWS)
def test_pieces_get_moments_that_are_not_quicker_and_no_further_from_their_own_than_need_be(law):
    moments = moments_of_boxes(300, seed=2)
    bounded = bounded_moments(law, moments)
    is_own = (bounded == moments).all(axis=1)
    np.testing.assert_array_equal(is_own, largest_eigenvalues(law, moments) <= QUICKER * law.rest_bound)
    assert (largest_eigenvalues(law, bounded) <= QUICKER * law.rest_bound).all()
    assert 20 < is_own.sum() < 280


def test_springs_keep_their_moments():
    moments = moments_of_boxes(5, seed=3)
    assert bounded_moments(ForceLaw(), moments) is moments
