"""Truths by scikit-fem: quadratic hexahedra on fine meshes, in small strain with the library's own bilinear form.

In large strain there are two: neo-Hooke's solid, and our element's energy density without what it says of a cell's
linear strain. What both have in common with us is the solver, not the stiffness.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cache, cached_property
from itertools import pairwise

import numpy as np
import scipy.sparse as sp
from skfem import Basis, ElementHex2, ElementVector, FacetBasis, LinearForm, MeshHex, MeshHex2
from skfem.models.elasticity import linear_elasticity

from benchmarks.elasticity_scenes import Field, Scene, scene
from benchmarks.statics import Held, solve_linear, solve_newton
from heartcase.schemas.arrays import Bool, Float64
from heartcase.simulator.lattice.moduli import ForceLaw

Material = Callable[[Float64, float, float], tuple[Float64, Float64]]
"""From deformation gradients (n, 3, 3), mu and lambda: first Piola-Kirchhoff stress and its derivative."""

_I = np.eye(3)
_GRADING = 2.0
"""Exponent by which elements get smaller towards an edge where stress is singular."""


def neo_hooke(F: Float64, mu: float, lam: float) -> tuple[Float64, Float64]:
    """W = mu/2 (I_C - 3) - mu ln J + lambda/2 (ln J)^2: stress (n, 3, 3) and its derivative (n, 3, 3, 3, 3)."""
    T = np.swapaxes(np.linalg.inv(F), 1, 2)
    # A trial of Newton's that is inside out has no logarithm, and is halved.
    with np.errstate(invalid="ignore"):
        log = np.log(np.linalg.det(F))[:, None, None]
    stress = mu * F + (lam * log - mu) * T
    slope = lam * _outer(T, T) - (lam * log - mu)[:, :, :, None, None] * _turned(T)
    return stress, slope + mu * _identity()


def our_energy(F: Float64, mu: float, lam: float) -> tuple[Float64, Float64]:
    """W of heartcase/simulator/forces/cell_forces.py without H: stress (n, 3, 3) and its derivative (n, 3, 3, 3, 3)."""
    modulus = lam + mu / 3.0
    T = np.swapaxes(np.linalg.inv(F), 1, 2)
    J = np.linalg.det(F)[:, None, None]
    D = 0.5 + (F * F).sum(axis=(1, 2))[:, None, None] / 6.0
    d = (J - 1.0) / D
    S = J * T / D - d / (3.0 * D) * F
    stress = mu * F + (modulus * d - mu) * S
    J, D, d = (array[:, :, :, None, None] for array in (J, D, d))
    S_slope = J / D * (_outer(T, T) - _turned(T)) - J / (3.0 * D**2) * _outer(T, F)
    S_slope += d / (9.0 * D**2) * _outer(F, F) - (_outer(F, S) + d * _identity()) / (3.0 * D)
    return stress, mu * _identity() + modulus * _outer(S, S) + (modulus * d - mu) * S_slope


MATERIALS: dict[str, Material] = {"neo_hooke": neo_hooke, "our_energy": our_energy}


@dataclass(frozen=True)
class Solid:
    """A mesh with quadratic hexahedra; node-major degrees of freedom, 3 node + axis."""

    mesh: MeshHex
    integration_order: int = 5

    @cached_property
    def basis(self) -> Basis:
        """Of a scalar."""
        return Basis(self.mesh, ElementHex2(), intorder=self.integration_order)

    @property
    def points(self) -> Float64:
        """Rest positions of the nodes, shape (n, 3)."""
        return np.ascontiguousarray(self.basis.doflocs.T)

    def elastic_matrix(self, law: ForceLaw) -> sp.csc_array:
        """Hooke's stiffness as the library assembles it, shape (3 n, 3 n)."""
        vector = Basis(self.mesh, ElementVector(ElementHex2()), intorder=self.integration_order)
        matrix = linear_elasticity(law.lame_modulus, law.shear_modulus).assemble(vector)
        order = np.empty(vector.N, np.int64)
        by_axis = vector.element_dofs.reshape(-1, 3, vector.element_dofs.shape[1])
        for axis in range(3):
            order[3 * self.basis.element_dofs + axis] = by_axis[:, axis]
        return sp.csc_array(matrix[order][:, order])

    def forces(self, u: Float64, material: Material, law: ForceLaw) -> Float64:
        """Inner forces at a displacement, shape (n, 3) each."""
        stress, _ = self._stress(u, material, law)
        weighted = stress * self.basis.dx.ravel()[:, None, None]
        elements, points = self.basis.dx.shape
        at_nodes = -np.einsum("eqij,eqaj->eai", weighted.reshape(elements, points, 3, 3), self._slopes)
        force = np.zeros(u.shape)
        for axis in range(3):
            force[:, axis] = np.bincount(self.basis.element_dofs.T.ravel(), at_nodes[:, :, axis].ravel(), len(u))
        return force

    def tangent(self, u: Float64, material: Material, law: ForceLaw) -> sp.csc_array:
        """Minus the derivative of the inner forces, shape (3 n, 3 n)."""
        _, slope = self._stress(u, material, law)
        elements, points = self.basis.dx.shape
        degrees = (3 * self.basis.element_dofs.T[:, :, None] + np.arange(3)).reshape(elements, -1)
        nodes = self._slopes.shape[2]
        slope = (slope * self.basis.dx.ravel()[:, None, None, None, None]).reshape(elements, points, 3, 3, 3, 3)
        blocks = np.empty((elements, 3 * nodes, 3 * nodes))
        # Not by matmul: BLAS would start threads for products too small for them.
        for e, B in enumerate(self._slopes):
            half = np.einsum("qijkl,qbl->qjikb", slope[e], B).reshape(3 * points, 9 * nodes)
            columns = np.ascontiguousarray(np.swapaxes(B, 1, 2)).reshape(3 * points, nodes)
            whole = np.einsum("pa,pm->am", columns, half).reshape(nodes, 3, 3, nodes)
            blocks[e] = np.swapaxes(whole, 2, 3).reshape(3 * nodes, 3 * nodes)
        rows = np.broadcast_to(degrees[:, :, None], blocks.shape).ravel()
        columns = np.broadcast_to(degrees[:, None, :], blocks.shape).ravel()
        return sp.csc_array(sp.coo_array((blocks.ravel(), (rows, columns)), shape=(u.size, u.size)))

    def normal_shares(self, is_on: Callable[[Float64], Bool]) -> Float64:
        """Integral of each node's shape function times the outward normal over a part of the boundary, shape (n, 3).

        ``is_on`` says of points of shape (3, count), the middles of facets, whether they belong to it.
        """
        facets = self.mesh.facets_satisfying(is_on, boundaries_only=True)
        basis = FacetBasis(self.mesh, ElementHex2(), facets=facets, intorder=self.integration_order)
        forms = [LinearForm(lambda v, w, axis=axis: v * w.n[axis]) for axis in range(3)]
        return np.stack([form.assemble(basis) for form in forms], axis=1)

    @cached_property
    def _slopes(self) -> Float64:
        """Slopes of the shape functions, shape (elements, points, nodes, 3)."""
        slopes = np.stack([function[0].grad for function in self.basis.basis])
        return np.ascontiguousarray(slopes.transpose(2, 3, 0, 1))

    def _stress(self, u: Float64, material: Material, law: ForceLaw) -> tuple[Float64, Float64]:
        at_nodes = u[self.basis.element_dofs.T]
        F = _I + np.einsum("eai,eqaj->eqij", at_nodes, self._slopes)
        return material(F.reshape(-1, 3, 3), law.shear_modulus, law.lame_modulus)


@dataclass(frozen=True)
class Truth:
    """A figure, and how sure it is."""

    value: float
    uncertainty: float
    """What Richardson's extrapolation changed, over the value."""

    @classmethod
    def of(cls, fine: float, finer: float, finenesses: tuple[int, int]) -> Truth:
        """From two meshes, with an error of second order: about what singular edges leave of these graded meshes."""
        n, m = finenesses
        value = finer + (finer - fine) * n**2 / (m**2 - n**2)
        return cls(value, abs(finer / value - 1.0))


LINEAR_MESHES = (2, 3)
LARGE_MESHES = (1, 2)


@cache
def box_truth(name: str, material: str, poissons_ratio: float) -> Truth:
    """What a scene measures: in small strain with the material ``linear``, else in large strain."""
    law = ForceLaw("element", poissons_ratio)
    one = scene(name, material != "linear")
    meshes = LINEAR_MESHES if material == "linear" else LARGE_MESHES
    fine, finer = (solve_box(one, material, law, fineness) for fineness in meshes)
    return Truth.of(fine, finer, meshes)


def solve_box(scene: Scene, material: str, law: ForceLaw, fineness: int) -> float:
    """What a scene measures, with two ``fineness`` elements across a bar."""
    solid = Solid(box_mesh(scene, fineness))
    points = solid.points
    is_mirrored = np.stack([(np.abs(points[:, axis]) < 1e-9) & (axis in scene.mirrors) for axis in range(3)], axis=1)

    def held_at(part: float) -> Held:
        is_led, where = scene.led(points, part)
        return np.flatnonzero(is_led | is_mirrored), where[is_led | is_mirrored]

    end_share = solid.normal_shares(lambda x: np.abs(x[0] - scene.high[0]) < 1e-9)[:, 0]
    load = end_share[:, None] * np.array(scene.traction)
    if material == "linear":
        u, reaction = solve_linear(solid.elastic_matrix(law), load, held_at(1.0))
    else:
        of = (MATERIALS[material], law)
        inner, tangent = (lambda u: solid.forces(u, *of)), (lambda u: solid.tangent(u, *of))
        u, reaction = solve_newton(inner, tangent, load, held_at, scene.step_count)
    parts = 2 ** len(scene.mirrors) if scene.is_extensive else 1
    return parts * scene.measure(Field(points, u, reaction, end_share))


@cache
def ventricle_truth(
    inner: tuple[float, float], outer: tuple[float, float], poissons_ratio: float
) -> tuple[Truth, Truth]:
    """Displacement of the inner apex along the axis and change of the cavity's volume, both per unit of pressure.

    Parameters
    ----------
    inner, outer
        Radius and length of half an ellipsoid, its base at z = 0 and held.
    poissons_ratio
        Of the wall, whose Young's modulus is 2.5.
    """
    law = ForceLaw("element", poissons_ratio)
    fine, finer = (solve_ventricle(inner, outer, law, fineness) for fineness in LINEAR_MESHES)
    apex, change = (Truth.of(*pair, LINEAR_MESHES) for pair in zip(fine, finer, strict=True))
    return apex, change


def solve_ventricle(
    inner: tuple[float, float], outer: tuple[float, float], law: ForceLaw, fineness: int
) -> tuple[float, float]:
    """Both figures, with ``fineness`` elements through the wall."""
    solid = Solid(_ventricle_mesh(inner, outer, fineness), integration_order=7)
    points = solid.points
    is_held = np.abs(points) < 1e-9
    is_held[is_held[:, 2]] = True
    middle = (np.array(inner) + outer) / 2

    def is_inside(x: Float64) -> Bool:
        off_planes = (x > 1e-9).all(axis=0)
        return off_planes & ((x[0] ** 2 + x[1] ** 2) / middle[0] ** 2 + (x[2] / middle[1]) ** 2 < 1.0)

    outward = -solid.normal_shares(is_inside)
    u, _ = solve_linear(solid.elastic_matrix(law), outward, (np.flatnonzero(is_held), np.zeros(is_held.sum())))
    apex = np.abs(points - np.array([0.0, 0.0, inner[1]])).sum(axis=1).argmin()
    return float(u[apex, 2]), 4.0 * float((u * outward).sum())


def _ventricle_mesh(inner: tuple[float, float], outer: tuple[float, float], fineness: int) -> MeshHex2:
    """A quarter: the cube's three faces about a corner, drawn out through the wall and bent to the ellipsoids."""
    across, through = np.linspace(0.0, 1.0, 2 * fineness + 1), np.linspace(1.0, 2.0, fineness + 1)
    block = MeshHex.init_tensor(across, across, through)
    s, t, w = block.p
    patches = np.concatenate([[w * s, w * t, w], [w, w * s, w * t], [w * t, w, w * s]]).reshape(3, 3, -1)
    corners = np.concatenate(patches, axis=1)
    cells = np.concatenate([block.t + n * block.p.shape[1] for n in range(3)], axis=1)
    _, first, number = np.unique(np.round(corners, 9), axis=1, return_index=True, return_inverse=True)
    straight = MeshHex2.from_mesh(MeshHex(corners[:, first], number.ravel()[cells]))
    cube = straight.doflocs
    w = cube.max(axis=0)
    towards = cube / np.linalg.norm(cube, axis=0)
    radius, length = (a + (b - a) * (w - 1.0) for a, b in zip(inner, outer, strict=True))
    return MeshHex2(towards * np.stack([radius, radius, length]), straight.t)


def box_mesh(scene: Scene, fineness: int) -> MeshHex:
    """The scene's box, above its mirrors, with elements that get smaller towards its edges."""
    axes = []
    for axis in range(3):
        low = 0.0 if axis in scene.mirrors else scene.low[axis]
        high, edges = scene.high[axis], [x for x in scene.edges[axis] if low <= x <= scene.high[axis]]
        stops = sorted({low, high, *edges})
        parts = []
        for a, b in pairwise(stops):
            half = [a, (a + b) / 2, b] if a in edges and b in edges else [a, b]
            for c, d in pairwise(half):
                count = max(round(2 * fineness * min(d - c, 0.75 + 0.25 * (d - c))), fineness)
                even = np.linspace(0.0, 1.0, count + 1)
                finer = even**_GRADING if c in edges else 1.0 - (1.0 - even) ** 1.5 if d in edges else even
                parts.append(c + (d - c) * finer)
        axes.append(np.unique(np.round(np.concatenate(parts), 12)))
    return MeshHex.init_tensor(*axes)


def _outer(a: Float64, b: Float64) -> Float64:
    """a_ij b_kl."""
    return a[:, :, :, None, None] * b[:, None, None]


def _turned(T: Float64) -> Float64:
    """T_il T_kj."""
    return np.einsum("nil,nkj->nijkl", T, T)


def _identity() -> Float64:
    """Derivative of F by F, shape (1, 3, 3, 3, 3)."""
    return np.einsum("ik,jl->ijkl", _I, _I)[None]
