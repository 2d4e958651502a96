"""Leaks after the walls are grown: blood compartments that were joined or split, cavities open to the outside.

The structures are looked at on a lattice of twice the resolution, near the border of the blood only; a wall thinner
than that is looked for between its points as well.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numba
import numpy as np

from heartcase.compiling.kernel import loop_kernel
from heartcase.compiling.tuple_addresses import lend
from heartcase.pipeline.data import Structures
from heartcase.pipeline.fields.compartments import Change, compartment_changes
from heartcase.pipeline.fields.contacts import Contact, Extent, faces_between, without_tissue
from heartcase.pipeline.fields.point_kernels import evaluate_owner, scratch
from heartcase.pipeline.fields.reader import FieldReader, ownership_on_lattice, steps_through
from heartcase.pipeline.fields.wall_thickness import thickness_at_points
from heartcase.pipeline.kernels.parallel import side_by_side
from heartcase.pipeline.warning_words import sentence
from heartcase.pipeline.warnings import CaseWarning, anatomy, note
from heartcase.schemas.arrays import Bool, UInt8
from heartcase.schemas.geometry import Geometry
from heartcase.schemas.labels import BACKGROUND, Role

__all__ = ["leak_warnings"]


FACTOR = 2
"""Points along each edge of a voxel."""
TISSUE = 255
"""What stands for all tissue; no label has this value."""
LEAST_GAP_MM2 = 1.0
"""Gaps of a smaller area are where three structures meet, and are not reported."""
LEAST_CUT_OFF = 8 * FACTOR**3
"""What a septum cuts off a cavity is told from this many fine points on."""
MOST_WARNINGS = 5
"""Joins, splits and gaps that are told one by one, the largest; the rest is counted."""


def leak_warnings(structures: Structures, labels: UInt8) -> tuple[CaseWarning, ...]:
    """Compare the compartments of blood with those of the segmentation, and look for gaps in the walls.

    That grown septa part what was in one piece is meant; that one cuts a cavity by itself in two is told.

    Parameters
    ----------
    structures
        Fields and walls.
    labels
        The segmentation that they were made from, with the vessels continued to their ends; shape
        ``structures.geometry.shape``.

    Returns
    -------
    tuple of CaseWarning
        In plain words, with labels, areas and places in mm: joined compartments, split ones, gaps; each the largest
        first.
    """
    blood = np.array(structures.table.blood_values, np.uint8)
    corner, part = _box_with_blood(structures, labels, blood)
    if part is None:
        return ()
    reader = FieldReader.of(structures)
    fine, geometry = _fine_labels(reader, part, corner, blood)
    changes, found = side_by_side(
        lambda: compartment_changes(part, fine, blood.tolist(), geometry), lambda: list(_gaps(reader, fine, geometry))
    )
    cut_by_septa: list[Change] = []
    if structures.grown_septa:
        without, _ = _fine_labels(_without_septa(reader), part, corner, blood)
        plain = compartment_changes(part, without, blood.tolist(), geometry)
        changes = (*(one for one in changes if one.is_joined), *(one for one in plain if not one.is_joined))
        cut_by_septa = _cut_by_septa(structures, without, fine, geometry)
    joined = sorted((one for one in changes if one.is_joined), key=lambda one: -one.extent.area_mm2)
    split = sorted((one for one in changes if not one.is_joined), key=lambda one: -one.extent.area_mm2)
    gaps = sorted(found, key=lambda one: -one[1].area_mm2)
    return (
        *_listed([_of_joined(structures, one) for one in joined]),
        *_listed([_of_split(structures, one) for one in split]),
        *_listed([_of_cut(structures, one) for one in cut_by_septa]),
        *_listed([_of_gap(structures, *one) for one in gaps]),
    )


def _without_septa(reader: FieldReader) -> FieldReader:
    """A reader of the same structures before septa were grown; openings in them then change nothing."""
    none = np.zeros(0, np.int32)
    layout = reader.layout._replace(
        septum_slot=none, septum_first=none, septum_second=none, septum_half_mm=np.zeros(0, np.float32)
    )
    return FieldReader(replace(reader.structures, septa=()), layout, reader.tables)


def _cut_by_septa(structures: Structures, before: UInt8, after: UInt8, geometry: Geometry) -> list[Change]:
    """Where a cavity by itself is in one piece without the septa and in two with them, the largest first."""
    cavities = sorted({value for one in structures.grown_septa for value in (one.first, one.second)})
    changes = [
        one
        for cavity in cavities
        for one in compartment_changes(before, after, [cavity], geometry, least_voxels=LEAST_CUT_OFF)
        if not one.is_joined
    ]
    return sorted(changes, key=lambda one: -one.extent.area_mm2)


def _box_with_blood(structures: Structures, labels: UInt8, blood: UInt8) -> tuple[tuple[int, int, int], UInt8 | None]:
    """First voxel (i, j, k) and labels of the smallest box that holds all blood and two voxels around it."""
    is_blood = np.zeros(256, np.bool_)
    is_blood[blood] = True
    mask = is_blood[labels]
    there = [np.flatnonzero(mask.any(axis=axes)) for axes in ((1, 2), (0, 2), (0, 1))]
    if len(there[0]) == 0:
        return (0, 0, 0), None
    low = [max(int(one[0]) - 2, 0) for one in there]
    z, y, x = (slice(start, int(one[-1]) + 3) for start, one in zip(low, there, strict=True))
    return (low[2], low[1], low[0]), labels[z, y, x]


def _fine_labels(
    reader: FieldReader, labels: UInt8, corner: tuple[int, int, int], blood: UInt8
) -> tuple[UInt8, Geometry]:
    """Label of every fine point of a box, ``TISSUE`` for all tissue.

    It is worked out near the border of the blood; elsewhere it is that of the voxel's centre.
    """
    nz, ny, nx = labels.shape
    geometry = reader.structures.geometry.cropped(corner, (nx, ny, nz))
    owner = ownership_on_lattice(reader, geometry)
    coarse = np.where(owner.tissue_mm <= 0.0, np.uint8(TISSUE), owner.void_label)
    is_blood = np.zeros(256, np.bool_)
    is_blood[blood] = True
    near = _beside_border(is_blood[labels]) | _beside_border(is_blood[coarse])
    fine_geometry = geometry.refined(FACTOR)
    start, step = steps_through(reader.structures.geometry, fine_geometry)
    fine = np.empty(fine_geometry.shape, np.uint8)
    _fill_fine(reader.layout, reader.tables, start, step, coarse, near, fine)
    return fine, fine_geometry


@loop_kernel
def _fill_fine(layout, tables, start, step, coarse, near, fine):
    """Label of each fine point: evaluated in the voxels that are near, else their centre's."""
    nz, ny, nx = fine.shape
    fields, walls = lend(layout), lend(tables)
    for k in numba.prange(nz):
        spare = scratch(fields)
        z = start[2] + k * step[2]
        for j in range(ny):
            y = start[1] + j * step[1]
            for i in range(nx):
                c, b, a = k // FACTOR, j // FACTOR, i // FACTOR
                if not near[c, b, a]:
                    fine[k, j, i] = coarse[c, b, a]
                    continue
                owner = evaluate_owner(fields, walls, start[0] + i * step[0], y, z, spare)
                fine[k, j, i] = TISSUE if owner[0] <= 0.0 else owner[1]


def _beside_border(mask: Bool) -> Bool:
    """Voxels on both sides of the faces between a mask and the rest."""
    beside = np.zeros(mask.shape, np.bool_)
    for axis in range(3):
        one, other = np.swapaxes(mask, 0, axis), np.swapaxes(beside, 0, axis)
        differs = one[1:] != one[:-1]
        other[1:] |= differs
        other[:-1] |= differs
    return beside


def _gaps(reader: FieldReader, fine: UInt8, geometry: Geometry) -> Iterator[tuple[int, Extent, bool]]:
    """Cavities whose blood touches the background: value, extent, and whether a table of thicknesses says so.

    Where the volume ends there is no background, so what the region of interest cuts is no gap.
    """
    structures = reader.structures
    cavities = [value for value in structures.table.blood_values if value in structures.distance_mm]
    is_wanted = np.zeros((256, 256), np.bool_)
    is_wanted[BACKGROUND, cavities] = is_wanted[cavities, BACKGROUND] = True
    faces = faces_between(fine, geometry, is_wanted)
    faces = without_tissue(faces[~_at_ends(faces, structures)], reader)
    tables = {table.cavity: table for table in structures.thickness_tables}
    width = max(geometry.spacing_mm)
    for cavity in cavities:
        own = (faces.first == cavity) | (faces.second == cavity)
        is_stated = np.zeros(len(own), np.bool_)
        table = tables.get(cavity)
        if table is not None and min(table.thickness_mm) == 0.0 and own.any():
            thickness, slope = thickness_at_points(table, faces.points_mm[own])
            is_stated[own] = thickness - width * slope <= 0.5 * width  # the wall tapers off around here
        for chosen, stated in ((own & ~is_stated, False), (own & is_stated, True)):
            if chosen.any():
                extent = faces[chosen].extent()
                if extent.area_mm2 >= LEAST_GAP_MM2:
                    yield cavity, extent, stated


def _at_ends(faces: Contact, structures: Structures) -> Bool:
    """Faces that lie in an end marker's disc, where the vessel is cut open."""
    points = faces.points_mm
    width = float(max(structures.geometry.spacing_mm))
    at_end = np.zeros(len(points), np.bool_)
    for position, axis, radius in structures.fixed_planes:
        offset = points - np.array(position)
        along = offset @ np.array(axis)
        across = np.linalg.norm(offset - along[:, None] * np.array(axis), axis=1)
        at_end |= (np.abs(along) <= width) & (across <= radius + width)
    return at_end


def _listed(warnings: list[CaseWarning]) -> list[CaseWarning]:
    rest = len(warnings) - MOST_WARNINGS
    if rest <= 0:
        return warnings
    more = CaseWarning(sentence("more-places", rest=rest), warnings[MOST_WARNINGS - 1].grade)
    return [*warnings[:MOST_WARNINGS], more]


def _of_joined(structures: Structures, change: Change) -> CaseWarning:
    one, other = (structures.table[value].name for value in change.labels)
    kind = "compartments-joined" if one != other else "parts-joined"
    return anatomy(
        sentence(kind, one=one, other=other, where=_where(change.extent)),
        code="compartments-joined",
        places_mm=change.extent.centers_mm,
    )


def _of_split(structures: Structures, change: Change) -> CaseWarning:
    one, other = (structures.table[value].name for value in change.labels)
    return anatomy(
        sentence("compartments-split", one=one, other=other if one != other else None, where=_where(change.extent)),
        code="compartments-split",
        places_mm=change.extent.centers_mm,
    )


def _of_cut(structures: Structures, change: Change) -> CaseWarning:
    name = structures.table[change.labels[0]].name
    return anatomy(
        sentence("cavity-cut-by-septum", label=name, where=_where(change.extent)),
        code="cavity-cut-by-septum",
        places_mm=change.extent.centers_mm,
    )


def _of_gap(structures: Structures, cavity: int, extent: Extent, is_stated: bool) -> CaseWarning:
    label, places = structures.table[cavity], extent.centers_mm
    if is_stated:
        text = sentence("gap-stated", label=label.name, where=_where(extent))
        return note(text, code="gap-stated", places_mm=places)
    if structures.table.wall_value(cavity) in structures.values:
        return anatomy(
            sentence("wall-gap", label=label.name, where=_where(extent)),
            code="wall-gap",
            places_mm=places,
        )
    kind = "vessel-open-to-outside" if label.role is Role.VESSEL_LUMEN else "open-to-outside"
    return anatomy(
        sentence(kind, label=label.name, where=_where(extent)),
        code="open-to-outside",
        places_mm=places,
    )


def _where(extent: Extent) -> str:
    area = f"{extent.area_mm2:,.0f}" if extent.area_mm2 >= 10.0 else f"{extent.area_mm2:.1f}"
    pieces = f" in {extent.patches} patches, the largest" if extent.patches > 1 else ""
    place = ", ".join(f"{value:.1f}" for value in extent.center_mm)
    return f"over {area} mm²{pieces} near ({place}) mm"
