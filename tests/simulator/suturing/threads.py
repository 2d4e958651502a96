"""Threads for the tests: tethers at random, and two blocks that only a stitch joins."""

from __future__ import annotations

import numpy as np

from heartcase.simulator.lattice.model import LatticeModel, make_model
from heartcase.simulator.lattice.tethers import NO_LIMIT, Tethers, whole_weights
from tests.simulator.lattices import block_cells

CELL_MM = 2.0


def random_tethers(model: LatticeModel, seed: int, *, pace: float = 0.0, slack: float = 0.0) -> Tethers:
    """Threads between means of up to eight nodes of a lattice; some slack, some drawn with a tension."""
    rng = np.random.default_rng(seed)
    count = int(rng.integers(1, 6))
    nodes = rng.integers(model.node_count, size=(count, 16)).astype(np.int32)
    weights = whole_weights(rng.dirichlet(np.full(8, 0.5), (count, 2)))
    shares = np.concatenate([-weights[:, 0], weights[:, 1]], axis=1)
    offset = np.einsum("tn,tnx->tx", shares, model.node_index[nodes].astype(float))
    far = np.linalg.norm(offset, axis=1)
    limited = rng.random(count) < 0.3
    return Tethers(
        nodes=nodes,
        shares=shares.astype(np.float32),
        offset=offset,
        stiffness=(rng.uniform(0.05, 1.0, count) * model.node_mass.min()).astype(np.float32),
        length=far * rng.uniform(0.0, 1.0 + slack, count),
        tension_most=np.where(limited, 0.05 * model.node_mass.min(), NO_LIMIT),
        pace=np.stack([pace * rng.uniform(-1, 1, count) * far, np.zeros(count)], axis=1),
    )


def two_blocks(*, gap: int = 2, size: int = 3, upper_fixed: bool = False) -> LatticeModel:
    """Two cubes of ``size`` cells, one over the other, ``gap`` cells apart; the top of the upper can be held."""
    lower = block_cells(size, size, size)
    cells = np.concatenate([lower, lower + np.array([0, 0, size + gap], np.int32)])
    model = make_model(cells, cell_mm=CELL_MM)
    if upper_fixed:
        model.node_is_fixed[model.node_index[:, 2] == 2 * size + gap] = True
    return model
