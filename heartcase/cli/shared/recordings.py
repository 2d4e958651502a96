"""A recording that a command makes: finished with its block, and kept where that ends early."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

import click

from heartcase.schemas.errors import HeartcaseError
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
            _end(recorder, error)
        raise


def _end(recorder: Recorder, error: BaseException) -> None:
    if isinstance(error, HeartcaseError):
        recorder.finish()
    else:
        recorder.break_off()
    kept = f"kept what was recorded by then: {recorder.seconds:.3f} s in {recorder.path}"
    if recorder.error is not None:
        kept += ", cut short: 'heartcase replay --partial' takes what is whole of it"
    click.echo(kept, err=True)
