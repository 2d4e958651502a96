"""``heartcase suggest --ends``, automatic ends in a build, and in a lock."""

import json
import tomllib

import numpy as np
import pytest
from click.testing import CliRunner

from heartcase.cli.main import cli
from heartcase.pipeline.building.lock import lock_recipe, recipe_text, unlocked_recipe
from heartcase.pipeline.building.recipe_ends import propose_ends
from heartcase.pipeline.building.run import build_case
from heartcase.schemas.errors import RecipeError
from heartcase.schemas.recipe.recipe import load_recipe, parse_recipe
from tests.pipeline.lattices import lattice
from tests.pipeline.vessel_shapes import ball, line, segmented, tube
from tests.pipeline.write_labels import write_labels

AXIS = np.array([0.0, 0.6, 0.8])
GEOMETRY = lattice("even", 70.0)
ENDS = {"superior vena cava": 20.0 * AXIS, "aorta": np.array((24.0, -6.0, -10.0))}
HEAD = """\
heartcase_recipe = 1
name = "two-vessels"   # a comment that stays
parts = ["surface"]
"""
BODY = """
labels = [
  { value = 1, name = "right atrium", role = "blood", wall_thickness_mm = 2.0 },
  { value = 2, name = "superior vena cava", role = "vessel_lumen", wall_thickness_mm = 2.0 },
  { value = 4, name = "left ventricle", role = "blood", wall_thickness_mm = 2.0 },
  { value = 5, name = "aorta", role = "vessel_lumen", wall_thickness_mm = 2.0 },
]
scan = { path = "scan.nii.gz", modality = "CT" }
segment = { method = "labels", file = "labels.nii.gz", names = { "1" = "right atrium", "2" = "superior vena cava", \
"4" = "left ventricle", "5" = "aorta" } }
pins = [{ position_mm = [0.0, -8.0, -12.0], radius_mm = 8.0 }]
grid = { cell_mm = 4.0 }
surface = { triangle_count = 2000, level_counts = [], normal_map_size = 0 }
"""


@pytest.fixture(scope="module")
def work(tmp_path_factory):
    directory = tmp_path_factory.mktemp("ends")
    middle = -10.0 * AXIS
    segmentation = segmented(
        GEOMETRY,
        (1, ball(GEOMETRY, middle, 11.0) & ball(GEOMETRY, middle - np.array((3.0, 0.0, 0.0)), 11.0)),
        (4, ball(GEOMETRY, (6.0, -6.0, -14.0), 8.0)),
        (2, tube(GEOMETRY, line(tuple(middle), tuple(ENDS["superior vena cava"])), 5.0)),
        (5, tube(GEOMETRY, line((6.0, -6.0, -14.0), tuple(ENDS["aorta"])), 5.0)),
    )
    write_labels(directory, segmentation)
    return directory


def written(work, name, head="", tail=""):
    path = work / name
    path.write_text(HEAD + head + BODY + tail)
    return path


def run(*arguments):
    return CliRunner().invoke(cli, [str(one) for one in arguments])


def check_ends(ends):
    assert sorted(end["label"] for end in ends) == sorted(ENDS)
    for end in ends:
        assert np.linalg.norm(np.subtract(end["position_mm"], ENDS[end["label"]])) < 4.0
        assert 5.0 + 2.0 < end["radius_mm"] < 12.0


def test_the_ends_are_printed_and_written_below_a_recipe_that_stays(work):
    path = written(work, "suggest.toml")
    before = path.read_text()
    done = run("suggest", path, "--out", work, "--ends")
    assert done.exit_code == 0, done.output
    assert path.read_text() == before
    check_ends(tomllib.loads("[[ends]]" + done.stdout.partition("[[ends]]")[2])["ends"])
    told = json.loads(run("suggest", path, "--out", work, "--ends", "--json").stdout)
    check_ends([end for end in told["ends"] if not end["is_open"]])
    assert told["without"] == told["problems"] == []
    done = run("suggest", path, "--out", work, "--ends", "--write")
    assert "wrote 2 entries" in done.stdout
    text = path.read_text()
    assert text.startswith(before)
    check_ends([end.model_dump() for end in load_recipe(path).ends])
    # they cut, so that there is nothing more to tell
    done = run("suggest", path, "--out", work, "--ends", "--write")
    assert "No vessel ends anywhere else" in done.stdout
    assert path.read_text() == text


@pytest.mark.parametrize("line", ['ends = "automatic"\n', "ends = 'automatic'   # found each time\n"])
def test_found_ends_take_the_place_of_automatic_ones(work, line):
    """The older spelling leaves no room for tables: what it asked for is written down, and the line goes."""
    path = written(work, "automatic.toml", head=line)
    done = run("suggest", path, "--out", work, "--ends", "--write")
    assert done.exit_code == 0, done.output
    assert path.read_text().startswith(HEAD + BODY)
    recipe = load_recipe(path)
    check_ends([end.model_dump() for end in recipe.ends])
    assert not recipe.walls_to_grow.find_ends


def test_what_is_wrong_with_the_ends_that_there_are_is_told_beside(work):
    wrong = '\n[[ends]]\nlabel = "aorta"\nposition_mm = [15.0, -6.0, -12.0]\naxis = [0.0, 1.0, 0.0]\nradius_mm = 2.0\n'
    told = json.loads(run("suggest", written(work, "wrong.toml", tail=wrong), "--out", work, "--ends", "--json").stdout)
    (problem,) = told["problems"]
    assert problem["place"] == "ends[1]"
    assert "this end of it" in problem["message"]
    check_ends([end for end in told["ends"] if not end["is_open"]])


def test_what_cannot_be_written_is_refused(work):
    done = run("suggest", written(work, "strokes.toml"), "--out", work, "--write")
    assert "goes with --ends" in str(done.exception)
    one = 'ends = [{ label = "aorta", position_mm = [9.0, -6.0, -12.0], axis = [1.0, 0.0, 0.2], radius_mm = 9.0 }]\n'
    path = written(work, "array.toml", head=one)
    with pytest.raises(RecipeError, match="cannot be added at the end of this recipe"):
        propose_ends(path, out=work).save()
    assert path.read_text() == HEAD + one + BODY
    proposed = propose_ends(written(work, "meanwhile.toml"), out=work)
    proposed.path.write_text(HEAD + "# changed\n" + BODY)
    with pytest.raises(RecipeError, match="changed by another program"):
        proposed.save()


def test_a_lock_writes_down_the_ends_that_a_build_would_find(work):
    recipe = load_recipe(written(work, "auto.toml", head='ends = "automatic"\n'))
    assert recipe.walls_to_grow.find_ends
    assert recipe.ends == ()
    locked = lock_recipe(recipe, directory=work, out=work)
    check_ends([end.model_dump() for end in locked.ends])
    assert locked.lock.found_end_count == 2
    assert not locked.walls_to_grow.find_ends
    text = recipe_text(locked)
    assert parse_recipe(text) == locked
    # locked again it stays as it is; unlocked they are sought again
    assert recipe_text(lock_recipe(locked, directory=work, out=work)) == text
    today = unlocked_recipe(locked)
    assert today.ends == ()
    assert today.walls_to_grow.find_ends


@pytest.mark.slow
def test_automatic_ends_are_found_in_the_build_and_told_in_the_report(work):
    recipe = load_recipe(written(work, "build.toml", head='ends = "automatic"\n'))
    built = build_case(recipe, directory=work, out=work / "out")
    assert not [line for line in built.warnings if "closed sac" in line.text]
    html = built.report.read_text()
    section = html.partition('<section id="ends">')[2].partition("</section>")[0]
    assert section.count("cut where the program found the end") == 2
    assert 'src="data:image/jpeg' in section
    assert "found by the program" in html.partition('<section id="hand">')[2]
    again = build_case(lock_recipe(recipe, directory=work, out=work), directory=work, out=work / "locked")
    stated = again.report.read_text().partition('<section id="ends">')[2].partition("</section>")[0]
    assert stated.count("cut where the recipe says") == 2
