"""The parts of a frame of a finished case: steps of 1/30 s, surface, picking surface, force on a hand, on CPU and GPU.

``surface_cpu`` and ``picking_cpu`` work out every vertex. ``surface_tenth_cpu`` and its like show a surface of which
nothing, the tenth around the apex or all moves from frame to frame, and take over the rest; ``surface_tenth_whole_cpu``
and its like work it out whole; these on one thread.

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

from benchmarks.runner.cases import MethodSkipped
from heartcase.schemas.errors import SimulationError
from heartcase.simulator.engine.backends import Backend
from heartcase.simulator.instruments.grab import Grab
from heartcase.simulator.load import Case, load_case
from heartcase.simulator.simulation import Simulation
from heartcase.simulator.surface.deform import DeformedSurface, deform
from heartcase.simulator.surface.followers import SurfaceFollower

FRAME_S = 1 / 30
PULL_MM = (4.0, -3.0, 5.0)


@dataclass
class Followed:
    """A surface that is shown over two fields of displacement in turn."""

    follower: SurfaceFollower
    displacements: tuple[Any, Any]
    frame_count: int = 0

    def show(self) -> tuple[Any, DeformedSurface]:
        """The next field, and the surface over it."""
        displacement = self.displacements[self.frame_count % 2]
        self.frame_count += 1
        return displacement, self.follower.now(displacement)


@dataclass(frozen=True)
class Inputs:
    """A case, and the simulation of each backend once it is made."""

    case: Case
    memory: dict[Backend, tuple[Simulation, Grab]]
    followed: dict[tuple[float, bool], Followed]


@dataclass(frozen=True)
class Output:
    """Which backend did the work, and what a surface that was followed showed over which displacement."""

    backend: Backend
    shown: tuple[Any, DeformedSurface] | None = None


def prepare(params: dict[str, Any]) -> Inputs:
    path = Path(os.environ["HEARTCASE_CASE"]) if "HEARTCASE_CASE" in os.environ else built_case(params)
    return Inputs(load_case(path, needs=("surface", "tangents", "picking")), {}, {})


def built_case(params: dict[str, Any]) -> Path:
    try:
        from benchmarks.build import build_phantom
    except ImportError:
        raise MethodSkipped("it needs the extra [prepare], or a case in HEARTCASE_CASE") from None
    return build_phantom(params, Path(tempfile.gettempdir()) / "heartcase-benchmark-case")


def _pulled(inputs: Inputs, backend: Backend) -> tuple[Simulation, Grab]:
    """A hand has pulled the apex for a tenth of a second and holds it."""
    if backend not in inputs.memory:
        case = inputs.case
        try:
            surfaces = {"surface": case.surface, "picking": case.picking}
            simulation = Simulation(case.model, **surfaces, backend=backend, skips_unmoved=False, sleep_mm=0.0)
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


def _followed(inputs: Inputs, share: float, skips_unmoved: bool) -> Followed:
    """The pulled surface, and the same with the nodes moved that are nearest to the apex."""
    if (share, skips_unmoved) not in inputs.followed:
        case, surface = inputs.case, inputs.case.surface
        pulled = _pulled(inputs, "cpu")[0].state.displacement
        apex = next(mark for mark in case.manifest.landmarks if mark.name == "apex").points_mm[0]
        way = np.linalg.norm(surface.rest_mm - np.asarray(apex), axis=1)
        moved = np.linalg.norm(case.model.rest_positions_mm() - apex, axis=1) < np.quantile(way, share)
        moved |= share == 1.0
        other = pulled + np.where(moved[:, None] & (share > 0.0), np.float32(0.01), np.float32(0.0))
        followed = Followed(SurfaceFollower(case.model, surface, skips_unmoved=skips_unmoved), (pulled, other))
        followed.show()
        inputs.followed[share, skips_unmoved] = followed
    return inputs.followed[share, skips_unmoved]


def _follow(share: float, skips_unmoved: bool) -> Callable[[Inputs], Output]:
    def run(inputs: Inputs) -> Output:
        followed = _followed(inputs, share, skips_unmoved)
        return Output("cpu", followed.show())

    return run


WORKS = {"steps": _steps, "surface": _surface, "picking": _picking, "force": _force}
METHODS = {f"{name}_{backend}": _method(work, backend) for backend in ("cpu", "cuda") for name, work in WORKS.items()}
SHARES = {"still": 0.0, "tenth": 0.1, "all": 1.0}
METHODS |= {f"surface_{name}_cpu": _follow(share, True) for name, share in SHARES.items()}
METHODS |= {f"surface_{name}_whole_cpu": _follow(share, False) for name, share in SHARES.items()}


def errors(inputs: Inputs, output: Output) -> dict[str, float]:
    """Surface of the frame against the CPU's over the same nodes."""
    if output.shown is not None:
        return _errors_followed(inputs, *output.shown)
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


def _errors_followed(inputs: Inputs, displacement: Any, frame: DeformedSurface) -> dict[str, float]:
    """What a followed surface shows against all of it worked out, and how much of it moved."""
    case = inputs.case
    whole = deform(case.model, case.surface, displacement)
    pairs = ((frame.vertices_mm, whole.vertices_mm), (frame.normals, whole.normals), (frame.tangents, whole.tangents))
    (followed,) = inputs.followed.values()
    now, before = (deform(case.model, case.surface, field).vertices_mm for field in followed.displacements)
    return {
        "surface to the one worked out whole [mm]": float(np.abs(frame.vertices_mm - whole.vertices_mm).max()),
        "numbers of which a bit differs [1]": float(sum((a.view("i4") != b.view("i4")).sum() for a, b in pairs)),
        "vertices [1]": float(len(now)),
        "of them moved [1]": float((now != before).any(axis=1).sum()),
    }
