"""A scan that is made and not taken: which heart, and what the scanner does to it."""

from __future__ import annotations

from typing import Annotated, Literal, Self

from pydantic import Field, model_validator

from heartcase.schemas.base import Model
from heartcase.schemas.errors import ModelProblems, Problem
from heartcase.schemas.recipe.heart_form import HeartDefect, HeartForm, IncisionName

__all__ = ["PhantomScan"]

_Spacing = Annotated[float, Field(ge=0.2, le=20.0)]


class PhantomScan(Model):
    """A synthetic scan of a synthetic heart."""

    heart: HeartForm = HeartForm()
    """The heart."""
    modality: Literal["CT", "MR"] = "MR"
    """Computed tomography with contrast medium in all chambers, or steady-state free precession magnetic resonance."""
    is_specimen: bool = False
    """CT of the heart alone, plastinated and filled with air, instead of one in a chest."""
    spacing_mm: tuple[_Spacing, _Spacing, _Spacing] = (1.75, 1.75, 1.75)
    """Voxel size along i, j, k."""
    slice_thickness_mm: _Spacing | None = None
    """Thickness of a slice, where there are gaps between them; k's voxel size when left out."""
    is_oblique: bool = False
    """Slices in the heart's short-axis plane."""
    margin_mm: Annotated[float, Field(ge=0.0, le=100.0)] = 12.0
    """Least distance of the heart from the scan's border."""
    contrast_to_noise: Annotated[float, Field(gt=0.0, le=1000.0)] | None = None
    """(blood - myocardium) / standard deviation of the noise; 14.5 (MR) or 8 (CT) when left out."""
    bias: Annotated[float, Field(ge=0.0, lt=1.0)] = 0.08
    """MR: largest relative deviation of the receiver's sensitivity."""
    motion_mm: Annotated[float, Field(ge=0.0, le=50.0)] = 0.0
    """MR: how far the heart moves head to foot with the breath while the scan is taken: blurs."""
    ghost: Annotated[float, Field(ge=0.0, le=1.0)] = 0.0
    """MR: relative change of the signal from line to line: makes ghosts."""
    has_noise_texture: bool = False
    """CT: noise with the texture that the reconstruction gives it, instead of white noise."""
    streak_hu: Annotated[float, Field(ge=0.0, le=1000.0)] = 0.0
    """CT: how dark beam hardening makes the worst place, HU, with undiluted contrast medium in the superior cava."""
    seed: Annotated[int, Field(ge=0, le=2**31)] = 1
    """Seed of everything random."""
    edited_defects: tuple[HeartDefect, ...] = ()
    """Holes that are not in the scan: the recipe makes them, as edits."""
    incisions: tuple[IncisionName, ...] = ()
    """Planned incisions that the recipe gets, as lines on the heart with a depth."""

    @model_validator(mode="after")
    def _settings_fit(self) -> Self:
        of_mr, of_ct = ("motion_mm", "ghost"), ("has_noise_texture", "streak_hu", "is_specimen", "slice_thickness_mm")
        problems = [
            Problem(name, f"{self.modality} has none: leave it out")
            for name in (of_ct if self.modality == "MR" else of_mr)
            if getattr(self, name)
        ]
        if self.slice_thickness_mm is not None and self.slice_thickness_mm > self.spacing_mm[2]:
            problems.append(Problem("slice_thickness_mm", "must not be above the third of spacing_mm"))
        if problems:
            raise ModelProblems(problems)
        return self
