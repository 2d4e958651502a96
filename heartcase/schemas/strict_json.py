"""JSON as every reader of a case takes it: UTF-8, finite numbers, no key twice, of bounded depth (RFC 8259)."""

from __future__ import annotations

import json
import math
import re
from typing import Any

__all__ = ["DEPTH_MAX", "parse_json"]

DEPTH_MAX = 64
"""Objects and lists within each other; deeper ones overflow the stack of some reader."""

_CONTAINERS = frozenset({dict, list})


def _outline() -> bytes:
    """Each byte to what it may be of a number: 0 a digit, e an exponent, a space behind it, x none of it."""
    table = bytearray(b"x" * 256)
    for these, as_one in ((b"0123456789", b"0"), (b"eE", b"e"), (b",]} \t\r\n", b" ")):
        for byte in these:
            table[byte] = as_one[0]
    return bytes(table)


_OUTLINE = _outline()
_LARGE_EXPONENT, _LARGE_RUN = re.compile(b"e000+ "), b"0" * 300
"""Numbers beyond float64 look so in outline. Where there are none, numbers need not be looked at one by one."""


def parse_json(content: bytes) -> Any:
    """Parse JSON text, refusing what readers in other languages refuse or would read otherwise.

    Raises
    ------
    ValueError
        It is not UTF-8, not JSON, holds NaN, a number beyond float64 or half a character, a key twice in one object,
        or is nested deeper than :data:`DEPTH_MAX`.
    """
    text = content.decode("utf-8")
    outline = content.translate(_OUTLINE, b"+") + b" "
    is_large = _LARGE_RUN in outline or _LARGE_EXPONENT.search(outline)
    numbers: dict[str, Any] = {"parse_float": _finite, "parse_int": _whole} if is_large else {}
    try:
        data = json.loads(text, object_pairs_hook=_without_repeats, parse_constant=_refuse_constant, **numbers)
    except RecursionError:
        raise ValueError("nested too deep") from None
    level: list[Any] = [data] if data.__class__ in _CONTAINERS else []
    for _ in range(DEPTH_MAX):
        inside = [outer.values() if outer.__class__ is dict else outer for outer in level]
        level = [inner for values in inside for inner in values if inner.__class__ in _CONTAINERS]
        if not level:
            break
    else:
        raise ValueError("nested too deep")
    if "\\ud" in text or "\\uD" in text:
        json.dumps(data, ensure_ascii=False).encode("utf-8")
    return data


def _without_repeats(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    """A JSON object whose keys differ: readers would disagree on which of two equal keys counts."""
    found = dict(pairs)
    if len(found) != len(pairs):
        raise ValueError("a key stands twice")
    return found


def _refuse_constant(name: str) -> None:
    raise ValueError(f"{name} is no JSON")


def _finite(text: str) -> float:
    value = float(text)
    if not math.isfinite(value):
        raise ValueError("a number is out of range")
    return value


def _whole(text: str) -> int:
    _finite(text)
    return int(text)
