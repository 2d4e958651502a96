"""The tissue that blades cut: what lies inside the visible surface at rest."""

from __future__ import annotations

from heartcase.simulator.cutting.tissue_samples import TissueSamples
from heartcase.simulator.lattice.model import LatticeModel
from heartcase.simulator.surface.deform import SurfaceModel

__all__ = ["tissue_inside"]


def tissue_inside(model: LatticeModel, surface: SurfaceModel) -> TissueSamples:
    """Samples of the tissue inside a closed surface over a lattice that was not cut."""
    vertices = model.geometry.world_to_index(surface.rest_mm) + 0.5
    return TissueSamples.inside(vertices, surface.triangles)
