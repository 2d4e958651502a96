"""What a page's request makes of a recipe's text."""

from __future__ import annotations

import tomllib
from collections.abc import Mapping, Sequence
from typing import Any

from pydantic import TypeAdapter, ValidationError

from heartcase.pipeline.building.recipe_text import Inserted, changed_text, place_words, without_line
from heartcase.schemas.base import Model, Name
from heartcase.schemas.errors import Problem, UsageError, problems_from_validation
from heartcase.schemas.landmarks import Landmark
from heartcase.schemas.recipe.edit_settings import Edit
from heartcase.schemas.recipe.recipe import AUTOMATIC, Recipe
from heartcase.schemas.recipe.settings import (
    ContactPlace,
    EndMarker,
    MaterialSettings,
    Pin,
    SeptumThickness,
    WallThickness,
)
from heartcase.schemas.toml_places import Place
from heartcase.studio.shaping.facts import LINES, SETTINGS
from heartcase.studio.shaping.label_table import with_label, with_wall_thickness, without_label
from heartcase.studio.shaping.requests import Act, Add, AddLabel, Change, Remove, RemoveLabel, Set

__all__ = ["done_to", "plain"]

_LINES: dict[str, TypeAdapter[Any]] = {
    "ends": TypeAdapter(EndMarker),
    "edits": TypeAdapter(Edit),
    "landmarks": TypeAdapter(Landmark),
    "pins": TypeAdapter(Pin),
    "walls.thickness": TypeAdapter(WallThickness),
    "walls.septum": TypeAdapter(SeptumThickness),
    "walls.contact": TypeAdapter(ContactPlace),
}
_NAME: TypeAdapter[str] = TypeAdapter(Name)
_BARE = ("smooth", "fill", "keep_largest", "remove_islands")
"""Edits that come before all others, whatever their place: a build refuses some of them behind others."""
_FIRST_KEYS = ("kind", "name", "label")
"""What a line begins with, as people write it."""


def done_to(head: str, recipe: Recipe, request: Act) -> tuple[str, str]:
    """The recipe's text after a request, and what was changed, in the recipe's words.

    Parameters
    ----------
    head
        The recipe's text, without the strokes of sessions at its end.
    recipe
        What it says.
    request
        What is asked.

    Raises
    ------
    UsageError
        There is no such line or setting, the line says something else than it was shown to say, or it cannot say
        that; every problem.
    RecipeError
        The part is written in a way that cannot be changed by itself.
    """
    match request:
        case Set():
            return _set(head, recipe, request)
        case AddLabel():
            return with_label(head, recipe, request.entry)
        case RemoveLabel():
            return without_label(head, recipe, request.label)
    place: Place = tuple(request.list.split("."))
    if request.list == "ends":
        head = _without_automatic(head)
    there = _at(recipe, request.list)
    count = len(there)
    match request:
        case Add():
            lines = [_line(request.list, number, entry) for number, entry in enumerate(request.entries, start=count)]
            first = _first_laid_over(recipe.edits) if all(line.get("kind") in _BARE for line in lines) else count
            if first < count:
                lines.reverse()
                return changed_text(head, *(((*place, first), Inserted(line)) for line in lines)), place_words(
                    (*place, first)
                )
            changes = [((*place, number), line) for number, line in enumerate(lines, start=count)]
            return changed_text(head, *changes), place_words((*place, count))
        case Change():
            where = _existing(request, there)
            return changed_text(head, (where, _line(request.list, request.number - 1, request.entry))), place_words(
                where
            )
        case Remove():
            where = _existing(request, there)
            return changed_text(head, (where, None)), place_words(where)


def _first_laid_over(edits: Sequence[Edit]) -> int:
    """Where edits of bare structures end: those behind are laid over the heart with its walls."""
    return next((number for number, edit in enumerate(edits) if edit.kind not in _BARE), len(edits))


def _at(recipe: Recipe, name: str) -> tuple[Model, ...]:
    found: Any = recipe
    for key in name.split("."):
        found = getattr(found, key)
    return tuple(found)


def plain(model: Model) -> dict[str, Any]:
    """What a line or a table states, its defaults left out: as pages are shown it."""
    return model.model_dump(mode="json", exclude_defaults=True)


def _existing(request: Change | Remove, there: Sequence[Model]) -> Place:
    """Where the line is that the request was made for."""
    name, number = request.list, request.number
    if number > len(there):
        raise UsageError(f"there is no line {number}: the recipe has {len(there)}", place=name)
    place: Place = (*name.split("."), number - 1)
    if plain(there[number - 1]) != request.was:
        raise UsageError("it was changed or moved meanwhile: look at it again", place=place_words(place))
    return place


def _line(name: str, number: int, entry: Mapping[str, Any]) -> dict[str, Any]:
    """A line as it is written: what is not stated stays away."""
    stated = {key: value for key, value in entry.items() if value is not None}
    try:
        model: Model = _LINES[name].validate_python(stated)
    except ValidationError as error:
        raise UsageError(_problems(error, name, number)) from None
    written = model.model_dump(mode="json", exclude_unset=True)
    return {key: written[key] for key in sorted(written, key=_rank)}


def _problems(error: ValidationError, name: str, number: int) -> tuple[Problem, ...]:
    """What is wrong with a line; pydantic puts the kind of line into places."""
    place = place_words((*name.split("."), number))
    places = {f"{place}.{kind}": place for kind in LINES[name]}
    found = []
    for problem in problems_from_validation(error, place=place):
        kind = next((one for one in places if f"{problem.place}.".startswith(f"{one}.")), None)
        where = problem.place if kind is None else problem.place.replace(kind, places[kind], 1)
        found.append(Problem(where, problem.message))
    return tuple(found)


def _rank(key: str) -> int:
    return _FIRST_KEYS.index(key) if key in _FIRST_KEYS else len(_FIRST_KEYS)


def _without_automatic(head: str) -> str:
    """The text with ``ends = "automatic"`` said in the other way, which leaves room for lines."""
    if tomllib.loads(head).get("ends") != AUTOMATIC:
        return head
    return changed_text(without_line(head, "ends"), (("walls", "find_ends"), True))


def _set(head: str, recipe: Recipe, request: Set) -> tuple[str, str]:
    first, *rest = request.place
    if first == "name" and not rest:
        try:
            name = _NAME.validate_python(request.value)
        except ValidationError as error:
            raise UsageError(problems_from_validation(error, place="name")) from None
        return changed_text(head, (("name",), name)), "name"
    if first == "labels" and len(rest) == 2 and rest[1] == "wall_thickness_mm":
        return with_wall_thickness(head, recipe, rest[0], request.value)
    if first == "materials" and len(rest) == 2 and rest[0] == "labels":
        return _set_material(head, recipe, rest[1], request.value)
    if first not in SETTINGS or rest not in ([key] for key in SETTINGS[first][1]):
        raise UsageError("this is not set on this page: change it in the recipe's file", place=".".join(request.place))
    if isinstance(request.value, dict | list):
        raise UsageError("must be one value", place=".".join(request.place))
    if first == "walls":
        head = _without_automatic(head)
    if rest == ["material"] and request.value is not None:
        # numbers that are stated would count instead of the material's
        stated = tomllib.loads(head).get("materials", {})
        for key in ("youngs_modulus_kpa", "density_kg_m3"):
            if key in stated:
                head = changed_text(head, (("materials", key), None))
    return changed_text(head, (tuple(request.place), request.value)), ".".join(request.place)


def _set_material(head: str, recipe: Recipe, name: str, value: Any) -> tuple[str, str]:
    place = f"materials.labels.{name}"
    if value is None:
        if name not in recipe.materials.labels:
            raise UsageError("has no constants of its own", place=place)
        return changed_text(head, (("materials", "labels", name), None)), place
    if not isinstance(value, dict):
        raise UsageError("must be a table of constants", place=place)
    try:
        settings = MaterialSettings.model_validate(value)
    except ValidationError as error:
        raise UsageError(problems_from_validation(error, place=place)) from None
    # a material's own numbers are not written beside its name
    written = settings.model_dump(mode="json", exclude_unset=True, exclude_none=True)
    stated = {key: written[key] for key in value if key in written}
    return changed_text(head, (("materials", "labels", name), stated)), place
