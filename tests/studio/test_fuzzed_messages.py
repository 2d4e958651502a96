"""Random sequences of messages from two pages, right and wrong ones: nothing of them harms the recipe or the server."""

import json
import random
from contextlib import ExitStack

import numpy as np
import pytest

from heartcase.pipeline.building.session_file import open_session
from heartcase.schemas.recipe.recipe import load_recipe
from tests.studio.fuzzed import damaged, request
from tests.studio.talking import page, studio, write_recipe

MESSAGES = 14
"""Of one sequence."""


def say(talker, drawn, middle):
    """One message, of which nobody waits for the answer; whether it ended the connection."""
    asked = request(drawn, middle)
    chance = drawn.random()
    if chance < 0.02:
        talker.socket.send_bytes(json.dumps({"id": 1} | asked).encode())
        return True
    talker.number += 1
    talker.socket.send_text(json.dumps({"id": talker.number} | asked) if chance < 0.6 else damaged(drawn, asked))
    return False


def is_alive(talker):
    """A page is still answered; all that it was told can be sent as UTF-8."""
    told = len(talker.told)
    answer = talker.ask(do="end")
    assert answer["kind"] == "done"
    for one in talker.told[told:]:
        json.dumps(one, ensure_ascii=False, allow_nan=False).encode("utf-8")
        if one["kind"] == "refused":
            assert one["problems"]
            assert all(problem["message"] for problem in one["problems"])


def run_sequence(path, middle, browser, seed):
    """A sequence from two pages; then everything is taken back."""
    drawn = random.Random(seed)
    with ExitStack() as open_pages:
        pages = [open_pages.enter_context(page(browser)) for _ in range(2)]
        for _ in range(MESSAGES):
            which = drawn.randrange(2)
            if say(pages[which], drawn, middle):
                pages[which] = open_pages.enter_context(page(browser))
            elif drawn.random() < 0.3:
                is_alive(pages[which])
        for talker in pages:
            is_alive(talker)
        # both show what a session makes of the recipe as it is on the disk
        load_recipe(path)
        wanted = open_session(path, out=path.parent / "out").session.labels
        for talker in pages:
            is_alive(talker)
            np.testing.assert_array_equal(talker.labels, wanted)
        while pages[0].ask(do="undo")["kind"] == "done":
            pass


def run_sequences(folder, seeds):
    path, middle = write_recipe(folder)
    text = path.read_bytes()
    with studio(path) as browser:
        with page(browser) as talker:
            first = talker.labels.copy()
        for seed in seeds:
            run_sequence(path, middle, browser, seed)
            assert path.read_bytes() == text, seed
            with page(browser) as talker:
                np.testing.assert_array_equal(talker.labels, first, err_msg=str(seed))
                assert talker.opened["undo_count"] == 0
    assert sorted(one.name for one in folder.iterdir()) == ["out", "painted.toml", "scan.nii.gz"]


def test_whatever_two_pages_say_the_recipe_stays_valid_and_all_is_taken_back(tmp_path):
    run_sequences(tmp_path, range(12))


@pytest.mark.slow
def test_a_thousand_sequences(tmp_path):
    run_sequences(tmp_path, range(1000, 2000))
