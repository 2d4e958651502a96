"""Landmarks: named points, rings and lines of a heart, in mm."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field, model_validator

from heartcase.schemas.base import Model, Name, PointMm, PositiveMm, Vector3

__all__ = ["Landmark"]


class Landmark(Model):
    """A named place: a point (apex), a ring (valve, defect) or a polyline (coronary path, planned incision)."""

    name: Name
    """Unique name."""
    kind: Literal["point", "ring", "polyline"]
    """What the points mean."""
    points_mm: Annotated[tuple[PointMm, ...], Field(min_length=1)]
    """One point; the centre of a ring, or the points along it; the points of a polyline. LPS, mm."""
    axis: Vector3 | None = None
    """For a ring given by its centre: its axis."""
    radius_mm: PositiveMm | None = None
    """For a ring given by its centre: its radius; for a polyline that is a vessel: that vessel's."""
    depth_mm: PositiveMm | None = None
    """For a polyline that is a planned incision along the surface: how deep it goes."""

    @property
    def is_vessel(self) -> bool:
        """Whether it is a line with a radius, such as the course of a coronary artery."""
        return self.kind == "polyline" and self.radius_mm is not None

    @model_validator(mode="after")
    def _points_fit_kind(self) -> Landmark:
        count = len(self.points_mm)
        if self.kind == "point" and count != 1:
            raise ValueError(f"a point has exactly one point, not {count}")
        if self.kind == "polyline" and count < 2:
            raise ValueError("a polyline needs at least two points")
        if self.kind == "ring":
            if count == 1 and (self.axis is None or self.radius_mm is None):
                raise ValueError("a ring given by its centre needs an axis and a radius_mm")
            if count == 2:
                raise ValueError("a ring given by points along it needs at least three")
        if self.depth_mm is not None and self.kind != "polyline":
            raise ValueError("only a polyline, a planned incision, has a depth_mm")
        if self.axis is not None and not any(self.axis):
            raise ValueError("the axis must not be zero")
        return self
