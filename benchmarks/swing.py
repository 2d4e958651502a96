"""A second of a free bar that swings in its lowest bending: time it takes against error of its frequency.

The bar is square and ten times as long as thick, 100 mm of tissue of 30 kPa, swings by a thousandth of its length, and
is not damped. Truth: Timoshenko's beam, free at both ends (T. C. Huang, J. Appl. Mech. 28, 1961); at this slenderness
it is within some 1e-4 of the solid. Laws and steps are the methods, cells across the thickness the sweep. Peers are the
solvers of Newton on NVIDIA Warp, on the CPU; they hold what they hold at all steps and iterations that are named.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from scipy.optimize import brentq, least_squares

from benchmarks.runner.cases import MethodSkipped
from heartcase.schemas.arrays import Float32, Float64
from heartcase.simulator.lattice.model import LatticeModel, make_model
from heartcase.simulator.lattice.moduli import ForceLaw, LawName
from heartcase.simulator.lattice.state import State
from heartcase.simulator.simulation import Simulation

if TYPE_CHECKING:
    from benchmarks.swing_newton import Solver

SLENDERNESS = 10
LENGTH_MM = 100.0
SECONDS = 1.0
SAMPLE_S = 0.004
SWING = 1e-3
"""Largest displacement over the length."""


@dataclass(frozen=True)
class Inputs:
    """Cells across the thickness, and Poisson's ratio."""

    cells: int
    ratio: float


@dataclass(frozen=True)
class Output:
    """How far along the swing the bar was, from 1 at the start."""

    time_s: Float64
    swing: Float64
    model: LatticeModel


def prepare(params: dict[str, Any]) -> Inputs:
    return Inputs(**params)


def _bar(inputs: Inputs, law: LawName) -> LatticeModel:
    n = inputs.cells
    cells = np.stack(np.meshgrid(*[np.arange(k) for k in (SLENDERNESS * n, n, n)], indexing="ij"), axis=-1)
    cell_mm = LENGTH_MM / (SLENDERNESS * n)
    return make_model(cells.reshape(-1, 3), law=ForceLaw(law, inputs.ratio), cell_mm=cell_mm)


def _run(law: LawName, step_part: float) -> Callable[[Inputs], Output]:
    def run(inputs: Inputs) -> Output:
        model = _bar(inputs, law)
        default_s = Simulation(model).step_s
        count = int(np.ceil(SAMPLE_S / (default_s * step_part)))
        simulation = Simulation(model, step_s=SAMPLE_S / count, damping_per_s=0.0, sleep_mm=0.0)
        shape = _shape(model, inputs.ratio)
        simulation.restore(State(shape, np.zeros_like(shape)))
        weight = shape * model.node_mass[:, None].astype(float)
        swings = [1.0]
        for _ in range(round(SECONDS / SAMPLE_S)):
            simulation.step(count)
            swings.append(float((weight * simulation.state.displacement).sum() / (weight * shape).sum()))
        return Output(SAMPLE_S * np.arange(len(swings)), np.array(swings), model)

    return run


def _run_newton(solver: Solver, step_s: float, iterations: int) -> Callable[[Inputs], Output]:
    def run(inputs: Inputs) -> Output:
        try:
            from benchmarks.swing_newton import NewtonBar
        except ImportError:
            raise MethodSkipped("it needs newton: pip install '.[bench]'") from None
        model = _bar(inputs, "springs")
        shape = _shape(model, inputs.ratio)
        youngs_pa, density = _tissue(model)
        bar = NewtonBar(
            model,
            shape,
            solver=solver,
            iterations=iterations,
            youngs_pa=youngs_pa,
            ratio=inputs.ratio,
            density=density,
        )
        weight = shape * model.node_mass[:, None].astype(float)
        swings = [1.0]
        for _ in range(round(SECONDS / SAMPLE_S)):
            bar.step(round(SAMPLE_S / step_s), step_s)
            swings.append(float((weight * bar.displacement).sum() / (weight * shape).sum()))
        return Output(SAMPLE_S * np.arange(len(swings)), np.array(swings), model)

    return run


LAWS: dict[str, LawName] = {"springs": "springs", "element": "element"}
STEPS = {"": 1.0, "_half_step": 0.5, "_quarter_step": 0.25}
PEERS: dict[str, tuple[Solver, float, int]] = {
    "vbd": ("vbd", 1e-3, 10),
    "vbd_more": ("vbd", 5e-4, 40),
    "xpbd": ("xpbd_springs", 1e-4, 2),
    "xpbd_more": ("xpbd_springs", 5e-5, 2),
    "xpbd_tetrahedra": ("xpbd", 2.5e-4, 4),
}
"""Solver, step in s, and iterations in a step."""
METHODS = {f"{name}{word}": _run(law, part) for name, law in LAWS.items() for word, part in STEPS.items()} | {
    f"newton_{name}": _run_newton(*given) for name, given in PEERS.items()
}


def errors(inputs: Inputs, output: Output) -> dict[str, float]:
    """Frequency against theory, and how much of the swing is lost."""
    b, _ = _timoshenko(inputs.ratio)
    true_hz = b * _unit_hz(output.model) / (2.0 * np.pi)

    def misfit(guess: Float64) -> Float64:
        frequency, cosine, sine = guess
        angle = 2.0 * np.pi * frequency * output.time_s
        return cosine * np.cos(angle) + sine * np.sin(angle) - output.swing

    # From the number of times that it passes through the middle.
    passes = np.count_nonzero(np.diff(np.sign(output.swing)))
    start = np.array([0.5 * passes / SECONDS, 1.0, 0.0])
    fit = least_squares(misfit, start, x_scale=[0.1, 1.0, 1.0], xtol=1e-12, ftol=1e-12)
    last = output.swing[-len(output.swing) // 4 :]
    return {
        "frequency to Timoshenko's [1]": abs(float(fit.x[0]) / true_hz - 1.0),
        "swing that is missing in the last quarter [1]": abs(1.0 - float(np.abs(last).max())),
    }


def _unit_hz(model: LatticeModel) -> float:
    """sqrt(E I / (rho A L^4)) of the bar, 1/s."""
    thickness_m, length_m = 1e-3 * LENGTH_MM / SLENDERNESS, 1e-3 * LENGTH_MM
    youngs_pa, density = _tissue(model)
    return float(np.sqrt(youngs_pa * thickness_m**2 / 12.0 / density) / length_m**2)


def _tissue(model: LatticeModel) -> tuple[float, float]:
    """Young's modulus in Pa and density in kg/m3."""
    return 1e3 * float(model.cell_stiffness[0]) * 30.0, 1060.0 * float(model.cell_density[0])


def _constants(ratio: float) -> tuple[float, float]:
    """r^2 = I / (A L^2) and s^2 = E I / (kappa A G L^2)."""
    kappa = 10.0 * (1.0 + ratio) / (12.0 + 11.0 * ratio)
    r_squared = 1.0 / (12.0 * SLENDERNESS**2)
    return r_squared, r_squared * 2.0 * (1.0 + ratio) / kappa


def _waves(b: float, ratio: float) -> tuple[float, float, float, float]:
    """B alpha, b beta, and L psi over w of the two parts of the lowest swing, cosh(b alpha x) and cos(b beta x)."""
    r_squared, s_squared = _constants(ratio)
    root = np.sqrt((r_squared - s_squared) ** 2 / 4.0 + 1.0 / b**2)
    alpha, beta = np.sqrt(root - (r_squared + s_squared) / 2.0), np.sqrt(root + (r_squared + s_squared) / 2.0)
    return b * alpha, b * beta, b * (alpha**2 + s_squared) / alpha, -b * (beta**2 - s_squared) / beta


def _timoshenko(ratio: float) -> tuple[float, float]:
    """Omega sqrt(rho A L^4 / (E I)) of the lowest swing, and the weight of its cosine beside a cosh of weight one."""

    def free_end(b: float) -> tuple[float, float, float, float]:
        p, q, turn_p, turn_q = _waves(b, ratio)
        moment = turn_p * p * np.cosh(p / 2), turn_q * q * np.cos(q / 2)
        shear = (p - turn_p) * np.sinh(p / 2), -(q + turn_q) * np.sin(q / 2)
        return *moment, *shear

    def determinant(b: float) -> float:
        moment_p, moment_q, shear_p, shear_q = free_end(b)
        return moment_p * shear_q - moment_q * shear_p

    b = float(brentq(determinant, 15.0, 22.5, xtol=1e-12))
    moment_p, moment_q, _, _ = free_end(b)
    return b, -moment_p / moment_q


def _shape(model: LatticeModel, ratio: float) -> Float32:
    """The swing on the nodes [cells]: deflection along z, and the sections' turn."""
    b, cosine = _timoshenko(ratio)
    p, q, turn_p, turn_q = _waves(b, ratio)
    length = float(model.node_index[:, 0].max())
    x = model.node_index[:, 0] / length - 0.5
    deflection = np.cosh(p * x) + cosine * np.cos(q * x)
    turn = (turn_p * np.sinh(p * x) + cosine * turn_q * np.sin(q * x)) / length
    shape = np.zeros((model.node_count, 3))
    shape[:, 2] = deflection
    shape[:, 0] = -turn * (model.node_index[:, 2] - model.node_index[:, 2].max() / 2.0)
    return (SWING * length / np.abs(deflection).max() * shape).astype(np.float32)
