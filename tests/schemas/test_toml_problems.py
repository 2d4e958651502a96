"""A text that is not TOML: the line, and what to do."""

from __future__ import annotations

import tomllib

import pytest

from heartcase.schemas.toml_problems import toml_problem


def problem_of(text):
    with pytest.raises(tomllib.TOMLDecodeError) as raised:
        tomllib.loads(text)
    return toml_problem(text, raised.value)


@pytest.mark.parametrize(
    ("text", "line", "hint"),
    [
        ('name = "x"\n[scan\npath = 3\n', 2, "end the heading with ]"),
        ('name = "x"\n[[strokes]\nlabel = 3\n', 2, "end the heading with ]]"),
        ("[scan]\n[walls]\n[scan]\n", 3, "this heading stands twice"),
        ('name = "x"\nname = "y"\n', 2, "stands twice in its section"),
        ("name = x\n", 1, 'text needs "quotation marks"'),
        ('name = "x\n', 1, 'a " is missing in this line'),
        ('path = "C:\\scans\\a"\n', 1, "write paths with / instead of"),
        ("size = 1,5\n", 1, "decimals are written with a point"),
        ("size 1\n", 1, "write key = value"),
        ("size = [1, 2\n", None, "has no ] at its end"),
        ("a = 1 b = 2\n", 1, "one setting a line"),
        ("= 4\n", 1, "correct that line"),
    ],
)
def test_the_line_and_what_to_do(text, line, hint):
    told = problem_of(text)
    assert told.startswith("this is not valid TOML: ")
    assert hint in told.split("; ", 1)[1]
    assert line is None or f"line {line}" in told
