"""The parts of a frame of a finished case: steps of 1/30 s, surface, picking surface, force on a hand, on CPU and GPU.

A GPU machine need not have the pipeline: ``HEARTCASE_CASE`` may name a case that was built elsewhere.
"""

from __future__ import annotations

import os
import tempfile
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from heartcase.schemas.benchmark import MethodSkipped
from heartcase.schemas.errors import SimulationError
from heartcase.simulator.engine import Backend
from heartcase.simulator.instruments import Grab
from heartcase.simulator.load import Case, load_case
from heartcase.simulator.simulation import Simulation

FRAME_S = 1 / 30
PULL_MM = (4.0, -3.0, 5.0)


@dataclass(frozen=True)
class Inputs:
    """A case, and the simulation of each backend once it is made."""

    case: Case
    memory: dict[Backend, tuple[Simulation, Grab]]


@dataclass(frozen=True)
class Output:
    """Which backend did the work."""

    backend: Backend


def prepare(params: dict[str, Any]) -> Inputs:
    path = Path(os.environ["HEARTCASE_CASE"]) if "HEARTCASE_CASE" in os.environ else _built(params)
    return Inputs(load_case(path, needs=("surface", "tangents", "picking")), {})


def _built(params: dict[str, Any]) -> Path:
    try:
        from build import build_phantom
    except ImportError:
        raise MethodSkipped("it needs heartcase[prepare], or a case in HEARTCASE_CASE") from None
    return build_phantom(params, Path(tempfile.gettempdir()) / "heartcase-benchmark-case")


def _pulled(inputs: Inputs, backend: Backend) -> tuple[Simulation, Grab]:
    """A hand has pulled the apex for a tenth of a second and holds it."""
    if backend not in inputs.memory:
        case = inputs.case
        try:
            simulation = Simulation(case.model, surface=case.surface, picking=case.picking, backend=backend)
        except SimulationError as error:
            raise MethodSkipped(str(error)) from None
        simulation.prepare()
        apex = next(mark for mark in case.manifest.landmarks if mark.name == "apex").points_mm[0]
        hand = simulation.grab(apex, 8.0)
        for part in (1, 2, 3):
            simulation.lead(hand, np.multiply(PULL_MM, part / 3))
            simulation.step(_steps_of_a_frame(simulation))
        inputs.memory[backend] = simulation, hand
    return inputs.memory[backend]


def _steps_of_a_frame(simulation: Simulation) -> int:
    return round(FRAME_S / simulation.step_s)


def _steps(simulation: Simulation, hand: Grab) -> None:
    simulation.step(_steps_of_a_frame(simulation))


def _surface(simulation: Simulation, hand: Grab) -> None:
    simulation.surface_now()


def _picking(simulation: Simulation, hand: Grab) -> None:
    simulation.picking_now()


def _force(simulation: Simulation, hand: Grab) -> None:
    simulation.force_on(hand)


def _method(work: Callable[[Simulation, Grab], None], backend: Backend) -> Callable[[Inputs], Output]:
    def run(inputs: Inputs) -> Output:
        work(*_pulled(inputs, backend))
        return Output(backend)

    return run


WORKS = {"steps": _steps, "surface": _surface, "picking": _picking, "force": _force}
METHODS = {f"{name}_{backend}": _method(work, backend) for backend in ("cpu", "cuda") for name, work in WORKS.items()}


def errors(inputs: Inputs, output: Output) -> dict[str, float]:
    """Surface of the frame against the CPU's over the same nodes."""
    simulation, _ = inputs.memory[output.backend]
    other = Simulation(inputs.case.model, surface=inputs.case.surface, backend="reference")
    other.restore(simulation.state)
    gap = np.abs(simulation.surface_now().vertices_mm - other.surface_now().vertices_mm).max()
    return {
        "surface to that of the CPU over the same nodes [mm]": float(gap),
        "nodes [1]": float(inputs.case.model.node_count),
        "vertices [1]": float(len(simulation.surface_now().vertices_mm)),
        "steps of a frame [1]": float(_steps_of_a_frame(simulation)),
    }
