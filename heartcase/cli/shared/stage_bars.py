"""Bars of the stages of a build: how far the one that runs is, and how long it may still take."""

from __future__ import annotations

from rich.progress import BarColumn, ProgressColumn, Task
from rich.progress_bar import ProgressBar
from rich.text import Text

__all__ = ["TimeLeft", "TimedBar", "stage_result", "time_left"]


class TimedBar(BarColumn):
    """Fills with the time that the stage was expected to take, and waits just short of the end when it takes longer."""

    def render(self, task: Task) -> ProgressBar:
        """Draw it."""
        total = task.total or 1.0
        return ProgressBar(total=total, completed=min(task.elapsed or 0.0, 0.97 * total), width=self.bar_width)


class TimeLeft(ProgressColumn):
    """Time that this stage and those after it may still take."""

    def render(self, task: Task) -> Text:
        """Write it."""
        return Text(time_left(max((task.total or 0.0) - (task.elapsed or 0.0), 0.0) + task.fields["seconds_after"]))


def time_left(seconds: float) -> str:
    """An estimate in words."""
    if seconds < 1.0:
        return "nearly there"
    return f"about {seconds:.0f} s left" if seconds < 120.0 else f"about {seconds / 60.0:.0f} min left"


def stage_result(seconds: float, *, reused: bool) -> str:
    """What became of a stage, right-aligned."""
    return "unchanged" if reused else f"{seconds:6.1f} s"
