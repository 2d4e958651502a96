"""Lines on the heart's outside: planned incisions, and the courses of the coronary arteries.

The incisions are those of the thesis (chapter 12, figures 12.5 to 12.8) and two that every access through the chest
knows: the right atrium's free wall, and the isthmus of the aorta.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from heartcase.phantom.anatomy.axes import LONG_AXIS, SEPTUM_AXIS, UPWARD_AXIS
from heartcase.phantom.anatomy.build import mirrored
from heartcase.phantom.anatomy.shapes import Tube
from heartcase.schemas.arrays import Float64
from heartcase.schemas.errors import UsageError
from heartcase.schemas.landmarks import Landmark
from heartcase.schemas.recipe.heart_form import IncisionName

if TYPE_CHECKING:
    from heartcase.phantom.anatomy.heart import HeartPhantom

__all__ = ["coronary_arteries", "coronary_landmarks", "incision_landmark"]

_BEYOND_MM = 1.0
"""How much deeper than the wall an incision is planned."""
_EXIT_STEPS = 6
"""Steps of 0.1 mm of the adult heart that a ray has to be outside to have left it."""
_LARGEST_GAP = 6.0
"""Largest step of a coronary artery's course between two rays, mm of the adult heart."""


def incision_landmark(phantom: HeartPhantom, name: IncisionName) -> Landmark:
    """A planned incision: a polyline on the outside, with a depth that opens the wall all along.

    Raises
    ------
    UsageError
        The heart has no such place.
    """
    if phantom.form.is_mirrored:
        return _mirrored(incision_landmark(phantom.twin, name))
    origins, directions = _rays(phantom, name)
    surface, depth = _exits(phantom, origins, directions)
    return Landmark(
        name=name,
        kind="polyline",
        points_mm=_rounded(surface),
        depth_mm=round(float(depth.max()) + _BEYOND_MM, 1),
    )


def coronary_landmarks(phantom: HeartPhantom) -> tuple[Landmark, ...]:
    """The courses of the three large coronary arteries, in their grooves, with their radii: they touch the heart.

    The anterior descending one follows the line where the right ventricle's wall meets the left ventricle's in front,
    the two others the grooves between atria and ventricles. Radii are means of adults (1.85, 1.95 and 1.7 mm: Dodge
    et al., Circulation 86, 1992, 232), times the square root of the heart's size.
    """
    if phantom.form.is_mirrored:
        return tuple(_mirrored(one) for one in coronary_landmarks(phantom.twin))
    places, scale = phantom.anatomy.places, phantom.scale
    mitral, tricuspid = places["mitral valve"], places["tricuspid valve"]
    towards_right = _unit(tricuspid - mitral)
    front = _unit(np.cross(LONG_AXIS, towards_right))
    front = front if front[1] < 0.0 else -front

    def around(valve: Float64, below_mm: float, side: Float64, first: float, last: float) -> Float64:
        """Where rays from below a valve leave the heart, from the front (-90 degrees) by a side to the back."""
        angles = np.radians(np.arange(first, last + 1.0, 6.0))[:, None]
        rays = np.cos(angles) * side - np.sin(angles) * front
        surface, _ = _exits(phantom, np.repeat((valve + below_mm * scale * LONG_AXIS)[None], len(rays), axis=0), rays)
        return surface

    width = np.sqrt(scale / 1.2)
    courses = {
        "right coronary artery": (around(tricuspid, 2.0, towards_right, -60.0, 126.0), 1.95 * width, 1.0),
        "left circumflex artery": (around(mitral, 8.0, -towards_right, -60.0, 108.0), 1.7 * width, 1.0),
        "left anterior descending artery": (_groove(phantom), 1.85 * width, 2.0),
    }
    landmarks = []
    for name, (surface, radius, spacing) in courses.items():
        gap = spacing * _LARGEST_GAP * scale
        # Where rays end on another chamber, and where what lies above pushes an artery aside, the course is cut.
        line = _longest_run(_laid_on(phantom, _longest_run(surface, gap), radius), gap)
        line = _without_kinks(np.array(_rounded(line)), 1.5 * radius)
        landmarks.append(
            Landmark(name=name, kind="polyline", points_mm=_rounded(line), radius_mm=round(float(radius), 2))
        )
    return tuple(landmarks)


def coronary_arteries(phantom: HeartPhantom) -> dict[str, Tube]:
    """The coronary arteries as shapes: name -> a tube with the exact signed distance to its wall's outside, mm."""
    return {
        one.name: Tube(np.array(one.points_mm), np.full(len(one.points_mm), one.radius_mm))
        for one in coronary_landmarks(phantom)
    }


def _rays(phantom: HeartPhantom, name: IncisionName) -> tuple[Float64, Float64]:
    """Where to look for the surface from, and in which directions, both shape (n, 3)."""
    scale, places = phantom.scale, phantom.anatomy.places
    x, y, z = np.eye(3)

    def around(degrees: float) -> Float64:
        outward: Float64 = np.cos(np.radians(degrees)) * SEPTUM_AXIS + np.sin(np.radians(degrees)) * UPWARD_AXIS
        return outward

    def below(valve: str, direction: Float64, along_mm: float) -> tuple[Float64, Float64]:
        flow = _unit(direction)
        front = _unit(-y - (-y @ flow) * flow)
        side = np.cross(flow, front)
        angles = np.radians(np.linspace(-50.0, 50.0, 11))
        rays = np.array([np.cos(a) * front + np.sin(a) * side for a in angles])
        return np.repeat((places[valve] - along_mm * scale * flow)[None], len(rays), axis=0), rays

    if name == "right ventriculotomy":
        along = np.linspace(12.0, 40.0 * min(1.0, phantom.form.right_ventricle), 12)
        return scale * along[:, None] * LONG_AXIS, np.repeat(around(8.0)[None], len(along), axis=0)
    if name == "apical infundibulotomy":
        angles = np.linspace(-24.0, 16.0, 9)
        origin = scale * 46.0 * phantom.form.right_ventricle * LONG_AXIS
        return np.repeat(origin[None], len(angles), axis=0), np.array([around(a) for a in angles])
    if name == "pulmonary root":
        return below("pulmonary valve", np.array((0.12, 0.12, 0.98)), 7.0)
    if name == "aortic root":
        is_left = phantom.form.great_arteries == "concordant"
        return below("aortic valve", np.array((-0.3, -0.1, 0.95)), -16.0 if is_left else 7.0)
    if name == "right atriotomy":
        height = np.linspace(-14.0, 14.0, 10)
        origins = places["right atrium"] + scale * height[:, None] * z
        return origins, np.repeat(_unit(-x - 0.35 * y)[None], len(height), axis=0)
    line = places["aorta line"]
    isthmus = int(np.argmin(np.linalg.norm(line - scale * np.array((18.4, 50.0, 52.0)), axis=1)))
    part = line[isthmus - 4 : isthmus + 5]
    return part, np.repeat(x[None], len(part), axis=0)


def _exits(phantom: HeartPhantom, origins: Float64, directions: Float64) -> tuple[Float64, Float64]:
    """Where rays leave the heart for the first time, and how thick the tissue is there, along the ray."""
    step = 0.1 * phantom.scale
    reach = np.arange(0.0, 90.0 * phantom.scale, step)
    points = origins[:, None, :] + reach[None, :, None] * directions[:, None, :]
    labels = phantom.truth.label(points)
    outside = labels == 0
    # Where muscles end on the septum there are cracks of some tenths of a millimetre, which lead nowhere.
    is_exit = np.all(np.lib.stride_tricks.sliding_window_view(outside, _EXIT_STEPS, axis=1), axis=2)
    first = np.argmax(is_exit, axis=1)
    if not is_exit.any(axis=1).all() or not first.all():
        raise UsageError("a planned incision lies where this heart has no wall: leave it out", place="incisions")
    tissue = np.isin(labels, phantom.truth.table.tissue_values)
    depth = np.empty(len(first))
    for n, stop in enumerate(first):
        solid = np.flatnonzero(~tissue[n, :stop])
        depth[n] = step * (stop - 1 - (solid[-1] if len(solid) else 0))
    return points[np.arange(len(first)), first], depth


def _longest_run(points: Float64, gap: float) -> Float64:
    """The longest part of a line without a step over ``gap``: rays beside each other can end on different chambers."""
    breaks = 1 + np.flatnonzero(np.linalg.norm(np.diff(points, axis=0), axis=1) > gap)
    return max(np.split(points, breaks), key=len)


def _without_kinks(points: Float64, least_mm: float) -> Float64:
    """The line without the points where it turns on a circle of less than a radius: its tube would cross itself."""
    while len(points) > 2:
        a, b, c = points[:-2], points[1:-1], points[2:]
        twice_area = np.linalg.norm(np.cross(b - a, c - a), axis=1)
        sides = [np.linalg.norm(one, axis=1) for one in (b - a, c - b, c - a)]
        curvature = 2.0 * twice_area / np.maximum(np.prod(sides, axis=0), 1e-12)
        sharpest = int(np.argmax(curvature))
        if curvature[sharpest] * least_mm < 1.0:
            break
        points = np.delete(points, sharpest + 1, axis=0)
    return points


def _laid_on(phantom: HeartPhantom, surface: Float64, radius: float) -> Float64:
    """Points moved away from the heart until they are a radius off: in fat, between the shoulders of a groove.

    They climb the distance to the heart, its slope taken so coarsely that both walls of a groove count. Where something
    else of the heart lies close above, such as an appendage, they stay where it is widest.
    """
    points = surface.copy()
    step, reach = 0.05 * phantom.scale, 0.5 * radius
    aside = reach * np.concatenate([np.eye(3), -np.eye(3)])
    for _ in range(int(4.0 * radius / step)):
        room = -phantom.truth.value(points, 0)
        near = np.flatnonzero(room < radius)
        if not len(near):
            break
        around = -phantom.truth.value((points[near, None] + aside).reshape(-1, 3), 0).reshape(-1, 6)
        slope = around[:, :3] - around[:, 3:]
        size = np.linalg.norm(slope, axis=1, keepdims=True)
        # Away from one flat wall it is 2 reach; hardly any is the middle of a gap, more a narrow groove.
        points[near] += step * np.where(size > 0.1 * reach, slope / np.maximum(size, 1e-9), 0.0)
    return points


def _groove(phantom: HeartPhantom) -> Float64:
    """Where the right ventricle's wall begins at the front, from the base to the apex."""
    scale = phantom.scale
    angles = np.radians(np.linspace(20.0, 150.0, 131))
    outward = np.cos(angles)[:, None] * SEPTUM_AXIS + np.sin(angles)[:, None] * UPWARD_AXIS
    found = []
    for along in np.linspace(10.0, 58.0, 13):
        surface, _ = _exits(phantom, np.repeat((scale * along * LONG_AXIS)[None], len(angles), axis=0), outward)
        fields = phantom.anatomy.tables.evaluate(surface)
        is_left = np.abs(fields[:, 8]) < 0.6 * scale
        if is_left.any():
            found.append(surface[int(np.argmax(is_left))])
    return np.array(found)


def _rounded(points: Float64) -> tuple[tuple[float, float, float], ...]:
    return tuple((round(float(x), 1), round(float(y), 1), round(float(z), 1)) for x, y, z in points)


def _mirrored(landmark: Landmark) -> Landmark:
    return landmark.model_copy(update={"points_mm": tuple(mirrored(point) for point in landmark.points_mm)})


def _unit(vector: Float64) -> Float64:
    unit: Float64 = vector / np.linalg.norm(vector)
    return unit
