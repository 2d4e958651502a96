"""Materials by name: what a recipe may say instead of numbers.

No stiffness here is measured. Published moduli of one tissue differ by more than ten times with the test, the direction
and the stretch at which they are taken, and the simulator has one modulus for a tissue in all directions, so none of
them is its number. What counts for how a model moves is how stiff its parts are against each other: each material is a
ratio to the default, chosen by the order in which such materials are known to be stiff. State numbers of your own
where you have measured some.
"""

from __future__ import annotations

from typing import Literal, NamedTuple

__all__ = ["DEFAULT_DENSITY_KG_M3", "DEFAULT_MODULUS_KPA", "MATERIALS", "MaterialName", "NamedMaterial"]

DEFAULT_MODULUS_KPA = 30.0
"""Young's modulus of tissue of which nothing is said, kPa."""
DEFAULT_DENSITY_KG_M3 = 1060.0
"""Density of tissue of which nothing is said, kg/m3."""

MaterialName = Literal[
    "adult myocardium",
    "infant myocardium",
    "hypertrophied myocardium",
    "great artery",
    "great vein",
    "scar",
    "pericardial patch",
    "conduit",
]
"""Materials that a recipe may name."""


class NamedMaterial(NamedTuple):
    """What a named material is."""

    ratio: float
    """Its stiffness against the default's."""
    basis: str
    """What the ratio rests on, one sentence."""

    @property
    def youngs_modulus_kpa(self) -> float:
        """Young's modulus, kPa."""
        return self.ratio * DEFAULT_MODULUS_KPA

    @property
    def density_kg_m3(self) -> float:
        """Density, kg/m3: that of tissue."""
        return DEFAULT_DENSITY_KG_M3


MATERIALS: dict[str, NamedMaterial] = {
    "adult myocardium": NamedMaterial(1.0, "The default."),
    "infant myocardium": NamedMaterial(0.5, "Softer than an adult's: a ratio that was chosen, not measured."),
    "hypertrophied myocardium": NamedMaterial(
        2.0, "Stiffer than healthy muscle: a ratio that was chosen, not measured."
    ),
    "great artery": NamedMaterial(2.0, "Stiffer than relaxed muscle: a ratio that was chosen, not measured."),
    "great vein": NamedMaterial(0.7, "Softer than an artery: a ratio that was chosen, not measured."),
    "scar": NamedMaterial(4.0, "Collagen instead of muscle: a ratio that was chosen, not measured."),
    "pericardial patch": NamedMaterial(10.0, "Hardly stretches by hand: a ratio that was chosen, not measured."),
    "conduit": NamedMaterial(
        30.0, "A woven or expanded graft, which keeps its length: a ratio that was chosen, not measured."
    ),
}
"""Name -> material."""
