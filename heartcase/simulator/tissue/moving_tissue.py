"""Tissue in motion: its lattice, what moves it, what is cut and joined of it, and the surfaces that follow."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import numpy.typing as npt

from heartcase.schemas.arrays import Float64
from heartcase.schemas.errors import SimulationError
from heartcase.simulator.cutting.blade_sheet import Poses, blade_points, checked_poses
from heartcase.simulator.cutting.cuts import Cuts, Step
from heartcase.simulator.cutting.rest_space import blade_at_rest, refined
from heartcase.simulator.cutting.tissue_samples import TissueSamples
from heartcase.simulator.dynamics.joining import join
from heartcase.simulator.dynamics.step_size import (
    StepSizes,
    checked_pace,
    checked_step,
    explicit_rate_limit,
    own_step_limit,
)
from heartcase.simulator.engine.backends import Backend, Engine, make_engine
from heartcase.simulator.lattice.explicit_springs import ExplicitSprings
from heartcase.simulator.lattice.loose_nodes import without_loose_nodes
from heartcase.simulator.lattice.model import LatticeModel
from heartcase.simulator.lattice.state import State
from heartcase.simulator.surface.deform import DeformedSurface, PickingModel, SurfaceModel
from heartcase.simulator.surface.followers import SurfaceFollower
from heartcase.simulator.surface.shown_surfaces import ShownSurfaces
from heartcase.simulator.surface.tissue_inside import tissue_inside
from heartcase.simulator.surface_splitting.cuttable_surface import CuttableSurface
from heartcase.simulator.surface_splitting.free_parts import cut_picking, without_excised
from heartcase.simulator.surface_splitting.split_surface import SplitSurface, split_surface
from heartcase.simulator.tissue.checked import check_fit
from heartcase.simulator.tissue.coming_cuts import CutsAhead, CutTissue, cut_tissue

__all__ = ["MovingTissue"]

_FAR = 1e5
"""Displacement that no blade reaches [cells]."""
_SPLITS_KEPT = 8
"""Split surfaces that are kept for going back and on."""


class MovingTissue:
    """A lattice in motion, and the surfaces that follow it.

    Parameters
    ----------
    model
        The lattice.
    surface, picking
        Surfaces that follow it, where they are wanted.
    tissue
        Where in its cells the tissue lies that blades cut; inside ``surface`` when left out.
    step_s
        Time step, s; the case's default when left out.
    pace
        How many times as long steps may be, as of :class:`heartcase.simulator.simulation.Simulation`.
    backend
        What moves it.
    skips_unmoved
        As of :class:`heartcase.simulator.surface.followers.SurfaceFollower`.

    Raises
    ------
    SimulationError
        A step is beyond the lattice's own limit, there is no such backend, or a surface is of another lattice.
    """

    def __init__(
        self,
        model: LatticeModel,
        *,
        surface: SurfaceModel | None,
        picking: PickingModel | None,
        tissue: TissueSamples | None,
        step_s: float | None,
        pace: float | None,
        backend: Backend,
        skips_unmoved: bool,
    ) -> None:
        check_fit(model, surface, picking, tissue)
        self.model = model
        self.surface = self._whole_surface = surface
        self.picking = self._whole_picking = picking
        self.split: SplitSurface | None = None
        self._tissue = tissue
        sizes = StepSizes(model)
        self.step_s = checked_step(sizes, step_s)
        if pace is None:
            pace = sizes.pace(self.step_s) if step_s is None and backend != "cuda" else 1.0
        self.pace = checked_pace(sizes, self.step_s, pace)
        self.backend = backend
        self.cuts: Cuts | None = None
        self._cuttable: CuttableSurface | None = None
        self._splits: list[tuple[Cuts, SplitSurface]] = []
        self._split_ahead: tuple[tuple[Cuts, SplitSurface], ...] = ()
        self._ahead = CutsAhead()
        self._rate_limit: tuple[LatticeModel, float] | None = None
        self._inverse_mass = model.inverse_mass
        self._engine = make_engine(model, backend)
        self._state: State | None = None
        self._skips_unmoved = skips_unmoved
        self._surfaces = self._make_surfaces()

    @property
    def state(self) -> State:
        """The state now, in grid units; not to be changed."""
        if self._state is None:
            self._state = self._engine.read()
        return self._state

    @property
    def step_count(self) -> int:
        """Steps taken."""
        return self._engine.step_count

    @property
    def step_limit_s(self) -> float:
        """Largest step that is stable at rest with the springs that there are now, s."""
        return own_step_limit(self.model)

    def cut(self, poses_mm: Poses, *, at_rest: bool = False, name: str = "blade") -> None:
        """Cut along what a blade sweeps from pose to pose; nothing moves in this moment.

        The tissue is parted along the sheet itself, wherever in cells that lies: each piece of a cell becomes a cell of
        its own, with its share of coverage and mass (:mod:`heartcase.simulator.cutting`). Hands hold all copies of the
        nodes that they held.

        Parameters
        ----------
        poses_mm
            Points of the blade's edge at each pose, LPS mm, shape (pose_count, point_count, 3), at least two of each.
            For a line drawn on tissue: the line, and the line at its depth.
        at_rest
            Whether they are places of the tissue at rest; else they are places now. At rest a point may be NaN or None:
            the blade met no tissue there.
        name
            Name in messages.

        Raises
        ------
        SimulationError
            Too few poses or points, numbers that are not finite, a blade that reaches too far, or springs were removed
            one by one: what they held together is not known.
        """
        rest_mm = poses_mm if at_rest else self.rest_poses_mm(poses_mm, name=name)
        points = blade_points(self.model, rest_mm, name, may_be_open=True)
        made = self._ahead.take(points, self.model, self.cuts)
        if made is None:
            made = self._cut_tissue(self.model, self.cuts or self.nothing_cut(), points, self._engine)
        model, cuts, step = made.model, made.cuts, made.step
        if self.model.explicit is not made.before.explicit:
            model = replace(model, explicit=step.joined(self.model.explicit))
        self._check_explicit(model, cuts)
        state = step.carried(self.state)
        self._set_model(model, cuts, made)
        self._engine.load(state)
        self._carry(step)
        self._state = None

    def begin_cut(self, poses_mm: Poses, *, at_rest: bool = False, name: str = "blade") -> Float64:
        """Begin to work out, in a thread of its own, what a cut will leave; nothing is cut yet, and steps go on.

        :meth:`cut` with the poses that are returned then makes the cut at once, and the same to the bit as without
        this. Several that are begun must be made in their order; another change of the lattice makes them void, and
        :meth:`cut` works out again what it needs.

        Parameters
        ----------
        poses_mm, at_rest, name
            As of :meth:`cut`.

        Returns
        -------
        ndarray
            Poses of the blade at rest, LPS mm, shape (any, any, 3): where it meets the tissue now, else NaN.

        Raises
        ------
        SimulationError
            As of :meth:`cut`; that springs were removed one by one is said by :meth:`cut` alone.
        """
        given = checked_poses(poses_mm, name, may_be_open=at_rest)
        rest_mm = given if at_rest else self.rest_poses_mm(given, name=name)
        points = blade_points(self.model, rest_mm, name, may_be_open=True)
        nothing_cut = self.nothing_cut()
        self._prepare_split(nothing_cut)
        self._ahead.begin(points, self.model, self.cuts, nothing_cut, self._engine, self._cut_tissue)
        return rest_mm

    @property
    def coming_cuts(self) -> int:
        """Cuts that were begun and not made."""
        return len(self._ahead)

    @property
    def is_cut_ready(self) -> bool:
        """Whether the next of the cuts that were begun can be made without waiting."""
        return self._ahead.is_ready

    def prepare_cuts(self) -> None:
        """Compile what a cut needs, so that the first is as quick as the rest; nothing changes."""
        middle = self.model.node_index[self.model.cell_corners[0]].mean(axis=0)
        square = 2.4 * np.array([[[-1.0, -1, 0], [1, -1, 0]], [[-1, 1, 0], [1, 1, 0]]])
        # Sheets that go through tissue and cross each other, and one more that changes nothing.
        ways = [square, square[..., [0, 2, 1]], square[..., [2, 0, 1]], square]
        model, cuts, engine, state = self.model, self.cuts or self.nothing_cut(), None, self.state
        for way in ways:
            moved = np.ones((model.node_count, 3), np.float32)
            # Where it meets no tissue, too.
            for there in (middle + way, middle + way + 1e3):
                blade_at_rest(model, moved, refined(there, "blade"), cuts.parted)
            made = self._cut_tissue(model, cuts, middle + way, engine)
            model, cuts, engine, state = made.model, made.cuts, made.engine, made.step.carried(state)
        if made.split is not None and self.backend != "cuda":
            SurfaceFollower(model, made.split.surface).prepare()

    def rest_poses_mm(self, poses_mm: Poses, *, name: str = "blade") -> Float64:
        """Where a blade that is swept now meets the tissue at rest: more poses and points, LPS mm, (any, any, 3).

        NaN where it meets none, as between lips that are held apart.

        Parameters
        ----------
        poses_mm, name
            As of :meth:`cut`.

        Raises
        ------
        SimulationError
            As of :meth:`cut`.
        """
        points = refined(blade_points(self.model, poses_mm, name), name)
        parted = None if self.cuts is None else self.cuts.parted
        displacement = self.state.displacement
        if self.cuts is not None and self.cuts.excised is not None:
            # No blade meets what was taken out, wherever that stood.
            displacement = displacement.copy()
            displacement[: len(self.cuts.excised)][self.cuts.excised] = _FAR
        rest = blade_at_rest(self.model, displacement, points, parted)
        rest_mm: Float64 = self.model.geometry.index_to_world(rest - 0.5)
        return rest_mm

    def remove_springs(self, removed: npt.ArrayLike) -> None:
        """Take springs of the lattice away: the plain way to cut, in whole cells.

        Hands hold on to what they held before, and the surface is not split.

        Parameters
        ----------
        removed
            True for each spring of ``model`` to take away, shape (spring_count,).

        Raises
        ------
        SimulationError
            It has not one value for each spring, or a blade has cut the tissue before.
        """
        if self.cuts is not None:
            raise SimulationError("the tissue was cut: cut it by blades only", place="removed")
        self._check_mask(removed, self.model.spring_count)
        self._set_model(self.model.without_springs(removed), self.cuts)

    def add_springs(
        self, nodes: npt.ArrayLike, stiffness_n_m: npt.ArrayLike, rest_length_mm: npt.ArrayLike | None = None
    ) -> None:
        """Join nodes by explicit springs (thesis 8.5.1).

        Parameters
        ----------
        nodes
            Two different nodes each, shape (count, 2).
        stiffness_n_m
            Stiffness, N/m, above zero; one number or shape (count,).
        rest_length_mm
            Length at rest, mm; the distance now when left out; one number or shape (count,).

        Raises
        ------
        SimulationError
            With everything that is wrong: nodes that there are not, numbers out of range, springs that are too stiff
            for the time step.
        """
        how = {"step_s": self.step_s, "thread_rate": self._thread_rate()}
        joined = join(self.model, self.state.displacement, nodes, stiffness_n_m, rest_length_mm, **how)
        self._set_model(joined, self.cuts)

    def remove_explicit_springs(self, removed: npt.ArrayLike) -> None:
        """Take explicit springs away; True for each of ``model.explicit``, shape (count,).

        Raises
        ------
        SimulationError
            It has not one value for each.
        """
        self._check_mask(removed, self.model.explicit.count)
        kept = self.model.explicit.without(np.asarray(removed, dtype=bool))
        self._set_model(replace(self.model, explicit=kept), self.cuts)

    def displacement_mm(self) -> Float64:
        """Displacement of every node now, LPS mm, shape (node_count, 3)."""
        return self.model.to_mm(self.state.displacement)

    def positions_mm(self) -> Float64:
        """Position of every node now, LPS mm, shape (node_count, 3)."""
        return self.model.rest_positions_mm() + self.displacement_mm()

    def surface_now(self) -> DeformedSurface:
        """The visible surface now; its arrays are not to be changed, and do not change when the simulation goes on.

        Raises
        ------
        SimulationError
            The simulation was made without one.
        """
        return self._surfaces.surface_now(self.state)

    def picking_now(self) -> DeformedSurface:
        """The one-to-one surface now; its arrays are not to be changed, and do not change when the simulation goes on.

        Raises
        ------
        SimulationError
            The simulation was made without one.
        """
        return self._surfaces.picking_now(self.state)

    def nothing_cut(self) -> Cuts:
        """What a first cut begins with: the lattice before it, and its tissue.

        Where that was not given it lies inside the visible surface at rest, and fills its cells where there is none.
        """
        if self.cuts is not None:
            return Cuts(self.cuts.uncut, self.cuts.tissue)
        uncut = replace(without_loose_nodes(self.model), explicit=ExplicitSprings.none())
        if self._tissue is None and self._whole_surface is not None:
            self._tissue = tissue_inside(uncut, self._whole_surface)
        return Cuts(uncut, self._tissue or TissueSamples.everywhere())

    @staticmethod
    def uncut(model: LatticeModel, cuts: Cuts | None) -> LatticeModel:
        """The lattice before all cuts, without loose nodes."""
        return without_loose_nodes(model) if cuts is None else cuts.uncut

    def _carry(self, step: Step) -> None:
        """Let instruments hold on from one lattice to the next."""

    def _thread_rate(self) -> float:
        """What threads that hang on it add to omega^2 at most [1 / unit of time^2]."""
        return 0.0

    def _explicit_rate_limit(self, uncut: LatticeModel) -> float:
        """What explicit springs may add to omega^2; worked out once for a lattice, as elements take long to ask."""
        if self._rate_limit is None or self._rate_limit[0] is not uncut:
            self._rate_limit = (uncut, explicit_rate_limit(uncut, self.step_s))
        return self._rate_limit[1]

    def _check_explicit(self, model: LatticeModel, cuts: Cuts) -> None:
        """SimulationError where explicit springs are too stiff for what is left of the tissue that they hang on."""
        if not model.explicit.count:
            return
        rate = model.explicit.rate_bound(model.inverse_mass)
        if rate and rate > self._explicit_rate_limit(cuts.uncut):
            raise SimulationError(
                "explicit springs hang on so little tissue after this cut that they are too stiff for the time step: "
                "remove them first, or take a smaller step",
                place="cut",
            )

    def _set_model(self, model: LatticeModel, cuts: Cuts | None, made: CutTissue | None = None) -> None:
        """Go on with another model; where it has other nodes, the engine starts from rest and without hands.

        What was made of it already is given. What raises does so before anything has changed.
        """
        if cuts is self.cuts and np.array_equal(model.node_index, self.model.node_index):
            self._engine.set_springs(model)
            self.model = model
            return
        split = None if cuts is None else self._split_of(cuts, None if made is None else made.split)
        if cuts is not None and split is not None and cuts.excised is not None:
            split = without_excised(split, cuts.excised)
        picking = self._whole_picking
        if picking is not None and cuts is not None:
            picking = cut_picking(without_loose_nodes(model), cuts.excised) if made is None else made.picking
        engine = None if made is None else made.engine
        if engine is None:
            engine = make_engine(model, self.backend, self._engine)
        elif made is not None and model is not made.model:
            engine.set_springs(model)
        engine.step_count = self._engine.step_count
        split_before = self.split
        self.model, self.cuts, self.split, self.picking = model, cuts, split, picking
        self.surface = self._whole_surface if split is None else split.surface
        self._inverse_mass, self._engine = model.inverse_mass, engine
        before, self._surfaces = self._surfaces, self._make_surfaces()
        if self._whole_surface is not None and cuts is not None:
            other = [each.work.other for each in (split_before, split) if each is not None and each.work is not None]
            self._surfaces.go_on_from(
                before, self._whole_surface, cuts.uncut.node_count, np.concatenate([np.zeros(0, np.int64), *other])
            )

    def _cut_tissue(self, model: LatticeModel, cuts: Cuts, points: Float64, engine_before: Engine | None) -> CutTissue:
        """What one more cut leaves of some lattice, of which so much was cut, and which an engine moves."""
        before = next((split for known, split in (*self._splits, *self._split_ahead) if known is cuts), None)
        made = cut_tissue(
            model,
            cuts,
            points,
            cuttable=self._prepare_split(cuts),
            has_picking=self._whole_picking is not None,
            backend=self.backend,
            split_before=before,
            engine_before=engine_before,
        )
        self._split_ahead = () if made.split is None else ((made.cuts, made.split),)
        return made

    def _prepare_split(self, cuts: Cuts) -> CuttableSurface | None:
        """The surface over the uncut lattice, where there is one."""
        if self._cuttable is None and self._whole_surface is not None:
            self._cuttable = CuttableSurface.of(cuts.uncut, self._whole_surface)
        return self._cuttable

    def _split_of(self, cuts: Cuts, made: SplitSurface | None) -> SplitSurface | None:
        """The surface that some cuts leave, where there is one; given if it was made already."""
        cuttable = self._prepare_split(cuts)
        if cuttable is None or cuts.parted is None:
            return None
        for known, split in self._splits:
            if known is cuts:
                return split
        if made is None:
            before = self._splits[-1][1] if self._splits else None
            split = split_surface(cuttable, cuts.parted, cuts.sheets, before)
        else:
            split = made
        self._splits = [*self._splits[1 - _SPLITS_KEPT :], (cuts, split)]
        return split

    def _make_surfaces(self) -> ShownSurfaces:
        return ShownSurfaces(
            self.model,
            self._engine,
            self.backend,
            surface=self.surface,
            picking=self.picking,
            skips_unmoved=self._skips_unmoved,
        )

    @staticmethod
    def _check_mask(removed: npt.ArrayLike, count: int) -> None:
        if np.shape(removed) != (count,):
            raise SimulationError(f"there are {count} springs: give one value for each", place="removed")
