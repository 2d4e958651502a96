"""Kernels that the studio will call, compiled behind its pages, so that the first stroke need not wait for them.

``kernels.json`` lists those of painting and operating, with the types that they are called with; those of building are
listed by :mod:`heartcase.pipeline.building.kernels_ahead`. ``python -m tests.studio.starting.test_compiling --write``
writes it anew.
"""

from __future__ import annotations

import threading
from collections.abc import Callable
from pathlib import Path

from heartcase.compiling.compile_ahead import Called, Progress, compiled_ahead, core_count
from heartcase.pipeline.building.kernels_ahead import PROCESSES_MOST, SCAN, kernels_in, kernels_of
from heartcase.pipeline.stages.table import steps

__all__ = ["LIST", "Compiling", "kernels_of_the_studio"]

LIST = Path(__file__).with_name("kernels.json")


def kernels_of_the_studio() -> tuple[Called, ...]:
    """Painting, then building, then operating: the order in which a user comes to them."""
    listed = kernels_in(LIST)
    building = kernels_of({SCAN, *(step.name for step in steps())})
    found = {(one.module, one.name, repr(one.types)): one for one in (*listed["paint"], *building, *listed["operate"])}
    return tuple(found.values())


class Compiling:
    """Compiles behind all else what is not compiled yet on this machine.

    ``progress`` tells how far it is; None before it begins, where nothing is left, and when it is done.

    Parameters
    ----------
    told
        Called from other threads whenever ``progress`` changed.
    wanted
        Kernels; those of the studio when left out.
    """

    def __init__(self, told: Callable[[], None], *, wanted: tuple[Called, ...] | None = None) -> None:
        self.progress: Progress | None = None
        self._told = told
        self._wanted = wanted
        self._is_over = threading.Event()
        self._thread: threading.Thread | None = None

    def begin(self) -> None:
        """Begin; the processes end with :meth:`close`, or when all is done."""
        self._thread = threading.Thread(target=self._run, name="studio-compiling", daemon=True)
        self._thread.start()

    def close(self) -> None:
        """End all processes."""
        self._is_over.set()
        if self._thread is not None:
            self._thread.join()

    def _run(self) -> None:
        wanted = kernels_of_the_studio() if self._wanted is None else self._wanted
        with compiled_ahead(wanted, processes=min(core_count(), PROCESSES_MOST), told=self._hear, is_behind=True):
            if self.progress is not None:
                self._is_over.wait()
        self.progress = None
        self._told()

    def _hear(self, progress: Progress) -> None:
        self.progress = progress
        if progress.done + progress.failed == progress.total:
            self._is_over.set()
        self._told()
