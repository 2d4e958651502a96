"""The browser that the studio's page is tried in."""

import shutil

import pytest

from tests.studio.page.browsing import Server, write_recipe

BROWSERS = ("chromium", "chromium-browser", "google-chrome", "google-chrome-stable", "chrome")
SWITCHES = ["--no-sandbox", "--enable-unsafe-swiftshader"]


@pytest.fixture(scope="package")
def chromium():
    # of the package alone: while Playwright runs, this thread has an event loop, and other tests start their own
    playwright = pytest.importorskip("playwright.sync_api", reason="Playwright is not installed: no browser was tried")
    path = next((found for name in BROWSERS if (found := shutil.which(name))), None)
    if path is None:
        pytest.skip("there is no Chromium on this machine: the studio's page was not tried in a browser")
    with playwright.sync_playwright() as running:
        browser = running.chromium.launch(executable_path=path, args=SWITCHES)
        yield browser
        browser.close()


@pytest.fixture
def painted(tmp_path):
    """A recipe that is served: the server, the recipe's path, and the scan's affine."""
    path, affine = write_recipe(tmp_path)
    server = Server(path)
    server.start()
    yield server, path, affine
    server.stop()
