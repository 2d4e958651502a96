"""The studio's server is killed while somebody paints: nothing is lost but the stroke under way."""

import random
import threading

import numpy as np
import pytest

from heartcase.pipeline.building.session_file import open_session
from heartcase.schemas.recipe.recipe import load_recipe
from tests.studio.process import GONE, connected, started
from tests.studio.talking import page, studio, write_recipe

LATEST_S = 1.2
"""After so long at most the server is killed."""


def stroke_of(drawn, middle):
    # within the scan
    points = [[round(m + drawn.uniform(-4.0, 4.0), 3) for m in middle] for _ in range(4)]
    label = drawn.choice(("aorta", "background", "left ventricle"))
    return {"label": label, "radius_mm": drawn.choice((1.0, 2.0)), "points_mm": points}


def plain(stroke):
    """A stroke as what was asked for."""
    return {
        "label": stroke.label,
        "radius_mm": stroke.radius_mm,
        "points_mm": [list(map(float, one)) for one in stroke.points_mm],
    }


class Painter:
    """Paints and takes back without a pause; knows what the server said is saved, and what it was asked to save."""

    def __init__(self, held):
        self.saved = list(held)
        self.asked = list(held)

    def go_on(self, talker, drawn, middle):
        while True:
            if self.saved and drawn.random() < 0.25:
                self.take_back(talker)
            else:
                self.paint(talker, drawn, middle)

    def paint(self, talker, drawn, middle):
        stroke = stroke_of(drawn, middle)
        first, *others = stroke["points_mm"]
        self._do(talker, do="paint", **stroke | {"points_mm": [first]})
        for point in others:
            self._do(talker, do="extend", points_mm=[point])
        # from here on it may be saved
        self.asked = [*self.saved, stroke]
        self._do(talker, do="end")
        self.saved = self.asked

    def take_back(self, talker):
        self.asked = self.saved[:-1]
        self._do(talker, do="undo")
        self.saved = self.asked

    def _do(self, talker, **request):
        answer = talker.ask(**request)
        assert answer["kind"] == "done", answer


def paint_until_killed(path, middle, seed, held):
    """What was saved for certain, and what may have been, when the server was killed at a random moment."""
    drawn = random.Random(seed)
    painter = Painter(held)
    with started(path) as (process, address):
        with connected(address) as talker:
            # what the one before had saved is all here
            assert talker.opened["undo_count"] == len(held)
            np.testing.assert_array_equal(talker.labels, open_session(path, out=path.parent / "out").session.labels)
            timer = threading.Timer(drawn.uniform(0.02, LATEST_S), process.kill)
            timer.start()
            with pytest.raises(GONE):
                painter.go_on(talker, drawn, middle)
            timer.join()
        assert process.wait(timeout=60) == -9
    return painter


def run_kills(folder, seeds):
    path, middle = write_recipe(folder)
    text = path.read_text()
    held, count = [], 0
    for seed in seeds:
        painter = paint_until_killed(path, middle, seed, held)
        count += len(painter.saved)
        # the recipe is valid, what was there before is there to the letter, and so is every stroke that was over
        assert path.read_text().startswith(text)
        found = [plain(one) for one in load_recipe(path).strokes[1:]]
        assert found in (painter.saved, painter.asked), seed
        held = found
    assert count > 0
    with studio(path) as browser, page(browser) as talker:
        for _ in held:
            assert talker.ask(do="undo")["kind"] == "done"
        assert talker.ask(do="undo")["kind"] == "refused"
        assert path.read_text() == text


def test_a_server_that_is_killed_loses_nothing_but_the_stroke_under_way(tmp_path):
    run_kills(tmp_path, range(2))


@pytest.mark.slow
def test_fifty_kills(tmp_path):
    run_kills(tmp_path, range(100, 150))
