"""A site of several cases: what is in it, what it leaves alone, what it says is wrong."""

import json
import os

import numpy as np
import pytest

from heartcase import CloseGrab
from heartcase.cli.main import main
from heartcase.schemas.errors import UsageError
from heartcase.simulator.load import load_case
from heartcase.simulator.session.operating_session import OperatingSession
from heartcase.simulator.session.recorder import Recorder
from heartcase.simulator.simulation import Simulation
from heartcase.studio.offline.site import MARK, SiteCase, write_site
from tests.simulator.live.scenes import write_case as write_block
from tests.simulator.touring.hollow_tour import TOUR
from tests.studio.offline.cases import about, write_cases
from tests.studio.page.test_offline import contents_of


@pytest.fixture(scope="module", autouse=True)
def small_pictures():
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("heartcase.studio.offline.pictures.PICTURE_SIZE", (80, 60))
        yield


@pytest.fixture(scope="module")
def cases(tmp_path_factory):
    return write_cases(tmp_path_factory.mktemp("site"), ["first", "second (b)+c"])


def files_of(folder):
    return {path.relative_to(folder).as_posix(): path.read_bytes() for path in folder.rglob("*") if path.is_file()}


def leftovers(folder):
    return [name for name in os.listdir(folder) if name.startswith(".")]


def test_one_copy_of_the_viewer_and_the_same_bytes_again(cases, tmp_path, capsys):
    out = tmp_path / "site"
    assert main(["export", *map(str, cases), "--out", str(out), "--json"]) == 0
    said = json.loads(capsys.readouterr().out)
    assert (said["cases"], said["index"]) == (["first", "second (b)+c"], str(out.resolve() / "index.html"))
    first = files_of(out)
    assert sum(map(len, first.values())) == said["bytes"]
    pages = {f"cases/{name}.{ending}" for name in ("first", "second (b)+c") for ending in ("html", "js")}
    pictures = {f"pictures/{name}.webp" for name in ("first", "second (b)+c")}
    assert (
        set(first)
        == {"index.html", MARK, "assets/viewer.js", "assets/viewer.css", "assets/index.js"} | pages | pictures
    )
    index = first["index.html"].decode()
    assert "second%20%28b%29%2Bc.html" in index
    assert "Heart first" in index
    assert "Not a medical device" in index
    for name in ("index.html", "cases/first.html"):
        text = first[name].decode()
        assert "unsafe" not in text
        assert "<script>" not in text
        assert "style=" not in text
    # a site that nobody changed is replaced whole
    assert main(["export", str(cases[0]), "--web", "--out", str(out)]) == 0
    assert "cases/second (b)+c.html" not in files_of(out)
    assert main(["export", *map(str, cases), "--out", str(out)]) == 0
    assert files_of(out) == first
    assert leftovers(tmp_path) == []
    assert said["tours"] == {}
    capsys.readouterr()
    (cases[0].parent / "look.tour.md").write_text(TOUR.partition("## The hole")[0].replace('"hollow"', '"first"'))
    assert main(["export", *map(str, cases), "--out", str(out)]) == 0
    assert capsys.readouterr().out.splitlines()[1:] == ["guided tours of first: Two rooms"]
    (cases[0].parent / "look.tour.md").unlink()


def test_all_cases_that_cannot_be_opened_are_named_at_once(cases, tmp_path):
    (tmp_path / "notes.txt").write_text("mine")
    chosen = [SiteCase(path) for path in (tmp_path / "lost.case", cases[0], tmp_path / "notes.txt")]
    with pytest.raises(UsageError) as refused:
        write_site(chosen, tmp_path / "site")
    assert [problem.place for problem in refused.value.problems] == ["CASE lost", "CASE notes.txt"]
    assert not (tmp_path / "site").exists()


def test_what_somebody_else_put_there_stays(cases, tmp_path):
    chosen = [SiteCase(cases[0])]
    (tmp_path / "mine").mkdir()
    (tmp_path / "mine/index.html").write_text("mine")
    (tmp_path / "file").write_text("mine")
    with pytest.raises(UsageError, match="no site of heartcase left there"):
        write_site(chosen, tmp_path / "mine")
    with pytest.raises(UsageError, match="it is a file"):
        write_site(chosen, tmp_path / "file")
    with pytest.raises(UsageError, match="is to lie in is not there"):
        write_site(chosen, tmp_path / "none/site")
    out = tmp_path / "site"
    out.mkdir()
    write_site(chosen, out)
    (out / "Thumbs.db").write_text("of a file manager")
    write_site(chosen, out)
    before = files_of(out)
    for change in (
        lambda: (out / "notes.txt").write_text("mine"),
        lambda: (out / "index.html").write_text("changed"),
        lambda: (out / "cases/first.js").unlink() or (out / "cases/first.js").symlink_to(tmp_path / "file"),
        lambda: (out / MARK).write_text("{}"),
    ):
        change()
        with pytest.raises(UsageError, match=r"somebody else|no site of heartcase"):
            write_site(chosen, out)
        (out / "notes.txt").unlink(missing_ok=True)
        for name, content in before.items():
            (out / name).unlink()
            (out / name).write_bytes(content)
    assert (tmp_path / "file").read_text() == "mine"
    write_site(chosen, out)
    assert leftovers(tmp_path) == []


@pytest.mark.parametrize("error", [KeyboardInterrupt, OSError])
def test_an_interruption_leaves_what_was_there(cases, tmp_path, error):
    out = tmp_path / "site"

    def stop(name):
        if name != "first":
            raise error

    with pytest.raises(error):
        write_site([SiteCase(case) for case in cases], out, say=stop)
    assert os.listdir(tmp_path) == []
    write_site([SiteCase(cases[0])], out)
    before = files_of(out)
    with pytest.raises(error):
        write_site([SiteCase(case) for case in cases], out, say=stop)
    assert files_of(out) == before
    assert leftovers(tmp_path) == []


def test_all_that_is_wrong_is_said_at_once(cases, tmp_path, capsys):
    twice = tmp_path / "other" / cases[0].name
    twice.mkdir(parents=True)
    with pytest.raises(UsageError) as found:
        write_site([SiteCase(cases[0]), SiteCase(twice), SiteCase(tmp_path / "ü.case")], tmp_path / "none/site")
    assert [one.place for one in found.value.problems] == ["CASE", "CASE", "--out"]
    first = str(cases[0])
    for options, words in (
        ([first, first, "--out", "x.html"], "give a name without .html"),
        ([first, "--web", "--out", "x.stl"], "a site is a folder"),
        ([first, first, "--out", "x.v2"], "add --web"),
        ([first, "--out", "x"], "needs --web"),
        ([first, first, "--out", "x", "--model", "solid"], "a page shows the hollow model"),
        ([first, first, "--out", "x", "--frames-per-second", "5"], "serves only with --recording"),
        ([first, "--out", "x.gif", "--recording", "a", "--recording", "b"], "give one"),
    ):
        assert main(["export", *options]) == 2
        assert words in capsys.readouterr().err


def test_a_patients_case_without_a_release_is_told_of(tmp_path, capsys):
    (case,) = write_cases(tmp_path, ["heart"], about=about(origin="patient"))
    assert main(["export", str(case), "--web", "--out", str(tmp_path / "site")]) == 0
    assert "do not publish this site" in capsys.readouterr().err


def test_hostile_texts_are_inert(tmp_path):
    hostile = "</script><img src=x onerror=alert(1)> \"'&"
    texts = {"en": {"title": hostile, "what": hostile, "look_for": hostile}}
    (case,) = write_cases(tmp_path, ["heart"], about=about(texts=texts, diagnoses=[{"name": hostile}]))
    write_site([SiteCase(case)], tmp_path / "site")
    index = (tmp_path / "site/index.html").read_text()
    assert "<img src=x" not in index
    assert "alert(1)" in index


def test_a_recording_is_played_on_the_page_of_its_case(tmp_path, capsys):
    (mine,) = write_cases(tmp_path, ["mine"])
    loaded = load_case(mine, needs=("surface", "tissue"))
    session = OperatingSession(Simulation(loaded.model, surface=loaded.surface, tissue=loaded.tissue))
    recorder = Recorder(session, tmp_path / "pull.recording", case=loaded.manifest)
    session.do(CloseGrab(name="hand", center_mm=tuple(np.float64(loaded.surface.rest_mm[0]).tolist()), radius_mm=6.0))
    session.advance(20)
    recorder.finish()
    command = ["export", str(mine), "--web", "--out", str(tmp_path / "site")]
    assert main([*command, "--recording", str(tmp_path / "pull.recording")]) == 0
    script = (tmp_path / "site/cases/mine.js").read_text()
    assert [one["name"] for one in contents_of(script.split('"')[1])[0]["recordings"]] == ["pull"]
    block = write_block(tmp_path)
    command = ["export", str(block), "--web", "--out", str(tmp_path / "blocks")]
    assert main([*command, "--recording", str(tmp_path / "pull.recording")]) == 2
    assert "pull is of none of these cases" in capsys.readouterr().err
