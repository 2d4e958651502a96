"""Tissue in motion that is patched: sheets that are cut to outlines on it and sewn on."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from heartcase.schemas.arrays import Bool, Float64
from heartcase.schemas.errors import Problem, SimulationError
from heartcase.simulator.instruments.grab import Grab
from heartcase.simulator.instruments.placing import is_point
from heartcase.simulator.lattice.model import LatticeModel
from heartcase.simulator.lattice.state import State
from heartcase.simulator.lattice.tethers import Tethers
from heartcase.simulator.patching.flat_sheets import FlatSheet, flat_sheet, resampled
from heartcase.simulator.patching.patches import (
    Patch,
    PatchState,
    bind_rim,
    patch_state,
    rim_tethers,
    with_nodes_of,
    with_patch,
    without_patch,
)
from heartcase.simulator.suturing.places import Place, as_known, cell_of, nodes_and_weights
from heartcase.simulator.suturing.stitches import fitting_stiffness, softened
from heartcase.simulator.tissue.sutured_tissue import SuturedTissue

__all__ = ["PatchedTissue"]

RIM_MAX = 400
"""Most stitches of a patch's rim."""


class PatchedTissue(SuturedTissue):
    """Sutured tissue in motion with patches on it; its parameters are those of :class:`MovingTissue`."""

    patches: list[Patch]
    """Patches that are sewn on."""
    grabs: list[Grab]
    """Hands, forceps and retractors that hold tissue."""

    def outline_places(
        self, outline_mm: npt.ArrayLike, *, spacing_mm: float = 2.5, at_rest: bool = False, name: str = "patch"
    ) -> tuple[list[Place], Float64]:
        """Places on the surface along a closed outline, and where they are now, LPS mm, shape (count, 3).

        Parameters
        ----------
        outline_mm
            Points of the outline, closed from the last to the first, LPS mm, shape (any, 3), at least three.
        spacing_mm
            Distance between the places along it, mm: the nearest that divides it evenly, and six places at least.
        at_rest
            Whether it is drawn on the tissue at rest; else on it as it is now.
        name
            Name in messages.

        Raises
        ------
        SimulationError
            Too few points, too many stitches, numbers out of range, or there is no tissue near.
        """
        outline = np.asarray(outline_mm, dtype=np.float64)
        if outline.ndim != 2 or len(outline) < 3 or not all(is_point(point) for point in outline):
            raise SimulationError("an outline has at least three points of three finite numbers", place=name)
        if not (np.isfinite(spacing_mm) and spacing_mm > 0.0):
            raise SimulationError(f"a spacing of {spacing_mm} mm cannot be: give one above 0", place=name)
        length = np.linalg.norm(np.roll(outline, -1, axis=0) - outline, axis=1).sum()
        if length > RIM_MAX * spacing_mm:
            raise SimulationError(
                f"this rim would have {length / spacing_mm:,.0f} stitches; {RIM_MAX} are the most: space them wider",
                place=name,
            )
        places = [self.place(point, at_rest=at_rest, name=name) for point in resampled(outline, spacing_mm)]
        return places, self._places_now_mm(places)

    def patch(
        self,
        outline_mm: npt.ArrayLike,
        *,
        at_rest: bool = False,
        spacing_mm: float = 2.5,
        stiffness_n_m: float = 100.0,
        thickness_mm: float = 0.5,
        scale: float = 1.0,
        name: str = "patch",
    ) -> Patch:
        """Cut a patch to a closed outline drawn on the tissue, and stitch its rim on along it.

        Parameters
        ----------
        outline_mm, at_rest, spacing_mm, name
            As of :meth:`outline_places`. The patch's nodes are as far apart as the stitches of its rim.
        stiffness_n_m, thickness_mm, scale
            As of :meth:`sew_on`.

        Raises
        ------
        SimulationError
            As of :meth:`outline_places` and :meth:`sew_on`.
        """
        places, rim_mm = self.outline_places(outline_mm, spacing_mm=spacing_mm, at_rest=at_rest, name=name)
        how = {"stiffness_n_m": stiffness_n_m, "thickness_mm": thickness_mm, "scale": scale}
        return self.sew_on(places, rim_mm, **how, name=name)

    def sew_on(
        self,
        places: Sequence[Place],
        rim_mm: npt.ArrayLike,
        *,
        stiffness_n_m: float = 100.0,
        thickness_mm: float = 0.5,
        scale: float = 1.0,
        name: str = "patch",
    ) -> Patch:
        """Sew a patch on at places in tissue. It is cut to where they are, and nothing moves in this moment.

        It is a sheet that springs along its edges hold together, with nodes of its own that are stepped with the
        tissue. Each stitch of the rim is a thread of no length from a place to the patch.

        Parameters
        ----------
        places
            Where the stitches of its rim go through the tissue, in order around it.
        rim_mm
            Where these are now, LPS mm, shape (len(places), 3).
        stiffness_n_m
            Young's modulus times thickness, N/m.
        thickness_mm
            Thickness, mm.
        scale
            Size of what is cut over that of the outline laid out flat; below 1 it is stretched when it is sewn on.
        name
            Name, of which there is no other patch.

        Raises
        ------
        SimulationError
            With everything that is wrong: the outline is no simple loop, numbers are out of range, the name is taken,
            or the time step leaves nothing for it.
        """
        problems = []
        if any(patch.name == name for patch in self.patches):
            problems.append(Problem(name, "there is a patch of this name: take another name"))
        numbers = {"stiffness_n_m": stiffness_n_m, "thickness_mm": thickness_mm, "scale": scale}
        problems += [
            Problem(name, f"{what} must be above 0 (is {number})")
            for what, number in numbers.items()
            if not (np.isfinite(number) and number > 0.0)
        ]
        uncut = self.uncut(self.model, self.cuts)
        if self._explicit_rate_limit(uncut) == 0.0:
            problems.append(Problem(name, "the time step leaves nothing for a patch: give a smaller step"))
        if problems:
            raise SimulationError(problems)
        known = tuple(as_known(place, uncut, name=name) for place in places)
        sheet = flat_sheet(rim_mm, scale=scale, name=name)
        model = with_patch(self.model, uncut, sheet, stiffness_n_m, thickness_mm, self.step_s)
        patch = Patch(name, sheet, known, stiffness_n_m, thickness_mm, self.model.loose_count, stitch_stiffness=1.0)
        bind_rim(patch, model, self.cuts)
        limit = self._thread_rate_limit(model, self.cuts)
        # Those that are there make way for it, as for a cut.
        present = self._strung_in(model)
        there = softened(present, model.inverse_mass, 0.5 * limit)
        present = Tethers(**(vars(present) | {"stiffness": there.astype(np.float32)}))
        new = rim_tethers(model, [patch])
        patch.stitch_stiffness = fitting_stiffness(model, present, new, limit, None, name=name)
        self._go_on_with(model, with_nodes_of(self.state, model, sheet))
        self._soften(there)
        self.patches.append(patch)
        self._string()
        return patch

    def take_out_patch(self, patch: Patch) -> None:
        """Take a patch out, with the stitches of its rim. One that was taken out already stays so."""
        if patch not in self.patches:
            return
        model, state = self.model, self.state
        gone = np.zeros(model.node_count, np.bool_)
        gone[patch.nodes_in(model)] = True
        self.patches.remove(patch)
        for other in self.patches:
            if other.first > patch.first:
                other.first -= patch.node_count
        self._let_go_of(gone)
        smaller = without_patch(model, patch.first, patch.node_count)
        for other in self.patches:
            bind_rim(other, smaller, self.cuts)
        self._go_on_with(smaller, state.of_nodes(np.flatnonzero(~gone).astype(np.int32)))
        self._string()

    def patch_state(self, patch: Patch) -> PatchState:
        """A patch as a surface, and the force in each stitch of its rim, now.

        Raises
        ------
        SimulationError
            The patch was taken out.
        """
        if patch not in self.patches:
            raise SimulationError("the patch was taken out", place=getattr(patch, "name", "patch"))
        return patch_state(patch, self.model, self.state.displacement)

    def template(self, patch: Patch) -> FlatSheet:
        """A patch laid out flat: its outline to cut along, and how much laying it out has stretched it."""
        return patch.sheet

    def _places_now_mm(self, places: Sequence[Place]) -> Float64:
        model, u = self.model, self.state.displacement
        points = np.empty((len(places), 3))
        for number, place in enumerate(places):
            nodes, weights = nodes_and_weights(model, cell_of(place, self.cuts), place.local)
            points[number] = weights @ (model.node_index[nodes] + u[nodes].astype(np.float64))
        return model.geometry.index_to_world(points - 0.5)

    def _go_on_with(self, model: LatticeModel, state: State) -> None:
        """Go on with more or fewer loose nodes, in a state of them."""
        self._set_model(model, self.cuts)
        self._engine.load(state)
        self._hold()
        self._state = None

    def _let_go_of(self, gone: Bool) -> None:
        """Let hands hold what is left of what they held, True for each node that goes, shape (node_count,)."""
        number = np.cumsum(~gone) - 1
        for grab in list(self.grabs):
            kept = np.flatnonzero(~gone[grab.nodes])
            if len(kept):
                grab.carry(number[grab.nodes[kept]], kept)
            else:
                self.grabs.remove(grab)

    def _hold(self) -> None:
        """Let the engine know what hands hold."""
        raise NotImplementedError

    def _strung_in(self, model: LatticeModel, step_count: int = 0) -> Tethers:
        return super()._strung_in(model, step_count).with_more(rim_tethers(model, self.patches))

    def _bind_all(self) -> None:
        super()._bind_all()
        for patch in self.patches:
            bind_rim(patch, self.model, self.cuts)

    def _soften(self, stiffness: Float64) -> None:
        super()._soften(stiffness[: len(self.stitches)])
        first = len(self.stitches)
        for patch in self.patches:
            patch.stitch_stiffness = float(stiffness[first : first + patch.sheet.rim_count].min())
            first += patch.sheet.rim_count
