"""The baffle as a hand would paint it: rings around the tunnel, in the middle of the sheet."""

from __future__ import annotations

import numpy as np

from heartcase.phantom.anatomy.heart import HeartPhantom
from heartcase.phantom.anatomy.inner import tunnel
from heartcase.phantom.anatomy.regions import CAVITY_COUNT
from heartcase.phantom.anatomy.sizes import proportions_of
from heartcase.phantom.anatomy.vessels import build_vessels
from heartcase.schemas.arrays import Bool, Float64
from heartcase.schemas.labels import Role

__all__ = ["baffle_rings"]

Points = tuple[tuple[float, float, float], ...]
_LEAST_POINTS = 3


def baffle_rings(
    phantom: HeartPhantom, *, apart_mm: float, clear_mm: float, deep_mm: float
) -> list[tuple[Points, bool]]:
    """Polylines in the middle of the baffle's sheet, LPS mm, where it lies in blood, and whether they lie deep in it.

    Parameters
    ----------
    phantom
        A heart with a baffle, not mirrored.
    apart_mm
        Distance from ring to ring, and of the points along one.
    clear_mm
        Least depth in the blood.
    deep_mm
        Depth in the blood from which on a brush cannot come near the outer wall, however the scan shows that.
    """
    baffle = phantom.form.baffle
    assert baffle is not None
    sizes = proportions_of(phantom.form)
    tube = tunnel(baffle, build_vessels(phantom.form, sizes), sizes.scale)
    device = next(label.value for label in phantom.table if label.role is Role.DEVICE)
    rings: list[tuple[Points, bool]] = []
    for at in np.arange(0.0, tube.length_mm, apart_mm):
        centre, direction, inner = tube.frame(float(at))
        radius = inner + 0.5 * baffle.thickness_mm
        across = np.cross(direction, np.eye(3)[np.argmin(np.abs(direction))])
        across /= np.linalg.norm(across)
        count = int(np.ceil(2.0 * np.pi * radius / apart_mm)) + 1
        turn = np.linspace(0.0, 2.0 * np.pi, count)[:, None]
        ring = centre + radius * (np.cos(turn) * across + np.sin(turn) * np.cross(direction, across))
        lumens = phantom.anatomy.tables.evaluate(ring)[:, :CAVITY_COUNT].min(axis=1)
        kept = (phantom.truth.label(ring) == device) & (lumens < -clear_mm)
        is_deep = kept & (lumens < -deep_mm)
        rings += [(_rounded(part), True) for part in _runs(ring, is_deep)]
        # Each begins and ends in what is deep, so that nothing is left open between the two.
        beside = _runs(ring, kept & ~(is_deep & np.roll(is_deep, 1) & np.roll(is_deep, -1)))
        rings += [(_rounded(part), False) for part in beside]
    return rings


def _runs(points: Float64, kept: Bool) -> list[Float64]:
    edges = np.flatnonzero(np.diff(np.concatenate([[False], kept, [False]])))
    return [points[a:b] for a, b in zip(edges[::2], edges[1::2], strict=True) if b - a >= _LEAST_POINTS]


def _rounded(points: Float64) -> Points:
    return tuple((round(float(x), 1), round(float(y), 1), round(float(z), 1)) for x, y, z in points)
