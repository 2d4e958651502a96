"""How large a heart is: the two of fixed size, and those of published tables for a body surface area.

Children's echocardiography (Lopez et al., Circulation: Cardiovascular Imaging 10, 2017, doi
10.1161/CIRCIMAGING.117.006979) gives the mean of a structure as a constant times a power of the body surface area: left
ventricular end-diastolic volume 62.02 ml and 1.3, posterior wall 5.7 mm and 0.4, vessels' diameters 0.5. At 1.9 m2 they
give 143 ml and 7.4 mm, where adults' magnetic resonance has 132 ml (women) and 160 ml (men): one rule serves all. The
right ventricle holds a sixth more than the left, and its free wall is as thick as its mass asks for (Buechel et al.,
Journal of Cardiovascular Magnetic Resonance 11:19, 2009: 16.7 and 14.9 g at 1 m2 for boys and girls; Jhaveri et al.,
2023: 12.5 g/m2 in newborns). No table was found of the walls of atria and veins in children: theirs follow the square
root of the area.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

from heartcase.schemas.recipe.heart_form import HeartForm

__all__ = ["Proportions", "proportions_of"]

ADULT_SURFACE_M2 = 1.9
_VOLUME_ML = 83.0
"""Cavity of the left ventricle at scale 1, measured."""
_WALLS = {3: 2.2, 4: 2.2, 5: 1.6, 6: 1.4, 7: 1.2, 8: 1.2}
"""Label -> thickness of an adult's wall, mm: atria, aorta (1.5: Mensel et al., European Radiology 24,
2014, doi 10.1007/s00330-014-3188-8); of the others no table was found."""
_LEAST_WALLS = {3: 1.2, 4: 1.2, 5: 0.9, 6: 0.9, 7: 0.8, 8: 0.8}
"""The same of the smallest hearts."""


@dataclass(frozen=True)
class Proportions:
    """Sizes of a heart against the shapes of :mod:`heartcase.phantom.anatomy.build`."""

    scale: float
    """Size of the cavities."""
    left_wall_mm: float
    """Thickness of the left ventricular myocardium at its middle."""
    walls_mm: dict[int, float]
    """Label -> thickness of its grown wall, where it is not that of the default label table."""
    right_ventricle: float
    """Width and length of the right ventricle's cavity."""
    artery: float
    """Width of the arteries and of the ways into them."""
    gap_mm: float
    """Least tissue between cavities of the left and of the right side."""


def proportions_of(form: HeartForm) -> Proportions:
    """Sizes of the heart of a form."""
    area = form.body_surface_m2
    if area is None and form.size == "adult":
        walls: dict[int, float] = {}
        sizes = Proportions(0.93, 9.0, walls, 1.0, 1.0, 1.0 + 2.5 * 0.93)
    elif area is None:
        walls = {2: 2.5, 3: 1.5, 4: 1.5, 5: 1.3, 6: 1.2, 7: 1.0, 8: 1.0}
        sizes = Proportions(0.52, 5.0, walls, 1.0, 1.0, 1.0 + 2.5 * 0.52)
    else:
        scale = (62.02 * area**1.3 / _VOLUME_ML) ** (1.0 / 3.0)
        part = math.sqrt(area / ADULT_SURFACE_M2)
        walls = {label: round(max(_LEAST_WALLS[label], part * wall), 2) for label, wall in _WALLS.items()}
        walls[2] = round(1.2 + 1.3 * min(1.0, area / ADULT_SURFACE_M2), 2)
        # Diameters go with the square root of the area, the cavities' scale with its 0.43rd power.
        width = 0.89 * part / (scale / (62.02 * ADULT_SURFACE_M2**1.3 / _VOLUME_ML) ** (1.0 / 3.0))
        sizes = Proportions(scale, 5.7 * area**0.4, walls, 1.12, width, 0.92 * (walls[3] + walls[4]))
    if form.right_ventricular_wall_mm is not None:
        walls[2] = form.right_ventricular_wall_mm
    if form.septum_mm is not None:
        sizes = replace(sizes, gap_mm=form.septum_mm)
    return sizes
