"""A page that operates without a browser: what it asks, and the heart that it would show by what it is sent."""

from __future__ import annotations

import json
import time
from contextlib import contextmanager
from dataclasses import dataclass, field

import numpy as np
from starlette.testclient import TestClient

from heartcase.studio.operating.theatre import Origin
from heartcase.studio.serving.app import make_app
from heartcase.studio.starting.registry import Registry
from tests.studio.talking import ADDRESS, PORT, TOKEN

UP = {"axes": [[1, 0, 0], [0, 1, 0], [0, 0, 1]]}
"""Axes of an eye above the heart that looks down."""


def unpacked(data):
    """Header and arrays of a binary message."""
    length = int.from_bytes(data[:4], "little")
    header, payload = json.loads(data[4 : 4 + length]), data[4 + length :]
    assert (4 + length) % 4 == 0
    arrays = {}
    for name, one in header["arrays"].items():
        count = int(np.prod(one["shape"]))
        arrays[name] = np.frombuffer(payload, np.dtype(one["dtype"]).newbyteorder("<"), count, one["at"])
        arrays[name] = arrays[name].reshape(one["shape"])
    return header, arrays


@dataclass
class Operator:
    """A page: the frames that it was sent, and where it has the nodes by them."""

    socket: object
    takes: bool = True
    told: list[dict] = field(default_factory=list)
    frames: list[dict] = field(default_factory=list)
    sizes: list[int] = field(default_factory=list)
    topology: tuple | None = None
    topology_count: int = 0
    displacement: np.ndarray | None = None
    arrays: dict = field(default_factory=dict)
    slices: dict = field(default_factory=dict)
    number: int = 0

    def next(self):
        """The next message, taken."""
        message = self.socket.receive()
        if message.get("bytes") is not None:
            self._take(message["bytes"])
            return None
        assert message.get("text") is not None, message
        found = json.loads(message["text"])
        self.told.append(found)
        return found

    def hear(self, *kinds):
        """Take messages until one of these kinds, which is returned."""
        while True:
            found = self.next()
            if found is not None and found["kind"] in kinds:
                return found

    def ask(self, do, **request):
        """Ask, and take the answer."""
        self.number += 1
        self.socket.send_text(json.dumps({"id": self.number, "do": do} | request))
        while (answer := self.hear("done", "refused")).get("id") != self.number:
            pass
        return answer

    def done(self, do, **request):
        answer = self.ask(do, **request)
        assert answer["kind"] == "done", answer
        return answer

    def until(self, check, seconds=60.0):
        """Take messages until a frame of which something is so; the frame."""
        end = time.monotonic() + seconds
        while not (self.frames and check(self.frames[-1])):
            assert time.monotonic() < end, "it did not come to that"
            self.next()
        return self.frames[-1]

    def at(self, do, place_mm, **more):
        """Point at a place from above."""
        x, y, z = place_mm
        return self.ask(do, pointer={"start_mm": [x, y, z + 100.0], "direction": [0, 0, -1]} | UP, **more)

    def _take(self, data):
        header, arrays = unpacked(data)
        if header["kind"] == "topology":
            if self.displacement is None or len(self.displacement) != header["node_count"]:
                self.displacement = np.full((header["node_count"], 3), np.nan)
            self.topology, self.topology_count = (header, arrays), self.topology_count + 1
            return
        if header["kind"] == "slice":
            self.slices[header["name"]] = header, arrays["greys"]
            return
        assert header["topology"] == self.topology[0]["topology"]
        size = header["block_nodes"]
        for block, steps in zip(arrays["blocks"], arrays["steps"], strict=True):
            part = self.displacement[block * size : (block + 1) * size]
            part[:] = steps[: len(part)] * header["scale"]
        self.frames.append(header)
        self.sizes.append(len(data))
        self.arrays = arrays
        if self.takes:
            self.socket.send_text(json.dumps({"do": "seen", "frame": header["frame"]}))


@contextmanager
def theatre(case, out, recipe=None):
    """A browser that may open this case, the address of its socket, and the theatre itself."""
    registry = Registry(TOKEN)
    origin = None if recipe is None else Origin(recipe, registry.open_recipe(recipe, out=out).address)
    opened = registry.open_case(case, out=out, origin=origin)
    app = make_app(registry, token=TOKEN, port=PORT)
    with TestClient(app, base_url=ADDRESS, follow_redirects=False) as browser:
        assert browser.get(opened.address, params={"token": TOKEN}).status_code == 303
        yield browser, opened
    """The server's end ends the session."""


@contextmanager
def operator(browser, opened, **options):
    """A page that has the case open."""
    url = f"ws://127.0.0.1:{PORT}/operating/{opened.key}"
    with browser.websocket_connect(url, headers={"origin": ADDRESS}) as socket:
        page = Operator(socket, **options)
        page.opened = page.hear("opened", "failed")
        yield page
