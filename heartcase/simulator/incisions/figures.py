"""The figures of an incision, as a table and as JSON, and plans in the order of their worth."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import asdict, dataclass, field, replace
from math import isfinite

from heartcase.schemas.errors import Problem, SimulationError
from heartcase.simulator.incisions.stitch_limits import StitchFigures

__all__ = [
    "CRITERIA",
    "INVERTED_CELLS_MOST",
    "Criterion",
    "IncisionFigures",
    "RankedPlan",
    "ranked",
    "table",
    "table_rows",
    "to_json",
]


@dataclass(frozen=True)
class IncisionFigures:
    """What one incision is worth. A figure that was not worked out is None."""

    name: str
    """Name of the plan."""
    rim_seen: float | None = None
    """Part of the defect's rim that is seen from some eye of the cone [1]."""
    rim_seen_closed: float | None = None
    """The same before the heart was cut [1]."""
    rim_seen_cut: float | None = None
    """The same when it was cut and nothing holds it open yet [1]."""
    rim_seen_best: float | None = None
    """The same as it is held open, from the best eye alone [1]."""
    solid_angle_sr: float | None = None
    """Solid angle of what is seen of the defect from the best eye, sr."""
    freedom_mm3: float | None = None
    """Volume of surgical freedom with the tip on the defect, mm3."""
    reach_mm3: float | None = None
    """Volume of all places that the tip comes to through the opening, mm3."""
    gap_mm: float | None = None
    """Largest distance between the lips as they are held, mm."""
    retraction_n: float | None = None
    """Largest force with which the opening is held, N."""
    stretch: float | None = None
    """Largest stretch of the tissue [1]."""
    stretch_high: float | None = None
    """Stretch that 99% of the tissue, by volume, stay below [1]."""
    stretch_place_mm: tuple[float, float, float] | None = None
    """Where, LPS mm."""
    stress_kpa: float | None = None
    """Largest principal stress, kPa."""
    stress_high_kpa: float | None = None
    """Principal stress that 99% of the tissue stay below, kPa."""
    stress_place_mm: tuple[float, float, float] | None = None
    """Where, LPS mm."""
    inverted_cell_count: int = 0
    """Cells that are inside out: with some, the largest stretch and stress mean nothing."""
    nearest_mm: dict[str, float] = field(default_factory=dict)
    """Shortest distance at rest of what was cut to each coronary artery, mm, below 0 inside it: name -> distance."""
    cut_mm2: float | None = None
    """Area at rest of all that was cut, one side of it, mm2."""
    cut_structures_mm2: dict[str, float] = field(default_factory=dict)
    """The same by what tissue it went through, the most first, where that is known: name -> area."""
    length_mm: float | None = None
    """Length of the incision, mm."""
    stitches: tuple[StitchFigures, ...] = ()
    """Force of each stitch, beside a measured one."""

    @property
    def nearest_vessel_mm(self) -> float | None:
        """The shortest of the distances, mm."""
        return min(self.nearest_mm.values(), default=None)

    @property
    def worst_stitch(self) -> float | None:
        """Largest force of a stitch over the measured mean [1]."""
        return max((one.part_of_mean for one in self.stitches), default=None)


@dataclass(frozen=True)
class Criterion:
    """One thing that plans are compared by."""

    figure: str
    """Name of the figure in :class:`IncisionFigures`."""
    weight: float
    """How much it counts, not below 0."""
    more_is_better: bool
    """Whether a larger figure is the better one."""


INVERTED_CELLS_MOST = 2
"""Cells that a plan may leave inside out without being put last: so few, beside a hand, do not reach what 99% of the
tissue stay below."""
CRITERIA: tuple[Criterion, ...] = (
    Criterion("rim_seen_best", 3.0, True),
    Criterion("rim_seen", 1.0, True),
    Criterion("solid_angle_sr", 1.0, True),
    Criterion("freedom_mm3", 2.0, True),
    Criterion("retraction_n", 1.0, False),
    Criterion("stretch_high", 1.0, False),
    Criterion("nearest_vessel_mm", 2.0, True),
    Criterion("length_mm", 1.0, False),
)
"""What plans are compared by where nothing else is said: a convention of this program, not a clinical one."""


@dataclass(frozen=True)
class RankedPlan:
    """A plan in its place."""

    place: int
    """1 is the best; plans with the same score share a place."""
    figures: IncisionFigures
    """The plan."""
    score: float
    """Weighted mean of the shares, 0 to 1."""
    shares: dict[str, float]
    """What each criterion gives: 0 to the worst of the plans, 1 to the best, in between in proportion."""
    is_too_near: bool
    """Whether it comes nearer to a vessel than is allowed: such plans come last."""
    is_inverted: bool
    """Whether it leaves more cells inside out than are allowed: such plans come last, too."""


def ranked(
    plans: Sequence[IncisionFigures],
    criteria: Sequence[Criterion] = CRITERIA,
    *,
    nearest_least_mm: float = 2.0,
    inverted_cells_most: int = INVERTED_CELLS_MOST,
) -> tuple[RankedPlan, ...]:
    """Plans for one heart, the best first.

    A criterion counts where all plans have its figure, and where they differ in it. Plans that come too near to a
    vessel, or leave many cells inside out, are put behind all others, whatever their score.

    Parameters
    ----------
    plans
        Figures of each, with names that differ.
    criteria
        What counts, and how much.
    nearest_least_mm
        Nearest that a plan may come to a vessel, mm.
    inverted_cells_most
        Most cells that a plan may leave inside out.

    Raises
    ------
    SimulationError
        Names are the same, a figure is not finite, a criterion names no figure, or a weight is below 0.
    """
    _check(plans, criteria)
    shares: dict[str, list[float]] = {}
    weights: dict[str, float] = {}
    for criterion in criteria:
        found = [getattr(plan, criterion.figure) for plan in plans]
        if any(value is None for value in found):
            continue
        low, high = min(found, default=0.0), max(found, default=0.0)
        if criterion.weight > 0.0 and high > low:
            parts = [(value - low) / (high - low) for value in found]
            shares[criterion.figure] = parts if criterion.more_is_better else [1.0 - part for part in parts]
            weights[criterion.figure] = criterion.weight
    total = sum(weights.values())
    entries = []
    for number, plan in enumerate(plans):
        own = {name: values[number] for name, values in shares.items()}
        score = sum(weights[name] * share for name, share in own.items()) / total if total > 0.0 else 0.0
        nearest = plan.nearest_vessel_mm
        is_too_near = nearest is not None and nearest < nearest_least_mm
        is_inverted = plan.inverted_cell_count > inverted_cells_most
        entries.append((is_too_near or is_inverted, -score, RankedPlan(0, plan, score, own, is_too_near, is_inverted)))
    entries.sort(key=lambda entry: (*entry[:2], entry[2].figures.name))
    order = [entry[:2] for entry in entries]
    return tuple(replace(one, place=order.index((is_last, minus)) + 1) for is_last, minus, one in entries)


def table(plans: Sequence[IncisionFigures]) -> str:
    """The figures of plans side by side, a plan in each column, as text."""
    rows = [("", *(plan.name for plan in plans)), *table_rows(plans)]
    widths = [max(len(row[column]) for row in rows) for column in range(len(rows[0]))]
    lines = [
        "  ".join(
            cell.ljust(width) if column == 0 else cell.rjust(width)
            for column, (cell, width) in enumerate(zip(row, widths, strict=True))
        ).rstrip()
        for row in rows
    ]
    return "\n".join(lines) + "\n"


def table_rows(plans: Sequence[IncisionFigures]) -> list[tuple[str, ...]]:
    """A row for each figure that some plan has: what it is, and a cell for each plan."""
    rows = []
    for label, figure, form in _ROWS:
        cells = [getattr(plan, figure) for plan in plans]
        if any(cell is not None for cell in cells):
            rows.append((label, *("-" if cell is None else format(cell, form) for cell in cells)))
    for name in sorted({name for plan in plans for name in plan.nearest_mm}):
        distances = [plan.nearest_mm.get(name) for plan in plans]
        rows.append((f"to {name} [mm]", *("-" if one is None else f"{one:.1f}" for one in distances)))
    for name in dict.fromkeys(name for plan in plans for name in plan.cut_structures_mm2):
        areas = [plan.cut_structures_mm2.get(name) for plan in plans]
        rows.append((f"cut of {name} [mm2]", *("-" if one is None else f"{one:,.0f}" for one in areas)))
    if any(plan.inverted_cell_count for plan in plans):
        rows.append(("cells inside out", *(f"{plan.inverted_cell_count:,}" for plan in plans)))
    return rows


def to_json(plans: Sequence[RankedPlan]) -> str:
    """Ranked plans as JSON text, the best first: figures, score, shares."""
    return json.dumps([asdict(plan) for plan in plans], indent=2, sort_keys=True, allow_nan=False) + "\n"


_ROWS = (
    ("rim seen, closed [%]", "rim_seen_closed", ".0%"),
    ("rim seen, cut, not held [%]", "rim_seen_cut", ".0%"),
    ("rim seen [%]", "rim_seen", ".0%"),
    ("rim seen from the best eye [%]", "rim_seen_best", ".0%"),
    ("solid angle [sr]", "solid_angle_sr", ".2g"),
    ("freedom at the defect [mm3]", "freedom_mm3", ",.0f"),
    ("reach of the tip [mm3]", "reach_mm3", ",.0f"),
    ("length [mm]", "length_mm", ".1f"),
    ("area of all cuts [mm2]", "cut_mm2", ",.0f"),
    ("gap between the lips [mm]", "gap_mm", ".1f"),
    ("retraction force [N]", "retraction_n", ".2f"),
    ("largest stretch [1]", "stretch", ".2f"),
    ("stretch of 99% below [1]", "stretch_high", ".2f"),
    ("largest stress [kPa]", "stress_kpa", ".1f"),
    ("stress of 99% below [kPa]", "stress_high_kpa", ".1f"),
    ("worst stitch over measured [1]", "worst_stitch", ".2f"),
)


def _check(plans: Sequence[IncisionFigures], criteria: Sequence[Criterion]) -> None:
    problems = []
    names = [plan.name for plan in plans]
    for name in sorted({name for name in names if names.count(name) > 1}):
        problems.append(Problem("plans", f"{name} is there more than once: name each plan differently"))
    for plan in plans:
        for figure in _NUMBERS:
            value = getattr(plan, figure)
            if value is not None and not isfinite(value):
                problems.append(Problem(plan.name, f"{figure} is not finite: leave out what was not worked out"))
    for criterion in criteria:
        if criterion.figure not in _NUMBERS:
            problems.append(Problem("criteria", f"{criterion.figure} is no figure: choose from {', '.join(_NUMBERS)}"))
        if not 0.0 <= criterion.weight < float("inf"):
            problems.append(Problem("criteria", f"the weight of {criterion.figure} must be 0 or more"))
    if problems:
        raise SimulationError(problems)


_NUMBERS = (*(figure for _, figure, _ in _ROWS), "nearest_vessel_mm")
