"""A bar cut half through: how far it bends, beside scikit-fem's quadratic hexahedra on a mesh that is cut the same.

The bar is 1 x 1 x 4, clamped at one end and pulled across at the other so that the cut opens. It is cut from above, a
little before or beyond its middle (``place``) and a little further than half through (``depth``), in cells. The time
is that of the cut; the plain way, taking away the springs that the sheet crosses, is beside it.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from typing import Any

import numpy as np

from benchmarks.runner.cases import MethodSkipped
from benchmarks.statics import Held, solve_linear, stiffness
from heartcase.schemas.arrays import Bool, Float64
from heartcase.simulator.cutting.blade_sheet import Sheet
from heartcase.simulator.cutting.parted_lattice import part
from heartcase.simulator.cutting.tissue_samples import TissueSamples
from heartcase.simulator.lattice.model import LatticeModel, make_model
from heartcase.simulator.lattice.moduli import ForceLaw

LENGTH, PLACE, LEFT = 4.0, 2.0, 0.5
"""Length of the bar, place of the cut, and what is left of the bar's height under it."""


@dataclass(frozen=True)
class Inputs:
    """Where a bar is cut."""

    cells: int
    """Across the bar."""
    place: float
    """Beyond the bar's middle [cells]."""
    depth: float
    """Further than half through [cells]."""


def prepare(params: dict[str, Any]) -> Inputs:
    return Inputs(params["cells"], params["place"], params["depth"])


def whole(cells: int, law: ForceLaw) -> LatticeModel:
    """The bar."""
    ijk = np.stack(np.meshgrid(np.arange(int(LENGTH * cells)), *[np.arange(cells)] * 2, indexing="ij"), axis=-1)
    index = ijk.reshape(-1, 3)
    return make_model(index[np.lexsort(index.T)], law=law)


def sheet(cells: int, place: float, depth: float) -> Sheet:
    """The swept blade, in cells."""
    x, end, top = PLACE * cells + place, LEFT * cells - depth, cells + 1
    return Sheet.swept([[(x, -1, top), (x, top, top)], [(x, -1, end), (x, top, end)]])


def lattice(cells: int, law: ForceLaw, place: float, depth: float) -> LatticeModel:
    """The bar, cut."""
    return part(whole(cells, law), [sheet(cells, place, depth)], TissueSamples.everywhere()).model


def crossed_springs(model: LatticeModel, cells: int, place: float, depth: float) -> Bool:
    """Springs that the blade's sheet crosses, or that begin on it and go on; shape (spring_count,)."""
    ends = model.node_index[model.spring_nodes].astype(float)
    ends = np.take_along_axis(ends, np.argsort(ends[:, :, :1], axis=1), axis=1)
    low, high = np.moveaxis(ends, 1, 0)
    x = PLACE * cells + place
    along = high[:, 0] - low[:, 0]
    way = np.divide(x - low[:, 0], along, out=np.full(len(along), -1.0), where=along > 0)
    is_high = low[:, 2] + way * (high[:, 2] - low[:, 2]) > LEFT * cells - depth
    crossed: Bool = (way >= 0) & (way < 1) & is_high
    return crossed


def springs(inputs: Inputs) -> LatticeModel:
    return lattice(inputs.cells, ForceLaw(), inputs.place, inputs.depth)


def element(inputs: Inputs) -> LatticeModel:
    return lattice(inputs.cells, ForceLaw("element"), inputs.place, inputs.depth)


def springs_removed(inputs: Inputs) -> LatticeModel:
    return _removed(inputs, ForceLaw())


def element_removed(inputs: Inputs) -> LatticeModel:
    return _removed(inputs, ForceLaw("element"))


def _removed(inputs: Inputs, law: ForceLaw) -> LatticeModel:
    model = whole(inputs.cells, law)
    return model.without_springs(crossed_springs(model, inputs.cells, inputs.place, inputs.depth))


METHODS = {
    "springs": springs,
    "element": element,
    "springs_removed": springs_removed,
    "element_removed": element_removed,
}


def errors(inputs: Inputs, output: LatticeModel) -> dict[str, float]:
    """How far the bar bends over what it should, what a mass is lost, and how many cells and nodes are more."""
    try:
        wanted = truth(inputs.place / inputs.cells, inputs.depth / inputs.cells)
    except ImportError:
        raise MethodSkipped("it needs scikit-fem: pip install '.[dev]'") from None
    uncut = whole(inputs.cells, output.law)
    mass = uncut.node_mass.sum(dtype=float)
    return {
        "deflection over truth - 1 [1]": deflection(output, inputs.cells) / wanted - 1.0,
        "mass lost [1]": 1.0 - float(output.node_mass.sum(dtype=float)) / mass,
        "cells more [1]": float(output.cell_count - uncut.cell_count),
        "nodes more [1]": float(output.node_count - uncut.node_count),
    }


def deflection(model: LatticeModel, cells: int) -> float:
    """How far the bar's end goes under a unit force, in a bar of shear modulus 1 and height 1."""
    index = model.node_index
    end = index[:, 0] == int(LENGTH * cells)
    share = end * np.prod(np.where((index[:, 1:] == 0) | (index[:, 1:] == cells), 0.5, 1.0), axis=1)
    return _bent(stiffness(model), index[:, 0] == 0, share / share.sum() * cells**2) / cells


@cache
def truth(place: float, depth: float, fineness: int = 4) -> float:
    """The same by finite elements, the cut ``place`` beyond the middle and ``depth`` deeper than half [bar heights].

    Elements get smaller towards the end of the cut. What two finenesses say differs by 0.4% at 4 and 6.
    """
    from skfem import MeshHex

    from benchmarks.elasticity_truth import Solid

    x, z = PLACE + place, LEFT - depth
    near = np.linspace(0.0, 1.0, 3 * fineness + 1) ** 2
    mesh = MeshHex.init_tensor(
        np.concatenate([x - x * near[::-1], x + (LENGTH - x) * near[1:]]),
        np.linspace(0.0, 1.0, fineness + 1),
        np.concatenate([z - z * near[::-3], z + (1.0 - z) * near[3::3]]),
    )
    points, corners = mesh.p, mesh.t.copy()
    on = np.flatnonzero((np.abs(points[0] - x) < 1e-9) & (points[2] > z + 1e-9))
    copy = np.arange(points.shape[1])
    copy[on] = points.shape[1] + np.arange(len(on))
    beyond = points[0][corners].mean(axis=0) > x
    corners[:, beyond] = copy[corners[:, beyond]]
    solid = Solid(MeshHex(np.hstack([points, points[:, on]]), corners))
    share = np.abs(solid.normal_shares(lambda at: at[0] > LENGTH - 1e-9)[:, 0])
    return _bent(solid.elastic_matrix(ForceLaw()), solid.points[:, 0] < 1e-9, share)


def _bent(matrix: Any, is_clamped: Bool, share: Float64) -> float:
    """Mean displacement of an end under a load that is spread over it."""
    degrees = (3 * np.flatnonzero(is_clamped)[:, None] + np.arange(3)).ravel()
    held: Held = (degrees, np.zeros(len(degrees)))
    load = np.zeros((len(share), 3))
    load[:, 2] = -share
    u, _ = solve_linear(matrix, load, held)
    return float(-(share @ u[:, 2]) / share.sum())
