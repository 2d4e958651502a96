"""A guided tour in the page without a server: what its steps do is in it."""

import json

import numpy as np
import pytest

from heartcase.cli.main import main
from heartcase.pipeline.bundle.write_bundle import write_bundle
from heartcase.schemas.touring.reading import parse_tour
from heartcase.simulator.load import load_case
from heartcase.simulator.touring.case_places import CasePlaces
from heartcase.simulator.touring.staging import staged_scenes
from heartcase.studio.offline.exported import page_of
from heartcase.studio.offline.toured import Toured
from heartcase.studio.touring.found_tours import ShownTour
from tests.ball import write_ball_recipe
from tests.hollow_case import hollow_case
from tests.simulator.touring.hollow_tour import TOUR


@pytest.fixture(scope="module")
def case(tmp_path_factory):
    path = tmp_path_factory.mktemp("toured") / "hollow.case"
    write_bundle(path, hollow_case())
    return load_case(path, needs=("surface", "structures", "tissue"))


def toured(case, text):
    tour = parse_tour(text)
    return Toured(ShownTour(tour, staged_scenes(tour, CasePlaces(case))), case)


def test_each_step_ends_with_what_it_did(case):
    made = toured(case, TOUR)
    moments = list(made.moments())
    assert made.problems == []
    assert made.ends[:2] == [1, 1]
    assert made.ends == sorted(made.ends)
    assert made.ends[-1] == len(moments)
    at_end = [moments[end - 1].frame for end in made.ends]
    assert [sorted(one.instruments) for one in at_end] == [
        [],
        [],
        ["probe"],
        ["lid one lip", "lid other lip"],
        ["lid one lip", "lid other lip"],
        [],
    ]
    assert list(at_end[4].patches) == ["patch"]
    assert np.abs(moments[0].frame.displacement_mm).max() == 0.0


def test_a_step_that_cannot_be_done_leaves_those_before(case):
    wrong = TOUR.replace('kind = "withdraw_probe"\nname = "probe"', 'kind = "take_out_patch"\nname = "none"')
    made = toured(case, wrong)
    moments = list(made.moments())
    assert len(made.ends) == 3
    assert made.ends[-1] == len(moments)
    assert "(step 4)" in made.problems[0].place


def test_a_tour_that_only_shows_takes_no_steps(case):
    made = toured(case, TOUR.partition("## Through it")[0])
    assert list(made.moments()) == []
    assert made.as_data()["ends"] == []


def test_a_tour_beside_the_case_that_cannot_be_read_is_left_out_and_told(tmp_path):
    path = tmp_path / "hollow.case"
    write_bundle(path, hollow_case())
    (tmp_path / "wrong.tour.md").write_text(TOUR.replace("heartcase_tour = 1", "heartcase_tour = 1\ncolour = 3"))
    made = page_of(path, [], level=0, frames_per_second=10.0)
    assert any("colour" in str(one) for one in made.warnings), made.warnings
    assert made.tours == ()


def test_the_command_says_which_tours_went_in(tmp_path, capsys):
    """Those beside the case, and in the folder above it where its recipe lies; and where it looked for them if none."""
    path = tmp_path / "out" / "hollow.case"
    path.parent.mkdir()
    write_bundle(path, hollow_case())
    looks = TOUR.partition("## Through it")[0]

    def said(*options):
        page = tmp_path / "pages" / "hollow.html"
        page.parent.mkdir(exist_ok=True)
        assert main(["export", str(path), "--out", str(page), *options]) == 0
        printed = capsys.readouterr()
        assert printed.err == ""
        if "--json" in options:
            return json.loads(printed.out).get("tours")
        first, *more = printed.out.splitlines()
        assert first.startswith(f"wrote the case as a page to {page}, ")
        return more

    (none,) = said()
    assert none.startswith("no guided tour is in it: they are found beside the case, and in the folder above it")
    assert said("--json") == []
    (tmp_path / "any.tour.md").write_text(looks)
    assert said() == [none]
    write_ball_recipe(tmp_path / "scan.nii.gz", tmp_path / "any.toml")
    recipe = (tmp_path / "any.toml").read_text()
    (tmp_path / "any.toml").write_text(recipe.replace('name = "ball"', 'name = "hollow"'))
    assert said() == ["guided tours in it: Two rooms"]
    (path.parent / "again.tour.md").write_text(looks.replace("# Two rooms", "# Rooms"))
    assert said() == ["guided tours in it: Rooms; Two rooms"]
    assert said("--json") == ["Rooms", "Two rooms"]
    assert said("--no-tours") == []
    assert said("--no-tours", "--json") is None
