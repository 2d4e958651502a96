"""What lies inside the ventricles: papillary muscles, the moderator band, trabeculae, and a surgeon's baffle."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from heartcase.phantom.anatomy.axes import LONG_AXIS, SEPTUM_AXIS, UPWARD_AXIS
from heartcase.phantom.anatomy.shapes import Capsule, HalfSpace, Intersection, Shape, Tube, complement
from heartcase.phantom.anatomy.vessels import Vessels
from heartcase.schemas.arrays import Float64
from heartcase.schemas.recipe.heart_form import Baffle

__all__ = ["BAFFLE_LINE", "Trabeculae", "baffle_shape", "tunnel", "with_left_detail", "with_right_detail"]

BAFFLE_LINE = (
    *((9.3, -22.0, 1.7), (9.1, -32.0, 2.3), (4.0, -38.0, -0.5), (-5.0, -39.5, 0.5), (-12.5, -36.5, 6.0)),
    (-16.0, -32.0, 14.0),
)
"""The tunnel's middle, from the septum to the aortic valve, in the adult's positions."""


@dataclass(frozen=True)
class Trabeculae:
    """A cavity whose wall has ridges along the heart's long axis, higher towards the apex."""

    shape: Shape
    """The smooth cavity."""
    scale: float
    """Size against the adult's."""
    height_mm: float
    """Height of the ridges in the adult."""
    spacing_mm: float
    """Distance from one to the next in the adult."""

    @property
    def steepest(self) -> float:
        """How much the value with its ridges would change per mm at most: it is divided by that."""
        wave = 2.0 * np.pi / self.spacing_mm
        return 1.0 + self.height_mm * (0.443 * wave * float(np.hypot(1.3, 1.3)) + 1.5 / 24.0)

    def without(self, muscles: list[Shape], blend_mm: float) -> Shape:
        """The cavity less muscles in it, with seams of that width."""
        # Values of the ridged cavity are that much smaller than distances, and so must be what blends them.
        return Intersection([self, *(complement(muscle) for muscle in muscles)], blend_mm / self.steepest)

    def distance(self, points: Float64) -> Float64:
        """Signed value in mm, shape (n, 3) -> (n,)."""
        adult = points / self.scale
        along, right, up = adult @ LONG_AXIS, adult @ SEPTUM_AXIS, adult @ UPWARD_AXIS
        wave = 2.0 * np.pi / self.spacing_mm
        bend = 0.9 * np.sin(wave * along / 4.0)
        # Narrow ridges, so that the wall around them is smooth outside.
        ridge = sum(0.5 * (0.5 + 0.5 * np.cos(phase)) ** 4 for phase in (wave * right + bend, wave * up - bend))
        rise = np.clip((along - 8.0) / 24.0, 0.0, 1.0)
        height = self.height_mm * self.scale * ridge * rise * rise * (3.0 - 2.0 * rise)
        value: Float64 = (self.shape.distance(points) + height) / self.steepest
        return value


def with_left_detail(cavity: Shape, scale: float, width: float) -> Shape:
    """The left ventricle's cavity without its two papillary muscles, and with trabeculae."""
    rough = Trabeculae(cavity, scale, 1.8, 6.5)
    muscles: list[Shape] = []
    for degrees in (130.0, 225.0):
        outward = np.cos(np.radians(degrees)) * SEPTUM_AXIS + np.sin(np.radians(degrees)) * UPWARD_AXIS
        points = [
            along * LONG_AXIS + part * width * outward for along, part in ((54.0, 0.86), (38.0, 0.72), (22.0, 0.52))
        ]
        muscles.append(Tube(scale * np.array(points), scale * np.array((6.0, 4.6, 2.6))))
    return rough.without(muscles, 3.0 * scale)


def with_right_detail(cavity: Shape, scale: float) -> Shape:
    """The right ventricle's cavity without moderator band and papillary muscle, and with trabeculae.

    Their tissue is the grown wall's: nothing here may be farther from the blood than that wall is thick, about 2 mm in
    the adult's positions.
    """
    rough = Trabeculae(cavity, scale, 1.0, 8.0)

    def at(along: float, right: float, up: float) -> Float64:
        point: Float64 = scale * (along * LONG_AXIS + right * SEPTUM_AXIS + up * UPWARD_AXIS)
        return point

    band = Capsule(at(34.0, 27.0, 4.0), at(44.0, 47.0, -4.0), 1.2 * scale)
    muscle = Capsule(at(44.0, 46.0, -4.0), at(24.0, 40.0, -8.0), 1.2 * scale)
    return rough.without([band, muscle], 2.0 * scale)


def baffle_shape(baffle: Baffle, vessels: Vessels, scale: float) -> Shape:
    """The sheet of a tunnel from a subpulmonary defect to the aortic valve; only what is in blood counts.

    Parameters
    ----------
    baffle
        Its measures, in mm.
    vessels
        Where the aortic valve is.
    scale
        Size against the adult's.
    """
    line = scale * np.array(BAFFLE_LINE)
    valve = next(outlet for outlet in vessels.outlets if outlet.is_aortic)
    inside = tunnel(baffle, vessels, scale)
    outside = tunnel(baffle, vessels, scale, wider_mm=baffle.thickness_mm)
    # Both ends of the sheet lie in tissue, or against the valve's ring.
    from_septum = HalfSpace(line[0], line[0] - line[1])
    to_valve = HalfSpace(valve.valve_mm + 1.0 * scale * _unit(valve.direction), valve.direction)
    leaks = []
    for diameter, part in zip(baffle.leaks_mm, (0.36, 0.62), strict=False):
        at = inside.nearest_mm(line[0]) + part * (inside.nearest_mm(line[-1]) - inside.nearest_mm(line[0]))
        centre, along, radius = inside.frame(at)
        outward = np.array((0.35, -1.0, -0.25))
        outward = _unit(outward - (outward @ along) * along)
        leaks.append(Capsule(centre, centre + (radius + 2.0 * baffle.thickness_mm) * outward, 0.5 * diameter))
    return Intersection([outside, complement(inside), from_septum, to_valve, *(complement(leak) for leak in leaks)])


def tunnel(baffle: Baffle, vessels: Vessels, scale: float, *, wider_mm: float = 0.0) -> Tube:
    """The tunnel that a baffle encloses, longer at both ends than its sheet, or one that is wider by so much."""
    line = scale * np.array(BAFFLE_LINE)
    valve = next(outlet for outlet in vessels.outlets if outlet.is_aortic)
    # At the valve the sheet is sewn to its ring.
    ring = float(valve.infundibulum.radius(valve.infundibulum.nearest_mm(valve.valve_mm))) + 0.5 * scale
    middle = np.linspace(0.0, 1.0, len(line))
    waist = np.minimum(1.0, 1.11 * np.sin(np.pi * middle) ** 2)
    plain = 0.5 * baffle.diameter_mm + (ring - 0.5 * baffle.diameter_mm) * middle
    radii = plain if baffle.waist_mm is None else plain * (1.0 - waist) + 0.5 * baffle.waist_mm * waist
    before = line[0] + 12.0 * scale * _unit(line[0] - line[1])
    beyond = valve.valve_mm + 14.0 * scale * _unit(valve.direction)
    return Tube(np.array([before, *line, beyond]), np.array([radii[0], *radii, radii[-1]]) + wider_mm)


def _unit(vector: Float64) -> Float64:
    unit: Float64 = vector / np.linalg.norm(vector)
    return unit
