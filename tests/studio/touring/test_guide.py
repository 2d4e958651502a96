"""A step of a tour that is left goes on with nothing, whenever that comes."""

from __future__ import annotations

import asyncio
import contextlib
from concurrent.futures import Future
from types import SimpleNamespace

import pytest

from heartcase.studio.touring.guide import Guide


@pytest.mark.parametrize("turns", range(8))
def test_what_is_left_at_the_moment_of_an_answer_is_left(turns):
    went_on = []

    async def lead(live):
        await Guide({})._asked(live, None)
        went_on.append("done")

    async def leave():
        answer: Future[None] = Future()
        task = asyncio.create_task(lead(SimpleNamespace(asked=lambda command: answer)))
        for _ in range(4):
            await asyncio.sleep(0)
        answer.set_result(None)
        for _ in range(turns):
            await asyncio.sleep(0)
        is_left = task.cancel()
        with contextlib.suppress(asyncio.CancelledError):
            await task
        assert bool(went_on) != is_left

    asyncio.run(leave())
