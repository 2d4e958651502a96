"""The page about plans of incisions: for each case and defect the figures side by side, the order, and pictures."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from heartcase import __version__
from heartcase.pipeline.report.report_pictures import Picture

__all__ = ["ComparedCase", "ComparedDefect", "render_comparison"]


@dataclass(frozen=True)
class ComparedDefect:
    """What the plans of a case come to for one defect."""

    name: str
    """Name of the defect."""
    plans: Sequence[str]
    """Name of each plan with its place, the best first."""
    rows: Sequence[Sequence[str]]
    """A figure in each: what it is, and a cell for each plan."""
    scores: Sequence[str]
    """A sentence about each plan's score."""
    pictures: Sequence[Picture] = ()
    """Pictures of the plans, in the same order."""


@dataclass(frozen=True)
class ComparedCase:
    """What plans come to on a case."""

    name: str
    """Name of the case."""
    case_id: str | None
    """Made-up identifier of the case."""
    settings: str
    """Which law, how many nodes, of which size."""
    notice: str
    """What the case is not meant for."""
    defects: Sequence[ComparedDefect]
    """The defects that were looked at."""
    remarks: Sequence[str] = ()
    """What went wrong, and what was left out."""


def render_comparison(cases: Sequence[ComparedCase]) -> str:
    """Write the page: a whole HTML document that needs nothing beside it."""
    import jinja2

    environment = jinja2.Environment(
        loader=jinja2.PackageLoader("heartcase.pipeline.report", "templates"),
        autoescape=True,
        undefined=jinja2.StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    notices = list(dict.fromkeys(case.notice for case in cases))
    return environment.get_template("comparison.html.j2").render(cases=cases, notices=notices, version=__version__)
