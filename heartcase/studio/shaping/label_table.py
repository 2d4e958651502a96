"""What a page's request makes of the label table in a recipe's text."""

from __future__ import annotations

import tomllib
from collections.abc import Iterator, Mapping, Sequence
from typing import Any

from pydantic import ValidationError

from heartcase.pipeline.building.recipe_text import changed_text
from heartcase.schemas.errors import Problem, UsageError, problems_from_validation
from heartcase.schemas.labels import BACKGROUND, Label, LabelTable, Role
from heartcase.schemas.recipe.recipe import Recipe
from heartcase.schemas.recipe.settings import Stroke
from heartcase.schemas.toml_places import Place

__all__ = ["check_names", "with_label", "with_wall_thickness", "without_label"]

_KEYS = ("value", "name", "role", "colour", "wall_thickness_mm", "snomed")
"""What a line says of a label, in this order."""
_GIVEN = frozenset(_KEYS) - {"value", "snomed"}


def with_label(head: str, recipe: Recipe, entry: Mapping[str, Any]) -> tuple[str, str]:
    """The recipe's text with one more label, and where that stands, in the recipe's words.

    It gets the lowest value that is free, and the code of the structure that its name stands for.

    Parameters
    ----------
    head
        The recipe's text, without the strokes of sessions at its end.
    recipe
        What it says.
    entry
        Name, role, and, where they are not the usual ones, colour and wall thickness.

    Raises
    ------
    UsageError
        There is such a label already, all values are taken, or the line cannot say that; every problem.
    RecipeError
        The table is written in a way that cannot be changed by itself.
    """
    table = recipe.table
    stated = {key: value for key, value in entry.items() if value is not None}
    if foreign := sorted(stated.keys() - _GIVEN):
        raise UsageError("is not set on this page: change it in the recipe's file", place=f"labels.{foreign[0]}")
    try:
        value = table.free_value()
    except ValueError as error:
        raise UsageError(str(error), place="labels") from None
    try:
        label = Label.model_validate({"value": value, **stated})
    except ValidationError as error:
        raise UsageError(problems_from_validation(error, place="labels")) from None
    if label.role is Role.BACKGROUND:
        raise UsageError("there is one background, and it is there already", place="labels.role")
    same = next((one for one in table if one.name.lower() == label.name.lower()), None)
    if same is None and label.term is not None:
        same = next((one for one in table if one.term is label.term), None)
    if same is not None:
        raise UsageError(f"the recipe has it already, as {same.name!r}: paint with that one", place="labels.name")
    line = {"value": value, **stated}
    if label.term is not None and label.term.code is not None:
        line["snomed"] = label.term.code
    lines, changes = _lines(head, recipe)
    place: Place = ("labels", len(lines))
    changes.append((place, {key: line[key] for key in _KEYS if key in line}))
    return changed_text(head, *changes), f"labels.{label.name}"


def without_label(head: str, recipe: Recipe, name: str) -> tuple[str, str]:
    """The recipe's text without a label, and what that was, in the recipe's words.

    Parameters
    ----------
    head
        The recipe's text, without the strokes of sessions at its end.
    recipe
        What it says.
    name
        The label's name.

    Raises
    ------
    UsageError
        There is no such label, it is the background, or the last structure.
    RecipeError
        The table is written in a way that cannot be changed by itself.
    """
    label = _found(recipe, name, place=f"labels.{name}")
    if label.value == BACKGROUND:
        raise UsageError("the background cannot be removed", place="labels")
    if len(recipe.table) == 2:
        # a table without any line is the usual one
        raise UsageError("the last structure cannot be removed: add another one first", place="labels")
    lines, changes = _lines(head, recipe)
    changes.append((("labels", _number(lines, label)), None))
    return changed_text(head, *changes), f"labels.{label.name}"


def with_wall_thickness(head: str, recipe: Recipe, name: str, thickness_mm: Any) -> tuple[str, str]:
    """The recipe's text with another wall around a cavity, and what was changed, in the recipe's words.

    Parameters
    ----------
    head
        The recipe's text, without the strokes of sessions at its end.
    recipe
        What it says.
    name
        The label's name.
    thickness_mm
        A number, in mm; None, or 0, grows no wall.

    Raises
    ------
    UsageError
        There is no such label, it is no cavity, or this is no number.
    RecipeError
        The table is written in a way that cannot be changed by itself.
    """
    place = f"labels.{name}.wall_thickness_mm"
    label = _found(recipe, name, place=place)
    lines, changes = _lines(head, recipe)
    if label.value == BACKGROUND:
        raise UsageError("is no cavity and has no wall", place=place)
    if thickness_mm is not None and (isinstance(thickness_mm, bool) or not isinstance(thickness_mm, int | float)):
        raise UsageError("must be a number, in mm", place=place)
    # no wall is what a label has when nothing is said
    changes.append((("labels", _number(lines, label), "wall_thickness_mm"), thickness_mm or None))
    return changed_text(head, *changes), place


def check_names(head: str, strokes: Sequence[Stroke], table: LabelTable) -> None:
    """Refuse a table by which a recipe would name other structures than before.

    Parameters
    ----------
    head
        The recipe's text with the new table, which it states, without the strokes of sessions at its end.
    strokes
        These strokes.
    table
        The table that was.

    Raises
    ------
    UsageError
        Names mean something else, or nothing any more: each of them.
    """
    stated = tomllib.loads(head)
    try:
        before, after = table.with_walls(), LabelTable(labels=stated["labels"]).with_walls()
    except ValueError:
        # whoever reads the recipe says what is wrong
        return
    names = dict.fromkeys([*_words(stated), *(one.label for one in strokes if one.label is not None)])
    problems = []
    for name in names:
        was, now = before.find(name), after.find(name)
        # a label's own name may stand there for something else; that it is missed is told by whoever reads the recipe
        is_missed = was is not None and now is None and name.lower() != was.name.lower()
        if was is not None and (is_missed or (now is not None and now.name != was.name)):
            means = "nothing" if now is None else repr(now.name)
            problems.append(Problem("labels", f"{name!r} in the recipe is {was.name!r}, and would mean {means} then"))
    if problems:
        raise UsageError(problems)


def _words(value: Any) -> Iterator[str]:
    """All keys and texts of a recipe but for those of the table itself."""
    if isinstance(value, dict):
        for key, one in value.items():
            yield key
            if key != "labels" or not isinstance(one, list):
                yield from _words(one)
    elif isinstance(value, list):
        for one in value:
            yield from _words(one)
    elif isinstance(value, str):
        yield value


def _found(recipe: Recipe, name: str, *, place: str) -> Label:
    label = recipe.table.find(name)
    if label is None:
        raise UsageError(f"there is no label {name!r}: take one of the list", place=place)
    return label


def _lines(head: str, recipe: Recipe) -> tuple[list[dict[str, Any]], list[tuple[Place, Any]]]:
    """The lines of the table, and the changes that state them where the recipe does not.

    A table that is stated replaces the usual one, so all of it is.
    """
    stated = tomllib.loads(head).get("labels")
    if stated is not None:
        return stated, []
    usual = [one.model_dump(mode="json", exclude_defaults=True) for one in recipe.labels if one.value != BACKGROUND]
    lines = [{key: one[key] for key in _KEYS if key in one} for one in usual]
    return lines, [(("labels",), lines)]


def _number(lines: list[dict[str, Any]], label: Label) -> int:
    return next(n for n, one in enumerate(lines) if one["value"] == label.value)
