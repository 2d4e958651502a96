"""Writing TOML (https://toml.io/en/v1.0.0): what the standard library reads but does not write."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence
from typing import Any

__all__ = ["toml_string", "toml_text", "toml_value"]

_BARE_KEY = re.compile(r"[A-Za-z0-9_-]+")
_SHORT_ESCAPES = {"\\": "\\\\", '"': '\\"', "\n": "\\n", "\t": "\\t", "\r": "\\r", "\b": "\\b", "\f": "\\f"}
_WIDTH = 118


def toml_text(data: Mapping[str, Any]) -> str:
    """Text of a TOML document: read back, it gives the same data.

    Parameters
    ----------
    data
        Tables (mappings), arrays (lists or tuples), text, whole numbers, finite numbers, true and false. The order is
        kept, but the plain values of a table come before the tables in it.

    Raises
    ------
    ValueError
        A value has no place in TOML (None, say), or is not finite, which no format of heartcase allows.
    """
    return "\n".join(_table_lines(data, ())).lstrip("\n") + "\n"


def toml_string(text: str) -> str:
    """Text as a basic string of TOML, quotes included."""
    return '"' + "".join(_escaped(letter) for letter in text) + '"'


def _escaped(letter: str) -> str:
    if letter in _SHORT_ESCAPES:
        return _SHORT_ESCAPES[letter]
    return f"\\u{ord(letter):04x}" if letter < " " or letter == "\x7f" else letter


def _table_lines(table: Mapping[str, Any], path: tuple[str, ...]) -> list[str]:
    lines: list[str] = []
    later: list[str] = []
    for key, value in table.items():
        inner = (*path, key)
        title = ".".join(_key(part) for part in inner)
        if isinstance(value, Mapping) and value:
            later += ["", f"[{title}]", *_table_lines(value, inner)]
        elif _is_array_of_tables(value):
            for member in value:
                later += ["", f"[[{title}]]", *_table_lines(member, inner)]
        else:
            lines.append(_assignment(key, value))
    return lines + later


def _is_array_of_tables(value: Any) -> bool:
    return isinstance(value, list | tuple) and bool(value) and all(isinstance(member, Mapping) for member in value)


def _assignment(key: str, value: Any) -> str:
    line = f"{_key(key)} = {toml_value(value)}"
    if len(line) <= _WIDTH or not isinstance(value, list | tuple):
        return line
    return "\n".join([f"{_key(key)} = [", *(f"  {toml_value(member)}," for member in value), "]"])


def _key(key: str) -> str:
    return key if _BARE_KEY.fullmatch(key) else toml_string(key)


def toml_value(value: Any) -> str:
    """One value as it stands behind an equals sign."""
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, str):
        return toml_string(value)
    if isinstance(value, int):
        return str(int(value))
    if isinstance(value, float) and math.isfinite(value):
        return repr(float(value))
    if isinstance(value, Mapping):
        inner = ", ".join(f"{_key(key)} = {toml_value(member)}" for key, member in value.items())
        return f"{{ {inner} }}" if inner else "{}"
    if isinstance(value, Sequence):
        return "[" + ", ".join(toml_value(member) for member in value) + "]"
    raise ValueError(f"TOML has no place for {value!r}")
