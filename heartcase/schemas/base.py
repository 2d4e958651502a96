"""What all schema models share: strict, immutable, numbers finite."""

from __future__ import annotations

from typing import Annotated

from pydantic import BaseModel, ConfigDict, Field

__all__ = ["CaseId", "Colour", "Model", "Name", "PointMm", "PositiveMm", "Vector3"]


class Model(BaseModel):
    """Base of the schema models: unknown keys refused, instances immutable, no NaN or infinity."""

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False, use_attribute_docstrings=True)


Vector3 = tuple[float, float, float]
"""Three numbers, in the order x, y, z."""

PointMm = Annotated[Vector3, Field(description="Point in patient LPS space: x, y, z in mm.")]
"""A point (x, y, z) in patient LPS space, in mm."""

PositiveMm = Annotated[float, Field(gt=0.0, le=1000.0)]
"""A length in mm, above zero."""

Name = Annotated[str, Field(min_length=1, max_length=64, pattern=r"^[A-Za-z0-9][A-Za-z0-9 _.()+-]*$")]
"""A name of a label, a landmark or a case: letters, digits, space and ``_ . ( ) + -``."""

CaseId = Annotated[str, Field(pattern=r"^[A-Z0-9](-?[A-Z0-9]){2,31}$")]
"""A made-up identifier of a case: capital letters, digits and single hyphens. Nothing in it tells who was scanned."""

Colour = Annotated[str, Field(pattern=r"^#[0-9a-fA-F]{6}$", description="Colour as #rrggbb.")]
"""A colour as ``#rrggbb``."""
