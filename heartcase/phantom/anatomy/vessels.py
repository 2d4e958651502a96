"""Where the great vessels run: their centrelines and radii, in the arrangements that hearts are born with.

Positions and radii are those of an adult (:mod:`heartcase.phantom.anatomy.build` says of which axes), times a scale.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from heartcase.phantom.anatomy.axes import SEPTUM_AXIS
from heartcase.phantom.anatomy.shapes import Narrowing, Tube
from heartcase.phantom.anatomy.sizes import Proportions
from heartcase.schemas.arrays import Float64
from heartcase.schemas.recipe.heart_form import HeartForm

__all__ = ["Outlet", "Vessels", "build_vessels"]

Points = list[tuple[float, float, float]]
TRIM_MM = 7.0
"""How much of a vessel's line is kept off its shape: its round end stays inside the tables."""


@dataclass(frozen=True)
class Outlet:
    """The way out of the right ventricle into an artery."""

    infundibulum: Tube
    """The muscular tube below the valve, and a stretch beyond it."""
    valve_mm: Float64
    """Centre of the valve."""
    direction: Float64
    """Direction of the blood through it."""
    is_aortic: bool
    """Whether it leads into the aorta; otherwise into the pulmonary trunk."""


@dataclass(frozen=True)
class Vessels:
    """The tubes of a heart."""

    arch: Tube
    """Aorta, from its valve to the descending part."""
    arch_branches: tuple[Tube, ...]
    """Brachiocephalic, left common carotid and left subclavian artery."""
    trunk: Tube
    """Pulmonary trunk."""
    right_branch: Tube
    """Right pulmonary artery."""
    left_branch: Tube
    """Left pulmonary artery."""
    superior_cava: Tube
    """Superior vena cava."""
    inferior_cava: Tube
    """Inferior vena cava."""
    veins: dict[str, Tube]
    """Pulmonary veins."""
    right_auricle: Tube
    """Appendage of the right atrium, which gives way to an artery in front of it."""
    outlets: tuple[Outlet, ...]
    """Ways out of the right ventricle."""
    left_root: Tube | None
    """The artery that leaves the left ventricle; None where there is none."""
    left_outflow_mm: Float64
    """Where the left ventricle's outflow meets that artery."""


def build_vessels(form: HeartForm, sizes: Proportions) -> Vessels:
    """Great vessels of a heart, not mirrored.

    Parameters
    ----------
    form
        How they are connected, and where they are narrow.
    sizes
        How large it is.
    """
    scale = sizes.scale

    def tube(
        points: Points, radii: Sequence[float], *, trim: float = 0.0, narrowings: Sequence[Narrowing] = ()
    ) -> Tube:
        return Tube(
            scale * np.array(points), scale * np.array(radii), trim_mm=scale * trim, narrowings=tuple(narrowings)
        )

    def artery(points: Points, radii: Sequence[float], **more: Any) -> Tube:
        return tube(points, [sizes.artery * radius for radius in radii], **more)

    def narrowing(at: tuple[float, float, float], ratio: float, length: float) -> list[Narrowing]:
        return [Narrowing(scale * np.array(at), ratio, scale * length)] if ratio < 1.0 else []

    arch_points, arch_radii = _arch(form)
    arch = artery(
        arch_points,
        arch_radii,
        trim=TRIM_MM,
        narrowings=narrowing((18.4, 50.0, 52.0), form.aortic_isthmus, 5.0),
    )
    trunk_points, trunk_radii = _trunk(form)
    outflow = form.pulmonary_outflow
    trunk = artery(
        trunk_points,
        [radius * (outflow + (1.0 - outflow) * 0.12 * n) for n, radius in enumerate(trunk_radii)],
        narrowings=narrowing(trunk_points[3], form.pulmonary_band, 4.0),
    )
    branch_width = 0.4 + 0.6 * outflow
    right_branch = artery(
        [
            (21.0, -2.0, 44.5),
            (10.0, 13.0, 44.5),
            (-8.0, 17.0, 43.5),
            (-26.0, 17.0, 42.0),
            (-45.0, 16.0, 40.0),
            (-60.0, 16.0, 38.0),
        ],
        [branch_width * radius for radius in (9.6, 9.0, 8.6, 8.3, 7.8, 7.5)],
        trim=TRIM_MM,
    )
    left_branch = artery(
        [(19.0, -4.0, 45.0), (27.0, 7.0, 47.0), (39.0, 18.0, 47.0), (51.0, 28.0, 43.0), (60.0, 35.0, 38.0)],
        [branch_width * radius for radius in (9.6, 9.0, 8.6, 8.0, 7.5)],
        trim=TRIM_MM,
        narrowings=narrowing((32.0, 12.0, 47.3), form.left_pulmonary_artery, 6.0),
    )
    return Vessels(
        arch=arch,
        arch_branches=(
            artery([(-8.0, 0.0, 62.0), (-13.0, -1.0, 78.0), (-18.0, -3.0, 98.0)], [6.0, 5.2, 5.0], trim=TRIM_MM),
            artery([(1.0, 12.0, 72.0), (2.0, 11.0, 84.0), (1.0, 8.0, 98.0)], [4.2, 3.6, 3.5], trim=TRIM_MM),
            artery([(8.0, 25.0, 73.0), (12.0, 25.0, 84.0), (17.0, 22.0, 98.0)], [4.8, 4.2, 4.0], trim=TRIM_MM),
        ),
        trunk=trunk,
        right_branch=right_branch,
        left_branch=left_branch,
        superior_cava=tube(
            [(-41.0, 0.0, 8.0), (-41.0, -2.0, 24.0), (-41.0, -4.5, 42.0), (-40.0, -6.0, 58.0), (-37.0, -7.0, 84.0)],
            [9.5, 9.0, 8.7, 8.5, 8.0],
            trim=TRIM_MM,
        ),
        inferior_cava=tube(
            [(-40.0, 6.0, -8.0), (-40.0, 8.0, -24.0), (-39.0, 9.0, -40.0), (-38.0, 10.0, -58.0)],
            [11.0, 10.2, 10.0, 10.0],
            trim=TRIM_MM,
        ),
        veins={name: tube(points, radii, trim=TRIM_MM) for name, (points, radii) in _veins(form).items()},
        right_auricle=tube(*_right_auricle(form)),
        outlets=tuple(_outlets(form, artery, scale)),
        left_root={"concordant": arch, "transposed": trunk}.get(form.great_arteries),
        left_outflow_mm=scale * (np.array((0.3, -10.3, 4.0)) + 0.6 * _override(form)),
    )


def _arch(form: HeartForm) -> tuple[Points, list[float]]:
    beyond: Points = [(8.0, 24.0, 73.0), (16.0, 42.0, 64.0), (19.0, 52.0, 44.0), (19.0, 54.0, 20.0), (18.0, 55.0, -4.0)]
    radii = [10.2, 12.6, 13.0, 12.2, 12.2, 11.6, 10.6, 9.8, 9.3, 9.0, 9.0]
    if form.great_arteries == "transposed":
        root: Points = [
            (5.0, -39.5, 2.0),
            (3.0, -37.0, 17.0),
            (1.0, -34.0, 30.0),
            (-2.0, -27.0, 44.0),
            (-4.0, -14.0, 58.0),
            (-1.0, 4.0, 69.0),
        ]
        return [*root, *beyond], [11.5, 12.0, *radii[2:]]
    if form.great_arteries == "double outlet right ventricle":
        root = [
            (-12.0, -36.0, 2.0),
            (-16.0, -32.0, 14.0),
            (-17.0, -27.0, 28.0),
            (-16.0, -18.0, 43.0),
            (-12.0, -6.0, 57.0),
            (-3.0, 7.0, 69.0),
        ]
        return [*root, *beyond], [11.0, 11.5, *radii[2:]]
    root = [
        (1.0, -10.5, 3.0),
        (-3.0, -11.5, 12.0),
        (-8.0, -12.0, 23.0),
        (-12.0, -11.0, 38.0),
        (-11.0, -6.0, 55.0),
        (-3.0, 6.0, 69.0),
    ]
    if form.aortic_override > 0.0:
        shift = _override(form)
        root = [
            tuple(float(v) for v in np.array(point) + part * shift)  # type: ignore[misc]
            for point, part in zip(root, (1.0, 0.8, 0.5, 0.2, 0.0, 0.0), strict=True)
        ]
    return [*root, *beyond], radii


def _override(form: HeartForm) -> Float64:
    """How far the aortic root is moved towards the right ventricle, in the adult."""
    shift: Float64 = form.aortic_override * 2.0 * 10.2 * SEPTUM_AXIS
    return shift


def _trunk(form: HeartForm) -> tuple[Points, list[float]]:
    if form.great_arteries == "transposed":
        return (
            [(1.0, -10.5, 3.0), (5.0, -10.5, 14.0), (10.0, -8.0, 26.0), (15.0, -3.5, 35.0), (20.0, 3.0, 44.5)],
            [10.2, 11.8, 11.8, 11.4, 10.0],
        )
    return (
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


def _outlets(form: HeartForm, tube: Callable[[Points, list[float]], Tube], scale: float) -> list[Outlet]:
    r = form.pulmonary_outflow
    to_lungs = Outlet(
        tube(
            [(6.0, -40.0, -14.0), (10.0, -38.5, 2.0), (14.0, -36.0, 17.0), (17.0, -34.0, 28.0)],
            [17.0, 14.5 * (0.15 + 0.85 * r), 12.2 * r, 11.9 * r],
        ),
        scale * np.array((14.3, -35.8, 18.0)),
        np.array((0.12, 0.12, 0.98)),
        is_aortic=False,
    )
    if form.great_arteries == "transposed":
        line: Points = [(4.0, -40.0, -14.0), (5.0, -39.5, 2.0), (3.0, -37.0, 17.0), (1.0, -34.0, 30.0)]
        return [
            Outlet(
                tube(line, [17.0, 14.5, 12.2, 11.9]),
                scale * np.array((2.8, -36.8, 18.0)),
                np.array((-0.14, 0.2, 0.97)),
                is_aortic=True,
            )
        ]
    if form.great_arteries == "double outlet right ventricle":
        to_body = Outlet(
            tube(
                [(-4.0, -38.0, -14.0), (-12.0, -36.0, 2.0), (-16.0, -32.0, 14.0), (-17.0, -27.0, 28.0)],
                [17.0, 14.0, 11.9, 11.7],
            ),
            scale * np.array((-16.0, -32.0, 14.0)),
            np.array((-0.16, 0.37, 0.91)),
            is_aortic=True,
        )
        return [to_lungs, to_body]
    return [to_lungs]


def _right_auricle(form: HeartForm) -> tuple[Points, list[float]]:
    if form.great_arteries == "double outlet right ventricle":
        line: Points = [(-40.0, -6.0, 8.0), (-46.0, -17.0, 15.0), (-48.0, -26.0, 18.0), (-46.0, -33.0, 18.0)]
        return line, [14.0, 11.0, 8.5, 6.0]
    line = [(-40.0, -6.0, 8.0), (-42.0, -20.0, 16.0), (-34.0, -32.0, 22.0), (-22.0, -37.0, 24.0)]
    return line, [14.0, 11.0, 9.0, 6.0]


def _veins(form: HeartForm) -> dict[str, tuple[Points, list[float]]]:
    right_superior: tuple[Points, list[float]] = (
        [(-12.0, 24.0, 14.0), (-30.0, 29.0, 22.0), (-53.0, 33.0, 27.0)],
        [8.0, 6.0, 5.5],
    )
    if any(defect.kind == "sinus venosus" for defect in form.defects):
        # Right behind the superior vena cava: one wall lies between them.
        right_superior = (
            [(-12.0, 24.0, 14.0), (-27.0, 21.0, 21.0), (-41.0, 16.0, 27.0), (-57.0, 22.0, 30.0)],
            [8.0, 7.5, 7.0, 5.5],
        )
    return {
        "right superior": right_superior,
        "right inferior": ([(-12.0, 28.0, 2.0), (-30.0, 37.0, -1.0), (-51.0, 43.0, -6.0)], [8.0, 6.0, 5.5]),
        "left superior": ([(8.0, 25.0, 17.0), (25.0, 31.0, 23.0), (47.0, 36.0, 26.0)], [8.0, 6.0, 5.5]),
        "left inferior": ([(6.0, 27.0, 4.0), (23.0, 35.0, 0.0), (44.0, 39.0, -6.0)], [8.0, 6.0, 5.5]),
    }
