"""Scripts at random of cuts into moving tissue, and what has to hold of every one of them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from heartcase.schemas.arrays import Float64, Int64
from heartcase.schemas.errors import SimulationError
from heartcase.simulator.cutting.descent import descent_of
from heartcase.simulator.cutting.tissue_samples import TissueSamples
from heartcase.simulator.forces.cell_forces import cell_energies
from heartcase.simulator.forces.reference import elastic_energy
from heartcase.simulator.lattice.model import LatticeModel
from heartcase.simulator.lattice.moduli import ForceLaw
from heartcase.simulator.lattice.state import State
from heartcase.simulator.simulation import Simulation
from heartcase.simulator.surface.deform import SurfaceModel
from tests.simulator.lattices import block
from tests.simulator.surface_splitting.surfaces import box, check_closed, check_ties, hung

ROUNDING = 2e-6
"""Of an energy in 32 bits, added up over the cells."""


@dataclass(frozen=True)
class Operated:
    """What a script came to."""

    cut_count: int
    """Cuts that met tissue, or void alone."""
    refused_count: int
    """Cuts that were refused."""
    mixed_count: int
    """Cuts by which tissue changed sides: near the end of another."""
    cut_face_count: int
    """Triangles of cut faces at the end."""
    part_count: int
    """Parts of the surface at the end."""
    mixed_rise: float
    """Largest rise of the elastic energy by a cut by which tissue changed sides, of itself."""
    elastic_rise: float
    """The same of all other cuts."""


def block_with_surface(rng: np.random.Generator, law: ForceLaw) -> tuple[LatticeModel, SurfaceModel, TissueSamples]:
    """Up to 6 x 4 x 4 full cells on a fixed base, and a finer surface around them."""
    shape = rng.integers(2, [7, 5, 5])
    model = block(*shape, fix_base=True, law=law)
    places, triangles = box(tuple(2 * shape), shape.astype(float))
    return model, hung(model, places, triangles), TissueSamples.everywhere()


def random_blade(rng: np.random.Generator, low: Float64, high: Float64) -> Float64:
    """Poses of a blade somewhere around a box: smooth, on a grid, to and fro or twisted; [the box's units].

    Shape (pose_count, point_count, 3).
    """
    size, (poses, points) = high - low, rng.integers(2, [5, 4])

    def numbers(*shape):
        found = rng.uniform(-0.3, 1.3, (*shape, 3))
        return low + size * (np.round(found * 4) / 4 if kind == 1 else found)

    kind = rng.integers(4)
    if kind == 3:
        return numbers(poses, points)
    along, across = (numbers(2) - low for _ in range(2))
    lengths = np.linspace(0, 1, points)
    ways = rng.uniform(0, 1, poses) if kind == 2 else np.linspace(0, 1, poses)
    blade = along[0] + lengths[:, None] * (along[1] - along[0])
    return low + blade[None] + ways[:, None, None] * (across[1] - across[0])


def operate(
    simulation: Simulation,
    rng: np.random.Generator,
    blades: list[Float64],
    *,
    hand_mm: Float64 | None = None,
    turned_max: float = 0.0,
    steps: int = 25,
) -> Operated:
    """Pull, cut, go on, and undo, blade by blade, with everything checked that has to hold at each cut.

    A hand pulls at a place, LPS mm; at the last free node where none is given. ``turned_max`` says how far a vertex
    that follows a normal between nodes may turn at the moment of a cut [cells].
    """
    cut_count = refused_count = 0
    mixed_count, rises = 0, [0.0, 0.0]
    model, uncut = simulation.model, simulation.surface
    last = model.rest_positions_mm()[np.flatnonzero(~model.node_is_fixed)[-1]]
    hand = simulation.grab(last if hand_mm is None else hand_mm, 1.6 * model.cell_mm)
    for blade in blades:
        simulation.lead(hand, rng.normal(0, 0.4 * model.cell_mm, 3))
        simulation.step(steps)
        before = simulation.snapshot()
        shown = all_bytes(simulation)
        at_rest = bool(rng.integers(2))
        try:
            found, is_refined = check_cut(simulation, blade, at_rest, uncut, turned_max)
            rises[is_refined] = max(rises[is_refined], found)
            mixed_count += not is_refined
        except SimulationError:
            refused_count += 1
            assert all_bytes(simulation) == shown
            continue
        cut_count += 1
        after = all_bytes(simulation)
        simulation.step(3)
        simulation.restore(before)
        assert all_bytes(simulation) == shown
        if rng.random() < 0.25:
            continue
        simulation.cut(blade, at_rest=at_rest)
        assert all_bytes(simulation) == after
    simulation.step(steps)
    assert np.isfinite(simulation.positions_mm()).all()
    faces = parts = 0
    if simulation.split is not None:
        check_surface(simulation, uncut)
        faces = int(simulation.split.triangle_is_cut_face.sum())
        parts = int(simulation.split.triangle_part.max()) + 1
    return Operated(cut_count, refused_count, mixed_count, faces, parts, *rises)


def all_bytes(simulation: Simulation) -> tuple[bytes, ...]:
    """The state, the lattice and the surface now."""
    state, model, surface = simulation.state, simulation.model, simulation.surface
    lattice = (model.node_index, model.node_mass, model.cell_corners, model.cell_moments, model.cell_coverage)
    faces = (surface.triangles, surface.triangle_nodes, surface.weights, simulation.surface_now().vertices_mm)
    arrays = (state.displacement, state.velocity, *lattice, *faces)
    return tuple(np.ascontiguousarray(array).tobytes() for array in arrays)


def check_cut(
    simulation: Simulation, blade: Float64, at_rest: bool, uncut: SurfaceModel, turned_max: float
) -> tuple[float, bool]:
    """Cut, and check what the moment of the cut may not change; by how much of itself the energy rises,
    and whether no tissue changed sides. As of :func:`operate`."""
    model, state, elastic = simulation.model, simulation.state, simulation.energy().elastic_j
    springs = energy_of_springs(model, state)
    momentum, kinetic, speed = movement(model, state)
    vertices = simulation.surface_now().vertices_mm
    before, whole = simulation.cuts, simulation.split is None
    simulation.cut(blade, at_rest=at_rest)
    cut, now = simulation.model, simulation.state
    assert now.step_count == state.step_count
    # Each node lies where its place lay, and where tissue changes sides, at the centre of what was at several.
    old = None if before is None else before.parted
    mixed = np.unique(descent_of(simulation.cuts.uncut, old, simulation.cuts.parted).mixed)
    is_refined = len(mixed) == 0
    assert is_refined or not whole
    assert places(cut, now, leaving_out=mixed) <= places(model, state)
    assert not is_refined or places(cut, now) == places(model, state)
    moments = [one.node_mass.astype(float) @ at.displacement.astype(float) for one, at in ((model, state), (cut, now))]
    np.testing.assert_allclose(moments[1], moments[0], atol=1e-6 * model.node_mass.sum(dtype=float))
    mass = model.node_mass.sum(dtype=float)
    np.testing.assert_allclose(cut.node_mass.sum(dtype=float), mass, rtol=1e-6)
    carried, left, _ = movement(cut, now)
    np.testing.assert_allclose(carried, momentum, atol=1e-6 * speed)
    assert left <= kinetic * (1 + ROUNDING)
    rise = simulation.energy().elastic_j / elastic - 1
    # The guard of slivers' corners may get stronger, and elements share strain with fewer; springs are only shared out.
    assert not is_refined or energy_of_springs(cut, now) <= springs * (1 + ROUNDING)
    if simulation.split is None:
        return rise, is_refined
    check_surface(simulation, uncut)
    if whole:
        kept = simulation.split.vertex_cells[: len(vertices)] < 0
        bent = uncut.curvature != 0
        shown = simulation.surface_now().vertices_mm[: len(vertices)]
        np.testing.assert_array_equal(shown[kept & ~bent], vertices[kept & ~bent])
        # Those that follow a normal between nodes turn a little where they lost springs.
        moved = np.linalg.norm((shown - vertices)[kept & bent], axis=1)
        assert moved.max(initial=0.0) <= turned_max * model.cell_mm
    return rise, is_refined


def energy_of_springs(model: LatticeModel, state: State) -> float:
    """Elastic energy without that of cells, in units of the grid."""
    return elastic_energy(model, state.displacement) - float(cell_energies(model, state.displacement).sum())


def movement(model: LatticeModel, state: State) -> tuple[Float64, float, float]:
    """Momentum, kinetic energy, and the sum of all momenta's sizes, in units of the grid."""
    momenta = model.node_mass[:, None] * state.velocity.astype(float)
    return momenta.sum(axis=0), float((momenta * state.velocity).sum()), float(np.linalg.norm(momenta, axis=1).sum())


def places(model: LatticeModel, state: State, leaving_out: Int64 | tuple[()] = ()) -> set[tuple[bytes, bytes]]:
    """Where every node lies at rest and now, each once, but for some nodes."""
    kept = np.delete(np.arange(model.node_count), np.asarray(leaving_out, dtype=np.int64))
    columns = (model.node_index[kept], state.displacement[kept])
    return {tuple(np.ascontiguousarray(one).tobytes() for one in row) for row in zip(*columns, strict=True)}


def check_surface(simulation: Simulation, uncut: SurfaceModel) -> None:
    """Closed and manifold, lips in one place, each vertex tied to one piece and to its own part of the tissue."""
    split, model = simulation.split, simulation.model
    check_closed(split.weld[split.surface.triangles])
    shown = simulation.surface_now().vertices_mm.astype(float)
    assert np.abs(shown[split.weld] - shown).max(initial=0.0) <= 1e-6 * model.cell_mm
    check_ties(model, split, uncut)
