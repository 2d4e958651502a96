"""Places of settings: what a file did not state, what has no value, and taking settings out of a file's data."""

import copy

from heartcase.schemas.base import Model
from heartcase.schemas.recipe.lock import defaulted_settings, fill_unset, settings_of, unset_settings, without_settings


class Inner(Model):
    kind: str = "plain"
    size: int | None = None
    names: tuple[str, ...] = ()


class Kindless(Model):
    weight: float | None = None


class Outer(Model):
    title: str
    inner: Inner = Inner()
    many: tuple[Inner, ...] = ()
    named: dict[str, Kindless] = {}
    place: str | None = None


DATA = {
    "title": "a",
    "many": [{"kind": "round", "size": 3}, {"kind": "flat"}],
    "named": {"left wall. old": {}, "b": {"weight": 2.0}},
}


def test_places_of_settings():
    outer = Outer.model_validate(DATA)
    values = dict(settings_of(outer))
    assert values["many[1].size"] == 3
    assert values["named.b.weight"] == 2.0
    assert values["inner.kind"] == "plain"
    assert values["place"] is None
    assert defaulted_settings(outer) == (
        *("inner", "many[1].names", "many[2].size", "many[2].names"),
        *("named.left wall. old.weight", "place"),
    )
    assert unset_settings(outer) == ("inner.size", "many[flat].size", "named.*.weight", "place")


def test_what_is_unset_is_filled_where_it_fits_and_nowhere_else():
    data = {
        **copy.deepcopy(DATA),
        "inner": {},
        "lock": {"unset": ["inner.size", "many[flat].size", "named.*.weight", "place", "gone.size", "title.x", "[", 7]},
    }
    fill_unset(data)
    assert data["inner"] == {"size": None}
    assert data["many"] == [{"kind": "round", "size": 3}, {"kind": "flat", "size": None}]
    assert data["named"] == {"left wall. old": {"weight": None}, "b": {"weight": 2.0}}
    assert data["place"] is None
    assert "gone" not in data
    for lock in (None, 7, {}, {"unset": "x"}, {"unset": None}):
        untouched = {"title": "a", "lock": lock}
        fill_unset(untouched)
        assert untouched == {"title": "a", "lock": lock}


def test_settings_are_taken_out_by_their_places():
    places = {"title", "many[1].size", "named.left wall. old"}
    assert without_settings(DATA, places) == {
        "many": [{"kind": "round"}, {"kind": "flat"}],
        "named": {"b": {"weight": 2.0}},
    }
    assert "title" in DATA
