"""A surface from frame to frame: only vertices of which a node moved are worked out again.

Every bit is that of :func:`heartcase.simulator.surface.deform.deform`. A vertex follows from the displacement of its
nodes and from their approximate normals, and those from the nodes' displacement and their neighbours'. Where no bit of
all these changed, the vertex of the last frame is that of this one.
"""

from __future__ import annotations

import numpy as np

from heartcase.schemas.arrays import Float32, Int32
from heartcase.simulator.lattice.model import LatticeModel
from heartcase.simulator.surface.cpu_kernels import mark_moved, node_normals
from heartcase.simulator.surface.deform import (
    DeformedSurface,
    PickingModel,
    SurfaceModel,
    empty_frame,
    empty_normals,
    write_vertices,
)

__all__ = ["SurfaceFollower"]


SKIPPING_SHARE_MAX = 0.5
"""Share of moved nodes from which on all is worked out: on more than one thread that is as quick."""
PARALLEL_VERTICES_MIN = 10_000
"""Vertices from which on more than one thread may pay."""


class SurfaceFollower:
    """Shows a surface over displaced nodes, frame after frame.

    Parameters
    ----------
    model
        The lattice that the surface follows. That springs are removed or added later makes no difference.
    surface
        The visible surface, or the one-to-one surface.
    skips_unmoved
        Take over from the last frame what has not changed since. The frames are then read-only.
    """

    def __init__(
        self, model: LatticeModel, surface: SurfaceModel | PickingModel, *, skips_unmoved: bool = True
    ) -> None:
        self.surface = surface
        self.skips_unmoved = skips_unmoved
        self._model = model
        self._frame: DeformedSurface | None = None
        self._before = np.zeros((model.node_count, 3), np.float32)
        self._marks = np.zeros(model.node_count, np.uint8)
        self._node_normal = empty_normals(surface.normals_of)

    def prepare(self) -> None:
        """Compile what will be needed."""
        for together in (True, False):
            self._frame = None
            self.now(self._before, together=together)

    def now(self, displacement: Float32, *, together: bool = False) -> DeformedSurface:
        """The surface over these nodes, as :func:`heartcase.simulator.surface.deform.deform` gives it.

        Parameters
        ----------
        displacement
            Displacement of the nodes [cells, grid axes], float32, shape (node_count, 3).
        together
            Whether threads are idle that would share the work where there is much of it: the same bits.

        Returns
        -------
        DeformedSurface
            The last frame itself where nothing moved. Frames that were given out before stay as they are.
        """
        displacement = np.ascontiguousarray(displacement, np.float32)
        together = together and self.surface.vertex_count >= PARALLEL_VERTICES_MIN
        if not self.skips_unmoved:
            return self._worked_out(displacement, together)
        # Until this one is finished there is no frame: if it is interrupted, the next one is worked out whole.
        last, self._frame = self._frame, None
        moved_count = mark_moved(_bits(displacement), _bits(self._before), self._marks)
        if last is None or moved_count > SKIPPING_SHARE_MAX * self._model.node_count:
            frame = self._worked_out(displacement, together)
        else:
            frame = self._mended(last, displacement) if moved_count else last
        for array in (frame.vertices_mm, frame.normals, frame.tangents):
            if array is not None:
                array.flags.writeable = False
        self._frame = frame
        return frame

    def _worked_out(self, displacement: Float32, together: bool) -> DeformedSurface:
        """All of it."""
        frame = empty_frame(self.surface)
        node_normals(self.surface.normals_of.springs, displacement, self._node_normal, together=together)
        write_vertices(self._model, self.surface, self._node_normal, displacement, frame, together=together)
        return frame

    def _mended(self, last: DeformedSurface, displacement: Float32) -> DeformedSurface:
        """A copy of the last frame in which what changed is worked out again."""
        tangents = None if last.tangents is None else last.tangents.copy()
        frame = DeformedSurface(last.vertices_mm.copy(), last.normals.copy(), tangents)
        springs = self.surface.normals_of.springs
        node_normals(springs, displacement, self._node_normal, self._marks)
        write_vertices(self._model, self.surface, self._node_normal, displacement, frame, self._marks)
        return frame


def _bits(displacement: Float32) -> Int32:
    return displacement.view(np.int32).ravel()
