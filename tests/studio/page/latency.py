"""How long it takes from a movement of the pointer to changed labels on the screen, in a real browser.

    python -m tests.studio.page.latency --make FOLDER --size 160x200x200
    heartcase studio FOLDER/latency.toml
    python -m tests.studio.page.latency ADDRESS [--moves 300] [--preview 20]

The first makes a scan of balls in noise: 160x200x200 are 6.4 million voxels, 320x400x400 are 51 million. ADDRESS is
what ``heartcase studio`` printed. Strokes are drawn from the middle of the axial slice outwards, and taken
back. Measured inside the page: from the time stamp of the pointer's event until the slices with the changed labels are
drawn (read back from the graphics card); what the screen itself takes is at most one frame more. With ``--preview``
also from the end of a stroke until the quick surface of what was painted is drawn, after so many strokes.
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
window.unseen = 0;
{
  // movements that were sent, by the number of their request: when the pointer moved, and when it was sent
  const sent = new Map();
  let endedAt = null, hasSurface = false; // a stroke, and whether its surface came
  addEventListener("pointerup", (event) => { [endedAt, hasSurface] = [event.timeStamp, false]; }, true);
  window.surfaces = [];
  // labels that came before their answer: when, and when a picture with them was drawn
  let moved = null, cameAt = null, drawnAt = null;
  // a movement whose labels are in the volume, and in no picture yet
  let shown = null;
  const move = "onpointerrawupdate" in window ? "pointerrawupdate" : "pointermove";
  addEventListener(move, (event) => { if (event.buttons && moved === null) moved = event.timeStamp; }, true);
  const Plain = WebSocket;
  window.WebSocket = class extends Plain {
    constructor(...all) {
      super(...all);
      this.addEventListener("message", ({ data }) => {
        if (typeof data !== "string") {
          const head = new TextDecoder().decode(new Uint8Array(data, 4, Math.min(data.byteLength - 4, 40)));
          if (head.includes('"surface"')) {
            if (endedAt !== null) hasSurface = true;
            return;
          }
          cameAt ??= performance.now();
          return;
        }
        const { kind, id } = JSON.parse(data);
        if (id === undefined) return;
        // labels stand before the answer that they belong to, and are in the volume before the next picture
        const one = sent.get(id);
        sent.delete(id);
        if (kind === "done" && one && cameAt !== null) {
          if (drawnAt !== null) note([...one, cameAt], drawnAt);
          else shown ??= [...one, cameAt];
          framesLeft = 2;
        }
        cameAt = drawnAt = null;
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
  const { drawArrays, drawElements } = WebGL2RenderingContext.prototype;
  WebGL2RenderingContext.prototype.drawElements = function (...all) {
    drawElements.apply(this, all);
    if (!hasSurface) return;
    this.readPixels(0, 0, 1, 1, this.RGBA, this.UNSIGNED_BYTE, new Uint8Array(4));
    window.surfaces.push(performance.now() - endedAt);
    [endedAt, hasSurface] = [null, false];
  };
  WebGL2RenderingContext.prototype.drawArrays = function (...all) {
    drawArrays.apply(this, all);
    // strips of the solids are drawn elsewhere first
    if (isAsked || this.getParameter(this.FRAMEBUFFER_BINDING) !== null) return;
    if (shown === null && (cameAt === null || drawnAt !== null)) return;
    isAsked = true;
    // when all slices are drawn
    queueMicrotask(() => {
      isAsked = false;
      this.readPixels(0, 0, 1, 1, this.RGBA, this.UNSIGNED_BYTE, new Uint8Array(4));
      const now = performance.now();
      if (shown !== null) note(shown, now);
      shown = null;
      if (cameAt !== null) drawnAt ??= now;
    });
  };
  let isAsked = false, framesLeft = 0;
  // labels that no slice shows change no picture
  const look = () => {
    if (shown !== null && framesLeft-- === 0) [shown, window.unseen] = [null, window.unseen + 1];
    requestAnimationFrame(look);
  };
  requestAnimationFrame(look);
  const note = ([at, sentAt, came], now) => window.measured.push([sentAt - at, came - sentAt, now - came, now - at]);
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
    parser.add_argument("--preview", type=int, default=0, help="strokes after which the quick surface is waited for")
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
        found, unseen = np.array(tab.evaluate("() => window.measured")), tab.evaluate("() => window.unseen")
        if given.preview:
            tab.locator("#preview-on").check()
            tab.locator("#preview-state").get_by_text("", exact=True).wait_for(state="attached")
            tab.wait_for_timeout(5000)
            tab.evaluate("() => window.surfaces.splice(0)")
        for number in range(given.preview):
            tab.keyboard.press(str(number % 5))
            tab.mouse.move(middle[0] + 30 * math.cos(number), middle[1] + 30 * math.sin(number))
            tab.mouse.down()
            tab.mouse.move(middle[0] + 34 * math.cos(number), middle[1] + 34 * math.sin(number))
            tab.mouse.up()
            tab.wait_for_timeout(3000)
        strokes += given.preview
        surfaces = tab.evaluate("() => window.surfaces")
        if given.shot:
            tab.screenshot(path=given.shot)
        for _ in range(strokes):
            tab.keyboard.press("Control+z")
            tab.locator("#saved[data-state=saved]").wait_for(timeout=60_000)
        browser.close()
    print(f"{len(found)} changes of labels in {strokes} strokes, and {unseen} off the slices, ms: median, 99%, most")
    for name, times in zip(
        ("page: until it is sent", "server and socket", "page: until it is drawn", "all"), found.T, strict=True
    ):
        half, most = np.percentile(times, [50, 99])
        print(f"{name:24} {half:8.1f} {most:8.1f} {times.max():8.1f}")
    if surfaces:
        print(f"{len(surfaces)} surfaces, ms: median {np.median(surfaces):.0f}, most {max(surfaces):.0f}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
