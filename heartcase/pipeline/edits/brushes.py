"""Smoothing and filling a bare structure within a brush.

Both make a new field of the structure from its stored one and give it to :class:`~.borders.Borders`. Walls that are
grown from the structure follow, as they are worked out from its field.
"""

from __future__ import annotations

from dataclasses import replace

import cc3d
import numpy as np
from scipy.ndimage import gaussian_filter

from heartcase.pipeline.data import Reshaping, Structures
from heartcase.pipeline.edits.borders import Borders, Box
from heartcase.pipeline.edits.probes import look, overlap
from heartcase.pipeline.fields.shapes import distance_on_lattice
from heartcase.pipeline.warnings import WarningGrade, of_edit
from heartcase.schemas.arrays import Float32, Float64
from heartcase.schemas.errors import StageError
from heartcase.schemas.labels import BACKGROUND, Label
from heartcase.schemas.recipe.edit_settings import Fill, Smooth

__all__ = ["fill_structure", "smooth_structure"]


SIGMA_SHARE = 1.0 / 3.0
"""Blur of a smoothing that states none, in radii of its brush."""
RIM_SHARE = 0.5
"""Part of the brush's radius within which a smoothing sets in, from its face inwards."""
BLUR_REACH = 4.0
"""Standard deviations after which the blur is cut off."""
FACE_VOXELS = 2.0
"""How near a border a field matters for its place."""
LEAST_GAIN = 0.05
"""Where a filling moves the border by less than this part of a voxel it leaves it."""
LEAST_DEPTH = 0.5
"""A filling that nowhere moves the border by more than this part of a voxel is none, but the lattice's noise."""


def smooth_structure(structures: Structures, edit: Smooth, label: Label, number: int) -> Structures:
    """Smooth a structure's border within a brush.

    The stored field v becomes ``v + w (2 g - g' - v)`` with g its Gaussian blur, g' the blur of g, and w rising from
    0 at the brush's face to 1 half a radius inside. One blur alone draws a curved face inwards by ``sigma**2`` times
    its mean curvature; the second takes that off to first order, as in :mod:`heartcase.pipeline.fields.distance`. A
    wave of length l in a flat face keeps ``1 - (1 - exp(-2 (pi sigma / l)**2))**2`` of its height.

    Raises
    ------
    StageError
        The brush does not meet the structure, or meets an earlier edit of it.
    """
    sigma = SIGMA_SHARE * edit.radius_mm if edit.sigma_mm is None else edit.sigma_mm
    brush = _brush(structures, edit, label)
    borders = Borders(structures)
    box = _box(borders, brush, max(2.0 * structures.band_mm, 2.0 * BLUR_REACH * sigma))
    own = structures.distance_mm[label.value][box]
    depth = -_brush_distance(structures, brush, box) / (RIM_SHARE * edit.radius_mm)
    share = np.clip(depth, 0.0, 1.0)
    weight = share * share * (3.0 - 2.0 * share)
    reach = max(structures.band_mm, BLUR_REACH * sigma)
    plain = _far_distance(borders, own, box, reach)
    steps = sigma / borders.spacing_mm
    once = gaussian_filter(plain, steps, mode="nearest", truncate=BLUR_REACH)
    flat = 2.0 * once - gaussian_filter(once, steps, mode="nearest", truncate=BLUR_REACH)
    field = np.where(weight > 0.0, own + weight * (flat - own), own).astype(np.float32)
    borders.move(label.value, box, field)
    return _with_warning(structures, borders.changed, label, box, number)


def fill_structure(structures: Structures, edit: Fill, label: Label, number: int) -> Structures:
    """Fill the holes and notches of a structure within a brush.

    What a ball of diameter ``gap_mm`` outside the structure cannot reach becomes the structure's: the morphological
    closing by that ball (Serra, Image Analysis and Mathematical Morphology, 1982), worked out on distances.

    Raises
    ------
    StageError
        The brush does not meet the structure, there is nothing to fill in it, or it meets an earlier edit of it.
    """
    radius = edit.radius_mm if edit.gap_mm is None else 0.5 * edit.gap_mm
    brush = _brush(structures, edit, label)
    borders = Borders(structures)
    room = radius + 3.0 * float(borders.spacing_mm.max())
    box = _box(borders, brush, max(2.0 * structures.band_mm, 2.0 * room))
    own = structures.distance_mm[label.value][box]
    grown = _far_distance(borders, own, box, room) - np.float32(radius)
    closed = _far_distance(borders, grown, box, room) + np.float32(radius)
    wanted = np.maximum(closed, _brush_distance(structures, brush, box))
    voxel = float(borders.spacing_mm.min())
    gain = (own - wanted) / voxel
    places = cc3d.connected_components((gain > LEAST_GAIN) & (wanted < FACE_VOXELS * voxel), connectivity=26)
    deep = np.zeros(int(places.max()) + 1, np.bool_)
    deep[places[(gain > LEAST_DEPTH) & (wanted < 0.5 * voxel)]] = True
    deep[0] = False
    field = np.where(deep[places], wanted, own).astype(np.float32)
    if not borders.move(label.value, box, field):
        raise StageError(
            f"there is no hole or notch of '{label.name}' narrower than {2.0 * radius:g} mm in the stroke: move its "
            "points_mm, enlarge gap_mm, or take it out of the recipe"
        )
    return _with_warning(structures, borders.changed, label, box, number)


def _brush(structures: Structures, edit: Smooth | Fill, label: Label) -> Reshaping:
    """The brush as a shape, once it is known that it can be used here."""
    points = tuple((float(x), float(y), float(z)) for x, y, z in edit.points_mm)
    brush = Reshaping("strokes", points, float(edit.radius_mm), (), ())
    found = look(replace(structures, reshapings=()), brush)
    if not found.is_inside_volume:
        raise StageError("the stroke lies outside the region of interest: check its position in mm")
    if label.value not in found.labels:
        raise StageError(f"the stroke touches no '{label.name}': move its points_mm, or enlarge radius_mm")
    background = structures.table[BACKGROUND].name
    for one in structures.reshapings:
        is_end_cut = one.shape == "cylinder" and one.targets == (background,)
        if not is_end_cut and label.name in (*one.sources, *one.targets) and overlap(brush, one):
            x, y, z = one.points_mm[0]
            raise StageError(
                f"the stroke meets an earlier edit of '{label.name}' at ({x:.1f}, {y:.1f}, {z:.1f}) mm, and "
                f"'{edit.kind}' works on the structure below it: put this edit before that one"
            )
    return brush


def _box(borders: Borders, brush: Reshaping, margin_mm: float) -> Box:
    index = borders.structures.geometry.world_to_index(np.array(brush.points_mm))
    reach = brush.radius_mm + margin_mm
    box = borders.box_around(index.min(axis=0), index.max(axis=0), reach)
    if box is None:
        raise StageError("the stroke lies outside the region of interest: check its position in mm")
    return box


def _brush_distance(structures: Structures, brush: Reshaping, box: Box) -> Float64:
    k, j, i = box
    size = (i.stop - i.start, j.stop - j.start, k.stop - k.start)
    return distance_on_lattice(brush, structures.geometry.cropped((i.start, j.start, k.start), size))


def _far_distance(borders: Borders, field: Float32, box: Box, reach_mm: float) -> Float32:
    """The field as a distance out to some reach, and that reach beyond."""
    near = borders.distance_to(field, box, reach_mm)
    far = np.where(field < 0.0, np.float32(-reach_mm), np.float32(reach_mm))
    distance: Float32 = np.where(np.isfinite(near), np.clip(near, -reach_mm, reach_mm), far).astype(np.float32)
    return distance


def _with_warning(before: Structures, after: Structures, label: Label, box: Box, number: int) -> Structures:
    """Say where the structure came into more pieces, or was lost."""
    connectivity = 26 if label.role.is_tissue else 6
    counts = [
        int(cc3d.connected_components(one.distance_mm[label.value][box] < 0.0, connectivity=connectivity).max())
        for one in (before, after)
    ]
    if counts[1] == 0 < counts[0]:
        text = f"nothing of '{label.name}' is left there; take a smaller sigma_mm"
    elif counts[1] > counts[0]:
        text = f"'{label.name}' is in {counts[1]} pieces there, {counts[0]} before; take a smaller sigma_mm"
    else:
        return after
    return replace(after, warnings=(*after.warnings, of_edit(number, text, WarningGrade.ANATOMY)))
