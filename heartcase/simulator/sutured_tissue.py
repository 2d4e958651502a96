"""Tissue in motion that is sutured: stitches between places on it, drawn, tied and taken out."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from heartcase.schemas.errors import SimulationError
from heartcase.simulator.cutting.cuts import Cuts
from heartcase.simulator.dynamics.step_size import explicit_rate_limit, own_step_limit
from heartcase.simulator.instruments.placing import is_point, point_in_lattice
from heartcase.simulator.lattice.model import LatticeModel
from heartcase.simulator.lattice.tethers import NO_LIMIT, Tethers
from heartcase.simulator.moving_tissue import MovingTissue
from heartcase.simulator.suturing.places import REACH_MM, Place, as_known, nearest_on_surface, place_near
from heartcase.simulator.suturing.stitches import (
    Stitch,
    StitchState,
    bind,
    checked_length,
    ends_of,
    fitting_stiffness,
    softened,
    tethers_of,
)

__all__ = ["SuturedTissue"]


class SuturedTissue(MovingTissue):
    """A lattice in motion with stitches in it; its parameters are those of :class:`MovingTissue`."""

    stitches: list[Stitch]
    """Threads that are in the tissue."""

    @property
    def step_limit_s(self) -> float:
        """Largest step that is stable at rest with the springs and threads that there are now, s."""
        return own_step_limit(self.model, self._thread_rate())

    def place(self, point_mm: npt.ArrayLike, *, at_rest: bool = False, name: str = "stitch") -> Place:
        """The place on the visible surface that is nearest to a point, or in the tissue where there is no surface.

        Parameters
        ----------
        point_mm
            LPS mm, shape (3,).
        at_rest
            Whether it is a place of the tissue at rest; else it is one now.
        name
            Name in messages.

        Raises
        ------
        SimulationError
            It is not a finite point, or there is no tissue near.
        """
        if not is_point(point_mm):
            raise SimulationError("a place must be three finite numbers", place=name)
        point, behind = point_in_lattice(self.model, point_mm), None
        displacement = np.zeros_like(self.state.displacement) if at_rest else self.state.displacement
        if self.surface is not None:
            shown_mm = self.surface.rest_mm if at_rest else self.surface_now().vertices_mm
            vertices = self.model.geometry.world_to_index(shown_mm.astype(np.float64)) + 0.5
            found = nearest_on_surface(point, vertices, self.surface.triangles)
            if found.distance * self.model.cell_mm > REACH_MM:
                raise SimulationError(
                    f"there is no tissue within {REACH_MM:g} mm of this place; the surface is "
                    f"{found.distance * self.model.cell_mm:.1f} mm away: give one on it",
                    place=name,
                )
            point, behind = found.point, found.behind
        return place_near(self.model, self.cuts or self.nothing_cut(), displacement, point, behind=behind, name=name)

    def stitch(
        self,
        places: Sequence[npt.ArrayLike | Place],
        *,
        at_rest: bool = False,
        stiffness_n_m: float | None = None,
        name: str = "stitch",
    ) -> Stitch:
        """Put a thread through the tissue at two places; it is as long as they are apart now, and pulls at nothing.

        Each place follows the nodes of its own side of every cut, by weights that sum to one. The thread pulls along
        itself alone, with as much as it is stretched, and never pushes.

        Parameters
        ----------
        places
            Two of them: points, LPS mm, shape (3,), each taken to the nearest place on the surface, or what
            :meth:`place` gave.
        at_rest
            Whether points are places of the tissue at rest; else they are places now.
        stiffness_n_m
            Stiffness of the thread between the places, N/m; when left out, half of what the time step allows there.
        name
            Name in messages.

        Raises
        ------
        SimulationError
            There are not two places, there is no tissue near, or the thread is too stiff for the time step.
        """
        if len(places) != 2:
            raise SimulationError(f"a stitch has two places (found {len(places)})", place=name)
        uncut = self.uncut(self.model, self.cuts)
        first, second = (
            as_known(one, uncut, name=name) if isinstance(one, Place) else self.place(one, at_rest=at_rest, name=name)
            for one in places
        )
        stitch = self._made((first, second), name)
        wanted = None
        if stiffness_n_m is not None:
            if not (np.isfinite(stiffness_n_m) and stiffness_n_m > 0.0):
                raise SimulationError(f"a stiffness of {stiffness_n_m} N/m cannot be: give one above 0", place=name)
            wanted = stiffness_n_m * self.model.units.length_m / self.model.units.force_n
        present, new = tethers_of(self.model, self.stitches), tethers_of(self.model, [stitch])
        limit = self._thread_rate_limit(self.model, self.cuts)
        stitch.stiffness = fitting_stiffness(self.model, present, new, limit, wanted, name=name)
        self.stitches.append(stitch)
        self._string()
        return stitch

    def draw(self, stitch: Stitch, *, length_mm: float | None = None, tension_n: float | None = None) -> None:
        """Draw the thread of a stitch, or give way, to a length or with a tension.

        It comes to that evenly over the next :meth:`step`. With a tension, the thread slips through the hand that
        pulls at it: it pulls so much at both places, however they move, until it is tied or drawn to a length.

        Parameters
        ----------
        stitch
            The stitch, not tied.
        length_mm
            Length of the thread between its places, mm.
        tension_n
            Tension, N; give one of the two.

        Raises
        ------
        SimulationError
            The stitch was taken out, or is tied, or not one number of 0 or more was given.
        """
        self._require(stitch)
        if stitch.is_tied:
            raise SimulationError("the stitch is tied: take it out and place another", place=stitch.name)
        if (length_mm is None) == (tension_n is None):
            raise SimulationError("give either a length in mm or a tension in N", place=stitch.name)
        if tension_n is not None:
            if not (np.isfinite(tension_n) and tension_n >= 0.0):
                raise SimulationError(
                    f"a thread cannot be drawn with {tension_n} N: give 0 N or more", place=stitch.name
                )
            if stitch.tension_most == NO_LIMIT:
                # From here on the hand holds what the thread pulls with now.
                stitch.tension_most = float(tethers_of(self.model, [stitch]).tension(self.state.displacement)[0])
                stitch.length = stitch.length_target = 0.0
            stitch.tension_target = tension_n / self.model.units.force_n
            self._string()
            return
        length = checked_length(length_mm, self.model.cell_mm, stitch.name)
        assert length is not None
        self._hold_length(stitch)
        stitch.length_target = length
        self._string()

    def tie(self, stitch: Stitch) -> None:
        """Tie a knot: the thread keeps the length that it has now; nothing jumps. One that is tied stays so.

        Raises
        ------
        SimulationError
            The stitch was taken out.
        """
        self._require(stitch)
        self._hold_length(stitch)
        stitch.length_target = stitch.length
        stitch.is_tied = True
        self._string()

    def take_out(self, stitch: Stitch) -> None:
        """Take a stitch out. One that was taken out already stays so."""
        if stitch in self.stitches:
            self.stitches.remove(stitch)
            self._string()

    def stitch_state(self, stitch: Stitch) -> StitchState:
        """The force in a stitch, where its places are, and its length now.

        Raises
        ------
        SimulationError
            The stitch was taken out.
        """
        self._require(stitch)
        model, displacement = self.model, self.state.displacement
        ends = ends_of(stitch, model, displacement)
        tension = float(tethers_of(model, [stitch]).tension(displacement)[0])
        distance = float(np.linalg.norm(ends[1] - ends[0]))
        is_held = stitch.tension_most == NO_LIMIT
        length = stitch.length if is_held else max(distance - tension / stitch.stiffness, 0.0)
        return StitchState(
            name=stitch.name,
            is_tied=stitch.is_tied,
            places_mm=model.geometry.index_to_world(ends - 0.5),
            force_n=float(tension * model.units.force_n),
            length_mm=float(length * model.cell_mm),
            distance_mm=float(distance * model.cell_mm),
        )

    def _made(self, places: tuple[Place, Place], name: str) -> Stitch:
        """A stitch that is as long as its places are apart now, of any stiffness."""
        nodes, shares = bind(self.model, self.cuts, places)
        stitch = Stitch(places, nodes, shares, 1.0, 0.0, 0.0, name=name)
        ends = ends_of(stitch, self.model, self.state.displacement)
        stitch.length = stitch.length_target = float(np.linalg.norm(ends[1] - ends[0]))
        return stitch

    def _hold_length(self, stitch: Stitch) -> None:
        """Hold a thread that is drawn with a tension by its length, which pulls with as much."""
        if stitch.tension_most == NO_LIMIT:
            return
        stitch.length = stitch.length_target = self.stitch_state(stitch).length_mm / self.model.cell_mm
        stitch.tension_most = stitch.tension_target = NO_LIMIT

    def _require(self, stitch: Stitch) -> None:
        if stitch not in self.stitches:
            raise SimulationError("the stitch was taken out: place another", place=getattr(stitch, "name", "stitch"))

    def _string(self, step_count: int = 0) -> None:
        """Let the engine pull with the threads as they are; in so many steps they come to their targets."""
        self._engine.set_tethers(tethers_of(self.model, self.stitches, step_count))

    def _strung(self) -> Tethers:
        """The threads as they are now."""
        return tethers_of(self.model, self.stitches)

    @property
    def _is_drawn(self) -> bool:
        """Whether a thread is on its way to another length or tension."""
        return any(
            stitch.length != stitch.length_target or stitch.tension_most != stitch.tension_target
            for stitch in self.stitches
        )

    def _drawn(self) -> None:
        """All threads are where they were drawn to."""
        for stitch in self.stitches:
            stitch.length, stitch.tension_most = stitch.length_target, stitch.tension_target

    def draw_part_of_the_way(self, share: float) -> None:
        """Draw each thread so far towards where it is drawn; 0 for not at all."""
        for stitch in self.stitches:
            stitch.length_target = stitch.length + share * (stitch.length_target - stitch.length)
            stitch.tension_target = stitch.tension_most + share * (stitch.tension_target - stitch.tension_most)

    def _stay(self) -> None:
        """All threads stay as they are, wherever they were drawn to."""
        for stitch in self.stitches:
            stitch.length_target, stitch.tension_target = stitch.length, stitch.tension_most
        self._string()

    def _thread_rate(self) -> float:
        return self._strung().rate_bound(self.model.inverse_mass)

    def _thread_rate_limit(self, model: LatticeModel, cuts: Cuts | None) -> float:
        """What threads may add to omega^2 beside the explicit springs [1 / unit of time^2]."""
        return explicit_rate_limit(self.uncut(model, cuts), self.step_s) - model.explicit.rate_bound(model.inverse_mass)

    def _rethread(self) -> None:
        """Bind all stitches anew, in tissue that was cut; those that are too stiff for what is left are softened."""
        for stitch in self.stitches:
            stitch.nodes, stitch.shares = bind(self.model, self.cuts, stitch.places)
        limit = self._thread_rate_limit(self.model, self.cuts)
        for stitch, stiffness in zip(self.stitches, softened(self.model, self.stitches, limit), strict=True):
            stitch.stiffness = stiffness
        self._string()
