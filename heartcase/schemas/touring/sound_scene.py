"""What is sound in a step's scene that is wrong: what it names of a case can be looked at all the same."""

from __future__ import annotations

import re
from collections.abc import Sequence
from typing import Any

from pydantic import ValidationError

from heartcase.schemas.errors import Problem, problems_from_validation
from heartcase.schemas.touring.places import Beside
from heartcase.schemas.touring.tour import CutPlane, Scene, TourView

__all__ = ["keys_of", "sound_scene"]

_NO_PLACE_OF_A_PLANE = {"", "show", "hide", "stretch"}
"""Settings that have no part in where a cut plane lies; "" is all of the scene."""


def sound_scene(data: dict[str, Any]) -> tuple[Scene, tuple[Problem, ...]]:
    """A scene without what is wrong in it, and that.

    Parameters
    ----------
    data
        The scene's settings; those that are wrong become None.
    """
    try:
        return Scene.model_validate(data), ()
    except ValidationError as error:
        problems = problems_from_validation(error, model=Scene)
    for problem in problems:
        _blank(data, keys_of(problem.place))
    wrong = {str(keys[0]) if (keys := keys_of(problem.place)) else "" for problem in problems}
    made: dict[str, Any] = {}
    for key in ("show", "hide"):
        if isinstance(data.get(key), list):
            made[key] = tuple(name for name in data[key] if isinstance(name, str))
    # A plane without a place is not told where what says it may be among what is wrong.
    if "view" in data or not wrong <= _NO_PLACE_OF_A_PLANE:
        made["view"] = _as_told(TourView, data.get("view"))
    if isinstance(data.get("cut_plane"), dict):
        made["cut_plane"] = _as_told(CutPlane, data["cut_plane"])
    return Scene.model_construct(**made), problems


def keys_of(dotted: str) -> tuple[str | int, ...]:
    """Keys of tables, and numbers in lists from 0 on, that lead to the setting of a problem's place."""
    parts = re.findall(r"[^.\[\]]+|\[\d+\]", dotted.replace("from_", "from"))
    return tuple(int(part[1:-1]) - 1 if part.startswith("[") else part for part in parts)


def _blank(data: Any, keys: Sequence[str | int]) -> None:
    """Put None for a setting that is wrong; of a table each setting in it is told, and the others are sound."""
    for key in keys[:-1]:
        data = _inner(data, key)
    if keys and _inner(data, keys[-1]) is not None and not isinstance(_inner(data, keys[-1]), dict):
        data[keys[-1]] = None


def _inner(data: Any, key: str | int) -> Any:
    if isinstance(data, dict):
        return data.get(key)
    return data[key] if isinstance(data, list) and isinstance(key, int) and key < len(data) else None


def _as_told(model: type[TourView | CutPlane | Beside], data: Any) -> Any:
    """The model with what a table says, None for what it leaves out without a default; nothing is checked."""
    told = data if isinstance(data, dict) else {}
    made: dict[str, Any] = {}
    for name, field in model.model_fields.items():
        value = told.get(field.alias or name, None if field.is_required() else field.default)
        made[name] = _as_told(Beside, value) if isinstance(value, dict) else value
    return model.model_construct(**made)
