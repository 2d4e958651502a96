"""What a build says of kernels that are compiled meanwhile."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import TYPE_CHECKING, Any

from rich.console import Console
from rich.progress import Progress as RowsOfProgress
from rich.progress import TaskID

if TYPE_CHECKING:
    from heartcase.compiling.compile_ahead import Progress

__all__ = ["Compiling"]


class Compiling:
    """Shows that kernels are being compiled, which are then kept, and for how long still.

    Told of progress by other threads, one at a time.

    Parameters
    ----------
    console
        Where the line goes that says so.
    progress
        What gets a row of it.
    fields
        Seconds left -> what the columns of ``progress`` need to know of the row.
    """

    def __init__(
        self,
        console: Console,
        progress: RowsOfProgress,
        fields: Callable[[float], dict[str, Any]] = lambda _: {"seconds_after": 0.0},
    ) -> None:
        self.console, self.progress, self.fields = console, progress, fields
        self.task: TaskID | None = None
        self.start = time.perf_counter()

    def __call__(self, state: Progress) -> None:
        """Show how far it is; the row goes when all is compiled."""
        words = f"compiling {state.done + state.failed} of {state.total}"
        if self.task is None:
            self.console.print(
                f"  compiling {state.total} kernels meanwhile, which is kept for later builds", highlight=False
            )
            self.task = self.progress.add_task(
                words, total=max(state.seconds_left, 0.1), **self.fields(state.seconds_left)
            )
        passed = time.perf_counter() - self.start
        self.progress.update(
            self.task, description=words, total=passed + state.seconds_left, **self.fields(state.seconds_left)
        )
        if state.done + state.failed == state.total:
            self.progress.remove_task(self.task)
