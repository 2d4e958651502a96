"""What a worker tells of a case while it builds: through the scheduler, so that workers anywhere are heard."""

from __future__ import annotations

import contextlib
import queue
from collections.abc import Callable, Iterator
from dataclasses import asdict, dataclass, fields
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from distributed import Client

__all__ = ["MAKING_THE_SCAN", "StageNews", "TellingListener", "heard"]

_TOPIC = "heartcase-stages"
MAKING_THE_SCAN = "scan"
"""What stands for a stage while a synthetic scan is made; no stage of a build has this name."""


@dataclass(frozen=True)
class StageNews:
    """That a stage of a case began or has its output."""

    case: str
    """Name of the case."""
    stamp: str
    """What it is built from: another build on the same scheduler may have a case of this name."""
    stage: str
    """The stage, or :data:`MAKING_THE_SCAN`."""
    is_finished: bool
    """Whether it has its output."""
    seconds: float = 0.0
    """How long it took, s; of one that was in the cache, when its output was computed."""
    reused: bool = False
    """Whether its output was there already."""
    seconds_expected: float = 0.0
    """How long it may take, s."""
    seconds_after: float = 0.0
    """How long the stages after it may take, s."""


_FIELDS = frozenset(field.name for field in fields(StageNews))


class TellingListener:
    """A listener of a build that logs an event with the scheduler; made in a worker."""

    def __init__(self, case: str, stamp: str) -> None:
        self.case, self.stamp = case, stamp

    def stage_started(self, stage: str, *, seconds_expected: float, seconds_after: float) -> None:
        """Tell that a stage begins to compute."""
        self._tell(stage, False, seconds_expected=seconds_expected, seconds_after=seconds_after)

    def stage_finished(self, stage: str, *, seconds: float, reused: bool) -> None:
        """Tell that a stage has its output."""
        self._tell(stage, True, seconds=seconds, reused=reused)

    def _tell(self, stage: str, is_finished: bool, **more: Any) -> None:
        from distributed import get_worker

        # Only progress: whatever keeps it from being told must not cost the case.
        with contextlib.suppress(Exception):
            get_worker().log_event(_TOPIC, asdict(StageNews(self.case, self.stamp, stage, is_finished, **more)))


@contextlib.contextmanager
def heard(client: Client) -> Iterator[Callable[[], list[StageNews]]]:
    """A function that gives the news since it was last asked, in order; they come in a thread of the client's."""
    arrived: queue.SimpleQueue[StageNews] = queue.SimpleQueue()

    def put(event: tuple[float, Any]) -> None:
        # Of another version of heartcase, on a scheduler that is shared, it may hold anything.
        with contextlib.suppress(TypeError, AttributeError):
            # Dask adds which worker it was.
            arrived.put(StageNews(**{key: value for key, value in event[1].items() if key in _FIELDS}))

    def news() -> list[StageNews]:
        found = []
        with contextlib.suppress(queue.Empty):
            while True:
                found.append(arrived.get_nowait())
        return found

    client.subscribe_topic(_TOPIC, put)
    try:
        yield news
    finally:
        with contextlib.suppress(Exception):  # the scheduler may be gone
            client.unsubscribe_topic(_TOPIC)
