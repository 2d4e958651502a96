"""How far each structure is: worked out beside the painting, once nobody has asked for anything for a while."""

from __future__ import annotations

import asyncio
import contextlib
from collections.abc import Awaitable, Callable
from concurrent.futures import ThreadPoolExecutor

from heartcase.pipeline.markers.states import StillSegmentation, structure_states
from heartcase.studio.messages import text_message

__all__ = ["States"]

IDLE_S = 0.6
"""So long after the last request the segmentation is copied and looked at."""


class States:
    """Works states out in a thread of its own; all methods belong to one event loop.

    Parameters
    ----------
    copied
        Gives the segmentation as it is now; None where none is open.
    tell
        Is given the message of the states, unless something was asked for meanwhile.
    """

    def __init__(
        self, copied: Callable[[], Awaitable[StillSegmentation | None]], tell: Callable[[str], object]
    ) -> None:
        self._copied = copied
        self._tell = tell
        self._thread = ThreadPoolExecutor(1, thread_name_prefix="states")
        self._task: asyncio.Task[None] | None = None

    def later(self) -> None:
        """Something changed, or may have: look again when it is quiet."""
        if self._task is not None:
            self._task.cancel()
        self._task = asyncio.get_running_loop().create_task(self._look())

    def close(self) -> None:
        """End; what is being worked out is not waited for."""
        if self._task is not None:
            self._task.cancel()
        self._thread.shutdown(wait=False, cancel_futures=True)

    async def _look(self) -> None:
        await asyncio.sleep(IDLE_S)
        # it is worth no more than that: what fails here fails again where somebody asks for it
        with contextlib.suppress(Exception):
            still = await self._copied()
            if still is not None:
                self._tell(await asyncio.get_running_loop().run_in_executor(self._thread, _message, still))


def _message(still: StillSegmentation) -> str:
    states = structure_states(still)
    return text_message("states", states={still.table[value].name: state.value for value, state in states.items()})
