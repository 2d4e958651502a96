"""All that was cut of a lattice: the uncut lattice, the sheets, and what they leave."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from heartcase.schemas.arrays import Bool, Float64, Int64
from heartcase.schemas.errors import SimulationError
from heartcase.simulator.cutting.bit_masks.inheriting import held_nodes
from heartcase.simulator.cutting.blade_sheet import Sheet
from heartcase.simulator.cutting.cut_frequency import rate_along_cuts
from heartcase.simulator.cutting.descent import Descent, descent_of, nodes_now
from heartcase.simulator.cutting.further_parting import part_further
from heartcase.simulator.cutting.parted_lattice import PartedLattice, part
from heartcase.simulator.cutting.tissue_samples import TissueSamples
from heartcase.simulator.lattice.explicit_springs import ExplicitSprings
from heartcase.simulator.lattice.loose_nodes import with_loose_of
from heartcase.simulator.lattice.model import LatticeModel
from heartcase.simulator.lattice.state import State

__all__ = ["Cuts", "Step", "cut_further"]


@dataclass(frozen=True)
class Step:
    """From one lattice to the next, which was cut further."""

    descent: Descent
    """Where each node comes from."""
    node_now: Int64
    """Of the nodes that come from each node before, the heaviest, shape (node_count before,)."""

    def carried(self, state: State) -> State:
        """A state of the lattice before: copies lie, and go, where their node does.

        A node that takes over tissue of several lies at the centre of its mass, and goes on with its momentum.
        """
        found = self.descent
        carried = state.of_nodes(found.node_before)
        return carried.with_means_of(state, found.mixed, found.mixed_before, found.mixed_share)

    def joined(self, springs: ExplicitSprings) -> ExplicitSprings:
        """Explicit springs of the lattice before, which hold on to the heaviest copies of their nodes."""
        return replace(springs, nodes=self.node_now[springs.nodes].astype(np.int32))

    def with_loose(self, loose_count: int) -> Step:
        """The same of lattices that both have so many loose nodes more."""
        if not loose_count:
            return self
        loose = np.arange(loose_count)
        before = self.descent.node_before
        now = np.append(self.node_now, len(before) + loose)
        before = np.append(before, len(self.node_now) + loose).astype(np.int32)
        return Step(replace(self.descent, node_before=before), now)

    def held(self, nodes: Int64) -> tuple[Int64, Int64]:
        """Nodes that come from some nodes before, ascending, and the place of that node among those given."""
        held, place = held_nodes(self.descent.node_before, nodes, len(self.node_now))
        return held, place


@dataclass(frozen=True)
class Cuts:
    """What was cut, all of it: the same sheets, in any order, give the same lattice."""

    uncut: LatticeModel
    """The lattice before any cut, without explicit springs."""
    tissue: TissueSamples
    """Samples of its tissue."""
    sheets: tuple[Sheet, ...] = ()
    """What blades swept, at rest."""
    parted: PartedLattice | None = None
    """What they leave; None where there are none."""
    excised: Bool | None = None
    """Nodes of ``model`` whose tissue was taken out, shape (node_count,): they stand still at rest, and nothing shows,
    touches or holds them; None where nothing was."""

    @cached_property
    def rate_along(self) -> float:
        """As of :func:`heartcase.simulator.cutting.cut_frequency.rate_along_cuts`; 0 with springs."""
        return 0.0 if self.parted is None or not self.model.law.is_element else rate_along_cuts(self.parted)

    @cached_property
    def model(self) -> LatticeModel:
        """The lattice that is left, without explicit springs; what was excised is fixed."""
        model = self.uncut if self.parted is None else self.parted.model
        return model if self.excised is None else replace(model, node_is_fixed=model.node_is_fixed | self.excised)

    @property
    def excised_ml(self) -> float:
        """Volume of what was excised, ml."""
        if self.excised is None:
            return 0.0
        model = self.model
        return float(model.cell_coverage[self.excised[model.cell_corners[:, 0]]].sum()) * model.cell_mm**3 / 1000.0

    def without(self, nodes: Bool) -> Cuts:
        """The same with more excised: True for each of its nodes, shape (node_count,)."""
        return replace(self, excised=nodes if self.excised is None else self.excised | nodes)

    def with_sheet(self, sheet: Sheet) -> tuple[Cuts, Step]:
        """One more sheet, and how nodes go over.

        Raises
        ------
        SimulationError
            Springs of the lattice were removed.
        """
        sheets = (*self.sheets, sheet)
        if not self.uncut.cell_is_whole.all():
            raise SimulationError("springs of this lattice were removed: cut it by sheets only", place="cut")
        if self.parted is not None or not self.sheets:
            made = part_further(self.uncut, self.tissue, self.parted, sheet)
            if made is not None:
                further, descent, now = made
                return self._parted(sheets, further, descent), Step(descent, now)
        parted = part(self.uncut, sheets, self.tissue)
        descent = descent_of(self.uncut, self.parted, parted)
        step = Step(descent, nodes_now(self.uncut, self.parted, parted, descent.node_before))
        return self._parted(sheets, parted, descent), step

    def _parted(self, sheets: tuple[Sheet, ...], parted: PartedLattice, descent: Descent) -> Cuts:
        excised = None if self.excised is None else self.excised[descent.node_before]
        return replace(self, sheets=sheets, parted=parted, excised=excised)


def cut_further(model: LatticeModel, cuts: Cuts, points: Float64) -> tuple[LatticeModel, Cuts, Step]:
    """A lattice after one more cut, all that was cut, and how nodes go over.

    Parameters
    ----------
    model
        The lattice now, with explicit springs.
    cuts
        What was cut of it.
    points
        Points of the blade at each pose, at rest, in the frame of the nodes [cells], (pose_count, point_count, 3).

    Raises
    ------
    SimulationError
        Springs of the lattice were removed one by one.
    """
    if not model.cell_is_whole.all():
        raise SimulationError("springs of this lattice were removed: cut it by blades only", place="blade")
    cuts, step = cuts.with_sheet(Sheet.swept(points))
    step = step.with_loose(model.loose_count)
    return replace(with_loose_of(cuts.model, model), explicit=step.joined(model.explicit)), cuts, step
