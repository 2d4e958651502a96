"""A moment of a simulation: the lattice, its state, and the instruments in it."""

from __future__ import annotations

import copy
from collections.abc import Iterable
from dataclasses import dataclass

from heartcase.simulator.cutting.cuts import Cuts
from heartcase.simulator.instruments.wrench import Instrument
from heartcase.simulator.lattice.model import LatticeModel
from heartcase.simulator.lattice.state import State

__all__ = ["KeptInstrument", "Snapshot"]


@dataclass(frozen=True)
class KeptInstrument:
    """An instrument, and how it was at a moment."""

    instrument: Instrument
    """The one that programs hold on to."""
    then: Instrument
    """What it held and where it was: a copy."""

    @classmethod
    def of(cls, instrument: Instrument) -> KeptInstrument:
        """An instrument as it is now."""
        return cls(instrument, copy.copy(instrument))

    def put_back(self) -> Instrument:
        """Make the instrument what it was; returns it."""
        vars(self.instrument).update(vars(self.then))
        return self.instrument


@dataclass(frozen=True)
class Snapshot:
    """A moment: what :meth:`heartcase.simulator.simulation.Simulation.restore` needs to go back to it."""

    model: LatticeModel
    """The lattice with its springs of that moment."""
    state: State
    """Where its nodes were and how they moved."""
    instruments: tuple[KeptInstrument, ...] = ()
    """Hands and probes of that moment: what they held, where they were and where they were led."""
    cuts: Cuts | None = None
    """What had been cut; None for nothing."""

    @classmethod
    def of(
        cls, model: LatticeModel, state: State, instruments: Iterable[Instrument], cuts: Cuts | None = None
    ) -> Snapshot:
        """The moment now: ``model``, ``state`` and ``cuts`` of a simulation, and the ``instruments`` in it."""
        return cls(model, state, tuple(KeptInstrument.of(instrument) for instrument in instruments), cuts)
