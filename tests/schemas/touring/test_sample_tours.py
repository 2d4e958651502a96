"""The tours that come with heartcase: each is sound, and fits the recipe beside it."""

from __future__ import annotations

import tomllib
from pathlib import Path

import pytest

from heartcase.cli.main import main
from heartcase.schemas.recipe.recipe import load_recipe
from heartcase.schemas.touring.names import tour_problems
from heartcase.schemas.touring.reading import TOUR_ENDING, load_tour

ROOT = Path(__file__).parents[3]
SAMPLES = ROOT / "sample_cases"
TOURS = sorted(SAMPLES.glob(f"*{TOUR_ENDING}"))
DEFECTS = (
    "vsd_perimembranous", "vsd_muscular_mid", "vsd_muscular_apical", "vsd_multiple", "vsd_subpulmonary",
    "asd_secundum", "asd_primum", "asd_sinus_venosus", "avsd", "coarctation", "tetralogy", "transposition",
    "dorv_unrepaired", "hypoplastic_right_ventricle", "normal_adult",
)  # fmt: skip


def test_every_sample_defect_has_a_tour():
    assert {path.name.removesuffix(TOUR_ENDING) for path in TOURS} >= set(DEFECTS)


@pytest.mark.parametrize("path", TOURS, ids=lambda path: path.name.removesuffix(TOUR_ENDING))
def test_a_sample_tour_fits_its_recipe(path):
    tour = load_tour(path)
    recipe = load_recipe(path.with_name(path.name.removesuffix(TOUR_ENDING) + ".toml"))
    assert tour.head.case == recipe.name
    assert tour_problems(tour, recipe.landmarks, recipe.labels) == ()
    assert 5 <= len(tour.steps) <= 10
    assert tour.steps[0].scene.view is not None
    asked = [step.question for step in tour.steps if step.question is not None]
    assert len(asked) >= 2
    assert all(choice.reason for question in asked for choice in question.choices)
    # what is opened is closed again
    kinds = [act.kind for step in tour.steps for act in step.acts]
    assert kinds.count("open_along") == kinds.count("close_along") >= 1


def test_the_wheel_carries_them():
    build = tomllib.loads((ROOT / "pyproject.toml").read_text())["tool"]["hatch"]["build"]["targets"]["wheel"]
    assert build["force-include"] == {"sample_cases": "heartcase/sample_cases"}
    assert not any("md" in pattern for pattern in build["exclude"])


def test_the_command_line_checks_a_tour(tmp_path, capsys):
    path = tmp_path / "mine.tour.md"
    path.write_text((SAMPLES / "avsd.tour.md").read_text().replace('"primum defect"', '"primum defct"'))
    assert main(["validate", str(SAMPLES / "avsd.tour.md")]) == 0
    assert capsys.readouterr().out == "sound\n"
    assert main(["validate", str(path)]) == 0
    assert "give --case" in capsys.readouterr().out
    assert main(["validate", str(path), "--case", str(SAMPLES / "avsd.toml")]) == 1
    assert "did you mean 'primum defect'?" in capsys.readouterr().out
    assert main(["validate", str(path), "--case", str(SAMPLES / "tetralogy.toml")]) == 1
    assert "the tour is for avsd, and this is tetralogy" in capsys.readouterr().out
    assert main(["validate", str(path), "--run"]) == 2
    assert main(["validate", str(SAMPLES / "avsd.toml"), "--run"]) == 2


def test_what_is_wrong_in_the_text_hides_nothing_that_the_case_lacks(tmp_path, capsys):
    path = tmp_path / "mine.tour.md"
    text = (SAMPLES / "avsd.tour.md").read_text().replace('"primum defect"', '"primum defct"')
    path.write_text(text)
    assert main(["validate", str(path), "--case", str(SAMPLES / "avsd.toml")]) == 1
    lacking = [one for one in capsys.readouterr().out.splitlines() if one.startswith("line ")]
    assert lacking
    # of each kind one: a mark-up, a setting, an act
    wrong = """
## Wrong

See <b>here</b>.

```toml
show = ["no such structure"]

[view]
sqare = true
at = "primum defct"

[[do]]
kind = "close_grab"
center_mm = { near = "apex" }
radius_mm = -1

[[do]]
kind = "close_grab"
name = "hand"
center_mm = "nowhere"
```
"""
    path.write_text(text + wrong)
    assert main(["validate", str(path), "--case", str(SAMPLES / "avsd.toml")]) == 1
    told = [one for one in capsys.readouterr().out.splitlines() if one.startswith("line ")]
    assert set(lacking) < set(told)
    more = [one for one in told if one not in lacking]
    for words in (
        "HTML is not shown",
        "did you mean 'square'",
        "do[1].center_mm.towards: is missing",
        "do[1].radius_mm: ",
        "show: the case has no structure 'no such structure'",
        "view.at: ",
        "do[2].center_mm: ",
    ):
        assert sum(words in one for one in more) == 1, (words, more)
    # where the head is wrong, too, --case says of which case it is
    path.write_text(path.read_text().replace("heartcase_tour = 1", "heartcase_tour = 9"))
    assert main(["validate", str(path), "--case", str(SAMPLES / "avsd.toml")]) == 1
    again = capsys.readouterr().out
    assert "line 2: heartcase_tour" in again or "versions up to 1" in again
    assert "show: the case has no structure" in again


def test_a_tour_whose_head_is_wrong_is_not_said_to_have_no_recipe_beside_it(tmp_path, capsys):
    path = tmp_path / "avsd.tour.md"
    text = (SAMPLES / "avsd.tour.md").read_text()
    path.write_text(text)
    assert main(["validate", str(path)]) == 0
    assert "no recipe of this case lies beside it" in capsys.readouterr().out
    (tmp_path / "avsd.toml").write_bytes((SAMPLES / "avsd.toml").read_bytes())
    path.write_text(text.replace("heartcase_tour = 1", "heartcase_tour = 9"))
    assert main(["validate", str(path)]) == 1
    told = capsys.readouterr().out
    assert "lies beside it" not in told
    assert "which case it is for cannot be read" in told
    assert "mend its head, or give --case" in told
