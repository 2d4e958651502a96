"""A moment of a simulation: the lattice, its state, and the instruments in it."""

from __future__ import annotations

import copy
from collections.abc import Iterable
from dataclasses import dataclass
from typing import Generic, TypeVar

from heartcase.simulator.cutting.cuts import Cuts
from heartcase.simulator.instruments.wrench import Instrument
from heartcase.simulator.lattice.model import LatticeModel
from heartcase.simulator.lattice.state import State
from heartcase.simulator.patching.patches import Patch
from heartcase.simulator.suturing.stitches import Stitch

__all__ = ["KeptInstrument", "Snapshot"]


_Kept = TypeVar("_Kept", Instrument, Stitch, Patch)


@dataclass(frozen=True)
class KeptInstrument(Generic[_Kept]):
    """An instrument, a stitch or a patch, and how it was at a moment."""

    instrument: _Kept
    """The one that programs hold on to."""
    then: _Kept
    """What it held and where it was: a copy."""

    @classmethod
    def of(cls, instrument: _Kept) -> KeptInstrument[_Kept]:
        """An instrument as it is now."""
        return cls(instrument, copy.copy(instrument))

    def put_back(self) -> _Kept:
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
    instruments: tuple[KeptInstrument[Instrument], ...] = ()
    """Hands and probes of that moment: what they held, where they were and where they were led."""
    cuts: Cuts | None = None
    """What had been cut; None for nothing."""
    stitches: tuple[KeptInstrument[Stitch], ...] = ()
    """Threads that were in the tissue: their places, lengths, and what they were drawn to."""
    patches: tuple[KeptInstrument[Patch], ...] = ()
    """Patches that were sewn on."""

    @classmethod
    def of(
        cls,
        model: LatticeModel,
        state: State,
        instruments: Iterable[Instrument],
        cuts: Cuts | None = None,
        stitches: Iterable[Stitch] = (),
        patches: Iterable[Patch] = (),
    ) -> Snapshot:
        """The moment now: ``model``, ``state``, ``instruments``, ``cuts``, ``stitches``, ``patches`` of tissue."""
        kept = tuple(KeptInstrument[Instrument].of(instrument) for instrument in instruments)
        threads = tuple(KeptInstrument[Stitch].of(stitch) for stitch in stitches)
        return cls(model, state, kept, cuts, threads, tuple(KeptInstrument[Patch].of(patch) for patch in patches))
