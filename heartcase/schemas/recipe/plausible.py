"""Numbers of a recipe that no heart has, and the unit that was probably meant instead."""

from __future__ import annotations

__all__ = ["density_problem", "modulus_problem", "wall_problem"]

TISSUE_MODULUS_KPA = (0.1, 5000.0)
"""Young's modulus of soft tissue, from clot to a calcified wall."""
TISSUE_DENSITY_KG_M3 = (500.0, 3000.0)
"""Density of tissue, from fat full of air to solid calcium."""
DEVICE_DENSITY_KG_M3 = (100.0, 20_000.0)
"""Density of what is put into a heart, from foam to platinum."""
WALL_MM = (0.1, 15.0)
"""Thickness of a wall that is grown."""


def modulus_problem(value_kpa: float, *, is_device: bool = False) -> str:
    """What is wrong with a Young's modulus, kPa, in words; empty where nothing is. Devices may be as stiff as they are.

    Parameters
    ----------
    value_kpa
        The number of the recipe.
    is_device
        Whether it is for a label with the role ``device`` only.
    """
    low, high = TISSUE_MODULUS_KPA
    if value_kpa >= low and (is_device or value_kpa <= high):
        return ""
    if value_kpa < low:
        return _words(value_kpa, "kPa", "softer than any tissue", (low, high), {"MPa": 1000.0 * value_kpa})
    return _words(value_kpa, "kPa", "stiffer than any soft tissue", (low, high), {"Pa": value_kpa / 1000.0})


def density_problem(value_kg_m3: float, *, is_device: bool = False) -> str:
    """What is wrong with a density, kg/m3, in words; empty where nothing is.

    Parameters
    ----------
    value_kg_m3
        The number of the recipe.
    is_device
        Whether it is for a label with the role ``device`` only.
    """
    limits = DEVICE_DENSITY_KG_M3 if is_device else TISSUE_DENSITY_KG_M3
    what = "device" if is_device else "tissue"
    if value_kg_m3 < limits[0]:
        return _words(value_kg_m3, "kg/m3", f"lighter than any {what}", limits, {"g/cm3": 1000.0 * value_kg_m3})
    if value_kg_m3 > limits[1]:
        return _words(value_kg_m3, "kg/m3", f"heavier than any {what}", limits, {"g/m3": value_kg_m3 / 1000.0})
    return ""


def wall_problem(value_mm: float) -> str:
    """What is wrong with the thickness of a wall, mm, in words; empty where nothing is, as for 0, which is no wall."""
    if value_mm == 0.0 or WALL_MM[0] <= value_mm <= WALL_MM[1]:
        return ""
    if value_mm < WALL_MM[0]:
        meant = {"m": 1000.0 * value_mm, "cm": 10.0 * value_mm}
        return _words(value_mm, "mm", "thinner than any wall", WALL_MM, meant, ", or 0 for none")
    return _words(value_mm, "mm", "thicker than any wall", WALL_MM, {"tenths of a mm": value_mm / 10.0})


def _words(
    value: float, unit: str, what: str, limits: tuple[float, float], meant: dict[str, float], besides: str = ""
) -> str:
    """The number with its unit, what is usual, and the first unit in which it would be so."""
    low, high = limits
    likely = next(((name, other) for name, other in meant.items() if low <= other <= high), None)
    ask = "check the number and its unit" if likely is None else f"was {likely[0]} meant? then write {likely[1]:.6g}"
    return f"{value:g} {unit} is {what} ({low:g} to {high:g} {unit}{besides}): {ask}"
