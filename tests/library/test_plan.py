"""Which recipes a folder holds, and which of their cases are as they would be built now."""

from __future__ import annotations

import json
import os
from dataclasses import replace

import pytest

from heartcase.library.plan import (
    CaseRecord,
    files_written,
    is_up_to_date,
    plan_library,
    read_record,
    skipped_words,
    write_record,
)
from heartcase.schemas.errors import UsageError
from tests.ball import write_ball_recipe, write_ball_scan


@pytest.fixture
def library(tmp_path):
    write_ball_scan(tmp_path / "scan.nii.gz")
    for number in range(2):
        path = write_ball_recipe(tmp_path / "scan.nii.gz", tmp_path / f"group {number}" / "ball.toml")
        path.write_text(path.read_text().replace('name = "ball"', f'name = "ball-{number}"'))
    return tmp_path


def test_recipes_are_found_by_name_and_what_is_none_is_passed_over(library):
    (library / "pull.toml").write_text("heartcase_script = 1\n")
    (library / "notes.toml").write_text("a = 1\n")
    (library / ".hidden").mkdir()
    (library / ".hidden" / "one.toml").write_text("heartcase_recipe = 1\n")
    assert [case.name for case in plan_library(library)] == ["ball-0", "ball-1"]
    assert not any(case.problems for case in plan_library(library))


def test_all_that_cannot_be_built_says_why(library):
    (library / "wrong.toml").write_text('heartcase_recipe = 1\nname = "wrong"\n[grid]\ncell_mm = -1\n')
    gone = (library / "group 0" / "ball.toml").read_text()
    (library / "gone.toml").write_text(gone.replace("ball-0", "gone").replace("../scan.nii.gz", "nothing.nii.gz"))
    (library / "twin.toml").write_text(gone.replace("../scan.nii.gz", "scan.nii.gz"))
    cases = plan_library(library)
    assert [case.name for case in cases] == ["ball-0", "ball-0", "ball-1", "gone", "wrong"]
    words = {case.recipe.name: " ".join(str(problem) for problem in case.problems) for case in cases if case.problems}
    assert set(words) == {"ball.toml", "twin.toml", "gone.toml", "wrong.toml"}
    assert "2 recipes have this name (group 0/ball.toml, twin.toml)" in words["twin.toml"]
    assert "2 recipes have this name (group 0/ball.toml, twin.toml)" in words["ball.toml"]
    assert "scan.path" in words["gone.toml"]
    assert "grid.cell_mm" in words["wrong.toml"]
    assert [case.stamp == "" for case in cases] == [True, True, False, True, True]


def test_names_that_differ_in_upper_and_lower_case_alone_are_one_folder(library):
    one = (library / "group 0" / "ball.toml").read_text().replace("../scan.nii.gz", "scan.nii.gz")
    (library / "twin.toml").write_text(one.replace("ball-0", "BALL-0"))
    cases = plan_library(library)
    assert [(case.name, bool(case.problems)) for case in cases] == [
        ("BALL-0", True), ("ball-0", True), ("ball-1", False),
    ]  # fmt: skip
    for case in cases[:2]:
        told = (
            "2 recipes have this name, but for upper and lower case (group 0/ball.toml, twin.toml): give each its own"
        )
        assert str(case.problems[0]) == f"name: {told}"


def test_a_recipe_with_a_misspelt_key_is_told_as_skipped(library):
    (library / "wrong.toml").write_text((library / "group 0" / "ball.toml").read_text().replace("_recipe", "_recipi"))
    (library / "group 1" / "empty.toml").write_text("")
    (library / "pull.toml").write_text('seconds = 1.0\n[[grabs]]\nname = "a"\n')
    (library / "plans.toml").write_text("heartcase_plans = 1\n[[plans]]\n")
    skipped = []
    assert len(plan_library(library, skip=skipped.append)) == 2
    assert skipped == ["wrong.toml", "group 1/empty.toml"]
    assert skipped_words(skipped) == "skipped: wrong.toml, group 1/empty.toml (they have no heartcase_recipe = 1)"
    for path in library.glob("*/ball.toml"):
        path.unlink()
    (library / "group 1" / "empty.toml").unlink()
    with pytest.raises(UsageError, match=r"no recipe .* \(skipped: wrong.toml \(it has no heartcase_recipe = 1\)\)"):
        plan_library(library)


@pytest.mark.parametrize("place", ["nothing", "empty", "scan.nii.gz"])
def test_a_folder_without_recipes_is_refused(library, place):
    (library / "empty").mkdir()
    with pytest.raises(UsageError):
        plan_library(library / place)


def test_a_stamp_changes_with_the_recipe_and_with_what_it_reads(library):
    def stamps():
        return [case.stamp for case in plan_library(library)]

    first = stamps()
    assert stamps() == first
    assert len(set(first)) == 2
    path = library / "group 1" / "ball.toml"
    path.write_text(path.read_text().replace("cell_mm = 4.0", "cell_mm = 4.5"))
    second = stamps()
    assert (second[0], second[1] != first[1]) == (first[0], True)
    os.utime(library / "scan.nii.gz", ns=(1, 1))
    assert not set(stamps()) & set(second)


def test_what_was_kept_of_recipes_gives_the_same_plan(library, own_cache):
    (library / "wrong.toml").write_text('heartcase_recipe = 1\nname = "wrong"\n')
    plan = plan_library(library)
    (kept,) = own_cache.rglob("recipes-*.json")
    assert len(json.loads(kept.read_text())["recipes"]) == 2
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("heartcase.library.plan.parse_recipe", lambda _: pytest.fail("parsed again"))
        (library / "wrong.toml").unlink()
        assert plan_library(library) == plan[:2]
    (library / "scan.nii.gz").unlink()
    assert all("scan.path" in str(case.problems[0]) for case in plan_library(library))
    for damage in ("", "[]", '{"software": 1}', '{"software": "0", "recipes": []}'):
        kept.write_text(damage)
        assert all(case.problems for case in plan_library(library))
    (own_cache / "heartcase").rename(own_cache / "away")
    (own_cache / "heartcase").write_text("no folder")
    assert len(plan_library(library)) == 2


def test_a_case_is_up_to_date_as_long_as_its_files_are_as_they_were_written(library):
    out = library / "out"
    (out / "ball-0.case").mkdir(parents=True)
    file = out / "ball-0.case" / "case.json"
    file.write_text("{}")
    case = plan_library(library)[0]
    record = CaseRecord("ball-0", case.stamp, files=files_written(out, ["ball-0.case/case.json"]))
    assert not is_up_to_date(case, out)
    write_record(record, out)
    assert read_record("ball-0", out) == record
    assert is_up_to_date(case, out)
    assert not is_up_to_date(replace(case, stamp="0" * 64), out)
    write_record(replace(record, problems=(("grid", "no tissue"),)), out)
    assert not is_up_to_date(case, out)
    write_record(record, out)
    os.utime(file, ns=(5, 5))
    assert not is_up_to_date(case, out)
    file.unlink()
    assert not is_up_to_date(case, out)


@pytest.mark.parametrize("text", ["", "[]", "{}", '{"record_version": 2}', '{"record_version": 99}', "\0"])
def test_a_damaged_record_is_none(tmp_path, text):
    write_record(CaseRecord("one", "0" * 64), tmp_path)
    path = next(tmp_path.rglob("one.json"))
    path.write_text(text)
    assert read_record("one", tmp_path) is None
