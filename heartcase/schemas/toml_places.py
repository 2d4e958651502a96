"""Where things stand in the text of a TOML document (https://toml.io/en/v1.0.0), so that one can be changed alone."""

from __future__ import annotations

import re
import tomllib
from dataclasses import dataclass

__all__ = ["EntryPlace", "Place", "TablePlace", "toml_places"]

Place = tuple[str | int, ...]
"""What leads to a value of a document: keys, and numbers from 0 in an array."""

_ONE_KEY = r"""(?:[A-Za-z0-9_-]+|"(?:[^"\\\n]|\\.)*"|'[^'\n]*')"""
_KEY = re.compile(rf"{_ONE_KEY}(?:[ \t]*\.[ \t]*{_ONE_KEY})*")
_BLANK = re.compile(r"(?:[ \t\r\n]|#[^\n]*)*")
_REST_OF_LINE = re.compile(r"[^\n]*(?:\n|\Z)")
_STRING = re.compile(
    r'"""(?:[^\\]|\\.)*?"{3,5}|' + r"'''.*?'{3,5}" + r"""|"(?:[^"\\\n]|\\.)*"|'[^'\n]*'""",
    re.S,
)
_SCALAR = re.compile(r"[^,\]}#\n]*")


@dataclass(frozen=True)
class EntryPlace:
    """A key and its value."""

    place: Place
    """What leads to the value from the document's top."""
    start: int
    """Where its first line begins."""
    value_start: int
    """Where the value begins."""
    value_end: int
    """Where the value ends."""
    end: int
    """Behind its last line."""
    is_commented: bool
    """Whether there are comments within the value."""


@dataclass(frozen=True)
class TablePlace:
    """A table with a header of its own; the first one is the document's top, which has none."""

    place: Place
    """What leads to the table."""
    start: int
    """Where the line of its header begins."""
    end: int
    """Behind the last line of its header and entries: comments that follow belong to what comes next."""
    entries: tuple[EntryPlace, ...]
    """Its own entries, in order."""


def toml_places(text: str) -> tuple[TablePlace, ...]:
    """The tables of a document and their entries, in the order in which they are written.

    Parameters
    ----------
    text
        A valid document: what ``tomllib`` refuses has no defined places.
    """
    counts: dict[Place, int] = {}
    tables: list[TablePlace] = []
    place: Place = ()
    start, end = 0, 0
    entries: list[EntryPlace] = []
    at = _skip(_BLANK, text, 0)
    while at < len(text):
        line_start = text.rfind("\n", 0, at) + 1
        if text[at] == "[":
            tables.append(TablePlace(place, start, end, tuple(entries)))
            is_array = text.startswith("[[", at)
            at = _skip(re.compile(r"\[\[?[ \t]*"), text, at)
            key_end = _skip(_KEY, text, at)
            place = _resolved(_keys(text[at:key_end]), is_array, counts)
            start, end, entries = line_start, _skip(_REST_OF_LINE, text, key_end), []
        else:
            key_end = _skip(_KEY, text, at)
            value_start = _skip(re.compile(r"[ \t]*=[ \t]*"), text, key_end)
            value_end = _value_end(text, value_start)
            end = _skip(_REST_OF_LINE, text, value_end)
            keys = (*place, *_keys(text[at:key_end]))
            is_commented = "#" in _STRING.sub("", text[value_start:value_end])
            entries.append(EntryPlace(keys, line_start, value_start, value_end, end, is_commented))
        at = _skip(_BLANK, text, end)
    tables.append(TablePlace(place, start, end, tuple(entries)))
    return tuple(tables)


def _skip(pattern: re.Pattern[str], text: str, at: int) -> int:
    found = pattern.match(text, at)
    return at if found is None else found.end()


def _keys(written: str) -> tuple[str, ...]:
    """The parts of a key as it is written, dotted and quoted."""
    data, keys = tomllib.loads(f"{written} = 0"), []
    while isinstance(data, dict):
        ((key, data),) = data.items()
        keys.append(key)
    return tuple(keys)


def _resolved(keys: tuple[str, ...], is_array: bool, counts: dict[Place, int]) -> Place:
    """The place of a header: it speaks of the newest member of each array on the way."""
    place: Place = ()
    for number, key in enumerate(keys, start=1):
        place = (*place, key)
        if is_array and number == len(keys):
            counts[place] = counts.get(place, 0) + 1
        if place in counts:
            place = (*place, counts[place] - 1)
    return place


def _value_end(text: str, at: int) -> int:
    """Behind the value that begins here."""
    depth = 0
    while at < len(text):
        if text[at] in "\"'":
            at = _skip(_STRING, text, at)
        elif text[at] in "[{":
            depth, at = depth + 1, at + 1
        elif text[at] in "]}":
            depth, at = depth - 1, at + 1
        elif depth and text[at] in ", \t\r\n#=":
            at = _skip(_REST_OF_LINE, text, at) if text[at] == "#" else at + 1
        else:
            end = _skip(re.compile(r"[A-Za-z0-9_+:.-]+") if depth else _SCALAR, text, at)
            at += max(len(text[at:end].rstrip()), 1)
        if depth == 0:
            return at
    return at
