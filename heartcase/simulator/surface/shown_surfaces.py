"""The surfaces that a simulation shows: each over the nodes of the moment, on the CPU or where the nodes are."""

from __future__ import annotations

from collections.abc import Callable

from heartcase.schemas.arrays import Int64
from heartcase.schemas.errors import SimulationError
from heartcase.simulator.engine.backends import Backend, Engine
from heartcase.simulator.lattice.model import LatticeModel
from heartcase.simulator.lattice.state import State
from heartcase.simulator.surface.deform import DeformedSurface, PickingModel, SurfaceModel
from heartcase.simulator.surface.followers import SurfaceFollower

__all__ = ["ShownSurfaces"]


class ShownSurfaces:
    """What follows the nodes of an engine.

    Parameters
    ----------
    model, engine, backend
        The lattice, and what moves it.
    surface, picking
        The visible and the one-to-one surface, where they are wanted.
    skips_unmoved
        As of :class:`heartcase.simulator.surface.followers.SurfaceFollower`.
    """

    def __init__(
        self,
        model: LatticeModel,
        engine: Engine,
        backend: Backend,
        *,
        surface: SurfaceModel | None,
        picking: PickingModel | None,
        skips_unmoved: bool,
    ) -> None:
        self._engine = engine
        is_on_device = backend == "cuda"
        self._follower = (
            None if surface is None or is_on_device else SurfaceFollower(model, surface, skips_unmoved=skips_unmoved)
        )
        self._picker = None if picking is None else SurfaceFollower(model, picking, skips_unmoved=skips_unmoved)
        self._on_device: Callable[[], DeformedSurface] | None = None
        if surface is not None and is_on_device:
            from heartcase.simulator.surface.cuda_surface import deform_on_device

            self._on_device = deform_on_device(model, surface, engine)

    def go_on_from(self, before: ShownSurfaces, uncut: SurfaceModel, node_count: int, other: Int64) -> None:
        """Take over what was shown of a surface that was cut otherwise.

        Parameters
        ----------
        before, uncut, node_count, other
            As of :meth:`heartcase.simulator.surface.followers.SurfaceFollower.go_on_from`.
        """
        if self._follower is not None and before._follower is not None:
            self._follower.go_on_from(before._follower, uncut, node_count, other)

    def prepare(self) -> None:
        """Compile what will be needed."""
        for follower in (self._follower, self._picker):
            if follower is not None:
                follower.prepare()
        if self._on_device is not None:
            self._on_device()

    def surface_now(self, state: State) -> DeformedSurface:
        """The visible surface over a state, which is the engine's now.

        Raises
        ------
        SimulationError
            There is none.
        """
        if self._on_device is not None:
            return self._on_device()
        if self._follower is None:
            raise SimulationError("this simulation has no surface: load the case with needs=('surface',)")
        return self._follower.now(state.displacement, together=self._engine.threads_pay)

    def picking_now(self, state: State) -> DeformedSurface:
        """The one-to-one surface over a state.

        Raises
        ------
        SimulationError
            There is none.
        """
        if self._picker is None:
            raise SimulationError("this simulation has no picking surface: load the case with needs=('picking',)")
        return self._picker.now(state.displacement, together=self._engine.threads_pay)
