"""A peer of the elements: scikit-fem's trilinear hexahedra, fully integrated, one for each cell, in small strain."""

from __future__ import annotations

import numpy as np
import scipy.sparse as sp
from skfem import Basis, ElementHex1, ElementVector, FacetBasis, LinearForm, MeshHex
from skfem.models.elasticity import linear_elasticity

from benchmarks.elasticity_scenes import Field, Scene
from benchmarks.statics import solve_linear
from heartcase.simulator.lattice.moduli import ForceLaw


def solve_trilinear(scene: Scene, cells_per_unit: int, law: ForceLaw) -> float:
    """What the scene measures of them."""
    counts = np.round((np.array(scene.high) - scene.low) * cells_per_unit).astype(int)
    axes = [np.linspace(low, high, n + 1) for low, high, n in zip(scene.low, scene.high, counts, strict=True)]
    mesh = MeshHex.init_tensor(*axes)
    vector = Basis(mesh, ElementVector(ElementHex1()), intorder=3)
    order = vector.nodal_dofs.T.ravel()
    matrix = linear_elasticity(law.lame_modulus, law.shear_modulus).assemble(vector)[order][:, order]
    end = mesh.facets_satisfying(lambda x: np.abs(x[0] - scene.high[0]) < 1e-9)
    share = LinearForm(lambda v, w: v).assemble(FacetBasis(mesh, ElementHex1(), facets=end, intorder=3))
    points = mesh.p.T
    is_led, where = scene.led(points, 1.0)
    load = share[:, None] * np.array(scene.traction)
    u, reaction = solve_linear(sp.csc_array(matrix), load, (np.flatnonzero(is_led), where[is_led]))
    return scene.measure(Field(points, u, reaction, share))
