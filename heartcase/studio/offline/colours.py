"""Colours of structures in the viewer: by structure, by oxygenation, and for people who are colour-blind."""

from __future__ import annotations

from heartcase.schemas.labels import Label, LabelTable
from heartcase.studio.offline.oxygenation import Oxygen

__all__ = ["OXYGEN_COLOURS", "RIM_COLOUR", "SAFE_RIM_COLOUR", "SAFE_VESSEL_COLOUR", "safe_colour"]

OXYGEN_COLOURS = {
    Oxygen.RICH: "#d0312d",
    Oxygen.POOR: "#2f6fc4",
    Oxygen.MIXED: "#8a4fb0",
    Oxygen.UNKNOWN: "#b0a8a2",
}

RIM_COLOUR = "#ffd400"
"""Rims of defects, in all modes but the one for the colour-blind."""
SAFE_RIM_COLOUR = "#303030"

_VERMILION, _ORANGE, _YELLOW, _GREEN = "#d55e00", "#e69f00", "#f0e442", "#009e73"
_BLUE, _SKY, _PURPLE, _GREY = "#0072b2", "#56b4e9", "#cc79a7", "#a8a8a8"
SAFE_VESSEL_COLOUR = _PURPLE
_SAFE = {
    "morphologically left ventricle": _VERMILION,
    "morphologically right ventricle": _BLUE,
    "morphologically left atrium": _ORANGE,
    "morphologically right atrium": _SKY,
    "left atrial appendage": _ORANGE,
    "right atrial appendage": _SKY,
    "aorta": _PURPLE,
    "pulmonary artery": _GREEN,
    "superior vena cava": _YELLOW,
    "inferior vena cava": _YELLOW,
    "coronary sinus": _YELLOW,
    "pulmonary vein": _YELLOW,
    "morphologically left ventricular myocardium": _VERMILION,
    "morphologically right ventricular myocardium": _BLUE,
}
"""Term -> one of the eight colours of Okabe and Ito (Color Universal Design, 2008), with grey instead of black."""


def safe_colour(label: Label, table: LabelTable) -> str:
    """Colour of a structure that colour-blind people can tell from its neighbours, ``#rrggbb``.

    Tissue takes the colour of its cavity, half grey; what the vocabulary lacks is grey.
    """
    cavity = label
    if label.wall_of is not None and label.wall_of in table:
        cavity = table[label.wall_of]
    colour = _SAFE.get(cavity.term.name, _GREY) if cavity.term is not None else _GREY
    return _half_grey(colour) if label.role.is_tissue else colour


def _half_grey(colour: str) -> str:
    return "#" + "".join(f"{(int(colour[at : at + 2], 16) + 0xA8) // 2:02x}" for at in (1, 3, 5))
