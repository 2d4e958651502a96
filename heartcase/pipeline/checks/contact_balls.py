"""Balls of ``walls.contact`` that are open, less what the recipe says is wall."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from heartcase.schemas.labels import LabelTable
from heartcase.schemas.recipe.settings import ContactPlace

__all__ = ["OpenBall", "open_balls"]


class OpenBall(NamedTuple):
    """A ball in which two cavities are open to each other."""

    number: int
    """Number of the entry, from 1."""
    center_mm: tuple[float, float, float]
    """Its middle, world mm."""
    radius_mm: float
    """Its radius."""
    values: tuple[int, int]
    """Label values of the two, the lower first."""


def open_balls(places: Sequence[ContactPlace], table: LabelTable) -> tuple[OpenBall, ...]:
    """The open entries as balls: each the largest ball within its own that keeps out of the same pair's wall entries.

    An entry that lies within walls altogether has none.
    """
    walls = [(_values(table, one.between), one) for one in places if not one.is_open]
    found = []
    for number, one in enumerate(places, start=1):
        if not one.is_open:
            continue
        values = _values(table, one.between)
        center, radius = np.array(one.position_mm, np.float64), float(one.radius_mm)
        for pair, wall in walls:
            if pair != values or radius <= 0.0:
                continue
            away = center - np.array(wall.position_mm, np.float64)
            distance = float(np.linalg.norm(away))
            # from the wall's near side to the ball's far side
            free = distance - wall.radius_mm
            if free >= radius:
                continue
            axis = away / distance if distance > 0.0 else np.array([1.0, 0.0, 0.0])
            center = center + 0.5 * (radius - free) * axis
            radius = 0.5 * (radius + free)
        if radius > 0.0:
            x, y, z = (float(value) for value in center)
            found.append(OpenBall(number, (x, y, z), radius, values))
    return tuple(found)


def _values(table: LabelTable, names: tuple[str, str]) -> tuple[int, int]:
    low, high = sorted(table[name].value for name in names)
    return low, high
