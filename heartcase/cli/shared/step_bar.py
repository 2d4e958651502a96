"""A bar for the steps of one command: which one runs, how far it is, and for how long."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager

from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn

from heartcase.cli.shared.stage_bars import stage_result

__all__ = ["StepBar"]


class StepBar:
    """Shows the step that runs in a terminal, and everywhere a line for each that is done.

    Parameters
    ----------
    console
        On standard error.
    """

    def __init__(self, console: Console) -> None:
        columns = (TextColumn("{task.description}"), BarColumn(24), TimeElapsedColumn())
        self.progress = Progress(*columns, console=console, transient=True, disable=not console.is_terminal)
        self.console = console

    @contextmanager
    def step(self, words: str) -> Iterator[Callable[[float], None]]:
        """Show a step while it lasts; what it gives is told how far it is, from 0 to 1."""
        # without a total the bar pulses: as long as nothing is told
        task = self.progress.add_task(words, total=None)
        started = time.perf_counter()
        try:
            yield lambda fraction: self.progress.update(task, total=1.0, completed=fraction)
        finally:
            self.progress.remove_task(task)
        self.console.print(
            f"  {words:<28} {stage_result(time.perf_counter() - started, reused=False)}", highlight=False
        )
