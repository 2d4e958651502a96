"""How a build of a library goes on: bars in a terminal, in a log a line for every stage that is finished."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass

from rich.console import Console
from rich.progress import BarColumn, Progress, ProgressColumn, Task, TaskID, TextColumn, TimeElapsedColumn
from rich.progress_bar import ProgressBar
from rich.text import Text

from heartcase.cli.shared.compiling import Compiling
from heartcase.cli.shared.stage_bars import TimedBar, stage_result, time_left
from heartcase.library.progress import MAKING_THE_SCAN, StageNews

__all__ = ["LibraryProgress"]


@dataclass
class _Running:
    """A case that is being built."""

    task: TaskID
    """Its line."""
    began_s: float
    """When its first stage began."""
    ends_s: float
    """When it may be done."""


class _Bar(ProgressColumn):
    """Cases done of all; of a case, the time that its stage was expected to take."""

    def __init__(self) -> None:
        super().__init__()
        self.counting, self.timed = BarColumn(24), TimedBar(24)

    def render(self, task: Task) -> ProgressBar:
        """Draw it."""
        return self.counting.render(task) if task.fields["is_all"] else self.timed.render(task)


class _Left(ProgressColumn):
    """Estimate of the time left, which the task carries as the moment of its end."""

    def render(self, task: Task) -> Text:
        """Write it."""
        ends_s = task.fields["ends_s"]()
        return Text("" if ends_s is None else time_left(ends_s - time.monotonic()))


class LibraryProgress:
    """Shows on standard error what is being built, by which stage, and how long it may take.

    Parameters
    ----------
    console
        Where to.
    count
        Cases to build.
    worker_count
        How many are built at a time, as far as is known.
    """

    def __init__(self, console: Console, count: int, worker_count: int) -> None:
        columns = (TextColumn("{task.description}"), _Bar(), TimeElapsedColumn(), _Left())
        self.progress = Progress(*columns, console=console, transient=True, disable=not console.is_terminal)
        self.console = console
        self.count, self.worker_count = count, worker_count
        self.done = 0
        self.running: dict[str, _Running] = {}
        self.case_s: list[float] = []
        self.all = self.progress.add_task(self._words(), total=count, is_all=True, ends_s=self.ends_s)

    def hear(self, news: StageNews) -> None:
        """Show that a stage began or is finished."""
        title = _title(news.stage)
        if news.is_finished:
            if not self.console.is_terminal:
                result = stage_result(news.seconds, reused=news.reused)
                self.console.print(f"  {news.case:<32} {title:<28} {result}", markup=False, soft_wrap=True)
            return
        now = time.monotonic()
        ends_s = now + news.seconds_expected + news.seconds_after
        before = self.running.get(news.case)
        if before is not None:
            self.progress.remove_task(before.task)
        words = f"{news.case}: {title}"
        task = self.progress.add_task(
            words, total=max(news.seconds_expected, 0.1), is_all=False, ends_s=_constant(ends_s)
        )
        self.running[news.case] = _Running(task, now if before is None else before.began_s, ends_s)

    def compiling(self) -> Compiling:
        """What shows that kernels are compiled meanwhile."""
        return Compiling(
            self.console,
            self.progress,
            lambda seconds_left: {"is_all": False, "ends_s": _constant(time.monotonic() + seconds_left)},
        )

    def case_done(self, name: str, seconds: float) -> None:
        """Show that a case is done, or failed."""
        self.done += 1
        self.case_s.append(seconds)
        running = self.running.pop(name, None)
        if running is not None:
            self.progress.remove_task(running.task)
        self.progress.update(self.all, completed=self.done, description=self._words())

    def ends_s(self) -> float | None:
        """When all may be done, by the clock :func:`time.monotonic`; None while nothing is known yet.

        Cases that wait count as the mean of those that are done, or else of what is expected of those that run.
        """
        now = time.monotonic()
        left = [max(one.ends_s - now, 0.0) for one in self.running.values()]
        known = self.case_s or [one.ends_s - one.began_s for one in self.running.values()]
        if not known:
            return None
        waiting = max(self.count - self.done - len(left), 0) * sum(known) / len(known)
        return now + max((sum(left) + waiting) / max(1, self.worker_count), max(left, default=0.0))

    def _words(self) -> str:
        return f"{self.done} of {self.count} cases"


def _constant(value: float) -> Callable[[], float]:
    return lambda: value


def _title(stage: str) -> str:
    if stage == MAKING_THE_SCAN:
        return "making the scan"
    from heartcase.pipeline.stages.table import step_named

    try:
        return step_named(stage).title
    except KeyError:  # of another heartcase
        return stage
