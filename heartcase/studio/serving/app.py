"""The studio's server: the pages' files, and a socket for each page."""

from __future__ import annotations

import asyncio
import contextlib
from collections.abc import AsyncIterator
from pathlib import Path
from typing import Any

from starlette.applications import Starlette
from starlette.requests import ClientDisconnect, Request
from starlette.responses import FileResponse, JSONResponse, RedirectResponse, Response
from starlette.routing import Mount, Route, WebSocketRoute
from starlette.staticfiles import StaticFiles
from starlette.types import ASGIApp
from starlette.websockets import WebSocket, WebSocketDisconnect

from heartcase.studio.building.building import Building
from heartcase.studio.messages import problems_of, text_message, told
from heartcase.studio.operating.theatre import Theatre
from heartcase.studio.pages import Page, Place
from heartcase.studio.painting.workplace import Workplace
from heartcase.studio.serving.gate import Gate
from heartcase.studio.starting.registry import Registry
from heartcase.studio.starting.start import Start

__all__ = ["PAGE", "make_app"]

PAGE = Path(__file__).parents[1] / "page"
"""The page's files."""


_PAGES = {"prepare": "index.html", "operate": "operating/operate.html"}
"""Pages that show what is open, and the HTML of each."""
_LINES = ("socket", "building", "operating", "beside")
"""Sockets that talk to what is open."""
_ALIVE = text_message("alive")
_BEAT_S = 0.5
"""A page that operates is given a sign of life so often where it is told nothing else, s: without one it says so."""


def make_app(registry: Registry, *, token: str, port: int, start: Start | None = None) -> ASGIApp:
    """The server as an ASGI application.

    Parameters
    ----------
    registry
        What is open.
    token
        Secret of this run: ``http://127.0.0.1:PORT/?token=TOKEN`` opens the start page, and ``?token=TOKEN`` behind the
        address of anything open opens that.
    port
        Port that the server listens on.
    start
        What the start page is connected to; where it looks into the user's own folder when left out.
    """
    starting = start or Start(registry)

    async def start_page(_: Request) -> FileResponse:
        return FileResponse(PAGE / "start" / "start.html")

    def page(name: str, file: str) -> Route:
        async def answer(request: Request) -> Response:
            if registry.find(name, request.path_params["key"]) is None:
                # the start page says so
                return RedirectResponse("/#closed", status_code=303)
            return FileResponse(PAGE / file)

        return Route(f"/{name}/{{key}}", answer)

    async def report(request: Request) -> Response:
        place = registry.place("building", request.path_params["key"])
        found = place.report if isinstance(place, Building) else None
        return RedirectResponse("/#closed", status_code=303) if found is None else FileResponse(found)

    async def saved_page(request: Request) -> Response:
        place = registry.place("operating", request.path_params["key"])
        found = place.saved.file if isinstance(place, Theatre) else None
        if found is None or not found.is_file():
            return RedirectResponse("/#closed", status_code=303)
        # as a file: what the studio's own pages may do is not for it
        return FileResponse(found, filename=found.name)

    def line(name: str) -> WebSocketRoute:
        async def talk(websocket: WebSocket) -> None:
            place = registry.place(name, websocket.path_params["key"])
            if place is None:
                await websocket.close(1008)
            else:
                await _serve_page(websocket, place, starting)

        return WebSocketRoute(f"/{name}/{{key}}", talk)

    async def starting_line(websocket: WebSocket) -> None:
        await _serve_page(websocket, starting)

    @contextlib.asynccontextmanager
    async def lifespan(_: Starlette) -> AsyncIterator[None]:
        yield
        await starting.close()
        await registry.close()

    async def draft(request: Request) -> Response:
        workplace = registry.place("socket", request.path_params["key"])
        # a page of another site can send a form, but no origin of ours
        if not isinstance(workplace, Workplace) or "origin" not in request.headers:
            return Response(status_code=404)
        problems: list[dict[str, Any]] = []
        try:
            await workplace.add_draft(request.stream())
        except ClientDisconnect:
            return Response(status_code=400)
        except Exception as error:
            # an answer like any other: browsers write others into their log
            problems = problems_of(told(error))
        return JSONResponse({"problems": problems})

    routes = [
        Route("/draft/{key}", draft, methods=["POST"]),
        Route("/", start_page),
        WebSocketRoute("/starting", starting_line),
        *(page(name, file) for name, file in _PAGES.items()),
        *(line(name) for name in _LINES),
        Route("/report/{key}", report),
        Route("/saved/{key}", saved_page),
        Mount("/static", StaticFiles(directory=PAGE)),
    ]
    return Gate(Starlette(routes=routes, lifespan=lifespan), token=token, port=port)


async def _serve_page(websocket: WebSocket, place: Place, told_by: Start | None = None) -> None:
    """Talk to a page until it is gone."""
    await websocket.accept()
    page = Page()
    if told_by is not None:
        told_by.follow(page)
    sender = asyncio.create_task(_send(websocket, page, _BEAT_S if isinstance(place, Theatre) else None))
    # Requests are read while a recipe is being opened, and wait for it.
    joined = asyncio.create_task(place.join(page))
    try:
        while True:
            text = await websocket.receive_text()
            await joined
            await place.ask(page, text)
    except (WebSocketDisconnect, KeyError, RuntimeError):
        pass
    finally:
        if told_by is not None:
            told_by.unfollow(page)
        joined.cancel()
        sender.cancel()
        # A server that ends cancels this too: the page's stroke is saved all the same.
        await asyncio.shield(_forget(place, page, joined))


async def _forget(place: Place, page: Page, joined: asyncio.Task[None]) -> None:
    with contextlib.suppress(asyncio.CancelledError, Exception):
        await joined
    await place.leave(page)


async def _send(websocket: WebSocket, page: Page, beat_s: float | None) -> None:
    with contextlib.suppress(WebSocketDisconnect, RuntimeError):
        try:
            while (message := await _next(page, websocket, beat_s)) is not None:
                if isinstance(message, str):
                    await websocket.send_text(message)
                else:
                    await websocket.send_bytes(message)
        except ValueError:
            # A text that cannot be sent: the page connects anew rather than waiting for what never comes.
            await websocket.close(1011)
            return
        await websocket.close(1013)


async def _next(page: Page, websocket: WebSocket, beat_s: float | None) -> str | bytes | None:
    """What is to be sent next; while there is nothing, a sign of life each so many seconds."""
    waiting = asyncio.create_task(page.waiting.get())
    try:
        while not (await asyncio.wait({waiting}, timeout=beat_s))[0]:
            await websocket.send_text(_ALIVE)
        return waiting.result()
    finally:
        waiting.cancel()
