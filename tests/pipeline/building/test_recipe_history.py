"""Acts on a recipe: done, taken back and done again, whatever kind they are."""

import contextlib
import hashlib
import json
import random
import subprocess
import sys
import time

import pytest

from heartcase.pipeline.building.recipe_history import Act, open_history
from heartcase.pipeline.building.recipe_text import changed_text
from heartcase.schemas.errors import RecipeError, UsageError
from heartcase.schemas.recipe.recipe import load_recipe, parse_recipe
from heartcase.schemas.recipe.settings import Stroke
from tests.pipeline.building.test_recipe_text import TEXT

END = {"label": "aorta", "position_mm": [0.0, 1.0, 2.0], "axis": [1.0, 0.0, 0.0], "radius_mm": 4.0}
STROKE = Stroke(label="aorta", radius_mm=1.0, points_mm=((1.0, 2.0, 3.0),))


@pytest.fixture
def recipe(tmp_path):
    path = tmp_path / "one.toml"
    path.write_text(TEXT)
    return path


def opened(path):
    return open_history(path, out=path.parent / "out")


def shape(history, place, value):
    history.change(str(place), changed_text(history.head, (place, value)))


def do_something(history, drawn):
    """An act, a step back or a step forward at random: how many states it goes on, or None where it adds one."""
    length = round(drawn.uniform(1.0, 9.0), 1)
    ends = len(history.recipe.ends)
    choice = drawn.randrange(8)
    if choice in (0, 1) and history.undo_count:
        history.undo()
        return -1
    if choice == 2 and history.redo_count:
        history.redo()
        return 1
    if choice == 3 and ends:
        shape(history, ("ends", drawn.randrange(ends)), None)
    elif choice == 4 and ends:
        shape(history, ("ends", drawn.randrange(ends), "radius_mm"), length)
    elif choice == 5:
        shape(history, ("materials", "youngs_modulus_kpa"), length)
    elif choice == 6:
        shape(history, ("ends", ends), END | {"radius_mm": length})
    else:
        history.paint(Stroke(label="aorta", radius_mm=length, points_mm=((length, 0.0, 0.0),)))
    return None


PAINTED = """
# Painted in a session.
[[strokes]]
label = "aorta"
points_mm = [[0.0, 0.0, 0.0]]
"""


@pytest.mark.parametrize("seed", range(8))
def test_random_acts_taken_back_give_the_first_bytes_also_after_restarts(recipe, seed):
    act_at_random(recipe, seed)


@pytest.mark.slow
def test_a_thousand_random_sequences_of_acts(recipe):
    for seed in range(8, 1008):
        for log in (recipe.parent / "out").rglob("*.jsonl"):
            log.unlink()
        act_at_random(recipe, seed)


ACTING = """
import random, sys
from pathlib import Path
from tests.pipeline.building.test_recipe_history import do_something, opened, sha256
history, drawn = opened(Path(sys.argv[1])), random.Random(int(sys.argv[2]))
print("ready", flush=True)
while True:
    do_something(history, drawn)
    print(sha256(history.text), flush=True)
"""


def sha256(text):
    return hashlib.sha256(text.encode()).hexdigest()


@pytest.mark.slow
def test_whoever_is_killed_at_any_moment_loses_nothing(recipe):
    first, drawn, act_count = recipe.read_bytes(), random.Random(0), 0
    for number in range(50):
        command = [sys.executable, "-c", ACTING, str(recipe), str(number)]
        with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as acting:
            assert acting.stdout.readline() == "ready\n"
            time.sleep(drawn.uniform(0.0, 0.4))
            acting.kill()
            done = [line.strip() for line in acting.stdout if len(line) == 65]
        act_count += len(done)
        history = opened(recipe)
        # what was told as done is there, or one step away: the act that was under way came after it
        near = {sha256(history.text)}
        for there, back in ((history.undo, history.redo), (history.redo, history.undo)):
            with contextlib.suppress(UsageError):
                there()
                near.add(sha256(history.text))
                back()
        assert not done or done[-1] in near
        parse_recipe(recipe.read_text(), needs_markers=False)
        if number % 10 == 9:
            while history.undo_count:
                history.undo()
            assert recipe.read_bytes() == first
            while history.redo_count:
                history.redo()
    assert act_count > 100


def act_at_random(recipe, seed):
    """Acts at random, compared with whole texts."""
    drawn = random.Random(seed)
    newline = drawn.choice(["\n", "\r\n"])
    texts = [TEXT, TEXT + PAINTED] if seed % 2 else [TEXT.rstrip("\n")]
    # whole texts are what acts are compared with
    states = [text.replace("\n", newline).encode() for text in texts]
    recipe.write_bytes(states[-1])
    at, history = len(states) - 1, opened(recipe)
    for _ in range(25):
        step = do_something(history, drawn)
        if step is None:
            states[at + 1 :] = [recipe.read_bytes()]
        at += step or 1
        assert recipe.read_bytes() == states[at]
        assert (history.undo_count, history.redo_count) == (at, len(states) - 1 - at)
        assert history.recipe == opened(recipe).recipe
        assert len(parse_recipe(recipe.read_text(), needs_markers=False).strokes) == history.stroke_count
        if drawn.random() < 0.3:
            history = opened(recipe)
            assert (history.undo_count, history.redo_count) == (at, len(states) - 1 - at)
    while history.undo_count:
        history.undo()
    assert recipe.read_bytes() == states[0]
    for state in states[1:]:
        history.redo()
        assert recipe.read_bytes() == state


def test_an_act_that_is_no_recipe_changes_nothing(recipe):
    history = opened(recipe)
    for place, value in [
        (("ends", 0, "radius_mm"), -1.0),
        (("ends", 2), END | {"label": "spleen"}),
        (("grid", "x"), 1),
    ]:
        with pytest.raises(RecipeError) as refused:
            shape(history, place, value)
        assert all(problem.place and "\n" not in problem.message for problem in refused.value.problems)
    assert recipe.read_text() == TEXT
    assert (history.undo_count, history.redo_count) == (0, 0)
    for step in (history.undo, history.redo):
        with pytest.raises(UsageError, match="nothing"):
            step()


def test_another_programs_change_is_neither_lost_nor_taken_back(recipe):
    history = opened(recipe)
    shape(history, ("grid", "node_count"), 20000)
    recipe.write_text(recipe.read_text() + "# somebody else\n")
    assert history.is_stale
    changed = recipe.read_bytes()
    for step in (history.undo, lambda: history.paint(STROKE), lambda: shape(history, ("grid", "node_count"), 1000)):
        with pytest.raises(RecipeError, match="another program changed"):
            step()
    assert recipe.read_bytes() == changed
    assert opened(recipe).undo_count == 0
    # where it puts the text back that the history knows, all can be taken back again
    recipe.write_text(TEXT)
    again = opened(recipe)
    assert (again.undo_count, again.redo_count) == (0, 1)


def test_whoever_is_killed_between_log_and_recipe_loses_nothing(recipe, monkeypatch):
    history = opened(recipe)
    history.paint(STROKE)
    painted = recipe.read_text()

    class Killed(BaseException):
        pass

    def kill(*_):
        raise Killed

    with monkeypatch.context() as patched:
        patched.setattr("heartcase.pipeline.building.recipe_history.atomic_write", kill)
        with pytest.raises(Killed):
            shape(history, ("grid", "node_count"), 20000)
    assert recipe.read_text() == painted
    again = opened(recipe)
    assert (again.undo_count, again.redo_count) == (1, 1)
    again.redo()
    assert load_recipe(recipe).grid.node_count == 20000
    # and a log that is torn says what it can
    log = next((recipe.parent / "out" / ".heartcase-cache" / "studio").iterdir())
    log.write_bytes(log.read_bytes() + b'{"after": 2, "ac')
    assert opened(recipe).undo_count == 2
    log.write_bytes(b"\xff junk")
    assert opened(recipe).undo_count == 1  # the stroke at the recipe's end


def painted_texts(recipe, count):
    """Strokes of several lengths, painted one by one, and a setting in between; the text after each act."""
    history, texts = opened(recipe), [recipe.read_text()]
    for number in range(count):
        if number == count // 2:
            shape(history, ("grid", "node_count"), 20000)
        else:
            points = tuple((float(n), 2.0, 3.0) for n in range(1 + number % 3))
            history.paint(Stroke(label="aorta", radius_mm=1.0, points_mm=points))
        texts.append(recipe.read_text())
    return texts


def test_every_text_that_the_history_went_through_is_known_again(recipe):
    texts = painted_texts(recipe, 12)
    for number, text in enumerate(texts):
        recipe.write_text(text)
        again = opened(recipe)
        assert (again.undo_count, again.redo_count) == (number, 12 - number)
    # of a log that was written without the first text's length, what a stop between two writes leaves
    log = next((recipe.parent / "out" / ".heartcase-cache" / "studio").iterdir())
    begins, *lines = log.read_text().splitlines()
    begins = {key: value for key, value in json.loads(begins).items() if key != "length"}
    log.write_text("\n".join([json.dumps(begins), *lines]) + "\n")
    for number in (11, 12):
        recipe.write_text(texts[number])
        assert opened(recipe).undo_count == number


def test_a_text_that_another_program_changed_is_told_from_many_strokes_in_few_steps(recipe, monkeypatch):
    count = 60
    text = painted_texts(recipe, count)[-1]
    undone, steps = Act.undone, []
    monkeypatch.setattr(Act, "undone", lambda self, text: steps.append(1) or undone(self, text))
    # as long as it was, before all that sessions wrote
    recipe.write_text(text.replace("that stays", "as before!", 1))
    assert opened(recipe).undo_count == count - 1
    assert len(steps) <= 3 * count


def test_an_act_is_the_shortest_change():
    assert Act.between("x", "abcabc", "abXabc") == Act("x", 2, "c", "X")
    assert Act.between("x", "aa", "aaa") == Act("x", 2, "", "a")
    assert Act("x", 2, "c", "X").undone("abXabc") == "abcabc"
