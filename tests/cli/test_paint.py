import base64
import json
import tomllib

import numpy as np
import pytest
from click.testing import CliRunner

from heartcase.cli.main import cli
from heartcase.pipeline.building.session_file import open_session
from heartcase.schemas.errors import RecipeError, UsageError
from heartcase.schemas.recipe.recipe import load_recipe
from heartcase.schemas.recipe.settings import Stroke
from tests.cli.small_case import write_scan

RECIPE = """
# a comment that stays
heartcase_recipe = 1
name = "painted"

[scan]
path = "scan.nii.gz"

[[strokes]]
label = "background"
radius_mm = 0.0
points_mm = [{corner}]
"""


@pytest.fixture
def recipe(tmp_path):
    import SimpleITK

    image = SimpleITK.ReadImage(str(write_scan(tmp_path / "scan.nii.gz")))
    corner, middle = (
        [round(x, 2) for x in image.TransformContinuousIndexToPhysicalPoint(index)] for index in ((1, 1, 1), (5, 4, 3))
    )
    path = tmp_path / "painted.toml"
    path.write_text(RECIPE.format(corner=corner))
    return path, middle


def talk(path, *requests):
    lines = "".join(request if isinstance(request, str) else json.dumps(request) for request in requests)
    lines = "\n".join(request if isinstance(request, str) else json.dumps(request) for request in requests)
    done = CliRunner().invoke(cli, ["paint", str(path), "--out", str(path.parent / "out")], input=lines + "\n")
    assert done.exit_code == 0, done.output
    return [json.loads(line) for line in done.stdout.splitlines()]


def test_a_viewer_paints_looks_takes_back_and_saves(recipe):
    path, middle = recipe
    hello, *answers = talk(
        path,
        {"do": "slice", "axis": "k", "index": 3},
        {"do": "paint", "label": "aorta", "radius_mm": 1.0, "points_mm": [middle]},
        {"do": "box", "low": [5, 4, 3], "high": [5, 4, 3]},
        {"do": "undo"},
        {"do": "redo"},
        {"do": "paint", "erase": True, "radius_mm": 0.5, "points_mm": [middle]},
        {"do": "undo"},
        {"do": "changed"},
        {"do": "changed"},
        {"do": "save"},
        {"do": "quit"},
    )
    assert hello["size"] == [12, 10, 8]
    assert hello["labels"]["aorta"] == 5
    assert all(answer["ok"] for answer in answers)
    shown = np.frombuffer(base64.b64decode(answers[0]["labels"]), np.uint8)
    assert answers[0]["size"] == [12, 10]
    assert (shown == 0).all()
    assert answers[1]["changed"] is not None
    assert base64.b64decode(answers[2]["labels"]) == b"\x05"
    assert answers[3]["changed"] == answers[1]["changed"] == answers[4]["changed"]
    assert answers[7]["changed"] is not None
    assert answers[8]["changed"] is None
    assert answers[9]["stroke_count"] == 1
    text = path.read_text()
    assert "# a comment that stays" in text
    assert [stroke.label for stroke in load_recipe(path).strokes] == ["background", "aorta"]
    assert tomllib.loads(text)["strokes"][1]["points_mm"] == [middle]


def test_every_wrong_request_is_answered_and_the_session_goes_on(recipe):
    path, middle = recipe
    before = path.read_text()
    _, *answers = talk(
        path,
        "not json",
        {"do": "dance"},
        {"do": "paint", "label": "aorta"},
        {"do": "paint", "label": "spleen", "points_mm": [middle]},
        {"do": "paint", "label": "aorta", "points_mm": [[1e6, 0, 0]]},
        {"do": "paint", "points_mm": [middle]},
        {"do": "undo"},
        {"do": "redo"},
        {"do": "slice", "axis": "k", "index": 8},
        {"do": "box", "low": [0, 0, 0], "high": [12, 1, 1]},
        {"do": "paint", "label": "aorta", "points_mm": [middle]},
    )
    assert [answer["ok"] for answer in answers] == [False] * 10 + [True]
    assert all(problem["message"] for answer in answers[:-1] for problem in answer["problems"])
    assert path.read_text() == before


def test_the_painted_strokes_give_the_same_labels_when_the_recipe_is_opened_again(recipe):
    path, middle = recipe
    opened = open_session(path, out=path.parent)
    opened.session.paint(Stroke(label="aorta", radius_mm=1.5, points_mm=(tuple(middle),)))
    opened.session.paint(Stroke(erase=True, radius_mm=0.0, points_mm=(tuple(middle),)))
    assert opened.save() == 2
    again = open_session(path, out=path.parent)
    np.testing.assert_array_equal(again.session.labels, opened.session.labels)
    np.testing.assert_array_equal(again.session.markers().labels, opened.session.markers().labels)
    # what was saved is not saved twice, and an undo takes it out again
    opened.session.undo()
    assert opened.save() == 1
    assert len(load_recipe(path).strokes) == 2
    # its own file by another way is its own file
    (path.parent / "aside").mkdir()
    opened.save_as(path.parent / "aside" / ".." / path.name)
    assert opened.save() == 1


def test_a_recipe_without_any_marker_can_be_opened(recipe):
    path, _ = recipe
    path.write_text(path.read_text().split("[[strokes]]")[0])
    assert (open_session(path, out=path.parent).session.labels == 255).all()


def test_another_programs_change_of_the_recipe_is_not_lost(recipe):
    path, middle = recipe
    opened = open_session(path, out=path.parent)
    opened.session.paint(Stroke(label="aorta", points_mm=(tuple(middle),)))
    path.write_text(path.read_text() + "# somebody else\n")
    with pytest.raises(RecipeError, match="changed by another program"):
        opened.save()
    assert path.read_text().endswith("# somebody else\n")
    other = path.with_name("other.toml")
    assert opened.save_as(other) == 1
    assert len(load_recipe(other).strokes) == 2


def test_what_cannot_be_painted_on_is_refused(recipe):
    path, middle = recipe
    text = path.read_text()
    head, tail = text.split("[scan]")
    path.write_text(head + "strokes = [{label = 'aorta', points_mm = [[0, 0, 0]]}]\n[scan]" + tail.split("[[")[0])
    text = path.read_text().replace("[0, 0, 0]", str(middle))
    path.write_text(text)
    opened = open_session(path, out=path.parent)
    opened.session.paint(Stroke(label="background", points_mm=(tuple(middle),)))
    with pytest.raises(RecipeError, match=r"\[\[strokes\]\] tables"):
        opened.save()
    assert path.read_text() == text
    path.write_text(text + '\n[segment]\nmethod = "threshold"\nranges = [{label = "aorta", lower = 1.0}]\n')
    with pytest.raises(UsageError, match="only the watershed"):
        open_session(path, out=path.parent)


def test_saving_under_another_name_replaces_nothing_that_it_did_not_write(recipe):
    path, middle = recipe
    scan = path.with_name("scan.nii.gz")
    before = scan.read_bytes()
    requests = [{"do": "save_as", "path": str(name)} for name in (scan, path.with_name("copy.toml"))]
    _, _, refused, written, again = talk(
        path, {"do": "paint", "label": "aorta", "radius_mm": 1.0, "points_mm": [middle]}, *requests, requests[1]
    )
    assert refused["ok"] is False
    assert "scan.nii.gz is there already" in json.dumps(refused)
    assert scan.read_bytes() == before
    assert written["ok"] is True
    assert again["ok"] is True
    assert len(load_recipe(path.with_name("copy.toml")).strokes) == 2


def test_the_help_shows_the_requests_a_line_each():
    said = CliRunner().invoke(cli, ["paint", "--help"]).output
    assert "\\b" not in said
    assert '\n  {"do": "suggest", "count": 5}\n' in said


def told(answer):
    return {problem["place"]: problem["message"] for problem in answer["problems"]}


def test_every_answer_says_how_long_it_took(recipe):
    path, _ = recipe
    _, *answers = talk(path, {"do": "changed"}, {"do": "dance"}, "broken", {"do": "slice", "axis": "k", "index": 99})
    assert [answer["ok"] for answer in answers] == [True, False, False, False]
    assert all(answer["milliseconds"] >= 0.0 for answer in answers)


def test_wrong_requests_are_told_in_plain_words_with_what_is_possible(recipe):
    path, middle = recipe
    dab = {"do": "paint", "label": "aorta", "points_mm": [middle]}
    kinds = "'paint', 'undo', 'redo', 'changed', 'save', 'quit', 'save_as', 'suggest', 'slice' or 'box'"
    example = 'one JSON object in one line, such as {"do": "undo"}'
    wrong = [
        ({"do": "dance"}, "request.do", f"must be {kinds} (found 'dance')"),
        ({"do": 5}, "request.do", f"must be {kinds} (found 5)"),
        ({}, "request.do", f"must be {kinds}"),
        ('{"do": "undo"', "request", f"is not valid JSON at character 14: give {example}"),
        ('{"do": NaN}', "request", f"is not valid JSON (NaN is no JSON): give {example}"),
        ("[1]", "request", f"must be {example}"),
        (dab | {"points_mm": 5}, "request.paint.points_mm", "must be a list in [brackets] (found 5)"),
        (dab | {"radius_mm": "wide"}, "request.paint.radius_mm", "must be a number (found 'wide')"),
        ({"do": "slice", "axis": "x", "index": 1}, "request.slice.axis", "must be 'i', 'j' or 'k' (found 'x')"),
        ({"do": "paint", "erase": "no", "points_mm": [middle]}, "request.paint.erase", "must be true or false"),
    ]
    _, *answers = talk(path, *(request for request, _, _ in wrong))
    for answer, (_, place, words) in zip(answers, wrong, strict=True):
        assert list(told(answer)) == [place]
        assert told(answer)[place].startswith(words)
        assert not any(raw in told(answer)[place] for raw in ("Input", "discriminator", "valid tuple", "valid array"))


def test_a_line_that_is_no_text_is_answered_too(recipe):
    path, _ = recipe
    line = b'{"do": "save_as", "path": "\xff"}\n{"do": "changed"}\n'
    done = CliRunner().invoke(cli, ["paint", str(path), "--out", str(path.parent / "out")], input=line)
    _, wrong, right = (json.loads(answer) for answer in done.stdout.splitlines())
    assert told(wrong) == {"request": "is not UTF-8 text: write it as UTF-8"}
    assert right["ok"]


def test_a_scan_or_a_folder_is_no_recipe_to_paint_on(recipe):
    path, _ = recipe
    with pytest.raises(RecipeError, match="looks like a scan, not a recipe"):
        open_session(path.with_name("scan.nii.gz"), out=path.parent)
    with pytest.raises(RecipeError, match="a folder, not a recipe"):
        open_session(path.parent, out=path.parent)
