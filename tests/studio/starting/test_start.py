"""What the start page is told: folders, series, samples, recent work; and what it is refused."""

import base64
import io
import json
import os
import shutil
import stat
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from heartcase.pipeline.building.recipe_history import history_file
from heartcase.pipeline.data import Scan, Segmentation
from heartcase.pipeline.formats.read_scan import read_scan
from heartcase.pipeline.formats.write_images import write_scan, write_segmentation
from heartcase.schemas.geometry import Geometry
from heartcase.schemas.labels import Label, LabelTable, Role
from heartcase.schemas.recipe.recipe import load_recipe, parse_recipe, read_recipe_text
from heartcase.studio.starting.recent import COUNT_MAX, Recent, state_folder
from heartcase.studio.starting.registry import Registry
from heartcase.studio.starting.roots import ENTRY_COUNT_MAX, Roots
from heartcase.studio.starting.samples import _SCAN_PATH, copy_sample, sample_folder, shown_samples
from heartcase.studio.starting.shown_series import shown_series
from heartcase.studio.starting.start import Start
from tests.pipeline.formats.dicom_series import write_series
from tests.studio.talking import line, studio, write_recipe

NAME = "JANE^DOE"


def write_dicom(folder):
    """Three series: a fine stack, its every fourth slice in three phases, and three slices."""
    volume = np.zeros((24, 20, 16), np.uint16)
    volume[:, 4:10, 2:8] = 500
    positions = np.array([[0.0, 0.0, 1.5 * k] for k in range(24)])
    tags = {"PatientName": NAME, "SeriesDescription": NAME, "modality": "MR", "pixel_spacing": (1.5, 1.5)}
    write_series(folder, volume, positions, series=1, **tags)
    for phase in range(3):
        cine = {"series": 2, "TriggerTime": 200.0 * phase, "first_instance": 1 + 100 * phase}
        write_series(folder, volume[::2], positions[::2] * 3, **cine, **tags)
    write_series(folder, volume[:3], positions[:3], series=3, **tags)
    return folder


@pytest.fixture(scope="module")
def dicom(tmp_path_factory):
    return write_dicom(tmp_path_factory.mktemp("JANE-DOE"))


@pytest.fixture
def browser(tmp_path):
    path, _ = write_recipe(tmp_path)
    with studio(path) as found:
        yield found


def test_a_folder_shows_what_the_studio_opens_and_nothing_else(tmp_path):
    write_recipe(tmp_path)
    for name in ("a_folder", "b.case", ".hidden"):
        (tmp_path / name).mkdir()
    (tmp_path / "c").mkdir()
    (tmp_path / "c" / "case.json").write_text("{}")
    for name, content in (("script.toml", "heartcase_script = 1"), ("notes.txt", "x"), ("x.zip", "x"), ("plain", "x")):
        (tmp_path / name).write_text(content)
    (tmp_path / "IM0001").write_bytes(bytes(128) + b"DICM")
    (tmp_path / "IM0002.dcm").write_bytes(b"")
    found = Roots.of([tmp_path]).listing(None)
    assert [(one["kind"], one["name"]) for one in found["entries"]] == [
        ("recipe", "painted.toml"),
        ("case", "b.case"),
        ("case", "c"),
        ("folder", "a_folder"),
        ("scan", "scan.nii.gz"),
        ("zip", "x.zip"),
    ]
    assert (found["dicom_count"], found["more"], found["parent"]) == (2, 0, None)
    assert Roots.of([tmp_path]).listing(tmp_path / "a_folder")["parent"] == str(tmp_path)
    # a file that is named is shown in its folder
    assert Roots.of([tmp_path]).listing(tmp_path / "painted.toml")["chosen"] == "painted.toml"


def test_a_volume_of_labels_is_no_scan(tmp_path):
    geometry = Geometry.of(shape=(3, 4, 5))
    labels = Segmentation(
        np.zeros(geometry.shape, np.uint8),
        geometry,
        LabelTable(labels=(Label(value=1, name="myocardium", role=Role.MYOCARDIUM),)),
    )
    scan = Scan(np.zeros(geometry.shape, np.float32), geometry)
    for name in ("truth.nii.gz", "truth.nii", "truth.seg.nrrd"):
        write_segmentation(labels, tmp_path / name)
    write_scan(scan, tmp_path / "scan.nii.gz")
    write_scan(scan, tmp_path / "other.nii")
    (tmp_path / "damaged.nii.gz").write_bytes(b"\x1f\x8bx")
    found = Roots.of([tmp_path]).listing(None)
    assert [one["name"] for one in found["entries"]] == ["damaged.nii.gz", "other.nii", "scan.nii.gz"]
    assert {one["kind"] for one in found["entries"]} == {"scan"}


def test_the_page_begins_where_the_studio_was_started(tmp_path):
    home, inside, beside = tmp_path / "home", tmp_path / "home" / "work", tmp_path / "beside"
    for folder in (inside / "scan", beside):
        folder.mkdir(parents=True)
    roots = Roots.of((home, inside)).beginning_in(inside)
    assert roots.folders == (home,)
    assert roots.listing(None)["path"] == str(inside)
    # nothing to open there, or not to be looked into
    assert Roots.of((home, beside)).beginning_in(beside).listing(None)["path"] == str(home)
    assert Roots.of((home,)).beginning_in(beside).listing(None)["path"] == str(home)
    begins = Start(Registry("token"), roots=(home, inside), begin=inside, state=tmp_path)
    assert begins._roots.listing(None)["path"] == str(inside)


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="this system has no pipes in folders")
def test_pipes_are_left_alone(tmp_path):
    """Whoever opens one waits for somebody who writes into it."""
    for name in ("notes.toml", "1", "scan.nii.gz"):
        os.mkfifo(tmp_path / name)
    assert Roots((tmp_path,)).listing(None)["entries"] == []


def test_a_folder_whose_name_is_no_text_is_not_shown(tmp_path):
    """It could not be told to a page."""
    try:
        odd = tmp_path / os.fsdecode(b"M\xfcller")
        odd.mkdir()
    except OSError:
        pytest.skip("this system has no such names")
    assert Roots.of([odd, tmp_path]).folders == (tmp_path,)


def test_a_folder_of_many_is_cut_and_says_so(tmp_path):
    for number in range(ENTRY_COUNT_MAX + 7):
        (tmp_path / f"{number}").mkdir()
    found = Roots.of([tmp_path]).listing(None)
    assert (len(found["entries"]), found["more"]) == (ENTRY_COUNT_MAX, 7)


@pytest.mark.parametrize("do", ["list", "look", "open"])
def test_paths_do_not_leave_the_folders_of_the_start(browser, tmp_path, do, tmp_path_factory):
    outside = tmp_path_factory.mktemp("outside")
    path, _ = write_recipe(outside)
    (tmp_path / "link").symlink_to(outside)
    with line(browser, "/starting", first="start") as page:
        for one in (outside, path, "/", "..", "link", f"{tmp_path}/../{outside.name}", "link/painted.toml", "~root/x"):
            answer = page.ask(do=do, path=str(one))
            assert answer["kind"] == "refused"
            assert outside.name not in json.dumps(answer)
            assert answer["problems"][0]["place"] in ("outside", "path")
        assert page.ask(do=do, path="x\0y")["kind"] == "refused"
        assert page.ask(do=do, path="nothing")["problems"][0]["message"].startswith("there is nothing at this path")
        begin = {"do": "begin", "path": "scan.nii.gz", "folder": str(outside), "file": "new.toml"}
        assert page.ask(**begin)["kind"] == "refused"
        for file in ("../new.toml", "/new.toml", ".new", "a\\b", "a\nb"):
            assert page.ask(**begin | {"folder": str(tmp_path), "file": file})["kind"] == "refused"
    assert sorted(one.name for one in outside.iterdir()) == ["painted.toml", "scan.nii.gz"]


def test_series_have_pictures_and_say_what_they_are_good_for(dicom):
    fine, cine, few = shown_series(dicom)
    assert fine["spacing_mm"] == [1.5, 1.5, 1.5]
    assert (fine["slice_count"], fine["good_for"], fine["can_be_read"]) == (24, ["fine"], True)
    assert cine["trigger_times_ms"] == [0.0, 200.0, 400.0]
    assert cine["good_for"] == ["thick", "phases"]
    assert few["good_for"] == ["localizer"]
    picture = Image.open(io.BytesIO(base64.b64decode(fine["picture"].partition(",")[2])))
    # 16 columns by 20 rows of the same length; the block is bright where it was put
    assert picture.size == (77, 96)
    pixels = np.asarray(picture)
    assert pixels[7 * 96 // 20, 5 * 77 // 16] == 255
    assert pixels[15 * 96 // 20, 12 * 77 // 16] == 0
    assert NAME not in json.dumps([fine, cine, few])


def test_a_chosen_series_and_phase_become_a_recipe_that_opens(tmp_path):
    path, _ = write_recipe(tmp_path)
    write_dicom(tmp_path / "images")
    with studio(path) as browser, line(browser, "/starting", first="start") as page:
        found = page.ask(do="look", path="images")["series"]
        begin = {
            "do": "begin",
            "path": "images",
            "folder": str(tmp_path),
            "file": "heart",
            "series": found[1]["series"],
        }
        assert page.ask(**begin)["kind"] == "refused"
        assert page.ask(**begin, trigger_time_ms=400.0, name="../x")["kind"] == "refused"
        answer = page.ask(**begin, trigger_time_ms=400.0, name="a child 1")
        assert answer["kind"] == "go"
        assert browser.get(answer["address"]).status_code == 200
        recipe = parse_recipe(read_recipe_text(tmp_path / "heart.toml"), needs_markers=False)
        assert recipe.name == "a child 1"
        assert recipe.scan.choice["trigger_time_ms"] == 400.0
        read = read_scan(tmp_path / recipe.scan.path, **recipe.scan.choice)
        assert read.geometry.size == (16, 20, 12)
        assert read.acquisition["trigger_time_ms"] == 400.0
        # what is there is never replaced
        text = (tmp_path / "heart.toml").read_bytes()
        assert "already a recipe" in page.ask(**begin, trigger_time_ms=0.0)["problems"][0]["message"]
        assert (tmp_path / "heart.toml").read_bytes() == text


def test_nothing_is_begun_in_the_folder_of_a_case(tmp_path):
    path, _ = write_recipe(tmp_path)
    inside = tmp_path / "heart.case"
    inside.mkdir()
    (inside / "case.json").write_text("{}")
    shutil.copy(path, inside / "painted.toml")
    with studio(path) as browser, line(browser, "/starting", first="start") as page:
        for asked in (
            {"do": "begin", "path": "scan.nii.gz", "folder": str(inside), "file": "heart"},
            {"do": "sample", "name": "adult-phantom", "folder": str(inside)},
            {"do": "open", "path": "heart.case/painted.toml"},
        ):
            (problem,) = page.ask(**asked)["problems"]
            assert "this is the folder of a case, or lies in one" in problem["message"]
            assert str(tmp_path) not in json.dumps(problem)
    assert {one.name for one in inside.iterdir()} == {"case.json", "painted.toml"}


def test_recent_work_can_be_opened_again_and_forgotten(tmp_path):
    path, _ = write_recipe(tmp_path)
    with studio(path) as browser:
        with line(browser, "/starting", first="start") as page:
            assert page.first["recent"] == []
            address = page.ask(do="open", path="painted.toml")["address"]
            assert address == browser.opened.address
        with line(browser, "/starting", first="start") as page:
            (work,) = page.first["recent"]
            assert (work["name"], work["kind"], work["is_there"]) == ("painted", "recipe", True)
            # where it lies, as far as it lies in a folder that may be looked into
            assert work["folder"] == tmp_path.name
            # no path and no file name is told
            assert str(tmp_path) not in json.dumps(page.first)
            assert ".toml" not in json.dumps(page.first["recent"])
            assert page.ask(do="reopen", key=work["key"])["address"] == address
            path.rename(tmp_path / "moved.toml")
            assert "no longer where it was" in page.ask(do="reopen", key=work["key"])["problems"][0]["message"]
        with line(browser, "/starting", first="start") as page:
            assert not page.first["recent"][0]["is_there"]
            page.ask(do="forget", key=work["key"])
            assert page.hear("start")["recent"] == []
            assert page.ask(do="reopen", key=work["key"])["kind"] == "refused"
    assert (tmp_path / "moved.toml").exists()


def folder_of(start, path, **given):
    """Where a recipe is built that was opened, by the last of the list."""
    start.open_recipe(path, **given)
    return Path(start._recent._read()[0].out)


def test_a_recipe_is_built_in_the_same_folder_whoever_opens_it_and_from_wherever(tmp_path, monkeypatch):
    home, out, elsewhere = tmp_path / "home", tmp_path / "out", tmp_path / "elsewhere"
    for folder in (home, out, elsewhere):
        folder.mkdir()
    path, _ = write_recipe(home)
    monkeypatch.chdir(elsewhere)
    state = tmp_path / "state"
    start = Start(Registry("token"), roots=[home], state=state)
    assert folder_of(start, path) == home
    # what is said counts, and is remembered
    assert folder_of(start, path, out=out) == out
    start = Start(Registry("token"), roots=[home], state=state)
    assert folder_of(start, path) == out
    # what is gone is not made anew
    (tmp_path / "gone").mkdir()
    assert folder_of(start, path, out=tmp_path / "gone" / "out") == tmp_path / "gone" / "out"
    (tmp_path / "gone").rmdir()
    assert folder_of(start, path) == home


def test_work_on_a_recipe_that_lies_in_another_folder_is_named(tmp_path, monkeypatch):
    home, here = tmp_path / "home", tmp_path / "here"
    home.mkdir()
    here.mkdir()
    path, _ = write_recipe(home)
    monkeypatch.chdir(here)
    start = Start(Registry("token"), roots=[home], state=tmp_path / "state")
    assert start.left_elsewhere(path) is None
    # heartcase build writes into the present folder
    (here / "painted.case").mkdir()
    (here / "painted.case" / "case.json").write_text("{}")
    assert f'a case of this name lies in another folder; to go on with it: --out "{here}"' == start.left_elsewhere(path)
    assert start.left_elsewhere(path, out=here) is None
    history = history_file(path, out=home)
    history.parent.mkdir(parents=True)
    history.write_text("")
    assert start.left_elsewhere(path) is None
    history_file(path, out=here).parent.mkdir(parents=True)
    (here / "painted.case" / "case.json").unlink()
    assert "to take it back" in start.left_elsewhere(path, out=here)


def test_recent_work_is_kept_in_a_private_file_and_is_bounded(tmp_path):
    recent = Recent(tmp_path / "state")
    for number in range(COUNT_MAX + 3):
        recent.note("recipe", tmp_path / f"{number}.toml", name=f"case {number}", out=tmp_path)
    recent.note("recipe", tmp_path / "5.toml", name="case 5", out=tmp_path)
    names = [one["name"] for one in recent.shown()]
    assert names == ["case 5", *(f"case {n}" for n in range(COUNT_MAX + 2, 2, -1) if n != 5)]
    file = tmp_path / "state" / "studio.json"
    if os.name == "posix":
        assert stat.S_IMODE(file.stat().st_mode) == 0o600
    for damaged in (b"", b"[1]", b'{"opened": [{"kind": 1}]}', b'{"opened": [3]}', b"\xff"):
        file.write_bytes(damaged)
        assert recent.shown() == []
    recent.note("recipe", tmp_path / "x.toml", name="x", out=tmp_path)
    assert [one["name"] for one in recent.shown()] == ["x"]


def test_recent_work_of_one_name_is_told_apart_by_its_folder_and_nothing_is_told_of_others(tmp_path):
    inside, outside = tmp_path / "mine", tmp_path / "other"
    recent = Recent(tmp_path / "state")
    for folder in (inside, inside / "a" / "b", outside):
        folder.mkdir(parents=True)
        recent.note("recipe", folder / "heart.toml", name="heart", out=folder)
    recent.note("case", inside / "heart.case", name="heart")
    shown = recent.shown(Roots.of([inside]).named)
    assert [one["folder"] for one in shown] == ["mine", None, "mine/a/b", "mine"]
    assert str(tmp_path) not in json.dumps(shown)
    assert "other" not in json.dumps(shown)
    assert Roots.of([inside]).named(inside / "not\ntext") is None
    # what only looks like a folder inside
    assert Roots.of([inside]).named(tmp_path / "mine too") is None


def test_recent_work_lies_in_the_users_state_folder(monkeypatch, tmp_path):
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path))
    assert state_folder() == tmp_path / "heartcase"


def test_every_sample_case_whose_scan_can_be_made_opens_as_a_copy(tmp_path):
    samples = {one["name"]: one for one in shown_samples()}
    originals = sample_folder()
    recipes = {one.stem for one in originals.glob("*.toml") if "heartcase_recipe" in one.read_text()}
    assert set(samples) == recipes
    assert not samples["chest_ct"]["can_be_opened"]
    for name in ("avsd", "adult_phantom", "dorv_baffle"):
        assert samples[name]["can_be_opened"]
        copy, original = load_recipe(copy_sample(name, tmp_path)), load_recipe(originals / f"{name}.toml")
        assert copy.scan.path == "scan.nii.gz"
        same = original.model_copy(update={"scan": original.scan.model_copy(update={"path": "scan.nii.gz"})})
        assert copy.model_dump() == same.model_dump()
    for name, one in samples.items():
        text = (originals / f"{name}.toml").read_text()
        assert one["can_be_opened"] == ("[scan.phantom]" in text)
        assert _SCAN_PATH.search(text)[0].count("path = ") == 1
    # what was changed in a copy stays
    copied = tmp_path / "avsd" / "avsd.toml"
    copied.write_text(copied.read_text() + "# mine\n")
    assert copy_sample("avsd", tmp_path).read_text().endswith("# mine\n")


@pytest.mark.parametrize("name", ["chest_ct", "nothing", "../avsd"])
def test_a_sample_case_that_cannot_be_opened_says_so(browser, tmp_path, name):
    with line(browser, "/starting", first="start") as page:
        assert page.ask(do="sample", name=name, folder=str(tmp_path))["kind"] == "refused"
    assert sorted(one.name for one in tmp_path.rglob("*.toml")) == ["painted.toml"]
    assert not (tmp_path.parent / "avsd").exists()
