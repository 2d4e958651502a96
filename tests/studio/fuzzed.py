"""What a page might say: requests as they should be, damaged ones, and what is no request at all."""

from __future__ import annotations

import json

HOSTILE = (
    None,
    True,
    -1,
    0,
    1 << 53,
    (1 << 53) + 1,
    10**400,
    1e308,
    -1e308,
    5e-324,
    0.5,
    "",
    "aorta",
    "\x00",
    "\ud800",
    "../../etc/passwd",
    "</script><script>alert(1)</script>",
    "x" * 50_000,
    [],
    {},
    [[]],
    [[0, 0]],
    [[0, 0, 0, 0]],
    [["0", "0", "0"]],
    [[None] * 3],
    [[1e308] * 3],
    [[0, 0, 0]] * 10_001,
    {"__proto__": 1},
)
RAW = (
    "",
    " ",
    "null",
    "[]",
    "0",
    '"undo"',
    "{",
    '{"id": 1',
    "\ufeff{}",
    "\x00",
    '{"id": 1, "do": "undo", "do": "redo"}',
    '{"id": 1, "do": "paint", "label": "aorta", "points_mm": [[NaN, 0, 0]]}',
    '{"id": 1, "do": "paint", "label": "aorta", "points_mm": [[Infinity, 0, 0]]}',
    '{"id": 1, "do": "paint", "label": "aorta", "points_mm": [[1e400, 0, 0]]}',
    '{"id": 1e400, "do": "undo"}',
    '{"id": "\\ud800", "do": "undo"}',
    '{"id": 1, "do": "paint", "label": "\\ud800", "points_mm": [[0, 0, 0]]}',
    '{"id": 1, "do": "\\ud800"}',
    '{"id": 1, "\\ud800": "undo"}',
    '{"id": ' + "9" * 5000 + ', "do": "undo"}',
    "[" * 100_000,
    '{"a":' * 100_000,
    '{"id": 1, "do": ' + "[" * 60 + "]" * 60 + "}",
)


def request(drawn, middle):
    """A request as a page makes it, about the middle of a scan, LPS mm; ``drawn`` is a Random."""
    far = drawn.choice((3.0, 6.0, 6.0, 30.0))
    points = [[m + drawn.uniform(-far, far) for m in middle] for _ in range(drawn.choice((1, 1, 2, 5)))]
    radius = drawn.choice((0.3, 1, 2.0, 3.5))
    label = drawn.choice(("aorta", "background", "left ventricle", "spleen"))
    return drawn.choice(
        [
            {"do": "paint", "label": label, "radius_mm": radius, "points_mm": points},
            {"do": "paint", "label": label, "radius_mm": radius, "points_mm": points},
            {"do": "paint", "erase": True, "radius_mm": radius, "points_mm": points},
            {"do": "extend", "points_mm": points},
            {"do": "extend", "points_mm": points},
            {"do": "end"},
            {"do": "undo"},
            {"do": "redo"},
            {"do": "suggest", "count": 2},
            {"do": "planes"},
            {
                "do": "look",
                "planes": [{"point_mm": points[0], "normal": drawn.choice(([0, 0, 1], [0.6, 0, 0.8], [0, 0, 0]))}],
            },
            {"do": "rest"},
            {"do": "picture", "position_mm": points[0]},
            {"do": "confirm", "position_mm": points[0], "label": label, "rival": "background"},
            {"do": "add_label", "entry": {"name": label, "role": drawn.choice(("blood", "device"))}},
            {"do": "remove_label", "label": label},
            {"do": "lock", "label": label, "locked": drawn.choice((True, False))},
        ]
    )


def damaged(drawn, asked):
    """The same request with something wrong: a value, a field too many or too few, a bit of its text."""
    # a number that no right request has: its answer is told from theirs
    asked = {"id": drawn.randrange(10**6, 10**7)} | asked
    how = drawn.randrange(6)
    field = drawn.choice(sorted(asked))
    if how == 0:
        asked[field] = drawn.choice(HOSTILE)
    elif how == 1:
        del asked[field]
    elif how == 2:
        asked[drawn.choice(("id", "do", "label", "points_mm", "radius_mm", "path", "__class__"))] = drawn.choice(
            HOSTILE
        )
    if how == 3:
        return drawn.choice(RAW)
    text = json.dumps(asked)
    at = drawn.randrange(len(text))
    if how == 4:
        return text[:at]
    if how == 5:
        return (
            text[:at]
            + drawn.choice(('"', "{", "]", "\\", "\x00", "NaN", "\u202e", ","))
            + text[at + drawn.randrange(2) :]
        )
    return text
