"""``heartcase bench``: the benchmarks of the repository, where there is one."""

from __future__ import annotations

import importlib
import sys
from pathlib import Path

import click

from heartcase.schemas.errors import UsageError

__all__ = ["command"]

_RUNNER = Path("benchmarks", "runner", "command.py")
_PACKAGE = Path(__file__).parents[2]


# --help is the runner's, too.
@click.command(add_help_option=False, context_settings={"ignore_unknown_options": True})
@click.argument("arguments", nargs=-1, type=click.UNPROCESSED)
def command(arguments: tuple[str, ...]) -> None:
    """Run ``python -m benchmarks`` of the repository: the one worked in, or the one that heartcase lies in.

    Raises
    ------
    UsageError
        There is none: an installed heartcase has no benchmarks.
    """
    here = Path.cwd()
    repository = next((path for path in (here, *here.parents, _PACKAGE.parent) if (path / _RUNNER).is_file()), None)
    if repository is None:
        raise UsageError("the benchmarks are not installed with heartcase: run this in a checkout of its repository")
    sys.path.insert(0, str(repository))
    runner = importlib.import_module("benchmarks.runner.command")
    runner.command.main(args=list(arguments), prog_name="heartcase bench", standalone_mode=False)
