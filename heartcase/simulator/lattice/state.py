"""The state of a moving lattice: displacement and velocity."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from heartcase.compiling.kernel import kernel
from heartcase.schemas.arrays import Bool, Float, Float32, Float64, Int32, Int64

__all__ = ["PreciseState", "State"]


@dataclass(frozen=True)
class State:
    """Displacement and velocity of every node, in grid units and axes.

    Displacements instead of positions keep the rounding error of float32 in proportion to the movement: the centre
    of mass drifts by 0.006 cells in a million steps where positions drift by hundreds.
    """

    displacement: Float32
    """Way from the rest position [cells], shape (node_count, 3)."""
    velocity: Float32
    """Velocity HALF A STEP BEFORE the displacement's time [cells per unit of time], shape (node_count, 3)."""
    step_count: int = 0
    """Steps taken since the start."""

    @classmethod
    def at_rest(cls, node_count: int) -> State:
        """Nothing displaced, nothing moving."""
        return cls(np.zeros((node_count, 3), np.float32), np.zeros((node_count, 3), np.float32))

    def of_nodes(self, nodes: Int32) -> State:
        """The state of a lattice whose nodes lie, and go, where some nodes of this one do, shape (count,)."""
        return State(_rows_of(self.displacement, nodes), _rows_of(self.velocity, nodes), self.step_count)

    def with_means_of(self, before: State, nodes: Int64, nodes_before: Int64, shares: Float64) -> State:
        """The same with some nodes where the means of others lie, and going as these go.

        Parameters
        ----------
        before
            State that the others are nodes of; one of this kind.
        nodes, nodes_before, shares
            Node here that each of the others counts for, ascending; the others; and their share of it. Shapes (count,);
            the shares of each node add up to 1.
        """
        if not len(nodes):
            return self
        chosen, first = np.unique(nodes, return_index=True)
        found = []
        for own, others in zip(self._all_digits, before._all_digits, strict=True):
            rows = own.copy()
            rows[chosen] = np.add.reduceat(others[nodes_before].astype(np.float64) * shares[:, None], first)
            found.append(rows)
        return self._rounded(*found)

    def with_still(self, nodes: Bool) -> State:
        """The same with some nodes at their rest position and still: True for each, shape (node_count,)."""
        return self._rounded(*(np.where(nodes[:, None], 0, rows).astype(rows.dtype) for rows in self._all_digits))

    @property
    def _all_digits(self) -> tuple[Float, Float]:
        """Displacement and velocity, with all digits that are known."""
        return self.displacement, self.velocity

    def _rounded(self, displacement: Float, velocity: Float) -> State:
        """A state of this kind at the same time."""
        return State(displacement, velocity, self.step_count)


@dataclass(frozen=True)
class PreciseState(State):
    """A state of an engine that reckons in float64, with all of its digits: going on from it repeats the same bytes."""

    precise_displacement: Float64 = field(kw_only=True)
    """The displacement before it was rounded [cells], shape (node_count, 3)."""
    precise_velocity: Float64 = field(kw_only=True)
    """The velocity before it was rounded [cells per unit of time], shape (node_count, 3)."""

    @classmethod
    def of(cls, displacement: Float64, velocity: Float64, step_count: int) -> PreciseState:
        """From the numbers of the engine, which it may go on to change."""
        return cls(
            displacement.astype(np.float32),
            velocity.astype(np.float32),
            step_count,
            precise_displacement=displacement.copy(),
            precise_velocity=velocity.copy(),
        )

    def of_nodes(self, nodes: Int32) -> State:
        """The same of some nodes."""
        return PreciseState.of(self.precise_displacement[nodes], self.precise_velocity[nodes], self.step_count)

    @property
    def _all_digits(self) -> tuple[Float, Float]:
        return self.precise_displacement, self.precise_velocity

    def _rounded(self, displacement: Float, velocity: Float) -> State:
        return PreciseState.of(displacement.astype(np.float64), velocity.astype(np.float64), self.step_count)


@kernel
def _rows_of(vectors: Float, nodes: Int32) -> Float:
    """The vectors of some nodes, shape (count, 3)."""
    rows = np.empty((len(nodes), 3), vectors.dtype)
    for row in range(len(nodes)):
        for axis in range(3):
            rows[row, axis] = vectors[nodes[row], axis]
    return rows
