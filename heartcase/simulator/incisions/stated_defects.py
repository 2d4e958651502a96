"""Defects that the recipe states without a landmark: rings around the openings that the build found there."""

from __future__ import annotations

import re
from math import pi, sqrt
from typing import Any

import numpy as np

from heartcase.schemas.bundle.format import CaseManifest
from heartcase.schemas.landmarks import Landmark

__all__ = ["landmarks_with_defects"]

_SIDES = " - "
_NAME_LENGTH = 56
"""Letters at most; a number may follow."""


def landmarks_with_defects(manifest: CaseManifest) -> tuple[Landmark, ...]:
    """The case's landmarks, and a ring for each stated opening at which there is none.

    An opening that an edit, strokes or ``walls.contact`` state has a middle and an axis in the manifest's figures
    (``quality.openings``). Its ring is as wide as a circle of its area, and called by the two cavities. Cases of older
    builds have none.

    Parameters
    ----------
    manifest
        What the case says of itself.
    """
    landmarks = manifest.landmarks
    rings = [np.mean(one.points_mm, axis=0) for one in landmarks if one.kind == "ring"]
    names = {one.name.casefold() for one in landmarks}
    found = []
    openings = manifest.quality.get("openings")
    for one in openings if isinstance(openings, list) else ():
        ring = _ring(one)
        if ring is None or any(np.linalg.norm(ring[0] - other) < 2.0 * ring[2] for other in rings):
            continue
        middle, axis, radius = ring
        name, number = _called(one.get("between")), 1
        while (own := name if number == 1 else f"{name} {number}").casefold() in names:
            number += 1
        names.add(own.casefold())
        found.append(
            Landmark(
                name=own,
                kind="ring",
                points_mm=(tuple(middle.tolist()),),
                axis=tuple(axis.tolist()),
                radius_mm=radius,
            )
        )
    return (*landmarks, *found)


def _ring(opening: Any) -> tuple[Any, Any, float] | None:
    """Middle, axis and radius, mm; None where they are not known."""
    try:
        if opening["verdict"] != "stated":
            return None
        middle, axis = (np.array(opening[name], float) for name in ("middle_mm", "axis"))
        radius = sqrt(float(opening["area_mm2"]) / pi)
    except (KeyError, TypeError, ValueError):
        return None
    is_sound = middle.shape == axis.shape == (3,) and np.isfinite([*middle, *axis, radius]).all()
    return (middle, axis, radius) if is_sound and axis.any() and radius > 0.0 else None


def _called(between: Any) -> str:
    """Both cavities, as a name of a landmark may be."""
    names = [str(one).removeprefix("morphologically ") for one in between] if isinstance(between, list) else []
    words = re.sub(r"[^A-Za-z0-9 _.()+-]", "", _SIDES.join(names))
    return re.sub(r"^[^A-Za-z0-9]+", "", words)[:_NAME_LENGTH] or "defect"
