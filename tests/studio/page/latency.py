"""How long it takes from a movement of the pointer to changed labels on the screen, in a real browser.

    python -m tests.studio.page.latency ADDRESS [--moves 300]

ADDRESS is what ``heartcase studio`` printed. Strokes are drawn from the middle of the axial slice outwards, and taken
back. Measured inside the page: from the time stamp of the pointer's event until the slices with the changed labels are
drawn (read back from the graphics card); what the screen itself takes is at most one frame more.
"""

from __future__ import annotations

import argparse
import math
import sys

import numpy as np

from tests.studio.page.conftest import SWITCHES, find_browser

HOOKS = """
window.measured = [];
{
  let sent = [], came = []; // movements that were sent, and times of labels that came, oldest first
  let moved = null, hasLabels = false, isBlocks = false, shown = null;
  addEventListener("pointermove", (event) => { if (event.buttons && moved === null) moved = event.timeStamp; }, true);
  const Plain = WebSocket;
  window.WebSocket = class extends Plain {
    constructor(...all) {
      super(...all);
      this.addEventListener("message", ({ data }) => {
        if (typeof data !== "string") {
          hasLabels = true;
          came.push(performance.now());
        } else if (data.includes('"done"') && data.includes('"id"')) {
          if (!hasLabels) sent.shift();
          hasLabels = false;
        }
      });
    }
    send(data) {
      const { do: what } = JSON.parse(data);
      // a stroke begins when all answers have come
      if (what === "paint") [sent, came, moved, hasLabels, isBlocks] = [[], [], null, false, false];
      sent.push(what === "extend" ? [moved ?? performance.now(), performance.now()] : null);
      if (what === "extend") moved = null;
      super.send(data);
    }
  };
  const { texSubImage3D, drawArrays } = WebGL2RenderingContext.prototype;
  WebGL2RenderingContext.prototype.texSubImage3D = function (...all) {
    texSubImage3D.apply(this, all);
    // labels first, and then which blocks of them are empty
    if (!isBlocks) {
      const [one, at] = [sent.shift(), came.shift()];
      if (one && at) shown ??= [...one, at];
    }
    isBlocks = !isBlocks;
  };
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


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("address")
    parser.add_argument("--moves", type=int, default=300)
    parser.add_argument("--shot", help="picture of the page at the end")
    given = parser.parse_args()
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
    for name, times in zip(("until it is sent", "until the answer", "until it is drawn", "all"), found.T, strict=True):
        half, most = np.percentile(times, [50, 99])
        print(f"{name:18} {half:8.1f} {most:8.1f} {times.max():8.1f}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
