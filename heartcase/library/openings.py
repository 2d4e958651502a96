"""Where blood passes between two cavities of a case, against the heart that its scan was made from."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from heartcase.phantom.anatomy.truth import Truth
from heartcase.pipeline.checks.openings import Verdict

__all__ = ["FalseOpening", "false_openings"]

REACH_MM = 5.0
"""How far from the middle of an opening in the case the truth may have it."""
STEP_MM = 0.4
"""Lattice on which the truth is looked at: an opening a third of a voxel wide is found."""


@dataclass(frozen=True)
class FalseOpening:
    """Two cavities that are open to each other where they should not be."""

    between: tuple[str, str]
    """Their labels."""
    area_mm2: float
    """Over which area."""
    center_mm: tuple[float, float, float]
    """Where, world mm."""
    is_true_nearby: bool
    """Whether the truth has an opening of the two here: then it is one that reaches too far."""

    def __str__(self) -> str:
        one, other = (name.removeprefix("morphologically ") for name in self.between)
        x, y, z = self.center_mm
        where = (
            f"{one} and {other} are open to each other over {self.area_mm2:.1f} mm² near ({x:.1f}, {y:.1f}, {z:.1f}) mm"
        )
        return f"{where}, beyond their true opening" if self.is_true_nearby else f"{where}, in truth not"


def false_openings(figures: Sequence[Mapping[str, Any]], truth: Truth) -> tuple[FalseOpening, ...]:
    """Find the openings of a case that the truth does not have, and those that the report takes for a fault.

    Parameters
    ----------
    figures
        The openings that the case's manifest tells: ``quality.openings``.
    truth
        The heart.
    """
    found = []
    for figure in figures:
        one, other = figure["between"]
        x, y, z = (float(value) for value in figure["center_mm"])
        is_true = _is_open(truth, one, other, (x, y, z))
        if figure["verdict"] == Verdict.UNEXPECTED or not is_true:
            found.append(FalseOpening((one, other), float(figure["area_mm2"]), (x, y, z), is_true))
    return tuple(found)


def _is_open(truth: Truth, one: str, other: str, center_mm: Sequence[float]) -> bool:
    """Whether two cavities touch in a cube around a point."""
    first, second = truth.table[one].value, truth.table[other].value
    axis = np.arange(-REACH_MM, REACH_MM + 0.5 * STEP_MM, STEP_MM)
    labels = truth.label(np.array(center_mm) + np.stack(np.meshgrid(axis, axis, axis, indexing="ij"), axis=-1))
    for across in range(3):
        pair = np.moveaxis(labels, across, 0)
        before, behind = pair[:-1], pair[1:]
        if ((before == first) & (behind == second)).any() or ((before == second) & (behind == first)).any():
            return True
    return False
