"""A page that is connected, and what a page can be connected to."""

from __future__ import annotations

import asyncio
from typing import Protocol

__all__ = ["Page", "Place"]

QUEUE_LENGTH_MAX = 2000
"""Messages that wait for a page at most: one that takes none is let go, and asks again for everything."""


class Page:
    """A page that is connected: messages wait here until they are sent."""

    def __init__(self) -> None:
        self.waiting: asyncio.Queue[str | bytes | None] = asyncio.Queue()

    def send(self, message: str | bytes) -> None:
        """Let a message be sent, after those before it; a page that takes none is let go."""
        if self.waiting.qsize() < QUEUE_LENGTH_MAX:
            self.waiting.put_nowait(message)
        else:
            self.close()

    def close(self) -> None:
        """Let the page go, after what waits."""
        self.waiting.put_nowait(None)


class Place(Protocol):
    """What pages are connected to: all its methods belong to the server's event loop."""

    async def join(self, page: Page) -> None:
        """Show a page everything, and then all that changes."""

    async def leave(self, page: Page) -> None:
        """Forget a page."""

    async def ask(self, page: Page, text: str) -> None:
        """Do what a page asks for, and tell it; what cannot be done is told as well, and raises nothing."""

    async def close(self) -> None:
        """End, with nothing lost."""
