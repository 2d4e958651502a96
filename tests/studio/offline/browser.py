"""A browser whose WebGPU is computed in software."""

from contextlib import contextmanager

import pytest

from tests.studio.page.conftest import find_browser

SWITCHES = ["--no-sandbox", "--enable-unsafe-webgpu", "--use-webgpu-adapter=swiftshader", "--enable-features=Vulkan"]
HAS_NONE = "async () => (await navigator.gpu?.requestAdapter()) == null"


@contextmanager
def with_web_gpu():
    """A Chromium with WebGPU; the test is skipped where there is none."""
    playwright = pytest.importorskip("playwright.sync_api")
    path = find_browser()
    if path is None:
        pytest.skip("there is no Chromium on this machine: the page's own engine was not tried")
    with playwright.sync_playwright() as running:
        browser = running.chromium.launch(executable_path=path, args=SWITCHES)
        page = browser.new_page()
        page.route("**/*", lambda route: route.fulfill(body="<p>", content_type="text/html"))
        page.goto("http://localhost/")
        has_none = page.evaluate(HAS_NONE)
        page.close()
        if has_none:
            browser.close()
            pytest.skip("this Chromium has no WebGPU in software: the page's own engine was not tried")
        yield browser
        browser.close()
