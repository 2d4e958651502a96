"""Recipes that make their own scan, and the part of them that a program draws."""

import json
from pathlib import Path

import numpy as np
import pytest

from heartcase.cli.main import main
from heartcase.library import draw, scans
from heartcase.library.draw import DRAWN_BELOW, draw_recipe
from heartcase.library.plan import is_up_to_date, plan_library
from heartcase.library.progress import MAKING_THE_SCAN
from heartcase.library.scans import ensure_scan, scan_is_made
from heartcase.library.worker import build_one
from heartcase.phantom.scan.acquisition import SyntheticScan
from heartcase.pipeline.formats.read_scan import read_scan
from heartcase.schemas.bundle.reader import open_bundle
from heartcase.schemas.errors import RecipeError, UsageError
from heartcase.schemas.geometry import Geometry
from heartcase.schemas.recipe.heart_form import HeartForm
from heartcase.schemas.recipe.phantom_scan import PhantomScan
from heartcase.schemas.recipe.recipe import ScanSource, load_recipe
from tests.ball import write_ball_recipe, write_ball_scan

SAMPLES = Path(__file__).parents[2] / "sample_cases"
RECIPES = [path for path in sorted(SAMPLES.glob("*.toml")) if "heartcase_recipe" in path.read_text()]
DRAWN = '[[strokes]]\nlabel = "aorta"\nradius_mm = 2.0\npoints_mm = [[0.0, 0.0, 0.0]]\n'
HEAD = """# a heart
heartcase_recipe = 1
name = "made"
[scan]
path = "scans/made.nii.gz"
modality = "MR"
[scan.phantom]
seed = 5
"""


@pytest.fixture
def made(monkeypatch):
    """Scans are made at once, and counted."""
    calls = []

    def quick(settings):
        calls.append(settings)
        values = np.full((3, 4, 5), settings.seed, np.float32)
        return SyntheticScan(values, Geometry.of(shape=values.shape, spacing_mm=(1.0, 1.0, 1.0)), "MR", 10.0, 1.0)

    monkeypatch.setattr("heartcase.phantom.scan.made_scan.made_scan", quick)
    return calls


def test_a_scan_is_made_once_and_again_when_its_settings_change(tmp_path, made):
    source = ScanSource(path="a/b.nii.gz", phantom=PhantomScan(seed=3))
    assert not scan_is_made(source, tmp_path)
    assert ensure_scan(source, tmp_path)
    assert scan_is_made(source, tmp_path)
    assert not ensure_scan(source, tmp_path)
    assert len(made) == 1
    other = source.model_copy(update={"phantom": PhantomScan(seed=4)})
    assert ensure_scan(other, tmp_path)
    assert not ensure_scan(other, tmp_path)
    assert len(made) == 2


def test_a_half_written_scan_is_made_again(tmp_path, made, monkeypatch):
    source = ScanSource(path="b.nii.gz", phantom=PhantomScan())

    def full(*_):
        raise OSError(28, "No space left on device")

    with monkeypatch.context() as patch:
        patch.setattr(scans, "write_scan", full)
        with pytest.raises(UsageError, match="cannot be written: no space left"):
            ensure_scan(source, tmp_path)
    assert not scan_is_made(source, tmp_path)
    assert ensure_scan(source, tmp_path)
    assert scan_is_made(source, tmp_path)


@pytest.mark.parametrize("was_made", [False, True])
def test_a_file_of_somebody_else_stays(tmp_path, made, was_made):
    source = ScanSource(path="b.nii.gz", phantom=PhantomScan())
    if was_made:  # and was replaced by hand since
        ensure_scan(source, tmp_path)
        made.clear()
    (tmp_path / "b.nii.gz").write_bytes(b"a scan")
    with pytest.raises(UsageError, match=r"was not made for this recipe.*b\.nii\.gz"):
        ensure_scan(source, tmp_path)
    assert (tmp_path / "b.nii.gz").read_bytes() == b"a scan"
    assert not made


@pytest.mark.parametrize("at", ["write_scan", "note_scan"])
def test_killed_at_any_moment_it_is_made_again(tmp_path, made, monkeypatch, at):
    source = ScanSource(path="b.nii.gz", phantom=PhantomScan(seed=1))
    ensure_scan(source, tmp_path)
    other = source.model_copy(update={"phantom": PhantomScan(seed=2)})
    whole = getattr(scans, at)
    for is_before in (True, False):

        def killed(*args, _is_before=is_before, **more):
            if not _is_before:
                whole(*args, **more)
            raise KeyboardInterrupt

        with monkeypatch.context() as patch:
            patch.setattr(scans, at, killed)
            with pytest.raises(KeyboardInterrupt):
                ensure_scan(other, tmp_path)
        assert not scan_is_made(other, tmp_path)
    assert ensure_scan(other, tmp_path)
    assert scan_is_made(other, tmp_path)
    assert sorted(path.name for path in tmp_path.iterdir()) == ["b.nii.gz", "b.nii.gz.made.json"]


def test_a_scan_that_is_not_made_is_left_alone(tmp_path):
    source = ScanSource(path="b.nii.gz")
    assert scan_is_made(source, tmp_path)
    assert not ensure_scan(source, tmp_path)


def test_a_newer_phantom_makes_the_scan_again_and_the_case_stale(tmp_path, made, monkeypatch):
    source = ScanSource(path="b.nii.gz", phantom=PhantomScan())
    ensure_scan(source, tmp_path)
    (tmp_path / "r.toml").write_text(HEAD + DRAWN)
    (before,) = plan_library(tmp_path)
    assert not before.problems
    monkeypatch.setattr(scans, "PHANTOM_VERSION", 99)
    monkeypatch.setattr("heartcase.library.plan.PHANTOM_VERSION", 99)
    assert not scan_is_made(source, tmp_path)
    (after,) = plan_library(tmp_path)
    assert before.stamp != after.stamp
    assert not is_up_to_date(after, tmp_path)


@pytest.mark.parametrize(("settings", "place"), [
    ({"modality": "CT", "ghost": 0.1}, "ghost"),
    ({"modality": "MR", "is_specimen": True}, "is_specimen"),
    ({"modality": "CT", "slice_thickness_mm": 3.0}, "slice_thickness_mm"),
])  # fmt: skip
def test_settings_of_the_other_scanner_are_refused(settings, place):
    with pytest.raises(ValueError, match=place):
        PhantomScan.model_validate(settings)


def test_only_what_stands_below_the_line_is_drawn(tmp_path, monkeypatch):
    monkeypatch.setattr(draw, "drawn_part", lambda scan: DRAWN.replace("2.0", f"{scan.seed}.0"))
    path = tmp_path / "r.toml"
    path.write_text(HEAD)
    assert draw_recipe(path, write=False)
    assert path.read_text() == HEAD
    assert draw_recipe(path)
    assert path.read_text().startswith(HEAD.rstrip())
    assert load_recipe(path).strokes[0].radius_mm == 5.0
    assert not draw_recipe(path)
    path.write_text(path.read_text().replace("seed = 5", "seed = 6").replace("# a heart", "# my heart"))
    assert draw_recipe(path)
    assert load_recipe(path).strokes[0].radius_mm == 6.0
    assert path.read_text().count(DRAWN_BELOW) == 1
    assert path.read_text().startswith("# my heart")


def test_what_a_person_wrote_below_the_line_is_not_deleted(tmp_path, monkeypatch, capfd):
    monkeypatch.setattr(draw, "drawn_part", lambda scan: DRAWN.replace("2.0", f"{scan.seed}.0"))
    path = tmp_path / "r.toml"
    path.write_text(HEAD)
    assert draw_recipe(path)
    drawn = path.read_text()
    own = drawn.count("\n") + 2
    mine = f"{drawn}\n[[pins]]\nposition_mm = [0.0, 0.0, 1.0]\nradius_mm = 5.0\n"
    changed = mine.replace("seed = 5", "seed = 6")
    for text, words in [
        (mine, f"lines {own}-{own + 2})"),
        (changed, f"it is among lines {own - 3}, {own}-{own + 2}"),
        (drawn.replace("radius_mm = 5.0", "radius_mm = 4.5"), f"line {own - 3})"),
        (mine.replace("\n", "\r\n"), f"lines {own}-{own + 2})"),
    ]:
        for asked in ([], ["--check"]):
            path.write_bytes(text.encode())
            assert main(["library", "draw", str(path), *asked]) == 1
            said = capfd.readouterr()
            assert words in said.err, said.err
            assert "above that line" in said.err
            assert path.read_bytes() == text.encode()
    # Moved above the line, it stays.
    pin = mine[len(drawn) :]
    path.write_text(drawn.replace(DRAWN_BELOW, f"{pin}\n{DRAWN_BELOW}").replace("seed = 5", "seed = 6"))
    assert draw_recipe(path)
    assert load_recipe(path).pins[0].radius_mm == 5.0


def test_a_drawn_part_without_a_checksum_is_only_drawn_over_where_nothing_is_lost(tmp_path, monkeypatch):
    monkeypatch.setattr(draw, "drawn_part", lambda scan: DRAWN.replace("2.0", f"{scan.seed}.0"))
    path = tmp_path / "r.toml"
    older = f"{HEAD.rstrip()}\n\n{DRAWN_BELOW}\n\n{DRAWN.replace('2.0', '5.0')}"
    path.write_text(older)
    assert draw_recipe(path)
    assert not draw_recipe(path)
    path.write_text(older.replace("seed = 5", "seed = 6"))
    with pytest.raises(RecipeError, match="no checksum"):
        draw_recipe(path)
    path.write_text(older.replace("seed = 5", "seed = 6").partition(DRAWN_BELOW)[0] + DRAWN_BELOW + "\n")
    assert draw_recipe(path)
    assert load_recipe(path).strokes[0].radius_mm == 6.0


def test_a_recipe_of_a_real_scan_cannot_be_drawn(tmp_path, capfd):
    path = tmp_path / "r.toml"
    path.write_text(HEAD.partition("[scan.phantom]")[0])
    with pytest.raises(RecipeError, match="not a synthetic one"):
        draw_recipe(path)
    assert main(["library", "draw", str(path)]) == 1
    assert "heartcase paint" in capfd.readouterr().err


def test_every_sample_case_says_what_a_catalogue_needs():
    recipes = [load_recipe(path) for path in RECIPES]
    made = [recipe for recipe in recipes if recipe.scan.phantom is not None]
    assert all(recipe.about is not None for recipe in made)
    # The two of fixed size are for tests and benchmarks.
    library = [recipe for recipe in made if recipe.scan.phantom.heart.body_surface_m2 is not None]
    assert len(library) >= 16
    for recipe in library:
        assert recipe.about is not None, recipe.name
        assert recipe.about.refusal is None
        assert recipe.about.origin == "synthetic"
        for text in recipe.about.texts.values():
            assert text.access is not None, recipe.name
        names = {landmark.name for landmark in recipe.landmarks}
        assert {"apex", "right coronary artery", "left anterior descending artery"} <= names, recipe.name
        planned = {one.name for one in recipe.landmarks if one.depth_mm is not None}
        assert planned == set(recipe.scan.phantom.incisions), recipe.name
        assert planned, recipe.name
    kinds = {one.kind for recipe in library for one in recipe.scan.phantom.heart.defects}
    kinds |= {one.kind for recipe in library for one in recipe.scan.phantom.edited_defects}
    assert len(kinds) == 10
    texts = json.dumps([recipe.about.model_dump(mode="json") for recipe in library])
    assert texts.count('"ipccc": "') >= 14
    assert texts.count('"icd11": "') >= 16


@pytest.mark.slow
@pytest.mark.parametrize("path", RECIPES, ids=lambda path: path.stem)
def test_the_drawn_part_of_a_sample_case_is_current(path):
    if DRAWN_BELOW in path.read_text():
        assert not draw_recipe(path, write=False)
    else:
        assert path.stem in {"adult_phantom", "child_phantom", "chest_ct", "chest_ct_few_strokes"}


def test_a_recipe_with_markers_of_its_own_is_not_drawn_over(monkeypatch):
    """As the phantom command writes them; without the line nobody knows which to keep."""
    path = SAMPLES / "adult_phantom.toml"
    before = path.read_text()
    monkeypatch.setattr(draw, "drawn_part", lambda _: before[before.index("[[strokes]]") :])
    with pytest.raises(RecipeError, match="labels, strokes or landmarks of its own") as caught:
        draw_recipe(path)
    assert DRAWN_BELOW in str(caught.value)
    assert path.read_text() == before


def test_the_normal_heart_is_the_default():
    assert PhantomScan().heart == HeartForm()


@pytest.mark.thorough
def test_a_case_of_a_scan_that_was_made_before_is_replaced(tmp_path, monkeypatch):
    write_ball_scan(tmp_path / "ball.nii.gz")
    ball = read_scan(tmp_path / "ball.nii.gz")

    def quick(settings):
        values = ball.values + np.float32(settings.seed)
        return SyntheticScan(values, ball.geometry, "MR", 10.0, 1.0)

    monkeypatch.setattr("heartcase.phantom.scan.made_scan.made_scan", quick)
    path = write_ball_recipe(tmp_path / "made.nii.gz", tmp_path / "r.toml", parts="parts = []", cell_mm=6.0)
    text = path.read_text()
    ids = []
    for seed in (1, 2):
        path.write_text(text.replace("[[labels]]", f"[scan.phantom]\nseed = {seed}\n[[labels]]", 1))
        (case,) = plan_library(tmp_path)
        record = build_one(case, str(tmp_path / "out"), None)
        assert not record.problems
        # making the scan is time that the build took, where it was made
        assert next(iter(record.stage_seconds)) == MAKING_THE_SCAN
        assert MAKING_THE_SCAN not in build_one(case, str(tmp_path / "out"), None).stage_seconds
        ids.append(open_bundle(tmp_path / "out" / "ball.case").manifest.case_id)
        assert main(["build", str(path), "--out", str(tmp_path / "alone")]) == 0
    assert ids[0] != ids[1]
