"""A surface over a lattice before any cut, prepared so that each split of it starts from the same."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from heartcase.schemas.arrays import Float32, Float64, Int32, Int64
from heartcase.simulator.cutting.tissue_samples import TissueSamples
from heartcase.simulator.lattice.model import LatticeModel
from heartcase.simulator.mesh_arrangement.uncut_surface import UncutSurface
from heartcase.simulator.surface.deform import SurfaceModel, deform, rest_normals, ways_of_nodes
from heartcase.simulator.surface_splitting.surface_binding import TiedSurface

__all__ = ["CuttableSurface"]


@dataclass(frozen=True)
class CuttableSurface:
    """A surface over a lattice, before any cut: what every split of it starts from."""

    model: LatticeModel
    """The uncut lattice."""
    surface: SurfaceModel
    """The uncut surface, with triangles."""
    mesh: UncutSurface
    """The same at rest, in the frame of the nodes."""
    normals: Float64
    """Unit normals at rest, grid axes, shape (vertex_count, 3)."""
    curved: Int64
    """Vertices with an interpolated basis, ascending."""
    rest_normals: Float32
    """Approximate normals at rest of the nodes that these need, shape (at least 1, 3)."""
    lowest_neighbours: Int32
    """Lowest node that a spring joins to each node, or itself, shape (node_count,)."""
    ways: Int64
    """Ways of the springs of each node: see :func:`heartcase.simulator.surface.deform.ways_of_nodes`."""
    tied: TiedSurface
    """What its vertices follow."""

    @classmethod
    def of(cls, model: LatticeModel, surface: SurfaceModel) -> CuttableSurface:
        """Prepare a surface.

        Raises
        ------
        SimulationError
            The surface is not closed.
        """
        still = deform(model, surface, np.zeros((model.node_count, 3), np.float32))
        places = model.geometry.world_to_index(surface.rest_mm.astype(np.float64)) + 0.5
        normals = still.normals.astype(np.float64) @ model.geometry.direction_matrix
        mesh = UncutSurface.of(places, surface.triangles)
        tied = TiedSurface.of(model, surface.triangle_nodes, mesh.places, mesh.triangles)
        curved, at_rest = np.flatnonzero(surface.curvature), rest_normals(surface.normals_of)
        lowest = np.arange(model.node_count, dtype=np.int32)
        np.minimum.at(lowest, model.spring_nodes[:, 1], model.spring_nodes[:, 0])
        return cls(model, surface, mesh, normals, curved, at_rest, lowest, ways_of_nodes(model), tied)

    def samples(self) -> TissueSamples:
        """Samples of the tissue inside the surface."""
        return TissueSamples.inside(self.mesh.places, self.mesh.triangles)
