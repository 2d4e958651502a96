"""The servo loop beside the simulation: a process of its own, 1,000 updates a second.

A process, not a thread: kernels run without the interpreter's lock, but NumPy and Python between them hold it for
longer than an update may wait (``python -m benchmarks haptics`` measures both).
"""

from __future__ import annotations

import contextlib
import gc
import multiprocessing
import os
import signal
import time
from collections.abc import Callable, Sequence
from multiprocessing.connection import Connection
from typing import Any

import numpy as np

from heartcase.schemas.arrays import Float64
from heartcase.schemas.errors import HeartcaseError, Problem, SimulationError, UsageError
from heartcase.simulator.haptics.channel import Channel
from heartcase.simulator.haptics.device import DeviceSpec, HapticDevice, NamedDevice
from heartcase.simulator.haptics.loop import LoopNumbers
from heartcase.simulator.haptics.settings import ServoSettings

__all__ = ["LOG_WIDTH", "HapticServo", "run_loop"]

LOG_WIDTH = 4
"""Numbers of an update in a log: time, number of the tissue's state, time of that state, part that was put out."""
_SPIN_S = 2e-4
"""The last part of a wait is spent looking at the clock: a sleep may end late by more than this, s."""
_START_S = 60.0
"""Longest time for the process to start, s."""


class HapticServo:
    """The loop in a process of its own; as a context it starts, and ends with all force taken away.

    A program that starts one must guard its own start with ``if __name__ == "__main__":``, as for any process.

    Parameters
    ----------
    devices
        One for each hand.
    settings
        Coupling, limits, fade; the defaults when left out.
    log_count
        Updates of the first device of which times are kept, for measurements.

    Raises
    ------
    UsageError
        What is given is no list of :class:`DeviceSpec`.
    """

    def __init__(
        self, devices: Sequence[DeviceSpec], settings: ServoSettings | None = None, *, log_count: int = 0
    ) -> None:
        self.devices = _checked(devices)
        self.settings = settings or ServoSettings()
        self.channels = tuple(Channel() for _ in self.devices)
        context = multiprocessing.get_context("spawn")
        self._log = context.RawArray("d", LOG_WIDTH * log_count)
        self._stop = context.RawValue("b", 0)
        self._told, self._tells = context.Pipe(duplex=False)
        memories = tuple(channel.memories for channel in self.channels)
        arguments = (self.devices, memories, self.settings, self._stop, self._tells, self._log)
        self._process = context.Process(target=_serve, args=arguments, daemon=True, name="heartcase-haptics")

    def __enter__(self) -> HapticServo:
        """Start, and wait until the devices are open.

        Raises
        ------
        SimulationError
            A device cannot be opened, or the process does not start.
        """
        self._process.start()
        self._tells.close()
        is_told = self._told.poll(_START_S)
        try:
            said = self._told.recv() if is_told else "it did not start within a minute"
        except EOFError:
            said = "it ended before it had begun"
        if said:
            self._end()
            raise SimulationError(f"the haptic loop cannot run: {said}", place="haptics")
        return self

    def __exit__(self, *_: object) -> None:
        """End the loop."""
        self._end()

    def check(self) -> None:
        """Complain if the loop has ended by itself.

        Raises
        ------
        SimulationError
            It has; all force was taken away.
        """
        if self._process.is_alive():
            return
        said = ""
        with contextlib.suppress(EOFError, OSError):
            said = self._told.recv() if self._told.poll() else ""
        raise SimulationError(f"the haptic loop has ended: {said or 'it was killed'}; make another", place="haptics")

    def log(self) -> Float64:
        """Time, number of the tissue's state, its time, and part that was put out, of the updates kept; (count, 4)."""
        rows: Float64 = np.frombuffer(self._log, dtype=np.float64).reshape(-1, LOG_WIDTH)
        return rows[rows[:, 0] > 0.0].copy()

    def _end(self) -> None:
        self._stop.value = 1
        self._process.join(2.0)
        if self._process.is_alive():
            self._process.terminate()
            self._process.join()
        self._told.close()


def _checked(devices: Sequence[DeviceSpec]) -> tuple[DeviceSpec, ...]:
    """The devices as they were given, or UsageError."""
    if isinstance(devices, str | DeviceSpec):
        raise UsageError("is a list of them, also where it is one: write [DeviceSpec(...)]", place="devices")
    problems = [
        Problem(f"devices[{number}]", f"must be a DeviceSpec, such as DeviceSpec('mouse', {{...}}) (found {one!r})")
        for number, one in enumerate(devices, start=1)
        if not isinstance(one, DeviceSpec)
    ]
    if problems:
        raise UsageError(problems)
    return tuple(devices)


def run_loop(
    devices: Sequence[HapticDevice],
    channels: Sequence[Channel],
    settings: ServoSettings,
    is_ended: Callable[[], bool],
    log: Float64 | None = None,
) -> None:
    """Read, reckon and write until it is ended; then all force is taken away, whatever happened.

    An update is begun :attr:`ServoSettings.ahead_s` before it is due, and what it put out is written when it is due: a
    sleep that ends late, and caches that the simulation has filled, are made up for by then.

    Parameters
    ----------
    devices
        One for each hand, open.
    channels
        One for each device.
    settings
        Coupling, limits, fade.
    is_ended
        Asked once an update.
    log
        Where times of the first device's updates go, shape (count, 4).
    """
    try:
        LoopNumbers.prepare()
        began_s = time.perf_counter()
        readings = [device.read(0.0) for device in devices]
        loops = [LoopNumbers(began_s, reading, settings) for reading in readings]
        due_s, number = began_s, 0
        began = [began_s] * len(devices)
        waited = [settings.ahead_s] * len(devices)
        while not is_ended():
            due_s = _wait_for_begin(due_s + settings.period_s, settings)
            numbers, finished_s = [], 0.0
            for place, (device, channel, loop) in enumerate(zip(devices, channels, loops, strict=True)):
                now_s = began[place] = time.perf_counter()
                reading = device.read(now_s - began_s)
                sample_number, tissue = channel.tissue_row()
                loop.update(now_s, reading, tissue, waited[place])
                felt = (loop.part, loop.energy_mj)
                channel.publish_tool(now_s, loop.pose, loop.load, felt, reading.buttons, sample_number)
                numbers.append(sample_number)
                if tissue is not None and place == 0:
                    finished_s = float(tissue[0])
            # A sleep would end late.
            while time.perf_counter() < due_s:
                pass
            for place, (device, loop) in enumerate(zip(devices, loops, strict=True)):
                device.write(loop.load[0].copy(), loop.load[1].copy())
                written_s = time.perf_counter()
                waited[place] = written_s - began[place]
                if log is not None and place == 0 and number < len(log):
                    log[number] = written_s, numbers[0], finished_s, loop.part
            number += 1
    finally:
        for device in devices:
            _take_all_force_away(device)


def _take_all_force_away(device: HapticDevice) -> None:
    """Of one device, and give it back; one that fails leaves no other one pushing."""
    with contextlib.suppress(Exception):
        device.write(np.zeros(3), np.zeros(3))
    with contextlib.suppress(Exception):
        device.close()


def _wait_for_begin(due_s: float, settings: ServoSettings) -> float:
    """Wait until an update is to be begun; when it is due: one that was missed by a whole period is left out."""
    begin_s = due_s - settings.ahead_s
    left_s = begin_s - _SPIN_S - time.perf_counter()
    if left_s > 0.0:
        time.sleep(left_s)
    while (now_s := time.perf_counter()) < begin_s:
        pass
    return due_s if now_s < due_s + settings.period_s else now_s


def _serve(
    devices: tuple[DeviceSpec, ...],
    memories: tuple[tuple[Any, Any], ...],
    settings: ServoSettings,
    stop: Any,
    tells: Connection,
    log: Any,
) -> None:
    """The process: open, say so, run; say what went wrong."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    opened: list[HapticDevice] = []
    try:
        for spec in devices:
            opened.append(NamedDevice(spec))
    except Exception as error:
        for device in opened:
            _take_all_force_away(device)
        tells.send(_words_of(error))
        return
    LoopNumbers.prepare()
    tells.send("")
    _hurry()
    parent = multiprocessing.parent_process()
    parent_number = parent.pid if parent is not None else None

    def is_ended() -> bool:
        # Without its parent nobody could end it.
        return bool(stop.value) or os.getppid() != parent_number

    rows = np.frombuffer(log, dtype=np.float64).reshape(-1, LOG_WIDTH)
    try:
        run_loop(opened, [Channel(memory) for memory in memories], settings, is_ended, rows)
    except Exception as error:
        tells.send(_words_of(error))


def _words_of(error: Exception) -> str:
    """One line for the other process; of what nobody has foreseen its kind must do."""
    if isinstance(error, HeartcaseError):
        return "; ".join(map(str, error.problems))
    return f"it failed with {type(error).__name__}"


def _hurry() -> None:
    """Never stop to look for garbage, of which there is next to none; be woken before others where that is allowed."""
    gc.collect()
    gc.disable()
    if not hasattr(os, "sched_setscheduler"):
        return
    try:
        os.sched_setscheduler(0, os.SCHED_RR, os.sched_param(os.sched_get_priority_min(os.SCHED_RR)))
    except OSError:
        return
    # On one core for good: else the simulation makes way for it on one core after the other.
    with contextlib.suppress(OSError, AttributeError):
        os.sched_setaffinity(0, {max(os.sched_getaffinity(0))})
