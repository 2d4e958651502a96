"""Marker strokes for the phantom, drawn where a person would: along the middle of cavities and walls, around the heart.

None is thicker than 2 mm in radius, and every stroke stays inside its structure. The two hearts of fixed size have at
most ten strokes a label; hearts of any other form get more where those would not do
(:mod:`heartcase.phantom.drawing.corrections`). What a few short strokes reach is measured with :func:`first_strokes`
and, as one set of strokes is one chance, with several of :func:`random_strokes`.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import lru_cache
from itertools import pairwise

import numpy as np
from scipy.spatial import cKDTree

from heartcase.phantom.anatomy.axes import LONG_AXIS, SEPTUM_AXIS, UPWARD_AXIS
from heartcase.phantom.anatomy.build import mirrored
from heartcase.phantom.anatomy.heart import HeartPhantom
from heartcase.phantom.anatomy.inner import BAFFLE_LINE
from heartcase.phantom.anatomy.sizes import proportions_of
from heartcase.phantom.drawing.corrections import corrective_lines, wall_lines
from heartcase.schemas.arrays import Float64
from heartcase.schemas.errors import UsageError
from heartcase.schemas.recipe.heart_form import HeartForm
from heartcase.schemas.recipe.settings import Stroke

__all__ = ["LONGEST_SHORT_STROKE_MM", "first_strokes", "marker_strokes", "random_strokes"]

_FIXED = (HeartForm(size="adult"), HeartForm(size="child"))
"""Hearts whose strokes were drawn by hand."""
LONGEST_SHORT_STROKE_MM = 30.0
"""Length of what one movement of the hand paints; longer lines count as several strokes."""


def marker_strokes(phantom: HeartPhantom) -> tuple[Stroke, ...]:
    """Strokes for every label of the phantom's table but sheets in the blood, the background last."""
    if phantom.form.is_mirrored:
        return tuple(
            stroke.model_copy(update={"points_mm": tuple(mirrored(point) for point in stroke.points_mm)})
            for stroke in marker_strokes(phantom.twin)
        )
    return tuple(_stroke(*line) for line in _drawn_lines(phantom))


def first_strokes(phantom: HeartPhantom, count: int) -> tuple[Stroke, ...]:
    """The first ``count`` short strokes of every label, in the order in which a person would add them.

    The lines of :func:`marker_strokes` are cut into strokes of at most :data:`LONGEST_SHORT_STROKE_MM`. A label's first
    stroke is the one nearest to its middle; each further one is the farthest from those that are there (Gonzalez,
    1985), so later strokes go towards ends and borders. The strokes of a smaller count are among those of a larger.

    Parameters
    ----------
    phantom
        The heart.
    count
        Strokes a label, background included; fewer where a small label has no more.

    Returns
    -------
    tuple of Stroke
        Label by label, in the order in which they are painted.

    Raises
    ------
    UsageError
        The count is below one.
    """
    return tuple(
        _stroke(label, *drawn[n])
        for label, drawn in _short_lines(phantom, count).items()
        for n in _middle_first([line for _, line in drawn], count)
    )


def random_strokes(phantom: HeartPhantom, count: int, seed: int) -> tuple[Stroke, ...]:
    """``count`` short strokes of every label, taken at random from those that :func:`first_strokes` puts in order.

    Parameters
    ----------
    phantom
        The heart.
    count
        Strokes a label, background included; fewer where a small label has no more.
    seed
        Of the choice; a smaller count's strokes are not among those of a larger.

    Raises
    ------
    UsageError
        The count is below one.
    """
    generator = np.random.Generator(np.random.PCG64([seed, count]))
    return tuple(
        _stroke(label, *drawn[n])
        for label, drawn in _short_lines(phantom, count).items()
        for n in sorted(generator.permutation(len(drawn))[:count])
    )


def _short_lines(phantom: HeartPhantom, count: int) -> dict[str, list[tuple[float, Float64]]]:
    """Radius of the brush and line of every short stroke, by label."""
    if count < 1:
        raise UsageError("every label needs at least one stroke", place="strokes")
    pieces: dict[str, list[tuple[float, Float64]]] = {}
    for label, radius, points in _drawn_lines(phantom):
        lines = _cut(points, LONGEST_SHORT_STROKE_MM)
        pieces.setdefault(label, []).extend((radius, line) for line in lines)
    return pieces


def _stroke(label: str, radius: float, points: Float64) -> Stroke:
    rounded = tuple((round(float(x), 1), round(float(y), 1), round(float(z), 1)) for x, y, z in points)
    return Stroke(label=label, radius_mm=radius, points_mm=rounded)


@lru_cache(maxsize=2)
def _drawn_lines(phantom: HeartPhantom) -> tuple[tuple[str, float, Float64], ...]:
    """Label, radius of the brush and line of every stroke."""
    radius = round(1.5 * phantom.scale, 1)
    fine = round(1.1 * phantom.scale, 1)
    drawn: list[tuple[str, float, Float64]] = []
    for label, points in _cavity_lines(phantom):
        drawn.append((label, radius, _inside(phantom, label, points, radius)))
    drawn += [(label, radius, points) for label, points in _valve_rings(phantom, radius)]
    if phantom.form not in _FIXED:
        drawn += corrective_lines(phantom, drawn, radius)
    for points in _myocardium_lines(phantom):
        label = "left ventricular myocardium"
        drawn.append((label, radius, _inside(phantom, label, points, radius)))
    for points in _outlines(phantom, fine):
        drawn.append(("background", fine, points))
    if phantom.form.body_surface_m2 is not None:
        drawn += [("background", width, points) for width, points in _septal_lines(phantom)]
    drawn = [line for line in drawn if len(line[2])]
    return tuple(drawn) if phantom.form in _FIXED else (*drawn, *wall_lines(phantom, drawn))


def _cut(points: Float64, longest_mm: float) -> list[Float64]:
    """A polyline in pieces of equal length, at most the given one."""
    at = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(points, axis=0), axis=1))])
    piece_count = max(1, int(np.ceil(at[-1] / longest_mm)))
    bounds = np.linspace(0.0, at[-1], piece_count + 1)
    pieces = []
    for low, high in pairwise(bounds):
        inner = at[(at > low) & (at < high)]
        where = np.concatenate([[low], inner, [high]])
        pieces.append(np.stack([np.interp(where, at, points[:, axis]) for axis in range(3)], axis=1))
    return pieces


def _middle_first(lines: list[Float64], count: int) -> list[int]:
    """Numbers of the first lines: the one nearest to the middle of all, then always the farthest from those taken."""
    dense = [_resampled(line, 2.0) for line in lines]
    middle = np.concatenate(dense).mean(axis=0)
    # Rounded, so that an order does not hang on the last bits.
    off = [round(float(np.linalg.norm(points - middle, axis=1).mean()), 2) for points in dense]
    taken = [int(np.argmin(off))]
    away = [np.full(len(points), np.inf) for points in dense]
    while len(taken) < min(count, len(lines)):
        tree = cKDTree(dense[taken[-1]])
        away = [np.minimum(before, tree.query(points)[0]) for before, points in zip(away, dense, strict=True)]
        far = [round(float(distance.mean()), 2) for distance in away]
        for n in taken:
            far[n] = -1.0
        taken.append(int(np.argmax(far)))
    return taken


def _cavity_lines(phantom: HeartPhantom) -> list[tuple[str, Float64]]:
    scale, places = phantom.scale, phantom.anatomy.places

    def at(along: float, right: float, up: float) -> Float64:
        point: Float64 = scale * (along * LONG_AXIS + right * SEPTUM_AXIS + up * UPWARD_AXIS)
        return point

    left, right = places["left atrium"], places["right atrium"]
    crescent = np.linspace(-60.0, 60.0, 9)
    if phantom.form in _FIXED:
        bow = [
            [at(along, 38.0 * np.cos(np.radians(a)), 38.0 * np.sin(np.radians(a)) - 3.0) for a in crescent]
            for along in (12.0, 30.0)
        ]
        lengthwise = np.array([at(4.0, 36.0, -16.0), at(30.0, 38.0, -6.0), at(52.0, 33.0, -2.0)])
    else:
        bow = [_middle_of_right(phantom, [(along, a) for a in crescent]) for along in (12.0, 30.0)]
        lengthwise = np.array(_middle_of_right(phantom, [(along, -14.0) for along in (2.0, 10.0, 20.0, 32.0, 44.0)]))
    outflow = scale * np.array([(-2.0, -44.0, -20.0), (8.0, -39.5, 0.0), (13.0, -36.5, 13.0)])
    x, y, z = scale * np.eye(3)
    lines = [
        ("left ventricle", np.array([at(2.0, 0.0, 0.0), at(30.0, 0.0, 0.0), at(66.0, 0.0, 0.0)])),
        ("left ventricle", _ring(places["left ventricle"], SEPTUM_AXIS, UPWARD_AXIS, 14.0 * scale)),
        ("left ventricle", _ring(at(10.0, 0.0, 0.0), SEPTUM_AXIS, UPWARD_AXIS, 12.0 * scale)),
        ("right ventricle", np.array(bow[0])),
        ("right ventricle", np.array(bow[1])),
        ("right ventricle", lengthwise),
        ("right ventricle", outflow),
        ("left atrium", np.array([left - 20.0 * x, left, left + 20.0 * x])),
        ("left atrium", np.array([left - 14.0 * z, left, left + 14.0 * z])),
        ("left atrium", scale * np.array([(8.0, 20.0, 14.0), (24.0, 10.0, 20.0), (34.0, -2.0, 20.0)])),
        ("right atrium", np.array([right - 18.0 * z, right, right + 18.0 * z])),
        ("right atrium", np.array([right - 12.0 * x + 8.0 * y, right, right + 10.0 * x - 8.0 * y])),
        ("right atrium", scale * np.array([(-42.0, -12.0, 12.0), (-42.0, -20.0, 16.0), (-34.0, -32.0, 22.0)])),
        ("aorta", places["aorta line"]),
        ("pulmonary artery", places["pulmonary trunk line"]),
        ("pulmonary artery", places["right pulmonary line"]),
        ("pulmonary artery", places["left pulmonary line"]),
        ("superior vena cava", places["superior vena cava line"]),
        ("inferior vena cava", places["inferior vena cava line"]),
    ]
    if phantom.form.great_arteries != "concordant":
        lines += [("right ventricle", places[name]) for name in sorted(places) if name.startswith("right outflow line")]
    if phantom.form.baffle is not None:
        lines.append(("right ventricle", scale * np.array(BAFFLE_LINE)))
    for name in sorted(name for name in places if name.endswith("vein line")):
        lines.append(("left atrium", places[name]))
    for name in sorted(name for name in places if name.startswith("aortic branch line")):
        lines.append(("aorta", places[name]))
    return lines


def _middle_of_right(phantom: HeartPhantom, where: list[tuple[float, float]]) -> list[Float64]:
    """Middles of the right ventricle's cavity on rays from the left one's axis: (mm along it, angle), the adult's."""
    reach = np.arange(0.0, 80.0 * phantom.scale, 0.25 * phantom.scale)
    found = []
    for along, degrees in where:
        outward = np.cos(np.radians(degrees)) * SEPTUM_AXIS + np.sin(np.radians(degrees)) * UPWARD_AXIS
        ray = phantom.scale * along * LONG_AXIS + reach[:, None] * outward
        inside = np.flatnonzero(phantom.anatomy.tables.evaluate(ray)[:, 1] < 0.0)
        if len(inside):
            found.append(ray[(inside[0] + inside[-1]) // 2])
    return found


def _valve_rings(phantom: HeartPhantom, radius: float) -> list[tuple[str, Float64]]:
    """A ring on either side of each opening between two cavities, as wide as fits, and a cross in it."""
    lines = []
    scale = phantom.scale
    for pair in phantom.anatomy.openings:
        values = [phantom.table[label].value for label in pair]
        border = phantom.truth.surface_points(values[0])
        opening = border[phantom.truth.value(border, values[1]) < 0.02 * scale]
        # Rounded, so that the drawing does not hang on the last bits of the samples.
        centre = np.round(opening.mean(axis=0) / scale) * scale
        spread, axes = np.linalg.eigh(np.cov((opening - opening.mean(axis=0)).T))
        normal = np.round(axes[:, 0], 1)
        normal /= np.linalg.norm(normal)
        if phantom.truth.value(centre + 3.0 * scale * normal, values[0]) > 0.0:
            normal = -normal
        across = np.cross(normal, np.eye(3)[np.argmin(np.abs(normal))])
        across /= np.linalg.norm(across)
        # A disc's mean square along a diameter is a quarter of its squared radius.
        opening_radius = np.round(2.0 * float(np.sqrt(spread[1])) / scale) * scale
        for label, side in zip(pair, (1.0, -1.0), strict=True):
            rings = [
                _inside(
                    phantom,
                    label,
                    _ring(
                        centre + side * (radius + away * scale) * normal,
                        across,
                        np.cross(normal, across),
                        part * opening_radius,
                    ),
                    radius,
                )
                for part in (0.7, 0.6, 0.5, 0.4)
                for away in (1.5, 3.0)
            ]
            lines.append((label, max(rings, key=_length)))
            if phantom.form not in _FIXED:
                # A ring alone leaves the middle of the opening to the watershed.
                middle = centre + side * (radius + 1.5 * scale) * normal
                for way in (across, np.cross(normal, across)):
                    diameter = middle + np.linspace(-0.7, 0.7, 9)[:, None] * opening_radius * way
                    lines.append((label, _inside(phantom, label, diameter, radius)))
    return lines


def _length(points: Float64) -> float:
    return float(np.linalg.norm(np.diff(points, axis=0), axis=1).sum())


def _ring(centre: Float64, first: Float64, second: Float64, radius: float, count: int = 17) -> Float64:
    angle = np.linspace(0.0, 2.0 * np.pi, count)[:, None]
    ring: Float64 = centre + radius * (np.cos(angle) * first + np.sin(angle) * second)
    return ring


def _myocardium_lines(phantom: HeartPhantom) -> list[Float64]:
    """Three rings and two lines over the apex, in the middle of the wall."""
    scale = phantom.scale
    angles = np.linspace(0.0, 2.0 * np.pi, 33)[:, None]
    around = np.cos(angles) * SEPTUM_AXIS + np.sin(angles) * UPWARD_AXIS
    lines = [_middle_of_wall(phantom, scale * along * LONG_AXIS, around) for along in (12.0, 30.0, 50.0)]
    sweep = np.radians(np.linspace(-100.0, 100.0, 31))[:, None]
    for across in (SEPTUM_AXIS, UPWARD_AXIS):
        directions = np.cos(sweep) * LONG_AXIS + np.sin(sweep) * across
        lines.append(_middle_of_wall(phantom, scale * 24.0 * LONG_AXIS, directions))
    return lines


def _septal_lines(phantom: HeartPhantom) -> list[tuple[float, Float64]]:
    """Lines in the middle of the atrial septum, from front to back, a few mm apart, and where no hole is.

    The septum is one or two voxels thick: without them the basins of both atria meet in it, and it is lost.
    """
    tables, scale = phantom.anatomy.tables, phantom.scale
    gap = proportions_of(phantom.form).gap_mm
    radius = round(0.35 * gap, 2)
    # From the left atrium to the right one, in the adult's positions.
    centre, normal = scale * np.array((-27.5, 8.0, 1.0)), np.array((-0.8, -0.6, -0.05))
    normal /= np.linalg.norm(normal)
    side = np.cross(normal, (0.0, 0.0, 1.0))
    side /= np.linalg.norm(side)
    up = np.cross(side, normal)
    depth = np.linspace(-14.0, 14.0, 281) * scale
    lines: list[tuple[float, Float64]] = []
    for height in np.arange(-15.0 * scale, 18.0 * scale, max(2.5 * radius, 2.0)):
        across = np.arange(-18.0 * scale, 18.0 * scale, 0.5)
        points = centre + height * up + across[:, None] * side
        rays = points[:, None, :] + depth[None, :, None] * normal
        fields = tables.evaluate(rays.reshape(-1, 3)).reshape(len(across), len(depth), -1)
        middle = np.argmin(np.maximum(fields[:, :, 2], fields[:, :, 3]), axis=1)
        rows = np.arange(len(across))
        apart = fields[rows, middle, 2] + fields[rows, middle, 3]
        at = rays[rows, middle]
        kept = (apart < 1.4 * gap) & (np.minimum(fields[rows, middle, 2], fields[rows, middle, 3]) > radius)
        for one in phantom.defects:
            axis = np.array(one.axis)
            away = at - np.array(one.position_mm)
            kept &= np.linalg.norm(away - (away @ axis)[:, None] * axis, axis=1) > 0.5 * one.diameter_mm + radius
        edges = np.flatnonzero(np.diff(np.concatenate([[False], kept, [False]])))
        for first, last in zip(edges[::2], edges[1::2], strict=True):
            if (last - first) * 0.5 > 2.0 * radius:
                lines.append((radius, _simplified(at[first:last], 0.15)))
    return lines


def _middle_of_wall(phantom: HeartPhantom, centre: Float64, directions: Float64) -> Float64:
    """Points half-way between endocardium and epicardium along rays."""
    reach = np.arange(0.0, 80.0 * phantom.scale, 0.25 * phantom.scale)
    rays = centre + reach[None, :, None] * directions[:, None, :]
    fields = phantom.anatomy.tables.evaluate(rays.reshape(-1, 3)).reshape(len(directions), len(reach), -1)
    inner = np.argmax(fields[:, :, 0] > 0.0, axis=1)
    outer = np.argmax(fields[:, :, 8] > 0.0, axis=1)
    middle: Float64 = centre + (0.5 * (reach[inner] + reach[outer]))[:, None] * directions
    return middle


def _inside(phantom: HeartPhantom, label: str, points: Float64, radius: float) -> Float64:
    """The longest stretch of a polyline whose brush stays inside the structure."""
    value = phantom.table[label].value
    dense = _resampled(points, 2.0 * phantom.scale)
    fits = phantom.truth.value(dense, value) < -(radius + 0.2)
    best, start = (0, 0), None
    for n, ok in enumerate([*fits, False]):
        if ok and start is None:
            start = n
        if not ok and start is not None:
            if n - start > best[1] - best[0]:
                best = (start, n)
            start = None
    return _simplified(dense[best[0] : best[1]], 0.1 * radius)


def _simplified(points: Float64, tolerance_mm: float) -> Float64:
    """A polyline with fewer points, nowhere farther than the tolerance from the given one (Douglas and Peucker)."""
    if len(points) < 3:
        return points
    chord = points[-1] - points[0]
    gap = points - points[0]
    square = float(chord @ chord)
    fraction = np.clip(gap @ chord / square, 0.0, 1.0) if square > 0.0 else np.zeros(len(points))
    # Rounded, so that the choice between two points equally far does not hang on the last bits.
    distance = np.linalg.norm(gap - fraction[:, None] * chord, axis=1).round(6)
    farthest = int(np.argmax(distance))
    if distance[farthest] <= tolerance_mm:
        return points[[0, -1]]
    before, after = _simplified(points[: farthest + 1], tolerance_mm), _simplified(points[farthest:], tolerance_mm)
    return np.concatenate([before[:-1], after])


def _resampled(points: Float64, step: float) -> Float64:
    at = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(points, axis=0), axis=1))])
    wanted = np.linspace(0.0, at[-1], max(2, int(np.ceil(at[-1] / step)) + 1))
    return np.stack([np.interp(wanted, at, points[:, axis]) for axis in range(3)], axis=1)


def _outlines(phantom: HeartPhantom, radius: float) -> list[Float64]:
    """Closed lines around the heart: short-axis, axial, coronal and sagittal planes."""
    scale, places = phantom.scale, phantom.anatomy.places
    x, y, z = np.eye(3)
    middle = 0.5 * (places["left ventricle"] + places["right ventricle"])
    planes = [
        (scale * (12.0 * LONG_AXIS + 14.0 * SEPTUM_AXIS), SEPTUM_AXIS, UPWARD_AXIS),
        (scale * (32.0 * LONG_AXIS + 14.0 * SEPTUM_AXIS), SEPTUM_AXIS, UPWARD_AXIS),
        (scale * (54.0 * LONG_AXIS + 8.0 * SEPTUM_AXIS), SEPTUM_AXIS, UPWARD_AXIS),
        (middle, x, z),
        (middle, y, z),
        (scale * np.array((-2.0, 5.0, 0.0)), x, y),
        (scale * np.array((-2.0, 8.0, 26.0)), x, y),
        (scale * np.array((-4.0, 12.0, 45.0)), x, y),
        (scale * np.array((-4.0, 20.0, 64.0)), x, y),
        (scale * np.array((0.0, 26.0, 20.0)), x, z),
    ]
    rooms = [_room_close] * 6 + [_room_outside] * 4
    return [_outline(phantom, *plane, radius, room) for plane, room in zip(planes, rooms, strict=True)]


def _room_outside(phantom: HeartPhantom, points: Float64) -> Float64:
    """Distance from the heart, walls included."""
    return -phantom.truth.value(points, 0)


def _room_close(phantom: HeartPhantom, points: Float64) -> Float64:
    """The same, but the middle of the right ventricular wall counts as outside: it is grown, so not to be marked."""
    fields = phantom.anatomy.tables.evaluate(points.reshape(-1, 3))[:, :9].reshape(*points.shape[:-1], -1)
    thickness = np.array([phantom.table[value].wall_thickness_mm for value in range(1, 9)] + [0.0])
    brush = 1.1 * phantom.scale
    thickness[1] = 0.5 * thickness[1] - brush - 0.8 * phantom.scale
    room: Float64 = (fields - thickness).min(axis=-1)
    return room


def _outline(
    phantom: HeartPhantom,
    centre: Float64,
    first: Float64,
    second: Float64,
    radius: float,
    room: Callable[[HeartPhantom, Float64], Float64],
) -> Float64:
    """Closed line in a plane, as near to the heart from outside as its brush allows."""
    angle = np.linspace(0.0, 2.0 * np.pi, 61)[:-1, None]
    directions = np.cos(angle) * first + np.sin(angle) * second
    reach = np.arange(0.0, 110.0 * phantom.scale, 0.5 * phantom.scale)
    rays = centre + reach[None, :, None] * directions[:, None, :]
    clear = room(phantom, rays) > radius + 0.8 * phantom.scale
    last_hit = len(reach) - 1 - np.argmax(~clear[:, ::-1], axis=1)
    out = reach[np.minimum(last_hit + 1, len(reach) - 1)]
    for _ in range(4 * len(angle)):
        line = centre + out[:, None] * directions
        closed = np.concatenate([line, line[:1]])
        middles = closed[:-1, None] + np.linspace(0.0, 1.0, 42)[None, 1:-1, None] * (closed[1:] - closed[:-1])[:, None]
        hits = room(phantom, middles).min(axis=1) < radius + 0.2 * phantom.scale
        if not hits.any():
            break
        larger = np.maximum(out, np.roll(out, -1))
        out = np.where(hits, larger + 0.5 * phantom.scale, out)
        out = np.where(np.roll(hits, 1), np.maximum(out, np.roll(larger, 1) + 0.5 * phantom.scale), out)
    return closed
