"""Changing one thing in a recipe's text: all else, with its comments, stays to the letter.

A text is changed, and not written anew, because people write recipes: the order, the comments and the numbers as they
stand there are theirs. What comes out is read again and compared with what was to come out, so that a way of writing
that is not understood here is refused, and never damaged.
"""

from __future__ import annotations

import copy
import itertools
import tomllib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from heartcase.schemas.errors import RecipeError
from heartcase.schemas.recipe.settings import Stroke
from heartcase.schemas.toml import toml_text, toml_value
from heartcase.schemas.toml_places import EntryPlace, Place, TablePlace, toml_places

__all__ = [
    "HEADING",
    "Inserted",
    "changed_text",
    "place_words",
    "split_session",
    "strokes_text",
    "with_stroke",
    "without_line",
]

HEADING = "\n# Painted in a session.\n"
"""What stands above the strokes that sessions write at the end of a recipe."""


def split_session(text: str) -> tuple[str, str]:
    """A recipe's text without what sessions wrote at its end, and that; empty where there is nothing.

    What somebody wrote there by hand stays in the first part.
    """
    heading, place = HEADING.replace("\n", newline_of(text)), 0
    while (place := text.find(heading, place)) >= 0:
        tail = text[place:]
        is_ours = text[:place].endswith("\n") and "#" not in tail.replace(heading, "")
        if is_ours and tomllib.loads(tail).keys() == {"strokes"}:
            return text[:place], tail
        place += len(heading)
    return text, ""


def strokes_text(strokes: Sequence[Stroke]) -> str:
    """Strokes as they stand at the end of a recipe; empty where there are none."""
    if not strokes:
        return ""
    tables = [stroke.model_dump(mode="json", exclude_defaults=True) for stroke in strokes]
    return HEADING + toml_text({"strokes": tables})


def with_stroke(text: str, stroke: Stroke, *, has_some: bool) -> str:
    """A recipe's text with a stroke at its end; ``has_some`` where it ends with strokes of sessions already."""
    added = strokes_text((stroke,))
    if has_some:
        added = "\n" + added.removeprefix(HEADING)
    newline = newline_of(text)
    return (text if text.endswith("\n") else text + newline) + added.replace("\n", newline)


def changed_text(text: str, *changes: tuple[Place, Any]) -> str:
    """A recipe's text with other values at some places.

    Parameters
    ----------
    text
        The recipe, without the strokes of sessions at its end.
    changes
        Each a place and what is to stand there, one after the other. A place is keys, and numbers from 0: ``("ends",
        0)``, ``("materials", "youngs_modulus_kpa")``; a number that is one above those there adds a table. What is to
        stand there is a value; a mapping for a table, of which only what differs is written anew; :class:`Inserted`, a
        table before the one that is there; or None, which takes it away.

    Raises
    ------
    RecipeError
        A part is written in a way that cannot be changed by itself.
    """
    newline = newline_of(text)
    data: dict[str, Any] = tomllib.loads(text)
    found = text.replace(newline, "\n")
    place: Place = ()
    try:
        for place, value in changes:
            wanted = _with(data, place, value)
            if wanted != data:
                found, data = _changed(found, place, value, data), wanted
        is_right = found == text or tomllib.loads(found) == data
    except (tomllib.TOMLDecodeError, _Entangled):
        is_right = False
    if not is_right:
        raise RecipeError(
            "is written in a way that cannot be changed by itself: change it in the recipe's file, or write it as "
            f"{_header(place)} tables there",
            place=place_words(place),
        )
    return found.replace("\n", newline)


def without_line(text: str, key: str) -> str:
    """A text without one of the entries above its first table."""
    for entry in toml_places(text)[0].entries:
        if entry.place == (key,):
            return text[: entry.start] + text[entry.end :]
    return text


def place_words(place: Place) -> str:
    """A place as messages name it: ``edits[2].diameter_mm``."""
    words = ""
    for part in place:
        words += f"[{part + 1}]" if isinstance(part, int) else f".{part}" if words else part
    return words


def newline_of(text: str) -> str:
    """How the lines of a text end."""
    return "\r\n" if 0 < text.count("\n") == text.count("\r\n") else "\n"


@dataclass(frozen=True)
class Inserted:
    """A table that is put before another one of its array."""

    table: Mapping[str, Any]
    """What it holds."""


class _Entangled(Exception):
    """Two things are written in one."""


def _with(data: Mapping[str, Any], place: Place, value: Any) -> Any:
    """Data with another value at a place; tables on the way that are not there are made, and those left empty go."""
    whole = copy.deepcopy(dict(data))
    inner: Any = whole
    for key, following in itertools.pairwise(place):
        if isinstance(key, str) and key not in inner:
            inner[key] = [] if isinstance(following, int) else {}
        inner = inner[key]
    last = place[-1]
    if value is None:
        if isinstance(last, int) or last in inner:
            del inner[last]
        if len(place) > 1 and not inner:
            return _with(data, place[:-1], None)
    elif isinstance(value, Inserted):
        inner.insert(last, value.table)
    elif isinstance(inner, list) and last == len(inner):
        inner.append(value)
    else:
        inner[last] = value
    return whole


def _at(data: Any, place: Place) -> Any:
    for key in place:
        if isinstance(key, str):
            data = data.get(key) if isinstance(data, Mapping) else None
        else:
            data = data[key] if isinstance(data, list) and key < len(data) else None
    return data


def _changed(text: str, place: Place, value: Any, data: Mapping[str, Any]) -> str:
    """The text with the change, by the first way that fits how the place is written."""
    tables = toml_places(text)
    for entry in (entry for table in tables for entry in table.entries):
        if entry.place == place and value is not None:
            return _written_over(text, entry, value)
        if entry.place == place:
            return _without_entry(text, entry, place, data)
        if entry.place == place[: len(entry.place)]:
            # a part of an inline table or array
            rest = place[len(entry.place) :]
            whole = _with({"whole": _at(data, entry.place)}, ("whole", *rest), value).get("whole")
            return (
                _without_entry(text, entry, entry.place, data) if whole is None else _written_over(text, entry, whole)
            )
    if value is None:
        return _without_tables(text, tables, place, data)
    if isinstance(value, Inserted):
        return _with_block_before(text, tables, place, value.table)
    if isinstance(value, Mapping):
        return _with_table(text, tables, place, value, data)
    if _is_tables(value):
        return _with_block(text, tables, place, toml_text(_with({}, place, value)))
    return _with_entry(text, tables, place, value)


def _written_over(text: str, entry: EntryPlace, value: Any) -> str:
    if entry.is_commented:
        raise _Entangled  # comments in between would be lost
    return text[: entry.value_start] + _value_text(entry.place[-1], value) + text[entry.value_end :]


def _value_text(key: str | int, value: Any) -> str:
    """A value as it stands behind its key: long lists in several lines."""
    if isinstance(value, Mapping) or _is_tables(value):
        return toml_value(value)
    return toml_text({str(key): value}).partition(" = ")[2].rstrip("\n")


def _without_entry(text: str, entry: EntryPlace, place: Place, data: Mapping[str, Any]) -> str:
    inner = _at(data, place[:-1]) if len(place) > 1 else None
    if isinstance(inner, Mapping) and len(inner) == 1:
        # nothing would be left in its table
        return _changed(text, place[:-1], None, data)
    return text[: entry.start] + text[entry.end :]


def _without_tables(text: str, tables: Sequence[TablePlace], place: Place, data: Mapping[str, Any]) -> str:
    """Take a table away, with those in it and one blank line above each."""
    inner = _at(data, place[:-1]) if len(place) > 1 and isinstance(place[-1], str) else None
    if isinstance(inner, Mapping) and len(inner) == 1:
        return _changed(text, place[:-1], None, data)
    for table in reversed(tables):
        if table.place[: len(place)] == place:
            start = table.start - 1 if text[: table.start].endswith("\n\n") else table.start
            text = text[:start] + text[table.end :]
    return text


def _with_table(
    text: str, tables: Sequence[TablePlace], place: Place, value: Mapping[str, Any], data: Mapping[str, Any]
) -> str:
    """Write a new table, or what differs in one that is there."""
    there = _at(data, place)
    if there is None:
        return _with_block(text, tables, place, _block(place, value))
    changes: list[tuple[str, Any]] = [(key, None) for key in there if key not in value]
    changes += [(key, one) for key, one in value.items() if key not in there or there[key] != one]
    for key, one in changes:
        text = _changed(text, (*place, key), one, data)
        data = _with(data, (*place, key), one)
    return text


def _is_tables(value: Any) -> bool:
    return isinstance(value, list) and any(isinstance(one, Mapping) for one in value)


def _with_entry(text: str, tables: Sequence[TablePlace], place: Place, value: Any) -> str:
    """Write a new entry at the end of its table, which is made where it has no header."""
    for table in tables:
        if table.place == place[:-1]:
            written = f"{toml_text({str(place[-1]): value})}"
            before = text[: table.end]
            return before + ("" if before.endswith("\n") or not before else "\n") + written + text[table.end :]
    return _with_block(text, tables, place, _block(place[:-1], {str(place[-1]): value}))


def _block(place: Place, table: Mapping[str, Any]) -> str:
    """A table with its header, as a person writes it: without those of the tables that it lies in."""
    if not place:
        return toml_text(table)
    name = ".".join(toml_text({part: 0}).partition(" = ")[0] for part in place if isinstance(part, str))
    return (f"[[{name}]]\n" if isinstance(place[-1], int) else f"[{name}]\n") + toml_text(table)


def _with_block(text: str, tables: Sequence[TablePlace], place: Place, block: str) -> str:
    """Put a new table behind the last one of its kind; at the end where there is none."""
    alike = [table for table in tables if table.place[:1] == place[:1]]
    at = alike[-1].end if alike else len(text)
    before = text[:at]
    return before + ("" if before.endswith("\n") else "\n") + "\n" + block + text[at:]


def _with_block_before(text: str, tables: Sequence[TablePlace], place: Place, table: Mapping[str, Any]) -> str:
    """Put a new table before the one at a place, and before the words that stand right above that."""
    at = next(one.start for one in tables if one.place == place)
    while (line := text.rfind("\n", 0, at - 1) + 1) < at and text[line:at].lstrip().startswith("#"):
        at = line
    return text[:at] + _block(place, table) + "\n" + text[at:]


def _header(place: Place) -> str:
    name = ".".join(part for part in place if isinstance(part, str)) if isinstance(place[-1], int) else str(place[0])
    return f"[[{name}]]" if any(isinstance(part, int) for part in place) else f"[{name}]"
