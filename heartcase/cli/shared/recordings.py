"""A recording that a command makes: finished with its block, and kept where that ends early."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

import click

from heartcase.simulator.session.recorder import Recorder

__all__ = ["recorded_into"]


@contextmanager
def recorded_into(recorder: Recorder) -> Iterator[None]:
    """Finish a recording with the block.

    Where an error or Ctrl-C ends it early, what was done by then is kept, and a line on standard error says so; nothing
    is left where no time went by in the block.
    """
    begun_s = recorder.seconds
    try:
        yield
        recorder.finish()
    except BaseException as error:
        if recorder.seconds <= begun_s:
            recorder.discard()
        else:
            recorder.end_early(error)
            _tell(recorder)
        raise


def _tell(recorder: Recorder) -> None:
    kept = f"kept what was recorded by then: {recorder.seconds:.3f} s in {recorder.path}"
    if recorder.error is not None:
        (why,) = recorder.error.problems
        kept += f", cut short as it {why.message}; 'heartcase replay --partial' takes what is whole of it"
    click.echo(kept, err=True)
