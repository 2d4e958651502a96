"""What changed between two builds: figures against shapes and numbers that are known."""

from __future__ import annotations

import json
import shutil

import numpy as np
import pytest
import trimesh

from heartcase.cli.main import main
from heartcase.library.diff import Tolerances, diff_libraries, surface_change, warning_changes
from heartcase.pipeline.building.run import build_case
from heartcase.schemas.errors import UsageError
from heartcase.schemas.recipe.recipe import load_recipe
from tests.ball import write_ball_recipe, write_ball_scan

pytestmark = pytest.mark.usefixtures("plain_reports")


@pytest.fixture(scope="module")
def builds(tmp_path_factory):
    """The ball built as it is, and with half of its triangles and a coarser grid."""
    folder = tmp_path_factory.mktemp("diff")
    write_ball_scan(folder / "scan.nii.gz")
    for name, cell_mm, triangles in (("old", 4.0, 2000), ("new", 5.0, 900)):
        recipe = write_ball_recipe(folder / "scan.nii.gz", folder / f"{name}.toml", cell_mm=cell_mm)
        recipe.write_text(recipe.read_text().replace("triangle_count = 2000", f"triangle_count = {triangles}"))
        build_case(load_recipe(recipe), directory=folder, out=folder / name, cache=folder / "cache")
    return folder


def sphere(radius_mm: float, shift_mm: float = 0.0) -> tuple[np.ndarray, np.ndarray]:
    mesh = trimesh.creation.icosphere(subdivisions=4, radius=radius_mm)
    return mesh.vertices + np.array([shift_mm, 0.0, 0.0]), mesh.faces.astype(np.int32)


def test_distances_of_spheres_are_those_between_them():
    """Facets of a sphere of 20 mm lie up to 0.02 mm inside it."""
    mean, most = surface_change(sphere(20.0), sphere(21.0))
    assert (mean, most) == (pytest.approx(1.0, abs=0.03), pytest.approx(1.0, abs=0.03))
    mean, most = surface_change(sphere(20.0), sphere(20.0, 2.0))
    assert most == pytest.approx(2.0, abs=0.03)
    assert mean == pytest.approx(1.0, abs=0.05)  # |2 cos| over a sphere is 1 on average
    assert surface_change(sphere(20.0), sphere(20.0)) == (pytest.approx(0.0, abs=1e-6), pytest.approx(0.0, abs=1e-6))


def test_a_build_is_the_same_as_itself(builds, capsys):
    assert [change.kind for change in diff_libraries(builds / "old", builds / "old")] == ["same"]
    assert main(["library", "diff", str(builds / "old"), str(builds / "old")]) == 0
    assert "1 the same to the byte" in capsys.readouterr().out


def test_what_changed_is_said_and_judged(builds, capsys):
    (change,) = diff_libraries(builds / "old", builds / "new")
    assert change.kind == "changed"
    assert {"grid", "surface"} <= set(change.stages)
    assert not {"filter", "segment", "walls"} & set(change.stages)
    assert change.node_count is not None
    assert change.node_count[0] > 1.5 * change.node_count[1]
    assert any("nodes instead of" in words for words in change.beyond)
    # 2,000 triangles instead of 900 on spheres of 14 and 20 mm: the surface moves by a few tenths.
    assert 0.01 < change.surface_mean_mm < change.surface_most_mm < 1.5
    lenient = Tolerances(surface_mm=5.0, volume_percent=100.0, node_percent=100.0)
    (change,) = diff_libraries(builds / "old", builds / "new", lenient)
    assert not [words for words in change.beyond if "warning" not in words]
    assert main(["library", "diff", str(builds / "old"), str(builds / "new"), "--json"]) == 1
    assert json.loads(capsys.readouterr().out)["beyond_count"] == 1


def test_a_warning_is_new_only_where_more_than_its_numbers_changed():
    old = ["0.1% of the wall at (-7.5, 3.0, 12.0) mm is thin", "a piece at (1.0, 2.0, 3.0) mm is loose", "gone"]
    new = ["0.2% of the wall at (-7.4, 3.0, 12.0) mm is thin", "a piece at (1.0, 2.0, 3.0) mm is loose"]
    assert warning_changes(old, new) == ((), (new[0],))
    # A second piece is new, though it differs from the first in numbers only.
    second = "a piece at (9.0, 8.0, -7.0) mm is loose"
    assert warning_changes(old, [*new, second]) == ((second,), (new[0],))
    # What is not a number counts: another structure is another warning.
    other = "0.2% of the roof at (-7.4, 3.0, 12.0) mm is thin"
    assert warning_changes(old, [other]) == ((other,), ())


def test_warnings_with_other_numbers_are_listed_and_allowed(builds, tmp_path, capsys):
    for folder, text in (("old", "0.1% is thin"), ("new", "0.2% is thin")):
        case = tmp_path / folder / "ball.case"
        shutil.copytree(builds / "old" / "ball.case", case)
        data = json.loads((case / "case.json").read_text())
        (case / "case.json").write_text(json.dumps(data | {"warnings": [text], "warning_grades": ["look"]}))
    assert main(["library", "diff", str(tmp_path / "old"), str(tmp_path / "new")]) == 0
    said = capsys.readouterr().out
    assert "ball: a warning has other numbers now: 0.2% is thin" in said
    assert "0 to be looked at" in said


def test_cases_that_are_gone_new_or_damaged_are_listed(builds, tmp_path):
    old, new = tmp_path / "old", tmp_path / "new"
    for folder, names in ((old, ("kept", "gone", "torn")), (new, ("kept", "more", "torn"))):
        for name in names:
            shutil.copytree(builds / "old" / "ball.case", folder / f"{name}.case")
    (new / "torn.case" / "case.json").write_text("{")
    changes = {change.name: change for change in diff_libraries(old, new)}
    kinds = {name: change.kind for name, change in changes.items()}
    assert kinds == {"gone": "removed", "kept": "same", "more": "added", "torn": "unreadable"}
    assert {name for name, change in changes.items() if change.beyond} == {"gone", "torn"}


def test_folders_without_cases_are_refused(tmp_path):
    with pytest.raises(UsageError, match="there is no such folder"):
        diff_libraries(tmp_path / "nothing", tmp_path)
    with pytest.raises(UsageError, match="no case"):
        diff_libraries(tmp_path, tmp_path)
    assert main(["library", "diff", str(tmp_path), str(tmp_path), "--surface-mm", "-1"]) == 2
