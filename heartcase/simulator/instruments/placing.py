"""Where an instrument is, from what a program says in LPS mm to the lattice's own axes and cells."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from heartcase.schemas.arrays import Float64
from heartcase.schemas.errors import Problem, SimulationError
from heartcase.simulator.lattice.model import LatticeModel

__all__ = ["as_numbers", "is_number", "is_point", "jaw_axes", "point_in_lattice", "turn_in_grid"]


def as_numbers(values: npt.ArrayLike) -> Float64:
    """What was given, as an array; a NaN where that is no array of numbers."""
    try:
        return np.asarray(values, dtype=np.float64)
    except (TypeError, ValueError):
        return np.array(np.nan)


def is_number(value: npt.ArrayLike) -> bool:
    """Whether this is one finite number."""
    number = as_numbers(value)
    return number.shape == () and bool(np.isfinite(number))


def is_point(values: npt.ArrayLike) -> bool:
    """Whether these are three finite numbers."""
    numbers = as_numbers(values)
    return numbers.shape == (3,) and bool(np.isfinite(numbers).all())


def point_in_lattice(model: LatticeModel, point_mm: npt.ArrayLike) -> Float64:
    """A point, LPS mm, in the coordinates of the nodes [cells], shape (3,)."""
    return np.asarray(model.geometry.world_to_index(point_mm), dtype=float) + 0.5


def turn_in_grid(model: LatticeModel, turn: npt.ArrayLike | None, name: str) -> Float64:
    """A rotation in LPS axes, in grid axes, shape (3, 3); none where it is left out.

    Raises
    ------
    SimulationError
        It is no rotation; the message is about the instrument of this name.
    """
    rotation = np.eye(3) if turn is None else as_numbers(turn)
    is_rotation = rotation.shape == (3, 3) and np.allclose(rotation @ rotation.T, np.eye(3), atol=1e-6)
    if not is_rotation or np.linalg.det(rotation) < 0:
        raise SimulationError("the turn must be a rotation matrix, shape (3, 3)", place=name)
    direction = model.geometry.direction_matrix
    turned: Float64 = direction.T @ rotation @ direction
    return turned


def jaw_axes(
    model: LatticeModel, direction: npt.ArrayLike, closing: npt.ArrayLike, name: str
) -> tuple[Float64, list[Problem]]:
    """Axes of an instrument with two jaws, in rows, grid axes, shape (3, 3), and what is wrong with what was given.

    Along the jaws towards their tips; from one jaw to the other; along the hinge.

    Parameters
    ----------
    model
        The lattice.
    direction
        Along the jaws, LPS, shape (3,), of any length.
    closing
        From one jaw to the other, LPS, shape (3,), of any length; what of it lies along the jaws is left out.
    name
        Name of the instrument, in messages.
    """
    problems = [
        Problem(name, f"the {what} must be three finite numbers, not all zero")
        for what, given in (("direction", direction), ("closing direction", closing))
        if not is_point(given) or not np.asarray(given, dtype=float).any()
    ]
    if problems:
        return np.eye(3), problems
    along, across = (model.to_grid(np.asarray(given, dtype=float)) for given in (direction, closing))
    along, across = along / np.linalg.norm(along), across / np.linalg.norm(across)
    across = across - (across @ along) * along
    if np.linalg.norm(across) < 1e-3:
        return np.eye(3), [Problem(name, "the jaws close along their own length: give another closing direction")]
    across = across / np.linalg.norm(across)
    return np.stack([along, across, np.cross(along, across)]), []
