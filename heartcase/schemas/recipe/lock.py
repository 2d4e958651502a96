"""What a locked recipe was locked with, and which of its settings nobody had stated."""

from __future__ import annotations

import re
from collections.abc import Collection, Iterator, Mapping
from typing import Annotated, Any

from pydantic import Field

from heartcase.schemas.base import Model

__all__ = ["RecipeLock", "defaulted_settings", "fill_unset", "settings_of", "unset_settings", "without_settings"]

_Sha256 = Annotated[str, Field(pattern=r"^[0-9a-f]{64}$")]
_Place = Annotated[str, Field(min_length=1, max_length=200, pattern=r"^[^\x00-\x1f\x7f-\x9f]*$")]


class RecipeLock(Model):
    """What a recipe was locked with; ``heartcase lock`` writes it, people leave it alone."""

    software_version: Annotated[str, Field(max_length=100, pattern=r"^[0-9A-Za-z.+!-]*$")]
    """Version of heartcase that locked it."""
    stages: dict[Annotated[str, Field(pattern=r"^[a-z_]{1,32}$")], Annotated[int, Field(ge=1)]]
    """Stage -> version of its algorithm."""
    scan_sha256: _Sha256
    """Hash of the intensities and the geometry of the scan's region of interest."""
    markers_sha256: tuple[_Sha256, ...] = ()
    """Hash of each marker file, in the recipe's order."""
    segmentation_sha256: _Sha256 | None = None
    """Hash of the finished segmentation's file, where the recipe takes one."""
    settings_sha256: _Sha256 | None = None
    """Hash of all settings as they were locked: it shows when somebody edits the lock."""
    found_end_count: Annotated[int, Field(ge=0)] | None = None
    """How many of the last entries of ``ends`` were found at locking, as ``walls.find_ends`` asks for."""
    defaulted: tuple[_Place, ...] = ()
    """Settings that the recipe had left out, so that the lock filled them in."""
    unset: tuple[_Place, ...] = ()
    """Settings that stay without a value, whatever a later version takes for them."""

    @property
    def inputs(self) -> tuple[str | None, ...]:
        """Hashes of the scan, of the segmentation and of the marker files."""
        return (self.scan_sha256, self.segmentation_sha256, *self.markers_sha256)


def settings_of(model: Model, place: str = "") -> Iterator[tuple[str, Any]]:
    """All settings of a model and of the models in it, in order: place, as an error would name it, and value."""
    for name in type(model).model_fields:
        yield from _settings_in(getattr(model, name), _inside(place, name))


def _settings_in(value: Any, place: str) -> Iterator[tuple[str, Any]]:
    if isinstance(value, Model):
        yield from settings_of(value, place)
    elif members := _members(value):
        for key, member in members:
            yield from _settings_in(member, _inside(place, key))
    else:
        yield place, value


def defaulted_settings(model: Model, place: str = "") -> tuple[str, ...]:
    """Places of the settings that a model's file did not state; one of a whole table or array that it left out."""
    places: list[str] = []
    for name in type(model).model_fields:
        inner, value = _inside(place, name), getattr(model, name)
        if name not in model.model_fields_set:
            places.append(inner)
        elif isinstance(value, Model):
            places += defaulted_settings(value, inner)
        else:
            for key, member in _members(value):
                places += defaulted_settings(member, _inside(inner, key))
    return tuple(places)


def unset_settings(model: Model, place: str = "") -> tuple[str, ...]:
    """Settings without a value, ascending, such as ``region``, ``labels.snomed`` and ``edits[add].into``.

    One place stands for all members of an array, or for all of one ``kind`` where the members have kinds; ``*``
    stands for any name in a table of tables.
    """
    found: set[str] = set()
    for name in type(model).model_fields:
        inner, value = _inside(place, name), getattr(model, name)
        if value is None:
            found.add(inner)
        elif isinstance(value, Model):
            found.update(unset_settings(value, inner))
        else:
            for key, member in _members(value):
                kind = f"[{member.kind}]" if "kind" in type(member).model_fields else ""  # type: ignore[attr-defined]
                found.update(unset_settings(member, f"{inner}{kind}" if isinstance(key, int) else f"{inner}.*"))
    return tuple(sorted(found))


def without_settings(data: Any, places: Collection[str], place: str = "") -> Any:
    """A file's data without the settings at these places."""
    if isinstance(data, Mapping):
        inner = {key: _inside(place, key) for key in data}
        return {key: without_settings(data[key], places, inner[key]) for key in data if inner[key] not in places}
    if isinstance(data, list):
        return [without_settings(member, places, _inside(place, n)) for n, member in enumerate(data)]
    return data


def _members(value: Any) -> list[tuple[str | int, Model]]:
    """Key or index and model of each member of an array or a table of models; nothing for other values."""
    pairs = value.items() if isinstance(value, Mapping) else enumerate(value) if isinstance(value, tuple) else ()
    return [(key, member) for key, member in pairs if isinstance(member, Model)]


def _inside(place: str, key: str | int) -> str:
    if isinstance(key, int):
        return f"{place}[{key + 1}]"
    return f"{place}.{key}" if place else key


def fill_unset(data: dict[str, Any]) -> None:
    """Put None, which TOML cannot say, where a locked recipe says ``unset`` and gives no value; in place."""
    lock = data.get("lock")
    places = lock.get("unset") if isinstance(lock, dict) else None
    for place in places if isinstance(places, list) else ():
        if isinstance(place, str):
            _fill(data, place.split("."))


def _fill(node: Any, keys: list[str]) -> None:
    found = re.fullmatch(r"(\w+|\*)(?:\[(\w+)\])?", keys[0])
    if found is None or not isinstance(node, dict):
        return
    if keys[0] == "*":
        for member in node.values():
            _fill(member, keys[1:])
        return
    name, kind = found.groups()
    if len(keys) == 1:
        node.setdefault(name, None)
        return
    inner = node.get(name)
    for member in inner if isinstance(inner, list) else [inner]:
        if kind is None or (isinstance(member, dict) and member.get("kind") == kind):
            _fill(member, keys[1:])
