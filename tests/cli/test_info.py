"""``heartcase info`` and what the commands print with."""

import json
from pathlib import Path

import numpy as np
import pytest
import SimpleITK
from pydantic import BaseModel

from heartcase.cli.main import main
from heartcase.cli.shared.output import echo_json, file_size, json_ready, print_facts, print_table
from tests.cli.small_case import SCAN_DIRECTION, write_case, write_scan

RECIPE = """
heartcase_recipe = 1
name = "Case 7"
[scan]
path = "scan.nrrd"
origin = "ask the ward"
[segment]
method = "threshold"
[[segment.ranges]]
label = "aorta"
lower = 100
[[edits]]
kind = "septal_defect"
position_mm = [5, -15, -10]
diameter_mm = 8
axis = [1, 0, 0]
"""


def run_json(capsys, *arguments: object) -> dict:
    assert main([str(a) for a in arguments]) == 0
    captured = capsys.readouterr()
    assert captured.err == ""
    return json.loads(captured.out)


def test_scan_is_described_by_what_simpleitk_says(tmp_path, capsys):
    path = write_scan(tmp_path / "scan.nrrd")
    facts = run_json(capsys, "info", path, "--json")
    image = SimpleITK.ReadImage(str(path))
    assert facts["kind"] == "scan"
    assert facts["size"] == list(image.GetSize())
    assert facts["spacing_mm"] == pytest.approx(image.GetSpacing())
    assert facts["origin_mm"] == pytest.approx(image.GetOrigin())
    assert np.ravel(facts["direction"]) == pytest.approx(image.GetDirection(), abs=1e-6)
    values = SimpleITK.GetArrayFromImage(image)
    assert facts["intensity"]["min"] == pytest.approx(values.min())
    assert facts["intensity"]["median"] == pytest.approx(np.median(values))
    assert facts["voxel_count"] == values.size
    # The fixture's axes run to the right, to the head and (mostly) to the back: a left-handed frame or not, by det.
    assert facts["axes_run_towards"] == ["right", "head", "back"]
    assert facts["is_right_handed"] == bool(np.linalg.det(SCAN_DIRECTION) > 0)
    assert facts["oblique_degrees"] == pytest.approx(10.0, abs=0.01)


def test_scan_is_described_in_words(tmp_path, capsys):
    assert main(["info", str(write_scan(tmp_path / "scan.nrrd"))]) == 0
    out = capsys.readouterr().out
    assert "12 x 10 x 8 voxels" in out
    assert "right, head, back" in out
    assert "by up to 10.0 degrees" in out
    assert "handed" in out


def test_case_is_described(tmp_path, capsys):
    path, heart = write_case(tmp_path)
    facts = run_json(capsys, "info", path, "--json")
    assert facts["kind"] == "case"
    assert facts["name"] == "Toy"
    assert "Not a medical device" in facts["notice"]
    assert facts["simulation"]["node_count"] == len(heart.grid.nodes)
    assert facts["simulation"]["cell_count"] == len(heart.grid.cells)
    by_name = {label["name"]: label for label in facts["labels"]}
    assert by_name["morphologically left ventricle"]["volume_ml"] == 33.0
    assert by_name["aorta"]["volume_ml"] is None
    on_disk = {file.name: file.stat().st_size for file in path.iterdir() if file.name != "case.json"}
    assert {file["name"]: file["bytes"] for file in facts["files"]} == on_disk
    assert facts["total_bytes"] == sum(on_disk.values())

    assert main(["info", str(path)]) == 0
    out = capsys.readouterr().out
    assert "Not a medical device" in out
    assert f"{len(heart.grid.nodes):,} nodes" in out
    assert "33.0" in out
    assert "Look at this (1 warning)\n  - A warning for the reader.\n" in out


def test_the_two_limits_of_the_step_are_told_apart(capsys):
    """What holds for every lattice of such cells, which a case states, and the higher one of its own lattice."""
    case = Path(__file__).parents[1] / "golden" / "lopsided.case"
    assert main(["info", str(case)]) == 0
    (line,) = (line for line in capsys.readouterr().out.splitlines() if line.startswith("Largest step"))
    assert line.rstrip().endswith("ms (stable at rest for any lattice of such cells)")
    assert main(["simulate", str(case), "--seconds", "0.002"]) == 0
    (own,) = (line for line in capsys.readouterr().out.splitlines() if line.startswith("Step "))
    assert " ms (this lattice at rest is stable up to " in own
    assert float(line.split()[2]) <= float(own.partition("up to ")[2].split()[0])


def test_recipe_is_described_with_and_without_its_scan(tmp_path, capsys):
    recipe = tmp_path / "recipe.toml"
    recipe.write_text(RECIPE)
    facts = run_json(capsys, "info", recipe, "--json")
    assert facts["kind"] == "recipe"
    assert facts["name"] == "Case 7"
    assert facts["method"] == "threshold"
    assert facts["edits"] == ["septal_defect"]
    assert facts["scan_is_there"] is False
    assert facts["scan"] is None
    assert main(["info", str(recipe)]) == 0
    assert "ask the ward" in capsys.readouterr().out

    write_scan(tmp_path / "scan.nrrd")
    assert run_json(capsys, "info", recipe, "--json")["scan"]["size"] == [12, 10, 8]
    assert main(["info", str(recipe)]) == 0
    assert "12 x 10 x 8 voxels" in capsys.readouterr().out


@pytest.mark.parametrize("name", ["nothing.nrrd", "empty.case", "broken.toml", "broken.nrrd"])
def test_problems_are_one_clear_line(tmp_path, capsys, name):
    path = tmp_path / name
    if name.startswith("broken"):
        path.write_text("= not what it says")
    elif name == "empty.case":
        path.mkdir()
    assert main(["info", str(path)]) > 0
    captured = capsys.readouterr()
    assert captured.out == ""
    lines = captured.err.strip().splitlines()
    assert len(lines) == 1
    assert lines[0].startswith("heartcase: ")


class _Point(BaseModel):
    x: float


def test_json_is_plain_and_strict(capsys):
    data = {
        "array": np.array([[1, 2]], np.uint8),
        "number": np.float32(0.5),
        "none": float("nan"),
        "model": _Point(x=1.0),
        "set": {3, 1},
        5: ("a", Path("x").name),
    }
    expected = {"array": [[1, 2]], "number": 0.5, "none": None, "model": {"x": 1.0}, "set": [1, 3], "5": ["a", "x"]}
    assert json_ready(data) == expected
    echo_json(data)
    assert json.loads(capsys.readouterr().out) == expected


def test_tables_print_everything_as_it_is(capsys):
    print_facts([("Name", "[bold]x[/bold]"), ("Long", "y" * 150)], title="Title")
    print_table(("label", "ml"), [("left ventricle", 33.5)], right=("ml",))
    out = capsys.readouterr().out
    assert "[bold]x[/bold]" in out
    assert "y" * 150 in out
    assert out.startswith("Title")
    assert "left ventricle" in out
    assert "33.5" in out


@pytest.mark.parametrize(
    ("size", "words"), [(812, "812 B"), (3_400_000, "3.4 MB"), (1500, "1.5 kB"), (2e12, "2000.0 GB")]
)
def test_file_sizes_in_words(size, words):
    assert file_size(int(size)) == words
