"""The visible surface on a CUDA device: deformed where the nodes are, read back in LPS mm."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from numba import cuda

from heartcase.simulator.engine.backends import Engine
from heartcase.simulator.engine.cuda.cells import plain_launch
from heartcase.simulator.engine.cuda.engine import CudaEngine
from heartcase.simulator.lattice.model import LatticeModel
from heartcase.simulator.surface.cuda_kernels import (
    deform_in_cells,
    deform_vertices,
    node_normals,
    turn_tangents,
)
from heartcase.simulator.surface.deform import DeformedSurface, SurfaceModel

__all__ = ["SurfaceOnDevice", "deform_on_device"]


class SurfaceOnDevice:
    """Constant arrays of a surface on the device, and room for what follows from them.

    Parameters
    ----------
    model
        The lattice that the surface follows.
    surface
        The surface.
    """

    def __init__(self, model: LatticeModel, surface: SurfaceModel) -> None:
        direction = model.geometry.direction_matrix.T.astype(np.float32)
        springs = surface.normals_of
        self.normal_count = len(springs.nodes)
        self.vertex_count = surface.vertex_count
        self.render_vertex_count = len(surface.tangent)
        self._springs = _on_device(springs.nodes, springs.first, springs.neighbours, springs.offset)
        self._constants = _on_device(
            surface.triangle_nodes,
            surface.weights,
            surface.edges,
            surface.curvature,
            surface.offset,
            surface.normal,
            surface.normal_number,
        )
        self._rest = _on_device(surface.rest_mm, surface.rest_turn, direction * np.float32(model.cell_mm), direction)
        self._tangents = _on_device(surface.render_to_welded, surface.tangent, direction)
        self._in_cells = _on_device(*surface.in_cells.arrays)
        # Without such vertices, too: the first cut need not wait for the kernel.
        self._cell_launch = plain_launch(max(len(surface.in_cells.vertices), 1))
        self._drawn = _on_device(*surface.drawn)
        base_count = self.vertex_count if self.render_vertex_count else 0
        self._node_normals = cuda.to_device(np.zeros((max(self.normal_count, 1), 3), np.float32))
        self._bases = cuda.device_array((base_count, 3, 3), np.float32)
        self._moved = cuda.device_array((self.vertex_count, 3), np.float32)
        self._vertices = cuda.mapped_array((self.vertex_count, 3), np.float32)
        self._normals = cuda.mapped_array((self.vertex_count, 3), np.float32)
        self._turned = cuda.mapped_array((max(self.render_vertex_count, 1), 4), np.float32)

    def deform(self, engine: CudaEngine) -> DeformedSurface:
        """The surface over the engine's nodes now."""
        displacement = engine.displacement_on_device()
        if self.normal_count:
            node_normals[plain_launch(self.normal_count)](*self._springs, displacement, self._node_normals)
        if self.vertex_count:
            deform_vertices[plain_launch(self.vertex_count)](
                *self._constants,
                self._node_normals,
                displacement,
                self._moved,
                self._bases,
                *self._rest,
                self._vertices,
                self._normals,
            )
        if self.render_vertex_count:
            turn_tangents[plain_launch(self.render_vertex_count)](self._bases, *self._tangents, self._turned)
        rest_mm, _, to_mm, direction = self._rest
        turning = displacement, rest_mm, to_mm, direction
        written = self._vertices, self._normals, self._turned
        deform_in_cells[self._cell_launch](*self._in_cells, *turning, *self._drawn, *written)
        cuda.synchronize()
        return DeformedSurface(
            vertices_mm=np.array(self._vertices),
            normals=np.array(self._normals),
            tangents=np.array(self._turned) if self.render_vertex_count else None,
        )


def deform_on_device(model: LatticeModel, surface: SurfaceModel, engine: Engine) -> Callable[[], DeformedSurface]:
    """What deforms a surface over the nodes of a CUDA engine whenever it is called."""
    if not isinstance(engine, CudaEngine):
        raise TypeError("the engine must be one of a CUDA device")
    on_device = SurfaceOnDevice(model, surface)
    return lambda: on_device.deform(engine)


def _on_device(*arrays: Any) -> tuple[Any, ...]:
    return tuple(cuda.to_device(np.ascontiguousarray(array)) for array in arrays)
