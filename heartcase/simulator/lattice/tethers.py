"""Tethers: threads between two weighted points of the lattice, that pull and never push. A stitch is one.

Each end is a weighted mean of nodes, so that what is pulled is a place in the tissue and not a node. With d the vector
from the first end to the second, a tether of stiffness k and length L has the tension k (|d| - L) where that is above
zero, and at most what its limit says: a thread that slips through the hand which draws it.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from heartcase.schemas.arrays import Float32, Float64, Int32, Int64

__all__ = ["END_NODES", "NO_LIMIT", "WEIGHT_STEPS", "Tethers", "TethersByNode", "whole_weights"]

END_NODES = 8
"""Most nodes of an end."""
NO_LIMIT = 1e30
"""Tension that no tether reaches: kernels that know no infinity can compare with it."""
WEIGHT_STEPS = 2**20
"""Weights are whole multiples of one over this: float32 holds them, and their sums, exactly."""


def whole_weights(weights: npt.ArrayLike) -> Float64:
    """Weights rounded to multiples of 1 / WEIGHT_STEPS that sum to one exactly, shape (..., any).

    Parameters
    ----------
    weights
        Weights that sum to one but for rounding, shape (..., any).
    """
    steps = np.round(np.asarray(weights, dtype=np.float64) * WEIGHT_STEPS)
    missing = WEIGHT_STEPS - steps.sum(axis=-1, keepdims=True)
    largest = steps.argmax(axis=-1)[..., None]
    np.put_along_axis(steps, largest, np.take_along_axis(steps, largest, axis=-1) + missing, axis=-1)
    whole: Float64 = steps / WEIGHT_STEPS
    return whole


@dataclass(frozen=True)
class Tethers:
    """Tethers, in grid units."""

    nodes: Int32
    """Nodes of the first end, then of the second, shape (count, 2 * END_NODES)."""
    shares: Float32
    """Minus the weights of the first end's nodes, then the weights of the second's, (count, 2 * END_NODES). Each row
    sums to zero exactly (:func:`whole_weights`): a tether gives the tissue no momentum."""
    offset: Float64
    """Vector from the first end to the second where no node is displaced [cells], shape (count, 3)."""
    stiffness: Float32
    """Stiffness [k], above zero, shape (count,)."""
    length: Float64
    """Length up to which they are slack [cells], not below zero, shape (count,)."""
    tension_most: Float64
    """Most tension [grid units of force], NO_LIMIT where there is no limit, shape (count,)."""
    pace: Float64
    """Change of length, and of the most tension, in each step of a row, shape (count, 2)."""

    @classmethod
    def none(cls) -> Tethers:
        """No tethers."""
        nothing = np.zeros(0)
        ends = (np.zeros((0, 2 * END_NODES), np.int32), np.zeros((0, 2 * END_NODES), np.float32))
        return cls(*ends, np.zeros((0, 3)), nothing.astype(np.float32), nothing, nothing, np.zeros((0, 2)))

    @property
    def count(self) -> int:
        """Number of tethers."""
        return len(self.nodes)

    def with_more(self, more: Tethers) -> Tethers:
        """These, then others."""
        one, other = vars(self), vars(more)
        return Tethers(**{name: np.concatenate([one[name], other[name]]) for name in one})

    def after(self, step_count: int) -> Tethers:
        """As they are after so many steps of a row."""
        length, most = np.stack([self.length, self.tension_most]) + step_count * self.pace.T
        return replace(self, length=length, tension_most=most)

    def vectors(self, displacement: npt.ArrayLike) -> Float64:
        """Vectors from the first ends to the second [cells], shape (count, 3)."""
        u = np.asarray(displacement)[self.nodes].astype(np.float64)
        vectors: Float64 = self.offset + np.einsum("tn,tnx->tx", self.shares.astype(np.float64), u)
        return vectors

    def tension(self, displacement: npt.ArrayLike) -> Float64:
        """Tension in each [grid units of force], shape (count,); displacements in cells, shape (node_count, 3)."""
        stretch = np.linalg.norm(self.vectors(displacement), axis=1) - self.length
        tension: Float64 = np.minimum(self.stiffness * np.maximum(stretch, 0.0), self.tension_most)
        return tension

    def forces(self, displacement: npt.ArrayLike) -> Float64:
        """Force on every node [grid units], shape (node_count, 3), float64; displacements in cells."""
        force = np.zeros(np.shape(displacement))
        if not self.count:
            return force
        d = self.vectors(displacement)
        distance = np.linalg.norm(d, axis=1)
        pull = np.divide(self.tension(displacement), distance, out=np.zeros_like(distance), where=distance > 0)
        each = -self.shares.astype(np.float64)[:, :, None] * (pull[:, None] * d)[:, None, :]
        np.add.at(force, self.nodes.ravel(), each.reshape(-1, 3))
        return force

    def energy(self, displacement: npt.ArrayLike) -> float:
        """Energy that they hold [grid units]: half k stretch^2, and beyond the most tension what that does."""
        if not self.count:
            return 0.0
        stretch = np.maximum(np.linalg.norm(self.vectors(displacement), axis=1) - self.length, 0.0)
        tension = self.tension(displacement)
        return float((tension * stretch - 0.5 * tension**2 / self.stiffness).sum())

    def rate_bounds(self, inverse_mass: Float32) -> Float64:
        """Of each, a bound of what they add together to omega^2 where it takes part in a movement, shape (count,).

        The largest is a bound for the lattice, however it is deformed. A tether resists a movement of its ends by at
        most its stiffness in every direction: along itself by k or nothing, across itself by tension over length, which
        is at most k. Its stiffness matrix is then at most k b b^T for each axis, with b its shares. With all of them,
        the nonzero eigenvalues of the sum over the masses are those of the matrix b_a^T M^-1 b_b k_b, and none is
        larger than the largest sum of a row's absolute values (Gershgorin's theorem). Of a tether by itself that is
        k (sum w^2/m + sum v^2/m), with w and v the weights of its ends.
        """
        if not self.count:
            return np.zeros(0)
        share = np.abs(self.shares.astype(np.float64))
        stiffness = np.repeat(self.stiffness.astype(np.float64), share.shape[1])
        at_node = np.bincount(self.nodes.ravel(), stiffness * share.ravel(), len(inverse_mass)) * inverse_mass
        bounds: Float64 = (share * at_node[self.nodes]).sum(axis=1)
        return bounds

    def rate_bound(self, inverse_mass: Float32) -> float:
        """What they add at most to the largest eigenvalue omega^2 of the lattice (:meth:`rate_bounds`)."""
        return float(self.rate_bounds(inverse_mass).max(initial=0.0))

    def shapes(self) -> Float32:
        """What kernels read of each: offset, stiffness, length, most tension and both paces, shape (count, 8)."""
        columns = np.stack([self.stiffness.astype(np.float64), self.length, self.tension_most], axis=1)
        return np.concatenate([self.offset, columns, self.pace], axis=1).astype(np.float32)


@dataclass(frozen=True)
class TethersByNode:
    """Which tethers pull at which node."""

    nodes: Int64
    """Nodes at which one pulls, ascending, shape (node_count,)."""
    first: Int64
    """Where those of each begin, and the last end, shape (node_count + 1,)."""
    number: Int64
    """Tether, shape (any,)."""
    share: Float32
    """The node's share in it, shape (any,)."""

    @classmethod
    def of(cls, tethers: Tethers) -> TethersByNode:
        """Sort tethers by node."""
        tether, place = np.nonzero(tethers.shares)
        node = tethers.nodes[tether, place].astype(np.int64)
        order = np.argsort(node, kind="stable")
        nodes, first = np.unique(node[order], return_index=True)
        return cls(
            nodes, np.append(first, len(order)).astype(np.int64), tether[order], tethers.shares[tether, place][order]
        )
