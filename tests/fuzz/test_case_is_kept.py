"""Bad input over a good case: the case and its report stay as they were, to the byte."""

from __future__ import annotations

import hashlib
from pathlib import Path

import numpy as np
import pytest

from heartcase.pipeline.building.run import build_case
from heartcase.schemas.errors import HeartcaseError
from heartcase.schemas.recipe.recipe import load_recipe
from tests.ball import write_ball_recipe, write_ball_scan

pytestmark = pytest.mark.usefixtures("plain_reports")


def tree(folder: Path) -> dict[str, str]:
    return {
        path.relative_to(folder).as_posix(): hashlib.sha256(path.read_bytes()).hexdigest()
        for path in sorted(folder.rglob("*"))
        if path.is_file() and ".heartcase-cache" not in path.parts
    }


@pytest.fixture(scope="module")
def built(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A case of the ball, built."""
    root = tmp_path_factory.mktemp("built")
    write_ball_scan(root / "ball.nrrd")
    recipe = write_ball_recipe(root / "ball.nrrd", root / "ball.toml", cell_mm=5.0)
    build_case(load_recipe(recipe), directory=root, out=root / "out")
    return root


def test_a_bad_scan_leaves_the_case(built: Path) -> None:
    before, sound = tree(built / "out"), (built / "ball.nrrd").read_bytes()
    rng = np.random.default_rng(5)
    cuts = [sound[: int(n)] for n in rng.integers(0, len(sound), 12)]
    flipped = []
    for _ in range(12):
        damaged = bytearray(sound)
        damaged[len(sound) - int(rng.integers(1, 2000))] ^= 1 << int(rng.integers(0, 8))
        flipped.append(bytes(damaged))
    refused = 0
    for content in [*cuts, *flipped]:
        (built / "ball.nrrd").write_bytes(content)
        try:
            build_case(load_recipe(built / "ball.toml"), directory=built, out=built / "out", until="read")
        except HeartcaseError:
            refused += 1
        assert tree(built / "out") == before
    (built / "ball.nrrd").write_bytes(sound)
    assert refused == 24


@pytest.mark.parametrize(
    "more",
    [
        '[[markers]]\npath = "gone.nrrd"\n',
        '[[strokes]]\nlabel = "cavity"\npoints_mm = [[900, 0, 0]]\n',
        "[region]\ncenter_mm = [900, 0, 0]\nsize_mm = [10, 10, 10]\n",
        '[[edits]]\nkind = "septal_defect"\nposition_mm = [0, 0, 0]\ndiameter_mm = 4\naxis = [1, 0, 0]\n',
    ],
)
def test_a_bad_recipe_leaves_the_case(built: Path, more: str) -> None:
    before = tree(built / "out")
    wrong = write_ball_recipe(built / "ball.nrrd", built / "wrong.toml", cell_mm=5.0, more=more)
    with pytest.raises(HeartcaseError):
        build_case(load_recipe(wrong), directory=built, out=built / "out")
    assert tree(built / "out") == before
