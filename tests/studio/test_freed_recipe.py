"""A recipe that no page has open for some time leaves the memory, and is as it was for who comes."""

from __future__ import annotations

import gc
import weakref

import numpy as np

from heartcase.studio import idle
from heartcase.studio.painting.workplace import Workplace
from tests.simulator.live.scenes import until
from tests.studio.talking import page, studio, write_recipe


def test_what_was_painted_is_there_again_and_can_be_taken_back(monkeypatch, tmp_path):
    recipe, middle = write_recipe(tmp_path)
    with studio(recipe) as browser:
        workplace = browser.opened.places["socket"]
        monkeypatch.setattr(idle, "FREE_AFTER_S", 0.3)
        with page(browser) as one:
            first = one.labels.copy()
            assert one.ask(do="paint", label="aorta", radius_mm=1.0, points_mm=[middle])["kind"] == "done"
            labels = one.labels.copy()
        painting = weakref.ref(workplace._painting)
        until(lambda: workplace._painting is None)
        until(lambda: gc.collect() >= 0 and painting() is None)
        monkeypatch.setattr(idle, "FREE_AFTER_S", 300.0)
        with page(browser) as one:
            np.testing.assert_array_equal(one.labels, labels)
            assert one.ask(do="undo")["kind"] == "done"
            np.testing.assert_array_equal(one.labels, first)


def test_a_stroke_that_was_lost_by_then_is_told_who_comes(monkeypatch, tmp_path):
    """Another program changed the recipe while nobody looked at it."""
    recipe, middle = write_recipe(tmp_path)
    with studio(recipe) as browser:
        workplace = browser.opened.places["socket"]
        monkeypatch.setattr(idle, "FREE_AFTER_S", 0.3)
        with page(browser) as one:
            one.ask(do="paint", label="aorta", radius_mm=1.0, points_mm=[middle])
            recipe.write_text(recipe.read_text() + "# by hand\n")
            # the page goes before it is told
            workplace._painting.leave = lambda *_, **__: ()
            monkeypatch.setattr(Workplace, "_reopened", _nobody_looked)
        until(lambda: workplace._painting is None)
        monkeypatch.undo()
        with page(browser) as one:
            assert "is lost" in one.hear("refused")["problems"][0]["message"]
        with page(browser) as one:
            one.ask(do="lock", label="aorta", locked=False)
            assert not [told for told in one.told if told["kind"] == "refused"]


async def _nobody_looked(self, painting, **options):
    return None
