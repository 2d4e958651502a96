"""One thing changed in a recipe's text, and all else to the letter."""

import tomllib

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from heartcase.pipeline.building.recipe_text import Inserted, changed_text, split_session
from heartcase.schemas.errors import RecipeError
from heartcase.schemas.toml import toml_text
from heartcase.schemas.toml_places import toml_places

TEXT = """\
# a comment that stays
heartcase_recipe = 1
name = 'one'  # behind it

[scan]
path = "scan.nii.gz"
origin = \"\"\"
[[ends]] in a text = no table \\\"""
\"\"\"

[[ends]]
label = "aorta"   # the root
position_mm = [ 1, 2.50,  # x and y
  3 ]
axis = [0, 0, 1]
radius_mm = 12

# why this one
[[ends]]
label = "pulmonary artery"
position_mm = [0, 0, 0]
axis = [0, 0, 1]
radius_mm = 9.0

[materials.labels."right ventricle wall"]
youngs_modulus_kpa = 50.0
"""


def test_a_value_is_changed_where_it_stands():
    assert changed_text(TEXT, (("ends", 0, "radius_mm"), 13.5)) == TEXT.replace(
        "radius_mm = 12\n", "radius_mm = 13.5\n"
    )
    assert changed_text(TEXT, (("name",), "b")) == TEXT.replace("'one'  #", '"b"  #')
    assert changed_text(TEXT, (("ends", 0, "radius_mm"), 12)) == TEXT


def test_of_a_table_only_what_differs_is_written_anew():
    table = tomllib.loads(TEXT)["ends"][0] | {"radius_mm": 10.0, "label": "left atrium"}
    found = changed_text(TEXT, (("ends", 0), table))
    assert found == TEXT.replace('"aorta" ', '"left atrium" ').replace("radius_mm = 12\n", "radius_mm = 10.0\n")


def test_a_table_is_added_behind_those_of_its_kind_and_goes_without_a_trace():
    table = {"label": "aorta", "position_mm": [0.0, 1.0, 2.0], "axis": [1.0, 0.0, 0.0], "radius_mm": 4.0}
    found = changed_text(TEXT, (("ends", 2), table))
    block = '\n[[ends]]\nlabel = "aorta"\nposition_mm = [0.0, 1.0, 2.0]\naxis = [1.0, 0.0, 0.0]\nradius_mm = 4.0\n'
    assert found == TEXT.replace("radius_mm = 9.0\n", f"radius_mm = 9.0\n{block}")
    assert changed_text(found, (("ends", 2), None)) == TEXT
    # the words above a table are somebody's, and stay
    assert "# why this one\n" in changed_text(TEXT, (("ends", 1), None))


def test_a_table_is_put_before_another_one_and_the_words_above_that():
    table = {"label": "aorta", "position_mm": [0.0, 1.0, 2.0], "axis": [1.0, 0.0, 0.0], "radius_mm": 4.0}
    found = changed_text(TEXT, (("ends", 1), Inserted(table)))
    block = '[[ends]]\nlabel = "aorta"\nposition_mm = [0.0, 1.0, 2.0]\naxis = [1.0, 0.0, 0.0]\nradius_mm = 4.0\n\n'
    assert found == TEXT.replace("# why this one\n", f"{block}# why this one\n")
    assert tomllib.loads(changed_text("e = [{x = 1}]\n", (("e", 0), Inserted({"x": 2}))))["e"] == [{"x": 2}, {"x": 1}]


def test_a_setting_gets_a_table_where_it_has_none_and_takes_it_away_again():
    found = changed_text(TEXT, (("grid", "node_count"), 20000))
    assert found == TEXT + "\n[grid]\nnode_count = 20000\n"
    assert changed_text(found, (("grid", "node_count"), None)) == TEXT
    found = changed_text(TEXT, (("materials", "labels", "aorta wall"), {"youngs_modulus_kpa": 20.0}))
    assert found == TEXT + '\n[materials.labels."aorta wall"]\nyoungs_modulus_kpa = 20.0\n'
    found = changed_text(TEXT, (("walls", "septum", 0), {"between": ["a", "b"], "thickness_mm": 2.0}))
    assert found == TEXT + '\n[[walls.septum]]\nbetween = ["a", "b"]\nthickness_mm = 2.0\n'
    place = ("materials", "labels", "right ventricle wall", "youngs_modulus_kpa")
    assert "materials" not in tomllib.loads(changed_text(TEXT, (place, None)))
    assert changed_text(TEXT, (("materials", "youngs_modulus_kpa"), 20.0)).endswith(
        "[materials]\nyoungs_modulus_kpa = 20.0\n"
    )


@pytest.mark.parametrize(
    ("text", "place", "value", "expected"),
    [
        ("a = 'x # \"'\n", ("a",), 2, "a = 2\n"),
        ("a = 1\nb = {c = 1, d = 2}\n", ("b", "c"), 3, "a = 1\nb = { c = 3, d = 2 }\n"),
        ("b.c = 1\n", ("b", "c"), 2, "b.c = 2\n"),
        ("[a]\nb.c = 1\n", ("a", "b", "d"), 2, None),
        ("e = [{x = 1}]\n", ("e", 1), {"x": 2}, "e = [{ x = 1 }, { x = 2 }]\n"),
        ("e = [ # mine\n {x = 1}]\n", ("e", 1), {"x": 2}, None),
        ("[a]\nx = 1", ("a", "y"), 2, "[a]\nx = 1\ny = 2\n"),
        ("[a]\r\nx = 1\r\n", ("a", "x"), 2, "[a]\r\nx = 2\r\n"),
        ("[[w.t]]\nx = 1\n", ("w", "y"), 2, "[[w.t]]\nx = 1\n\n[w]\ny = 2\n"),
    ],
)
def test_other_ways_of_writing_are_kept_or_refused(text, place, value, expected):
    if expected is None:
        with pytest.raises(RecipeError, match="cannot be changed by itself"):
            changed_text(text, (place, value))
    else:
        assert changed_text(text, (place, value)) == expected


def test_strokes_of_sessions_are_told_from_what_is_written_by_hand():
    ours = '\n# Painted in a session.\n[[strokes]]\nlabel = "aorta"\npoints_mm = [[0.0, 0.0, 0.0]]\n'
    assert split_session(TEXT + ours) == (TEXT, ours)
    assert split_session(TEXT + ours + "# mine\n") == (TEXT + ours + "# mine\n", "")
    assert split_session((TEXT + ours).replace("\n", "\r\n"))[0] == TEXT.replace("\n", "\r\n")


SCALARS = st.one_of(
    st.booleans(), st.integers(-9, 9), st.floats(-9, 9), st.text(max_size=6), st.lists(st.floats(0, 1), max_size=3)
)
KEYS = st.sampled_from(["a", "b", "c d", "é", "1", 'q"'])
TABLES = st.dictionaries(KEYS, SCALARS, max_size=3)
DATA = st.dictionaries(KEYS, st.one_of(SCALARS, TABLES, st.lists(TABLES, min_size=1, max_size=2)), max_size=4)


@settings(max_examples=150, deadline=None)
@given(data=DATA)
def test_every_value_of_a_document_is_found_where_it_stands(data):
    text = toml_text(data)
    found = tomllib.loads(text)
    for table in toml_places(text):
        for entry in table.entries:
            expected = found
            for key in entry.place:
                expected = expected[key]
            assert tomllib.loads(f"x = {text[entry.value_start : entry.value_end]}")["x"] == expected
