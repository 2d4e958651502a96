"""Work of the last stage, begun as soon as what it takes is there: the stages between leave cores idle now and then."""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor
from types import TracebackType
from typing import Any

import numba

from heartcase.pipeline.kernels.parallel import may_share
from heartcase.pipeline.stages.stage import Work

__all__ = ["WorkAhead"]


class WorkAhead:
    """A thread for it; as a context, what nobody asked for is given up at its end.

    Parameters
    ----------
    work
        What the stages have made so far; told of what is begun.
    """

    def __init__(self, work: Work) -> None:
        self._work = work
        self._is_over = False
        self._pool = ThreadPoolExecutor(
            1, "heartcase-ahead", initializer=numba.set_num_threads, initargs=(numba.get_num_threads(),)
        )

    def __enter__(self) -> WorkAhead:
        """Nothing is begun yet."""
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, at: TracebackType | None) -> None:
        """Give up what is not begun, and wait for what is: not for long."""
        self._is_over = True
        self._pool.shutdown(cancel_futures=True)

    def look(self) -> None:
        """Begin what can be begun, where the stages have computed, and not found, what it takes."""
        from heartcase.pipeline.bundle.assembly import normal_maps, volumes_and_labels

        outputs = self._work.outputs
        if outputs.structures is not None and outputs.structures.value is not None:
            structures = outputs.structures.value
            self._begin("volumes_and_labels", lambda: volumes_and_labels(structures, lambda: not self._is_over))
        if outputs.surface is not None and outputs.surface.value is not None:
            surface = outputs.surface.value
            self._begin("normal_maps", lambda: normal_maps(self._work.recipe, surface))

    def _begin(self, name: str, function: Callable[[], Any]) -> None:
        if name not in self._work.begun and may_share():
            future: Future[Any] = self._pool.submit(function)
            self._work.begun[name] = future.result
