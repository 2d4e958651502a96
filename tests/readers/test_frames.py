"""The readers' ways to other programs' axes: those of the format, and a mirrored heart is told."""

from __future__ import annotations

import json
import subprocess

import numpy as np
import pytest

from heartcase.schemas.bundle.coordinates import Coordinates
from tests.readers.test_readers import LANGUAGES, READERS, ROOT, _compile, _program

MARKS = np.array([[1, 2, 3], [3, 2, 3], [1, 5, 3], [1, 2, 7]], float)
"""They span 2 x 3 x 4 / 6 = 4 mm3."""

SCRIPT = f"""
import {{ checkChirality, FRAMES, fromLps, reversedWinding }} from
  {json.dumps((READERS / "javascript" / "heartcase-reader.mjs").as_uri())};
const judge = (points, frame) => {{
  try {{
    checkChirality(4, points, frame);
    return "ok";
  }} catch (error) {{
    return error.message;
  }}
}};
for (const [name, frame] of Object.entries(FRAMES)) {{
  const here = {MARKS.tolist()}.map((p) => fromLps(frame, p));
  console.log(name, frame.reverseTriangles ? 1 : 0, here.flat().join(" "));
  console.log(judge(here, frame));
  console.log(judge(here.map(([x, y, z]) => [-x, y, z]), frame));
  console.log(judge(here.map((p) => p.map((x) => 2 * x)), frame));
  console.log(judge(here.map(([x, y]) => [x, y, 0]), frame));
}}
console.log(reversedWinding(Int32Array.of(0, 1, 2, 7, 8, 9)).join(" "));
"""


@pytest.fixture(scope="module", params=LANGUAGES)
def said(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> list[str]:
    """What the program of each language prints."""
    if request.param == "cpp":
        command = [str(tmp_path_factory.mktemp("frames") / "frames")]
        _compile(ROOT / "tests" / "readers" / "frames.cpp", ROOT / command[0])
    else:
        command = [_program("node"), "--input-type=module", "--eval", SCRIPT]
    done = subprocess.run(command, check=True, capture_output=True, text=True, timeout=60)
    return done.stdout.splitlines()


def test_points_go_where_the_format_says(said):
    frames = {frame.name: frame for frame in Coordinates().frames}
    rows = [line.split() for line in said[:20:5]]
    assert [row[0] for row in rows] == ["lps", *frames]
    for name, turned, *numbers in rows[1:]:
        expected = MARKS @ np.array(frames[name].from_lps_mm).T
        np.testing.assert_allclose(np.array(numbers, float).reshape(4, 3), expected, rtol=1e-15, err_msg=name)
        assert bool(int(turned)) == frames[name].reverse_triangles


@pytest.mark.parametrize("number", range(4))
def test_a_mirrored_load_is_told(said, number):
    here, mirrored, doubled, flat = said[5 * number + 1 : 5 * number + 5]
    assert here == "ok"
    assert "mirrored" in mirrored
    assert "wrong volume" in doubled
    assert "wrong volume" in flat


def test_triangles_are_turned(said):
    assert said[20].split() == ["0", "2", "1", "7", "9", "8"]
