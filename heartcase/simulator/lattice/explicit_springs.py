"""Explicit springs: between any two nodes, with a stiffness and a rest length of their own (thesis 8.5.1).

They are few and outside the lattice: what a suture or a patch hangs on.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from heartcase.compiling.kernel import kernel
from heartcase.schemas.arrays import Bool, Float32, Float64, Int32

__all__ = ["ExplicitSprings", "SpringsByNode"]


@dataclass(frozen=True)
class ExplicitSprings:
    """Explicit springs, in grid units."""

    nodes: Int32
    """Nodes at both ends, shape (explicit_count, 2)."""
    stiffness: Float32
    """Stiffness [k], above zero, shape (explicit_count,)."""
    rest_length: Float32
    """Length at rest [cells], not below zero, shape (explicit_count,)."""

    @classmethod
    def none(cls) -> ExplicitSprings:
        """No explicit springs."""
        return cls(np.zeros((0, 2), np.int32), np.zeros(0, np.float32), np.zeros(0, np.float32))

    @property
    def count(self) -> int:
        """Number of explicit springs."""
        return len(self.nodes)

    def with_more(self, more: ExplicitSprings) -> ExplicitSprings:
        """These, then others."""
        return ExplicitSprings(
            np.concatenate([self.nodes, more.nodes]),
            np.concatenate([self.stiffness, more.stiffness]),
            np.concatenate([self.rest_length, more.rest_length]),
        )

    def without(self, removed: Bool) -> ExplicitSprings:
        """All but some, shape (explicit_count,)."""
        return ExplicitSprings(self.nodes[~removed], self.stiffness[~removed], self.rest_length[~removed])

    def pull(self, node_index: Int32, displacement: npt.ArrayLike) -> tuple[Float64, Float64]:
        """Pull on the first node of each, shape (explicit_count, 3), and stretch, shape (explicit_count,); float64."""
        u = np.asarray(displacement, dtype=np.float64)
        first, second = self.nodes.T
        d = node_index[second] - node_index[first] + (u[second] - u[first])
        length = np.linalg.norm(d, axis=1)
        stretch: Float64 = length - self.rest_length
        pull = np.divide(self.stiffness * stretch, length, out=np.zeros_like(length), where=length > 0)
        return pull[:, None] * d, stretch

    def forces(self, node_index: Int32, displacement: npt.ArrayLike) -> Float64:
        """Force on every node, shape (node_count, 3), float64."""
        pull, _ = self.pull(node_index, displacement)
        force = np.zeros((len(node_index), 3))
        np.add.at(force, self.nodes[:, 0], pull)
        np.subtract.at(force, self.nodes[:, 1], pull)
        return force

    def rate_bound(self, inverse_mass: Float32) -> float:
        """What they add at most to the largest eigenvalue omega^2 of the lattice, however it is deformed.

        A spring resists a movement of its ends by at most its stiffness. With that for all movements, the nonzero
        eigenvalues are those of a matrix with a row per spring whose entries sum up to what hangs on its two ends,
        over their masses (Gershgorin's theorem).
        """
        if not self.count:
            return 0.0
        total = np.bincount(self.nodes.ravel(), np.repeat(self.stiffness, 2), len(inverse_mass)) * inverse_mass
        return float(total[self.nodes].sum(axis=1).max())


@dataclass(frozen=True)
class SpringsByNode:
    """Springs by node, as the kernels read them.

    With o the vector to the other end before any movement and d the one after, D = d - o, a spring of rest length L
    pulls with k e d / (|d|^2 + L |d|), where e = (o + d) . D + c and c = |o|^2 - L^2: at rest it does not pull at all.
    """

    first: Int32
    """Where the springs of each node begin, and the last end, shape (node_count + 1,)."""
    other: Int32
    """Node at the other end, shape (2 * count,)."""
    offset: Float32
    """o, and L [cells], shape (2 * count, 4)."""
    excess: Float32
    """c [cells squared], shape (2 * count,)."""
    stiffness: Float32
    """k, shape (2 * count,)."""

    @classmethod
    def of(
        cls, springs: ExplicitSprings, node_index: Int32, more: tuple[Int32, Float32, Float64] | None = None
    ) -> SpringsByNode:
        """Sort explicit springs by node; each is there twice.

        More springs can be given: their nodes, shape (count, 2), stiffness [k] and rest length [cells], (count,).
        """
        nodes, stiffness, rest_length = springs.nodes, springs.stiffness, springs.rest_length.astype(np.float64)
        if more is not None:
            nodes = np.concatenate([nodes, more[0]])
            stiffness = np.concatenate([stiffness, more[1]])
            rest_length = np.concatenate([rest_length, more[2]])
        room = 2 * len(nodes)
        found = cls(
            first=np.zeros(len(node_index) + 1, np.int32),
            other=np.empty(room, np.int32),
            offset=np.empty((room, 4), np.float32),
            excess=np.empty(room, np.float32),
            stiffness=np.empty(room, np.float32),
        )
        if room:
            how = (found.first, found.other, found.offset, found.excess, found.stiffness)
            _sort_by_node(nodes, stiffness, rest_length, node_index, *how)
        return found

    def forces(self, displacement: npt.ArrayLike) -> Float64:
        """Force on every node [grid units], shape (node_count, 3), float64; displacements in cells."""
        u = np.asarray(displacement, dtype=np.float64)
        here = np.repeat(np.arange(len(u)), np.diff(self.first))
        way, rest_length = self.offset[:, :3].astype(np.float64), self.offset[:, 3].astype(np.float64)
        moved = u[self.other] - u[here]
        d = way + moved
        length = np.linalg.norm(d, axis=1)
        e = ((way + d) * moved).sum(axis=1) + self.excess
        pull = np.divide(self.stiffness * e, length * (length + rest_length), out=np.zeros_like(e), where=length > 0)
        force = np.zeros_like(u)
        np.add.at(force, here, pull[:, None] * d)
        return force


@kernel
def _sort_by_node(
    nodes: Int32,
    stiffness: Float32,
    rest_length: Float64,
    node_index: Int32,
    first: Int32,
    other: Int32,
    offset: Float32,
    excess: Float32,
    stiffnesses: Float32,
) -> None:
    """Write what SpringsByNode has of some springs; at each node those come first of which it is the first end."""
    for spring in range(len(nodes)):
        for end in range(2):
            first[nodes[spring, end] + 1] += 1
    for node in range(len(node_index)):
        first[node + 1] += first[node]
    filled = first.copy()
    for end in range(2):
        for spring in range(len(nodes)):
            here, there = nodes[spring, end], nodes[spring, 1 - end]
            place, length = filled[here], rest_length[spring]
            filled[here] += 1
            square = 0.0
            for axis in range(3):
                way = np.float64(node_index[there, axis] - node_index[here, axis])
                square += way * way
                offset[place, axis] = way
            other[place] = there
            offset[place, 3] = length
            more = square - length * length
            # What rounding leaves of zero is none.
            excess[place] = 0.0 if abs(more) < 1e-12 * (length * length) else more
            stiffnesses[place] = stiffness[spring]
