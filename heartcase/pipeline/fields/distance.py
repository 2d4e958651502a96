"""From a label volume to smooth signed-distance fields whose faces lie between the voxels.

Each label's mask is blurred; a point belongs to the label whose blurred mask is highest there, so the labels divide
space without gap or overlap and two that touch see one face from either side
(:mod:`heartcase.pipeline.fields.partition`). Put through the inverse of the blur's step response, the lead over the
highest other label is the distance to that face to first order. A blur draws a curved face towards its centre of
curvature by ``sigma**2`` times the mean curvature; to undo that, the division is blurred once more, and the (smoothed)
shift of the second blur is taken off the first. The distance is then measured to the closest point of the zero level
(iteration of Chopp, SIAM J. Sci. Comput. 23, 2001).
"""

from __future__ import annotations

from collections.abc import Sequence
from concurrent.futures import Executor

import numpy as np
import numpy.typing as npt
from scipy.ndimage import correlate1d
from scipy.special import erf

from heartcase.compiling.kernel import kernel
from heartcase.pipeline.fields.closest import closest_points, offset_for_interpolation
from heartcase.pipeline.fields.compartments import bridging_voxels
from heartcase.pipeline.fields.partition import (
    Box,
    Part,
    Touch,
    divide,
    find_touches,
    heights_of_groups,
    leads_of,
)
from heartcase.pipeline.kernels.feature_transform import distance_to_marked
from heartcase.pipeline.kernels.parallel import two_workers
from heartcase.schemas.arrays import Bool, Float32, Float64, Int64, UInt8

__all__ = ["default_smoothing_mm", "label_distances", "signed_distance"]

SATURATION = 3.0
"""Standard deviations of the blur up to which its step response is inverted."""
LEAST_SIGMA_VOXELS = 0.6
"""Narrowest blur along an axis: a narrower one leaves the steps of thick slices."""
RETURN_VOXELS = 0.5
"""Lead over the next label, in voxels, of a voxel that gets its old label back."""
SHIFT_GAIN = np.float32(1.06)
"""The second blur's shift falls short of the first one's by 10 to 17% on balls of 2 to 10 voxels, by less on tubes."""
FAR_SIGMAS = 2.0
"""Standard deviations of the blur, and a voxel, beyond which a label's lead says nothing about its own face."""
LEAD_SHARE = 0.6
"""Part of a label's distance that its lead is at least, where it is about the label's own face."""
OFFSET_LIMIT = 0.1
"""Most that a field is moved for the sake of its interpolation, in voxels."""
BORDER_VOXELS = 3
"""Voxels by which the faces are continued straight on beyond the volume's border."""


def default_smoothing_mm(spacing_mm: npt.ArrayLike) -> float:
    """Standard deviation of the blur when the settings leave it out: 0.8 of the mean voxel spacing, mm."""
    return 0.8 * float(np.asarray(spacing_mm, dtype=np.float64).mean())


def label_distances(
    labels: UInt8,
    spacing_mm: Sequence[float],
    *,
    smoothing_mm: float,
    band_mm: float,
    blood_values: Sequence[int] = (),
    tissue_values: Sequence[int] = (),
    kept: Bool | None = None,
) -> dict[int, Float32]:
    """Signed distance to the smooth border of every label that is there.

    Parameters
    ----------
    labels
        Label values, shape [z, y, x].
    spacing_mm
        Voxel size along x, y, z (i, j, k).
    smoothing_mm
        Standard deviation of the blur; 0 leaves the faces halfway between the voxels' centres. Along an axis with
        large spacing it is at least 0.6 voxel.
    band_mm
        Distance up to which the fields are exact; beyond it they are a distance between voxels.
    blood_values
        Values of blood: voxels whose smoothing would join or split its compartments keep their label.
    tissue_values
        Values of tissue. Where two labels of blood, or two of tissue, touch, the border that both have to the rest
        is smoothed as if they were one.
    kept
        Voxels beside those that keep their label however thin it is there, of the labels' shape.

    Returns
    -------
    dict
        Label value -> float32 of the labels' shape, mm, negative inside. A label that the blur leaves no voxel of
        is left out.
    """
    spacing = np.array(spacing_mm, dtype=np.float64)[::-1]
    values = [int(value) for value in np.flatnonzero(np.bincount(labels.ravel(), minlength=256))]
    if len(values) == 1:
        return {values[0]: np.full(labels.shape, -_diagonal_mm(labels.shape, spacing), np.float32)}
    margin = np.ceil(6.0 * smoothing_mm / spacing).astype(np.int64) + 4
    boxes = [_box_around(labels == value, margin) for value in values]
    group = _groups(values, blood_values, tissue_values)
    group_mm, inner_mm = _first_order(labels, values, boxes, group, spacing, smoothing_mm)
    width = float(spacing.mean())
    owner = divide(group_mm, inner_mm, group)
    smoothed = np.array(values, np.uint8)[owner]
    given_back = bridging_voxels(labels, smoothed, blood_values)
    if kept is not None:
        given_back |= kept & (labels != smoothed)
    if given_back.any():
        for number, value in enumerate(values):
            mine = given_back & (labels == value)
            lowest = np.min([one[mine] for n, one in enumerate(group_mm) if n != group[number]], axis=0)
            group_mm[group[number]][mine] = lowest - RETURN_VOXELS * width
            inner = inner_mm[number]
            if inner is not None:
                inner.values[mine[inner.box]] = -RETURN_VOXELS * width
        owner = divide(group_mm, inner_mm, group)

    outer = [0.5 * lead for lead in leads_of([-one for one in group_mm])]

    def one(number: int) -> Float32 | None:
        inside = owner == number
        if not inside.any():
            return None
        box = _box_around(inside, np.ceil(band_mm / spacing).astype(np.int64) + 2)
        lead = outer[group[number]][box].copy()
        inner = inner_mm[number]
        if inner is not None:
            np.maximum(lead, _within(inner, box, labels.shape, SATURATION * smoothing_mm + width), out=lead)
        return _completed(lead, inside, box, spacing, band_mm, FAR_SIGMAS * smoothing_mm + width)

    # the label with the longest border first, so that both threads end together
    borders = _face_counts(owner, len(values))
    first = sorted(range(len(values)), key=lambda number: -int(borders[number]))
    with two_workers() as pool:
        fields = dict(zip(first, pool.map(one, first), strict=True))
    found = {value: fields[number] for number, value in enumerate(values)}
    return {value: field for value, field in found.items() if field is not None}


@kernel
def _face_counts(owner, count):
    """Faces along x between each label and others."""
    faces = np.zeros(count, np.int64)
    nz, ny, nx = owner.shape
    for k in range(nz):
        for j in range(ny):
            for i in range(1, nx):
                if owner[k, j, i] != owner[k, j, i - 1]:
                    faces[owner[k, j, i]] += 1
                    faces[owner[k, j, i - 1]] += 1
    return faces


def signed_distance(first_order: Float32, spacing_mm: Sequence[float], *, band_mm: float) -> Float32:
    """Signed distance to the zero level of a smooth field.

    Parameters
    ----------
    first_order
        float32 [z, y, x], about a distance in mm near its zero level, negative inside.
    spacing_mm
        Voxel size along x, y, z.
    band_mm
        Distance up to which it is measured.

    Returns
    -------
    Float32
        Same shape, mm; plus or minus infinity beyond the band.
    """
    spacing = np.array(spacing_mm, dtype=np.float64)[::-1].copy()
    field = np.ascontiguousarray(first_order, dtype=np.float32)
    square = np.full(field.shape, np.inf, np.float32)
    closest_points(field, spacing, float(band_mm), square)
    distance = np.sqrt(square, out=square)
    return np.where(field < 0.0, -distance, distance)


def _groups(values: Sequence[int], blood_values: Sequence[int], tissue_values: Sequence[int]) -> list[int]:
    """Number of each label's group: blood, tissue, and every other label by itself; as many as are there."""
    names = [-1 if v in blood_values else -2 if v in tissue_values else v for v in values]
    order = list(dict.fromkeys(names))
    return [order.index(name) for name in names]


def _first_order(
    labels: UInt8, values: list[int], boxes: list[Box], group: list[int], spacing: Float64, sigma_mm: float
) -> tuple[list[Float32], list[Part | None]]:
    """Distance to first order of each group and of each label within its group, about mm, negative inside."""

    def blur(values: Float32) -> Float32:
        return _blur(values, spacing, sigma_mm)

    with two_workers() as pool:
        masks = list(pool.map(lambda n: blur((labels[boxes[n]] == values[n]).astype(np.float32)), range(len(values))))
        blurred = [Part(box, mask) for box, mask in zip(boxes, masks, strict=True)]
        touches = find_touches(labels, values, boxes, group, blur)
        group_mm = _group_distances(blurred, group, touches, labels.shape, spacing, sigma_mm, pool)
        inner_mm = _inner_distances(blurred, group, labels.shape, spacing, sigma_mm)
        if sigma_mm == 0.0:
            return group_mm, inner_mm
        width = float(spacing.mean())

        def soft(number: int) -> Float32:
            """The label's mask again, with borders as wide as a voxel: its part of its group's."""
            mask: Float32 = np.clip(0.5 - group_mm[group[number]][boxes[number]] / width, 0.0, 1.0)
            inner = inner_mm[number]
            return mask if inner is None else mask * np.clip(0.5 - inner.values / width, 0.0, 1.0)

        again = list(pool.map(lambda n: blur(soft(n)), range(len(values))))
        blurred = [Part(box, mask) for box, mask in zip(boxes, again, strict=True)]
        shifted = _group_distances(blurred, group, touches, labels.shape, spacing, sigma_mm, pool)
        limit = 0.5 * float(spacing.min())

        def correct(number: int) -> None:
            shift = np.clip(shifted[number] - group_mm[number], -limit, limit)
            group_mm[number] -= SHIFT_GAIN * _blur(shift, spacing, 1.25 * sigma_mm)

        list(pool.map(correct, range(len(group_mm))))
    return group_mm, inner_mm


def _group_distances(
    blurred: list[Part],
    group: list[int],
    touches: Sequence[Touch],
    shape: tuple[int, ...],
    spacing: Float64,
    sigma_mm: float,
    pool: Executor,
) -> list[Float32]:
    """Inverse step response of each group's lead over the highest other one."""
    heights = heights_of_groups(blurred, group, touches, shape)
    return list(pool.map(lambda lead: _inverse_response(lead, spacing, sigma_mm), leads_of(heights)))


def _inner_distances(
    blurred: list[Part], group: list[int], shape: tuple[int, ...], spacing: Float64, sigma_mm: float
) -> list[Part | None]:
    """Inverse step response of each label's lead over the highest other one of its group."""
    inner: list[Part | None] = [None] * len(blurred)
    for one in set(group):
        members = [number for number in range(len(group)) if group[number] == one]
        if len(members) == 1:
            continue
        negated = [Part(blurred[number].box, -blurred[number].values) for number in members]
        lowest, second, owner = _two_lowest(shape, negated, 0.0)
        for place, (number, part) in enumerate(zip(members, negated, strict=True)):
            other = np.where(owner[part.box] == place, second[part.box], lowest[part.box])
            inner[number] = Part(part.box, _inverse_response(part.values - other, spacing, sigma_mm))
    return inner


def _inverse_response(lead: Float32, spacing: Float64, sigma_mm: float) -> Float32:
    """Distance from a plane face whose blurred step is ``lead``, from -1 inside to 1."""
    if sigma_mm == 0.0:
        return (0.5 * float(spacing.mean()) * lead).astype(np.float32)
    steps = np.linspace(-SATURATION, SATURATION, 2049)
    response = erf(steps / np.sqrt(2.0))
    even = np.linspace(response[0], response[-1], 65537)
    table = (np.interp(even, response, steps) * sigma_mm).astype(np.float32)
    distance = np.empty(lead.shape, np.float32)
    scale = np.float32((len(even) - 1) / (even[-1] - even[0]))
    _look_up(np.ascontiguousarray(lead).ravel(), np.float32(even[0]), scale, table, distance.ravel())
    return distance


@kernel
def _look_up(values, first, scale, table, found):
    """Nearest entry of a table to each value, its ends beyond them."""
    last = np.float32(len(table) - 1)
    for n in range(len(values)):
        place = (values[n] - first) * scale + np.float32(0.5)
        found[n] = table[np.int32(min(max(place, np.float32(0.0)), last))]


def _blur(values: Float32, spacing: Float64, sigma_mm: float) -> Float32:
    """Gaussian of one width in mm, but at least wide enough for each axis; the border's values go on beyond it."""
    for axis in range(3):
        sigma = max(sigma_mm / spacing[axis], LEAST_SIGMA_VOXELS) if sigma_mm > 0.0 else 0.0
        radius = int(np.ceil(4.0 * sigma))
        if radius == 0 or values.shape[axis] == 1:
            continue
        weights = np.exp(-0.5 * (np.arange(-radius, radius + 1) / sigma) ** 2)
        values = correlate1d(values, weights / weights.sum(), axis=axis, mode="nearest")
    return values


def _two_lowest(shape: tuple[int, ...], parts: list[Part], outside: float) -> tuple[Float32, Float32, UInt8]:
    """Lowest and second lowest value of all parts at each voxel, and the number of the lowest (ties: the first)."""
    lowest = np.full(shape, outside, np.float32)
    second = np.full(shape, outside, np.float32)
    owner = np.full(shape, 255, np.uint8)
    for number, part in enumerate(parts):
        _insert(lowest[part.box], second[part.box], owner[part.box], part.values, number)
    return lowest, second, owner


@kernel
def _insert(lowest, second, owner, values, number):
    nz, ny, nx = values.shape
    for k in range(nz):
        for j in range(ny):
            for i in range(nx):
                value = values[k, j, i]
                if owner[k, j, i] == 255:
                    second[k, j, i] = min(second[k, j, i], lowest[k, j, i])
                    lowest[k, j, i] = value
                    owner[k, j, i] = number
                elif value < lowest[k, j, i]:
                    second[k, j, i] = lowest[k, j, i]
                    lowest[k, j, i] = value
                    owner[k, j, i] = number
                elif value < second[k, j, i]:
                    second[k, j, i] = value


def _box_around(mask: Bool, margin: Int64) -> Box:
    """Box of the true voxels and a margin, within the volume."""
    slices = []
    for axis in range(3):
        others = tuple(a for a in range(3) if a != axis)
        there = np.flatnonzero(mask.any(axis=others))
        slices.append(
            slice(
                max(int(there[0]) - int(margin[axis]), 0), min(int(there[-1]) + 1 + int(margin[axis]), mask.shape[axis])
            )
        )
    return slices[0], slices[1], slices[2]


def _within(part: Part, box: Box, shape: tuple[int, ...], outside: float) -> Float32:
    """A part's values in another box."""
    values = np.full(shape, outside, np.float32)
    values[part.box] = part.values
    return values[box]


def _completed(lead: Float32, inside: Bool, box: Box, spacing: Float64, band_mm: float, far_mm: float) -> Float32:
    """Exact distances in the band, and beyond it a distance between voxels.

    Beyond the volume's border the lead goes straight on, but not where the label is farther than ``far_mm``, or clearly
    farther than the lead says: there it falls towards a face between two *other* labels, and would reach zero as if the
    label were just outside.
    """
    shape = inside.shape
    outer = _distance_to(inside, spacing)
    pads = [
        (BORDER_VOXELS if part.start == 0 else 0, BORDER_VOXELS if part.stop == size else 0)
        if part.stop - part.start > BORDER_VOXELS
        else (0, 0)
        for part, size in zip(box, shape, strict=True)
    ]
    padded = np.pad(lead, pads, mode="reflect", reflect_type="odd")
    half = 0.5 * float(spacing.mean())
    is_far = (outer[box] > far_mm) | (lead < LEAD_SHARE * (outer[box] - half))
    padded = np.maximum(padded, np.pad(np.where(is_far, lead, np.float32(-np.inf)), pads, mode="edge"))
    near = signed_distance(padded, tuple(spacing[::-1]), band_mm=band_mm)
    near = offset_for_interpolation(near, np.float32(OFFSET_LIMIT * spacing.min()))
    near = near[tuple(slice(low, low + n) for (low, _), n in zip(pads, lead.shape, strict=True))]
    field: Float32 = np.maximum(outer - half, band_mm, dtype=np.float32)
    inner = _distance_to(~inside[box], spacing)
    part = field[box]
    np.copyto(part, -np.maximum(inner - half, band_mm), where=inside[box])
    known = np.isfinite(near)
    np.copyto(part, near, where=known)
    return field


def _distance_to(marked: Bool, spacing: Float64) -> Float32:
    """Distance of each voxel to the nearest marked one, mm."""
    distance = np.empty(marked.shape, np.float32)
    distance_to_marked(marked, np.ascontiguousarray(spacing), distance)
    return distance


def _diagonal_mm(shape: tuple[int, ...], spacing: Float64) -> float:
    return float(np.linalg.norm(np.array(shape) * spacing))
