"""A servo loop in made-up time, beside a tissue whose states come late and unevenly: what a busy machine does to it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

from heartcase.simulator.haptics.alignment import Alignment, pose_at, segment_times
from heartcase.simulator.haptics.coupling import TissueSample, stiffness_seen
from heartcase.simulator.haptics.device import DeviceReading
from heartcase.simulator.haptics.loop import ServoState, first_state, servo_update
from heartcase.simulator.haptics.poses import ToolPose, turn_by, vector_of
from heartcase.simulator.haptics.settings import ServoSettings

PARTS = 4


@dataclass(frozen=True)
class Run:
    """What happened."""

    given_mj: float
    """Energy that the hand got, mJ."""
    times_s: np.ndarray
    loads: np.ndarray
    """What was put out, shape (count, 2, 3)."""
    parts: np.ndarray
    hands: np.ndarray
    """Positions of the hand, shape (count, 3)."""
    tools: np.ndarray


def closed_path(seed: int, *, seconds: float, hz: float = 4.0, mm: float = 5.0, rad: float = 0.2):
    """A smooth random path of position and rotation vector that ends where it began, and rests at both ends."""
    rng = np.random.default_rng(seed)
    size = rng.normal(size=(6, 5)) * np.array([mm] * 3 + [rad] * 3)[:, None] / 5**0.5
    phase, rate = rng.uniform(0, 2 * np.pi, (6, 5)), rng.uniform(0, hz, (6, 5))

    def at(time_s: float) -> np.ndarray:
        time_s = min(time_s, seconds)
        waves = (size * np.sin(2 * np.pi * rate * time_s + phase)).sum(axis=1)
        return np.sin(np.pi * time_s / seconds) ** 2 * waves

    return at


def spring(seed: int, n_mm: float) -> Callable[[ToolPose], np.ndarray]:
    """A tissue that pulls a tool back to a place: elastic, unlike in its directions, and it resists rotation."""
    rng = np.random.default_rng(seed)
    root = rng.normal(size=(3, 3))
    matrix = root @ root.T
    matrix *= n_mm / np.linalg.eigvalsh(matrix).max()
    return lambda pose: np.stack([-matrix @ pose.position_mm, -200.0 * vector_of(pose.turn)])


def wall(seed: int, n_mm: float) -> Callable[[ToolPose], np.ndarray]:
    """A tissue that pushes a tool out of a half space: it is touched and left."""
    normal = np.random.default_rng(seed).normal(size=3)
    normal /= np.linalg.norm(normal)

    def load(pose: ToolPose) -> np.ndarray:
        return np.stack([max(-pose.position_mm @ normal, 0.0) * n_mm * normal, np.zeros(3)])

    return load


def publish(channel, state: ServoState, buttons=(), sample_number=0) -> None:
    """What the loop in NumPy did, as the loop itself hands it over."""
    pose = np.concatenate([state.tool.pose.position_mm, state.tool.pose.turn.ravel()])
    felt = (state.part, state.account.energy_mj)
    channel.publish_tool(state.time_s, pose, state.load, felt, buttons, sample_number)


def work_on_hand(state: ServoState, hand_at, time_s: float, settings: ServoSettings) -> float:
    """Work from an update to a time before the next, mJ: what was put out before acts on until the update is due."""
    due, hand = hand_at(min(state.time_s + settings.ahead_s, time_s)), hand_at(time_s)
    return float(np.vdot(state.earlier, state.hand.gap_to(due)) + np.vdot(state.load, due.gap_to(hand)))


def run(
    path,
    tissue,
    *,
    seconds: float,
    seed: int = 0,
    settings: ServoSettings | None = None,
    is_naive: bool = False,
    segments=None,
    ticks=None,
) -> Run:
    """Lead a hand along a path.

    ``segments`` gives the length of each segment of the simulation from its number, s; 2 to 30 ms, and now and then
    up to 80, when left out. ``ticks`` gives that of each update. A naive loop puts out the newest force as it is, and
    its steps take the pose of their own moment.
    """
    rng = np.random.default_rng(seed)
    settings = settings or ServoSettings()
    segments = segments or (lambda _: rng.uniform(0.002, 0.03) if rng.random() < 0.9 else rng.uniform(0.03, 0.08))
    ticks = ticks or (lambda _: rng.choice([0.001, 0.001, 0.001, 0.0012, 0.0025]))

    def hand_at(time_s: float) -> ToolPose:
        now = path(time_s)
        return ToolPose(now[:3], turn_by(now[3:]))

    state: ServoState = first_state(0.0, DeviceReading(hand_at(0.0)))
    history = [(0.0, state.tool.pose)]
    alignment, segment_end, segment_number = Alignment(0.0, 0.0, 0.0), segments(0), 0
    coming: list[tuple[float, TissueSample]] = []
    states: list[tuple[ToolPose, np.ndarray]] = []
    sample, stiffness, given, rows = None, np.zeros(2), 0.0, []
    time_s, number = 0.0, 0
    while time_s < seconds + 0.1:
        step_s = float(ticks(number))
        time_s, number = time_s + step_s, number + 1
        hand = hand_at(time_s)
        moved = state.hand.gap_to(hand)
        if is_naive:
            given += float(np.vdot(state.load, moved))
        else:
            given += work_on_hand(state, hand_at, time_s, settings)
        while coming and coming[0][0] <= time_s:
            sample = coming.pop(0)[1]
        if time_s >= segment_end:
            segment_number += 1
            length_s = segments(segment_number)
            alignment, wanted_s = segment_times(alignment, time_s, PARTS)
            times = np.array([at for at, _ in history])
            positions, turns = (np.stack([getattr(p, n) for _, p in history]) for n in ("position_mm", "turn"))
            for part, wanted in enumerate(wanted_s.tolist()):
                pose = history[-1][1] if is_naive else pose_at(times, positions, turns, wanted)
                states = [*states[-15:], (pose, tissue(pose))]
                if len(states) > 1:
                    gaps = np.stack([a[0].gap_to(b[0]) for a, b in pairwise(states)])
                    seen = stiffness_seen(gaps, np.stack([b[1] - a[1] for a, b in pairwise(states)]), 30.0)
                    stiffness = stiffness if seen is None else seen
                arrives_s = time_s + length_s * (part + 1) / PARTS
                coming.append((arrives_s, TissueSample(arrives_s, pose, states[-1][1], stiffness)))
            segment_end = time_s + length_s
        if is_naive:
            load = np.zeros((2, 3)) if sample is None else sample.load
            tool = replace(state.tool, pose=hand)
            state = replace(state, time_s=time_s, hand=hand, tool=tool, load=load)
        else:
            state = servo_update(state, time_s, DeviceReading(hand, moved / step_s), sample, settings)
        history = [*history[-499:], (time_s, state.tool.pose)]
        rows.append((time_s, state.load, state.part, hand.position_mm, state.tool.pose.position_mm))
    times_s, loads, parts, hands, tools = (np.array(column) for column in zip(*rows, strict=True))
    return Run(given, times_s, loads, parts, hands, tools)
