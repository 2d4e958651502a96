"""Boxes that are stretched, bent, twisted and pressed: one description for the lattice and for the finite elements.

Lengths are in units of the bar's thickness, for the block of half a punch's width; stresses in k/h, so that E = 2.5.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from benchmarks.statics import Held, equilibrium
from heartcase.schemas.arrays import Bool, Float64
from heartcase.simulator.lattice.model import LatticeModel, make_model
from heartcase.simulator.lattice.moduli import ForceLaw

Led = tuple[Bool, Float64]
"""Which components of which nodes are led, and where to, shape (n, 3) each."""

YOUNGS_MODULUS = ForceLaw().youngs_modulus


@dataclass(frozen=True)
class Field:
    """A solution on the nodes of either method."""

    points: Float64
    """Rest positions, shape (n, 3)."""
    displacement: Float64
    """Shape (n, 3)."""
    reaction: Float64
    """Force that leads or holds each node, shape (n, 3)."""
    end_share: Float64
    """Area of the far end, x = length, that each node stands for, shape (n,)."""


@dataclass(frozen=True)
class Scene:
    """A box, what leads it, and what is measured."""

    low: tuple[float, float, float]
    """Least corner."""
    high: tuple[float, float, float]
    """Greatest corner."""
    led: Callable[[Float64, float], Led]
    """What is led, from positions and the part, 0 to 1, of the way. In small strain it is proportional to the part."""
    quantity: str
    """Name of what is measured, with its unit."""
    measure: Callable[[Field], float]
    """It, of a solution of the whole box."""
    traction: tuple[float, float, float] = (0.0, 0.0, 0.0)
    """Force per area at rest on the far end, in the end."""
    mirrors: tuple[int, ...] = ()
    """Axes whose plane at zero is one of symmetry: a truth needs the part above them only."""
    is_extensive: bool = True
    """Whether a part of the box has that part of what is measured: a force, not a displacement."""
    edges: tuple[tuple[float, ...], tuple[float, ...], tuple[float, ...]] = ((), (), ())
    """Coordinates along x, y and z at which stress is singular or the boundary condition changes."""
    step_count: int = 0
    """Load steps; zero in small strain."""


def scene(name: str, is_large: bool) -> Scene:
    """The scene ``bar``, ``cantilever``, ``torsion`` or ``indentation``, in small or in large strain."""
    return {"bar": _bar, "cantilever": _cantilever, "torsion": _torsion, "indentation": _indentation}[name](is_large)


def lattice_of(scene: Scene, cells_per_unit: int, law: ForceLaw, thickness_mm: float) -> LatticeModel:
    """The scene's box as full cells; a unit is ``thickness_mm``."""
    shape = np.round((np.array(scene.high) - scene.low) * cells_per_unit).astype(int)
    cells = np.stack(np.meshgrid(*[np.arange(n) for n in shape], indexing="ij"), axis=-1).reshape(-1, 3)
    return make_model(cells, law=law, cell_mm=thickness_mm / cells_per_unit)


def solve_lattice(scene: Scene, model: LatticeModel, cells_per_unit: int) -> float:
    """What is measured, of the lattice in equilibrium."""
    points = model.node_index / cells_per_unit + np.array(scene.low)
    share = _end_share(model)

    def held_at(part: float) -> Held:
        is_led, where = scene.led(points, part)
        return np.flatnonzero(is_led), where[is_led] * cells_per_unit

    load = share[:, None] * np.array(scene.traction)
    displacement, reaction = equilibrium(model, load, held_at, scene.step_count)
    # A cell is 1/n long: areas and with them forces are n^2 as many as in the scene's units.
    n = cells_per_unit
    return scene.measure(Field(points, displacement / n, reaction / n**2, share / n**2))


def timoshenko_deflection(length: float, load: float, poissons_ratio: float) -> float:
    """Deflection of the tip of a square cantilever of thickness one; shear coefficient 10 (1 + nu) / (12 + 11 nu)."""
    shear_modulus = YOUNGS_MODULUS / (2.0 * (1.0 + poissons_ratio))
    coefficient = 10.0 * (1.0 + poissons_ratio) / (12.0 + 11.0 * poissons_ratio)
    return load * length**3 / (3.0 * YOUNGS_MODULUS / 12.0) + load * length / (coefficient * shear_modulus)


def saint_venant_torque(length: float, angle: float, poissons_ratio: float) -> float:
    """Torque of a square bar of thickness one, its ends free to warp: 0.1405770 mu angle / length."""
    return 0.1405770 * YOUNGS_MODULUS / (2.0 * (1.0 + poissons_ratio)) * angle / length


def _end_share(model: LatticeModel) -> Float64:
    """Area of the far end that each node stands for [cells^2], shape (node_count,)."""
    far = model.cells[:, 0].max()
    corners = model.cell_corners[model.cells[:, 0] == far]
    at_end = corners[model.node_index[corners][:, :, 0] == far + 1]
    return np.bincount(at_end, minlength=model.node_count) / 4.0


def _nothing_led(points: Float64) -> Led:
    return np.zeros(points.shape, np.bool_), np.zeros(points.shape)


def _is_at(points: Float64, axis: int, place: float) -> Bool:
    return np.abs(points[:, axis] - place) < 1e-6


BAR_LENGTH = 4.0
CANTILEVER_LENGTH = 10.0
CANTILEVER_LOAD = 2.0 * YOUNGS_MODULUS / 12.0 / CANTILEVER_LENGTH**2
"""P with P L^2 = 2 E I: a slender beam's tip goes aside by 0.49 of its length."""
TWIST = np.pi


def _bar(is_large: bool) -> Scene:
    stretch = 0.5 if is_large else 1.0

    def led(points: Float64, part: float) -> Led:
        is_led, where = _nothing_led(points)
        is_led[_is_at(points, 0, 0.0)] = True
        is_led[_is_at(points, 0, BAR_LENGTH), 0] = True
        where[_is_at(points, 0, BAR_LENGTH), 0] = part * stretch * BAR_LENGTH
        return is_led, where

    return Scene(
        low=(0.0, -0.5, -0.5),
        high=(BAR_LENGTH, 0.5, 0.5),
        led=led,
        quantity="force",
        measure=lambda field: float(field.reaction[_is_at(field.points, 0, BAR_LENGTH), 0].sum()),
        mirrors=(1, 2),
        edges=((0.0,), (0.5,), (0.5,)),
        step_count=5 if is_large else 0,
    )


def _cantilever(is_large: bool) -> Scene:
    def led(points: Float64, part: float) -> Led:
        is_led, where = _nothing_led(points)
        is_led[_is_at(points, 0, 0.0)] = True
        return is_led, where

    def measure(field: Field) -> float:
        return float((field.end_share * field.displacement[:, 2]).sum() / field.end_share.sum())

    return Scene(
        low=(0.0, -0.5, -0.5),
        high=(CANTILEVER_LENGTH, 0.5, 0.5),
        led=led,
        quantity="tip deflection",
        measure=measure,
        traction=(0.0, 0.0, CANTILEVER_LOAD),
        mirrors=(1,),
        is_extensive=False,
        edges=((0.0,), (0.5,), (-0.5, 0.5)),
        step_count=5 if is_large else 0,
    )


def _torsion(is_large: bool) -> Scene:
    """Both ends keep to their plane's outline, one turned in it by half a turn; free to warp along the axis."""

    def led(points: Float64, part: float) -> Led:
        is_led, where = _nothing_led(points)
        near, far = _is_at(points, 0, 0.0), _is_at(points, 0, BAR_LENGTH)
        is_led[near | far, 1:] = True
        # Where the bar slides along its axis is open: nothing pulls at the node that says.
        is_led[np.flatnonzero(near)[0], 0] = True
        y, z = points[far, 1:].T
        angle = TWIST * part
        cosine, sine = (np.cos(angle), np.sin(angle)) if is_large else (1.0, angle)
        where[far, 1], where[far, 2] = cosine * y - sine * z - y, sine * y + cosine * z - z
        return is_led, where

    def measure(field: Field) -> float:
        far = _is_at(field.points, 0, BAR_LENGTH)
        y, z = (field.points + field.displacement * is_large)[far, 1:].T
        return float((y * field.reaction[far, 2] - z * field.reaction[far, 1]).sum())

    return Scene(
        low=(0.0, -0.5, -0.5),
        high=(BAR_LENGTH, 0.5, 0.5),
        led=led,
        quantity="torque",
        measure=measure,
        edges=((0.0, BAR_LENGTH), (-0.5, 0.5), (-0.5, 0.5)),
        step_count=12 if is_large else 0,
    )


def _indentation(is_large: bool) -> Scene:
    """A block 4 x 4 x 2 stuck to the ground, and to a square punch of 2 x 2 in the middle of its top."""
    depth = 0.5 if is_large else 1.0

    def punched(points: Float64) -> Bool:
        inside = (np.abs(points[:, :2]) < 1.0 + 1e-6).all(axis=1)
        return inside & _is_at(points, 2, 0.0)

    def led(points: Float64, part: float) -> Led:
        is_led, where = _nothing_led(points)
        is_led[_is_at(points, 2, -2.0) | punched(points)] = True
        where[punched(points), 2] = -part * depth
        return is_led, where

    return Scene(
        low=(-2.0, -2.0, -2.0),
        high=(2.0, 2.0, 0.0),
        led=led,
        quantity="force",
        measure=lambda field: -float(field.reaction[punched(field.points), 2].sum()),
        mirrors=(0, 1),
        edges=((1.0,), (1.0,), (0.0,)),
        step_count=5 if is_large else 0,
    )
