"""The sentences of warnings, by kind: one source for what is said, and for what a page takes out of it.

A sentence is a template. ``{name}`` stands for a value in words, ``{name#}`` for a number; what stands in ``[...]`` is said
where its values are there, and of ``<one|several>`` the first where the value ``count`` is 1. A case holds sentences
alone, also one of an older heartcase, so kind and values are found again by the template: :func:`recognised`.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from functools import cache
from typing import NamedTuple

__all__ = ["SENTENCES", "Recognised", "recognised", "sentence", "value_names"]

_OPENING = (
    "{one} and {other} are open to each other over {area#} mm²[ in {patches#} patches, the largest] near {place} mm"
)
SENTENCES: Mapping[str, str] = {
    "grown-septum": (
        "walls were grown where two outlines touch, not seen, because a heart does not join these: {listed}. If the "
        "patient has an opening there, say so: an edit of kind septal_defect, a landmark (ring or point) whose name "
        "says defect, VSD or ASD, or strokes of the two that run into each other through it; if the two are one, name "
        "them in walls.connected"
    ),
    "grown-septum-confirmed": (
        "the wall that was grown between {one} and {other} over {area#} mm² near {place} mm is wall, as the recipe says "
        "(walls.contact)"
    ),
    "opening-unexpected": (
        f"{_OPENING}: paint the wall between them (a stroke of background, or of the muscle), or the third cavity whose "
        "blood they were given, if one lies there; or name the two in [[walls.septum]], so that one is grown; or, if "
        "the patient has this opening, say so: an edit of kind septal_defect, or a landmark (point or ring) there "
        "whose name says defect, VSD or ASD"
    ),
}
"""Kind of warning -> its sentence, as :class:`heartcase.pipeline.warnings.CaseWarning` has it."""

_TOKEN = re.compile(r"\{(\w+)(#?)\}|<([^<>|]*)\|([^<>|]*)>|\[\[|\]\]|\[|\]")
_NUMBER = r"-?[\d.,]+(?:e[+-]?\d+)?"


class Recognised(NamedTuple):
    """What a sentence says."""

    kind: str
    """Kind of the warning, a key of :data:`SENTENCES`; empty for a sentence that is none of them."""
    values: dict[str, str]
    """Its values, as they stand in the sentence."""


def sentence(kind: str, **values: object) -> str:
    """The sentence of a warning.

    Parameters
    ----------
    kind
        A key of :data:`SENTENCES`.
    values
        Its values, as they are to be read; None leaves out what stands around an optional one.

    Raises
    ------
    KeyError
        There is no such kind, or a value is missing.
    """
    said = {name: str(value) for name, value in values.items() if value is not None}
    parts, _ = _said(list(_tokens(SENTENCES[kind])), 0, said)
    return parts


def recognised(text: str) -> Recognised:
    """Kind and values of a sentence that :func:`sentence` made."""
    for kind, pattern in _patterns().items():
        found = pattern.fullmatch(text)
        if found is not None:
            return Recognised(kind, {name: value for name, value in found.groupdict().items() if value is not None})
    return Recognised("", {})


def value_names(template: str) -> frozenset[str]:
    """Names of the values of a template."""
    return frozenset(found[1] for found in _TOKEN.finditer(template) if found[1])


def _tokens(template: str) -> list[str | re.Match[str]]:
    """Plain text, and what stands for something."""
    found: list[str | re.Match[str]] = []
    at = 0
    for token in _TOKEN.finditer(template):
        found += [template[at : token.start()], token]
        at = token.end()
    return [*found, template[at:]]


def _said(tokens: list[str | re.Match[str]], at: int, values: Mapping[str, str]) -> tuple[str, int]:
    """What the tokens say from one on, up to the end of their optional part, and where that is."""
    said = ""
    while at < len(tokens):
        token = tokens[at]
        at += 1
        if isinstance(token, str):
            said += token
        elif token[0] in ("[[", "]]"):
            said += token[0]
        elif token[0] == "[":
            try:
                inner, at = _said(tokens, at, values)
                said += inner
            except KeyError:
                at = next(n for n in range(at, len(tokens)) if _is_end(tokens[n])) + 1
        elif token[0] == "]":
            return said, at
        elif token[1]:
            said += values[token[1]]
        else:
            said += token[3] if values["count"] == "1" else token[4]
    return said, at


def _is_end(token: str | re.Match[str]) -> bool:
    return not isinstance(token, str) and token[0] == "]"


@cache
def _patterns() -> dict[str, re.Pattern[str]]:
    return {kind: re.compile(_pattern(template), re.DOTALL) for kind, template in SENTENCES.items()}


def _pattern(template: str) -> str:
    pattern, seen = "", set()
    for token in _tokens(template):
        if isinstance(token, str):
            pattern += re.escape(token)
        elif token[0] in ("[[", "]]"):
            pattern += re.escape(token[0])
        elif token[0] in "[]":
            pattern += "(?:" if token[0] == "[" else ")?"
        elif token[1] and token[1] in seen:
            pattern += f"(?P={token[1]})"
        elif token[1]:
            seen.add(token[1])
            pattern += f"(?P<{token[1]}>{_NUMBER if token[2] else '.+?'})"
        else:
            pattern += f"(?:{re.escape(token[3])}|{re.escape(token[4])})"
    return pattern
