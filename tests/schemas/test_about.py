import pytest

from heartcase.schemas.about import About
from heartcase.schemas.errors import RecipeError
from heartcase.schemas.landmarks import Landmark
from heartcase.schemas.recipe.recipe import parse_recipe

TEXT = {"title": "A heart", "what": "A hole.", "look_for": "The hole."}
DATA = {
    "origin": "synthetic",
    "licence": "CC0-1.0",
    "attribution": "heartcase",
    "segmental": "{S,D,S}",
    "diagnoses": [{"name": "Atrial septal defect", "icd11": "LA8E.1", "ipccc": "05.04.02", "synonyms": ["ASD"]}],
    "texts": {"en": TEXT, "de": TEXT | {"title": "Ein Herz"}},
}
RELEASE = {"reference": "EC 12/2026", "scope": "teaching within the hospital", "date": "2026-03-04"}
RECIPE = """
heartcase_recipe = 1
name = "x"
[scan]
path = "x.nii"
[[strokes]]
label = "aorta"
points_mm = [[0.0, 0.0, 0.0]]
[about]
origin = "synthetic"
licence = "CC0-1.0"
attribution = "heartcase"
release = {reference = "1", scope = "public", date = "2026-01-02"}
[[about.diagnoses]]
name = "x"
[about.texts.de]
title = "x"
what = "x"
look_for = "x"
"""


def test_a_language_falls_back_on_its_main_one_and_on_english():
    about = About.model_validate(DATA)
    assert about.text("de").title == about.text("de-CH").title == "Ein Herz"
    assert about.text("fr").title == about.text("en").title == "A heart"


@pytest.mark.parametrize(("origin", "release", "shown"), [
    ("synthetic", None, True),
    ("specimen", None, True),
    ("patient", None, False),
    ("patient", RELEASE, True),
])  # fmt: skip
def test_only_a_patient_needs_a_release(origin, release, shown):
    about = About.model_validate(DATA | {"origin": origin, "release": release})
    assert (about.refusal is None) == shown
    if not shown:
        assert "no release is recorded" in about.refusal


def test_every_problem_is_named_at_once():
    with pytest.raises(RecipeError) as caught:
        parse_recipe(RECIPE)
    assert "about.texts: the English text (en) is missing" in str(caught.value)
    assert "about.release: only a patient's case has one" in str(caught.value)


@pytest.mark.parametrize(("place", "value"), [
    ("segmental", "{S,D}"),
    ("licence", "a\nb"),
    ("diagnoses", []),
    ("diagnoses", [{"name": "x", "ipccc": "1.2.3"}]),
    ("diagnoses", [{"name": "x", "icd11": "la88"}]),
])  # fmt: skip
def test_what_is_no_code_is_refused(place, value):
    with pytest.raises(ValueError, match=place):
        About.model_validate(DATA | {place: value})


def test_only_a_polyline_has_a_depth():
    line = [(0.0, 0.0, 0.0), (1.0, 0.0, 0.0)]
    assert Landmark(name="cut", kind="polyline", points_mm=line, depth_mm=5.0).depth_mm == 5.0
    with pytest.raises(ValueError, match="planned incision"):
        Landmark(name="cut", kind="point", points_mm=line[:1], depth_mm=5.0)
