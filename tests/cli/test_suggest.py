"""``heartcase suggest``, and the same in the paint protocol."""

import json

import numpy as np
import pytest
import SimpleITK
from click.testing import CliRunner
from scipy import ndimage

from heartcase.cli.main import cli
from heartcase.pipeline.building.session_file import open_session
from heartcase.pipeline.markers.confidence import voxel_confidence
from heartcase.schemas.recipe.settings import Stroke
from tests.cli.small_case import SCAN_DIRECTION

SHAPE = (18, 22, 26)
MARKS = {"aorta": (4, 10, 9), "left ventricle": (20, 10, 9), "background": (13, 20, 1)}


@pytest.fixture
def recipe(tmp_path):
    values = ndimage.gaussian_filter(np.random.default_rng(5).normal(size=SHAPE), 1.5) * 1000.0
    image = SimpleITK.GetImageFromArray(values.astype(np.float32))
    image.SetSpacing((1.5, 2.0, 2.5))
    image.SetOrigin((5.0, -7.0, 11.0))
    image.SetDirection(SCAN_DIRECTION.ravel().tolist())
    SimpleITK.WriteImage(image, str(tmp_path / "scan.nii.gz"))
    lines = ["heartcase_recipe = 1", 'name = "small"', "[scan]", 'path = "scan.nii.gz"']
    for name, index in MARKS.items():
        place = [round(x, 2) for x in image.TransformContinuousIndexToPhysicalPoint(index)]
        lines += ["[[strokes]]", f'label = "{name}"', "radius_mm = 1.0", f"points_mm = [{place}]"]
    path = tmp_path / "small.toml"
    path.write_text("\n".join(lines) + "\n")
    return path


def run(*arguments, **options):
    return CliRunner().invoke(cli, [str(one) for one in arguments], **options)


def test_the_places_are_told_as_json_and_a_stroke_there_changes_what_was_said(recipe):
    done = run("suggest", recipe, "--out", recipe.parent, "--count", "3", "--json")
    assert done.exit_code == 0, done.output
    told = json.loads(done.stdout)
    assert 1 <= len(told["places"]) <= 3
    assert told["rest_ml"] >= 0.0
    for place in told["places"]:
        opened = open_session(recipe, out=recipe.parent)
        before = opened.session.labels.copy()
        # what the label is called is what is there, and its rival another of the table
        table = opened.session.table
        assert table.find(place["rival"]) is not None
        assert place["rival"] != place["label"]
        dab = Stroke(label=place["rival"], radius_mm=0.99 * place["radius_mm"], points_mm=(place["position_mm"],))
        opened.session.paint(dab)
        changed = opened.session.labels != before
        assert (before[changed] == table.find(place["label"]).value).all()
        assert changed.sum() * 7.5e-3 == pytest.approx(place["change_ml"], rel=1e-6)


def test_people_get_a_table_and_are_told_when_to_stop(recipe):
    told = json.loads(run("suggest", recipe, "--out", recipe.parent, "--json").stdout)
    done = run("suggest", recipe, "--out", recipe.parent)
    assert done.exit_code == 0
    first = told["places"][0]
    lines = done.stdout.splitlines()
    number = next(n for n, line in enumerate(lines) if f"{first['position_mm'][0]:.1f}," in line)
    # A long name goes on in the line below.
    row = " ".join(lines[number : number + 2])
    for name in (first["label"], first["rival"]):
        assert all(word in row for word in name.split())
    assert f"{first['change_ml']:.2f}" in row
    assert f"worth {told['rest_ml']:.2f} ml" in done.stdout
    assert max(map(len, lines)) <= 100
    assert "certainty" not in done.stdout
    assert lines[number].split()[-1] == f"{first['confidence']:.2f}"
    for place in told["places"]:
        assert place["worth_ml"] == pytest.approx(min(place["change_ml"], 5.0) * (1.0 - place["confidence"]))


def test_the_confidence_of_a_place_is_the_one_that_the_report_colours(recipe):
    opened = open_session(recipe, out=recipe.parent)
    forest = opened.session._forest
    confidence = voxel_confidence(forest, opened.session.geometry)
    for place in opened.session.suggest(count=5).places:
        i, j, k = np.rint(opened.session.geometry.world_to_index(place.position_mm)).astype(int)
        assert place.confidence == pytest.approx(confidence[k, j, i], abs=1e-5)


def test_the_paint_protocol_names_the_same_places_and_follows_the_strokes(recipe):
    told = json.loads(run("suggest", recipe, "--out", recipe.parent, "--count", "2", "--json").stdout)
    place = told["places"][0]
    stroke = {"do": "paint", "label": place["rival"], "radius_mm": 0.0, "points_mm": [place["position_mm"]]}
    requests = [{"do": "suggest", "count": 2}, stroke, {"do": "suggest"}, {"do": "suggest", "count": 0}]
    lines = "\n".join(json.dumps(one) for one in requests) + "\n"
    done = run("paint", recipe, "--out", recipe.parent, input=lines)
    _, first, _, second, wrong = (json.loads(line) for line in done.stdout.splitlines())
    assert {key: first[key] for key in told} == told
    assert place["position_mm"] not in [one["position_mm"] for one in second["places"]]
    assert wrong["ok"] is False


def test_what_a_build_would_refuse_gets_no_all_clear(recipe):
    """One label reaches everything where no background is marked, so that nothing is unsure."""
    text = recipe.read_text()
    recipe.write_text(text.split("[[strokes]]")[0] + "[[strokes]]" + text.split("[[strokes]]")[1])
    done = run("suggest", recipe, "--out", recipe.parent)
    assert done.exit_code != 0
    assert "nothing is marked as background" in str(done.exception)
    assert "No place is unsure" not in done.stdout


def test_without_any_marker_or_watershed_it_is_refused(recipe):
    text = recipe.read_text()
    recipe.write_text(text.split("[[strokes]]")[0])
    done = run("suggest", recipe, "--out", recipe.parent)
    assert done.exit_code != 0
    assert "nothing is marked as background" in str(done.exception)
    recipe.write_text(text + '[segment]\nmethod = "threshold"\nranges = [{label = "aorta", lower = 1.0}]\n')
    done = run("suggest", recipe, "--out", recipe.parent)
    assert "only the watershed" in str(done.exception)


def test_where_nothing_is_unsure_that_is_said(tmp_path):
    values = np.zeros(SHAPE, np.float32)
    values[:, :, 13:] = 500.0
    SimpleITK.WriteImage(SimpleITK.GetImageFromArray(values), str(tmp_path / "scan.nii.gz"))
    lines = ["heartcase_recipe = 1", 'name = "plain"', "[scan]", 'path = "scan.nii.gz"']
    for name, i in {"background": 3.0, "aorta": 22.0}.items():
        lines += ["[[strokes]]", f'label = "{name}"', "radius_mm = 1.0", f"points_mm = [[{i}, 10.0, 9.0]]"]
    recipe = tmp_path / "plain.toml"
    recipe.write_text("\n".join(lines) + "\n")
    done = run("suggest", recipe, "--out", tmp_path)
    assert done.exit_code == 0, done.output
    assert done.stdout.splitlines() == ["No place is unsure enough to be worth a stroke."]
