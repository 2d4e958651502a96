"""The studio's server: the page's files, and a socket for each page."""

from __future__ import annotations

import asyncio
import contextlib
from collections.abc import AsyncIterator
from pathlib import Path

from starlette.applications import Starlette
from starlette.requests import Request
from starlette.responses import FileResponse
from starlette.routing import Mount, Route, WebSocketRoute
from starlette.staticfiles import StaticFiles
from starlette.types import ASGIApp
from starlette.websockets import WebSocket, WebSocketDisconnect

from heartcase.studio.gate import Gate
from heartcase.studio.workplace import Page, Workplace

__all__ = ["PAGE", "make_app"]

PAGE = Path(__file__).parent / "page"
"""The page's files."""


def make_app(workplace: Workplace, *, token: str, port: int) -> ASGIApp:
    """The server as an ASGI application.

    Parameters
    ----------
    workplace
        What is open.
    token
        Secret of this run: ``http://127.0.0.1:PORT/?token=TOKEN`` opens the page.
    port
        Port that the server listens on.
    """

    async def index(_: Request) -> FileResponse:
        return FileResponse(PAGE / "index.html")

    async def socket(websocket: WebSocket) -> None:
        await _serve_page(websocket, workplace)

    @contextlib.asynccontextmanager
    async def lifespan(_: Starlette) -> AsyncIterator[None]:
        yield
        await workplace.close()

    routes = [
        Route("/", index),
        WebSocketRoute("/socket", socket),
        Mount("/static", StaticFiles(directory=PAGE)),
    ]
    return Gate(Starlette(routes=routes, lifespan=lifespan), token=token, port=port)


async def _serve_page(websocket: WebSocket, workplace: Workplace) -> None:
    """Talk to a page until it is gone."""
    await websocket.accept()
    page = Page()
    sender = asyncio.create_task(_send(websocket, page))
    # Requests are read while the recipe is being opened, and wait for it.
    joined = asyncio.create_task(workplace.join(page))
    try:
        while True:
            text = await websocket.receive_text()
            await joined
            await workplace.ask(page, text)
    except (WebSocketDisconnect, KeyError, RuntimeError):
        pass
    finally:
        joined.cancel()
        sender.cancel()
        # A server that ends cancels this too: the page's stroke is saved all the same.
        await asyncio.shield(_forget(workplace, page, joined))


async def _forget(workplace: Workplace, page: Page, joined: asyncio.Task[None]) -> None:
    with contextlib.suppress(asyncio.CancelledError):
        await joined
    await workplace.leave(page)


async def _send(websocket: WebSocket, page: Page) -> None:
    with contextlib.suppress(WebSocketDisconnect, RuntimeError):
        while (message := await page.waiting.get()) is not None:
            if isinstance(message, str):
                await websocket.send_text(message)
            else:
                await websocket.send_bytes(message)
        await websocket.close(1013)
