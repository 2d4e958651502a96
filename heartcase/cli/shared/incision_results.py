"""What plans of incisions came to on a case: as text, as JSON, as rows of a table, as a page."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass, field, replace
from typing import Any

from heartcase.schemas.arrays import UInt8
from heartcase.schemas.errors import MissingExtraError, Problem
from heartcase.simulator.incisions.figures import RankedPlan, table, table_rows
from heartcase.simulator.load import Case
from heartcase.simulator.session.planned_incisions import HeldOpen, PlansOnCase, ranked_by_defect

__all__ = ["CaseResult", "markdown", "page"]


@dataclass
class CaseResult:
    """What the plans came to on a case."""

    case: Case
    """The case."""
    on: PlansOnCase
    """Its plans."""
    law: str
    """Law of force."""
    poissons_ratio: float
    """Poisson's ratio where the law takes one."""
    held: list[HeldOpen] = field(default_factory=list)
    """Plans that were run to their end."""
    problems: list[Problem] = field(default_factory=list)
    """Why others were not."""
    pictures: dict[tuple[str, str], UInt8] = field(default_factory=dict)
    """Name of a plan and of a defect -> its picture, where pictures are wanted."""

    @property
    def ranked(self) -> dict[str, tuple[RankedPlan, ...]]:
        """Plans for each defect, the best first."""
        plans = self.on.plans
        return ranked_by_defect(
            tuple(self.held),
            nearest_least_mm=plans.nearest_least_mm,
            inverted_cells_most=plans.inverted_cells_most,
        )

    @property
    def remarks(self) -> list[str]:
        """What went wrong, and what was left out; a sentence each."""
        words = [f"Not run to its end: {problem}" for problem in self.problems]
        for one in self.held:
            if one.inverted_cell_count:
                cells = "1 cell is" if one.inverted_cell_count == 1 else f"{one.inverted_cell_count:,} cells are"
                words.append(
                    f"{cells} inside out at the end of {one.plan.name}: its largest stretch and stress mean nothing."
                )
            words += [
                f"{one.plan.name}: on the surface {part:.0%} of the rim of {defect} was found."
                for defect, part in one.rim_found.items()
                if part < 1.0
            ]
        if self.on.left_out:
            words.append(f"Left out, for want of landmarks: {', '.join(self.on.left_out)}.")
        return words

    def facts(self) -> dict[str, Any]:
        """What --json has."""
        by_name = {one.plan.name: one for one in self.held}
        defects = {}
        for defect, plans in self.ranked.items():
            defects[defect] = [
                asdict(plan)
                | {
                    "looks_from": by_name[plan.figures.name].looks_from[defect],
                    "rim_found": by_name[plan.figures.name].rim_found[defect],
                }
                for plan in plans
            ]
        manifest = self.case.manifest
        return {
            "case": manifest.name,
            "case_id": manifest.case_id,
            "law": self.law,
            "poissons_ratio": self.poissons_ratio,
            "node_count": self.case.model.node_count,
            "cell_mm": self.case.model.cell_mm,
            "left_out": self.on.left_out,
            "failed": [str(problem) for problem in self.problems],
            "hand_force_n": {one.plan.name: one.hand_force_n for one in self.held},
            "inverted_cell_count": {one.plan.name: one.inverted_cell_count for one in self.held},
            "defects": defects,
        }

    def words(self) -> str:
        """A table for each defect."""
        manifest = self.case.manifest
        lines = [f"{manifest.name}" + (f" ({manifest.case_id})" if manifest.case_id else "")]
        for defect, plans in self.ranked.items():
            titled = [replace(one.figures, name=_placed(one)) for one in plans]
            lines += ["", f"{defect}, the best plan first", "", table(titled).rstrip()]
            lines += [_score(one) for one in plans]
        lines += ["", *self.remarks, manifest.notice, ""]
        return "\n".join(lines)


def page(results: Sequence[CaseResult]) -> str:
    """A whole HTML document about all cases.

    Raises
    ------
    MissingExtraError
        What makes pages is not installed.
    """
    try:
        from heartcase.pipeline.report.comparison_page import ComparedCase, ComparedDefect, render_comparison
        from heartcase.pipeline.report.report_pictures import embedded_picture
    except ImportError:
        raise MissingExtraError("A page", "prepare") from None
    cases = []
    for result in results:
        defects = []
        for defect, plans in result.ranked.items():
            pictures = []
            for one in plans:
                pixels = result.pictures.get((one.figures.name, defect))
                if pixels is not None:
                    alt = (
                        f"{one.figures.name}, held open: the heart, the opening with the rim of {defect} in green, "
                        "and the same coloured by stretch and by stress."
                    )
                    pictures.append(embedded_picture(_placed(one), alt, pixels, lossy=True))
            rows = table_rows([one.figures for one in plans])
            defects.append(
                ComparedDefect(defect, [_placed(one) for one in plans], rows, [_score(one) for one in plans], pictures)
            )
        manifest, model = result.case.manifest, result.case.model
        settings = (
            f"Law of force: {result.law}. {model.node_count:,} nodes, cells of {model.cell_mm:.3g} mm. "
            f"Tissue at rest without stress; forces in N."
        )
        cases.append(ComparedCase(manifest.name, manifest.case_id, settings, manifest.notice, defects, result.remarks))
    return render_comparison(cases)


_COLUMNS = (
    "case", "defect", "way", "place", "rim seen, closed", "rim seen", "best eye", "solid angle [msr]",
    "freedom [mm³]", "reach [mm³]", "gap [mm]", "force [N]", "stretch", "stress [kPa]", "nearest artery [mm]",
    "cut [mm²]", "cells inside out",
)  # fmt: skip


def markdown(results: Sequence[CaseResult]) -> str:
    """A row for each case, defect and plan, in Markdown. Stretch and stress are what 99% of the tissue stay below."""
    rows = [_COLUMNS, tuple("---" for _ in _COLUMNS)]
    for result in results:
        for defect, plans in result.ranked.items():
            for plan in plans:
                one = plan.figures
                rows.append(
                    (
                        result.case.manifest.name,
                        defect,
                        one.name,
                        str(plan.place),
                        _cell(one.rim_seen_closed, ".0%"),
                        _cell(one.rim_seen, ".0%"),
                        _cell(one.rim_seen_best, ".0%"),
                        _cell(None if one.solid_angle_sr is None else 1e3 * one.solid_angle_sr, ".2f"),
                        _cell(one.freedom_mm3, ",.0f"),
                        _cell(one.reach_mm3, ",.0f"),
                        _cell(one.gap_mm, ".1f"),
                        _cell(one.retraction_n, ".2f"),
                        _cell(one.stretch_high, ".2f"),
                        _cell(one.stress_high_kpa, ".1f"),
                        _cell(one.nearest_vessel_mm, ".1f"),
                        _cell(one.cut_mm2, ",.0f"),
                        f"{one.inverted_cell_count:,}",
                    )
                )
    return "".join(f"| {' | '.join(row)} |\n" for row in rows)


def _placed(one: RankedPlan) -> str:
    return f"{one.place}. {one.figures.name}"


def _score(one: RankedPlan) -> str:
    near = "; comes too near to a vessel" if one.is_too_near else ""
    inverted = "; leaves too many cells inside out" if one.is_inverted else ""
    return f"{_placed(one)}: score {one.score:.2f}{near}{inverted}"


def _cell(value: float | None, form: str) -> str:
    return "" if value is None else format(value, form)
