"""lock, upgrade and approve, as a user types them."""

import io
import json
import tomllib

import pytest

from heartcase.cli.main import main
from heartcase.pipeline.bundle.write_bundle import write_bundle
from heartcase.pipeline.stages import table
from heartcase.schemas.bundle.approval import approval_log
from heartcase.schemas.bundle.format import StageRecord
from heartcase.schemas.migrate import RECIPE, SCRIPT, Migration
from heartcase.schemas.recipe.recipe import load_recipe
from heartcase.schemas.recipe.settings import SurfaceSettings
from tests.ball import write_ball_recipe, write_ball_scan
from tests.factories import block_case
from tests.pipeline.stage_tables import with_versions


def run(*arguments):
    return main([str(argument) for argument in arguments])


def run_json(capsys, *arguments):
    capsys.readouterr()
    code = run(*arguments, "--json")
    out = capsys.readouterr().out
    return code, json.loads(out)


@pytest.fixture(scope="module")
def scans(tmp_path_factory):
    directory = tmp_path_factory.mktemp("patient-JANE-DOE")
    write_ball_scan(directory / "JANE-DOE.nii.gz")
    return directory


@pytest.fixture
def recipe(scans, tmp_path):
    return write_ball_recipe(scans / "JANE-DOE.nii.gz", tmp_path / "work" / "ball.toml", parts="parts = []")


@pytest.fixture
def case(tmp_path):
    directory = tmp_path / "block.case"
    write_bundle(directory, block_case())
    return directory


def test_lock_writes_beside_the_recipe_and_replaces_nothing_unasked(recipe, capsys):
    locked = recipe.with_name("ball.lock.toml")
    assert run("lock", recipe) == 0
    assert "ball.lock.toml" in capsys.readouterr().out
    text = locked.read_text()
    assert tomllib.loads(text)["surface"]["atlas"] == "cone"
    assert load_recipe(locked).name == "ball"
    locked.write_text("mine")
    assert run("lock", recipe) == 2
    assert "give --force" in capsys.readouterr().err
    assert locked.read_text() == "mine"
    assert run("lock", recipe, "--force") == 0
    assert locked.read_text() == text
    # A locked recipe is locked anew in its own place.
    assert run("lock", locked, "--force") == 0
    assert locked.read_text() == text


def test_lock_says_what_is_missing_without_naming_it(recipe, capsys):
    recipe.write_text(recipe.read_text().replace("JANE-DOE.nii.gz", "JOHN-DOE.nii.gz"))
    assert run("lock", recipe) == 1
    error = capsys.readouterr().err
    assert "scan.path: there is no such file" in error
    assert "DOE" not in error
    assert run("lock", recipe, "--out", recipe.parent / "no" / "a.toml") == 2
    assert not list(recipe.parent.glob("*.lock.toml"))


def test_building_with_another_scan_is_refused_and_can_be_accepted(scans, recipe, capsys):
    assert run("lock", recipe) == 0
    locked = recipe.with_name("ball.lock.toml")
    data = locked.read_text()
    sha256 = tomllib.loads(data)["lock"]["scan_sha256"]
    locked.write_text(data.replace(sha256, "0" * 64))
    assert run("build", locked, "--out", recipe.parent, "--until", "filter") == 1
    error = capsys.readouterr().err
    assert "its values or its place are not those that the recipe was locked with" in error
    assert "--accept-inputs" in error
    assert "DOE" not in error
    assert run("build", locked, "--out", recipe.parent, "--until", "filter", "--accept-inputs") == 0


def test_a_case_of_a_locked_recipe_carries_the_warnings_of_its_lock(scans, recipe, capsys):
    assert run("lock", recipe) == 0
    locked = recipe.with_name("ball.lock.toml")
    sha256 = tomllib.loads(locked.read_text())["lock"]["scan_sha256"]
    locked.write_text(locked.read_text().replace(sha256, "0" * 64))
    capsys.readouterr()
    for changed in (True, False):
        code, said = run_json(capsys, "build", locked, "--out", recipe.parent, "--accept-inputs")
        assert (code, said["changed"]) == (0, changed)
        place = next(n for n, line in enumerate(said["warnings"]) if "those that the recipe was locked with" in line)
        assert said["warning_grades"][place] == "anatomy"


def test_the_help_of_build_names_every_stage():
    # It is written out, because finding it out would load the pipeline for a page of help.
    from click.testing import CliRunner

    from heartcase.cli.commands.build import command

    text = " ".join(CliRunner().invoke(command, ["--help"]).output.split())
    *first, last = table.stage_names()[:-1]
    assert f"Stop after this stage: {', '.join(first)} or {last}." in text


def test_upgrade_of_an_unlocked_recipe_of_today_has_nothing_to_do(recipe, capsys):
    before = recipe.read_text()
    code, said = run_json(capsys, "upgrade", recipe, "--write")
    assert (code, said["changes"], said["written"]) == (0, [], False)
    assert "not locked" in said["notes"][0]
    assert recipe.read_text() == before
    assert [path.name for path in recipe.parent.iterdir()] == ["ball.toml"]


def test_upgrade_of_an_older_recipe_says_what_changes_and_keeps_the_old_one(recipe, capsys, monkeypatch):
    old = recipe.read_text()
    words = ("surface.triangle_count counts thousands",)

    def thousands(data):
        return {**data, "surface": {**data["surface"], "triangle_count": 3000}}

    monkeypatch.setitem(RECIPE.migrations, 1, Migration(words, thousands))
    code, said = run_json(capsys, "upgrade", recipe)
    assert (code, said["changes"], said["written"]) == (0, list(words), False)
    assert recipe.read_text() == old
    for name in ("ball.toml.bak", "ball.toml.bak2"):
        assert run("upgrade", recipe, "--write") == 0
        assert recipe.with_name(name).read_text() == old
        assert load_recipe(recipe).surface.triangle_count == 3000
        assert tomllib.loads(recipe.read_text())["heartcase_recipe"] == 2
        assert run("upgrade", recipe, "--write") == 0
        assert "nothing to upgrade" in capsys.readouterr().out
        recipe.write_text(old)


def test_upgrade_of_a_locked_recipe_says_which_defaults_and_stages_are_others(scans, recipe, capsys, monkeypatch):
    assert run("lock", recipe) == 0
    locked = recipe.with_name("ball.lock.toml")
    text = locked.read_text()
    assert run_json(capsys, "upgrade", locked)[1]["changes"] == []

    field = SurfaceSettings.model_fields["atlas"]
    monkeypatch.setattr("heartcase.pipeline.walls.grow_walls.default_smoothing_mm", lambda spacing: 0.25)
    with_versions(monkeypatch, walls=99)
    from heartcase.schemas.recipe.recipe import Recipe

    try:
        field.default = "xatlas"
        SurfaceSettings.model_rebuild(force=True)
        Recipe.model_rebuild(force=True)
        said = run_json(capsys, "upgrade", locked)[1]
        assert said["changes"][:2] == [
            "walls.smoothing_mm: 1.6 in the lock, 0.25 today",
            'surface.atlas: "cone" in the lock, "xatlas" today',
        ]
        assert said["changes"][2].startswith("stage walls: version")
        assert locked.read_text() == text
        hidden = scans / "JANE-DOE.nii.gz"
        hidden.rename(scans / "away")
        try:
            without = run_json(capsys, "upgrade", locked)[1]
            assert without["changes"] == said["changes"][1:]
            assert "were not compared" in without["notes"][0]
            assert run("upgrade", locked, "--write") == 2
            assert locked.read_text() == text
        finally:
            (scans / "away").rename(hidden)
        capsys.readouterr()
        assert run_json(capsys, "upgrade", locked, "--write")[1]["written"]
        assert locked.with_name("ball.lock.toml.bak").read_text() == text
        upgraded = load_recipe(locked)
        assert (upgraded.walls.smoothing_mm, upgraded.surface.atlas) == (0.25, "xatlas")
        # What the recipe had stated stays.
        assert (upgraded.surface.triangle_count, upgraded.grid.cell_mm) == (2000, 4.0)
        assert run_json(capsys, "upgrade", locked)[1]["changes"] == []
    finally:
        field.default = "cone"
        SurfaceSettings.model_rebuild(force=True)
        Recipe.model_rebuild(force=True)


def test_upgrade_does_not_lock_to_another_scan(recipe, capsys, monkeypatch):
    assert run("lock", recipe) == 0
    locked = recipe.with_name("ball.lock.toml")
    locked.write_text(locked.read_text().replace(load_recipe(locked).lock.scan_sha256, "0" * 64))
    with_versions(monkeypatch, walls=99)
    text = locked.read_text()
    assert run("upgrade", locked, "--write") == 2
    assert "heartcase lock --force" in capsys.readouterr().err
    assert locked.read_text() == text


def test_upgrade_of_scripts_and_of_what_is_neither(tmp_path, capsys, monkeypatch):
    script = tmp_path / "pull.toml"
    script.write_text("seconds = 1.0\n")
    assert run_json(capsys, "upgrade", script)[1] == {
        "kind": "simulation script",
        "changes": [],
        "notes": [],
        "written": False,
        "backup": None,
    }
    monkeypatch.setitem(SCRIPT.migrations, 1, Migration(("time is counted in ms",), lambda data: data))
    assert run("upgrade", script, "--write") == 0
    assert tomllib.loads(script.read_text()) == {"seconds": 1.0, "heartcase_script": 2}
    for text in ("seconds = [", "nonsense = 1"):
        script.write_text(text)
        assert run("upgrade", script) in (1, 2)
    assert run("upgrade", tmp_path / "gone") == 1
    (tmp_path / "scan.nii").write_text("")
    assert run("upgrade", tmp_path / "scan.nii") == 2
    assert "Traceback" not in capsys.readouterr().err


def test_upgrade_of_a_case_previews_and_sends_to_build(case, capsys):
    manifest = case / "case.json"
    data = json.loads(manifest.read_text())
    data["stages"] = [StageRecord(stage="walls", version=1, settings={}, output_sha256="1" * 64).model_dump()]
    manifest.write_text(json.dumps(data | {"software_version": "0.0.1"}))
    said = run_json(capsys, "upgrade", case)[1]
    assert said["changes"] == [
        f"stage walls: version 1 in the case, version {table.stage_versions()['walls']} today; its output may differ"
    ]
    assert "built by heartcase 0.0.1" in said["notes"][0]
    for entry in data["files"]:
        entry["arrays"] = []
    before = json.dumps(data | {"format_version": "1.0", "stages": []})
    manifest.write_text(before)
    changes = run_json(capsys, "upgrade", case)[1]["changes"]
    assert any("multiples of 64 bytes" in line for line in changes)
    assert all(line.startswith(tuple(f"format 1.{minor} adds: " for minor in range(1, 6))) for line in changes)
    assert run("upgrade", case, "--write") == 2
    assert "build it again from its recipe" in capsys.readouterr().err
    assert manifest.read_text() == before


def test_approve_asks_first_and_info_validate_and_simulate_say_the_state(case, capsys):
    from click.testing import CliRunner

    from heartcase.cli.commands.approve import command

    arguments = [str(case), "--role", "consultant cardiologist", "--note", "seen"]
    answered_no = CliRunner().invoke(command, arguments, input="n\n")
    assert answered_no.exit_code == 1
    assert "Not a medical device" in answered_no.output
    assert run_json(capsys, "info", case)[1]["approval"]["state"] == "draft"
    answered_yes = CliRunner().invoke(command, arguments, input="y\n")
    assert answered_yes.exit_code == 0
    assert "approved by consultant cardiologist" in answered_yes.output
    code, said = run_json(capsys, "validate", case)
    assert (code, said["valid"], said["approval"]["state"]) == (0, True, "approved")
    for command_line in (["info", case], ["validate", case], ["simulate", case, "--seconds", "0.01"]):
        assert run(*command_line) == 0
        assert "approved by consultant cardiologist" in capsys.readouterr().out, command_line
    manifest = case / "case.json"
    manifest.write_bytes(manifest.read_bytes() + b"\n")
    assert run("validate", case) == 0
    assert "draft: the case was changed since it was approved" in capsys.readouterr().out


def test_approve_asks_about_wrong_anatomy_by_itself_and_yes_says_it(case, capsys):
    from click.testing import CliRunner

    from heartcase.cli.commands.approve import command

    manifest = case / "case.json"
    texts, grades = ["a hole", "a second hole", "a look", "a note"], ["anatomy", "anatomy", "look", "note"]
    stated = json.loads(manifest.read_text()) | {"warnings": texts, "warning_grades": grades}
    manifest.write_text(json.dumps(stated))
    arguments = [str(case), "--role", "surgeon"]
    for answers, code in (("n\n", 1), ("y\nn\n", 1), ("y\ny\n", 0)):
        result = CliRunner().invoke(command, arguments, input=answers)
        assert result.exit_code == code
        assert result.output.count("2 warnings say that the anatomy may be wrong. Have you compared these places") == 1
    headings = ["The anatomy may be wrong (2 warnings)", "  - A hole.", "Look at this (1 warning)", "  - A look."]
    assert [line for line in result.output.splitlines() if line in headings] == headings
    assert run("approve", case, "--role", "surgeon", "--yes") == 0
    assert "2 warnings say that the anatomy may be wrong: approved all the same" in capsys.readouterr().err
    assert run("info", case) == 0
    assert "For your information (1 warning)\n  - A note.\n" in capsys.readouterr().out
    assert run_json(capsys, "info", case)[1]["warning_grades"] == grades


def test_approve_where_nobody_can_answer_names_the_option(case, capsys, monkeypatch):
    monkeypatch.setattr("sys.stdin", io.StringIO(""))
    assert run("approve", case, "--role", "surgeon") == 2
    assert "add --yes" in capsys.readouterr().err
    assert not approval_log(case).exists()


def test_approve_refuses_an_unsound_case_and_withdraws(case, capsys):
    assert run("approve", case, "--role", "surgeon", "--yes") == 0
    code, said = run_json(capsys, "approve", case, "--role", "surgeon", "--yes", "--withdraw")
    assert (code, said["state"], said["entry_count"]) == (0, "draft", 2)
    part = next(path for path in case.iterdir() if path.name.startswith("grid"))
    part.write_bytes(part.read_bytes()[:-1] + b"\x07")
    assert run("approve", case, "--role", "surgeon", "--yes") == 1
    assert "was changed: build the case again" in capsys.readouterr().err
