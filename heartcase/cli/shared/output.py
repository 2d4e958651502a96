"""What the commands print: one JSON object, tables for people, and messages beside them.

Results go to standard output and nothing else does, so they can be piped; messages and progress go to standard error.
"""

from __future__ import annotations

import contextlib
import json
from collections.abc import Iterable, Iterator, Mapping, Sequence
from typing import Any

import click
import numpy as np
from pydantic import BaseModel
from rich import box
from rich.console import Console
from rich.progress import Progress, SpinnerColumn, TextColumn, TimeElapsedColumn
from rich.table import Table
from rich.text import Text

from heartcase.compiling.hearing import told_when_compiling
from heartcase.pipeline.warnings import CaseWarning, WarningGrade, counted, grouped

__all__ = [
    "compiling_told",
    "echo_json",
    "echo_warnings",
    "error_console",
    "file_size",
    "json_ready",
    "print_facts",
    "print_table",
    "working",
]


_COMPILING = (
    "  compiling kernels that this machine has not compiled yet, which is kept: up to some minutes, once after an "
    "installation"
)
_SILENT_S = 2.0
"""Compiling that takes less is not told."""
_told: list[bool] = []
"""Whether this process said so."""


def json_ready(value: Any) -> Any:
    """Turn models, arrays, numpy numbers and tuples into what JSON has; numbers that are not finite become null."""
    if isinstance(value, BaseModel):
        return json_ready(value.model_dump(mode="json"))
    if isinstance(value, Mapping):
        return {str(key): json_ready(item) for key, item in value.items()}
    if isinstance(value, np.ndarray):
        return json_ready(value.tolist())
    if isinstance(value, np.generic):
        return json_ready(value.item())
    if isinstance(value, list | tuple | set | frozenset):
        return [json_ready(item) for item in (sorted(value) if isinstance(value, set | frozenset) else value)]
    if isinstance(value, float):
        return value if np.isfinite(value) else None
    return value


def echo_json(data: Any) -> None:
    """Print one JSON object on standard output."""
    click.echo(json.dumps(json_ready(data), indent=2, ensure_ascii=False, allow_nan=False))


def echo_warnings(warnings: Iterable[CaseWarning], *, err: bool = False) -> int:
    """Print the warnings of a case under the report's headings, the worst first, on standard output or error.

    Returns
    -------
    int
        How many of them say that the anatomy may be wrong.
    """
    worst = 0
    for group in grouped(warnings):
        click.echo(f"{group.title} ({counted(len(group.lines), 'warning')})", err=err)
        for line in group.lines:
            click.echo(f"  - {line}", err=err)
        worst += len(group.lines) * (group.grade is WarningGrade.ANATOMY)
    return worst


def error_console() -> Console:
    """A console on standard error, for progress and messages."""
    return Console(stderr=True, highlight=False)


@contextlib.contextmanager
def working(words: str) -> Iterator[None]:
    """Show what is being done and for how long, while it lasts; also a decorator of a command's function."""
    columns = (SpinnerColumn(), TextColumn("{task.description}"), TimeElapsedColumn())
    console = error_console()
    with Progress(*columns, console=console, transient=True, disable=not console.is_terminal) as progress:
        progress.add_task(words, total=None)
        with compiling_told(console):
            yield


@contextlib.contextmanager
def compiling_told(console: Console) -> Iterator[None]:
    """Say on a console, once in a command, that kernels are being compiled, where that takes a while."""

    def say() -> None:
        if not _told:
            _told.append(True)
            console.print(_COMPILING, highlight=False, soft_wrap=True)

    with told_when_compiling(say, after_s=_SILENT_S):
        yield


def print_facts(facts: Mapping[str, object] | Iterable[tuple[str, object]], *, title: str = "") -> None:
    """Print names and values in two columns on standard output, under a title."""
    rows = list(facts.items()) if isinstance(facts, Mapping) else list(facts)
    table = Table(box=None, show_header=False, padding=(0, 2, 0, 0))
    table.add_column(no_wrap=True, style="bold")
    table.add_column(overflow="fold")
    for name, value in rows:
        table.add_row(Text(name), Text(str(value)))
    _print(title, table)


def print_table(
    columns: Sequence[str],
    rows: Iterable[Sequence[object]],
    *,
    title: str = "",
    right: Sequence[str] = (),
    width_max: Mapping[str, int] | None = None,
) -> None:
    """Print a table on standard output; the columns named in ``right`` are set to the right.

    What is wider than ``width_max`` (column -> characters) goes on in a line below.
    """
    table = Table(box=box.SIMPLE_HEAD, padding=(0, 1), pad_edge=False)
    for column in columns:
        table.add_column(
            column,
            justify="right" if column in right else "left",
            overflow="fold",
            max_width=(width_max or {}).get(column),
        )
    for row in rows:
        table.add_row(*(Text(str(cell)) for cell in row))
    _print(title, table)


def file_size(byte_count: int) -> str:
    """A size in words: ``812 B``, ``3.4 MB``."""
    size = float(byte_count)
    for unit in ("B", "kB", "MB", "GB"):
        if size < 1000.0 or unit == "GB":
            break
        size /= 1000.0
    return f"{size:.0f} {unit}" if unit == "B" else f"{size:.1f} {unit}"


def _print(title: str, table: Table) -> None:
    console = Console(highlight=False)
    if not console.is_terminal:
        # A pipe has no width: nothing may be folded or cut there.
        console = Console(highlight=False, width=200)
    if title:
        console.print(Text(title, style="bold underline"))
    console.print(table)
