"""Lattices for the tests: solid blocks, and cells, coverage and stiffness at random."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from hypothesis import strategies as st

from heartcase.schemas.bundle.lattice import cell_nodes
from heartcase.schemas.geometry import Geometry
from heartcase.simulator.cutting.blade_sheet import Sheet
from heartcase.simulator.cutting.parted_lattice import part
from heartcase.simulator.cutting.tissue_samples import TissueSamples
from heartcase.simulator.engine.shared.contact import probe_row
from heartcase.simulator.lattice.explicit_springs import ExplicitSprings
from heartcase.simulator.lattice.model import LatticeModel, make_model

EPS = float(np.finfo(np.float32).eps)


def block_cells(ni: int, nj: int, nk: int) -> np.ndarray:
    return np.array([(i, j, k) for k in range(nk) for j in range(nj) for i in range(ni)], np.int32)


def block(ni: int, nj: int, nk: int, *, fix_base: bool = False, **options) -> LatticeModel:
    cells = block_cells(ni, nj, nk)
    fixed = cell_nodes(cells)[0][:, 2] == 0 if fix_base else False
    return make_model(cells, fixed=fixed, **options)


def oblique_geometry(shape=(8, 8, 8), cell_mm: float = 2.5) -> Geometry:
    """A right-handed frame along no axis."""
    rotation, upper = np.linalg.qr(np.random.default_rng(5).normal(size=(3, 3)))
    rotation *= np.sign(np.diag(upper))
    rotation[:, 2] *= np.sign(np.linalg.det(rotation))
    return Geometry.of(shape=shape, origin_mm=(-40.0, 310.0, 75.0), spacing_mm=(cell_mm,) * 3, direction=rotation)


@st.composite
def random_models(draw, *, fixed: bool = True, materials: bool = True, size_max=(20, 4, 4)) -> LatticeModel:
    """Any cells of a box over blocks of lanes and the origin; any coverage, stiffness, density, fixed nodes."""
    rng = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    size = [draw(st.integers(1, limit)) for limit in size_max]
    corner = [draw(st.integers(-9, 9)) for _ in range(3)]
    cells = block_cells(*size) + np.array(corner, np.int32)
    kept = rng.random(len(cells)) < draw(st.floats(0.1, 1.0))
    kept[rng.integers(len(cells))] = True
    cells = cells[kept]
    node_count = len(cell_nodes(cells)[0])
    return make_model(
        cells,
        coverage=rng.uniform(0.02, 1.0, len(cells)),
        stiffness_kpa=rng.uniform(5.0, 100.0, len(cells)) if materials else 30.0,
        density_kg_m3=rng.uniform(900.0, 1200.0, len(cells)) if materials else 1060.0,
        fixed=(rng.random(node_count) < 0.1) if fixed else False,
        cell_mm=draw(st.floats(0.5, 5.0)),
    )


@st.composite
def cut_models(draw, *, size_max=(20, 5, 4), law=None) -> LatticeModel:
    """Lattices of which sheets at random have parted some cells."""
    model = draw(random_models(materials=False, size_max=size_max))
    model = model if law is None else model.with_law(law)
    rng = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    sheets = []
    for _ in range(draw(st.integers(1, 4))):
        middle = model.node_index[rng.integers(model.node_count)] + rng.uniform(-0.5, 0.5, 3)
        along, across = rng.uniform(-6, 6, (2, 3)) * rng.choice([0.3, 1.0, 2.0])
        corners = middle + np.array([[-along - across, along - across], [across - along, along + across]])
        sheets.append(Sheet.swept(corners))
    return part(model, sheets, TissueSamples.everywhere()).model


def random_field(model: LatticeModel, seed: int, scale: float) -> np.ndarray:
    return (np.random.default_rng(seed).uniform(-scale, scale, (model.node_count, 3))).astype(np.float32)


def random_moments(cell_count: int, rng: np.random.Generator) -> np.ndarray:
    """Moments of cells whose tissue is a few boxes at random, shape (cell_count, 9)."""
    box_count = 3
    low, high = np.sort(rng.uniform(-0.5, 0.5, (2, cell_count, box_count, 3)), axis=0)
    volume = np.prod(high - low, axis=2) + 1e-6
    part = (volume / volume.sum(axis=1, keepdims=True))[:, :, None]
    middle = (low + high) / 2
    square = middle**2 + (high - low) ** 2 / 12
    product = np.roll(middle, -1, axis=2) * np.roll(middle, -2, axis=2)
    means = [(part * values).sum(axis=1) for values in (middle, square, product)]
    return np.concatenate(means, axis=1).astype(np.float32)


def random_shares(cell_count: int, rng: np.random.Generator) -> np.ndarray:
    """Any parts of cells that are strained by the means around their corners, none in some, shape (cell_count, 8)."""
    part = rng.uniform(0.0, 0.97, cell_count) * (rng.random(cell_count) < 0.8)
    return (part[:, None] * rng.dirichlet(np.full(8, 0.5), cell_count)).astype(np.float32)


def stiffness_matrix(model: LatticeModel, displacement: np.ndarray | None = None) -> np.ndarray:
    """Minus the derivative of the reference forces, at rest or where displaced, by central differences, (3 n, 3 n)."""
    from heartcase.simulator.forces.reference import elastic_forces

    n = 3 * model.node_count
    step = 1e-5
    at = np.zeros(n) if displacement is None else displacement.ravel()
    matrix = np.empty((n, n))
    for column in range(n):
        push = np.zeros(n)
        push[column] = step
        ahead = elastic_forces(model, (at + push).reshape(-1, 3))
        behind = elastic_forces(model, (at - push).reshape(-1, 3))
        matrix[:, column] = (behind - ahead).ravel() / (2 * step)
    return matrix


def tied(model: LatticeModel, seed: int) -> LatticeModel:
    """The model with explicit springs between some of its nodes."""
    rng = np.random.default_rng(seed)
    count = int(rng.integers(1, 6))
    first = rng.integers(model.node_count, size=count)
    second = (first + rng.integers(1, model.node_count, size=count)) % model.node_count
    springs = ExplicitSprings(
        np.stack([first, second], axis=1).astype(np.int32),
        rng.uniform(0.05, 1.0, count).astype(np.float32) * np.float32(model.node_mass.min()),
        rng.uniform(0.0, 2.0, count).astype(np.float32),
    )
    return replace(model, explicit=springs)


def random_probes(model: LatticeModel, seed: int) -> np.ndarray:
    """A ball and an ellipsoid that move through some nodes of a lattice."""
    rng = np.random.default_rng(seed)
    rows = []
    for _ in range(2):
        turn = np.linalg.qr(rng.normal(size=(3, 3)))[0]
        centre = model.node_index[rng.integers(model.node_count)] + rng.uniform(-0.5, 0.5, 3)
        rows.append(probe_row(centre, rng.uniform(-0.02, 0.02, 3), rng.uniform(0.7, 1.5, 3), turn))
    return np.stack(rows)
