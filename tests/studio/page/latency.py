"""How long it takes from a movement of the pointer to changed labels on the screen, in a real browser.

    python -m tests.studio.page.latency --make FOLDER --size 160x200x200
    heartcase studio FOLDER/latency.toml
    python -m tests.studio.page.latency ADDRESS [--moves 300]

The first makes a scan of balls in noise: 160x200x200 are 6.4 million voxels, 320x400x400 are 51 million. ADDRESS is
what ``heartcase studio`` printed. Strokes are drawn from the middle of the axial slice outwards, and taken
back. Measured inside the page: from the time stamp of the pointer's event until the slices with the changed labels are
drawn (read back from the graphics card); what the screen itself takes is at most one frame more.
"""

from __future__ import annotations

import argparse
import math
import sys
from pathlib import Path

import numpy as np
import SimpleITK
from scipy.ndimage import gaussian_filter

from tests.studio.page.conftest import SWITCHES, find_browser

HOOKS = """
window.measured = [];
{
  // movements that were sent, by the number of their request: when the pointer moved, and when it was sent
  const sent = new Map();
  let moved = null, cameAt = null, hasLabels = false, shown = null;
  addEventListener("pointermove", (event) => { if (event.buttons && moved === null) moved = event.timeStamp; }, true);
  const Plain = WebSocket;
  window.WebSocket = class extends Plain {
    constructor(...all) {
      super(...all);
      this.addEventListener("message", ({ data }) => {
        if (typeof data !== "string") {
          cameAt ??= performance.now();
          hasLabels = true;
          return;
        }
        const { kind, id } = JSON.parse(data);
        if (id === undefined) return;
        // labels stand before the answer that they belong to, and are in the volume before the next picture
        const one = sent.get(id);
        sent.delete(id);
        if (kind === "done" && one && hasLabels) shown ??= [...one, cameAt];
        [cameAt, hasLabels] = [null, false];
      });
    }
    send(data) {
      const { do: what, id } = JSON.parse(data);
      if (what === "extend") {
        sent.set(id, [moved ?? performance.now(), performance.now()]);
        moved = null;
      }
      super.send(data);
    }
  };
  const { drawArrays } = WebGL2RenderingContext.prototype;
  WebGL2RenderingContext.prototype.drawArrays = function (...all) {
    drawArrays.apply(this, all);
    if (shown === null) return;
    const [at, sentAt, cameAt] = shown;
    shown = null;
    queueMicrotask(() => {
      this.readPixels(0, 0, 1, 1, this.RGBA, this.UNSIGNED_BYTE, new Uint8Array(4));
      const now = performance.now();
      window.measured.push([sentAt - at, cameAt - sentAt, now - cameAt, now - at]);
    });
  };
}
"""


BALLS = (((0, 0, 0), 20), ((0, 0, 45), 22), ((0, 45, 0), 18), ((30, 0, 0), 16), ((0, -45, 0), 19), ((0, 0, -45), 17))
"""Middles off the scan's, voxels, and radii."""


def make(folder, shape):
    """A scan of balls in smooth noise, of 1 mm, and a recipe for it."""
    values = 120.0 * gaussian_filter(np.random.default_rng(0).normal(size=shape).astype(np.float32), 1.5)
    axes = [np.arange(n, dtype=np.float32) - n / 2 for n in shape]
    for middle, radius in BALLS:
        k, j, i = np.ix_(*(axis - off for axis, off in zip(axes, middle, strict=True)))
        away = np.sqrt(k**2 + j**2 + i**2)
        values += 300.0 / (1.0 + np.exp(np.clip((away - radius) / 1.5, -30.0, 30.0)))
    folder.mkdir(parents=True, exist_ok=True)
    image = SimpleITK.GetImageFromArray(np.rint(values).astype(np.int16))
    SimpleITK.WriteImage(image, str(folder / "latency.nii.gz"))
    text = 'heartcase_recipe = 1\nname = "latency"\n\n[scan]\npath = "latency.nii.gz"\nmodality = "MR"\n'
    (folder / "latency.toml").write_text(text)


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("address", nargs="?")
    parser.add_argument("--make", type=Path, metavar="FOLDER")
    parser.add_argument("--size", default="160x200x200")
    parser.add_argument("--moves", type=int, default=300)
    parser.add_argument("--shot", help="picture of the page at the end")
    given = parser.parse_args()
    if given.make:
        make(given.make, tuple(int(one) for one in given.size.split("x")))
        return 0
    from playwright.sync_api import sync_playwright

    path = find_browser()
    with sync_playwright() as running:
        browser = running.chromium.launch(executable_path=path, args=SWITCHES)
        tab = browser.new_context(viewport={"width": 1280, "height": 720}).new_page()
        tab.add_init_script(HOOKS)
        tab.goto(given.address)
        tab.locator("body[data-ready=true]").wait_for(timeout=590_000)
        box = tab.locator("#axial .surface").bounding_box()
        middle = (box["x"] + box["width"] / 2, box["y"] + box["height"] / 2)
        strokes = 0
        while len(tab.evaluate("() => window.measured")) < given.moves and strokes < given.moves:
            tab.keyboard.press(str(strokes % 5))
            angle = 2.4 * strokes
            for step in range(14):
                way = 4.0 + 6.0 * step
                tab.mouse.move(middle[0] + way * math.cos(angle), middle[1] + way * math.sin(angle))
                if step == 0:
                    tab.mouse.down()
                tab.wait_for_timeout(40)
            tab.mouse.up()
            tab.wait_for_timeout(250)
            strokes += 1
        found = np.array(tab.evaluate("() => window.measured"))
        if given.shot:
            tab.screenshot(path=given.shot)
        for _ in range(strokes):
            tab.keyboard.press("Control+z")
            tab.locator("#saved[data-state=saved]").wait_for(timeout=60_000)
        browser.close()
    print(f"{len(found)} changes of labels in {strokes} strokes, ms: median, 99%, most")
    for name, times in zip(
        ("page: until it is sent", "server and socket", "page: until it is drawn", "all"), found.T, strict=True
    ):
        half, most = np.percentile(times, [50, 99])
        print(f"{name:24} {half:8.1f} {most:8.1f} {times.max():8.1f}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
