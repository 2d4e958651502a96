"""Files of older versions are brought up to date, those of newer ones refused in a plain sentence."""

import pytest

from heartcase import __version__
from heartcase.schemas.bundle.format import FORMAT_VERSION
from heartcase.schemas.errors import RecipeError, ScriptError
from heartcase.schemas.migrate import (
    BUNDLE_CHANGES,
    RECIPE,
    SCRIPT,
    Migration,
    VersionedFormat,
    bundle_changes,
)
from heartcase.schemas.recipe.recipe import RECIPE_VERSION, parse_recipe
from heartcase.simulator.session.script import parse_script

RECIPE_TEXT = """
name = "a"
scan.path = "scan.nii.gz"
[filter]
iterations = 7
[[strokes]]
label = "background"
points_mm = [[0, 0, 0]]
"""


def renamed(data):
    """As if version 1 had called the conductance 'edge'."""
    table = dict(data.get("filter", {}))
    if "edge" in table:
        table["conductance"] = table.pop("edge")
    return {**data, "filter": table}


@pytest.fixture
def second_version(monkeypatch):
    monkeypatch.setitem(RECIPE.migrations, 1, Migration(("filter.edge is called filter.conductance",), renamed))


def test_the_versions_of_today():
    assert RECIPE.newest == RECIPE_VERSION == 1
    assert SCRIPT.newest == 1
    assert parse_recipe("heartcase_recipe = 1" + RECIPE_TEXT).filter.iterations == 7


def test_an_older_recipe_is_read_as_the_newer_one(second_version):
    old = "heartcase_recipe = 1" + RECIPE_TEXT.replace("iterations = 7", "edge = 2.5")
    recipe = parse_recipe(old)
    assert (recipe.heartcase_recipe, recipe.filter.conductance) == (2, 2.5)
    with pytest.raises(RecipeError, match=r"filter\.edge: unknown setting"):
        parse_recipe(old.replace("heartcase_recipe = 1", "heartcase_recipe = 2"))
    assert parse_recipe("heartcase_recipe = 2" + RECIPE_TEXT).heartcase_recipe == 2


def test_migrations_follow_one_another_and_leave_their_input_alone():
    steps = {n: Migration((f"step {n}",), lambda data, n=n: {**data, "seen": [*data["seen"], n]}) for n in (1, 2, 3)}
    kind = VersionedFormat("file", "version", RecipeError, steps)
    data = {"version": 2, "seen": []}
    assert kind.migrated(data) == ({"version": 4, "seen": [2, 3]}, ("step 2", "step 3"))
    assert data == {"version": 2, "seen": []}
    assert kind.migrated({"version": 4, "seen": []}) == ({"version": 4, "seen": []}, ())


@pytest.mark.parametrize(("parse", "key", "error"), [
    (parse_recipe, "heartcase_recipe", RecipeError),
    (parse_script, "heartcase_script", ScriptError),
])  # fmt: skip
def test_a_newer_file_is_refused_in_one_plain_sentence(parse, key, error):
    # Whatever else is in it, which this version cannot know, is not complained about.
    with pytest.raises(error) as caught:
        parse(f"{key} = 2\nwhat_comes_later = true\n")
    (problem,) = caught.value.problems
    assert problem.place == key
    assert f"is of version 2, but heartcase {__version__} reads versions up to 1: get a newer heartcase" in str(problem)


def test_a_newer_locked_recipe_says_which_heartcase_wrote_it():
    locked = 'heartcase_recipe = 9\n[lock]\nsoftware_version = "3.2.1"\n'
    with pytest.raises(RecipeError, match=r"get heartcase 3\.2\.1, which wrote it, or a newer one"):
        parse_recipe(locked)
    with pytest.raises(RecipeError) as caught:
        parse_recipe(locked.replace("3.2.1", "JANE DOE\\u001b[31m"))
    assert "JANE" not in str(caught.value)


@pytest.mark.parametrize("version", ["0", "-1", "1.5", "[]", '"x"'])
def test_what_is_no_version_is_refused_with_its_place(version):
    with pytest.raises(RecipeError, match="heartcase_recipe: "):
        parse_recipe(f"heartcase_recipe = {version}" + RECIPE_TEXT)


def test_a_script_may_leave_its_version_out():
    assert parse_script("seconds = 1.0").heartcase_script == 1
    assert parse_script("heartcase_script = 1").seconds == 2.0


def test_what_minor_versions_of_the_bundle_added(monkeypatch):
    # Every minor version up to today's says what it added.
    major, minor = (int(part) for part in FORMAT_VERSION.split("."))
    assert set(BUNDLE_CHANGES) == {f"{major}.{n}" for n in range(1, minor + 1)}
    monkeypatch.setitem(BUNDLE_CHANGES, "1.10", ("ten",))
    monkeypatch.setitem(BUNDLE_CHANGES, "1.9", ("nine", "nine too"))
    assert bundle_changes("1.8", "1.10") == (("1.9", "nine"), ("1.9", "nine too"), ("1.10", "ten"))
    assert bundle_changes("1.10", "1.10") == ()
