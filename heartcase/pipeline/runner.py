"""Runs a build's stages through the cache, and tells who listens how it goes on."""

from __future__ import annotations

import hashlib
import json
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any, Generic, Protocol, TypeVar, cast

from heartcase.pipeline.artifacts import artifact_to_bytes
from heartcase.pipeline.cache import Cache, stage_key
from heartcase.pipeline.side_by_side import may_share, side_by_side
from heartcase.schemas.bundle import StageRecord
from heartcase.schemas.files import atomic_write

__all__ = [
    "SECONDS_GUESSED",
    "STAGES",
    "STAGE_VERSIONS",
    "BuildListener",
    "Job",
    "Node",
    "Runner",
    "SilentListener",
    "UncachedRunner",
]

T = TypeVar("T")
U = TypeVar("U")

STAGE_VERSIONS = {
    "read": 3,
    "markers": 1,
    "filter": 3,
    "segment": 4,
    "walls": 13,
    "edit": 5,
    "grid": 10,
    "surface": 13,
    "map": 9,
    "bundle": 7,
}
"""Raised whenever a stage's output changes for the same input, so that the cache forgets the old one."""

STAGES = tuple(STAGE_VERSIONS)
"""The stages in their order."""

SECONDS_GUESSED = {
    "filter": 2.0,
    "segment": 5.0,
    "walls": 6.0,
    "edit": 1.0,
    "grid": 4.0,
    "surface": 12.0,
    "map": 2.0,
    "bundle": 6.0,
}
"""First estimate for a scan of a million voxels, until a build has measured."""


class BuildListener(Protocol):
    """Who wants to know how a build goes on."""

    def stage_started(self, stage: str, *, seconds_expected: float, seconds_after: float) -> None:
        """Note that a stage begins to compute, how long it may take, and how long the stages after it may take."""

    def stage_finished(self, stage: str, *, seconds: float, reused: bool) -> None:
        """Note that a stage has its output, computed or found in the cache."""


class SilentListener:
    """Listens to nothing."""

    def stage_started(self, stage: str, *, seconds_expected: float, seconds_after: float) -> None:
        """Do nothing."""

    def stage_finished(self, stage: str, *, seconds: float, reused: bool) -> None:
        """Do nothing."""


@dataclass
class Node(Generic[T]):
    """A stage's output: its hash at once, itself when somebody needs it."""

    sha256: str
    fetch: Callable[[], T]
    value: T | None = None

    def get(self) -> T:
        """The output, computed or loaded when it was not yet."""
        if self.value is None:
            self.value = self.fetch()
        return self.value


@dataclass(frozen=True)
class Job(Generic[T]):
    """What a stage is to compute."""

    stage: str
    settings: Any
    inputs: Mapping[str, Node[Any]]
    compute: Callable[[], T]
    kind: type[T]


@dataclass
class Runner:
    """Runs stages through the cache and remembers how."""

    cache: Cache
    listener: BuildListener
    force: bool
    voxel_count: int = 1_000_000
    seconds: dict[str, float] = field(default_factory=dict)
    reused: list[str] = field(default_factory=list)
    records: list[StageRecord] = field(default_factory=list)

    def run(self, job: Job[T], *, done: tuple[T, float] | None = None) -> Node[T]:
        """Find the stage's output, or compute and keep it; ``done``: it is computed already, in so many seconds."""
        stage, settings = job.stage, job.settings
        version, key = STAGE_VERSIONS[stage], _key_of(job)
        entry = None if self.force else self.cache.find(stage, key)
        node: Node[T]

        def compute_and_store() -> T:
            self.announce(stage)
            output, seconds = done or _timed(job.compute)
            start = time.perf_counter()
            self.learn(stage, seconds)
            stored = self.cache.store(stage, key, output, seconds=seconds + time.perf_counter() - start)
            node.sha256 = stored.output_sha256
            self.seconds[stage] = stored.seconds
            self.listener.stage_finished(stage, seconds=stored.seconds, reused=False)
            return output

        def fetch() -> T:
            cached = self.cache.load(stage, key, job.kind)
            if cached is not None:
                return cached
            self.reused.remove(stage)
            return compute_and_store()

        node = Node("", fetch)
        if entry is None:
            node.value = compute_and_store()
        else:
            node.sha256 = entry.output_sha256
            self.seconds[stage] = entry.seconds
            self.reused.append(stage)
            self.listener.stage_finished(stage, seconds=entry.seconds, reused=True)
        self.records.append(
            StageRecord(stage=stage, version=version, settings=_as_dict(settings), output_sha256=node.sha256)
        )
        return node

    def run_both(self, job: Job[T], longer: Job[U]) -> tuple[Node[T], Node[U]]:
        """Find or compute the outputs of two stages of which neither needs the other, and compute at the same time.

        The longer one runs in this thread, so that it can be interrupted, and is the one that the listener hears of.
        Stages are recorded in the order of the arguments.
        """
        is_kept = not self.force and any(self.cache.find(one.stage, _key_of(one)) for one in (job, longer))
        if is_kept or not may_share():
            return self.run(job), self.run(longer)
        for node in (*job.inputs.values(), *longer.inputs.values()):
            node.get()
        second, done = side_by_side(lambda: self.run(longer), lambda: _timed(job.compute))
        first = self.run(job, done=done)
        self.records[-2:] = reversed(self.records[-2:])
        return first, second

    def run_always(self, stage: str, *, settings: Any, compute: Callable[[], T]) -> Node[T]:
        """Compute a stage that is cheap or whose input is outside the cache's sight."""
        self.announce(stage)
        start = time.perf_counter()
        value = compute()
        node = Node(hashlib.sha256(artifact_to_bytes(value)).hexdigest(), lambda: value, value)
        self.seconds[stage] = time.perf_counter() - start
        self.listener.stage_finished(stage, seconds=self.seconds[stage], reused=False)
        self.records.append(
            StageRecord(
                stage=stage,
                version=STAGE_VERSIONS[stage],
                settings=_as_dict(settings),
                output_sha256=node.sha256,
            )
        )
        return node

    def announce(self, stage: str) -> None:
        """Tell the listener that a stage begins, with the time it took before, scaled to this scan."""
        after = sum(self._expected(later) for later in STAGES[STAGES.index(stage) + 1 :])
        self.listener.stage_started(stage, seconds_expected=self._expected(stage), seconds_after=after)

    def _rates(self) -> dict[str, float]:
        try:
            data = json.loads((self.cache.directory / "rates.json").read_bytes())
            return {str(stage): float(seconds) for stage, seconds in data.items()}
        except (OSError, ValueError, AttributeError, TypeError):
            return {}

    def _expected(self, stage: str) -> float:
        rate = self._rates().get(stage, SECONDS_GUESSED.get(stage, 1.0))
        return rate * self.voxel_count / 1e6

    def learn(self, stage: str, seconds: float) -> None:
        """Remember how long a stage took, per million voxels."""
        rates = self._rates() | {stage: round(seconds * 1e6 / max(self.voxel_count, 1), 3)}
        atomic_write(self.cache.directory / "rates.json", json.dumps(rates, sort_keys=True).encode())


class UncachedRunner(Runner):
    """Computes every stage and keeps nothing: for a single stage, whose output the user names a file for."""

    def __init__(self) -> None:
        super().__init__(cast("Cache", None), SilentListener(), force=True)

    def run(self, job: Job[T], *, done: tuple[T, float] | None = None) -> Node[T]:
        """Compute the stage."""
        return self.run_always(job.stage, settings=job.settings, compute=(lambda: done[0]) if done else job.compute)

    def announce(self, stage: str) -> None:
        """Tell nobody."""

    def learn(self, stage: str, seconds: float) -> None:
        """Remember nothing."""


def _key_of(job: Job[Any]) -> str:
    hashes = {name: node.sha256 for name, node in job.inputs.items()}
    return stage_key(stage=job.stage, version=STAGE_VERSIONS[job.stage], settings=job.settings, inputs=hashes)


def _timed(compute: Callable[[], T]) -> tuple[T, float]:
    """An output and the seconds it took."""
    start = time.perf_counter()
    output = compute()
    return output, time.perf_counter() - start


def _as_dict(settings: Any) -> dict[str, Any]:
    return settings if isinstance(settings, dict) else {"settings": settings}
