"""Who may talk to the studio: the browser that was given its address, on this machine, and no other page or program.

A page of another site can make a browser send requests here. So each must name this server as its host, come from no
other origin, and bring the cookie that only the address with the token gives.
"""

from __future__ import annotations

import hmac
import re
from urllib.parse import parse_qs

from starlette.types import ASGIApp, Message, Receive, Scope, Send

__all__ = ["Gate"]

_OPENED = re.compile(r"/(?:[a-z]+/[A-Za-z0-9_-]+)?")
"""Addresses that may be opened with the token: the start page, and what is open."""
_HEADERS = {
    "content-security-policy": (
        "default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self' data: blob:; connect-src 'self'; "
        "worker-src 'self'; base-uri 'none'; form-action 'none'; frame-ancestors 'none'"
    ),
    "x-content-type-options": "nosniff",
    "referrer-policy": "no-referrer",
    "cross-origin-opener-policy": "same-origin",
    "cross-origin-resource-policy": "same-origin",
    "cache-control": "no-store",
}


_REPORT_POLICY = (
    "default-src 'none'; style-src 'unsafe-inline'; img-src data:; base-uri 'none'; form-action 'none'; "
    "frame-ancestors 'none'; sandbox"
)
"""A report has its own styles and pictures in it, and no script."""


class Gate:
    """Refuses what does not come from the studio's own page; sets the headers that keep the page to itself.

    Parameters
    ----------
    app
        What is behind it.
    token
        Secret of this run.
    port
        Port that the server listens on.
    """

    def __init__(self, app: ASGIApp, *, token: str, port: int) -> None:
        self._app = app
        self._token = token
        self._cookie = f"heartcase-{port}"
        # Browsers send cookies to every server of this machine: the token cannot be told from what is in them.
        self._pass = hmac.new(token.encode(), b"cookie", "sha256").hexdigest()
        self._hosts = {f"{name}:{port}" for name in ("127.0.0.1", "localhost")}

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Let a request through, or refuse it."""
        if scope["type"] == "lifespan":
            await self._app(scope, receive, send)
            return
        headers = {name.decode("latin-1").lower(): value.decode("latin-1") for name, value in scope["headers"]}
        host, origin = headers.get("host", ""), headers.get("origin")
        is_ours = host in self._hosts and origin in (None, f"http://{host}")
        if scope["type"] == "websocket":
            if is_ours and origin is not None and self._is_known(headers):
                await self._app(scope, receive, send)
            else:
                await receive()
                await send({"type": "websocket.close", "code": 1008})
            return
        if not is_ours:
            await _answer(send, 403, "This address is not the studio's own.")
        elif self._asks_with_token(scope):
            flags = "Path=/; HttpOnly; SameSite=Strict"
            cookie = ("set-cookie", f"{self._cookie}={self._pass}; {flags}")
            await _answer(send, 303, "", cookie, ("location", scope["path"]))
        elif not self._is_known(headers):
            await _answer(send, 403, "Open the address that heartcase studio printed: it has the key to this page.")
        else:
            await self._app(scope, receive, _with_headers(send, scope["path"]))

    def _asks_with_token(self, scope: Scope) -> bool:
        if not _OPENED.fullmatch(scope["path"]) or scope["method"] != "GET":
            return False
        given = parse_qs(scope["query_string"].decode("latin-1")).get("token", [""])[0]
        return hmac.compare_digest(given.encode(), self._token.encode())

    def _is_known(self, headers: dict[str, str]) -> bool:
        for part in headers.get("cookie", "").split(";"):
            name, _, value = part.strip().partition("=")
            if name == self._cookie and hmac.compare_digest(value.encode(), self._pass.encode()):
                return True
        return False


def _with_headers(send: Send, path: str = "") -> Send:
    own = {"content-security-policy": _REPORT_POLICY} if path.startswith("/report/") else {}
    headers = _HEADERS | own

    async def sending(message: Message) -> None:
        if message["type"] == "http.response.start":
            kept = [(name, value) for name, value in message["headers"] if name.decode().lower() not in headers]
            message["headers"] = kept + [(name.encode(), value.encode()) for name, value in headers.items()]
        await send(message)

    return sending


async def _answer(send: Send, status: int, text: str, *headers: tuple[str, str]) -> None:
    own = (("content-type", "text/plain; charset=utf-8"), *headers)
    sending = _with_headers(send)
    encoded = [(name.encode(), value.encode()) for name, value in own]
    await sending({"type": "http.response.start", "status": status, "headers": encoded})
    await sending({"type": "http.response.body", "body": text.encode()})
