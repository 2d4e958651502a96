"""How long the server takes for each message of a stroke, through its socket: no page is in it.

    python -m tests.studio.page.latency --make FOLDER --size 160x200x200
    heartcase studio FOLDER/latency.toml
    python -m tests.studio.socket_frames ADDRESS [--strokes 16] [--mm-per-pixel 0.55] [--apart-ms 40] [--preview]

ADDRESS is what ``heartcase studio`` printed. Strokes as ``tests.studio.page.latency`` draws them, with the three planes
of the scan looked at, and the rest asked for as the page does; all is taken back. With ``--preview`` the quick surface
is asked for after each stroke, and the next stroke begins when it came.
"""

from __future__ import annotations

import argparse
import http.client
import json
import sys
import threading
import time
from urllib.parse import urlsplit

import numpy as np
from websockets.sync.client import connect

from tests.studio.timed_strokes import messages, planes, print_times

PAUSE_S = 0.12
"""As ``PAUSE_MS`` of the page: the rest is asked for when no labels changed for so long."""
WAIT_S = 0.005
"""As ``WAIT_MS`` of the page: the quick surface is asked for so long after a stroke."""


class Talk:
    """A page's line: what it asks, and what each answer took, ms."""

    def __init__(self, socket):
        self.socket, self.took, self.number = socket, {}, 0
        self.has_rest, self.opened = False, {}
        self._asked, self._answers = {}, {}
        self._heard = threading.Condition()
        threading.Thread(target=self._listen, daemon=True).start()

    def _listen(self):
        for message in self.socket:
            now = time.perf_counter()
            if isinstance(message, bytes):
                continue
            told = json.loads(message)
            with self._heard:
                if told["kind"] in ("done", "seen"):
                    self.has_rest = told.get("rest", False)
                if told["kind"] in ("opened", "failed", "structures"):
                    self.opened[told["kind"]] = told
                if told.get("id") in self._asked:
                    do, start = self._asked.pop(told["id"])
                    self.took.setdefault(do, []).append(1000.0 * (now - start))
                    self._answers[told["id"]] = told
                self._heard.notify_all()

    def wait(self, ready):
        with self._heard:
            self._heard.wait_for(ready, timeout=300)

    def send(self, do, **said):
        """Ask for something; the number of the request."""
        self.number += 1
        with self._heard:
            self._asked[self.number] = (do, time.perf_counter())
        self.socket.send(json.dumps({"id": self.number, "do": do, **said}))
        return self.number

    def ask(self, do, **said):
        """Ask, and wait for the answer."""
        number = self.send(do, **said)
        self.wait(lambda: number in self._answers)
        return self._answers.pop(number)


def _connect(address):
    """A socket of what is open at an address with its token."""
    parts = urlsplit(address)
    line = http.client.HTTPConnection(parts.netloc)
    line.request("GET", f"{parts.path}?{parts.query}")
    cookie = line.getresponse().getheader("set-cookie").partition(";")[0]
    return connect(
        f"ws://{parts.netloc}{parts.path.replace('/prepare/', '/socket/')}",
        origin=f"http://{parts.netloc}",
        additional_headers={"cookie": cookie},
        max_size=None,
        compression=None,
    )


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("address")
    parser.add_argument("--strokes", type=int, default=16)
    parser.add_argument("--mm-per-pixel", type=float, default=0.55)
    parser.add_argument("--apart-ms", type=float, default=40.0)
    parser.add_argument("--preview", action="store_true")
    given = parser.parse_args()
    talk = Talk(_connect(given.address))
    talk.wait(lambda: "structures" in talk.opened or "failed" in talk.opened)
    opened = talk.opened["opened"]
    size, affine = np.array(opened["size"]), np.array(opened["index_to_world"])
    middle = (affine[:3, :3] @ (size // 2) + affine[:3, 3]).tolist()
    talk.ask("look", planes=planes(middle))
    names = [label["name"] for label in opened["labels"]]
    surfaces = []
    for stroke in range(given.strokes):
        for do, said in messages(stroke, middle, names, given.mm_per_pixel):
            talk.send(do, **said)
            time.sleep(given.apart_ms / 1000.0)
        over = time.perf_counter()
        talk.ask("end")
        if given.preview:
            time.sleep(WAIT_S)
            talk.ask("preview", coarse=True)
            surfaces.append(1000.0 * (time.perf_counter() - over))
        time.sleep(PAUSE_S)
        until = time.perf_counter() + 0.25
        while talk.has_rest and time.perf_counter() < until:
            talk.ask("rest")
    for _ in range(given.strokes):
        talk.ask("undo")
    print_times(size.tolist(), talk.took)
    if surfaces:
        print(f"surface, from the end of a stroke: {np.median(surfaces):8.1f} {max(surfaces):8.1f}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
