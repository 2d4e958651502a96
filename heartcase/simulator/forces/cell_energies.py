"""Energy in the cells of a state, in float64, compiled: it is asked for with every frame of a script.

The formulas are those of :mod:`heartcase.simulator.forces.cell_forces`, which is its oracle.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
from numba import prange

from heartcase.compiling.kernel import kernel, loop_kernel
from heartcase.schemas.arrays import Bool, Float32, Float64, Int32, Int64
from heartcase.schemas.bundle.lattice import CORNER_OFFSETS
from heartcase.simulator.forces.cell_forces import EDGE_SQUARES, MODES, SPREAD_MIN, WARP_FREE, WARP_STIFFNESS
from heartcase.simulator.lattice.model import LatticeModel

__all__ = ["energies_in_cells"]

CHUNKS = 16
_CORNERS = CORNER_OFFSETS.astype(np.float64)


def energies_in_cells(model: LatticeModel, displacement: npt.ArrayLike, cells: Bool | None = None) -> Float64:
    """Energy in each cell beyond that of its springs [grid units], shape (cell_count,); displacements in cells.

    Only in the cells of a mask, shape (cell_count,), where one is given: then as many values as it has cells.
    """
    law = model.law
    chosen = np.arange(model.cell_count) if cells is None else np.flatnonzero(cells)
    if not len(chosen):
        return np.zeros(0)
    moved = np.ascontiguousarray(displacement, dtype=np.float64)
    corners, moments, shared = model.cell_corners, model.cell_moments, model.shared_stiffness
    stretching = np.array([law.shear_modulus, law.lame_modulus + law.shear_modulus / 3.0])
    node_energy = np.zeros(model.node_count if model.shares_strain else 0)
    if model.shares_strain:
        gradient = np.empty((model.cell_count, 3, 3))
        every = np.arange(model.cell_count)
        _write_gradients(_chunks(model.cell_count), every, corners, moved, moments, gradient)
        _write_node_energies(corners, shared, gradient, stretching, node_energy)
    bending = np.array([law.plate_modulus, law.poissons_ratio, law.youngs_modulus]) if law.is_element else np.zeros(3)
    guards = model.corner_guard_scale if law.has_corner_guard else np.zeros(model.cell_count, np.float32)
    result = np.empty(len(chosen))
    _write_energies(
        _chunks(len(chosen)),
        chosen,
        corners,
        moved,
        moments,
        model.cell_force_scale,
        model.cell_shares,
        shared,
        node_energy,
        guards,
        law.corner_floor,
        law.is_element,
        law.volume_modulus if law.has_volume_term else 0.0,
        stretching,
        bending,
        result,
    )
    return result


def _chunks(count: int) -> Int64:
    return np.linspace(0, count, CHUNKS + 1).astype(np.int64)


@kernel
def _write_modes(corners: Int32, cell: int, moved: Float64, q: Float64) -> None:
    """Write columns of G and q_1 to q_4 of a cell, shape (7, 3)."""
    q[:] = 0.0
    for corner in range(8):
        node = corners[cell, corner]
        for mode in range(7):
            for axis in range(3):
                q[mode, axis] += MODES[mode, corner] * moved[node, axis]


@kernel
def _write_gradient(q: Float64, moments: Float32, cell: int, F: Float64) -> None:
    """Write F, shape (3, 3): of an element the mean over its tissue."""
    x, y, z = np.float64(moments[cell, 0]), np.float64(moments[cell, 1]), np.float64(moments[cell, 2])
    yz, xz, xy = np.float64(moments[cell, 6]), np.float64(moments[cell, 7]), np.float64(moments[cell, 8])
    for i in range(3):
        F[i, 0] = q[0, i] + z * q[4, i] + y * q[5, i] + yz * q[6, i]
        F[i, 1] = q[1, i] + z * q[3, i] + x * q[5, i] + xz * q[6, i]
        F[i, 2] = q[2, i] + y * q[3, i] + x * q[4, i] + xy * q[6, i]
        F[i, i] += 1.0


@kernel
def _volume(F: Float64) -> tuple[float, float, float]:
    """I_C, D and d of a gradient."""
    squares = 0.0
    for i in range(3):
        for k in range(3):
            squares += F[i, k] * F[i, k]
    J = (
        F[0, 0] * (F[1, 1] * F[2, 2] - F[1, 2] * F[2, 1])
        - F[0, 1] * (F[1, 0] * F[2, 2] - F[1, 2] * F[2, 0])
        + F[0, 2] * (F[1, 0] * F[2, 1] - F[1, 1] * F[2, 0])
    )
    D = 0.5 + squares / 6.0
    return squares, D, (J - 1.0) / D


@kernel
def _stretching(F: Float64, moduli: Float64) -> float:
    """What stretching stores per covered stiffness."""
    mu, modulus = float(moduli[0]), float(moduli[1])
    squares, _, d = _volume(F)
    return float(0.5 * mu * (squares - 3.0) - mu * d + 0.5 * modulus * d * d)


@kernel
def _write_spread(moments: Float32, cell: int, spread: Float64) -> None:
    """Write the variance of the tissue along x, y and z where the other two are known, not below SPREAD_MIN."""
    x, y, z = np.float64(moments[cell, 0]), np.float64(moments[cell, 1]), np.float64(moments[cell, 2])
    xx = max(np.float64(moments[cell, 3]) - x * x, SPREAD_MIN)
    yy = max(np.float64(moments[cell, 4]) - y * y, SPREAD_MIN)
    zz = max(np.float64(moments[cell, 5]) - z * z, SPREAD_MIN)
    yz = np.float64(moments[cell, 6]) - y * z
    xz = np.float64(moments[cell, 7]) - x * z
    xy = np.float64(moments[cell, 8]) - x * y
    minors = (yy * zz - yz * yz, xx * zz - xz * xz, xx * yy - xy * xy)
    determinant = xx * minors[0] - xy * (xy * zz - yz * xz) + xz * (xy * yz - yy * xz)
    for axis in range(3):
        known = determinant / minors[axis] if minors[axis] > SPREAD_MIN * SPREAD_MIN else 0.0
        spread[axis] = max(known, SPREAD_MIN)


@kernel
def _bending(F: Float64, q: Float64, spread: Float64, shear: float, moduli: Float64, a: Float64) -> float:
    """H: what the strain's linear part stores per covered stiffness; ``a``, shape (4, 3), is written."""
    plate, ratio, youngs = moduli
    for mode in range(4):
        for i in range(3):
            a[mode, i] = F[0, i] * q[3 + mode, 0] + F[1, i] * q[3 + mode, 1] + F[2, i] * q[3 + mode, 2]
    x, y, z = spread
    total = x * (
        plate * (a[2, 1] ** 2 + a[1, 2] ** 2 + 2.0 * ratio * a[2, 1] * a[1, 2]) + shear * (a[1, 1] + a[2, 2]) ** 2
    )
    total += y * (
        plate * (a[2, 0] ** 2 + a[0, 2] ** 2 + 2.0 * ratio * a[2, 0] * a[0, 2]) + shear * (a[0, 0] + a[2, 2]) ** 2
    )
    total += z * (
        plate * (a[1, 0] ** 2 + a[0, 1] ** 2 + 2.0 * ratio * a[1, 0] * a[0, 1]) + shear * (a[0, 0] + a[1, 1]) ** 2
    )
    total += youngs * (y * z * a[3, 0] ** 2 + x * z * a[3, 1] ** 2 + x * y * a[3, 2] ** 2)
    return float(0.5 * total)


@kernel
def _guarded(corners: Int32, cell: int, moved: Float64, floor: float, edges: Float64) -> float:
    """What the corner guard stores for a stiffness k_c of one; ``edges``, shape (3, 3), is written."""
    total = 0.0
    for corner in range(8):
        here = corners[cell, corner]
        for axis in range(3):
            other = corners[cell, corner ^ (1 << axis)]
            sign = 1.0 - 2.0 * _CORNERS[corner, axis]
            for i in range(3):
                offset = _CORNERS[corner ^ (1 << axis), i] - _CORNERS[corner, i]
                edges[axis, i] = sign * (moved[other, i] - moved[here, i] + offset)
        J, D = 0.0, 0.0
        normal = (0.0, 0.0, 0.0)
        for axis in range(3):
            b, c = edges[(axis + 1) % 3], edges[(axis + 2) % 3]
            slope = (b[1] * c[2] - b[2] * c[1], b[2] * c[0] - b[0] * c[2], b[0] * c[1] - b[1] * c[0])
            D += slope[0] ** 2 + slope[1] ** 2 + slope[2] ** 2
            normal = (normal[0] + slope[0], normal[1] + slope[1], normal[2] + slope[2])
            if axis == 0:
                J = edges[0, 0] * slope[0] + edges[0, 1] * slope[1] + edges[0, 2] * slope[2]
        if floor > J:
            D = 0.5 + 0.25 * (D + normal[0] ** 2 + normal[1] ** 2 + normal[2] ** 2)
            total += 0.0625 * (floor - J) ** 2 / D
    return total


@loop_kernel
def _write_gradients(
    chunks: Int64, cells: Int64, corners: Int32, moved: Float64, moments: Float32, gradient: Float64
) -> None:
    """Write F of some cells."""
    for c in prange(len(chunks) - 1):
        q = np.empty((7, 3))
        for n in range(chunks[c], chunks[c + 1]):
            _write_modes(corners, cells[n], moved, q)
            _write_gradient(q, moments, cells[n], gradient[n])


@kernel
def _write_node_energies(
    corners: Int32, shared: Float32, gradient: Float64, stretching: Float64, node_energy: Float64
) -> None:
    """Write what the mean of F around each node stores per covered stiffness."""
    mean = np.zeros((len(node_energy), 3, 3))
    stiffness = np.zeros(len(node_energy))
    for cell in range(len(corners)):
        for corner in range(8):
            part, node = np.float64(shared[cell, corner]), corners[cell, corner]
            stiffness[node] += part
            for i in range(3):
                for k in range(3):
                    mean[node, i, k] += part * gradient[cell, i, k]
    for node in range(len(node_energy)):
        if stiffness[node] > 0.0:
            mean[node] /= stiffness[node]
            node_energy[node] = _stretching(mean[node], stretching)


@loop_kernel
def _write_energies(
    chunks: Int64,
    cells: Int64,
    corners: Int32,
    moved: Float64,
    moments: Float32,
    scale: Float32,
    shares: Float32,
    shared: Float32,
    node_energy: Float64,
    guards: Float32,
    corner_floor: float,
    is_element: bool,
    volume_modulus: float,
    stretching: Float64,
    bending: Float64,
    result: Float64,
) -> None:
    """Write the energy of some cells."""
    for c in prange(len(chunks) - 1):
        q, F, a = np.empty((7, 3)), np.empty((3, 3)), np.empty((4, 3))
        spread, edges = np.empty(3), np.empty((3, 3))
        for n in range(chunks[c], chunks[c + 1]):
            cell = cells[n]
            energy = 0.0
            _write_modes(corners, cell, moved, q)
            if is_element:
                _write_gradient(q, moments, cell, F)
                _write_spread(moments, cell, spread)
                _, D, _ = _volume(F)
                Q = 0.0
                for mode in range(4):
                    Q += EDGE_SQUARES[mode] * (q[3 + mode, 0] ** 2 + q[3 + mode, 1] ** 2 + q[3 + mode, 2] ** 2)
                warp = max(Q - WARP_FREE, 0.0) / (1.0 + Q)
                own = 1.0
                for corner in range(8):
                    own -= np.float64(shares[cell, corner])
                energy = own * _stretching(F, stretching)
                energy += _bending(F, q, spread, stretching[0], bending, a) / (D + Q / 6.0)
                energy += 0.5 * WARP_STIFFNESS * warp * warp * (1.0 + Q)
            elif volume_modulus > 0.0:
                for i in range(3):
                    for k in range(3):
                        F[i, k] = q[k, i]
                    F[i, i] += 1.0
                _, _, d = _volume(F)
                energy = 0.5 * volume_modulus * d * d
            energy *= scale[cell]
            if guards[cell] > 0.0:
                energy += guards[cell] * _guarded(corners, cell, moved, corner_floor, edges)
            if len(node_energy):
                for corner in range(8):
                    energy += shared[cell, corner] * node_energy[corners[cell, corner]]
            result[n] = energy
