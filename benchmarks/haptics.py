"""Forces on a hand at 1 kHz beside a running heart with its surface: how evenly they come, and how late.

A recorded hand leads the apex in a circle. The simulation takes steps in parts of 4 ms and shows its surface, up to
real time, for ``seconds``; ``HEARTCASE_HAPTICS_SECONDS=600`` makes it ten minutes. The servo loop is a process of its
own (``heartcase``), or a thread beside the simulation (``thread``). ``HEARTCASE_HAPTICS_PLOTS`` names a folder for
pictures of the intervals between updates.

The errors are what a hand would notice: updates that came later than 1.2 ms after the one before, the time from a state
of the tissue to the first force from it, the energy that the hand got.
"""

from __future__ import annotations

import contextlib
import os
import threading
import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.frame import prepare as prepare_frame
from benchmarks.haptics_jitter import jitter
from heartcase.schemas.arrays import Float64
from heartcase.simulator.haptics.channel import Channel
from heartcase.simulator.haptics.device import DeviceSpec, open_device
from heartcase.simulator.haptics.led import LedGrab
from heartcase.simulator.haptics.poses import ToolPose
from heartcase.simulator.haptics.servo import LOG_WIDTH, HapticServo, run_loop
from heartcase.simulator.haptics.settings import ServoSettings
from heartcase.simulator.haptics.tissue_side import FeltInstrument, TissueSide
from heartcase.simulator.load import Case
from heartcase.simulator.simulation import Simulation

FRAME_S = 1 / 60
PART_S = 0.004
RADIUS_MM = 4.0
LEAD_S = 1.0
"""Time at the start that is not looked at, s."""
EDGES_MS = (0.0, 0.9, 1.1, 1.2, 1.5, 2.0, 5.0, 20.0, np.inf)


@dataclass(frozen=True)
class Inputs:
    """A case, and for how long it runs."""

    case: Case
    seconds: float


@dataclass(frozen=True)
class Output:
    """What was kept of a run."""

    log: Float64
    """Time, number of the tissue's state, its time, part of the force that was put out, shape (count, 4)."""
    energy_mj: float
    """What the hand has put in less what it got back, mJ."""
    simulated_s: float
    """Simulated time, s."""
    surface_count: int
    """Surfaces shown."""


def prepare(params: dict[str, Any]) -> Inputs:
    seconds = float(os.environ.get("HEARTCASE_HAPTICS_SECONDS", params["seconds"]))
    return Inputs(prepare_frame(params).case, seconds)


def circle(center_mm: Float64, seconds: float) -> DeviceSpec:
    """A hand that goes out by the radius and round in a circle once in two seconds."""
    times = np.arange(0.0, seconds + 0.02, 0.02)
    radius = RADIUS_MM * np.clip(times / LEAD_S, 0.0, 1.0)
    angle = np.pi * times
    way = np.stack([radius * np.cos(angle), radius * np.sin(angle), 0.3 * radius], axis=1)
    return DeviceSpec("trajectory", {"times_s": times, "positions_mm": center_mm + way})


@contextlib.contextmanager
def in_process(device: DeviceSpec, settings: ServoSettings, log_count: int) -> Iterator[tuple[Channel, Any]]:
    with HapticServo([device], settings, log_count=log_count) as servo:
        yield servo.channels[0], servo.log


@contextlib.contextmanager
def in_thread(device: DeviceSpec, settings: ServoSettings, log_count: int) -> Iterator[tuple[Channel, Any]]:
    channel, ends, log = Channel(), threading.Event(), np.zeros((log_count, LOG_WIDTH))
    arguments = ([open_device(device)], [channel], settings, ends.is_set, log)
    thread = threading.Thread(target=run_loop, args=arguments)
    thread.start()
    try:
        yield channel, lambda: log[log[:, 0] > 0.0]
    finally:
        ends.set()
        thread.join()


def _run(inputs: Inputs, name: str, beside: Any) -> Output:
    settings = ServoSettings()
    simulation = Simulation(inputs.case.model, surface=inputs.case.surface)
    simulation.prepare()
    apex = np.array(next(mark for mark in inputs.case.manifest.landmarks if mark.name == "apex").points_mm[0])
    led = LedGrab(simulation, simulation.grab(apex, 8.0), ToolPose.at(apex))
    steps = round(PART_S / simulation.step_s)
    parts = max(round(FRAME_S / (steps * simulation.step_s)), 1)
    seconds = inputs.seconds + LEAD_S
    surface_count, simulated_s = 0, simulation.time_s
    side = TissueSide()
    with beside(circle(apex, seconds), settings, int(1.2 * settings.rate_hz * seconds) + 1000) as (channel, log):
        side.felt.append(FeltInstrument(led, channel, settings))
        began_s = time.perf_counter()
        while (passed_s := time.perf_counter() - began_s) < seconds:
            if simulation.time_s - simulated_s > passed_s:
                time.sleep(0.0005)
                continue
            side.segment(parts, lambda: simulation.step(steps))
            simulation.surface_now()
            surface_count += 1
        felt = channel.felt()
    rows = log()
    kept = rows[rows[:, 0] > rows[0, 0] + LEAD_S]
    if "HEARTCASE_HAPTICS_PLOTS" in os.environ:
        draw(kept, Path(os.environ["HEARTCASE_HAPTICS_PLOTS"]) / f"haptics-{name}.png")
    energy_mj = float("nan") if felt is None else felt.energy_mj
    return Output(kept, energy_mj, simulation.time_s - simulated_s, surface_count)


def process(inputs: Inputs) -> Output:
    return _run(inputs, "process", in_process)


def thread(inputs: Inputs) -> Output:
    return _run(inputs, "thread", in_thread)


def draw(log: Float64, path: Path) -> None:
    """Intervals between updates: over time, and how many of each length."""
    from matplotlib.figure import Figure

    intervals = np.diff(log[:, 0]) * 1e3
    figure = Figure(figsize=(9, 4), layout="constrained")
    over_time, counted = figure.subplots(1, 2, width_ratios=(2, 1), sharey=True)
    over_time.plot(log[1:, 0] - log[0, 0], intervals, ".", markersize=1.5)
    counted.hist(intervals, bins=np.geomspace(0.1, max(intervals.max(), 10.0), 120), orientation="horizontal", log=True)
    for axes in (over_time, counted):
        axes.axhline(1.2, color="#d55e00", linewidth=1)
        axes.set_yscale("log")
    over_time.set(xlabel="time [s]", ylabel="between two updates [ms]")
    counted.set(xlabel="updates")
    path.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(path, dpi=120)


METHODS = {"heartcase": process, "thread": thread}


def errors(inputs: Inputs, output: Output) -> dict[str, float]:
    """What a hand would notice, and the histogram of intervals."""
    found = jitter(output.log[:, 0], output.log[:, 1], output.log[:, 2])
    count, _ = np.histogram(np.diff(output.log[:, 0]) * 1e3, np.array(EDGES_MS))
    figures = {
        "updates later than 1.2 ms [1]": 1.0 - found.in_time,
        "updates [1]": float(found.update_count),
        "interval, median [ms]": found.interval_ms[0],
        "interval, 99.9% [ms]": found.interval_ms[1],
        "interval, longest [ms]": found.interval_ms[2],
        "state to force, median [ms]": found.latency_ms[0],
        "state to force, 99.9% [ms]": found.latency_ms[1],
        "state to force, longest [ms]": found.latency_ms[2],
        "updates with all of the force [1]": float((output.log[:, 3] >= 1.0).mean()),
        "energy that the hand got [mJ]": -output.energy_mj,
        "simulated over passed time [1]": output.simulated_s / (inputs.seconds + LEAD_S),
        "surfaces a second [1/s]": output.surface_count / (inputs.seconds + LEAD_S),
    }
    for low, high, part in zip(EDGES_MS[:-1], EDGES_MS[1:], count / count.sum(), strict=True):
        figures[f"intervals of {low:g} to {high:g} ms [1]"] = float(part)
    return figures
