"""A recipe on a small scan, and a page that talks to the studio's server without a browser."""

from __future__ import annotations

import json
import zlib
from contextlib import contextmanager
from dataclasses import dataclass, field

import numpy as np
from starlette.testclient import TestClient

from heartcase.studio.serving.app import make_app
from heartcase.studio.starting.registry import Registry
from heartcase.studio.starting.start import Start
from tests.cli.small_case import write_scan

TOKEN, PORT = "a-token", 4711
ADDRESS = f"http://127.0.0.1:{PORT}"

ANSWERS = (
    "done",
    "seen",
    "refused",
    "places",
    "planes",
    "proposal",
    "found_ends",
    "preview",
    "folder",
    "series",
    "go",
    "picture",
)

RECIPE = """\
# a comment that stays
heartcase_recipe = 1
name = "painted"

[scan]
path = "scan.nii.gz"

[[strokes]]
label = "background"
radius_mm = 0.0
points_mm = [{corner}]
"""


def write_recipe(folder):
    """A recipe with one stroke of background; its path, and a point in the middle of the scan, LPS mm."""
    import SimpleITK

    image = SimpleITK.ReadImage(str(write_scan(folder / "scan.nii.gz")))
    corner, middle = (
        [round(x, 2) for x in image.TransformContinuousIndexToPhysicalPoint(index)] for index in ((1, 1, 1), (5, 4, 3))
    )
    path = folder / "painted.toml"
    path.write_text(RECIPE.format(corner=corner))
    return path, middle


@dataclass
class Talker:
    """A page: what it asks, what it is told, and the labels that it would show."""

    socket: object
    labels: np.ndarray | None = None
    scan: np.ndarray | None = None
    told: list[dict] = field(default_factory=list)
    number: int = 0
    surface: dict | None = None

    def hear(self, *kinds):
        """Take messages until one of these kinds, which is returned."""
        while True:
            message = self.socket.receive()
            if message.get("bytes") is not None:
                self._take(message["bytes"])
                continue
            assert message.get("text") is not None, message
            found = json.loads(message["text"])
            self.told.append(found)
            if found["kind"] in kinds:
                return found

    def ask(self, **request):
        """Ask, and take the answer."""
        self.number += 1
        self.socket.send_text(json.dumps({"id": self.number} | request))
        while (answer := self.hear(*ANSWERS)).get("id") != self.number:
            pass
        return answer

    def _take(self, data):
        length = int.from_bytes(data[:4], "little")
        header, payload = json.loads(data[4 : 4 + length]), data[4 + length :]
        if header["encoding"] == "deflate":
            payload = zlib.decompress(payload)
        elif header["encoding"] == "runs":
            ends = np.frombuffer(payload[: len(payload) // 5 * 4], "<u4")
            values = np.frombuffer(payload[4 * len(ends) :], np.uint8)
            payload = np.repeat(values, np.diff(ends, prepend=0)).tobytes()
        if header["kind"] == "surface":
            self.surface = header | {"bytes": len(payload)}
            return
        if header["kind"] == "boxes":
            for *low, a, b, c in header["boxes"]:
                k, j, i = (slice(first, first + n) for first, n in zip(low[::-1], (c, b, a), strict=True))
                self.labels[k, j, i] = np.frombuffer(payload[: a * b * c], np.uint8).reshape(c, b, a)
                payload = payload[a * b * c :]
            return
        shape = header["size"][::-1]
        if header["kind"] == "scan":
            self.scan = np.frombuffer(payload, "<i2").reshape(shape) * header["scale"] + header["offset"]
            return
        part = np.frombuffer(payload, np.uint8).reshape(shape)
        if self.labels is None or part.shape == self.scan.shape:
            self.labels = part.copy()
        else:
            k, j, i = (slice(low, low + n) for low, n in zip(header["low"][::-1], shape, strict=True))
            self.labels[k, j, i] = part


@contextmanager
def studio(recipe):
    """A browser that has the studio of this recipe open; its start page looks into the recipe's folder alone."""
    registry = Registry(TOKEN)
    opened = registry.open_recipe(recipe, out=recipe.parent / "out")
    start = Start(registry, roots=[recipe.parent], state=recipe.parent / "state")
    app = make_app(registry, token=TOKEN, port=PORT, start=start)
    with TestClient(app, base_url=ADDRESS, follow_redirects=False) as browser:
        assert browser.get("/", params={"token": TOKEN}).status_code == 303
        browser.opened = opened
        yield browser


def socket_of(browser, line="socket"):
    """Address of a socket of what is open."""
    return f"ws://127.0.0.1:{PORT}/{line}/{browser.opened.key}"


@contextmanager
def page(browser):
    """A page of it."""
    with browser.websocket_connect(socket_of(browser), headers={"origin": ADDRESS}) as socket:
        talker = Talker(socket)
        talker.opened = talker.hear("opened", "failed")
        if talker.opened["kind"] == "opened":
            talker.hear("structures")
        yield talker


@contextmanager
def line(browser, path, *, first):
    """A page on another socket of the studio, once it was told the first message of this kind."""
    with browser.websocket_connect(f"ws://127.0.0.1:{PORT}{path}", headers={"origin": ADDRESS}) as socket:
        talker = Talker(socket)
        talker.first = talker.hear(first)
        yield talker
