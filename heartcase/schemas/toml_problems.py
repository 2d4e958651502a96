"""What to do about a text that is not TOML."""

from __future__ import annotations

import re
import tomllib

__all__ = ["toml_problem"]

_OF_HEADINGS = (
    (r"end of (an array of tables|an array table|an array) declaration", "end the heading with ]]"),
    (r"end of a table declaration", "end the heading with ]"),
    (r"Cannot declare .* twice", "this heading stands twice: keep one, or write [[it]] where there may be several"),
    (r"Cannot (overwrite|redefine|mutate)|already (defined|exists)", "this stands twice in its section: keep one"),
)
_OF_SETTINGS = (
    (r"[Uu]nclosed array", "a list that was begun with [ has no ] at its end"),
    (r"[Uu]nclosed inline table|inline table", "what was begun with { has no } at its end, or a comma is missing"),
    (r"Expected '='", "write key = value"),
    (r"Expected newline or end of document", 'one setting a line; text needs "quotation marks"'),
    (r"Unterminated string", 'text that was begun with " has no " at its end'),
)
"""Words of the parser and what they ask for; those of headings and of what stands twice say more than the line."""


def toml_problem(text: str, error: tomllib.TOMLDecodeError) -> str:
    """What is wrong with a text and where, in the parser's words, and what to do.

    Parameters
    ----------
    text
        All that was read.
    error
        What the parser raised.
    """
    return f"this is not valid TOML: {error}; {_hint(text, str(error))}"


def _hint(text: str, words: str) -> str:
    """What was probably meant: by the line that the parser stumbled over, and by its words."""
    found = re.search(r"line (\d+)", words)
    lines = text.splitlines()
    line = lines[int(found.group(1)) - 1] if found and int(found.group(1)) <= len(lines) else ""
    if "\\" in line:
        return "write paths with / instead of \\, or in 'single quotes'"
    if line.count('"') % 2:
        return 'a " is missing in this line'
    for pattern, hint in _OF_HEADINGS:
        if re.search(pattern, words):
            return hint
    if re.match(r"\s*\w+\s*=\s*[A-Za-z]", line) and not re.match(r"\s*\w+\s*=\s*(true|false|nan|inf)\b", line):
        return 'text needs "quotation marks"'
    if re.search(r"\d,\d", line):
        return "decimals are written with a point: 1.5"
    for pattern, hint in _OF_SETTINGS:
        if re.search(pattern, words):
            return hint
    return "correct that line: settings are written as key = value, headings as [heading]"
