"""What scripts sew: stitches, rows of them and patches, in a simulation script."""

from __future__ import annotations

from typing import Annotated, Self

from pydantic import Field, model_validator

from heartcase.schemas.base import Model, Name, Outline, PatchScale, PointMm, PositiveMm, RowPlaces

__all__ = ["PatchAction", "RowAction", "StitchAction", "suture_problems"]

_Seconds = Annotated[float, Field(ge=0.0)]


class _ThreadAction(Model):
    """A thread that is placed, drawn, tied and taken out: what stitches and rows have in common."""

    at_rest: bool = False
    """Whether they are places of the tissue at rest; else they are places at that time."""
    stiffness_n_m: Annotated[float, Field(gt=0.0)] | None = None
    """Stiffness of the thread between two places, N/m; half of what the time step allows when left out."""
    time_s: _Seconds = 0.0
    """When it is placed, s."""
    tied_s: _Seconds
    """When it is tied, s. It is drawn evenly from ``time_s`` on, and fully by then."""
    length_mm: Annotated[float, Field(ge=0.0)] | None = None
    """Length that the thread is drawn to between two places, mm."""
    tension_n: Annotated[float, Field(ge=0.0)] | None = None
    """Tension that it is drawn with, N, instead of a length."""
    out_s: Annotated[float, Field(gt=0.0)] | None = None
    """When it is taken out, s; it stays when left out."""

    @model_validator(mode="after")
    def _check(self) -> Self:
        problems = thread_problems(self.length_mm, self.tension_n)
        problems += time_problems(self.time_s, self.tied_s, self.out_s)
        if problems:
            raise ValueError("; ".join(problems))
        return self


class StitchAction(_ThreadAction):
    """A stitch: a thread through the tissue at two places that is drawn and tied."""

    name: Name = "stitch"
    """Name in the summary."""
    places_mm: tuple[PointMm, PointMm]
    """Where it goes through the tissue; each is taken to the nearest place on the surface."""


class RowAction(_ThreadAction):
    """A row of stitches, filled in between chosen ones, drawn and tied."""

    name: Name = "row"
    """Name in the summary; its stitches are numbered behind it."""
    places_mm: RowPlaces
    """Both places of each chosen stitch in their order, the first all on one side; each is taken to the nearest place
    on the surface."""
    spacing_mm: PositiveMm = 3.0
    """Distance between neighbouring stitches, mm: the nearest that divides the way evenly."""
    running: bool = False
    """Whether one thread runs through all, with one tension; else each is tied by itself."""


class PatchAction(Model):
    """A patch: cut to a closed outline, its rim stitched on along it."""

    name: Name = "patch"
    """Name in the summary."""
    outline_mm: Outline
    """The outline as it is drawn, closed from the last point to the first; each stitch of the rim is taken to the
    nearest place on the surface."""
    at_rest: bool = False
    """Whether they are places of the tissue at rest; else they are places at that time."""
    spacing_mm: PositiveMm = 2.5
    """Distance between the stitches of its rim, and between its nodes, mm."""
    stiffness_n_m: Annotated[float, Field(gt=0.0, le=1e6)] = 100.0
    """Young's modulus times thickness, N/m."""
    thickness_mm: PositiveMm = 0.5
    """Thickness, mm: its mass."""
    scale: PatchScale = 1.0
    """Size over that of the outline laid out flat; below 1 it is cut smaller and stretched when it is sewn on."""
    time_s: _Seconds = 0.0
    """When it is sewn on, s."""
    out_s: Annotated[float, Field(gt=0.0)] | None = None
    """When it is taken out, s; it stays when left out."""

    @model_validator(mode="after")
    def _check(self) -> PatchAction:
        if self.out_s is not None and self.out_s <= self.time_s:
            raise ValueError("out_s must come after time_s")
        return self


def suture_problems(
    seconds: float,
    stitches: tuple[StitchAction, ...],
    rows: tuple[RowAction, ...],
    patches: tuple[PatchAction, ...],
) -> list[str]:
    """What is wrong with what a script of so many seconds sews, all of it together."""
    problems = []
    groups: dict[str, tuple[StitchAction | RowAction | PatchAction, ...]]
    groups = {"stitches": stitches, "rows": rows, "patches": patches}
    for what, actions in groups.items():
        late = [action.name for action in actions if action.time_s >= seconds]
        if late:
            problems.append(f"{what} come after the end: {', '.join(late)}")
    names = [*(stitch.name for stitch in stitches), *(row.name for row in rows)]
    if len(set(names)) < len(names) or len({patch.name for patch in patches}) < len(patches):
        problems.append("two stitches, rows or patches have one name: name each by itself")
    return problems


def thread_problems(length_mm: float | None, tension_n: float | None) -> list[str]:
    """What is wrong with what a thread is drawn to."""
    return ["give either length_mm or tension_n"] if (length_mm is None) == (tension_n is None) else []


def time_problems(time_s: float, tied_s: float, out_s: float | None) -> list[str]:
    """What is wrong with a thread's times."""
    problems = []
    if tied_s <= time_s:
        problems.append("tied_s must come after time_s")
    if out_s is not None and out_s <= tied_s:
        problems.append("out_s must come after tied_s")
    return problems
