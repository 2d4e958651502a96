"""A bar cut half through, and a strip cut to a hinge, beside scikit-fem on a mesh that is cut the same.

Both are 1 high and 4 long, clamped at one end and pulled across at the other so that the cut opens. The cut comes from
above, in the middle or a little beyond (``place``), and leaves some of the height (``left``), in cells. Of the width
(``wide``), in cells, both programs model the half up to the plane of symmetry. Poisson's ratio is 1/4 in both, and the
truth is of quadratic hexahedra. The time is that of the cut; the plain way, taking away the springs that the sheet
crosses, is beside it.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from typing import Any, NamedTuple

import numpy as np

from benchmarks.runner.cases import MethodSkipped
from benchmarks.statics import Held, equilibrium, solve_linear, stiffness
from heartcase.schemas.arrays import Bool, Float64
from heartcase.simulator.cutting.blade_sheet import Sheet
from heartcase.simulator.cutting.parted_lattice import part
from heartcase.simulator.cutting.tissue_samples import TissueSamples
from heartcase.simulator.lattice.model import LatticeModel, make_model
from heartcase.simulator.lattice.moduli import ForceLaw

LENGTH, PLACE = 4.0, 2.0
"""Length of the bar, and the middle of it."""


@dataclass(frozen=True)
class Inputs:
    """A bar, and where it is cut."""

    cells: int
    """Across the bar's height."""
    left: float
    """What the cut leaves of these."""
    place: float = 0.0
    """Beyond the bar's middle [cells]."""
    wide: int = 0
    """Width of the bar [cells], an even number; that of the height where it is zero."""

    @property
    def half(self) -> int:
        """Cells up to the plane of symmetry."""
        return (self.wide or self.cells) // 2


class Bent(NamedTuple):
    """What a force does to a bar of height 1 and shear modulus 1: a unit of force for a unit of width."""

    deflection: float
    """Mean displacement of the end across the bar [bar heights]."""
    turn: float
    """How far the end turns [rad]."""


def prepare(params: dict[str, Any]) -> Inputs:
    """What is left is given in cells, or as a ``part`` of the height."""
    given = dict(params)
    if "part" in given:
        given["left"] = given.pop("part") * given["cells"]
    return Inputs(**given)


def whole(inputs: Inputs, law: ForceLaw) -> LatticeModel:
    """Half of the bar."""
    shape = int(LENGTH * inputs.cells), inputs.half, inputs.cells
    index = np.stack(np.meshgrid(*map(np.arange, shape), indexing="ij"), axis=-1).reshape(-1, 3)
    return make_model(index[np.lexsort(index.T)], law=law)


def sheet(inputs: Inputs) -> Sheet:
    """The swept blade, in cells."""
    x, end, top = PLACE * inputs.cells + inputs.place, inputs.left, inputs.cells + 1
    return Sheet.swept([[(x, -1, top), (x, top, top)], [(x, -1, end), (x, top, end)]])


def lattice(inputs: Inputs, law: ForceLaw) -> LatticeModel:
    """Half of the bar, cut."""
    return part(whole(inputs, law), [sheet(inputs)], TissueSamples.everywhere()).model


def crossed_springs(model: LatticeModel, inputs: Inputs) -> Bool:
    """Springs that the blade's sheet crosses, or that begin on it and go on; shape (spring_count,)."""
    ends = model.node_index[model.spring_nodes].astype(float)
    ends = np.take_along_axis(ends, np.argsort(ends[:, :, :1], axis=1), axis=1)
    low, high = np.moveaxis(ends, 1, 0)
    x = PLACE * inputs.cells + inputs.place
    along = high[:, 0] - low[:, 0]
    way = np.divide(x - low[:, 0], along, out=np.full(len(along), -1.0), where=along > 0)
    is_high = low[:, 2] + way * (high[:, 2] - low[:, 2]) > inputs.left
    crossed: Bool = (way >= 0) & (way < 1) & is_high
    return crossed


def springs(inputs: Inputs) -> LatticeModel:
    return lattice(inputs, ForceLaw())


def element(inputs: Inputs) -> LatticeModel:
    return lattice(inputs, ForceLaw("element"))


def springs_removed(inputs: Inputs) -> LatticeModel:
    return _removed(inputs, ForceLaw())


def element_removed(inputs: Inputs) -> LatticeModel:
    return _removed(inputs, ForceLaw("element"))


def _removed(inputs: Inputs, law: ForceLaw) -> LatticeModel:
    model = whole(inputs, law)
    return model.without_springs(crossed_springs(model, inputs))


METHODS = {
    "springs": springs,
    "element": element,
    "springs_removed": springs_removed,
    "element_removed": element_removed,
}


def errors(inputs: Inputs, output: LatticeModel) -> dict[str, float]:
    """How far the bar bends and turns over what it should, the mass that is lost, cells and nodes that are more."""
    try:
        wanted = truth(inputs)
    except ImportError:
        raise MethodSkipped("it needs scikit-fem: pip install '.[dev]'") from None
    uncut, bent = whole(inputs, output.law), bent_lattice(output, inputs)
    mass = uncut.node_mass.sum(dtype=float)
    return {
        "deflection over truth - 1 [1]": bent.deflection / wanted.deflection - 1.0,
        "turn over truth - 1 [1]": bent.turn / wanted.turn - 1.0,
        "mass lost [1]": 1.0 - float(output.node_mass.sum(dtype=float)) / mass,
        "cells more [1]": float(output.cell_count - uncut.cell_count),
        "nodes more [1]": float(output.node_count - uncut.node_count),
    }


def bent_lattice(model: LatticeModel, inputs: Inputs) -> Bent:
    """What the force does to a lattice, half of a bar."""
    points, share = model.node_index / inputs.cells, _end_share(model, inputs)
    return _bent(points, share, pulled(model, inputs))


def pulled(model: LatticeModel, inputs: Inputs) -> Float64:
    """Displacement of a lattice, half of a bar [bar heights], shape (node_count, 3)."""
    # A cell is 1/n long, so that forces are n^2 as many as in the bar's units, and displacements n.
    matrix = stiffness(model) / inputs.cells
    return _pulled(matrix, model.node_index / inputs.cells, _end_share(model, inputs), inputs.half / inputs.cells)


def turned(model: LatticeModel, inputs: Inputs, force: float, step_count: int) -> Float64:
    """The same in large strain, under so many units of force, in steps."""
    n = inputs.cells
    load = np.zeros((model.node_count, 3))
    load[:, 2] = -force * n**2 * _end_share(model, inputs)
    held = _held(model.node_index / n, inputs.half / n)
    return equilibrium(model, load, lambda part: held, step_count)[0] / n


def _end_share(model: LatticeModel, inputs: Inputs) -> Float64:
    """Area of the end that each node stands for [bar heights^2], shape (node_count,)."""
    index = model.node_index
    is_rim = (index[:, 1:] == 0) | (index[:, 1:] == (inputs.half, inputs.cells))
    at_end = index[:, 0] == int(LENGTH * inputs.cells)
    share: Float64 = at_end * np.prod(np.where(is_rim, 0.5, 1.0), axis=1) / inputs.cells**2
    return share


def truth(inputs: Inputs) -> Bent:
    """The same by finite elements, extrapolated from two meshes with an error of second order."""
    fineness = 4 if not inputs.wide else 8
    at = inputs.place / inputs.cells, inputs.left / inputs.cells, inputs.half / inputs.cells
    coarse, fine = (np.array(finite_elements(*at, one)) for one in (fineness // 2, fineness))
    return Bent(*map(float, fine + (fine - coarse) / 3.0))


@cache
def finite_elements(place: float, left: float, half: float, fineness: int) -> Bent:
    """The same on one mesh, the cut ``place`` beyond the middle, with ``left`` under it and a width of twice ``half``.

    Elements get smaller towards the end of the cut.
    """
    from skfem import MeshHex

    from benchmarks.elasticity_truth import Solid

    x, z = PLACE + place, left
    near = np.linspace(0.0, 1.0, 3 * fineness + 1) ** 2
    mesh = MeshHex.init_tensor(
        np.concatenate([x - x * near[::-1], x + (LENGTH - x) * near[1:]]),
        np.linspace(0.0, half, max(round(fineness * half), 1) + 1),
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
    return _bent(solid.points, share, _pulled(solid.elastic_matrix(ForceLaw()), solid.points, share, half))


def _pulled(matrix: Any, points: Float64, share: Float64, half: float) -> Float64:
    """Displacement of half a bar under a force that is spread over its end, shape (n, 3)."""
    load = np.zeros(points.shape)
    load[:, 2] = -share
    return solve_linear(matrix, load, _held(points, half))[0]


def _held(points: Float64, half: float) -> Held:
    """The clamp, and the plane of symmetry, from positions of shape (n, 3)."""
    is_held = np.zeros(points.shape, np.bool_)
    is_held[points[:, 0] < 1e-9] = True
    is_held[points[:, 1] > half - 1e-9, 1] = True
    degrees = np.flatnonzero(is_held)
    return degrees, np.zeros(len(degrees))


def _bent(points: Float64, share: Float64, u: Float64) -> Bent:
    """How far the end goes, and how far the line turns that fits it best."""
    height = points[:, 2] - 0.5
    return Bent(float(-(share @ u[:, 2]) / share.sum()), float(share @ (height * u[:, 0]) / (share @ height**2)))
