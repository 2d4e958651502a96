"""A heart of a site pulled by a finger, by the page's own engine (WebGPU, here in software)."""

import numpy as np
import pytest

from heartcase.studio.offline.site import SiteCase, write_site
from tests.studio.offline.browser import with_web_gpu
from tests.studio.offline.cases import write_cases
from tests.studio.page.test_site import CAMERA, VIEWER, fingers_on, middle_of, opened


@pytest.mark.slow
def test_a_finger_pulls_where_there_is_webgpu(tmp_path):
    (case,) = write_cases(tmp_path, ["first"])
    write_site([SiteCase(case)], tmp_path / "site")
    page = tmp_path / "site/cases/first.html"
    with (
        with_web_gpu() as browser,
        opened(browser, page.as_uri(), viewport={"width": 820, "height": 1180}, has_touch=True) as (tab, _),
    ):
        tab.wait_for_selector(VIEWER, timeout=60_000)
        tab.click("#tools [data-key=g]")
        x, y = np.add(middle_of(tab, "#scene"), (60.0, 100.0)).tolist()
        before, touch = tab.evaluate(CAMERA), fingers_on(tab)
        touch("touchStart", (x, y))
        tab.wait_for_timeout(300)
        touch("touchMove", (x + 60, y))
        moved = "() => heartcase.picture.heart.nodes.displacement.reduce((most, one) => Math.max(most, Math.abs(one)))"
        for _ in range(100):
            tab.wait_for_timeout(200)
            if tab.evaluate(moved) > 0.3:
                break
        else:
            pytest.fail("nothing moved")
        assert tab.evaluate(CAMERA) == before
        touch("touchEnd")
        tab.wait_for_timeout(200)
        assert tab.evaluate("() => heartcase.engine.heldBy('hand').length") == 0
        # two that come down together hold nothing, and zoom
        touch("touchStart", (x - 50, y), (x + 50, y))
        touch("touchMove", (x - 100, y), (x + 100, y))
        touch("touchEnd")
        assert tab.evaluate(CAMERA)["distance"] < before["distance"]
        assert tab.evaluate("() => heartcase.engine.heldBy('hand').length") == 0
