"""How often a heart that is pulled is drawn, in a real browser, and how long it takes from the pointer to the picture.

    heartcase studio NAME.case
    python -m tests.studio.page.frames ADDRESS [--seconds 20] [--plot frames.png]

ADDRESS is what ``heartcase studio`` printed. A hand pulls the tissue in the middle of the picture about. Measured
inside the page, after three seconds: times between pictures of a heart that moved, when the graphics card was done with
each; and from the time stamp of a movement of the pointer until the picture of the first frame that the server sent
after it took that movement over. What the screen itself takes is at most one frame more.
"""

from __future__ import annotations

import argparse
import math
import sys
from pathlib import Path

import numpy as np

from tests.studio.page.conftest import SWITCHES, find_browser

WARM_S = 3.0
HOOKS = """
window.measured = { pictures: [], pointer: [] };
{
  const sent = new Map(); // movements that are under way, by number
  let taken = [], shown = [], moved = null;
  addEventListener("pointermove", (event) => { if (event.buttons) moved = event.timeStamp; }, true);
  const Plain = WebSocket;
  window.WebSocket = class extends Plain {
    constructor(...all) {
      super(...all);
      this.addEventListener("message", ({ data }) => {
        if (typeof data !== "string") {
          [shown, taken] = [[...shown, ...taken], []];
          return;
        }
        const { kind, id } = JSON.parse(data);
        if (kind === "done" && sent.has(id)) taken.push(sent.get(id));
        sent.delete(id);
      });
    }
    send(data) {
      const { do: what, id } = JSON.parse(data);
      if (what === "drag" && moved !== null) sent.set(id, moved);
      super.send(data);
    }
  };
  window.watch = (picture) => {
    const draw = picture.draw.bind(picture);
    const gl = picture.renderer.getContext();
    picture.draw = () => {
      draw();
      const due = shown;
      shown = [];
      gl.readPixels(0, 0, 1, 1, gl.RGBA, gl.UNSIGNED_BYTE, new Uint8Array(4));
      const now = performance.now();
      window.measured.pictures.push(now);
      for (const at of due) window.measured.pointer.push(now - at);
    };
  };
}
"""
OPEN = "(await import('/static/operating/main.js')).open"


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("address")
    parser.add_argument("--seconds", type=float, default=20.0)
    parser.add_argument("--plot", type=Path, help="picture of the times between pictures")
    given = parser.parse_args()
    from playwright.sync_api import sync_playwright

    path = find_browser()
    with sync_playwright() as running:
        browser = running.chromium.launch(executable_path=path, args=SWITCHES)
        tab = browser.new_context(viewport={"width": 1366, "height": 768}).new_page()
        tab.add_init_script(HOOKS)
        tab.goto(given.address)
        tab.locator("body[data-ready=true]").wait_for(timeout=590_000)
        tab.evaluate(f"async () => window.watch({OPEN}.picture)")
        tab.keyboard.press("g")
        box = tab.locator("#scene").bounding_box()
        x, y = box["x"] + 0.45 * box["width"], box["y"] + 0.55 * box["height"]
        tab.mouse.move(x, y)
        tab.mouse.down()
        began = None
        for n in range(int((WARM_S + given.seconds) / 0.02)):
            if began is None and 0.02 * n >= WARM_S:
                tab.evaluate("() => { window.measured.pictures = []; window.measured.pointer = []; }")
                began = tab.evaluate(f"async () => [{OPEN}.header.time_s, performance.now(), {OPEN}.header.frame]")
            tab.mouse.move(x + 40 * math.sin(0.11 * n), y + 25 * math.sin(0.17 * n))
            tab.wait_for_timeout(20)
        ended = tab.evaluate(f"async () => [{OPEN}.header.time_s, performance.now(), {OPEN}.header.frame]")
        measured = tab.evaluate("() => window.measured")
        facts = tab.evaluate(
            f"""async () => {{ const {{ heart, renderer, detail }} = {OPEN}.picture; detail.moved();
            return {{ nodes: heart.nodes.count, level: detail.step.level, part: detail.step.part }}; }}"""
        )
        tab.mouse.up()
        browser.close()
    gaps, pointer = np.diff(measured["pictures"]), np.array(measured["pointer"])
    seconds = (ended[1] - began[1]) / 1000.0
    print(
        f"{facts['nodes']} nodes; drawn at level of detail {facts['level']}, {facts['part']:g} of the width in pixels"
    )
    print(f"{len(measured['pictures']) / seconds:.1f} pictures a second, {(ended[2] - began[2]) / seconds:.1f} frames")
    print(f"simulated time over time that went by: {(ended[0] - began[0]) / seconds:.2f}")
    for name, times in (("between pictures", gaps), ("pointer to picture", pointer)):
        half, most = np.percentile(times, [50, 99])
        print(f"{name:20} {half:7.1f} ms median {most:7.1f} at 99% {times.max():7.1f} most")
    if given.plot:
        plot(gaps, given.plot)
    return 0


def plot(gaps, path):
    from matplotlib.figure import Figure

    figure = Figure(figsize=(8, 3), layout="constrained")
    axes = figure.subplots()
    axes.plot(np.cumsum(gaps) / 1000.0, gaps, ".", markersize=3)
    axes.axhline(1000.0 / 30.0, linewidth=1)
    axes.set(xlabel="time [s]", ylabel="since the picture before [ms]", ylim=(0.0, None))
    figure.savefig(path, dpi=120)


if __name__ == "__main__":
    sys.exit(main())
