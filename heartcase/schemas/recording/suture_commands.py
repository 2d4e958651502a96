"""Commands for stitches, rows of stitches, patches, and pieces that are taken out."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field, model_validator

from heartcase.schemas.base import Name, Outline, PatchScale, PointMm, PositiveMm, RowPlaces
from heartcase.schemas.recording.command_model import CommandModel

__all__ = [
    "ROW_MAX",
    "BoundPlace",
    "DrawStitch",
    "Excise",
    "PlacePatch",
    "PlaceRow",
    "PlaceStitch",
    "TakeOutPatch",
    "TakeOutStitch",
    "TieStitch",
]

ROW_MAX = 1000
"""Most stitches of a row, and of a patch's rim."""

_Whole = Annotated[int, Field(ge=0)]
_Part = Annotated[float, Field(ge=0.0, le=1.0)]


class BoundPlace(CommandModel):
    """A place in tissue, as it was found: what a recording states."""

    cell: _Whole
    """Cell of the uncut lattice."""
    sample: _Whole
    """Sample of the cell's tissue, of whose piece it is."""
    local: tuple[_Part, _Part, _Part]
    """Where in the cell, from its lowest corner [edges]."""


class PlaceStitch(CommandModel):
    """Put a thread through the tissue at two places; it pulls at nothing until it is drawn."""

    kind: Literal["place_stitch"] = "place_stitch"
    """Which command."""
    name: Name
    """Name of the stitch; no other may have it."""
    places_mm: tuple[PointMm, PointMm]
    """Where; each is taken to the nearest place on the surface."""
    at_rest: bool = False
    """Whether they are places of the tissue at rest; else they are places now."""
    stiffness_n_m: Annotated[float, Field(gt=0.0)] | None = None
    """Stiffness of the thread, N/m; half of what the time step allows when left out."""
    bound: tuple[BoundPlace, BoundPlace] | None = None
    """The places that were found. What is recorded states them."""


class Excise(CommandModel):
    """Take out a piece of tissue that was cut free of all else."""

    kind: Literal["excise"] = "excise"
    """Which command."""
    name: Name = "excision"
    """Name in messages."""
    place_mm: PointMm
    """A point on it; it is taken to the nearest place on the surface."""
    at_rest: bool = False
    """Whether that is a place of the tissue at rest; else it is one now."""
    bound: BoundPlace | None = None
    """The place that was found. What is recorded states it."""


class PlaceRow(CommandModel):
    """Fill in a row of stitches between chosen ones; they pull at nothing until they are drawn, by the row's name."""

    kind: Literal["place_row"] = "place_row"
    """Which command."""
    name: Name
    """Name of the row; its stitches are numbered behind it. No other row or stitch may have it."""
    places_mm: RowPlaces | None = None
    """Both places of each chosen stitch in their order, the first all on one side; each is taken to the nearest place
    on the surface."""
    between: Annotated[tuple[Name, ...], Field(min_length=2, max_length=ROW_MAX)] | None = None
    """Names of stitches that are there, instead of ``places_mm``."""
    spacing_mm: PositiveMm = 3.0
    """Distance between neighbouring stitches, mm: the nearest that divides the way evenly."""
    running: bool = False
    """Whether one thread runs through all, with one tension; else each is tied by itself."""
    at_rest: bool = False
    """Whether they are places of the tissue at rest; else they are places now."""
    stiffness_n_m: Annotated[float, Field(gt=0.0)] | None = None
    """Stiffness of the thread between two places, N/m; half of what the time step allows when left out."""
    bound: Annotated[tuple[tuple[BoundPlace, BoundPlace], ...], Field(min_length=1, max_length=ROW_MAX)] | None = None
    """Places of all its stitches that were found. What is recorded states them."""

    @model_validator(mode="after")
    def _is_one(self) -> PlaceRow:
        if (self.places_mm is None) == (self.between is None):
            raise ValueError("give either places_mm or between")
        return self


class DrawStitch(CommandModel):
    """Draw the thread of a stitch, or all of a row; it comes to that with the end of the next steps."""

    kind: Literal["draw_stitch"] = "draw_stitch"
    """Which command."""
    name: Name
    """The stitch or the row."""
    length_mm: Annotated[float, Field(ge=0.0)] | None = None
    """Length of the thread between its places, mm."""
    tension_n: Annotated[float, Field(ge=0.0)] | None = None
    """Tension that it is drawn with until it is tied, N."""

    @model_validator(mode="after")
    def _is_one(self) -> DrawStitch:
        if (self.length_mm is None) == (self.tension_n is None):
            raise ValueError("give either length_mm or tension_n")
        return self


class TieStitch(CommandModel):
    """Tie a knot, or all of a row: the thread keeps the length that it has now."""

    kind: Literal["tie_stitch"] = "tie_stitch"
    """Which command."""
    name: Name
    """The stitch or the row."""


class TakeOutStitch(CommandModel):
    """Take a stitch out, or all of a row."""

    kind: Literal["take_out_stitch"] = "take_out_stitch"
    """Which command."""
    name: Name
    """The stitch or the row."""


class PlacePatch(CommandModel):
    """Cut a patch to a closed outline and stitch its rim on along it; nothing moves in this moment."""

    kind: Literal["place_patch"] = "place_patch"
    """Which command."""
    name: Name
    """Name of the patch; no other may have it."""
    outline_mm: Outline
    """The outline as it was drawn, closed from the last point to the first; each stitch of the rim is taken to the
    nearest place on the surface."""
    at_rest: bool = False
    """Whether they are places of the tissue at rest; else they are places now."""
    spacing_mm: PositiveMm = 2.5
    """Distance between the stitches of its rim, and between its nodes, mm."""
    stiffness_n_m: Annotated[float, Field(gt=0.0, le=1e6)] = 100.0
    """Young's modulus times thickness, N/m."""
    thickness_mm: PositiveMm = 0.5
    """Thickness, mm: its mass."""
    scale: PatchScale = 1.0
    """Size over that of the outline laid out flat; below 1 it is cut smaller and stretched when it is sewn on."""
    bound: Annotated[tuple[BoundPlace, ...], Field(min_length=3, max_length=ROW_MAX)] | None = None
    """Places of the rim's stitches that were found. What is recorded states them."""
    rim_mm: Outline | None = None
    """Where these were at that moment: what the patch is cut to. What is recorded states it."""


class TakeOutPatch(CommandModel):
    """Take a patch out, with the stitches of its rim."""

    kind: Literal["take_out_patch"] = "take_out_patch"
    """Which command."""
    name: Name
    """The patch."""
    nodes: tuple[_Whole, _Whole] | None = None
    """First and number of its nodes among those of all patches. What is recorded states them."""
