"""A recording that is not finished, on the page."""

import pytest

from heartcase.simulator.case_simulation import simulation_of_case
from heartcase.simulator.session.operating_session import OperatingSession
from heartcase.simulator.session.recorder import Recorder
from tests.simulator.live.scenes import load, write_case
from tests.studio.operating.short import cut_short
from tests.studio.page.browsing import browsing, until
from tests.studio.page.test_operating import CaseServer

WORDS = {
    "en-GB": ("not finished", "It is not whole: the first {} s are shown", "."),
    "de-DE": ("nicht beendet", "Sie ist nicht vollständig: Gezeigt werden die ersten {} s", ","),
}


@pytest.fixture(scope="module")
def served(tmp_path_factory):
    path = write_case(tmp_path_factory.mktemp("short"))
    case = load(path)
    session = OperatingSession(simulation_of_case(case))
    with Recorder(session, path.parent / "whole.recording", case=case.manifest):
        for _ in range(40):
            session.take([], 25)
    cut_short(path.parent / "whole.recording", path.parent / "torn.recording")
    server = CaseServer(path)
    server.start()
    yield server
    server.stop()


@pytest.mark.parametrize("locale", WORDS)
def test_it_is_marked_replayed_and_saved(chromium, served, locale):
    mark, words, point = WORDS[locale]
    with browsing(chromium, served, locale=locale) as page:
        tab = page.tab
        tab.locator("#tab-recordings").click()
        row = tab.locator("#recordings li", has_text="torn")
        row.get_by_text(mark, exact=True).wait_for()
        assert tab.locator("#recordings .unfinished").count() == 1
        row.locator("button").first.click()
        tab.locator("#notice-words").get_by_text(words.partition("{")[0]).wait_for()
        shown = page.text("#notice-words")
        assert words.partition("{}")[2] in shown
        assert point in shown
        row.locator("input").check()
        tab.locator("#save-page").click()
        until(lambda: words.partition("{")[0].lower() in page.text("#save-page-state").lower(), 120.0)
