"""Tissue of which parts are taken out that were cut free: excision."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import replace

import numpy as np

from heartcase.schemas.arrays import Bool
from heartcase.schemas.errors import SimulationError
from heartcase.simulator.cutting.cuts import Cuts
from heartcase.simulator.instruments.grab import Grab
from heartcase.simulator.instruments.wrench import Instrument
from heartcase.simulator.lattice.loose_nodes import without_loose_nodes
from heartcase.simulator.lattice.model import LatticeModel
from heartcase.simulator.surface_splitting.free_parts import parts_of_lattice
from heartcase.simulator.suturing.places import Place, as_known, cell_of
from heartcase.simulator.tissue.patched_tissue import PatchedTissue

__all__ = ["ExcisedTissue", "excised_lattice"]


def excised_lattice(
    model: LatticeModel, cuts: Cuts, place: Place, *, name: str = "excision"
) -> tuple[LatticeModel, Cuts, Bool]:
    """A lattice without the part that a place lies in.

    The part keeps its nodes and cells, fixed and at rest, so that everything else keeps its number and undo is exact;
    nothing shows, touches or holds it any more, and cuts that come later leave it out.

    Parameters
    ----------
    model
        The lattice now, with loose nodes and explicit springs.
    cuts
        What was cut of it.
    place
        A place in the part.
    name
        Name in messages.

    Returns
    -------
    model, cuts
        The lattice, and what was cut and excised of it.
    nodes
        The part's nodes, True for each, shape (node_count,).

    Raises
    ------
    SimulationError
        Nothing is cut free there, or it was taken out already.
    """
    if cuts.parted is None:
        raise SimulationError("nothing is cut: cut a piece free first", place=name)
    tissue = without_loose_nodes(model)
    cell = cell_of(as_known(place, cuts.uncut, name=name), cuts)
    if cuts.excised is not None and cuts.excised[tissue.cell_corners[cell, 0]]:
        raise SimulationError("this piece was taken out already", place=name)
    number = parts_of_lattice(tissue)
    # Whatever is larger than all else together is the heart.
    volume = np.bincount(number, tissue.cell_coverage)
    if 2.0 * volume[number[cell]] >= volume.sum():
        raise SimulationError(
            "what is here hangs together with the rest of the heart: cut around it on all sides first", place=name
        )
    part = np.zeros(model.node_count, np.bool_)
    part[tissue.cell_corners[number == number[cell]]] = True
    if part[model.explicit.nodes].any():
        raise SimulationError("explicit springs hold this piece: take them out first", place=name)
    left = replace(model, node_is_fixed=model.node_is_fixed | part)
    return left, cuts.without(part[: tissue.node_count]), part


class ExcisedTissue(PatchedTissue):
    """Tissue of which parts that were cut free can be taken out. Its instruments are set by what uses it."""

    @property
    def instruments(self) -> tuple[Instrument, ...]:
        """What is in the tissue."""
        raise NotImplementedError

    def excise(self, place: Sequence[float] | Place, *, at_rest: bool = False, name: str = "excision") -> float:
        """Take out the piece of tissue at a place, which was cut free of all else; nothing else moves in this moment.

        Parameters
        ----------
        place
            A point on it, LPS mm, shape (3,), taken to the nearest place on the surface, or what :meth:`place` gave.
        at_rest
            Whether the point is a place of the tissue at rest; else it is a place now.
        name
            Name in messages.

        Returns
        -------
        float
            Volume of what was taken out, ml.

        Raises
        ------
        SimulationError
            Nothing is cut free there, or instruments, stitches, patches or explicit springs hold it: the message says
            which. Nothing has changed.
        """
        cuts = self.cuts or self.nothing_cut()
        known = self._as_place(place, self.uncut(self.model, self.cuts), at_rest, name)
        model, without, part = excised_lattice(self.model, cuts, known, name=name)
        holding = [*self._holding(part), *self._sewn_to(part)]
        if holding:
            raise SimulationError(f"this piece is held by {', '.join(holding)}: let go of it first", place=name)
        state = self.state.with_still(part)
        full = next((split for known_cuts, split in self._splits if known_cuts is self.cuts), None)
        if full is not None:
            self._splits = [*self._splits, (without, full)]
        self._set_model(model, without)
        self._engine.load(state)
        self._hold()
        self._string()
        self._state = None
        return without.excised_ml - cuts.excised_ml

    def _holding(self, part: Bool) -> list[str]:
        """Names of hands, forceps and retractors that hold some of these nodes."""
        return [one.name for one in self.instruments if isinstance(one, Grab) and part[one.nodes].any()]

    def _sewn_to(self, part: Bool) -> Iterable[str]:
        """Names of stitches and patches that are sewn to some of these nodes."""
        sewn = [(one.name, one.places) for one in self.stitches] + [(one.name, one.places) for one in self.patches]
        for name, places in sewn:
            if any(part[self.model.cell_corners[cell_of(place, self.cuts), 0]] for place in places):
                yield name
