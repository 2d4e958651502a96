"""Memory of the studio's server and of its page while somebody operates: grabs, pulls, lets go, cuts, takes back.

``python -m tests.studio.page.growth CASE --seconds 600`` prints both over time, and ends with 1 where one of them grew
by more than is allowed after warming up. The server is a process of its own; memory is read by psutil, that of the page
is Chromium's JavaScript heap after a collection.
"""

from __future__ import annotations

import argparse
import os
import sys
import time
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import psutil

from tests.studio.page.conftest import SWITCHES, find_browser
from tests.studio.process import started

WARM_PART = 0.3
"""First part of the time that does not count."""
SERVER_MB_PER_MINUTE = 10.0
PAGE_MB_PER_MINUTE = 1.0
"""What is allowed at most, by a line through what was measured."""
OPEN = "(await import('/static/operating/main.js')).open"


@dataclass(frozen=True)
class Growth:
    """What was measured."""

    times_s: np.ndarray
    server_mb: np.ndarray
    page_mb: np.ndarray
    act_count: int

    def per_minute(self, values):
        """Slope of a line through what came after warming up, MB a minute."""
        late = self.times_s >= WARM_PART * self.times_s[-1]
        return 60.0 * float(np.polyfit(self.times_s[late], values[late], 1)[0])


def operate(case: Path, seconds: float, browser, *, every_s: float = 5.0, say=print) -> Growth:
    """Operate on a case for so long, in a browser that runs."""
    rows, rounds = [], 0
    with started(case) as (process, address):
        server = psutil.Process(process.pid)
        tab = browser.new_page(viewport={"width": 800, "height": 600})
        inside = tab.context.new_cdp_session(tab)
        tab.goto(address, timeout=300_000)
        tab.locator("body[data-ready=true]").wait_for(timeout=900_000)
        box = tab.locator("#scene").bounding_box()
        x, y = box["x"] + box["width"] / 2, box["y"] + box["height"] / 2
        began = told = time.monotonic()
        while time.monotonic() - began < seconds:
            rounds += 1
            pull(tab, x, y)
            if rounds % 3 == 0:
                cut(tab, x, y)
                for _ in range(2):
                    tab.keyboard.press("u")
                    tab.wait_for_timeout(300)
                tab.keyboard.press(" ")
                # the second took back that a hand let go
                tab.wait_for_timeout(300)
                tab.keyboard.press("x")
            if rounds % 40 == 0:
                tab.keyboard.press("v")
            if time.monotonic() - told >= every_s or not rows:
                told = time.monotonic()
                inside.send("HeapProfiler.collectGarbage")
                heap = inside.send("Runtime.getHeapUsage")["usedSize"]
                rows.append((told - began, server.memory_info().rss / 1e6, heap / 1e6))
                say(f"{rows[-1][0]:7.1f} s  server {rows[-1][1]:8.1f} MB  page {rows[-1][2]:7.2f} MB  rounds {rounds}")
        acts = tab.evaluate(f"async () => {OPEN}.header.act_count")
        tab.close()
    times, server_mb, page_mb = np.array(rows).T
    return Growth(times, server_mb, page_mb, acts)


def pull(tab, x, y):
    """Grab what is in the middle, lead it about, and let go."""
    tab.keyboard.press("g")
    tab.mouse.move(x, y)
    tab.mouse.down()
    for step in range(12):
        tab.mouse.move(x + 20 * np.sin(0.5 * step), y + 15 * np.cos(0.5 * step))
        tab.wait_for_timeout(30)
    tab.mouse.up()
    tab.wait_for_timeout(100)


def cut(tab, x, y):
    """A short cut in the middle."""
    tab.keyboard.press("c")
    tab.mouse.move(x - 25, y)
    tab.mouse.down()
    tab.mouse.move(x + 25, y, steps=8)
    tab.mouse.up()
    tab.wait_for_timeout(1500)


def main() -> int:
    """Operate, and say how it grew."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("case", type=Path)
    parser.add_argument("--seconds", type=float, default=600.0)
    options = parser.parse_args()
    from playwright import sync_api as playwright

    with playwright.sync_playwright() as running:
        browser = running.chromium.launch(executable_path=find_browser(), args=SWITCHES)
        found = operate(options.case, options.seconds, browser, say=lambda words: print(words, flush=True))
        browser.close()
    server, page = found.per_minute(found.server_mb), found.per_minute(found.page_mb)
    print(f"server {server:+.1f} MB a minute, page {page:+.2f} MB a minute, after the first {100 * WARM_PART:.0f}%")
    return int(server > SERVER_MB_PER_MINUTE or page > PAGE_MB_PER_MINUTE)


if __name__ == "__main__":
    os.environ.setdefault("PYTHONUNBUFFERED", "1")
    sys.exit(main())
