"""Tissue that cells cover in part: a tube and half an ellipsoid under pressure, in small strain.

Lengths are in units of the tube's inner radius, for the ventricle in mm; stresses in k/h, so that E = 2.5; the pressure
is one.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from benchmarks.elasticity_voxels import located, voxelised
from benchmarks.statics import solve_linear, stiffness
from heartcase.schemas.arrays import Bool, Float64
from heartcase.simulator.lattice.model import LatticeModel
from heartcase.simulator.lattice.moduli import ForceLaw

VENTRICLE_INNER, VENTRICLE_OUTER = (20.0, 45.0), (30.0, 55.0)
"""Radius and length of the cavity and of the outside, mm."""
VENTRICLE_WALL = 10.0


@dataclass(frozen=True)
class Wetted:
    """Points of the surface that the pressure acts on."""

    points: Float64
    """Shape (count, 3)."""
    areas: Float64
    """Area that each stands for, as a vector into the tissue, shape (count, 3)."""


def tube_truth(wall: float, poissons_ratio: float) -> float:
    """Lame's displacement of the inner wall, the ends held along the axis."""
    b_squared = (1.0 + wall) ** 2
    factor = (1.0 + poissons_ratio) / ForceLaw().youngs_modulus / (b_squared - 1.0)
    return factor * (1.0 - 2.0 * poissons_ratio + b_squared)


def tube(wall: float, cells_per_wall: float, law: ForceLaw, radius_mm: float = 20.0) -> LatticeModel:
    """A ring of cells whose centre lies at no symmetric place of the lattice."""
    edge = wall / cells_per_wall
    reach = int(np.ceil((1.0 + wall) / edge)) + 1
    centre = edge * np.array(_TUBE_CENTRE)

    def is_tissue(x: Float64) -> Bool:
        r = np.hypot(x[..., 0] - centre[0], x[..., 1] - centre[1])
        return (r >= 1.0) & (r <= 1.0 + wall)

    return voxelised(is_tissue, (-reach, -reach, 0), (reach, reach, 1), edge, law, edge * radius_mm)


def solve_tube(model: LatticeModel, wall: float, cells_per_wall: float) -> float:
    """Mean radial displacement of the inner wall."""
    edge = wall / cells_per_wall
    angle = (np.arange(4000) + 0.5) * 2.0 * np.pi / 4000
    normal = np.stack([np.cos(angle), np.sin(angle), np.zeros_like(angle)], axis=1)
    points = edge * np.array([*_TUBE_CENTRE, 0.5]) + normal
    wetted = Wetted(points, normal * 2.0 * np.pi / 4000 * edge)
    is_held = np.zeros((model.node_count, 3), np.bool_)
    is_held[:, 2] = True
    # The pressure holds itself: nothing pulls at what keeps the ring from floating and turning.
    right, left = model.node_index[:, 0].argmax(), model.node_index[:, 0].argmin()
    is_held[right, :2] = is_held[left, 1] = True
    displacement, _ = _under_pressure(model, wetted, is_held, edge)
    return float((displacement * normal).sum(axis=1).mean())


def ventricle(cells_per_wall: float, law: ForceLaw) -> LatticeModel:
    """A quarter of the shell, its base on the plane z = 0 and its apex above."""
    edge = VENTRICLE_WALL / cells_per_wall

    def is_tissue(x: Float64) -> Bool:
        across = x[..., 0] ** 2 + x[..., 1] ** 2
        (a, c), (A, C) = VENTRICLE_INNER, VENTRICLE_OUTER
        return (across / a**2 + (x[..., 2] / c) ** 2 >= 1.0) & (across / A**2 + (x[..., 2] / C) ** 2 <= 1.0)

    high = [int(np.ceil(VENTRICLE_OUTER[n] / edge - 1e-9)) for n in (0, 0, 1)]
    return voxelised(is_tissue, (0, 0, 0), (high[0], high[1], high[2]), edge, law, edge)


def solve_ventricle(model: LatticeModel, cells_per_wall: float) -> tuple[float, float]:
    """Displacement of the inner apex along the axis, and change of the whole cavity's volume."""
    edge = VENTRICLE_WALL / cells_per_wall
    radius, length = VENTRICLE_INNER
    steps = 120
    polar, around = np.meshgrid(*[(np.arange(steps) + 0.5) * np.pi / 2 / steps] * 2, indexing="ij")
    s, c = np.sin(polar).ravel(), np.cos(polar).ravel()
    x, y = np.cos(around).ravel(), np.sin(around).ravel()
    areas = np.stack([length * s * s * x, length * s * s * y, radius * s * c], axis=1)
    areas *= radius * (np.pi / 2 / steps) ** 2
    wetted = Wetted(np.stack([radius * s * x, radius * s * y, length * c], axis=1), areas)
    is_held = model.node_index == 0
    is_held[is_held[:, 2]] = True
    displacement, u = _under_pressure(model, wetted, is_held, edge)
    nodes, shares = located(model, np.array([[1e-9, 1e-9, length / edge]]))
    return float((shares @ u[nodes[0], 2])[0]), 4.0 * float((displacement * areas).sum())


_TUBE_CENTRE = (0.37, 0.21)
"""From a corner [cells]."""


def _under_pressure(model: LatticeModel, wetted: Wetted, is_held: Bool, edge: float) -> tuple[Float64, Float64]:
    """Displacement of the wetted points, and of the nodes; in the scene's units of length, shape (..., 3)."""
    nodes, shares = located(model, wetted.points / edge)
    load = np.zeros((model.node_count, 3))
    for axis in range(3):
        pushes = shares * wetted.areas[:, axis, None] / edge**2
        load[:, axis] = np.bincount(nodes.ravel(), pushes.ravel(), minlength=model.node_count)
    held = np.flatnonzero(is_held)
    u, _ = solve_linear(stiffness(model), load, (held, np.zeros(len(held))))
    u = u * edge
    return np.einsum("pc,pca->pa", shares, u[nodes]), u
