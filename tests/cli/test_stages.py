"""The stage commands one after the other, as a user types them, against the build of the same recipe."""

import json
import re

import numpy as np
import pytest

from heartcase.cli.main import COMMANDS, cli, main
from heartcase.pipeline.artifacts.serialise import artifact_to_bytes, load_artifact, load_history
from heartcase.pipeline.data import Scan, Segmentation, SimulationGrid, Structures, Surface
from heartcase.pipeline.formats.read_scan import read_scan
from heartcase.pipeline.formats.write_images import write_scan
from heartcase.schemas.bundle.check import check_bundle
from heartcase.schemas.bundle.format import FileRole
from heartcase.schemas.bundle.reader import open_bundle
from heartcase.schemas.geometry import Geometry
from heartcase.schemas.recipe.recipe import load_recipe
from tests.ball import write_ball_recipe, write_ball_scan

pytestmark = pytest.mark.usefixtures("plain_reports")

EDIT = """
[[edits]]
kind = "remove"
label = "muscle"
radius_mm = 4
points_mm = [[10, 0, 0], [24, 0, 0]]
"""


@pytest.fixture(scope="module")
def work(tmp_path_factory):
    directory = tmp_path_factory.mktemp("stages")
    write_ball_scan(directory / "scan.nii.gz")
    recipe = write_ball_recipe(directory / "scan.nii.gz", directory / "ball.toml")
    recipe.write_text(recipe.read_text().replace("[scan]\n", '[scan]\nmodality = "MR"\n', 1))
    return directory


def run(*arguments):
    return main([str(argument) for argument in arguments])


TELLING = """
[region]
center_mm = [6, 0, 0]
size_mm = [40, 62, 62]
[about]
origin = "synthetic"
licence = "CC0-1.0"
attribution = "the tests"
[[about.diagnoses]]
name = "open ball"
[about.texts.en]
title = "A ball"
what = "It is cut."
look_for = "The cut."
[[landmarks]]
name = "top"
kind = "point"
points_mm = [[0, 0, 20]]
[[labels]]
value = 3
name = "nowhere"
role = "vessel_lumen"
[[edits]]
kind = "remove"
name = "the hole"
label = "muscle"
radius_mm = 4
points_mm = [[10, 0, 0], [24, 0, 0]]
[[edits]]
kind = "remove_islands"
label = "muscle"
smallest_ml = 0.1
"""
"""What makes several stages tell something, and the case hold more than its parts."""


def test_the_stages_one_by_one_make_the_case_that_build_makes(work):
    levels = "level_counts = [600, 250]\n"
    recipe = write_ball_recipe(work / "scan.nii.gz", work / "levels.toml", surface=levels, more=TELLING)
    steps = [
        ("filter", work / "scan.nii.gz", work / "filtered.safetensors", "--recipe", recipe),
        ("segment", work / "filtered.safetensors", work / "labels.safetensors", "--recipe", recipe),
        ("walls", work / "labels.safetensors", work / "structures.safetensors", "--recipe", recipe),
        ("edit", work / "structures.safetensors", work / "edited.safetensors", "--recipe", recipe),
        ("grid", work / "edited.safetensors", work / "grid.safetensors", "--recipe", recipe),
        ("surface", work / "edited.safetensors", work / "surface.safetensors", "--recipe", recipe),
        (
            *("map", work / "surface.safetensors", work / "grid.safetensors", work / "edited.safetensors"),
            *(work / "map.safetensors", "--recipe", recipe),
        ),
        (
            *("bundle", work / "grid.safetensors", work / "by-hand" / "ball.case", "--scan", work / "scan.nii.gz"),
            *("--surface", work / "surface.safetensors", "--map", work / "map.safetensors"),
            *("--structures", work / "edited.safetensors", "--recipe", recipe),
        ),
        ("build", recipe, "--out", work),
    ]
    for step in steps:
        assert run(*step) == 0, step
    by_hand, built = open_bundle(work / "by-hand" / "ball.case"), open_bundle(work / "ball.case")
    assert check_bundle(work / "by-hand" / "ball.case") == ()
    assert {entry.role for entry in built.manifest.files} == set(FileRole) - {FileRole.SCAN}
    for role in (entry.role for entry in built.manifest.files):
        assert by_hand.manifest.file(role).sha256 == built.manifest.file(role).sha256, role
    assert len(built.manifest.warnings) >= 2
    assert built.manifest.about is not None
    assert built.manifest.quality["volumes_ml"]
    assert by_hand.manifest.model_dump() == built.manifest.model_dump()


def test_the_recipe_s_kind_of_scan_decides_on_the_filter(work):
    """A NIfTI does not say what it is."""
    recipe = work / "ct.toml"
    plain = (work / "ball.toml").read_text()
    recipe.write_text(plain.replace('modality = "MR"', 'modality = "CT"', 1))
    assert 'modality = "CT"' in recipe.read_text()
    found = []
    for name, options in (
        ("ct", ("--recipe", recipe)),
        ("curvature", ("--set", "method=curvature_diffusion")),
        ("gradient", ()),
    ):
        assert run("filter", work / "scan.nii.gz", work / f"{name}.nrrd", *options) == 0
        found.append(read_scan(work / f"{name}.nrrd").values)
    np.testing.assert_array_equal(found[0], found[1])
    assert np.abs(found[0] - found[2]).max() > 0.0


def test_the_recipe_s_kind_of_scan_decides_on_the_landscape(work, capsys):
    """Of a stage's output, too; where nobody says it, that is told."""
    recipe = work / "ct.toml"
    recipe.write_text((work / "ball.toml").read_text().replace('modality = "MR"', 'modality = "CT"', 1))
    bare = work / "bare.toml"
    bare.write_text((work / "ball.toml").read_text().replace('modality = "MR"\n', "", 1))
    assert run("filter", work / "scan.nii.gz", work / "nobody.safetensors") == 0
    assert "stated neither by the scan" in capsys.readouterr().err
    stated = {}
    for name, scan, options in (
        ("ct", "nobody.safetensors", ("--recipe", recipe)),
        ("image", "scan.nii.gz", ("--recipe", recipe)),
        ("bare", "nobody.safetensors", ("--recipe", bare)),
        ("set", "nobody.safetensors", ("--recipe", bare, "--set", "noise_floor=1", "--set", "shape_sigma_mm=1")),
    ):
        assert run("segment", work / scan, work / f"{name}.safetensors", *options) == 0
        told = capsys.readouterr()
        assert ("stated neither by the scan" in told.out + told.err) == (name == "bare")
        (record,) = (one for one in load_history(work / f"{name}.safetensors").stages if one.stage == "segment")
        stated[name] = (record.settings["noise_floor"], record.settings["shape_sigma_mm"])
    assert stated == {"ct": (4.0, 3.0), "image": (4.0, 3.0), "bare": (6.0, 3.0), "set": (1.0, 1.0)}


def test_images_in_and_out(work, capsys):
    assert run("filter", work / "scan.nii.gz", work / "filtered.nrrd", "--set", "iterations=2") == 0
    recipe = work / "ball.toml"
    assert run("segment", work / "filtered.nrrd", work / "labels.seg.nrrd", "--recipe", recipe) == 0
    assert run("walls", work / "labels.seg.nrrd", work / "again.safetensors", "--recipe", recipe) == 0
    assert run("filter", work / "scan.nii.gz", work / "filtered.txt") == 2
    assert "must end in one of" in capsys.readouterr().err


def test_markers_from_a_file_alone(work, capsys):
    recipe = load_recipe(work / "ball.toml")
    run("segment", work / "scan.nii.gz", work / "first.safetensors", "--recipe", work / "ball.toml")
    labels = load_artifact(work / "first.safetensors", Segmentation)
    assert labels.table == recipe.table
    assert run("segment", work / "scan.nii.gz", work / "none.safetensors") == 1
    assert "marker" in capsys.readouterr().err


def test_an_edit_opens_the_ball(work, tmp_path):
    recipe = write_ball_recipe(work / "scan.nii.gz", tmp_path / "open.toml", more=EDIT)
    run("segment", work / "scan.nii.gz", tmp_path / "labels.safetensors", "--recipe", recipe)
    run("walls", tmp_path / "labels.safetensors", tmp_path / "closed.safetensors", "--recipe", recipe)
    assert run("edit", tmp_path / "closed.safetensors", tmp_path / "open.safetensors", "--recipe", recipe) == 0
    from heartcase.pipeline.fields.reader import ownership_at_points

    middle = np.array([[17.0, 0.0, 0.0]])
    before = ownership_at_points(load_artifact(tmp_path / "closed.safetensors", Structures), middle)
    after = ownership_at_points(load_artifact(tmp_path / "open.safetensors", Structures), middle)
    assert before.tissue_mm[0] < 0 < after.tissue_mm[0]


def test_wrong_inputs_are_one_line_each_and_leave_the_output_alone(work, tmp_path, capsys):
    output = tmp_path / "kept.safetensors"
    output.write_bytes(b"mine")
    cases = [
        ("grid", work / "scan.nii.gz", output),
        ("grid", tmp_path / "none.safetensors", output),
        ("filter", tmp_path / "none.nii.gz", output),
        ("filter", work / "scan.nii.gz", output, "--set", "iterations"),
        ("filter", work / "scan.nii.gz", output, "--set", "iterations=many"),
        ("filter", work / "scan.nii.gz", output, "--set", "speed=2"),
        ("segment", work / "scan.nii.gz", output, "--recipe", tmp_path / "none.toml"),
    ]
    for case in cases:
        assert run(*case) in (1, 2), case
        error = capsys.readouterr().err
        assert error.count("\n") == 1, error
        assert error.startswith("heartcase: "), error
        assert output.read_bytes() == b"mine"


def test_every_command_explains_itself(capsys):
    for name in COMMANDS:
        command = cli.get_command(None, name)
        assert command.name
        assert run(name, "--help") == 0
        assert "Usage:" in capsys.readouterr().out


def test_new_writes_a_recipe_that_loads_and_does_not_overwrite(work, capsys):
    target = work / "new.toml"
    assert run("new", work / "scan.nii.gz", "--out", target, "--name", "first") == 0
    assert load_recipe(target).scan.path == "scan.nii.gz"
    text = target.read_text()
    assert run("new", work / "scan.nii.gz", "--out", target) == 2
    assert "already a recipe" in capsys.readouterr().err
    assert target.read_text() == text


def test_validate_lists_every_problem_and_exits_one(work, capsys):
    assert run("build", work / "ball.toml", "--out", work) == 0
    capsys.readouterr()
    assert run("validate", work / "ball.case") == 0
    assert run("validate", work / "ball.toml") == 0
    assert capsys.readouterr().out == "sound\ndraft: nobody has approved this case\nsound\n"
    broken = work / "broken.toml"
    broken.write_text((work / "ball.toml").read_text().replace('label = "muscle"', 'label = "muscel"') + "\nx = 1\n")
    assert run("validate", broken, "--json") == 1
    found = json.loads(capsys.readouterr().out)
    assert found["valid"] is False
    assert len(found["problems"]) >= 1
    script = work / "script.toml"
    script.write_text("seconds = -1\nspeed = 2\n")
    assert run("validate", script) == 1
    assert "2 problems found" in capsys.readouterr().out


def test_schema_lists_and_prints(capsys):
    assert run("schema") == 0
    assert "recipe" in capsys.readouterr().out.split()
    assert run("schema", "recipe") == 0
    assert json.loads(capsys.readouterr().out)["title"] == "Recipe"
    assert run("schema", "nothing") == 2


def test_outputs_hold_what_their_type_says(work):
    for name, kind in (
        ("filtered", Scan),
        ("labels", Segmentation),
        ("structures", Structures),
        ("grid", SimulationGrid),
        ("surface", Surface),
    ):
        assert isinstance(load_artifact(work / f"{name}.safetensors", kind), kind)


UNMARKED = {
    "nothing but erasers": (lambda text: re.sub(r'label = "\w+"\nradius', "erase = true\nradius", text), 2),
    "no background": (lambda text: text.replace('label = "background"', 'label = "muscle"'), 1),
    "no tissue": (lambda text: text.replace('label = "muscle"\nradius', 'label = "cavity"\nradius'), 1),
    "background alone": (lambda text: re.sub(r'label = "\w+"\nradius', 'label = "background"\nradius', text), 1),
    "nothing for the program to start at": (
        lambda text: (
            re.sub(r'label = "\w+"\nradius', 'label = "background"\nradius', text)
            + '[segment]\nautomatic = ["background"]\n'
        ),
        2,
    ),
}


@pytest.mark.parametrize("name", UNMARKED)
def test_validate_tells_what_build_would_refuse_of_the_strokes(work, tmp_path, capsys, name):
    change, count = UNMARKED[name]
    recipe = tmp_path / "unmarked.toml"
    recipe.write_text(change((work / "ball.toml").read_text()))
    (tmp_path / "scan.nii.gz").write_bytes((work / "scan.nii.gz").read_bytes())
    assert run("build", recipe, "--out", tmp_path, "--until", "markers") == 1
    refused = [line.removeprefix("heartcase: ") for line in capsys.readouterr().err.splitlines() if ": " in line]
    assert len(refused) == count
    assert run("validate", recipe) == 1
    said = capsys.readouterr().out.splitlines()
    assert said[:-1] == refused
    assert said[-1].endswith("found")


def write_marks(path, value):
    """A label volume on the ball's lattice that marks a corner."""
    geometry = Geometry.of(shape=(32, 32, 32), spacing_mm=(2, 2, 2), origin_mm=(-31, -31, -31))
    values = np.zeros(geometry.shape, np.float32)
    values[:2, :2, :2] = value
    write_scan(Scan(values, geometry), path)


MARKER_FILE = '[[markers]]\npath = "m.nrrd"\nnames = { "1" = "background", "2" = "muscle" }\n'


@pytest.mark.parametrize("more", [MARKER_FILE, '[segment]\nautomatic = ["background"]\n'])
def test_validate_knows_what_marker_files_mark_and_says_nothing_of_what_the_program_marks(work, tmp_path, capsys, more):
    (tmp_path / "scan.nii.gz").write_bytes((work / "scan.nii.gz").read_bytes())
    write_marks(tmp_path / "m.nrrd", 1)
    recipe = tmp_path / "unknown.toml"
    text = (work / "ball.toml").read_text().replace('label = "background"', 'label = "muscle"')
    recipe.write_text(text + more)
    assert run("validate", recipe) == 0
    assert capsys.readouterr().out == "sound\n"
    if more == MARKER_FILE:
        write_marks(tmp_path / "m.nrrd", 2)
        assert run("validate", recipe) == 1
        assert "markers: nothing is marked as background" in capsys.readouterr().out
        (tmp_path / "m.nrrd").write_bytes(b"no volume")
        assert run("validate", recipe) == 1
        assert "markers[1]: the file is not an NRRD file" in capsys.readouterr().out
    threshold = '[segment]\nmethod = "threshold"\nranges = [{ label = "muscle", lower = 1 }]\n'
    recipe.write_text(text + threshold)
    assert run("validate", recipe) == 0


def test_a_scan_or_a_folder_in_place_of_a_recipe_is_told_by_every_command(work, tmp_path, capsys):
    output = tmp_path / "x.safetensors"
    for command in ("build", "lock", "paint", "suggest", "edit", "grid"):
        for path, words in ((work / "scan.nii.gz", "looks like a scan"), (work, "is a folder")):
            more = ("--recipe", path) if command in ("edit", "grid") else ("--out", tmp_path / "out")
            inputs = (work / "scan.nii.gz", output) if command in ("edit", "grid") else (path,)
            assert run(command, *inputs, *more) == 1, command
            assert f"heartcase: recipe: this {words}, not a recipe" in capsys.readouterr().err


def test_a_named_edit_is_called_by_its_name_and_a_new_name_computes_no_stage_anew(work, tmp_path, capsys):
    text = (work / "ball.toml").read_text()
    (tmp_path / "scan.nii.gz").write_bytes((work / "scan.nii.gz").read_bytes())
    recipe = tmp_path / "ball.toml"
    told = []
    for name in ("", 'name = "tidy up"\n', 'name = "swept"\n'):
        recipe.write_text(text + f'[[edits]]\nkind = "keep_largest"\nlabel = "cavity"\n{name}')
        assert run("build", recipe, "--out", tmp_path, "--json") == 0
        result = json.loads(capsys.readouterr().out)
        told += [line.partition(":")[0] for line in result["warnings"] if line.startswith("edits")]
    assert told == ["edits[1]", 'edits[1] "tidy up"', 'edits[1] "swept"']
    assert {"edit", "grid", "surface", "map"} <= set(result["reused"])


def test_all_inputs_of_a_stage_that_are_wrong_are_told_at_once_by_name(work, tmp_path, capsys):
    output, junk = tmp_path / "map.safetensors", tmp_path / "junk.safetensors"
    output.write_bytes(b"what was there")
    junk.write_bytes(b"junk")
    assert run("map", tmp_path / "none.safetensors", junk, junk, output) == 1
    error = capsys.readouterr().err
    for name, words in (("SURFACE", "cannot be read"), ("GRID", "not the output"), ("STRUCTURES", "not the output")):
        assert re.search(f"{name}: the file .*{words}", error), error
    assert output.read_bytes() == b"what was there"
    case = tmp_path / "a.case"
    assert run("bundle", junk, case, "--surface", junk, "--scan", work / "scan.nii.gz") == 1
    error = capsys.readouterr().err
    assert "GRID: " in error
    assert "--surface: " in error
    assert not case.exists()


def without_history(path, kind):
    """The same output as another program, or an older heartcase, would hand it on."""
    path.write_bytes(artifact_to_bytes(load_artifact(path, kind)))


def test_what_was_told_on_the_way_is_in_the_case_and_what_is_not_known_is_told(work, tmp_path, capsys):
    """A ball whose muscle reaches the region's faces, with a label that nothing is painted for."""
    recipe = write_ball_recipe(work / "scan.nii.gz", tmp_path / "told.toml", more=TELLING)
    assert run("segment", work / "scan.nii.gz", tmp_path / "labels.safetensors", "--recipe", recipe) == 0
    assert "The nowhere is not in the model" in capsys.readouterr().out
    assert run("walls", tmp_path / "labels.safetensors", tmp_path / "walls.safetensors", "--recipe", recipe) == 0
    assert run("grid", tmp_path / "walls.safetensors", tmp_path / "grid.safetensors", "--recipe", recipe) == 0
    bundle = ("bundle", tmp_path / "grid.safetensors", tmp_path / "told.case", "--scan", work / "scan.nii.gz")
    assert run(*bundle, "--structures", tmp_path / "walls.safetensors", "--recipe", recipe) == 0
    manifest = open_bundle(tmp_path / "told.case").manifest
    first, *rest = manifest.warnings
    assert "the heart is cut off at the right face of the region of interest" in first
    assert manifest.warning_grades[0] == "anatomy"
    assert any("the nowhere is not in the model" in line for line in rest)
    assert not any("not known" in line for line in rest)
    assert [record.stage for record in manifest.stages] == ["read", "markers", "segment", "walls", "grid"]
    # without the fields nothing can be said of the faces, and that is said
    assert run(*bundle, "--recipe", recipe) == 0
    warnings = open_bundle(tmp_path / "told.case").manifest.warnings
    assert any("not known what the scan's faces cut off" in line for line in warnings)
    without_history(tmp_path / "grid.safetensors", SimulationGrid)
    assert run(*bundle, "--structures", tmp_path / "walls.safetensors", "--recipe", recipe) == 0
    warnings = open_bundle(tmp_path / "told.case").manifest.warnings
    assert any("does not say how it came about" in line for line in warnings)


def test_outputs_that_do_not_belong_together_are_refused(work, tmp_path, capsys):
    recipe = write_ball_recipe(work / "scan.nii.gz", tmp_path / "a.toml")
    run("segment", work / "scan.nii.gz", tmp_path / "labels.safetensors", "--recipe", recipe)
    for name, smoothing in (("a", 1.0), ("b", 2.5)):
        made = tmp_path / f"{name}.safetensors"
        change = ("--set", f"smoothing_mm={smoothing}")
        assert run("walls", tmp_path / "labels.safetensors", made, "--recipe", recipe, *change) == 0
    assert run("grid", tmp_path / "a.safetensors", tmp_path / "grid.safetensors", "--recipe", recipe) == 0
    bundle = ("bundle", tmp_path / "grid.safetensors", tmp_path / "a.case", "--scan", work / "scan.nii.gz")
    capsys.readouterr()
    assert run(*bundle, "--structures", tmp_path / "b.safetensors", "--recipe", recipe) == 2
    assert "GRID and --structures: were made from different outputs of the stage 'walls'" in capsys.readouterr().err
    assert run(*bundle, "--structures", tmp_path / "a.safetensors", "--recipe", recipe) == 0


def test_labels_from_an_image_file_say_that_what_was_told_is_not_known(work, tmp_path, capsys):
    recipe = write_ball_recipe(work / "scan.nii.gz", tmp_path / "a.toml")
    assert run("segment", work / "scan.nii.gz", tmp_path / "labels.seg.nrrd", "--recipe", recipe) == 0
    assert run("walls", tmp_path / "labels.seg.nrrd", tmp_path / "walls.safetensors", "--recipe", recipe) == 0
    told = load_history(tmp_path / "walls.safetensors").told
    assert "image file" in told["unknown"][0].text


def test_options_that_choose_a_scan_are_refused_for_the_output_of_a_stage(work, tmp_path, capsys):
    assert run("filter", work / "scan.nii.gz", tmp_path / "f.safetensors", "--recipe", work / "ball.toml") == 0
    arguments = (tmp_path / "f.safetensors", tmp_path / "g.safetensors", "--trigger-time", "0")
    assert run("filter", *arguments) == 2
    assert "choose among the images" in capsys.readouterr().err
