"""Runs a build's stages through the cache, and tells who listens how it goes on."""

from __future__ import annotations

import hashlib
import json
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any, Generic, Protocol, TypeVar

from heartcase.pipeline.artifacts import artifact_to_bytes
from heartcase.pipeline.cache import Cache, stage_key
from heartcase.schemas.bundle import StageRecord
from heartcase.schemas.files import atomic_write

__all__ = ["SECONDS_GUESSED", "STAGES", "STAGE_VERSIONS", "BuildListener", "Node", "Runner", "SilentListener"]

T = TypeVar("T")

STAGE_VERSIONS = {
    "read": 2,
    "markers": 1,
    "filter": 2,
    "segment": 2,
    "walls": 9,
    "edit": 3,
    "grid": 5,
    "surface": 11,
    "map": 5,
    "bundle": 4,
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

    def run(
        self, stage: str, *, settings: Any, inputs: Mapping[str, Node[Any]], compute: Callable[[], T], kind: type[T]
    ) -> Node[T]:
        """Find the stage's output, or compute and keep it."""
        version = STAGE_VERSIONS[stage]
        hashes = {name: node.sha256 for name, node in inputs.items()}
        key = stage_key(stage=stage, version=version, settings=settings, inputs=hashes)
        entry = None if self.force else self.cache.find(stage, key)
        node: Node[T]

        def compute_and_store() -> T:
            self.announce(stage)
            start = time.perf_counter()
            output = compute()
            self.learn(stage, time.perf_counter() - start)
            stored = self.cache.store(stage, key, output, seconds=time.perf_counter() - start)
            node.sha256 = stored.output_sha256
            self.seconds[stage] = stored.seconds
            self.listener.stage_finished(stage, seconds=stored.seconds, reused=False)
            return output

        def fetch() -> T:
            cached = self.cache.load(stage, key, kind)
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


def _as_dict(settings: Any) -> dict[str, Any]:
    return settings if isinstance(settings, dict) else {"settings": settings}
