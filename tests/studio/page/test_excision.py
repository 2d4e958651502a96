"""A piece that was cut free is taken out on the page, and is back by undo; why it is refused is said."""

import pytest

from heartcase.schemas.recording.commands import Cut
from tests.simulator.live.scenes import write_case
from tests.studio.page.browsing import browsing, until
from tests.studio.page.test_operating import TOP, CaseServer, Hands

WORDS = {
    "en-GB": ("cut a piece free first", "hangs together"),
    "de-DE": ("Schneiden Sie zuerst ein Stück frei", "hängt mit dem übrigen Herzen zusammen"),
}
SLIT = Cut(poses_mm=[[[22.3, y, 38.0], [22.3, y, 60.0]] for y in (-30.0, 0.0)], at_rest=True)
"""Down from above: all stays in one piece."""
OFF_MM = 36.7
OFF = Cut(poses_mm=[[[x, -30.0, OFF_MM], [x, 0.0, OFF_MM]] for x in (0.0, 45.0)], at_rest=True)
"""Level: what lies above it is cut free."""


@pytest.mark.parametrize("locale", WORDS)
def test_an_excision(chromium, tmp_path, locale):
    nothing_cut, not_free = WORDS[locale]
    server = CaseServer(write_case(tmp_path))
    server.start()
    try:
        with browsing(chromium, server, locale=locale, viewport={"width": 1366, "height": 768}) as page:
            hands, tab = Hands(page), page.tab
            hands.from_above()
            tab.keyboard.press("z")

            def click():
                hands.drag(TOP)
                tab.mouse.up()

            def top_mm():
                return hands.read_back()[1][:, 2].max()

            click()
            tab.locator("#notice-words").get_by_text(nothing_cut).wait_for()
            server.live.do(SLIT)
            hands.until(lambda header: header["cut_count"] == 1)
            click()
            tab.locator("#notice-words").get_by_text(not_free).wait_for()
            server.live.do(OFF)
            before = hands.until(lambda header: header["cut_count"] == 2)
            assert top_mm() > 39.0
            click()
            hands.until(lambda header: header["topology"] > before["topology"] and header["act_count"] == 3)
            # what lay above is gone, and the rest is where it was
            assert OFF_MM - 1.5 < top_mm() < OFF_MM + 1.5
            tab.keyboard.press("u")
            hands.until(lambda header: header["mode"] == "paused" and header["act_count"] == 2)
            until(lambda: top_mm() > 39.0)
    finally:
        server.stop()
