"""Frames of a case in which tissue that rests is left out, and in which all is worked out.

Scenes: nothing is touched (``rest``); a hand has pulled the apex by 7 mm and holds it (``held``); it goes round in a
circle of 2 mm in a second (``led``); it creeps on by 0.5 mm/s (``creeping``).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from benchmarks.frame import FRAME_S, PULL_MM
from benchmarks.frame import prepare as prepare_frame
from heartcase.simulator.load import Case
from heartcase.simulator.simulation import Simulation

PULL_FRAMES = 10
DAMPING_PER_S = 30.0


@dataclass
class Run:
    """A scene that goes on by a frame whenever it is asked to."""

    case: Case
    scene: str
    sleep_mm: float
    frame_count: int = 0
    simulation: Simulation = field(init=False)

    def __post_init__(self) -> None:
        self.simulation = Simulation(self.case.model, damping_per_s=DAMPING_PER_S, sleep_mm=self.sleep_mm)
        self.simulation.prepare()
        self.steps = round(FRAME_S / self.simulation.step_s)
        if self.scene != "rest":
            apex = next(mark for mark in self.case.manifest.landmarks if mark.name == "apex").points_mm[0]
            self.hand = self.simulation.grab(apex, 8.0)

    def go_on(self) -> None:
        """The next frame."""
        self.frame_count += 1
        if self.scene != "rest":
            self.simulation.lead(self.hand, self._way(self.frame_count))
        self.simulation.step(self.steps)

    def _way(self, frame: int) -> Any:
        pulled = np.array(PULL_MM) * min(frame / PULL_FRAMES, 1.0)
        time_s = max(frame - PULL_FRAMES, 0) * FRAME_S
        if self.scene == "led":
            angle = 2.0 * np.pi * time_s
            return pulled + 2.0 * np.array([np.cos(angle) - 1.0, np.sin(angle), 0.0])
        return pulled + np.array([0.0, 0.0, 0.5 * time_s if self.scene == "creeping" else 0.0])


@dataclass(frozen=True)
class Inputs:
    """A case, and the run of each method once it has begun."""

    case: Case
    scene: str
    start_frames: int
    runs: dict[float, Run]


def prepare(params: dict[str, Any]) -> Inputs:
    scene, start_frames = params.pop("scene"), params.pop("start_frames")
    return Inputs(prepare_frame(params).case, scene, start_frames, {})


def _begun(inputs: Inputs, sleep_mm: float) -> Run:
    if sleep_mm not in inputs.runs:
        run = Run(inputs.case, inputs.scene, sleep_mm)
        for _ in range(inputs.start_frames):
            run.go_on()
        inputs.runs[sleep_mm] = run
    return inputs.runs[sleep_mm]


def _method(sleep_mm: float) -> Callable[[Inputs], Run]:
    def go_on(inputs: Inputs) -> Run:
        run = _begun(inputs, sleep_mm)
        run.go_on()
        return run

    return go_on


METHODS = {"all": _method(0.0), "sleeping": _method(0.05), "sleeping_ten_times": _method(0.5)}


def errors(inputs: Inputs, output: Run) -> dict[str, float]:
    """Against the same scene with all tissue worked out, at the last frame."""
    whole = Run(inputs.case, inputs.scene, 0.0)
    for _ in range(output.frame_count):
        whole.go_on()
    gap = np.linalg.norm(output.simulation.displacement_mm() - whole.simulation.displacement_mm(), axis=1)
    ours, true = output.simulation.energy().elastic_j, whole.simulation.energy().elastic_j
    return {
        "position to all tissue worked out [mm]": float(gap.max()),
        "elastic energy to that [1]": abs(ours - true) / true if true else abs(ours),
        "nodes [1]": float(inputs.case.model.node_count),
        "steps of a frame [1]": float(output.steps),
    }
