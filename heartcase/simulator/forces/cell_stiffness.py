"""The stiffness of cells at rest times displacements, in float64: small strain, for the lattice's highest frequency."""

from __future__ import annotations

import numpy as np
from numba import prange

from heartcase.compiling.kernel import kernel, loop_kernel
from heartcase.schemas.arrays import Bool, Float64, Int32, Int64
from heartcase.simulator.forces.cell_forces import MODES, mean_slopes, tissue_spread
from heartcase.simulator.lattice.model import LatticeModel
from heartcase.simulator.lattice.moduli import ForceLaw

__all__ = ["CellStiffness", "is_quicker"]


class CellStiffness:
    """What the elements, or the volume term, of a model add to its springs; nothing where the law has neither."""

    def __init__(self, model: LatticeModel) -> None:
        law = model.law
        self.acts = law.acts_in_cells
        count = model.cell_count if self.acts else 0
        self._corners = model.cell_corners[:count]
        self._scale = model.cell_force_scale[:count].astype(np.float64)
        moments = model.cell_moments[:count].astype(np.float64)
        self._slopes = mean_slopes(moments) if law.is_element else np.zeros((count, 4, 3))
        self._spread = tissue_spread(moments)
        self._law = _law_numbers(law)
        order = np.argsort(self._corners.ravel(), kind="stable")
        self._places = order.astype(np.int64)
        ends = np.cumsum(np.bincount(self._corners.ravel(), minlength=model.node_count))
        self._first = np.concatenate(([0], ends))
        self._at_corners = np.zeros((count, 8, 3))
        self._shared = model.shared_stiffness[:count].astype(np.float64)
        self._own = self._scale - self._shared.sum(axis=1)
        self._gradient = np.zeros((count, 3, 3))
        self._node_stress = np.zeros((model.node_count if model.shares_strain else 0, 3, 3))

    def add_times(self, moved: Float64, inverse_root: Float64, product: Float64) -> None:
        """Add stiffness times displacements, over the roots of the masses, to a product; all (node_count, 3)."""
        if self.acts:
            if len(self._node_stress):
                _stretch(self._corners, self._slopes, moved, self._gradient)
                _share(self._places, self._first, self._shared, self._gradient, self._law, self._node_stress)
            cells = (self._corners, self._scale, self._own, self._slopes, self._spread)
            _resist(*cells, self._law, self._shared, self._node_stress, moved, self._at_corners)
            _gather(self._places, self._first, self._at_corners.reshape(-1, 3), inverse_root, product)


def is_quicker(law: ForceLaw, moments: Float64, bound: float) -> Bool:
    """Which lone elements have a larger omega^2 at rest than a bound [k/m], shape (count,).

    Parameters
    ----------
    law
        A law of elements.
    moments
        Of their tissue, shape (count, 9), read as the model keeps them: in float32.
    bound
        In k/m, with the mass of a cell of their coverage.
    """
    kept = np.asarray(moments, np.float32).astype(np.float64)
    result = np.empty(len(kept), np.bool_)
    # An eighth of the mass lies at each corner.
    _exceed(mean_slopes(kept), tissue_spread(kept), _law_numbers(law), bound / 8.0, result)
    return result


def _law_numbers(law: ForceLaw) -> Float64:
    shear, lame = (law.shear_modulus, law.lame_modulus) if law.is_element else (0.0, law.volume_modulus)
    return np.array([shear, lame, law.plate_modulus, law.poissons_ratio, law.youngs_modulus])


@kernel
def _modes(corners: Int32, cell: int, moved: Float64) -> Float64:
    """Columns of G and q_1 to q_4 of a cell, shape (7, 3)."""
    q = np.zeros((7, 3))
    for mode in range(7):
        for corner in range(8):
            for axis in range(3):
                q[mode, axis] += MODES[mode, corner] * moved[corners[cell, corner], axis]
    return q


@kernel
def _mean_gradient(q: Float64, slopes: Float64) -> Float64:
    """Mean gradient of the displacement over a cell's tissue, shape (3, 3)."""
    G = np.zeros((3, 3))
    for i in range(3):
        for k in range(3):
            G[i, k] = q[k, i]
            for mode in range(4):
                G[i, k] += q[3 + mode, i] * slopes[mode, k]
    return G


@kernel
def _stress(G: Float64, mu: float, lame: float) -> Float64:
    """Hooke's law."""
    P = mu * (G + G.T)
    trace = lame * (G[0, 0] + G[1, 1] + G[2, 2])
    for i in range(3):
        P[i, i] += trace
    return P


@loop_kernel
def _stretch(corners: Int32, slopes: Float64, moved: Float64, gradient: Float64) -> None:
    """Write the gradient of each cell."""
    for cell in prange(len(corners)):
        gradient[cell] = _mean_gradient(_modes(corners, cell, moved), slopes[cell])


@loop_kernel
def _share(places: Int64, first: Int64, shared: Float64, gradient: Float64, law: Float64, node_stress: Float64) -> None:
    """Write the stress of the mean strain around each node."""
    for node in prange(len(node_stress)):
        mean = np.zeros((3, 3))
        stiffness = 0.0
        for place in range(first[node], first[node + 1]):
            cell, corner = places[place] // 8, places[place] % 8
            part = shared[cell, corner]
            stiffness += part
            for i in range(3):
                for k in range(3):
                    mean[i, k] += part * gradient[cell, i, k]
        if stiffness > 0.0:
            mean /= stiffness
        node_stress[node] = _stress(mean, law[0], law[1])


@kernel
def _write_forces(
    q: Float64, P: Float64, slopes: Float64, spread: Float64, scale: float, law: Float64, at_corners: Float64
) -> None:
    """Write the forces of a cell on its corners, from its modes and the stress of its stretching."""
    mu, _, plate, ratio, youngs = law
    e = np.zeros((7, 3))
    if mu > 0:
        x, y, z = spread
        for varied, m, i, n, j in ((x, 5, 1, 4, 2), (y, 5, 0, 3, 2), (z, 4, 0, 3, 1)):
            e[m, i] += varied * plate * (q[m, i] + ratio * q[n, j])
            e[n, j] += varied * plate * (q[n, j] + ratio * q[m, i])
        for varied, m, n in ((x, 1, 2), (y, 0, 2), (z, 0, 1)):
            twist = mu * varied * (q[3 + m, m] + q[3 + n, n])
            e[3 + m, m] += twist
            e[3 + n, n] += twist
        for axis, product in enumerate((y * z, x * z, x * y)):
            e[6, axis] += youngs * product * q[6, axis]
    e *= scale
    for i in range(3):
        for k in range(3):
            e[k, i] += P[i, k]
            for mode in range(4):
                e[3 + mode, i] += P[i, k] * slopes[mode, k]
    for corner in range(8):
        for axis in range(3):
            total = 0.0
            for mode in range(7):
                total += MODES[mode, corner] * e[mode, axis]
            at_corners[corner, axis] = total


@loop_kernel
def _resist(
    corners: Int32,
    scale: Float64,
    own: Float64,
    slopes: Float64,
    spread: Float64,
    law: Float64,
    shared: Float64,
    node_stress: Float64,
    moved: Float64,
    at_corners: Float64,
) -> None:
    """Write the forces of each cell on its corners."""
    for cell in prange(len(corners)):
        q = _modes(corners, cell, moved)
        P = own[cell] * _stress(_mean_gradient(q, slopes[cell]), law[0], law[1])
        if len(node_stress):
            for corner in range(8):
                part, node = shared[cell, corner], corners[cell, corner]
                for i in range(3):
                    for k in range(3):
                        P[i, k] += part * node_stress[node, i, k]
        _write_forces(q, P, slopes[cell], spread[cell], scale[cell], law, at_corners[cell])


@kernel
def _exceed(slopes: Float64, spread: Float64, law: Float64, bound: float, result: Bool) -> None:
    """Write which lone elements have an eigenvalue of their stiffness above a bound."""
    q, column = np.empty((7, 3)), np.empty((8, 3))
    matrix = np.empty((24, 24))
    for cell in range(len(slopes)):
        for degree in range(24):
            q[:] = 0.0
            for mode in range(7):
                q[mode, degree % 3] = MODES[mode, degree // 3]
            P = _stress(_mean_gradient(q, slopes[cell]), law[0], law[1])
            _write_forces(q, P, slopes[cell], spread[cell], 1.0, law, column)
            for row in range(24):
                matrix[row, degree] = -column[row // 3, row % 3]
            matrix[degree, degree] += bound
        # None is above the bound where Cholesky's decomposition of what is left of it can be finished.
        result[cell] = False
        for row in range(24):
            for degree in range(row + 1):
                total = matrix[row, degree]
                for before in range(degree):
                    total -= matrix[row, before] * matrix[degree, before]
                if degree < row:
                    matrix[row, degree] = total / matrix[degree, degree]
                elif total > 0.0:
                    matrix[row, row] = np.sqrt(total)
                else:
                    result[cell] = True
                    break
            if result[cell]:
                break


@loop_kernel
def _gather(places: Int64, first: Int64, at_corners: Float64, inverse_root: Float64, product: Float64) -> None:
    for node in prange(len(first) - 1):
        for place in range(first[node], first[node + 1]):
            for axis in range(3):
                product[node, axis] += inverse_root[node] * at_corners[places[place], axis]
