"""A value that is none of several kinds is one mistake, told without the names that the kinds have in the code."""

from __future__ import annotations

import importlib
import math
import pkgutil
import types
import typing
from collections.abc import Iterator
from typing import Any

import pytest
from pydantic import BaseModel, ValidationError, create_model

import heartcase.schemas
from heartcase.schemas.base import Model, OneOf
from heartcase.schemas.errors import RecipeError, ScriptError, problems_from_validation
from heartcase.schemas.recipe.recipe import parse_recipe
from heartcase.schemas.recording.header import RecordingHeader
from heartcase.schemas.touring.reading import parse_tour

TOUR = '+++\nheartcase_tour = 1\ncase = "a"\n+++\n# T\n\nText.\n\n## One\n\nMore.\n\n```toml\n[view]\n{}\n```\n'
PLACE = "must be a name, three finite numbers, or { near = ... }"
WAY = 'must be a direction in words, such as "front left", a name, or three finite numbers'


@pytest.mark.parametrize(("line", "told"), [
    ("at = [1e300, nan, 0]", [f"view.at: {PLACE}"]),
    ("at = [1, 2]", [f"view.at: {PLACE}"]),
    ("at = 5", [f"view.at: {PLACE} (found 5)"]),
    ("from = [inf, 0, 0]", [f"view.from: {WAY}"]),
    ("from = {near = 'a'}", [f"view.from: {WAY}"]),
    ("from = [0, 0, 0]", ["view.from: a direction needs three numbers that are not all zero"]),
    ("at = {near = 'a', towards = [nan, 0, 0], by_mm = 'x'}",
     [f"view.at.towards: {WAY}", "view.at.by_mm: must be a number (found 'x')"]),
    ("at = {nears = 'a', towards = 'front', by_mm = 1}",
     ["view.at.near: is missing: add it", "view.at.nears: unknown setting: did you mean 'near'?"]),
])  # fmt: skip
def test_a_wrong_place_of_a_tour_is_told_as_what_it_may_be(line, told):
    with pytest.raises(ScriptError) as caught:
        parse_tour(TOUR.format(line))
    assert [str(one).partition(": ")[2] for one in caught.value.problems] == told


def test_a_name_that_is_no_place_is_told_as_a_name():
    with pytest.raises(ScriptError) as caught:
        parse_tour(TOUR.format("at = 'a/b'"))
    (problem,) = caught.value.problems
    assert "view.at: holds characters" in str(problem)


def test_a_wrong_name_of_a_table_is_told_by_itself():
    head = 'heartcase_recipe = 1\nname = "a"\n[scan]\npath = "s.nii.gz"\n'
    with pytest.raises(RecipeError) as caught:
        parse_recipe(head + '[materials.labels."a:b"]\nyoungs_modulus_kpa = 1.0\n')
    assert "materials.labels.a:b" in [one.place for one in caught.value.problems]


def test_a_setting_of_a_law_that_is_no_number_is_one_mistake():
    made = create_model("Law", __base__=Model, law=(RecordingHeader.model_fields["law"].annotation, ...))
    sound = {"name": "springs", "is_on": True, "ratio": 0.25}
    assert made.model_validate({"law": sound}).model_dump() == {"law": sound}
    with pytest.raises(ValidationError) as caught:
        made.model_validate({"law": {"ratio": math.nan, "name": []}})
    said = [str(one).partition(" (")[0] for one in problems_from_validation(caught.value)]
    assert said == [f"law.{key}: must be text, true, false, or a finite number" for key in ("ratio", "name")]


MADE_BY_CODE = {"TourStep.acts", "ResolvedRecipe.filter", "ResolvedRecipe.grid"}
"""No file says these as they are."""


def unions(annotation: Any, beside: tuple[Any, ...] = ()) -> Iterator[tuple[Any, ...]]:
    """What stands beside each union of several kinds in a type."""
    if typing.get_origin(annotation) is typing.Annotated:
        inner, *more = typing.get_args(annotation)
        yield from unions(inner, tuple(more))
        return
    inner = [one for one in typing.get_args(annotation) if one is not types.NoneType]
    if typing.get_origin(annotation) in (typing.Union, types.UnionType) and len(inner) > 1:
        yield beside
    for one in inner:
        if not isinstance(one, str | int):
            yield from unions(one)


def models(base: type[BaseModel]) -> Iterator[type[BaseModel]]:
    for one in base.__subclasses__():
        yield one
        yield from models(one)


def test_every_choice_between_kinds_says_what_it_may_be():
    for module in pkgutil.walk_packages(heartcase.schemas.__path__, "heartcase.schemas."):
        importlib.import_module(module.name)
    silent, count = set(), 0
    for model in set(models(BaseModel)):
        if not model.__module__.startswith("heartcase.schemas"):
            continue
        for name, field in model.model_fields.items():
            beside = tuple(field.metadata)
            for found in unions(field.annotation, (*beside, field)):
                count += 1
                if not any(isinstance(one, OneOf) or getattr(one, "discriminator", None) for one in found):
                    silent.add(f"{model.__name__}.{name}")
    assert silent == MADE_BY_CODE
    assert count > 10
