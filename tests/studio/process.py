"""``heartcase studio`` as a process of its own, and a page that talks to it over a real socket."""

from __future__ import annotations

import http.cookiejar
import os
import re
import subprocess
import sys
import urllib.request
from contextlib import contextmanager
from urllib.parse import urlsplit

from websockets.exceptions import ConnectionClosed
from websockets.sync.client import connect

from tests.studio.talking import Talker


class Socket:
    """A socket of the websockets library, as the test client of Starlette has them."""

    def __init__(self, line):
        self.line = line

    def send_text(self, text):
        self.line.send(text)

    def send_bytes(self, data):
        self.line.send(data)

    def receive(self):
        found = self.line.recv(timeout=120)
        return {"text": found} if isinstance(found, str) else {"bytes": found}


GONE = (ConnectionClosed, OSError, EOFError)
"""What is raised where the server is gone."""


@contextmanager
def started(recipe):
    """The process, and the address that it printed; it is killed at the end."""
    command = [sys.executable, "-m", "heartcase", "studio", str(recipe), "--no-browser"]
    command += ["--out", str(recipe.parent / "out")]
    with subprocess.Popen(
        command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, env=os.environ
    ) as process:
        try:
            yield process, re.search(r"http://127\.0\.0\.1:\d+/\S*\?token=\S+", process.stdout.readline())[0]
        finally:
            process.kill()


def entered(address):
    """Where the printed address leads to, and the headers that show that one came by it."""
    cookies = http.cookiejar.CookieJar()
    opener = urllib.request.build_opener(urllib.request.HTTPCookieProcessor(cookies))
    with opener.open(address, timeout=60) as found:
        place = urlsplit(found.url)
    return place, {"Cookie": "; ".join(f"{one.name}={one.value}" for one in cookies)}


@contextmanager
def connected(address):
    """A page of it, which has the recipe open."""
    place, header = entered(address)
    # what is open is named by the end of the page's address
    path = f"/socket/{place.path.rpartition('/')[2]}".rstrip("/")
    url = f"ws://{place.netloc}{path}"
    origin = f"http://{place.netloc}"
    with connect(url, origin=origin, additional_headers=header, compression=None, max_size=None) as line:
        talker = Talker(Socket(line))
        talker.opened = talker.hear("opened", "failed")
        talker.hear("structures", "failed")
        yield talker
