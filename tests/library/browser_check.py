"""Opens a catalogue in a real headless browser, by keyboard, from a folder, and takes pictures of what it sees.

    python tests/library/browser_check.py OUT/catalogue/index.html --case NAME --shots FOLDER [--axe axe.min.js]

It needs Playwright (``pip install playwright``) and an installed Chromium; where either is missing it says so and does
nothing, with exit code 77. It does not belong to the tests that run on every change.
"""

from __future__ import annotations

import argparse
import shutil
import sys
from pathlib import Path

SKIPPED = 77
SWITCHES = ["--no-sandbox", "--use-gl=angle", "--use-angle=swiftshader", "--enable-unsafe-swiftshader"]
BROWSERS = ("chromium", "chromium-browser", "google-chrome", "google-chrome-stable", "chrome")


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("index", type=Path)
    parser.add_argument("--case", required=True, help="name of a case to open")
    parser.add_argument("--shots", type=Path, default=Path("shots"))
    parser.add_argument("--axe", type=Path, help="axe.min.js of axe-core")
    given = parser.parse_args()
    try:
        from playwright.sync_api import sync_playwright
    except ImportError:
        print("skipped: Playwright is not installed")
        return SKIPPED
    browser = next((path for name in BROWSERS if (path := shutil.which(name))), None)
    if browser is None:
        print("skipped: there is no Chromium on this machine")
        return SKIPPED
    given.shots.mkdir(parents=True, exist_ok=True)
    with sync_playwright() as playwright:
        chromium = playwright.chromium.launch(executable_path=browser, args=SWITCHES)
        faults = Check(chromium, given.index.resolve(), given.shots, given.axe, given.case).run()
        chromium.close()
    for fault in faults:
        print(f"FAULT {fault}")
    print(f"{len(faults)} faults; pictures are in {given.shots}")
    return 1 if faults else 0


class Check:
    def __init__(self, chromium, index, shots, axe, case):
        self.chromium, self.index, self.shots, self.axe, self.case = chromium, index, shots, axe, case
        self.faults = []

    def page(self, *, width=1280, height=900, **options):
        page = self.chromium.new_context(
            viewport={"width": width, "height": height}, locale="en-GB", **options
        ).new_page()
        page.on("console", lambda said: said.type in ("error", "warning") and self.console(said.text))
        page.on("pageerror", lambda error: self.fault(f"script error: {error}"))
        return page

    def console(self, text):
        # The software renderer of a machine without a graphics card complains of reading pixels.
        if "GPU stall due to ReadPixels" not in text:
            self.fault(f"console: {text}")

    def fault(self, words):
        self.faults.append(words)

    def check(self, holds, words):
        print(("ok    " if holds else "FAULT ") + words)
        if not holds:
            self.fault(words)

    def shot(self, page, name, *, full=False):
        page.screenshot(path=str(self.shots / f"{name}.png"), full_page=full)

    def audit(self, page, where):
        """Run axe-core where it is given; it is put in past the page's own policy on scripts."""
        if self.axe is None:
            return
        page.evaluate(self.axe.read_text(encoding="utf-8"))
        found = page.evaluate("axe.run(document, {preload: false})")
        for one in found["violations"]:
            places = "; ".join(" ".join(map(str, node["target"])) for node in one["nodes"][:4])
            self.fault(f"axe on {where}: {one['id']} ({one['impact']}): {one['help']}: {places}")
        print(f"      axe on {where}: {len(found['violations'])} violations, {len(found['passes'])} rules passed")

    def run(self):
        for step in (self.see_index, self.see_case, self.see_viewer, self.see_narrow, self.see_without):
            step()
        return self.faults

    def see_index(self):
        page = self.page()
        page.goto(self.index.as_uri())
        cards = page.locator("#cards .card")
        total = cards.count()
        self.check(total > 0, f"the index shows {total} cards from {self.index.as_uri()[:7]}")
        self.audit(page, "the index")
        self.shot(page, "index")
        page.keyboard.press("Tab")
        self.check(page.evaluate("document.activeElement.className") == "skip", "the first Tab is on the skip link")
        for _ in range(12):
            page.keyboard.press("Tab")
            if page.evaluate("document.activeElement.id") == "search":
                break
        self.check(page.evaluate("document.activeElement.id") == "search", "Tab comes to the search")
        page.keyboard.type("zzzz")
        page.wait_for_timeout(300)
        self.check(cards.count() == 0 and "0" in page.inner_text("#count"), "a word that fits nothing finds nothing")
        page.keyboard.press("Control+a")
        page.keyboard.type(self.case.split("-")[0])
        page.wait_for_timeout(300)
        self.check(0 < cards.count() <= total, f"typing finds: {page.inner_text('#count')}")
        self.shot(page, "index-found")
        page.keyboard.press("Control+a")
        page.keyboard.press("Delete")
        page.select_option("#language", "de")
        self.check(page.evaluate("document.documentElement.lang") == "de", "the language can be changed")
        page.wait_for_timeout(300)
        self.shot(page, "index-de")
        page.locator(f'a[href*="{self.case}.html"]').first.focus()
        with page.expect_navigation():
            page.keyboard.press("Enter")
        self.check("lang=de" in page.url and self.case in page.url, "Enter opens the case, in the same language")
        page.context.close()

    def case_page(self, **options):
        page = self.page(**options)
        page.goto((self.index.parent / "cases" / f"{self.case}.html").as_uri())
        return page

    def see_case(self):
        page = self.case_page()
        self.check(page.evaluate("[...document.images].every(i => i.naturalWidth > 0)"), "all pictures are there")
        self.audit(page, "the case")
        self.shot(page, "case", full=True)
        page.context.close()

    def see_viewer(self):
        page = self.case_page()
        page.locator("#open-view").focus()
        page.keyboard.press("Enter")
        page.wait_for_selector("#viewer:not([hidden])")
        page.wait_for_timeout(500)
        self.check(page.evaluate("document.activeElement.id") == "stage", "opening leads to the view")
        self.audit(page, "the case with the view open")
        self.shot(page, "view-front")
        front = self.pixels(page)
        self.check(front["coloured"] > 0.05, f"{front['coloured']:.0%} of the view is drawn on")
        for _ in range(4):
            page.keyboard.press("ArrowLeft")
        page.keyboard.press("+")
        page.wait_for_timeout(900)
        self.check(self.pixels(page)["sum"] != front["sum"], "arrows turn the heart")
        self.check("Seen from" in page.inner_text("#view-status"), f"it says: {page.inner_text('#view-status')}")
        page.keyboard.press("Home")
        page.wait_for_timeout(900)
        self.check(abs(self.pixels(page)["sum"] - front["sum"]) < 1e-3 * front["sum"], "Home leads back")
        place = page.locator("#heart").bounding_box()
        middle = (place["x"] + place["width"] / 2, place["y"] + place["height"] / 2)
        page.mouse.move(*middle)
        page.mouse.down()
        page.mouse.move(middle[0] + 80, middle[1] + 30, steps=5)
        page.mouse.up()
        page.wait_for_timeout(900)
        self.check("right" in page.inner_text("#view-status"), "dragging to the right shows the patient's right side")
        page.locator("#stage").focus()
        before = self.pixels(page)["coloured"]
        page.mouse.wheel(0, -400)
        page.wait_for_timeout(300)
        self.check(self.pixels(page)["coloured"] > 1.1 * before, "the wheel comes nearer once the view is chosen")
        page.click("[data-move=reset]")
        for side in ("posterior", "left", "superior"):
            page.click(f"[data-side={side}]")
            page.wait_for_timeout(700)
            self.shot(page, f"view-{side}")
        page.click("[data-side=anterior]")
        page.wait_for_timeout(700)
        for mode in ("oxygen", "safe"):
            page.check(f"#colours-{mode}")
            page.wait_for_timeout(300)
            self.check(self.pixels(page)["sum"] != front["sum"], f"colours change: {mode}")
            self.shot(page, f"view-{mode}")
        page.check("#colours-structure")
        box = page.locator("#structures input").last
        box.focus()
        page.keyboard.press("Space")
        page.wait_for_timeout(900)
        self.check(not box.is_checked(), f"Space hides a structure: {page.inner_text('#view-status')}")
        self.shot(page, "view-hidden")
        page.click("#all-off")
        page.wait_for_timeout(300)
        self.check(self.pixels(page)["coloured"] < 0.04, "all structures can be hidden")
        page.click("#all-on")
        for cut in ("four", "front", "feet"):
            if page.locator(f"#cut option[value={cut}]").count():
                page.select_option("#cut", cut)
                page.wait_for_timeout(800)
                self.shot(page, f"view-cut-{cut}")
                specks = self.pixels(page)["specks"]
                self.check(specks == 0, f"nothing is drawn beside what cut {cut} leaves: {specks} specks")
        page.locator("#cut-depth").focus()
        before = self.pixels(page)["sum"]
        for _ in range(8):
            page.keyboard.press("ArrowLeft")
        page.wait_for_timeout(300)
        self.check(self.pixels(page)["sum"] != before, "the cut moves by keyboard")
        page.check("#colours-oxygen")
        page.wait_for_timeout(300)
        self.shot(page, "view-cut-oxygen")
        place = page.locator("#heart").bounding_box()
        page.mouse.click(place["x"] + place["width"] / 2, place["y"] + place["height"] / 2)
        page.wait_for_timeout(300)
        print(f"      a click says: {page.inner_text('#view-status')}")
        page.context.close()

    def pixels(self, page):
        """How much of the view is drawn on, a sum that tells pictures apart, and pixels alone within four around."""
        return page.evaluate(
            """() => new Promise(done => requestAnimationFrame(() => requestAnimationFrame(() => {
              const heart = document.getElementById('heart'), copy = document.createElement('canvas');
              document.getElementById('cut-fill').dispatchEvent(new Event('change'));
              requestAnimationFrame(() => {
                copy.width = heart.width; copy.height = heart.height;
                const pen = copy.getContext('2d'); pen.drawImage(heart, 0, 0);
                const d = pen.getImageData(0, 0, copy.width, copy.height).data; let sum = 0, coloured = 0, specks = 0;
                const off = n => Math.abs(d[n] - d[0]) + Math.abs(d[n + 1] - d[1]) + Math.abs(d[n + 2] - d[2]);
                const around = [], w = copy.width;
                for (let s = -4; s <= 4; s += 1) around.push(s - 4 * w, s + 4 * w, s * w - 4, s * w + 4);
                for (let n = 0; n < d.length; n += 4) {
                  sum += d[n] + 2 * d[n + 1] + 3 * d[n + 2];
                  coloured += off(n) > 24;
                  specks += off(n) > 6 && !around.some(s => d[n + 4 * s] !== undefined && off(n + 4 * s) > 6);
                }
                done({sum: sum, coloured: coloured / (d.length / 4), specks: specks});
              });
            })))"""
        )

    def see_narrow(self):
        page = self.case_page(width=320, height=640, has_touch=True, reduced_motion="reduce")
        page.click("#open-view")
        page.wait_for_selector("#viewer:not([hidden])")
        page.wait_for_timeout(500)
        wide = page.evaluate("document.documentElement.scrollWidth")
        self.check(wide <= 320, f"the case fits 320 pixels ({wide})")
        self.shot(page, "narrow-case", full=True)
        page.goto(self.index.as_uri())
        wide = page.evaluate("document.documentElement.scrollWidth")
        self.check(wide <= 320, f"the index fits 320 pixels ({wide})")
        self.shot(page, "narrow-index")
        page.context.close()

    def see_without(self):
        """Without scripts, and without WebGL."""
        page = self.page(java_script_enabled=False)
        page.goto(self.index.as_uri())
        self.check("list.html" in (page.content()), "without scripts the index links to the plain list")
        page.goto((self.index.parent / "list.html").as_uri())
        page.click("main li a")
        self.check(page.locator("h2").count() > 4, "without scripts a case's page can be read")
        page.context.close()
        page = self.page()
        page.add_init_script("HTMLCanvasElement.prototype.getContext = () => null")
        page.goto((self.index.parent / "cases" / f"{self.case}.html").as_uri())
        page.click("#open-view")
        page.wait_for_timeout(500)
        said = page.inner_text("#view-status")
        self.check("WebGL" in said and page.locator("#viewer").is_hidden(), f"without WebGL it says: {said}")
        page.context.close()


if __name__ == "__main__":
    sys.exit(main())
