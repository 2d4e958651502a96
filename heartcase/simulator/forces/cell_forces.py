"""The forces of cells written as their formulas, in float64: the oracle of every kernel.

A cell's displacement is u = u_0 + G x + q_1 yz + q_2 xz + q_3 xy + q_4 xyz with (x, y, z) from its centre [edges]. With
F = I + G, or for elements the mean of the deformation gradient over the tissue, I_C = tr(F^T F) and J = det F,

    d = (J - 1) / D,  D = 1/2 + I_C / 6        is the change of volume; D keeps its stiffness bounded at any stretch

    volume term        W = (lambda - mu) / 2 d^2
    element            W = mu / 2 (I_C - 3) - mu d + (lambda + mu / 3) / 2 d^2 + H / (D + Q / 6) + W_q

is the energy per covered volume: at small strain Hooke's, at any other a rubber's (neo-Hookean in the limit of constant
volume; as in Smith, de Goes and Kim, ACM Trans. Graph. 37, 2018, it has no pole where a cell is flat and pushes cells
that are inside out back). Without H and W_q it is what stretching stores. Of the tissue of cell i, with covered
stiffness v_i, a share s_in stores what the mean of F around the corner n does, not what F_i does itself
(:mod:`heartcase.simulator.lattice.strain_sharing`)::

    F_n = sum over i of  s_in v_i F_i / v_n,   v_n = sum over i of  s_in v_i

H is the energy of the strain's linear part, with a_i = F^T q_i, the plate modulus
E' = E / (1 - nu^2) and the variance s_x of x over the tissue where y and z are known (1/12 in a full cell)::

    H = 1/2 sum over x, y, z of  s_y [E' (a_3x^2 + a_1z^2 + 2 nu a_3x a_1z) + mu (a_1x + a_3z)^2]  and so on

Q = (|q_1|^2 + |q_2|^2 + |q_3|^2) / 2 + 3/16 |q_4|^2 is what the linear part adds to the edges' mean squares: with it
the stiffness stays bounded however a cell is warped. As H does not resist where F is nearly nothing, a warp guard does,
from a curvature on that no grid of such cells resolves: W_q = k_q / 2 max(Q - Q_0, 0)^2 / (1 + Q).

The corner guard adds k_c/16 e^2 for each of a cell's eight corners, with J the volume of its three edges a, b, c and
n = b x c + c x a + a x b::

    e^2 = max(J_0 - J, 0)^2 / D_c,  D_c = 1/2 + (|b x c|^2 + |c x a|^2 + |a x b|^2 + |n|^2) / 4
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from heartcase.schemas.arrays import Bool, Float64, Intp
from heartcase.schemas.bundle.lattice import CORNER_OFFSETS
from heartcase.simulator.lattice.model import LatticeModel
from heartcase.simulator.lattice.moduli import ForceLaw

__all__ = [
    "EDGE_SQUARES",
    "MODES",
    "WARP_FREE",
    "WARP_STIFFNESS",
    "cell_energies",
    "cell_forces",
    "cell_gradients",
    "forces_at_corners",
    "mean_gradients",
    "mean_slopes",
    "own_forces_at_corners",
    "stretching",
    "tissue_spread",
    "volume_stress",
]


WARP_FREE = 0.5
"""Q_0: what cells may warp freely; along one axis this bends them to a radius of one edge."""
WARP_STIFFNESS = 0.75
"""k_q [k/h]. With 2, warped elements would be so much quicker than others that steps had to be a third shorter."""
SPREAD_MIN = 0.1**2 / 12.0
"""Least variance of the tissue along an axis that is reckoned with: that of a wall a tenth of a cell thick."""

EDGE_SQUARES: Float64 = np.array([0.5, 0.5, 0.5, 0.1875])
"""What the squares of q_1 to q_4 add to the edges' mean squares."""

_SIGNS = 2.0 * CORNER_OFFSETS - 1.0
_X, _Y, _Z = _SIGNS.T
MODES: Float64 = np.stack([_X / 4, _Y / 4, _Z / 4, _Y * _Z / 2, _X * _Z / 2, _X * _Y / 2, _X * _Y * _Z])
"""What gives the three columns of G and q_1 to q_4 from the corners' displacements, shape (7, 8)."""


def cell_forces(model: LatticeModel, displacement: npt.ArrayLike) -> Float64:
    """Forces of all cells on every node [grid units], float64, shape (node_count, 3); displacements in cells."""
    at_corners = forces_at_corners(model, np.asarray(displacement, dtype=np.float64)[model.cell_corners])
    force = np.zeros((model.node_count, 3))
    for axis in range(3):
        pulls = at_corners[:, :, axis].ravel()
        force[:, axis] = np.bincount(model.cell_corners.ravel(), pulls, minlength=model.node_count)
    return force


def forces_at_corners(model: LatticeModel, u: Float64) -> Float64:
    """Force of each cell on its corners [grid units] at their displacements [cells], shape (cell_count, 8, 3)."""
    force = own_forces_at_corners(model, u)
    if model.shares_strain:
        force += _shared(model, u)[1]
    return force


def own_forces_at_corners(model: LatticeModel, u: Float64) -> Float64:
    """The same without what follows the mean strain around the corners: of each cell's displacements alone."""
    return _energies_and_forces(model, u, np.arange(model.cell_count))[1]


def mean_gradients(model: LatticeModel, u: Float64) -> tuple[Float64, Float64]:
    """Mean deformation gradient of the tissue that shares strain around each node, and how stiff it is.

    Parameters
    ----------
    model
        The lattice.
    u
        Displacements of all cells' corners [cells], shape (cell_count, 8, 3).

    Returns
    -------
    tuple of ndarray
        F_n, shape (node_count, 3, 3), the unit matrix where nothing is shared; v_n [k/h], shape (node_count,).
    """
    F = _gradients(np.einsum("mc,nci->nmi", MODES, u), mean_slopes(model.cell_moments.astype(np.float64)))
    shared = model.shared_stiffness.astype(np.float64)
    corners = model.cell_corners.ravel()
    stiffness: Float64 = np.bincount(corners, shared.ravel(), minlength=model.node_count).astype(np.float64)
    mean = np.zeros((model.node_count, 3, 3))
    for i, k in np.ndindex(3, 3):
        mean[:, i, k] = np.bincount(corners, (shared * F[:, None, i, k]).ravel(), minlength=model.node_count)
    is_shared = stiffness > 0.0
    mean[is_shared] /= stiffness[is_shared, None, None]
    mean[~is_shared] = np.eye(3)
    return mean, stiffness


def cell_gradients(model: LatticeModel, u: Float64) -> Float64:
    """Mean deformation gradient of each cell's tissue; for springs, of the cell, shape (cell_count, 3, 3).

    Parameters
    ----------
    model
        The lattice.
    u
        Displacements of all cells' corners [cells], shape (cell_count, 8, 3).
    """
    slopes = mean_slopes(model.cell_moments.astype(np.float64)) if model.law.is_element else np.zeros((len(u), 4, 3))
    return _gradients(np.einsum("mc,nci->nmi", MODES, u), slopes)


def volume_stress(law: ForceLaw, F: Float64) -> Float64:
    """Derivative by F of what the volume term of springs stores per covered stiffness, shape (count, 3, 3)."""
    cofactors, _, D, d = _invariants(F)
    return (law.volume_modulus * d)[:, None, None] * _d_slope(F, cofactors, D, d)


def stretching(law: ForceLaw, F: Float64) -> tuple[Float64, Float64]:
    """What stretching stores per covered stiffness, shape (count,), and its derivative by F, shape (count, 3, 3)."""
    cofactors, I_C, D, d = _invariants(F)
    mu, modulus = law.shear_modulus, law.lame_modulus + law.shear_modulus / 3.0
    energy = 0.5 * mu * (I_C - 3.0) - mu * d + 0.5 * modulus * d**2
    return energy, mu * F + (modulus * d - mu)[:, None, None] * _d_slope(F, cofactors, D, d)


def cell_energies(model: LatticeModel, displacement: npt.ArrayLike, cells: Bool | None = None) -> Float64:
    """Energy in each cell beyond that of its springs [grid units], shape (cell_count,); displacements in cells.

    Only in the cells of a mask, shape (cell_count,), where one is given: then as many values as it has cells.
    """
    chosen = np.arange(model.cell_count) if cells is None else np.flatnonzero(cells)
    u = np.asarray(displacement, dtype=np.float64)[model.cell_corners]
    energy = _energies_and_forces(model, u[chosen], chosen)[0]
    if model.shares_strain:
        energy += _shared(model, u)[0][chosen]
    return energy


def mean_slopes(moments: Float64) -> Float64:
    """Mean gradient of yz, xz, xy and xyz over the tissue, from its moments (count, 9): shape (count, 4, 3)."""
    x, y, z, _, _, _, yz, xz, xy = moments.T
    nil = np.zeros_like(x)
    return np.moveaxis(np.array([[nil, z, y], [z, nil, x], [y, x, nil], [yz, xz, xy]]), -1, 0)


def tissue_spread(moments: Float64) -> Float64:
    """Variance of the tissue along x, y and z where the other two are known, not below SPREAD_MIN, shape (count, 3).

    A wall askew to the cell is as thin along each axis as it is cut by it. With C the tissue's covariance, from its
    moments (count, 9), this is 1 / (C^-1)_xx = det C / (C_yy C_zz - C_yz^2) and so on.
    """
    x, y, z, xx, yy, zz, yz, xz, xy = moments.T
    xx, yy, zz = (np.maximum(square, SPREAD_MIN) for square in (xx - x * x, yy - y * y, zz - z * z))
    yz, xz, xy = yz - y * z, xz - x * z, xy - x * y
    minors = np.stack([yy * zz - yz * yz, xx * zz - xz * xz, xx * yy - xy * xy], axis=1)
    determinant = xx * minors[:, 0] - xy * (xy * zz - yz * xz) + xz * (xy * yz - yy * xz)
    known = np.divide(determinant[:, None], minors, out=np.zeros_like(minors), where=minors > SPREAD_MIN**2)
    spread: Float64 = np.maximum(known, SPREAD_MIN)
    return spread


def _energies_and_forces(model: LatticeModel, u: Float64, cells: Intp) -> tuple[Float64, Float64]:
    """Energy of some cells, shape (count,), and force on their corners, shape (count, 8, 3)."""
    energy, force = np.zeros(len(u)), np.zeros_like(u)
    terms = []
    if model.law.is_element:
        own = 1.0 - model.cell_shares[cells].astype(np.float64).sum(axis=1)
        element = _element(model.law, u, model.cell_moments[cells].astype(np.float64), own)
        terms.append((model.cell_force_scale[cells], *element))
    elif model.law.has_volume_term:
        terms.append((model.cell_force_scale[cells], *_volume_term(model, u)))
    if model.law.has_corner_guard:
        terms.append((model.corner_guard_scale[cells], *_corner_guard(u, model.law.corner_floor)))
    for scale, term_energy, term_force in terms:
        energy += scale * term_energy
        force += scale[:, None, None] * term_force
    return energy, force


def _shared(model: LatticeModel, u: Float64) -> tuple[Float64, Float64]:
    """What the means around its corners store in each cell, shape (count,), and forces on them, (count, 8, 3)."""
    at_node = stretching(model.law, mean_gradients(model, u)[0])
    shared = model.shared_stiffness.astype(np.float64)
    energy = (shared * at_node[0][model.cell_corners]).sum(axis=1)
    P = np.einsum("nc,ncik->nik", shared, at_node[1][model.cell_corners])
    slopes = mean_slopes(model.cell_moments.astype(np.float64))
    by_mode = np.concatenate([np.swapaxes(P, 1, 2), np.einsum("nki,nai->nak", P, slopes)], axis=1)
    return energy, -np.einsum("mc,nmi->nci", MODES, by_mode)


def _gradients(q: Float64, slopes: Float64) -> Float64:
    """F of each cell, shape (count, 3, 3)."""
    F: Float64 = np.eye(3) + np.swapaxes(q[:, :3], 1, 2) + np.einsum("nai,nak->nik", q[:, 3:], slopes)
    return F


def _invariants(F: Float64) -> tuple[Float64, Float64, Float64, Float64]:
    """Cofactors of F, I_C, D and d."""
    a, b, c = np.moveaxis(F, 2, 0)
    cofactors = np.stack([np.cross(b, c), np.cross(c, a), np.cross(a, b)], axis=2)
    I_C = (F**2).sum(axis=(1, 2))
    D = 0.5 + I_C / 6.0
    d = ((a * cofactors[:, :, 0]).sum(axis=1) - 1.0) / D
    return cofactors, I_C, D, d


def _d_slope(F: Float64, cofactors: Float64, D: Float64, d: Float64) -> Float64:
    """Derivative of d by F, shape (count, 3, 3)."""
    slope: Float64 = cofactors / D[:, None, None] - (d / D / 3.0)[:, None, None] * F
    return slope


def _volume_term(model: LatticeModel, u: Float64) -> tuple[Float64, Float64]:
    F = _gradients(np.einsum("mc,nci->nmi", MODES, u), np.zeros((len(u), 4, 3)))
    d = _invariants(F)[3]
    P = volume_stress(model.law, F)
    return 0.5 * model.law.volume_modulus * d**2, -np.einsum("mc,nim->nci", MODES[:3], P)


def _element(law: ForceLaw, u: Float64, moments: Float64, own: Float64) -> tuple[Float64, Float64]:
    """Energy and forces of cells of which a part, shape (count,), is stretched as they are themselves."""
    slopes, spread = mean_slopes(moments), tissue_spread(moments)
    q = np.einsum("mc,nci->nmi", MODES, u)
    F = _gradients(q, slopes)
    D = _invariants(F)[2]
    a = np.einsum("nki,nak->nai", F, q[:, 3:])
    e = _linear_stress(a, spread, law.plate_modulus, law.poissons_ratio, law.shear_modulus, law.youngs_modulus)
    H = 0.5 * (a * e).sum(axis=(1, 2))
    Q = np.einsum("a,nai->n", EDGE_SQUARES, q[:, 3:] ** 2)
    D_H = D + Q / 6.0
    warp = np.maximum(Q - WARP_FREE, 0.0) / (1.0 + Q)
    stored, slope = stretching(law, F)
    energy = own * stored + H / D_H + 0.5 * WARP_STIFFNESS * warp**2 * (1.0 + Q)
    P = own[:, None, None] * slope
    P += np.einsum("nak,nai->nki", q[:, 3:], e) / D_H[:, None, None] - (H / D_H**2 / 3.0)[:, None, None] * F
    by_mode = np.empty_like(q)
    by_mode[:, :3] = np.swapaxes(P, 1, 2)
    by_mode[:, 3:] = np.einsum("nki,nai->nak", F, e) / D_H[:, None, None] + np.einsum("nki,nai->nak", P, slopes)
    by_square = 2.0 * WARP_STIFFNESS * warp * (1.0 - 0.5 * warp) - H / D_H**2 / 3.0
    by_mode[:, 3:] += by_square[:, None, None] * EDGE_SQUARES[:, None] * q[:, 3:]
    return energy, -np.einsum("mc,nmi->nci", MODES, by_mode)


def _linear_stress(a: Float64, spread: Float64, plate: float, ratio: float, mu: float, youngs: float) -> Float64:
    """Derivative of H by a, shape (count, 4, 3)."""
    e = np.zeros_like(a)
    x, y, z = spread.T
    # (mode, component) pairs whose strains along two axes vary along the third, by whose spread they count
    for varied, (m, i), (n, j) in ((x, (2, 1), (1, 2)), (y, (2, 0), (0, 2)), (z, (1, 0), (0, 1))):
        e[:, m, i] = varied * plate * (a[:, m, i] + ratio * a[:, n, j])
        e[:, n, j] = varied * plate * (a[:, n, j] + ratio * a[:, m, i])
    for varied, m, n in ((x, 1, 2), (y, 0, 2), (z, 0, 1)):
        twist = mu * varied * (a[:, m, m] + a[:, n, n])
        e[:, m, m] += twist
        e[:, n, n] += twist
    e[:, 3] = youngs * np.stack([y * z, x * z, x * y], axis=1) * a[:, 3]
    return e


def _corner_guard(u: Float64, floor: float) -> tuple[Float64, Float64]:
    """Energy and forces of the corners for a stiffness k_c of one."""
    position = np.swapaxes(u + CORNER_OFFSETS, 0, 1)
    others = np.array([[corner ^ (1 << axis) for axis in range(3)] for corner in range(8)])
    signs = -_SIGNS[:, :, None, None]
    # The three edges of every corner, shape (8, count, 3) each.
    edges = [signs[:, axis] * (position[others[:, axis]] - position) for axis in range(3)]
    a, b, c = edges
    slopes = (np.cross(b, c), np.cross(c, a), np.cross(a, b))
    J = (a * slopes[0]).sum(axis=2)
    normal = slopes[0] + slopes[1] + slopes[2]
    D = 0.5 + 0.25 * np.stack([(n * n).sum(axis=2) for n in (*slopes, normal)]).sum(axis=0)
    lack = np.maximum(floor - J, 0.0)
    push = 0.125 * lack / D
    turned = [slope + normal for slope in slopes]
    pulls = []
    for axis in range(3):
        left, right = (axis + 1) % 3, (axis + 2) % 3
        steeper = np.cross(turned[left], edges[right]) + np.cross(edges[left], turned[right])
        along = push[:, :, None] * slopes[axis] + (push * lack / D / 4.0)[:, :, None] * steeper
        pulls.append(signs[:, axis] * along)
    energy, force = np.zeros(len(u)), np.zeros_like(u)
    for corner in range(8):
        energy += 0.0625 * lack[corner] ** 2 / D[corner]
        for axis in range(3):
            force[:, others[corner, axis]] += pulls[axis][corner]
            force[:, corner] -= pulls[axis][corner]
    return energy, force
