"""What is written as TOML must be read back as it was, by the standard library's reader."""

import math
import tomllib

import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from heartcase.schemas.recipe.recipe import Recipe, parse_recipe
from heartcase.schemas.toml import toml_text
from tests.schemas.recipes import recipes

texts = st.text(st.characters(exclude_categories=["Cs"]), max_size=12)
scalars = st.booleans() | st.integers(-(2**63), 2**63 - 1) | st.floats(allow_nan=False, allow_infinity=False) | texts
values = st.recursive(scalars, lambda inner: st.lists(inner, max_size=4) | st.dictionaries(texts, inner, max_size=4))
documents = st.dictionaries(texts, values, max_size=6)


def same(a, b):
    """Equal with types, so that 1, 1.0 and true are three values; NaN has no place here."""
    if type(a) is not type(b):
        return False
    if isinstance(a, dict):
        return a.keys() == b.keys() and all(same(a[key], b[key]) for key in a)
    if isinstance(a, list):
        return len(a) == len(b) and all(map(same, a, b))
    return a == b and (not isinstance(a, float) or math.copysign(1, a) == math.copysign(1, b))


@given(documents)
@example({"": {"": [{"a": [{}]}, {}]}, "a.b": '\x00\x7f"\\\n\u2028', "c": [[], [1e-07, 1e300]], "d": [{"e": 1}, 2]})
def test_any_document_is_read_back_as_it_was(document):
    assert same(tomllib.loads(toml_text(document)), document)


def test_long_arrays_are_broken_and_stay_the_same():
    document = {"points_mm": [[1.5, 2.5, 3.5]] * 40}
    assert max(map(len, toml_text(document).splitlines())) < 120
    assert tomllib.loads(toml_text(document)) == document


@pytest.mark.parametrize("value", [None, math.nan, math.inf, object(), [None]])
def test_what_toml_or_heartcase_has_no_place_for_is_refused(value):
    with pytest.raises(ValueError, match="no place"):
        toml_text({"a": value})


@given(recipes())
def test_any_recipe_is_read_back_as_it_was(recipe: Recipe):
    assert parse_recipe(toml_text(recipe.model_dump(mode="json", exclude_none=True))) == recipe
