"""Tissue in motion that is sutured: stitches between places on it, drawn, tied and taken out."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from heartcase.schemas.arrays import Float64
from heartcase.schemas.errors import SimulationError
from heartcase.simulator.cutting.cuts import Cuts
from heartcase.simulator.dynamics.step_size import own_step_limit
from heartcase.simulator.dynamics.tied_frequency import rate_where_tied
from heartcase.simulator.instruments.placing import is_point, point_in_lattice
from heartcase.simulator.lattice.model import LatticeModel
from heartcase.simulator.lattice.tethers import NO_LIMIT, Tethers
from heartcase.simulator.suturing.places import REACH_MM, Place, as_known, nearest_on_surface, place_near
from heartcase.simulator.suturing.rows import filled_in, rest_point, running_pairs, running_threads, slip
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
from heartcase.simulator.tissue.moving_tissue import MovingTissue

__all__ = ["SuturedTissue"]


class SuturedTissue(MovingTissue):
    """A lattice in motion with stitches in it; its parameters are those of :class:`MovingTissue`."""

    stitches: list[Stitch]
    """Threads that are in the tissue."""
    _tied: tuple[LatticeModel | None, Tethers, float] = (None, Tethers.none(), 0.0)
    """Lattice and threads of which the highest frequency is known, and its square."""

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
        first, second = (self._as_place(one, uncut, at_rest, name) for one in places)
        return self._put_in([self._made((first, second), name)], stiffness_n_m, name)[0]

    def row_places(
        self,
        chosen: Sequence[Stitch | Sequence[npt.ArrayLike | Place]],
        *,
        spacing_mm: float,
        at_rest: bool = False,
        name: str = "row",
    ) -> list[tuple[Place, Place]]:
        """Places of all stitches of a row that is filled in between chosen ones, these among them.

        Each side is filled along the straight line at rest, and taken to the nearest place on the surface at rest: an
        incision is closed there, and each side stays on its own. Choose one where the incision turns.

        Parameters
        ----------
        chosen
            At least two, in their order along the row: stitches that are there, or two places each as of
            :meth:`stitch`. All have their first place on the same side.
        spacing_mm
            Distance between neighbouring stitches, mm: the nearest that divides the way evenly.
        at_rest
            Whether points are places of the tissue at rest; else they are places now.
        name
            Name in messages.

        Raises
        ------
        SimulationError
            Fewer than two were chosen, the spacing is not above 0 or makes too many, or there is no tissue near.
        """
        if not (np.isfinite(spacing_mm) and spacing_mm > 0.0):
            raise SimulationError(f"a spacing of {spacing_mm} mm cannot be: give one above 0", place=name)
        uncut, ends = self.uncut(self.model, self.cuts), []
        for one in chosen:
            places = one.places if isinstance(one, Stitch) else tuple(one)
            if len(places) != 2:
                raise SimulationError(f"a stitch has two places (found {len(places)})", place=name)
            ends.append([self._as_place(place, uncut, at_rest, name) for place in places])
        rest = [[rest_point(place, uncut) for place in pair] for pair in ends]
        points, is_chosen = filled_in(rest, spacing_mm / self.model.cell_mm, name=name)
        points_mm = self.model.geometry.index_to_world(points - 0.5)
        known = iter(ends)
        row = []
        for pair, is_known in zip(points_mm, is_chosen, strict=True):
            first, second = next(known) if is_known else (self.place(one, at_rest=True, name=name) for one in pair)
            row.append((first, second))
        return row

    def stitch_row(
        self,
        places: Sequence[tuple[Place, Place]],
        *,
        is_running: bool = False,
        stiffness_n_m: float | None = None,
        name: str = "row",
    ) -> list[Stitch]:
        """Put a row of stitches in, interrupted or with one running thread; each is as its places are apart now.

        A running thread also goes from the second place of each stitch to the first of the next. It slips through the
        tissue without friction: drawn with a tension it has that all along, and where its length is held that is
        shared out anew after every row of steps, so that all of it pulls alike. Stitches that are there at one of these
        pairs of places stay as they are; in a running row the new thread is put in beside them.

        Parameters
        ----------
        places
            Both places of each, in their order, as of :meth:`row_places`.
        is_running
            Whether one thread runs through all.
        stiffness_n_m
            Stiffness of the thread between two places, N/m; when left out, half of what the time step allows.
        name
            Name of the row; the stitches are numbered behind it.

        Raises
        ------
        SimulationError
            The row has no new stitch, there is one of this name, or the thread is too stiff for the time step.
        """
        if any(name in (stitch.name, stitch.row) for stitch in self.stitches):
            raise SimulationError("there is a stitch or a row of this name: take another name", place=name)
        there = set() if is_running else {stitch.places for stitch in self.stitches}
        crossings = [pair for pair in places if pair not in there]
        pairs = list(crossings)
        if is_running:
            between = running_pairs(crossings)
            pairs = [pair for both in zip(crossings, between, strict=False) for pair in both] + crossings[-1:]
        made = [self._made(pair, f"{name} {number}") for number, pair in enumerate(pairs, start=1)]
        if not made:
            raise SimulationError("all stitches of this row are there already: space them closer", place=name)
        for stitch in made:
            stitch.row, stitch.is_running = name, is_running
        return self._put_in(made, stiffness_n_m, name)

    def draw(self, stitch: Stitch, *, length_mm: float | None = None, tension_n: float | None = None) -> None:
        """Draw the thread of a stitch, or give way, to a length or with a tension; of a running row all of it.

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
        if tension_n is not None and not (np.isfinite(tension_n) and tension_n >= 0.0):
            raise SimulationError(f"a thread cannot be drawn with {tension_n} N: give 0 N or more", place=stitch.name)
        length = checked_length(length_mm, self.model.cell_mm, stitch.name)
        for one in self._thread_of(stitch):
            if tension_n is None:
                assert length is not None
                self._hold_length(one)
                one.length_target = length
                continue
            if one.tension_most == NO_LIMIT:
                # From here on the hand holds what the thread pulls with now.
                one.tension_most = float(tethers_of(self.model, [one]).tension(self.state.displacement)[0])
                one.length = one.length_target = 0.0
            one.tension_target = tension_n / self.model.units.force_n
        self._string()

    def tie(self, stitch: Stitch) -> None:
        """Tie a knot: the thread keeps the length that it has now; nothing jumps. One that is tied stays so.

        A running thread is tied at its ends, and goes on to slip in between.

        Raises
        ------
        SimulationError
            The stitch was taken out.
        """
        self._require(stitch)
        for one in self._thread_of(stitch):
            self._hold_length(one)
            one.length_target = one.length
            one.is_tied = True
        self._string()

    def take_out(self, stitch: Stitch) -> None:
        """Take a stitch out, of a running row all of it. One that was taken out already stays so."""
        if stitch in self.stitches:
            out = self._thread_of(stitch)
            self.stitches = [one for one in self.stitches if one not in out]
            self._string()

    def _thread_of(self, stitch: Stitch) -> list[Stitch]:
        """The stitches that its thread runs through, itself among them."""
        if not stitch.is_running:
            return [stitch]
        return [one for one in self.stitches if one.is_running and one.row == stitch.row]

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
            row=stitch.row,
            is_running=stitch.is_running,
            drawn_n=None if is_held else float(stitch.tension_most * model.units.force_n),
        )

    def _as_place(self, one: npt.ArrayLike | Place, uncut: LatticeModel, at_rest: bool, name: str) -> Place:
        return (
            as_known(one, uncut, name=name) if isinstance(one, Place) else self.place(one, at_rest=at_rest, name=name)
        )

    def _put_in(self, made: list[Stitch], stiffness_n_m: float | None, name: str) -> list[Stitch]:
        """Put new stitches in, all of one stiffness."""
        wanted = None
        if stiffness_n_m is not None:
            if not (np.isfinite(stiffness_n_m) and stiffness_n_m > 0.0):
                raise SimulationError(f"a stiffness of {stiffness_n_m} N/m cannot be: give one above 0", place=name)
            wanted = stiffness_n_m * self.model.units.length_m / self.model.units.force_n
        limit = self._thread_rate_limit(self.model, self.cuts)
        new = tethers_of(self.model, made)
        stiffness = fitting_stiffness(self.model, self._strung(), new, limit, wanted, name=name)
        for stitch in made:
            stitch.stiffness = stiffness
        self.stitches += made
        self._string()
        return made

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
        self._engine.set_tethers(self._strung_in(self.model, step_count))

    def _strung(self) -> Tethers:
        """All threads as they are now."""
        return self._strung_in(self.model)

    def _strung_in(self, model: LatticeModel, step_count: int = 0) -> Tethers:
        """All threads in a lattice; in so many steps they come to their targets."""
        return tethers_of(model, self.stitches, step_count)

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

    def _slip(self) -> None:
        """Let running threads slip until they pull alike all along."""
        threads = running_threads(self.stitches)
        for thread in threads:
            slip(thread, tethers_of(self.model, thread), self.state.displacement)
        if threads:
            self._string()

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

    @property
    def _tied_rate(self) -> float:
        """omega^2 where threads and explicit springs tie elements together; worked out once for the same of them."""
        strung = self._strung()
        known, (model, tethers, rate) = False, self._tied
        if model is self.model and tethers.count == strung.count:
            pairs = ((tethers.nodes, strung.nodes), (tethers.shares, strung.shares))
            known = all(np.array_equal(*pair) for pair in (*pairs, (tethers.stiffness, strung.stiffness)))
        if not known:
            rate = rate_where_tied(self.model, strung)
            self._tied = self.model, strung, rate
        return rate

    def _thread_rate(self) -> float:
        return self._strung().rate_bound(self.model.inverse_mass)

    def _thread_rate_limit(self, model: LatticeModel, cuts: Cuts | None) -> float:
        """What threads may add to omega^2 beside the explicit springs [1 / unit of time^2]."""
        return self._explicit_rate_limit(self.uncut(model, cuts)) - model.explicit.rate_bound(model.inverse_mass)

    def _rethread(self) -> None:
        """Bind all threads anew, in tissue that was cut; those that are too stiff for what is left are softened."""
        self._bind_all()
        strung = self._strung()
        if len(strung.nodes):
            limit = self._thread_rate_limit(self.model, self.cuts)
            self._soften(softened(strung, self.model.inverse_mass, limit))
        self._string()

    def _bind_all(self) -> None:
        """Bind all threads to the nodes of their places."""
        for stitch in self.stitches:
            stitch.nodes, stitch.shares = bind(self.model, self.cuts, stitch.places)

    def _soften(self, stiffness: Float64) -> None:
        """Give each thread a stiffness [k], in their order, shape (count,)."""
        for stitch, own in zip(self.stitches, stiffness.tolist(), strict=True):
            stitch.stiffness = own
