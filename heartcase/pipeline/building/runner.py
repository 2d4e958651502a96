"""Running the stages of a build through the cache, with progress for a listener."""

from __future__ import annotations

import hashlib
import json
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any, Protocol, TypeVar, runtime_checkable

from heartcase.pipeline.artifacts.cache import Cache, stage_key
from heartcase.pipeline.artifacts.serialise import artifact_to_bytes
from heartcase.pipeline.data import Scan
from heartcase.pipeline.kernels.parallel import may_share, side_by_side
from heartcase.pipeline.stages import table
from heartcase.pipeline.stages.stage import Node, Stage, Work
from heartcase.schemas.bundle.format import StageRecord
from heartcase.schemas.files import atomic_write

__all__ = ["BuildListener", "Runner", "SilentListener", "SizeListener", "UncachedRunner", "run_stages"]

T = TypeVar("T")


class BuildListener(Protocol):
    """Who wants to know how a build goes on."""

    def stage_started(self, stage: str, *, seconds_expected: float, seconds_after: float) -> None:
        """Note that a stage begins to compute, or the report to be drawn.

        Parameters
        ----------
        stage
            Name of the stage, or "report".
        seconds_expected
            How long it may take, s.
        seconds_after
            How long the stages after it may take, s.
        """

    def stage_finished(self, stage: str, *, seconds: float, reused: bool) -> None:
        """Note that a stage has its output, computed or found in the cache.

        Parameters
        ----------
        stage
            Name of the stage.
        seconds
            How long it took, s.
        reused
            Whether its output was in the cache.
        """


@runtime_checkable
class SizeListener(Protocol):
    """A listener that wants to know how large the scan is as well."""

    def scan_read(self, voxel_count: int) -> None:
        """Note how many voxels the scan's part has that is built from; before any stage that takes long."""


class SilentListener:
    """Listens to nothing."""

    def stage_started(self, stage: str, *, seconds_expected: float, seconds_after: float) -> None:
        """Do nothing."""

    def stage_finished(self, stage: str, *, seconds: float, reused: bool) -> None:
        """Do nothing."""


@dataclass(kw_only=True)
class UncachedRunner:
    """Computes every stage and keeps nothing: for a single stage, whose output the user names a file for."""

    voxel_count: int = 1_000_000
    """Of the scan, once it is read: times are expected in proportion."""
    seconds: dict[str, float] = field(default_factory=dict)
    """Name of each stage that has its output -> how long that took, s."""
    reused: list[str] = field(default_factory=list)
    """Names of those whose output was found."""

    def run(self, stage: Stage[T], work: Work, *, done: tuple[T, float] | None = None) -> None:
        """Get a stage's output; nothing, where the recipe has no work for it.

        Parameters
        ----------
        stage
            The stage; its output is noted in ``work.outputs``, and how it came about in ``work.records``.
        work
            What it works with.
        done
            Its output and the seconds that it took, where it is computed already.
        """
        if not stage.has_work(work.recipe):
            if stage.passes_on:
                setattr(work.outputs, stage.output, work.outputs.of(stage.passes_on))
            return
        settings = stage.settings(work)
        if stage.is_kept(work.recipe):
            node = self._kept(stage, work, settings, done)
        else:
            node = self._computed(stage, work, done)
        setattr(work.outputs, stage.output, node)
        work.records.append(
            StageRecord(stage=stage.name, version=stage.version, settings=settings, output_sha256=node.sha256)
        )

    def _kept(self, stage: Stage[T], work: Work, settings: dict[str, Any], done: tuple[T, float] | None) -> Node[T]:
        """The output of a stage that a cache keeps, where there is one."""
        return self._computed(stage, work, done)

    def _computed(self, stage: Stage[T], work: Work, done: tuple[T, float] | None = None) -> Node[T]:
        """The output of a stage that the cache does not keep."""
        self.announce(stage.name)
        start = time.perf_counter()
        value = done[0] if done else stage.compute(work)
        node = Node(hashlib.sha256(artifact_to_bytes(value)).hexdigest(), lambda: value, value)
        self.seconds[stage.name] = done[1] if done else time.perf_counter() - start
        if isinstance(value, Scan):
            self.voxel_count = value.values.size
            self.tell_size()
        self.tell_finished(stage.name, self.seconds[stage.name], reused=False)
        return node

    def announce(self, stage: str) -> None:
        """Tell that a stage begins: here nobody."""

    def tell_size(self) -> None:
        """Tell how large the scan is: here nobody."""

    def tell_finished(self, stage: str, seconds: float, *, reused: bool) -> None:
        """Tell that a stage has its output: here nobody."""


@dataclass
class Runner(UncachedRunner):
    """Finds the outputs of stages in a cache, or computes and keeps them; tells a listener, and remembers the times."""

    cache: Cache
    """Keeps outputs, and how long stages took."""
    listener: BuildListener
    """Told of each stage."""
    force: bool
    """Compute every stage, whatever the cache holds."""

    def run_both(self, stage: Stage[Any], longer: Stage[Any], work: Work) -> None:
        """Run two stages of which neither needs the other, and compute both at the same time where both must be.

        The longer one runs in this thread, so that it can be interrupted, and is the one that the listener hears of.
        Stages are recorded in the order of the arguments.
        """
        keys = {one.name: _key_of(one, work, one.settings(work)) for one in (stage, longer)}
        is_found = not self.force and any(self.cache.find(name, key) for name, key in keys.items())
        if is_found or not may_share():
            self.run(stage, work)
            self.run(longer, work)
            return
        for name in (*stage.inputs.values(), *longer.inputs.values()):
            node = work.outputs.of(name)
            if node is not None:
                node.get()
        _, done = side_by_side(
            lambda: self.run(longer, work), lambda: _timed(lambda: stage.compute(work)), second_in_background=True
        )
        self.run(stage, work, done=done)
        work.records[-2:] = reversed(work.records[-2:])

    def _kept(self, stage: Stage[T], work: Work, settings: dict[str, Any], done: tuple[T, float] | None) -> Node[T]:
        """The output from the cache, or computed and kept there."""
        key = _key_of(stage, work, settings)
        entry = None if self.force else self.cache.find(stage.name, key)
        node: Node[T]

        def compute_and_store() -> T:
            self.announce(stage.name)
            output, seconds = done or _timed(lambda: stage.compute(work))
            start = time.perf_counter()
            self.learn(stage.name, seconds)
            stored = self.cache.store(stage.name, key, output, seconds=seconds + time.perf_counter() - start)
            node.sha256 = stored.output_sha256
            self.seconds[stage.name] = stored.seconds
            self.tell_finished(stage.name, stored.seconds, reused=False)
            return output

        def fetch() -> T:
            cached = self.cache.load(stage.name, key, stage.kind)
            if cached is not None:
                return cached
            self.reused.remove(stage.name)
            return compute_and_store()

        node = Node("", fetch)
        if entry is None:
            node.value = compute_and_store()
        else:
            node.sha256 = entry.output_sha256
            self.seconds[stage.name] = entry.seconds
            self.reused.append(stage.name)
            self.tell_finished(stage.name, entry.seconds, reused=True)
        return node

    def announce(self, stage: str) -> None:
        """Tell the listener that a stage begins, with the time it took before, scaled to this scan."""
        names = [step.name for step in table.steps()]
        after = sum(self._expected(later) for later in names[names.index(stage) + 1 :])
        self.listener.stage_started(stage, seconds_expected=self._expected(stage), seconds_after=after)

    def tell_size(self) -> None:
        """Tell the listener how large the scan is, where it wants to know."""
        if isinstance(self.listener, SizeListener):
            self.listener.scan_read(self.voxel_count)

    def tell_finished(self, stage: str, seconds: float, *, reused: bool) -> None:
        """Tell the listener that a stage has its output."""
        self.listener.stage_finished(stage, seconds=seconds, reused=reused)

    def _rates(self) -> dict[str, float]:
        try:
            data = json.loads((self.cache.directory / "rates.json").read_bytes())
            return {str(stage): float(seconds) for stage, seconds in data.items()}
        except (OSError, ValueError, AttributeError, TypeError):
            return {}

    def _expected(self, stage: str) -> float:
        rate = self._rates().get(stage, table.step_named(stage).expected_seconds)
        return rate * self.voxel_count / 1e6

    def learn(self, stage: str, seconds: float) -> None:
        """Remember how long a stage took, per million voxels."""
        rates = self._rates() | {stage: round(seconds * 1e6 / max(self.voxel_count, 1), 3)}
        atomic_write(self.cache.directory / "rates.json", json.dumps(rates, sort_keys=True).encode(), is_flushed=False)


def run_stages(
    runner: Runner, work: Work, *, until: str | None = None, after: Callable[[str], None] = lambda _: None
) -> None:
    """Run the stages of a build in their order, all but the last, which writes the case.

    Parameters
    ----------
    runner
        Runs them.
    work
        What they work with; ``after`` may change it.
    until
        Name of the last one to run; all when left out.
    after
        Told the name of each stage once it has run.
    """
    stages = table.STAGES[:-1]
    for number, stage in enumerate(stages):
        later = (one for one in stages[number + 1 :] if one.beside == stage.name and one.is_part(work.recipe))
        if not stage.is_part(work.recipe) or (until != stage.name and any(later)):
            continue
        if stage.beside:
            runner.run_both(table.stage_named(stage.beside), stage, work)
        else:
            runner.run(stage, work)
        after(stage.name)
        if stage.name == until:
            return


def _key_of(stage: Stage[Any], work: Work, settings: dict[str, Any]) -> str:
    nodes = {name: work.outputs.of(field) for name, field in stage.inputs.items()}
    hashes = {name: node.sha256 for name, node in nodes.items() if node is not None}
    return stage_key(stage=stage.name, version=stage.version, settings=settings, inputs=hashes)


def _timed(compute: Callable[[], T]) -> tuple[T, float]:
    """An output and the seconds it took."""
    start = time.perf_counter()
    output = compute()
    return output, time.perf_counter() - start
