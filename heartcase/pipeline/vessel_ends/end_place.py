"""How a disc across a vessel lies at a place: its middle, its axis out of the heart, and its radius."""

from __future__ import annotations

import edt
import numpy as np

from heartcase.pipeline.data import Segmentation
from heartcase.pipeline.vessel_ends.discs import Stumps, radii_for
from heartcase.pipeline.vessel_ends.lumen_sections import Lumen, Section, across
from heartcase.schemas.arrays import Float64
from heartcase.schemas.base import Vector3
from heartcase.schemas.errors import UsageError
from heartcase.schemas.labels import Label, LabelTable
from heartcase.schemas.recipe.settings import EndMarker

__all__ = ["end_place"]

LIMIT_MM = 40.0
"""Sections that reach farther are no vessel's."""
STARTS = 13
"""Directions that are looked along: half of those to the faces, edges and corners of a cube."""
TRIES = 3
"""So many of the smallest sections are turned across the lumen."""


def end_place(
    segmentation: Segmentation, table: LabelTable, stumps: Stumps, point_mm: Vector3, name: str | None = None
) -> EndMarker:
    """The disc that lies across the vessel at a point, as a recipe has it.

    The smallest of the sections that lie across the lumen there is taken; its axis points away from the middle of all
    chambers.

    Parameters
    ----------
    segmentation
        Labels.
    table
        Label table, with walls.
    stumps
        What the cuts will leave behind their discs: room for the wall.
    point_mm
        A point in the vessel, LPS mm.
    name
        Which vessel; the one at the point when left out.

    Returns
    -------
    EndMarker
        Positions are rounded to 0.1 mm, axes to 0.001.

    Raises
    ------
    UsageError
        The point lies outside the scan or in no vessel, or there is no section of a tube.
    """
    geometry = segmentation.geometry
    point = np.array(point_mm)
    index = np.rint(geometry.world_to_index(point)).astype(int)
    if np.any(index < 0) or np.any(index >= geometry.size):
        raise UsageError("lies outside the scan: click inside it", place="position_mm")
    label = _vessel(segmentation, table, index, name)
    mask = segmentation.labels == label.value
    if not mask.any():
        raise UsageError(f"{label.name!r} has no voxels yet: paint it first", place="label")
    lumen = Lumen.of(mask, geometry)
    cuts = [one for axis in _starts() if (one := lumen.section(point, axis, LIMIT_MM)) is not None and one.is_whole]
    cuts = sorted(cuts, key=lambda one: round(one.area_mm2, 3))[:TRIES]
    found = [one for cut in cuts if (one := across(lumen, point, cut.axis, LIMIT_MM)) is not None]
    if not found:
        raise UsageError(
            f"{label.name!r} is no tube here: click farther out, or drag across the vessel to set the disc by hand",
            place="position_mm",
        )
    section: Section = min(found, key=lambda one: (round(one.area_mm2, 3), one.extent_mm))
    axis = section.axis
    heart = _heart_middle(segmentation, table)
    if heart is not None and (section.middle - heart) @ axis < 0.0:
        axis = -axis
    radius = radii_for(section.extent_mm, stumps.wall_mm(label), stumps, max(geometry.spacing_mm))[0]
    return EndMarker(
        label=label.name,
        position_mm=_rounded(section.middle, 1),
        axis=_rounded(axis / np.linalg.norm(axis), 3),
        radius_mm=round(float(radius), 1),
    )


def _vessel(segmentation: Segmentation, table: LabelTable, index: Float64, name: str | None) -> Label:
    if name is not None:
        label = table.find(name)
        if label is None:
            raise UsageError(f"there is no label {name!r}: take one of the list", place="label")
    else:
        i, j, k = index
        label = table[int(value)] if (value := segmentation.labels[k, j, i]) in table else table[0]
    if not label.role.is_blood:
        raise UsageError(f"{label.name!r} is no cavity: click inside a vessel, or name it", place="position_mm")
    return label


def _starts() -> list[Float64]:
    every = [np.array((x, y, z), dtype=np.float64) for x in (-1, 0, 1) for y in (-1, 0, 1) for z in (-1, 0, 1)]
    return [one / np.linalg.norm(one) for one in every[-STARTS:]]


def _heart_middle(segmentation: Segmentation, table: LabelTable) -> Float64 | None:
    """Middle of the chambers' deepest parts, world mm: so veins in a chamber's label hardly count."""
    chambers = [label.value for label in table if label.role.value == "blood"]
    mask = np.isin(segmentation.labels, chambers)
    if not mask.any():
        return None
    deep = edt.edt(mask, anisotropy=segmentation.geometry.spacing_mm[::-1])
    k, j, i = np.nonzero(deep >= 0.5 * deep.max())
    middle: Float64 = segmentation.geometry.index_to_world(np.array([i.mean(), j.mean(), k.mean()]))
    return middle


def _rounded(vector: Float64, digits: int) -> Vector3:
    x, y, z = (round(float(one), digits) + 0.0 for one in vector)
    return x, y, z
