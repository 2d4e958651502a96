"""``heartcase preview``: pictures of scans, recipes and cases."""

import json

import numpy as np
import pytest
from PIL import Image

from heartcase.cli.main import main
from tests.cli.small_case import write_case, write_scan


def pixels(path) -> np.ndarray:
    return np.asarray(Image.open(path).convert("RGB")).astype(int)


def test_scan_becomes_three_stacks_of_slices(tmp_path, capsys):
    scan, out = write_scan(tmp_path / "scan.nrrd"), tmp_path / "out.png"
    assert main(["preview", str(scan), "-o", str(out), "--json"]) == 0
    facts = json.loads(capsys.readouterr().out)
    whole = pixels(out)
    assert facts["views"] == ["axial", "coronal", "sagittal"]
    assert (facts["height"], facts["width"]) == whole.shape[:2]
    assert facts["bytes"] == out.stat().st_size
    heights = []
    for stack in facts["views"]:
        assert main(["preview", str(scan), "-o", str(out), "--view", stack]) == 0
        heights.append(pixels(out).shape[0])
    assert sum(heights) == whole.shape[0]


def test_recipe_shows_its_scan(tmp_path):
    write_scan(tmp_path / "scan.nrrd")
    recipe, one, other = tmp_path / "r.toml", tmp_path / "one.png", tmp_path / "other.png"
    recipe.write_text(
        'heartcase_recipe = 1\nname = "x"\n[scan]\npath = "scan.nrrd"\n'
        '[segment]\nmethod = "threshold"\n[[segment.ranges]]\nlabel = "aorta"\nlower = 5\n'
    )
    assert main(["preview", str(recipe), "-o", str(one)]) == 0
    assert main(["preview", str(tmp_path / "scan.nrrd"), "-o", str(other)]) == 0
    assert one.read_bytes() == other.read_bytes()


def test_case_becomes_four_sides_and_the_cut(tmp_path, capsys):
    case, _ = write_case(tmp_path)
    out = tmp_path / "case.png"
    assert main(["preview", str(case), "-o", str(out), "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["views"] == [
        "anterior",
        "posterior",
        "left",
        "right",
        "cutaway",
        "front cut",
    ]
    sheet = pixels(out)
    # The pale colour of cut myocardium appears in the two cuts only: the last row.
    pale = np.round(np.array([0xC1, 0xA2, 0x9A]) * 0.72 + 255 * 0.28)
    rows, columns = np.nonzero(np.abs(sheet - pale).max(axis=2) <= 2)
    assert np.percentile(rows, 2) > 0.5 * sheet.shape[0]
    for half in (columns < sheet.shape[1] / 2, columns > sheet.shape[1] / 2):
        assert half.sum() > 5000

    assert main(["preview", str(case), "-o", str(out), "--view", "anterior"]) == 0
    side = pixels(out)
    assert side.shape[1] < 0.6 * sheet.shape[1]
    # The left ventricle lies on the patient's left, which is on the right of the picture: reddish there.
    wall = np.argwhere((side[..., 0] - side[..., 2] > 40) & (side[..., 1] < 140))
    blue = np.argwhere(side[..., 2] - side[..., 0] > 60)
    assert np.median(wall[:, 1]) > np.median(blue[:, 1]) + 40


def test_a_coarser_level_is_shown_where_there_is_one(tmp_path, capsys):
    case, _ = write_case(tmp_path, with_level=True)
    one, other = tmp_path / "one.png", tmp_path / "other.png"
    assert main(["preview", str(case), "-o", str(one), "--view", "anterior"]) == 0
    assert main(["preview", str(case), "-o", str(other), "--view", "anterior", "--level", "1"]) == 0
    # the same heart, drawn with a tenth of the triangles
    apart = np.abs(pixels(one) - pixels(other)).max(axis=2) > 8
    assert 0 < apart.sum() < 0.2 * apart.size
    capsys.readouterr()
    assert main(["preview", str(case), "-o", str(other), "--level", "2"]) > 0
    assert "no level of detail 2; it has 0, 1" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["missing.nrrd", "-o", "o.png"], "nothing at this path"),
        (["scan.nrrd", "-o", "o.jpg"], "must end in .png"),
        (["scan.nrrd", "-o", "o.png", "--view", "left"], "no view of a scan"),
        (["scan.nrrd", "-o", "no_such_folder/o.png"], "cannot be written"),
        (["r.toml", "-o", "o.png"], "scan is not there"),
        (["scan.nrrd", "-o", "o.png", "--level", "1"], "a scan has no levels of detail"),
    ],
)
def test_problems_are_one_clear_line(tmp_path, capsys, monkeypatch, arguments, words):
    monkeypatch.chdir(tmp_path)
    write_scan(tmp_path / "scan.nrrd")
    (tmp_path / "r.toml").write_text(
        'heartcase_recipe = 1\nname = "x"\n[scan]\npath = "gone.nrrd"\n'
        '[segment]\nmethod = "threshold"\n[[segment.ranges]]\nlabel = "aorta"\nlower = 5\n'
    )
    assert main(["preview", *arguments]) > 0
    captured = capsys.readouterr()
    assert captured.out == ""
    assert len(captured.err.strip().splitlines()) == 1
    assert words in captured.err
    assert not (tmp_path / "o.png").exists()
    assert not (tmp_path / "o.jpg").exists()
