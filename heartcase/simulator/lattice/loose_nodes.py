"""Loose nodes: point masses of no cell that are stepped with the lattice, such as those of a patch.

They come after all other nodes, and hang together by explicit springs and on the tissue by tethers alone. Their places
at rest are ones of the lattice above all others, where no springs or cells are: they mean nothing but that engines find
lanes for them. Where a loose node really is, its displacement says.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from heartcase.schemas.arrays import Bool, Float32, Int32
from heartcase.simulator.lattice.explicit_springs import ExplicitSprings
from heartcase.simulator.lattice.model import LatticeModel

__all__ = ["loose_first", "tissue_displacement", "with_loose_nodes", "with_loose_of", "without_loose_nodes"]

_GAP = 2
"""Empty layers below those of loose nodes."""
_ROW = 8
"""Loose nodes in a row along i and along j."""


def loose_first(model: LatticeModel) -> int:
    """Number of the first loose node."""
    return model.node_count - model.loose_count


def tissue_displacement(model: LatticeModel, displacement: Float32) -> Float32:
    """Displacements of the nodes that are tissue, shape (any, 3): those of loose nodes are no movement of anything."""
    return displacement[: loose_first(model)]


def with_loose_nodes(model: LatticeModel, mass: Float32) -> LatticeModel:
    """The lattice with more loose nodes, of some masses [full cells], shape (count,)."""
    number = np.arange(len(mass))
    low, high = model.node_index.min(axis=0), model.node_index.max(axis=0)
    layer = high[2] + (_GAP if not model.loose_count else 1) + number // _ROW**2
    index = np.stack([low[0] + number % _ROW, low[1] + number // _ROW % _ROW, layer], axis=1)
    return _appended(model, index.astype(np.int32), mass, model.loose_count + len(mass))


def with_loose_of(model: LatticeModel, other: LatticeModel) -> LatticeModel:
    """A lattice without loose nodes with those of another, which comes from the same; explicit springs are left out."""
    count = other.loose_count
    if not count:
        return model
    return _appended(model, other.node_index[-count:], other.node_mass[-count:], count)


def without_loose_nodes(model: LatticeModel, removed: Bool | None = None) -> LatticeModel:
    """The lattice without some of its loose nodes, or any, and the explicit springs that hang on them.

    Parameters
    ----------
    model
        The lattice.
    removed
        True for each loose node that goes, shape (loose_count,); all when left out.
    """
    if not model.loose_count:
        return model
    gone = np.zeros(model.node_count, np.bool_)
    gone[loose_first(model) :] = True if removed is None else removed
    number = (np.cumsum(~gone) - 1).astype(np.int32)
    one, other = model.explicit.nodes.T
    kept = model.explicit.without(gone[one] | gone[other])
    return replace(
        model,
        node_index=model.node_index[~gone],
        node_mass=model.node_mass[~gone],
        node_is_fixed=model.node_is_fixed[~gone],
        explicit=ExplicitSprings(number[kept.nodes], kept.stiffness, kept.rest_length),
        loose_count=model.loose_count - int(gone.sum()),
    )


def _appended(model: LatticeModel, index: Int32, mass: Float32, loose_count: int) -> LatticeModel:
    return replace(
        model,
        node_index=np.concatenate([model.node_index, index]),
        node_mass=np.concatenate([model.node_mass, np.asarray(mass, np.float32)]),
        node_is_fixed=np.concatenate([model.node_is_fixed, np.zeros(len(index), np.bool_)]),
        loose_count=loose_count,
    )
