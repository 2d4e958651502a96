"""The force law: springs with a volume term, or hexahedral elements; one for a model.

Both are an isotropic solid of the tissue's Young's modulus E and of any Poisson's ratio from 1/4 to almost 1/2. Stress
is reckoned in units of k/h = 0.4 E: there mu = 1.25 / (1 + ratio) and lambda = 2 mu ratio / (1 - 2 ratio).

``springs``
    The 18-neighbour lattice with k = mu h, which has lambda = mu by itself, and per cell a volume energy of modulus
    lambda - mu: nothing at a ratio of 1/4. Bends too stiffly where walls are thin.
``element``
    A hexahedron per cell with one point of integration at the tissue's centroid, and the strain's linear part by itself
    (assumed strain, Belytschko and Bindeman, Comput. Methods Appl. Mech. Eng. 105, 1993): bending is exact in a wall
    one cell thick. Where the moments of the tissue in a cell are known, a thin wall along the cells bends as such
    wherever it lies in them. One askew to them does so because its cells share strain with those around them.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal, get_args

from heartcase.schemas.errors import Problem, SimulationError

__all__ = ["LOOK_BELOW", "LOOK_STEPS", "RATIO_MAX", "RATIO_MIN", "ForceLaw", "LawName"]

LawName = Literal["springs", "element"]

RATIO_MIN = 0.25
"""Poisson's ratio of the springs alone."""
RATIO_MAX = 0.49
"""Poisson's ratio up to which a step is not too short to be of use."""
LOOK_BELOW = 0.6
"""Volume of a corner from which on nothing is done for it, in any law [cells]; one at rest."""
LOOK_STEPS = 8
"""Steps between two looks for such corners where springs act alone."""
_YOUNGS_MODULUS = 2.5
_CORNER_FLOOR = 0.3
_SPRINGS_CORNER = 3.0
"""Springs' corners: the least stiffness that drives a cell that is inside out back through being flat."""
_ELEMENTS_CORNER = 0.11
"""Elements' corners: stiffness over the bound at rest; more takes omega^2 beyond 3.1 times that bound."""
_SPRINGS_STRETCHED, _CELLS_STRETCHED = 1.2, 1.6
"""What a default step is made for over the bound at rest: springs alone, and where cells resist by themselves."""


@dataclass(frozen=True)
class ForceLaw:
    """Which forces act in the cells of a model.

    Raises
    ------
    SimulationError
        The name or the ratio is out of range.
    """

    name: LawName = "springs"
    """Springs, or hexahedral elements."""
    poissons_ratio: float = RATIO_MIN
    """Poisson's ratio [1], 0.25 to 0.49. The closer to 1/2, the shorter the step."""
    guards_corners: bool = True
    """Whether corners of cells that are about to turn inside out push back."""
    shares_strain: bool = True
    """Whether elements of thin walls askew to the grid are strained in part by the mean around their corners
    (:mod:`heartcase.simulator.lattice.strain_sharing`); without, they bend too stiffly, and a step takes less time."""

    def __post_init__(self) -> None:
        problems = []
        if self.name not in get_args(LawName):
            names = ", ".join(get_args(LawName))
            problems.append(Problem("law", f"there is no force law {self.name!r}: choose from {names}"))
        if not RATIO_MIN <= self.poissons_ratio <= RATIO_MAX:
            limits = f"{RATIO_MIN} to {RATIO_MAX}"
            problems.append(Problem("poissons_ratio", f"Poisson's ratio is {self.poissons_ratio}: give {limits}"))
        if problems:
            raise SimulationError(problems)

    @property
    def is_element(self) -> bool:
        """Whether cells are hexahedral elements."""
        return self.name == "element"

    @property
    def shear_modulus(self) -> float:
        """Shear modulus mu [k/h]."""
        return _YOUNGS_MODULUS / (2.0 * (1.0 + self.poissons_ratio))

    @property
    def lame_modulus(self) -> float:
        """Lame's first parameter lambda [k/h]."""
        return 2.0 * self.shear_modulus * self.poissons_ratio / (1.0 - 2.0 * self.poissons_ratio)

    @property
    def youngs_modulus(self) -> float:
        """Young's modulus E [k/h]."""
        return _YOUNGS_MODULUS

    @property
    def plate_modulus(self) -> float:
        """E / (1 - ratio^2), which resists the bending of a plate [k/h]."""
        return _YOUNGS_MODULUS / (1.0 - self.poissons_ratio**2)

    @property
    def volume_modulus(self) -> float:
        """What the volume term has to add to the springs' lambda [k/h]; zero at a ratio of 1/4, and for elements."""
        return 0.0 if self.is_element else max(self.lame_modulus - self.shear_modulus, 0.0)

    @property
    def has_volume_term(self) -> bool:
        """Whether springs alone do not have the ratio."""
        return not self.is_element and self.poissons_ratio > RATIO_MIN

    @property
    def acts_in_cells(self) -> bool:
        """Whether cells resist by themselves at any deformation: as elements, or by their volume."""
        return self.is_element or self.has_volume_term

    @property
    def has_corner_guard(self) -> bool:
        """Whether corners push back."""
        return self.guards_corners

    @property
    def corner_floor(self) -> float:
        """J_0: volume of a corner from which on it pushes back [cells].

        From 0.6 on, elements that a probe holds pressed never come to rest.
        """
        return _CORNER_FLOOR

    @property
    def corner_stiffness(self) -> float:
        """k_c: how strongly a corner pushes back [k/h]."""
        return _ELEMENTS_CORNER * self.rest_bound if self.is_element else _SPRINGS_CORNER

    @property
    def has_shared_strain(self) -> bool:
        """Whether cells share strain: elements may."""
        return self.shares_strain and self.is_element

    @property
    def constants(self) -> tuple[float, ...]:
        """What the kernels read, six numbers.

        The volume term's modulus and zeros, or mu, lambda + mu / 3, E / (1 - ratio^2), ratio and E; last the corners'
        floor.
        """
        if not self.is_element:
            return (self.volume_modulus, 0.0, 0.0, 0.0, 0.0, self.corner_floor)
        bulk = self.lame_modulus + self.shear_modulus / 3.0
        moduli = (self.shear_modulus, bulk, self.plate_modulus, self.poissons_ratio, self.youngs_modulus)
        return (*moduli, self.corner_floor)

    @property
    def rest_bound(self) -> float:
        """omega^2 m h / k of a lone cell of full moments at rest: 12 lambda + 8 mu, for either law."""
        return 12.0 * self.lame_modulus + 8.0 * self.shear_modulus

    @property
    def stretched_bound(self) -> float:
        """omega^2 m h / k for which the default step is made.

        For springs at a ratio of 1/4 this is 24, which no deformation exceeds. For elements, with a volume term and
        where corners push back it is no bound, but what the default step's safety makes one for all but extremes
        (``tests/verification/test_force_laws.py`` tries random deformations of a lone cell).
        """
        return (_CELLS_STRETCHED if self.acts_in_cells else _SPRINGS_STRETCHED) * self.rest_bound
