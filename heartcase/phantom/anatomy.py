"""The shapes of the phantom's heart: chambers, great vessels and left ventricular myocardium, in patient LPS mm.

Positions are those of an adult with the centre of the left ventricular base at the origin: x to the left, y to the
back, z to the head. The long axis points to the left, to the front and down; the right ventricle wraps around the
septum at the right and in front; the pulmonary trunk crosses in front of the aorta. Other sizes are scaled copies
with wall thicknesses of their own.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from heartcase.phantom.shapes import (
    Capsule,
    Ellipsoid,
    HalfSpace,
    Intersection,
    Offset,
    Shape,
    Tube,
    Union,
    complement,
)
from heartcase.phantom.tables import DistanceTables, tabulate
from heartcase.schemas.settings import EndMarker

__all__ = ["EXTENSION_MM", "LONG_AXIS", "SEPTUM_AXIS", "UPWARD_AXIS", "Anatomy", "build_anatomy"]

Float64 = npt.NDArray[np.float64]

LONG_AXIS = np.array([0.66, -0.50, -0.56]) / np.linalg.norm([0.66, -0.50, -0.56])
"""From the base of the left ventricle to its apex."""
_TOWARDS_RIGHT = np.array([-0.55, -0.80, -0.10])
SEPTUM_AXIS = (_TOWARDS_RIGHT - (_TOWARDS_RIGHT @ LONG_AXIS) * LONG_AXIS) / np.linalg.norm(
    _TOWARDS_RIGHT - (_TOWARDS_RIGHT @ LONG_AXIS) * LONG_AXIS
)
"""From the left ventricle through the septum to the right one."""
UPWARD_AXIS = np.cross(SEPTUM_AXIS, LONG_AXIS)
"""Across both, upwards."""
EXTENSION_MM = 3.0
"""How far a vessel goes on behind its end disc before it ends round, in a synthetic scan."""


@dataclass(frozen=True)
class Anatomy:
    """The heart's distance fields and what goes with them."""

    tables: DistanceTables
    """True distances: fields 0-7 are the lumens of labels 1-8, field 8 is all that the left epicardium holds."""
    ends: tuple[EndMarker, ...]
    """Where vessels are cut off; the shapes go on behind."""
    places: dict[str, Float64]
    """Named places, mm: centres of the chambers and of the valves, and the vessels' centrelines."""


@dataclass(frozen=True)
class _Valve:
    """A plane across the flow, and the half spaces before and behind it, each reaching over the plane a little."""

    position_mm: Float64
    direction: Float64
    overlap_mm: float

    @property
    def behind(self) -> HalfSpace:
        return HalfSpace(self.at(self.overlap_mm), self.direction)

    @property
    def beyond(self) -> HalfSpace:
        return HalfSpace(self.at(-self.overlap_mm), -self.direction)

    def at(self, along_mm: float) -> Float64:
        point: Float64 = self.position_mm + along_mm * _unit(self.direction)
        return point

    def moved(self, along_mm: float) -> _Valve:
        return _Valve(self.at(along_mm), self.direction, self.overlap_mm)


def _unit(vector: Float64) -> Float64:
    unit: Float64 = vector / np.linalg.norm(vector)
    return unit


def _at(along: float, right: float, up: float) -> Float64:
    point: Float64 = along * LONG_AXIS + right * SEPTUM_AXIS + up * UPWARD_AXIS
    return point


def build_anatomy(scale: float, left_wall_mm: float, vessel_gap_mm: float) -> Anatomy:
    """Shapes of a heart.

    Parameters
    ----------
    scale
        Size of the cavities against the adult's.
    left_wall_mm
        Thickness of the left ventricular myocardium at its middle.
    vessel_gap_mm
        Least tissue between cavities of the left and of the right side.
    """
    rounding = 2.0 * scale
    frame = np.stack([LONG_AXIS, SEPTUM_AXIS, UPWARD_AXIS])
    boxes = _boxes(scale)
    fields: dict[int, DistanceTables] = {}

    def fix(value: int, shape: Shape, *, edges: bool = False, fillet: float = 0.0) -> DistanceTables:
        lower, upper = boxes[value]
        fields[value] = tabulate(
            shape,
            lower,
            upper,
            spacing_mm=scale,
            band_mm=5.0 * scale + 2.5,
            margin_mm=4.0 * scale + 2.0,
            rounding_mm=rounding if edges else 0.0,
            fillet_mm=fillet * scale,
        )
        return fields[value]

    def tube(points: list[tuple[float, float, float]], radii: list[float], *, trim: float = 0.0) -> Tube:
        return Tube(scale * np.array(points), scale * np.array(radii), trim_mm=scale * trim)

    def ball(
        center: Float64 | tuple[float, float, float], radii: tuple[float, float, float], oblique: bool
    ) -> Ellipsoid:
        return Ellipsoid(scale * np.asarray(center), scale * np.asarray(radii), frame if oblique else np.eye(3))

    arch = tube(
        [
            (1.0, -10.5, 3.0),
            (-3.0, -11.5, 12.0),
            (-8.0, -12.0, 23.0),
            (-12.0, -11.0, 38.0),
            (-11.0, -6.0, 55.0),
            (-3.0, 6.0, 69.0),
            (8.0, 24.0, 73.0),
            (16.0, 42.0, 64.0),
            (19.0, 52.0, 44.0),
            (19.0, 54.0, 20.0),
            (18.0, 55.0, -4.0),
        ],
        [10.2, 12.6, 13.0, 12.2, 12.2, 11.6, 10.6, 9.8, 9.3, 9.0, 9.0],
        trim=7.0,
    )
    arch_branches = [
        tube([(-8.0, 0.0, 62.0), (-13.0, -1.0, 78.0), (-18.0, -3.0, 98.0)], [6.0, 5.2, 5.0], trim=7.0),
        tube([(1.0, 12.0, 72.0), (2.0, 11.0, 84.0), (1.0, 8.0, 98.0)], [4.2, 3.6, 3.5], trim=7.0),
        tube([(8.0, 25.0, 73.0), (12.0, 25.0, 84.0), (17.0, 22.0, 98.0)], [4.8, 4.2, 4.0], trim=7.0),
    ]
    trunk = tube(
        [
            (10.0, -38.5, 2.0),
            (14.0, -36.0, 17.0),
            (17.0, -34.0, 28.0),
            (20.0, -25.0, 38.0),
            (21.0, -10.0, 44.0),
            (20.0, 3.0, 45.0),
        ],
        [12.0, 12.0, 12.0, 12.0, 11.4, 10.0],
    )
    right_branch = tube(
        [
            (21.0, -2.0, 44.5),
            (10.0, 13.0, 44.5),
            (-8.0, 17.0, 43.5),
            (-26.0, 17.0, 42.0),
            (-45.0, 16.0, 40.0),
            (-60.0, 16.0, 38.0),
        ],
        [9.6, 9.0, 8.6, 8.3, 7.8, 7.5],
        trim=7.0,
    )
    left_branch = tube(
        [(19.0, -4.0, 45.0), (27.0, 7.0, 47.0), (39.0, 18.0, 47.0), (51.0, 28.0, 43.0), (60.0, 35.0, 38.0)],
        [9.6, 9.0, 8.6, 8.0, 7.5],
        trim=7.0,
    )
    superior_cava = tube(
        [(-41.0, 0.0, 8.0), (-41.0, -2.0, 24.0), (-41.0, -4.5, 42.0), (-40.0, -6.0, 58.0), (-37.0, -7.0, 84.0)],
        [9.5, 9.0, 8.7, 8.5, 8.0],
        trim=7.0,
    )
    inferior_cava = tube(
        [(-40.0, 6.0, -8.0), (-40.0, 8.0, -24.0), (-39.0, 9.0, -40.0), (-38.0, 10.0, -58.0)],
        [11.0, 10.2, 10.0, 10.0],
        trim=7.0,
    )
    veins = {
        "right superior": tube(
            [(-12.0, 24.0, 14.0), (-30.0, 29.0, 22.0), (-53.0, 33.0, 27.0)], [8.0, 6.0, 5.5], trim=7.0
        ),
        "right inferior": tube(
            [(-12.0, 28.0, 2.0), (-30.0, 37.0, -1.0), (-51.0, 43.0, -6.0)], [8.0, 6.0, 5.5], trim=7.0
        ),
        "left superior": tube([(8.0, 25.0, 17.0), (25.0, 31.0, 23.0), (47.0, 36.0, 26.0)], [8.0, 6.0, 5.5], trim=7.0),
        "left inferior": tube([(6.0, 27.0, 4.0), (23.0, 35.0, 0.0), (44.0, 39.0, -6.0)], [8.0, 6.0, 5.5], trim=7.0),
    }
    left_auricle = tube(
        [(8.0, 20.0, 14.0), (24.0, 10.0, 20.0), (34.0, -2.0, 20.0), (37.0, -12.0, 15.0)], [9.0, 8.0, 7.5, 5.5]
    )
    right_auricle = tube(
        [(-40.0, -6.0, 8.0), (-42.0, -20.0, 16.0), (-34.0, -32.0, 22.0), (-22.0, -37.0, 24.0)], [14.0, 11.0, 9.0, 6.0]
    )

    base = scale * _at(-3.0, 0.0, 0.0)
    left_ventricle: Shape = Intersection(
        [ball(_at(30.0, 0.0, 0.0), (44.0, 22.0, 22.0), True), HalfSpace(base, -LONG_AXIS)], 8.0 * scale
    )
    outflow = Capsule(scale * _at(16.0, 4.0, 4.0), scale * np.array((0.3, -10.3, 4.0)), 10.5 * scale)
    left_ventricle = fix(1, Union([left_ventricle, outflow], 5.0 * scale))

    inner_radius = 22.0 * scale
    outer = np.array([44.0 * scale + 0.85 * left_wall_mm, inner_radius + left_wall_mm, inner_radius + left_wall_mm])
    body: Shape = Intersection(
        [
            Ellipsoid(scale * _at(30.0, 0.0, 0.0), outer, frame),
            HalfSpace(base - 0.35 * left_wall_mm * LONG_AXIS, -LONG_AXIS),
        ],
        12.0 * scale,
    )
    body = fix(9, Union([body, Offset(left_ventricle, 0.45 * left_wall_mm)], 4.0 * scale))

    aorta = fix(5, Union([arch, *arch_branches], 4.0 * scale))
    mitral = scale * _at(-4.0, -8.0, -4.0)
    left_center = np.array((-7.0, 24.0, 8.0))
    left_atrium: Shape = Intersection(
        [
            Union([ball(left_center, (25.0, 17.0, 19.0), False), left_auricle], 6.0 * scale),
            complement(Offset(body, 0.3 * vessel_gap_mm)),
        ],
        5.0 * scale,
    )
    canal = Capsule(scale * (left_center + np.array((4.0, -6.0, -5.0))), mitral + 3.0 * scale * LONG_AXIS, 12.5 * scale)
    left_atrium = Union([left_atrium, canal], 6.0 * scale)
    left_atrium = Intersection([left_atrium, complement(aorta, gap_mm=vessel_gap_mm)], 4.0 * scale)
    left_atrium = fix(3, Union([left_atrium, *veins.values()], 6.0 * scale), edges=True, fillet=3.0)

    # A trace of overlap with the septum leaves no gap between it and the right ventricle; blood wins there.
    away_from_left = [
        complement(body, gap_mm=-0.1 * scale),
        *(complement(shape, gap_mm=vessel_gap_mm) for shape in (aorta, left_atrium)),
    ]

    # At a valve both cavities reach over one plane as far as their edges are rounded: on the plane both are full.
    pulmonary_valve = _Valve(scale * np.array((14.3, -35.8, 18.0)), np.array((0.12, 0.12, 0.98)), rounding)
    tricuspid_valve = _Valve(scale * np.array((-21.0, -15.0, -8.0)), np.array((0.75, -0.60, -0.28)), rounding)
    inflow = Capsule(tricuspid_valve.at(-13.0 * scale), tricuspid_valve.at(11.0 * scale), 13.0 * scale)
    infundibulum = tube(
        [(6.0, -40.0, -14.0), (10.0, -38.5, 2.0), (14.0, -36.0, 17.0), (17.0, -34.0, 28.0)], [17.0, 14.5, 12.2, 11.9]
    )
    right_ventricle: Shape = ball(_at(23.0, 20.0, -3.0), (43.0, 27.0, 33.0), True)
    base_plane = HalfSpace(scale * _at(-2.0, 25.0, 0.0), -LONG_AXIS - 0.1 * SEPTUM_AXIS)
    right_ventricle = Intersection([right_ventricle, base_plane], 12.0 * scale)
    limits = [pulmonary_valve.moved(-4.0 * scale).behind, tricuspid_valve.moved(4.0 * scale).beyond]
    right_ventricle = Intersection([right_ventricle, *limits], 8.0 * scale)
    right_ventricle = Union([right_ventricle, infundibulum, inflow], 8.0 * scale)
    right_ventricle = Intersection([right_ventricle, *away_from_left], 4.0 * scale)
    right_ventricle = fix(
        2, Intersection([right_ventricle, pulmonary_valve.behind, tricuspid_valve.beyond]), edges=True
    )

    right_center = np.array((-38.0, 1.0, 1.0))
    right_atrium: Shape = Union([ball(right_center, (20.0, 23.0, 26.0), False), right_auricle], 8.0 * scale)
    right_atrium = Intersection([right_atrium, complement(right_ventricle, gap_mm=vessel_gap_mm)], 5.0 * scale)
    right_atrium = Intersection([Union([right_atrium, inflow], 6.0 * scale), *away_from_left], 4.0 * scale)
    beside_valve = complement(inflow, gap_mm=3.0 * scale)
    right_atrium = fix(4, Intersection([right_atrium, Union([tricuspid_valve.behind, beside_valve])]), edges=True)

    pulmonary: Shape = Union([trunk, right_branch, left_branch], 8.0 * scale)
    pulmonary = Intersection([pulmonary, *away_from_left], 3.0 * scale)
    pulmonary = fix(6, Intersection([pulmonary, pulmonary_valve.beyond]), edges=True)
    others = [complement(shape, gap_mm=vessel_gap_mm) for shape in (pulmonary, aorta, left_atrium)]
    fix(7, Intersection([superior_cava, *others], 3.0 * scale), edges=True)
    fix(8, Intersection([inferior_cava, *others], 3.0 * scale), edges=True)
    open_tubes = [
        ("aorta", arch),
        *(("aorta", branch) for branch in arch_branches),
        ("pulmonary artery", right_branch),
        ("pulmonary artery", left_branch),
        ("superior vena cava", superior_cava),
        ("inferior vena cava", inferior_cava),
        *(("left atrium", vein) for vein in veins.values()),
    ]
    places = {
        "left ventricle": scale * _at(28.0, 0.0, 0.0),
        "right ventricle": scale * _at(20.0, 40.0, 0.0),
        "left atrium": scale * left_center,
        "right atrium": scale * right_center,
        "apex": scale * _at(74.0, 0.0, 0.0) + 0.4 * left_wall_mm * LONG_AXIS,
        "mitral valve": mitral,
        "tricuspid valve": tricuspid_valve.position_mm,
        "aortic valve": arch.line(0.0),
        "pulmonary valve": pulmonary_valve.position_mm,
        "aorta line": arch.line(np.linspace(0.0, arch.length_mm, 60)),
        "pulmonary trunk line": trunk.line(np.linspace(0.0, trunk.length_mm, 30)),
        "right pulmonary line": right_branch.line(np.linspace(0.0, right_branch.length_mm, 30)),
        "left pulmonary line": left_branch.line(np.linspace(0.0, left_branch.length_mm, 30)),
        "superior vena cava line": superior_cava.line(np.linspace(0.0, superior_cava.length_mm, 30)),
        "inferior vena cava line": inferior_cava.line(np.linspace(0.0, inferior_cava.length_mm, 30)),
    }
    places |= {f"{name} vein line": vein.line(np.linspace(0.0, vein.length_mm, 20)) for name, vein in veins.items()}
    places |= {
        f"aortic branch line {number}": branch.line(np.linspace(0.0, branch.length_mm, 20))
        for number, branch in enumerate(arch_branches, start=1)
    }
    ends = tuple(_end(label, line, scale) for label, line in open_tubes)
    return Anatomy(DistanceTables.joined([fields[value] for value in range(1, 10)]), ends, places)


def _end(label: str, tube: Tube, scale: float) -> EndMarker:
    """Disc across a tube, far enough before its last point that the rounded end stays behind it."""
    centre, direction, radius = tube.frame(tube.length_mm - EXTENSION_MM * scale)
    reach = radius + 4.0 * scale + 1.0
    return EndMarker(
        label=label,
        position_mm=tuple(round(float(v), 3) for v in centre),
        axis=tuple(round(float(v), 5) for v in direction),
        radius_mm=round(float(reach), 3),
    )


def _boxes(scale: float) -> dict[int, tuple[Float64, Float64]]:
    adult = {
        1: ((-25.0, -75.0, -75.0), (75.0, 30.0, 30.0)),
        2: ((-55.0, -85.0, -75.0), (60.0, 15.0, 40.0)),
        3: ((-60.0, -22.0, -24.0), (56.0, 52.0, 42.0)),
        4: ((-72.0, -50.0, -42.0), (5.0, 35.0, 42.0)),
        5: ((-35.0, -30.0, -40.0), (38.0, 74.0, 108.0)),
        6: ((-78.0, -54.0, 0.0), (76.0, 50.0, 70.0)),
        7: ((-56.0, -20.0, -5.0), (-28.0, 18.0, 104.0)),
        8: ((-58.0, -10.0, -80.0), (-24.0, 26.0, 8.0)),
        9: ((-45.0, -85.0, -85.0), (85.0, 45.0, 45.0)),
    }
    return {value: (scale * np.array(lower), scale * np.array(upper)) for value, (lower, upper) in adult.items()}
