"""Patches: sheets of a few nodes of their own, that springs hold together and threads hold at the tissue.

A patch is a net of springs along the edges of its triangles, with E t times the sum of the areas beside an edge over
its length squared each (Van Gelder, J. Graph. Tools 3, 1998): a sheet of Young's modulus E and thickness t whose
Poisson's ratio is 1/3, exactly so for triangles of equal sides. It does not resist bending. Its nodes have the mass of
the sheet, or as much more as the time step needs for its stiffness: that makes it slower, and no weaker.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from heartcase.schemas.arrays import Float32, Float64, Int32, Int64
from heartcase.simulator.cutting.cuts import Cuts
from heartcase.simulator.dynamics.step_size import explicit_rate_limit
from heartcase.simulator.lattice.explicit_springs import ExplicitSprings
from heartcase.simulator.lattice.loose_nodes import loose_first, with_loose_nodes, without_loose_nodes
from heartcase.simulator.lattice.model import LatticeModel
from heartcase.simulator.lattice.state import PreciseState, State
from heartcase.simulator.lattice.tethers import END_NODES, NO_LIMIT, Tethers
from heartcase.simulator.patching.flat_sheets import FlatSheet
from heartcase.simulator.suturing.places import Place, cell_of, nodes_and_weights

__all__ = [
    "DENSITY_KG_M3",
    "Patch",
    "PatchState",
    "bind_rim",
    "edges_of",
    "patch_springs",
    "patch_state",
    "rim_tethers",
    "with_nodes_of",
    "with_patch",
    "without_patch",
]

DENSITY_KG_M3 = 1100.0
"""Density of a patch."""
_RATE_PART = 0.3
"""Part of what the step leaves for springs beside the lattice that a patch's may take."""


@dataclass(eq=False)
class Patch:
    """A patch in the tissue."""

    name: str
    """Its name."""
    sheet: FlatSheet
    """What was cut; the first vertices are its rim."""
    places: tuple[Place, ...]
    """Where the stitches of the rim go through the tissue, shape (rim_count,)."""
    stiffness_n_m: float
    """Young's modulus times thickness, N/m."""
    thickness_mm: float
    """Thickness, mm."""
    first: int
    """First of its nodes among the loose nodes of the lattice."""
    stitch_stiffness: float = 0.0
    """Stiffness of each stitch of its rim [k]."""
    nodes: Int32 | None = None
    """Nodes that the stitches pull at, shape (rim_count, 16): the tissue's, then the rim's own."""
    shares: Float32 | None = None
    """Their shares, shape (rim_count, 16)."""

    @property
    def node_count(self) -> int:
        """Number of its nodes."""
        return len(self.sheet.flat_mm)

    def nodes_in(self, model: LatticeModel) -> Int64:
        """Its nodes in a lattice, shape (node_count,)."""
        return loose_first(model) + self.first + np.arange(self.node_count)


@dataclass(frozen=True)
class PatchState:
    """A patch at a moment: a surface of its own, and the forces along its rim."""

    name: str
    """Its name."""
    vertices_mm: Float64
    """Where its vertices are, LPS mm, shape (vertex_count, 3)."""
    normals: Float64
    """Unit normals, shape (vertex_count, 3)."""
    triangles: Int32
    """Vertex numbers, shape (triangle_count, 3)."""
    stitches_mm: Float64
    """Where the stitches of its rim go through the tissue, LPS mm, shape (rim_count, 3)."""
    forces_n: Float64
    """Force in each of these stitches, N, shape (rim_count,)."""
    stretch_most: float
    """Largest stretch of one of its edges, over the length that it was cut to."""
    area_mm2: float
    """Area that was cut, mm2."""
    distortion: float
    """How far the largest or least stretch between the flat sheet and the sheet in space was from 1 when it was cut."""
    mass_g: float
    """Mass of its nodes, g: more than the sheet's where the time step needs it."""
    kind: str = "patch"
    """What kind of surface it is."""


def edges_of(triangles: Int32) -> Int32:
    """Edges of a sheet, each once, shape (edge_count, 2)."""
    ends: Int32 = np.unique(np.sort(triangles[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2), axis=1), axis=0)
    return ends


def patch_springs(sheet: FlatSheet, stiffness: float) -> tuple[Int32, Float64, Float64]:
    """Edges, stiffness and length at rest (mm) of a sheet's springs, for E t in any unit; shapes (edge_count, ...)."""
    flat, triangles = sheet.flat_mm, sheet.triangles
    edges = edges_of(triangles)
    one, other = flat[triangles[:, 1]] - flat[triangles[:, 0]], flat[triangles[:, 2]] - flat[triangles[:, 0]]
    area = 0.5 * np.abs(one[:, 0] * other[:, 1] - one[:, 1] * other[:, 0])
    sides = np.sort(triangles[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2), axis=1)
    count = len(flat)
    number = np.searchsorted(edges[:, 0] * count + edges[:, 1], sides[:, 0] * count + sides[:, 1])
    beside = np.bincount(number, np.repeat(area, 3), minlength=len(edges))
    length = np.linalg.norm(flat[edges[:, 1]] - flat[edges[:, 0]], axis=1)
    return edges, stiffness * beside / length**2, length


def with_patch(
    model: LatticeModel, uncut: LatticeModel, sheet: FlatSheet, stiffness_n_m: float, thickness_mm: float, step_s: float
) -> LatticeModel:
    """A lattice with the nodes and springs of a patch more.

    Parameters
    ----------
    model
        The lattice.
    uncut
        The same before all cuts, and without loose nodes.
    sheet
        What was cut.
    stiffness_n_m, thickness_mm
        Young's modulus times thickness, N/m; thickness, mm.
    step_s
        Time step, s.
    """
    edges, stiffness, length = patch_springs(sheet, stiffness_n_m * model.units.length_m / model.units.force_n)
    flat, triangles = sheet.flat_mm, sheet.triangles
    one, other = flat[triangles[:, 1]] - flat[triangles[:, 0]], flat[triangles[:, 2]] - flat[triangles[:, 0]]
    area = 0.5 * np.abs(one[:, 0] * other[:, 1] - one[:, 1] * other[:, 0])
    of_sheet = np.bincount(triangles.ravel(), np.repeat(area / 3, 3), minlength=len(flat))
    own_mass = of_sheet * thickness_mm * 1e-9 * DENSITY_KG_M3 / model.units.mass_kg
    # Two ends of a spring add what hangs on each over its mass to omega^2 (ExplicitSprings.rate_bound).
    hangs = np.bincount(edges.ravel(), np.repeat(stiffness, 2), minlength=len(flat))
    limit = _RATE_PART * explicit_rate_limit(uncut, step_s)
    needed = 2.0 * hangs / limit if limit > 0.0 else np.full(len(flat), np.inf)
    mass = (np.maximum(own_mass, needed) * (1.0 + 1e-6)).astype(np.float32)
    wider = with_loose_nodes(model, mass)
    first = model.node_count
    springs = ExplicitSprings(
        (first + edges).astype(np.int32), stiffness.astype(np.float32), (length / model.cell_mm).astype(np.float32)
    )
    return replace(wider, explicit=wider.explicit.with_more(springs))


def with_nodes_of(state: State, model: LatticeModel, sheet: FlatSheet) -> State:
    """A state with the nodes of a patch more, the last of a lattice, where its sheet spans the outline, at rest."""
    count = len(sheet.flat_mm)
    places = model.geometry.world_to_index(sheet.spanned_mm) + 0.5
    more = places - model.node_index[-count:]
    still = np.zeros_like(more)
    if isinstance(state, PreciseState):
        return PreciseState.of(
            np.concatenate([state.precise_displacement, more]),
            np.concatenate([state.precise_velocity, still]),
            state.step_count,
        )
    return State(
        np.concatenate([state.displacement, more.astype(np.float32)]),
        np.concatenate([state.velocity, still.astype(np.float32)]),
        state.step_count,
    )


def without_patch(model: LatticeModel, first: int, count: int) -> LatticeModel:
    """A lattice without some loose nodes and their springs."""
    removed = np.zeros(model.loose_count, np.bool_)
    removed[first : first + count] = True
    return without_loose_nodes(model, removed)


def bind_rim(patch: Patch, model: LatticeModel, cuts: Cuts | None) -> None:
    """Bind the stitches of a patch's rim in the lattice that some cuts leave."""
    rim = patch.nodes_in(model)[: patch.sheet.rim_count]
    own = np.repeat(rim[:, None], END_NODES, axis=1)
    share = np.zeros((len(rim), END_NODES))
    share[:, 0] = 1.0
    ends = [nodes_and_weights(model, cell_of(place, cuts), place.local) for place in patch.places]
    patch.nodes = np.concatenate([np.stack([nodes for nodes, _ in ends]), own], axis=1).astype(np.int32)
    patch.shares = np.concatenate([-np.stack([weights for _, weights in ends]), share], axis=1).astype(np.float32)


def rim_tethers(model: LatticeModel, patches: Sequence[Patch]) -> Tethers:
    """The stitches of the rims of patches as the engines take them: threads of no length."""
    if not patches:
        return Tethers.none()
    nodes = np.concatenate([patch.nodes for patch in patches if patch.nodes is not None])
    shares = np.concatenate([patch.shares for patch in patches if patch.shares is not None])
    stiffness = np.concatenate([np.full(patch.sheet.rim_count, patch.stitch_stiffness) for patch in patches])
    count = len(nodes)
    offset = np.einsum("tn,tnx->tx", shares.astype(np.float64), model.node_index[nodes].astype(np.float64))
    nothing, no_limit = np.zeros(count), np.full(count, NO_LIMIT)
    return Tethers(nodes, shares, offset, stiffness.astype(np.float32), nothing, no_limit, np.zeros((count, 2)))


def patch_state(patch: Patch, model: LatticeModel, displacement: npt.ArrayLike) -> PatchState:
    """A patch as it is in a state of the lattice; displacements in cells, shape (node_count, 3)."""
    u = np.asarray(displacement)
    nodes, sheet = patch.nodes_in(model), patch.sheet
    vertices = model.geometry.index_to_world(model.node_index[nodes] + u[nodes].astype(np.float64) - 0.5)
    corners = vertices[sheet.triangles]
    across = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normals = np.zeros_like(vertices)
    np.add.at(normals, sheet.triangles, across[:, None])
    normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-300)
    assert patch.nodes is not None
    assert patch.shares is not None
    half = patch.nodes[:, :END_NODES]
    at = model.node_index[half] + u[half].astype(np.float64)
    places = np.einsum("tn,tnx->tx", -patch.shares[:, :END_NODES].astype(np.float64), at)
    edges, _, length = patch_springs(sheet, 1.0)
    now = np.linalg.norm(vertices[edges[:, 1]] - vertices[edges[:, 0]], axis=1)
    return PatchState(
        name=patch.name,
        vertices_mm=vertices,
        normals=normals,
        triangles=sheet.triangles,
        stitches_mm=model.geometry.index_to_world(places - 0.5),
        forces_n=rim_tethers(model, [patch]).tension(u) * model.units.force_n,
        stretch_most=float((now / length).max()),
        area_mm2=sheet.area_mm2,
        distortion=max(sheet.stretch_most - 1.0, 1.0 - sheet.stretch_least),
        mass_g=float(model.node_mass[nodes].sum(dtype=np.float64) * model.units.mass_kg * 1e3),
    )
