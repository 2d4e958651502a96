"""What scripts sew: stitches, in a simulation script."""

from __future__ import annotations

from typing import Annotated

from pydantic import Field, model_validator

from heartcase.schemas.base import Model, Name, PointMm

__all__ = ["StitchAction"]

_Seconds = Annotated[float, Field(ge=0.0)]


class StitchAction(Model):
    """A stitch: a thread through the tissue at two places that is drawn and tied."""

    name: Name = "stitch"
    """Name in the summary."""
    places_mm: tuple[PointMm, PointMm]
    """Where it goes through the tissue; each is taken to the nearest place on the surface."""
    at_rest: bool = False
    """Whether they are places of the tissue at rest; else they are places at that time."""
    stiffness_n_m: Annotated[float, Field(gt=0.0)] | None = None
    """Stiffness of the thread, N/m; half of what the time step allows when left out."""
    time_s: _Seconds = 0.0
    """When it is placed, s."""
    tied_s: _Seconds
    """When it is tied, s. It is drawn evenly from ``time_s`` on, and fully by then."""
    length_mm: Annotated[float, Field(ge=0.0)] | None = None
    """Length that the thread is drawn to, mm."""
    tension_n: Annotated[float, Field(ge=0.0)] | None = None
    """Tension that it is drawn with, N, instead of a length."""
    out_s: Annotated[float, Field(gt=0.0)] | None = None
    """When it is taken out, s; it stays when left out."""

    @model_validator(mode="after")
    def _check(self) -> StitchAction:
        problems = thread_problems(self.length_mm, self.tension_n)
        problems += time_problems(self.time_s, self.tied_s, self.out_s)
        if problems:
            raise ValueError("; ".join(problems))
        return self


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
