"""What nobody has open for some time is freed from memory."""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable

__all__ = ["FREE_AFTER_S", "Idle"]

FREE_AFTER_S = 1800.0
"""How long something that no page has open stays in memory, s: a page that is loaded again finds it as it was."""


class Idle:
    """Frees something some time after the last page went. All methods belong to one event loop.

    Parameters
    ----------
    free
        Frees it; asks itself whether somebody came meanwhile.
    """

    def __init__(self, free: Callable[[], Awaitable[None]]) -> None:
        self._free = free
        self._task: asyncio.Task[None] | None = None
        self._freeing: asyncio.Task[None] | None = None
        self._is_closed = False

    def begin(self) -> None:
        """Nobody has it open any more."""
        self.end()
        if not self._is_closed:
            self._task = asyncio.create_task(self._wait())

    def end(self) -> None:
        """Somebody has it open; what is being freed by now is freed."""
        if self._task is not None:
            self._task.cancel()
            self._task = None

    def close(self) -> None:
        """It is closed, and is not freed any more."""
        self._is_closed = True
        self.end()

    async def _wait(self) -> None:
        await asyncio.sleep(FREE_AFTER_S)
        # from here on it is done to its end
        self._freeing, self._task = self._task, None
        await self._free()
        self._freeing = None
