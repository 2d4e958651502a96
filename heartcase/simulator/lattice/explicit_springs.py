"""Explicit springs: between any two nodes, with a stiffness and a rest length of their own (thesis 8.5.1).

They are few and outside the lattice: what a suture or a patch hangs on.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

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
        here, there = np.concatenate([nodes, nodes[:, ::-1]]).T
        order = np.argsort(here, kind="stable")
        here, there, length = here[order], there[order], np.tile(rest_length, 2)[order]
        way = (node_index[there] - node_index[here]).astype(np.float64)
        excess = (way**2).sum(axis=1) - length**2
        count = np.bincount(here, minlength=len(node_index))
        return cls(
            first=np.concatenate([[0], np.cumsum(count)]).astype(np.int32),
            other=there.astype(np.int32),
            offset=np.column_stack([way, length]).astype(np.float32),
            # What rounding leaves of zero is none.
            excess=np.where(np.abs(excess) < 1e-12 * length**2, 0.0, excess).astype(np.float32),
            stiffness=np.tile(stiffness, 2)[order].astype(np.float32),
        )

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
