"""Rims of defects: triangles around an opening that a normal heart has closed."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from heartcase.pipeline.checks.openings import Opening, Verdict
from heartcase.pipeline.data import Surface
from heartcase.schemas.bundle.surface_kinds import SurfaceKind
from heartcase.schemas.geometry import Geometry

__all__ = ["with_rims"]


RIM_VOXELS = 1.5
"""How far from the plane of an opening its rim reaches, in edges of a cube with the volume of a voxel."""
OF_A_DEFECT = (Verdict.STATED, Verdict.UNEXPECTED)


def with_rims(surface: Surface, openings: Sequence[Opening], geometry: Geometry) -> Surface:
    """Mark the rims of defects, at every level of detail.

    Around each opening that the recipe states or that no normal heart has, the triangles nearest to where the blood of
    the two sides meets are its rim; of a canal that an edit made, its whole wall. Cut faces and devices are none.

    Parameters
    ----------
    surface
        The surface.
    openings
        From :func:`heartcase.pipeline.checks.openings.find_openings`.
    geometry
        The lattice of the voxels.
    """
    chosen = [one for one in openings if one.verdict in OF_A_DEFECT]
    if not chosen:
        return surface
    reach = RIM_VOXELS * geometry.voxel_volume_mm3 ** (1.0 / 3.0)
    levels = tuple(_one_level(level, chosen, reach) for level in surface.levels)
    return replace(_one_level(surface, chosen, reach), levels=levels)


def _one_level(surface: Surface, openings: Sequence[Opening], reach_mm: float) -> Surface:
    corner = surface.vertices_mm[surface.triangles].astype(np.float64)
    centre = corner.mean(axis=1)
    doubled = np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0])
    normal = doubled / np.maximum(np.linalg.norm(doubled, axis=1), 1e-30)[:, None]
    kinds = surface.triangle_kind.copy()
    may_be = ~np.isin(kinds, (SurfaceKind.CUT_FACE, SurfaceKind.DEVICE))
    for one in openings:
        beside = np.isin(surface.triangle_label, one.labels)
        near = one.has_rim_at(centre, normal, reach_mm)
        kinds[may_be & beside & near] = SurfaceKind.DEFECT_RIM
    return replace(surface, triangle_kind=kinds)
