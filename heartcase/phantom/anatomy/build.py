"""The shapes of the phantom's heart: chambers, great vessels and left ventricular myocardium, in patient LPS mm.

Positions are those of an adult with the centre of the left ventricular base at the origin: x to the left, y to the
back, z to the head. The long axis points to the left, to the front and down; the right ventricle wraps around the
septum at the right and in front; the pulmonary trunk crosses in front of the aorta. Other sizes are scaled copies
with wall thicknesses of their own.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from heartcase.phantom.anatomy.axes import LONG_AXIS, SEPTUM_AXIS, UPWARD_AXIS
from heartcase.phantom.anatomy.inner import baffle_shape, with_left_detail, with_right_detail
from heartcase.phantom.anatomy.shapes import (
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
from heartcase.phantom.anatomy.sizes import proportions_of
from heartcase.phantom.anatomy.tables import DistanceTables, tabulate
from heartcase.phantom.anatomy.vessels import Outlet, Vessels, build_vessels
from heartcase.schemas.arrays import Float64
from heartcase.schemas.recipe.heart_form import HeartForm
from heartcase.schemas.recipe.settings import EndMarker

__all__ = ["EXTENSION_MM", "Anatomy", "build_anatomy"]


EXTENSION_MM = 3.0
"""How far a vessel goes on behind its end disc before it ends round, in a synthetic scan."""


@dataclass(frozen=True)
class Anatomy:
    """The heart's distance fields and what goes with them."""

    tables: DistanceTables
    """True distances: fields 0-7 are the lumens of labels 1-8, field 8 is all that the left epicardium holds, field 9,
    where there is one, sheets in the blood."""
    ends: tuple[EndMarker, ...]
    """Where vessels are cut off; the shapes go on behind."""
    places: dict[str, Float64]
    """Named places, mm: centres of the chambers and of the valves, and the vessels' centrelines."""
    openings: tuple[tuple[str, str], ...]
    """Pairs of labels between which blood passes, defects left aside."""

    def mirrored(self) -> Anatomy:
        """The mirror image, left and right exchanged."""
        mirror = np.array((-1.0, 1.0, 1.0))
        ends = tuple(
            end.model_copy(update={"position_mm": mirrored(end.position_mm), "axis": mirrored(end.axis)})
            for end in self.ends
        )
        places = {name: place * mirror for name, place in self.places.items()}
        return Anatomy(self.tables.mirrored(), ends, places, self.openings)


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


def build_anatomy(form: HeartForm, told: Callable[[float], None] = lambda _: None) -> Anatomy:
    """Shapes of a heart, not mirrored.

    Parameters
    ----------
    form
        Its size, and what is not as in a normal heart; defects that are canals are not among the shapes.
    told
        Hears after each field how much is done, from 0 to 1.
    """
    sizes = proportions_of(form)
    scale, left_wall_mm = sizes.scale, sizes.left_wall_mm
    vessel_gap_mm = sizes.gap_mm
    arrangement = form.great_arteries
    rounding = 2.0 * scale
    boxes = _boxes(scale, arrangement)
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
        told(len(fields) / len(boxes))
        return fields[value]

    def ball(
        center: Float64 | tuple[float, float, float], radii: tuple[float, float, float], oblique: bool
    ) -> Ellipsoid:
        frame = np.stack([LONG_AXIS, SEPTUM_AXIS, UPWARD_AXIS]) if oblique else np.eye(3)
        return Ellipsoid(scale * np.asarray(center), scale * np.asarray(radii), frame)

    vessels = build_vessels(form, sizes)
    aortic_shapes = [vessels.arch, *vessels.arch_branches]
    pulmonary_shapes = [vessels.trunk, vessels.right_branch, vessels.left_branch]
    left_auricle = Tube(
        scale * np.array([(8.0, 20.0, 14.0), (24.0, 10.0, 20.0), (34.0, -2.0, 20.0), (37.0, -12.0, 15.0)]),
        scale * np.array([9.0, 8.0, 7.5, 5.5]),
    )

    width = 22.0 * form.left_ventricle
    length = 44.0 * (0.5 + 0.5 * form.left_ventricle)
    base = scale * _at(-3.0, 0.0, 0.0)
    left_ventricle: Shape = Intersection(
        [ball(_at(30.0, 0.0, 0.0), (length, width, width), True), HalfSpace(base, -LONG_AXIS)], 8.0 * scale
    )
    if arrangement != "double outlet right ventricle":
        outflow = Capsule(scale * _at(16.0, 4.0, 4.0), vessels.left_outflow_mm, 10.5 * scale * sizes.artery)
        left_ventricle = Union([left_ventricle, outflow], 5.0 * scale)
    smooth_ventricle = fix(1, left_ventricle)

    inner_radius = width * scale
    outer = np.array([length * scale + 0.85 * left_wall_mm, inner_radius + left_wall_mm, inner_radius + left_wall_mm])
    body: Shape = Intersection(
        [
            Ellipsoid(scale * _at(30.0, 0.0, 0.0), outer, np.stack([LONG_AXIS, SEPTUM_AXIS, UPWARD_AXIS])),
            HalfSpace(base - 0.35 * left_wall_mm * LONG_AXIS, -LONG_AXIS),
        ],
        12.0 * scale,
    )
    body = fix(9, Union([body, Offset(smooth_ventricle, 0.45 * left_wall_mm)], 4.0 * scale))

    # The artery that leaves the left ventricle is a part of the left side; the others give way to it.
    left_artery: list[Shape] = []
    if arrangement == "concordant":
        left_artery = [fix(5, Union(aortic_shapes, 4.0 * scale))]
    elif arrangement == "transposed":
        left_artery = [fix(6, Union(pulmonary_shapes, 8.0 * scale))]
    mitral = scale * _at(-4.0, -8.0, -4.0)
    left_center = np.array((-7.0, 24.0, 8.0))
    atrial_shapes: list[Shape] = [ball(left_center, (25.0, 17.0, 19.0), False), left_auricle]
    if form.body_surface_m2 is not None:
        # So that the atrial septum reaches down to the valves.
        atrial_shapes.append(ball((-15.0, 9.0, -4.0), (11.0, 11.0, 9.0), False))
    left_atrium: Shape = Intersection(
        [
            Union(atrial_shapes, 6.0 * scale),
            complement(Offset(body, 0.3 * vessel_gap_mm)),
        ],
        5.0 * scale,
    )
    canal = Capsule(scale * (left_center + np.array((4.0, -6.0, -5.0))), mitral + 3.0 * scale * LONG_AXIS, 12.5 * scale)
    left_atrium = Union([left_atrium, canal], 6.0 * scale)
    left_atrium = Intersection(
        [left_atrium, *(complement(shape, gap_mm=vessel_gap_mm) for shape in left_artery)], 4.0 * scale
    )
    left_atrium = fix(3, Union([left_atrium, *vessels.veins.values()], 6.0 * scale), edges=True, fillet=3.0)

    # A trace of overlap with the septum leaves no gap between it and the right ventricle; blood wins there.
    away_from_left = [
        complement(body, gap_mm=-0.1 * scale),
        *(complement(shape, gap_mm=vessel_gap_mm) for shape in (*left_artery, left_atrium)),
    ]

    # At a valve both cavities reach over one plane as far as their edges are rounded: on the plane both are full.
    outlets = [(outlet, _Valve(outlet.valve_mm, outlet.direction, rounding)) for outlet in vessels.outlets]
    tricuspid_valve = _Valve(scale * np.array((-21.0, -15.0, -8.0)), np.array((0.75, -0.60, -0.28)), rounding)
    small = 1.0 - form.right_ventricle * sizes.right_ventricle
    inflow = Capsule(
        tricuspid_valve.at(-13.0 * scale),
        tricuspid_valve.at(11.0 * scale),
        13.0 * scale * (1.0 - 0.6 * max(small, 0.0)),
    )
    shift = 22.0 * (form.left_ventricle - 1.0) + 11.7 * small
    right_radii = (43.0 * (1.0 - small), 27.0 * (1.0 - small), 33.0 * (1.0 - small))
    right_ventricle: Shape = ball(_at(23.0 - 25.0 * small, 20.0 + shift, -3.0), right_radii, True)
    base_plane = HalfSpace(scale * _at(-2.0, 25.0, 0.0), -LONG_AXIS - 0.1 * SEPTUM_AXIS)
    right_ventricle = Intersection([right_ventricle, base_plane], 12.0 * scale)
    limits = [valve.moved(-4.0 * scale).behind for _, valve in outlets]
    limits.append(tricuspid_valve.moved(4.0 * scale).beyond)
    right_ventricle = Intersection([right_ventricle, *limits], 8.0 * scale)
    right_ventricle = Union([right_ventricle, *(outlet.infundibulum for outlet, _ in outlets), inflow], 8.0 * scale)
    right_ventricle = Intersection([right_ventricle, *away_from_left], 4.0 * scale)
    if form.has_detail:
        fix(1, with_left_detail(left_ventricle, scale, width))
        right_ventricle = with_right_detail(right_ventricle, scale)
    right_ventricle = fix(
        2,
        Intersection([right_ventricle, *(valve.behind for _, valve in outlets), tricuspid_valve.beyond]),
        edges=True,
    )

    right_center = np.array((-38.0, 1.0, 1.0))
    right_atrium: Shape = Union([ball(right_center, (20.0, 23.0, 26.0), False), vessels.right_auricle], 8.0 * scale)
    right_atrium = Intersection([right_atrium, complement(right_ventricle, gap_mm=vessel_gap_mm)], 5.0 * scale)
    right_atrium = Intersection([Union([right_atrium, inflow], 6.0 * scale), *away_from_left], 4.0 * scale)
    beside_valve = complement(inflow, gap_mm=3.0 * scale)
    right_atrium = fix(4, Intersection([right_atrium, Union([tricuspid_valve.behind, beside_valve])]), edges=True)

    for outlet, valve in outlets:
        beyond: list[Shape] = [valve.beyond]
        if outlet.is_aortic:
            # The descending aorta runs behind the heart and below the plane of its valve.
            beyond = [Union([valve.beyond, HalfSpace(scale * np.array((0.0, 10.0, 0.0)), np.array((0.0, -1.0, 0.0)))])]
            beyond += [complement(right_atrium, gap_mm=vessel_gap_mm)]
        elif arrangement == "double outlet right ventricle":
            beyond += [complement(Union(aortic_shapes), gap_mm=vessel_gap_mm)]
        artery: Shape = Union(
            aortic_shapes if outlet.is_aortic else pulmonary_shapes, (4.0 if outlet.is_aortic else 8.0) * scale
        )
        artery = Intersection([artery, *away_from_left], 3.0 * scale)
        fix(5 if outlet.is_aortic else 6, Intersection([artery, *beyond]), edges=True)
    others = [complement(fields[value], gap_mm=vessel_gap_mm) for value in (6, 5, 3)]
    fix(7, Intersection([vessels.superior_cava, *others], 3.0 * scale), edges=True)
    fix(8, Intersection([vessels.inferior_cava, *others], 3.0 * scale), edges=True)
    sheet = _sheet(form, vessels, scale, mitral, tricuspid_valve, outlets)
    if sheet is not None:
        fix(SHEET_FIELD, sheet)

    named = _lines(vessels)
    places = {
        "left ventricle": scale * _at(28.0, 0.0, 0.0),
        "right ventricle": scale * _at(20.0, 40.0, 0.0),
        "left atrium": scale * left_center,
        "right atrium": scale * right_center,
        "apex": scale * _at(30.0 + length, 0.0, 0.0) + 0.4 * left_wall_mm * LONG_AXIS,
        "mitral valve": mitral,
        "tricuspid valve": tricuspid_valve.position_mm,
        "aortic valve": vessels.arch.line(0.0),
        "pulmonary valve": vessels.trunk.line(0.0),
    }
    for number, outlet in enumerate(vessels.outlets, start=1):
        tube = outlet.infundibulum
        places[f"right outflow line {number}"] = tube.line(np.linspace(0.0, 0.7 * tube.length_mm, 12))
        places["aortic valve" if outlet.is_aortic else "pulmonary valve"] = outlet.valve_mm
    places |= {name: tube.line(np.linspace(0.0, tube.length_mm, count)) for name, (_, tube, count) in named.items()}
    ends = tuple(_end(label, tube, scale) for name, (label, tube, _) in named.items() if name not in _CLOSED)
    tables = DistanceTables.joined([fields[value] for value in sorted(fields)])
    return Anatomy(tables, ends, places, _openings(arrangement))


SHEET_FIELD = 10
"""Number of the field of sheets in the blood (a baffle, valve leaflets), where a heart has any."""
_CLOSED = ("pulmonary trunk line",)
"""Lines of vessels that end in others."""


def _lines(vessels: Vessels) -> dict[str, tuple[str, Tube, int]]:
    """Name of each vessel's line -> its label, the tube, and how many points the line is told by."""
    lines: dict[str, tuple[str, Tube, int]] = {"aorta line": ("aorta", vessels.arch, 60)}
    for number, branch in enumerate(vessels.arch_branches, start=1):
        lines[f"aortic branch line {number}"] = ("aorta", branch, 20)
    lines |= {
        "pulmonary trunk line": ("pulmonary artery", vessels.trunk, 30),
        "right pulmonary line": ("pulmonary artery", vessels.right_branch, 30),
        "left pulmonary line": ("pulmonary artery", vessels.left_branch, 30),
        "superior vena cava line": ("superior vena cava", vessels.superior_cava, 30),
        "inferior vena cava line": ("inferior vena cava", vessels.inferior_cava, 30),
    }
    return lines | {f"{name} vein line": ("left atrium", vein, 20) for name, vein in vessels.veins.items()}


def _openings(arrangement: str) -> tuple[tuple[str, str], ...]:
    """Pairs of labels between which blood passes, defects left aside."""
    left, right = "left ventricle", "right ventricle"
    arteries = {
        "concordant": ((left, "aorta"), (right, "pulmonary artery")),
        "transposed": ((left, "pulmonary artery"), (right, "aorta")),
        "double outlet right ventricle": ((right, "aorta"), (right, "pulmonary artery")),
    }[arrangement]
    return (
        (left, "left atrium"),
        arteries[0],
        (right, "right atrium"),
        arteries[1],
        ("right atrium", "superior vena cava"),
        ("right atrium", "inferior vena cava"),
    )


def _sheet(
    form: HeartForm,
    vessels: Vessels,
    scale: float,
    mitral: Float64,
    tricuspid: _Valve,
    outlets: list[tuple[Outlet, _Valve]],
) -> Shape | None:
    """What lies in the blood: leaflets and the baffle together; None where there is neither."""
    shapes: list[Shape] = []
    if form.has_valve_leaflets:
        thickness = LEAFLET_STEPS * scale
        semilunar = [(valve.position_mm, valve.direction, 13.5) for _, valve in outlets]
        if vessels.left_root is not None:
            at = 4.0 * scale
            semilunar.append((vessels.left_root.line(at), vessels.left_root.line(at, 1), 13.0))
        for position, direction, reach in (
            (mitral, LONG_AXIS, 16.0),
            (tricuspid.position_mm, tricuspid.direction, 17.0),
            *((place, -1.0 * np.asarray(way), size) for place, way, size in semilunar),
        ):
            shapes.append(_leaflets(position, direction, reach * scale, thickness))
    if form.baffle is not None:
        shapes.append(baffle_shape(form.baffle, vessels, scale))
    return Union(shapes) if shapes else None


LEAFLET_STEPS = 2.2
"""Thickness of leaflets in steps of the tables: thinner ones would get holes."""


def _leaflets(position: Float64, towards: Float64, radius: float, thickness: float) -> Shape:
    """A closed valve: a piece of a spherical shell that bulges towards a side."""
    centre = position - 1.6 * radius * _unit(towards)
    outer = Ellipsoid(centre, np.full(3, 1.6 * radius + 0.5 * thickness))
    inner = Ellipsoid(centre, np.full(3, 1.6 * radius - 0.5 * thickness))
    return Intersection([outer, complement(inner), Ellipsoid(position, np.full(3, radius))])


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


def mirrored(point: tuple[float, float, float]) -> tuple[float, float, float]:
    """A point or a direction with left and right exchanged."""
    return (0.0 - point[0], point[1], point[2])


def _boxes(scale: float, arrangement: str) -> dict[int, tuple[Float64, Float64]]:
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
        SHEET_FIELD: ((-45.0, -60.0, -40.0), (40.0, 35.0, 40.0)),
    }
    if arrangement != "concordant":
        adult[5] = ((-45.0, -54.0, -40.0), (38.0, 74.0, 108.0))
        adult[6] = ((-78.0, -54.0, -20.0), (76.0, 50.0, 70.0))
    return {value: (scale * np.array(lower), scale * np.array(upper)) for value, (lower, upper) in adult.items()}
