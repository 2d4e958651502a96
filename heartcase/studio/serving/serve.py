"""Running the studio on this machine, until it is interrupted."""

from __future__ import annotations

import contextlib
import secrets
import socket
from collections.abc import Callable
from pathlib import Path

import uvicorn

from heartcase.schemas.errors import UsageError
from heartcase.studio.asking import REQUEST_SIZE_MAX
from heartcase.studio.serving.allocator import allocate_from_one_heap
from heartcase.studio.serving.app import make_app
from heartcase.studio.starting.registry import Left, Registry
from heartcase.studio.starting.start import Start

__all__ = ["ADDRESS", "listening", "serve"]

ADDRESS = "127.0.0.1"
"""The studio is for this machine alone."""
_CLOSING_S = 5


def serve(
    *,
    recipe: Path | None = None,
    case: Path | None = None,
    folder: Path | None = None,
    out: Path | None = None,
    port: int,
    ready: Callable[[str], None],
    noted: Callable[[str], None] = lambda _: None,
) -> Left:
    """Serve the studio's pages, until the process is interrupted; what it leaves then.

    Parameters
    ----------
    recipe, case
        What the page shows first: a recipe's file, or a case's folder; the start page where both are left out.
    folder
        Where the start page looks, and nowhere else; the user's own folder, the present one and that of the recipe or
        the case when left out. It begins in the last one then, unless nothing in it can be opened.
    out
        Directory that the recipe's case is built in, with the build's cache; when left out, the one that the start page
        takes.
    port
        Port to listen on; any free one at 0.
    ready
        Told the address with its token, once the server can be reached.
    noted
        Told where else there is work on the recipe, if there is none where it is opened.

    Raises
    ------
    UsageError
        The port is taken, or the case cannot be opened.
    """
    allocate_from_one_heap()
    token = secrets.token_urlsafe(24)
    registry, address = Registry(token), "/"
    opened = recipe or case
    begin = folder or (opened.resolve().parent if opened else Path.cwd())
    roots = [folder] if folder else [Path.home(), Path.cwd(), begin]
    start = Start(registry, roots=roots, begin=begin, looks=folder is not None)
    if recipe is not None:
        if (note := start.left_elsewhere(recipe, out=out)) is not None:
            noted(note)
        address = start.open_recipe(recipe, out=out)
    elif case is not None:
        address = start.open_case(case)
    with listening(port) as listener:
        port = listener.getsockname()[1]
        app = make_app(registry, token=token, port=port, start=start)
        config = uvicorn.Config(
            app,
            log_level="error",
            access_log=False,
            server_header=False,
            date_header=False,
            ws="websockets-sansio",
            ws_max_size=REQUEST_SIZE_MAX,
            # what is sent is compressed where that helps
            ws_per_message_deflate=False,
            timeout_graceful_shutdown=_CLOSING_S,
        )
        start.begin_to_compile()
        ready(f"http://{ADDRESS}:{port}{address}?token={token}")
        with contextlib.suppress(KeyboardInterrupt):
            uvicorn.Server(config).run(sockets=[listener])
    return registry.left()


def listening(port: int) -> socket.socket:
    """A socket of this machine on which the server listens.

    Parameters
    ----------
    port
        Any free one at 0.

    Raises
    ------
    UsageError
        The port is taken.
    """
    # where it is named as TCP, asyncio has no message wait until the one before is acknowledged, often 40 ms later
    listener = socket.socket(socket.AF_INET, socket.SOCK_STREAM, socket.IPPROTO_TCP)
    try:
        listener.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        listener.bind((ADDRESS, port))
        listener.listen()
    except OSError as error:
        listener.close()
        reason = (error.strerror or "the system gives no reason").lower()
        raise UsageError(f"cannot listen on port {port} ({reason}): give another", place="--port") from None
    return listener
