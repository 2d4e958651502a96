"""A surface from frame to frame: only vertices of which a node moved are worked out again.

Every bit is that of :func:`heartcase.simulator.surface.deform.deform`. A vertex follows from the displacement of its
nodes and from their approximate normals, and those from the nodes' displacement and their neighbours'. Where no bit of
all these changed, the vertex of the last frame is that of this one.
"""

from __future__ import annotations

import numpy as np

from heartcase.schemas.arrays import Float32, Int32, Int64
from heartcase.simulator.lattice.model import LatticeModel
from heartcase.simulator.surface.cpu_kernels import MOVED, mark_moved, node_normals
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
        self._other: Int64 | None = None

    def go_on_from(self, before: SurfaceFollower, uncut: SurfaceModel, node_count: int, other: Int64) -> None:
        """Take over the last frame of a surface that was cut otherwise, so that only what differs is worked out.

        Parameters
        ----------
        before
            Shows a surface that was split from the same uncut one.
        uncut, node_count
            The uncut surface, and the number of nodes of its lattice, which have the same numbers in both.
        other
            Its vertices that follow their nodes otherwise in one of the two surfaces than in the uncut one.
        """
        last, count, drawn = before._frame, uncut.vertex_count, len(uncut.tangent)
        if last is None or not (self.skips_unmoved and isinstance(self.surface, SurfaceModel)):
            return
        frame, normal_count = empty_frame(self.surface), len(uncut.normals_of.nodes)
        frame.vertices_mm[:count], frame.normals[:count] = last.vertices_mm[:count], last.normals[:count]
        if frame.tangents is not None and last.tangents is not None:
            frame.tangents[:drawn] = last.tangents[:drawn]
        self._before[:node_count] = before._before[:node_count]
        self._node_normal[:normal_count] = before._node_normal[:normal_count]
        # Where these nodes count as moved, all that may differ is worked out, and some that does not.
        nodes = self.surface.triangle_nodes
        is_other = np.zeros(len(self._marks), np.bool_)
        is_other[nodes[other]] = is_other[nodes[count:]] = True
        is_other[self.surface.normals_of.nodes[normal_count:]] = is_other[node_count:] = True
        self._frame, self._other = frame, np.flatnonzero(is_other)

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
        other, self._other = self._other, None
        if last is None or moved_count > SKIPPING_SHARE_MAX * self._model.node_count:
            frame = self._worked_out(displacement, together)
        elif other is not None:
            self._marks[other] = MOVED
            frame = self._mended(last, displacement)
        else:
            frame = self._mended(_copied(last), displacement) if moved_count else last
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

    def _mended(self, frame: DeformedSurface, displacement: Float32) -> DeformedSurface:
        """A frame, what changed in it worked out again."""
        springs = self.surface.normals_of.springs
        node_normals(springs, displacement, self._node_normal, self._marks)
        write_vertices(self._model, self.surface, self._node_normal, displacement, frame, self._marks)
        return frame


def _copied(frame: DeformedSurface) -> DeformedSurface:
    tangents = None if frame.tangents is None else frame.tangents.copy()
    return DeformedSurface(frame.vertices_mm.copy(), frame.normals.copy(), tangents)


def _bits(displacement: Float32) -> Int32:
    return displacement.view(np.int32).ravel()
