"""The shape of a synthetic heart: its size, how its vessels are connected, and what is wrong with it."""

from __future__ import annotations

from typing import Annotated, Literal, Self

from pydantic import Field, model_validator

from heartcase.schemas.base import Model
from heartcase.schemas.errors import ModelProblems, Problem

__all__ = ["Baffle", "DefectKind", "HeartDefect", "HeartForm", "HeartSize", "IncisionName"]

HeartSize = Literal["adult", "child"]
"""The two hearts of fixed size that tests and benchmarks are about: small for an adult and a child of one year."""

DefectKind = Literal[
    "secundum",
    "primum",
    "sinus venosus",
    "atrioventricular",
    "perimembranous",
    "inlet muscular",
    "mid muscular",
    "apical muscular",
    "anterior muscular",
    "subpulmonary",
]
"""Where a septum has its hole: three atrial ones, the common junction, and the ventricular ones from base to apex."""

IncisionName = Literal[
    "right ventriculotomy",
    "apical infundibulotomy",
    "pulmonary root",
    "aortic root",
    "right atriotomy",
    "aortic isthmus",
]
"""Planned incisions: those of the thesis' chapter 12, and one over the isthmus of the aorta."""

_Part = Annotated[float, Field(ge=0.3, le=1.0)]
_Ratio = Annotated[float, Field(ge=0.4, le=1.4)]


class HeartDefect(Model):
    """A hole in a septum."""

    kind: DefectKind
    """Where it is."""
    diameter_mm: Annotated[float, Field(ge=1.0, le=50.0)]
    """Diameter; of an oval hole the long one."""
    width_mm: Annotated[float, Field(ge=1.0, le=50.0)] | None = None
    """Oval holes: the short diameter; the long one lies along the heart's long axis."""


class Baffle(Model):
    """A tunnel of sheet inside the right ventricle, from a ventricular septal defect to the aorta."""

    thickness_mm: Annotated[float, Field(ge=0.5, le=5.0)] = 1.5
    """Thickness of the sheet."""
    diameter_mm: Annotated[float, Field(ge=3.0, le=40.0)] = 12.0
    """Inner diameter where it begins, at the septum; at the aortic valve it is as wide as the valve."""
    waist_mm: Annotated[float, Field(ge=2.0, le=40.0)] | None = None
    """Inner diameter where it is narrowest, half-way; when left out it widens evenly."""
    leaks_mm: tuple[Annotated[float, Field(ge=1.0, le=20.0)], ...] = ()
    """Diameters of the leaks: at most two."""

    @model_validator(mode="after")
    def _leaks_fit(self) -> Self:
        if len(self.leaks_mm) > 2:
            raise ModelProblems([Problem("leaks_mm", "at most two leaks have a place: leave the others out")])
        return self


class HeartForm(Model):
    """A synthetic heart; what is left out is as in a normal one."""

    size: HeartSize = "adult"
    """Which heart; it does not matter where ``body_surface_m2`` is given."""
    body_surface_m2: Annotated[float, Field(ge=0.15, le=2.5)] | None = None
    """Body surface area, m2: chambers, walls and arteries have the mean sizes of published tables for it, at the end of
    diastole. 0.23 is a newborn, 0.45 a child of one year, 1.1 one of ten years, 1.9 an adult."""
    is_mirrored: bool = False
    """Mirror image: the apex points to the right, and every side is exchanged."""
    great_arteries: Literal["concordant", "transposed", "double outlet right ventricle"] = "concordant"
    """Which ventricle they come from. Transposed: the aorta from the right, in front and to the right of the pulmonary
    trunk, which comes from the left. Double outlet: both from the right, side by side, the aorta to the right."""
    left_ventricle: _Ratio = 1.0
    """Width of its cavity against the normal one; above 1 it is dilated."""
    right_ventricle: _Ratio = 1.0
    """Width and length of its cavity against the normal one; below 1 it is hypoplastic."""
    right_ventricular_wall_mm: Annotated[float, Field(ge=1.0, le=15.0)] | None = None
    """Thickness of the right ventricle's free wall; that of the size when left out."""
    septum_mm: Annotated[float, Field(ge=0.5, le=10.0)] | None = None
    """Least tissue between the atria, and between vessels and atria; that of the size when left out."""
    aortic_override: Annotated[float, Field(ge=0.0, le=0.6)] = 0.0
    """How far the aortic root is moved over the septum, as a part of its diameter."""
    pulmonary_outflow: _Part = 1.0
    """Width of infundibulum, pulmonary valve and trunk against the normal one; below 1 there is a stenosis."""
    pulmonary_band: _Part = 1.0
    """Width of the pulmonary trunk where a band lies around it, against the trunk's."""
    left_pulmonary_artery: _Part = 1.0
    """Width of the left pulmonary artery at its origin against the normal one."""
    aortic_isthmus: _Part = 1.0
    """Width of the aorta beyond the left subclavian artery against the normal one; below 1 there is a coarctation."""
    has_detail: bool = False
    """Papillary muscles in both ventricles, trabeculae on their walls."""
    has_valve_leaflets: bool = False
    """Closed leaflets in the four valves; otherwise the valves are open orifices."""
    defects: tuple[HeartDefect, ...] = ()
    """Holes in the septa."""
    baffle: Baffle | None = None
    """Double outlet right ventricle: the tunnel that leads blood from a subpulmonary defect to the aorta."""

    @model_validator(mode="after")
    def _parts_fit(self) -> Self:
        problems: list[Problem] = []
        kinds = [defect.kind for defect in self.defects]
        for number, kind in enumerate(kinds, start=1):
            if kind in kinds[: number - 1]:
                problems.append(Problem(f"defects[{number}]", f"there is a {kind} one before it: they would coincide"))
        for number, defect in enumerate(self.defects, start=1):
            if defect.width_mm is not None and defect.width_mm > defect.diameter_mm:
                problems.append(Problem(f"defects[{number}].width_mm", "must not be above diameter_mm: exchange them"))
        is_double_outlet = self.great_arteries == "double outlet right ventricle"
        if self.baffle is not None and not (is_double_outlet and "subpulmonary" in kinds):
            problems.append(
                Problem("baffle", "leads from a subpulmonary defect to an aorta that comes from the right ventricle: "
                        "set great_arteries and add the defect")
            )  # fmt: skip
        if self.aortic_override > 0.0 and self.great_arteries != "concordant":
            problems.append(Problem("aortic_override", "only an aorta from the left ventricle can override the septum"))
        if problems:
            raise ModelProblems(problems)
        return self
