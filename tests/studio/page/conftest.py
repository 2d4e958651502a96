"""The browser that the studio's page is tried in."""

import os
import shutil

import pytest

from tests.studio.page.browsing import Server, write_recipe

BROWSERS = ("chromium", "chromium-browser", "google-chrome", "google-chrome-stable", "chrome")
SWITCHES = ["--no-sandbox", "--enable-unsafe-swiftshader"]


def _missing(reason):
    if os.environ.get("HEARTCASE_REQUIRE_BROWSER") == "1":
        pytest.fail(reason)
    pytest.skip(reason)


def find_browser():
    """The browser that is asked for, or one that is there, or None."""
    asked = os.environ.get("HEARTCASE_BROWSER")
    return asked or next((found for name in BROWSERS if (found := shutil.which(name))), None)


@pytest.fixture(scope="package")
def chromium():
    # of the package alone: while Playwright runs, this thread has an event loop, and other tests start their own
    path = find_browser()
    try:
        from playwright import sync_api as playwright
    except ImportError:
        _missing("Playwright is not installed: the studio's page was not tried in a browser")
    if path is None:
        _missing("there is no Chromium on this machine: the studio's page was not tried in a browser")
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
