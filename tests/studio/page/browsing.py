"""A browser that has the studio open: a real one, without a window.

With ``HEARTCASE_SHOTS=FOLDER`` each test leaves a picture of its page there.
"""

from __future__ import annotations

import io
import os
import re
import threading
import time
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import SimpleITK
import uvicorn
from PIL import Image
from scipy.spatial.transform import Rotation

from heartcase.studio.serving.app import make_app
from heartcase.studio.serving.serve import listening
from heartcase.studio.starting.registry import Registry
from heartcase.studio.starting.start import Start

TOKEN = "a-token"
WAIT_MS = 120_000
"""Until the page is ready: kernels may have to be compiled first."""
SILENT_MS = 60_000
"""How long a page that operates waits before it says that the server does not answer."""

STRAIGHT = np.diag([-1.0, 1.0, 1.0])
"""Stored with i to the patient's right."""
TURNED = Rotation.from_euler("z", 35.0, degrees=True).as_matrix() @ STRAIGHT
SIZE, SPACING = np.array([40, 30, 24]), np.array([1.0, 1.5, 2.0])
BLOCK = (np.array([26, 6, 15]), np.array([34, 13, 21]))
"""First and last + 1 voxel (i, j, k) of what is bright."""

RECIPE = """\
# a comment that stays
heartcase_recipe = 1
name = "painted"

[scan]
path = "scan.nii.gz"
modality = "MR"
"""


def write_recipe(folder, direction=STRAIGHT):
    """A recipe without strokes on a scan of a bright block; its path, and the affine (4, 4) of the scan, LPS mm."""
    values = np.random.default_rng(3).normal(100.0, 6.0, SIZE[::-1])
    (i0, j0, k0), (i1, j1, k1) = BLOCK
    values[k0:k1, j0:j1, i0:i1] += 400.0
    image = SimpleITK.GetImageFromArray(np.rint(values).astype(np.int16))
    image.SetSpacing(SPACING.tolist())
    image.SetOrigin((13.0, -21.0, 7.0))
    image.SetDirection(direction.ravel().tolist())
    SimpleITK.WriteImage(image, str(folder / "scan.nii.gz"))
    path = folder / "painted.toml"
    path.write_text(RECIPE)
    affine = np.eye(4)
    affine[:3, :3] = direction * SPACING
    affine[:3, 3] = image.GetOrigin()
    return path, affine


class Server:
    """The studio's server in a thread of this process, on a port that stays the same when it is started again."""

    def __init__(self, recipe):
        self.recipe, self.port, self._server = recipe, 0, None

    def start(self, token=TOKEN):
        listener = listening(self.port)
        self.port = listener.getsockname()[1]
        registry = Registry(token)
        opened = self.opened = self.open_in(registry)
        self.address = f"http://127.0.0.1:{self.port}{opened.address}?token={token}"
        app = make_app(registry, token=token, port=self.port, start=self.start_page(registry))
        self._server = uvicorn.Server(
            uvicorn.Config(app, log_level="error", ws="websockets-sansio", timeout_graceful_shutdown=1)
        )
        self._thread = threading.Thread(target=self._server.run, kwargs={"sockets": [listener]}, daemon=True)
        self._listener = listener
        self._thread.start()

    def open_in(self, registry):
        return registry.open_recipe(self.recipe, out=self.recipe.parent / "out")

    def start_page(self, registry):
        folder = self.recipe.parent
        return Start(registry, roots=[folder], state=folder / "state")

    def stop(self):
        if self._server is not None:
            self._server.should_exit = True
            self._thread.join(timeout=30)
            self._listener.close()
            self._server = None


@contextmanager
def serving(recipe):
    server = Server(recipe)
    server.start()
    try:
        yield server
    finally:
        server.stop()


class Page:
    """The studio's page in a browser: what is seen, and whether anything went wrong."""

    def __init__(self, context, server):
        self.server, self.faults, self.requests = server, [], []
        self.tab = context.new_page()
        self.tab.on("console", self._hear)
        self.tab.on("pageerror", lambda error: self.faults.append(str(error)))
        self.tab.on("request", lambda request: self.requests.append(request.url))
        self.tab.on("websocket", lambda socket: self.requests.append(socket.url))

    def _hear(self, said):
        # where there is no graphics card the browser itself reads the canvas back, and complains of its own reading
        is_own = "GL Driver Message (OpenGL, Performance" in said.text
        if said.type in ("error", "warning") and not is_own:
            self.faults.append(said.text)

    def open(self):
        self.tab.goto(self.server.address)
        self.ready()

    def ready(self):
        self.tab.locator("body[data-ready=true]").wait_for(timeout=WAIT_MS)
        if self.tab.locator("body.operate-page:not(.offline-page)").count():
            # on a busy machine this process may stand still for long, and what a user does meanwhile is left out
            script = "async (ms) => { (await import('/static/operating/main.js')).open.connection.silentMs = ms; }"
            self.tab.evaluate(script, SILENT_MS)
        self.drawn()

    def drawn(self):
        """Wait until what was asked for is drawn."""
        self.tab.evaluate("() => new Promise((done) => requestAnimationFrame(() => requestAnimationFrame(done)))")

    def saved(self, count=None):
        """Wait until all that was painted is saved, and this many strokes can be taken back."""
        if count is not None:
            self.tab.locator("#undo .count").get_by_text(str(count), exact=True).wait_for(timeout=60_000)
        self.tab.locator("#saved[data-state=saved]").wait_for(timeout=60_000)
        self.drawn()

    def text(self, selector):
        return self.tab.locator(selector).inner_text()

    def box(self, view):
        """Left, top, width, height of a view's picture, CSS pixels."""
        box = self.tab.locator(f"#{view} .surface").bounding_box()
        return box["x"], box["y"], box["width"], box["height"]

    def pixels(self, view):
        """What is seen of a view: (height, width, 3), bytes."""
        x, y, width, height = self.box(view)
        shot = self.tab.screenshot(clip={"x": x, "y": y, "width": width, "height": height}, animations="disabled")
        return np.asarray(Image.open(io.BytesIO(shot)).convert("RGB"))

    def plain(self):
        """Labels in their own colours, without anything else on them."""
        self.tab.locator("#opacity").evaluate("(one) => { one.value = 100; one.dispatchEvent(new Event('input')); }")
        self.tab.locator("#outline").set_checked(False)
        self.drawn()


@contextmanager
def browsing(chromium, server, *, may_fault=False, **options):
    """A page of the studio in a browser of its own; nothing may go wrong on it, and nothing leave this machine."""
    options = {"viewport": {"width": 1280, "height": 720}, "locale": "en-GB", "color_scheme": "dark"} | options
    context = chromium.new_context(**options)
    page = Page(context, server)
    page.open()
    yield page
    if folder := os.environ.get("HEARTCASE_SHOTS"):
        test = re.sub(r"\W+", "_", os.environ["PYTEST_CURRENT_TEST"].partition("::")[2].partition(" ")[0])
        page.tab.screenshot(path=Path(folder) / f"{test}.png")
    here = (f"http://127.0.0.1:{server.port}/", f"ws://127.0.0.1:{server.port}/", "data:", "blob:")
    assert [url for url in page.requests if not url.startswith(here)] == []
    if not may_fault:
        assert not page.faults, page.faults
    context.close()


FRAMES = {
    "axial": ((1, 0, 0), (0, 1, 0)),
    "coronal": ((1, 0, 0), (0, 0, -1)),
    "sagittal": ((0, 1, 0), (0, 0, -1)),
}
"""To the right and down in each view, LPS: as radiologists see it."""


def pixel_of(points_mm, page, view, affine, frame=None):
    """Where positions (n, 3) are seen when the whole scan is shown: pixels (n, 2) from the picture's corner."""
    right, down = np.array(frame or FRAMES[view], float)
    _, _, width, height = page.box(view)
    steps = affine[:3, :3]
    extents = [(np.abs(axis @ steps) * SIZE).sum() for axis in (right, down)]
    scale = max(extents[0] / width, extents[1] / height)
    centre = steps @ ((SIZE - 1) / 2) + affine[:3, 3]
    off = np.atleast_2d(points_mm) - centre
    return np.stack([width / 2 + off @ right / scale, height / 2 + off @ down / scale], axis=-1)


def mm_of(indices, affine):
    """Positions of voxels (n, 3)."""
    return np.atleast_2d(indices) @ affine[:3, :3].T + affine[:3, 3]


def until(check, seconds=30.0):
    """Wait until something is so."""
    end = time.monotonic() + seconds
    while not check():
        assert time.monotonic() < end, "it did not come to be so"
        time.sleep(0.05)
