"""The catalogue: what it shows and refuses, what hostile texts become, what it writes and removes."""

from __future__ import annotations

import json
import os
import re
import shutil
import subprocess
from collections import Counter
from html.parser import HTMLParser
from pathlib import Path
from urllib.parse import unquote

import pytest

from heartcase.cli.main import main
from heartcase.schemas.bundle.reader import open_bundle
from heartcase.schemas.errors import UsageError
from heartcase.schemas.labels import Label, LabelTable, Role, default_label_table
from heartcase.studio.catalogue.pages import words_script
from heartcase.studio.catalogue.site import write_catalogue
from heartcase.studio.catalogue.words import WORDS
from heartcase.studio.offline.oxygenation import Oxygen, oxygenation
from tests.cli.small_case import write_case
from tests.simulator.touring.hollow_tour import TOUR

ASSETS = Path(__file__).parents[3] / "heartcase/studio/catalogue/assets"
HOSTILE = "</script><script>alert(1)</script><img src=x onerror=alert(2)> \"'&\u2028\u2029 {{ 7*7 }}"
VOID = {"area", "base", "br", "col", "embed", "hr", "img", "input", "link", "meta", "source", "track", "wbr"}


def about(**changes):
    text = {"title": "A heart", "what": "What it is.\n\nMore.", "look_for": "The septum."}
    return {
        "origin": "synthetic",
        "licence": "CC0-1.0",
        "attribution": "Nobody",
        "diagnoses": [{"name": "Ventricular septal defect", "ipccc": "07.10.00", "synonyms": ["VSD"]}],
        "texts": {"en": text},
        **changes,
    }


@pytest.fixture(scope="module")
def toy(tmp_path_factory):
    path, _ = write_case(tmp_path_factory.mktemp("toy"), with_level=True, with_map=True)
    return path


@pytest.fixture(autouse=True)
def small_pictures(monkeypatch):
    monkeypatch.setattr("heartcase.studio.offline.pictures.PICTURE_SIZE", (80, 60))


@pytest.fixture
def library(toy, tmp_path):
    """Adds a case to a library: its name, and what its manifest says instead."""
    folder = tmp_path / "library"

    def add(name, **manifest):
        case = folder / f"{name}.case"
        shutil.copytree(toy, case, dirs_exist_ok=True)
        data = json.loads((toy / "case.json").read_text())
        (case / "case.json").write_text(json.dumps({**data, "name": name, **manifest}))
        return folder

    return add


def files_of(folder):
    return {path.relative_to(folder).as_posix(): path for path in sorted(folder.rglob("*")) if path.is_file()}


def handed_over(script):
    """The data in a script that calls a function with it."""
    return json.loads(script.strip()[script.index("(") + 1 : -2])


class Page(HTMLParser):
    """A page's elements, its text, and what is not well formed."""

    def __init__(self, text):
        super().__init__()
        self.elements, self.text, self.open, self.faults = [], "", [], []
        self.feed(text)
        self.close()
        self.faults += [f"{tag} is not closed" for tag in self.open]

    def handle_starttag(self, tag, attrs):
        self.elements.append((tag, dict(attrs)))
        if tag not in VOID:
            self.open.append(tag)

    def handle_endtag(self, tag):
        if not self.open or self.open.pop() != tag:
            self.faults.append(f"</{tag}> closes something else")

    def handle_data(self, data):
        self.text += data

    def all(self, tag):
        return [attrs for name, attrs in self.elements if name == tag]


def test_cases_are_shown_with_what_they_say(library):
    texts = {**about()["texts"], "de": {"title": "Ein Herz", "what": "Was", "look_for": "Wo", "access": "Womit"}}
    landmark = {"name": "atriotomy", "kind": "polyline", "points_mm": [[0, 0, 0], [5, 0, 0]], "depth_mm": 4.0}
    cases = library("first", about=about(texts=texts, segmental="{S,D,S}"), landmarks=[landmark])
    (cases / "first.report.html").write_text("<p>report</p>")
    result = write_catalogue(cases)
    assert (result.shown, result.made, result.refused) == (("first",), ("first",), {})
    assert result.index == cases / "catalogue" / "index.html"
    page = Page((cases / "catalogue/cases/first.html").read_text())
    for words in ("A heart", "Ein Herz", "07.10.00", "VSD", "{S,D,S}", "atriotomy", "CC0-1.0", "Not a medical device"):
        assert words in page.text
    assert "A warning for the reader." in page.text
    hrefs = [attrs["href"] for attrs in page.all("a")]
    assert "../../first.report.html" in hrefs
    assert {"../../first.case/case.json"} < {href for href in hrefs if href.startswith("../../first.case/")}
    (card,) = handed_over((cases / "catalogue/data/index.js").read_text())
    assert card["titles"] == {"de": "Ein Herz", "en": "A heart"}
    assert (card["doubtful"], card["origin"]) == (1, "synthetic")


def test_warnings_stand_under_what_they_matter_and_only_doubts_count(library):
    texts, grades = ["a hole", "a look", "a note"], ["anatomy", "look", "note"]
    library("graded", about=about(), warnings=texts, warning_grades=grades)
    library("older", about=about(), warnings=texts, warning_grades=[])
    cases = library("noted", about=about(), warnings=["a note"], warning_grades=["note"])
    write_catalogue(cases)
    cards = handed_over((cases / "catalogue/data/index.js").read_text())
    assert {card["name"]: card["doubtful"] for card in cards} == {"graded": 2, "noted": 0, "older": 3}
    text = {name: Page((cases / f"catalogue/cases/{name}.html").read_text()).text for name in ("graded", "noted")}
    found = [
        text["graded"].index(words) for words in ("A hole.", "Look with care.", "For your information.", "A note.")
    ]
    assert found == sorted(found)
    assert "The checks found nothing wrong." in text["noted"]
    assert "The checks found nothing wrong." not in text["graded"]
    assert not any("before you approve" in one for one in text.values())


def test_patients_without_a_release_and_cases_without_about_are_refused(library, capsys):
    release = {"reference": "R-1", "scope": "public", "date": "2026-01-01"}
    library("silent")
    library("closed", about=about(origin="patient"))
    cases = library("open", about=about(origin="patient", release=release))
    assert main(["library", "catalogue", str(cases), "--json"]) == 1
    said = json.loads(capsys.readouterr().out)
    assert said["shown"] == ["open"]
    assert said["refused"]["closed"][0][0] == "about.release"
    assert "no release is recorded" in said["refused"]["closed"][0][1]
    assert "add [about] to its recipe" in said["refused"]["silent"][0][1]
    written = " ".join(files_of(cases / "catalogue"))
    assert "cases/open.html" in written
    assert "cases/closed" not in written
    assert "pictures/closed" not in written
    assert "view/silent" not in written


def test_a_release_that_is_withdrawn_takes_the_page_away(library):
    release = {"reference": "R-1", "scope": "public", "date": "2026-01-01"}
    cases = library("heart", about=about(origin="patient", release=release))
    write_catalogue(cases)
    library("heart", about=about(origin="patient"))
    result = write_catalogue(cases)
    assert (result.shown, result.removed, set(result.refused)) == ((), ("heart",), {"heart"})
    left = files_of(cases / "catalogue")
    assert not [path for path in left if path.startswith(("cases/", "view/", "pictures/"))]
    assert not any("A heart" in path.read_text() for path in left.values() if path.suffix in (".js", ".html", ".json"))
    assert set(write_catalogue(cases).refused) == {"heart"}


def test_damaged_cases_and_names_that_cannot_be_addresses_are_refused(library):
    library("torn", about=about())
    cases = library("good", about=about())
    (cases / "torn.case" / "case.json").write_text("{")
    (cases / "a'b<c>.case").mkdir()
    result = write_catalogue(cases)
    assert result.shown == ("good",)
    assert set(result.refused) == {"torn", "a'b<c>"}


def test_names_that_differ_in_upper_and_lower_case_alone_are_refused(library):
    library("heart", about=about())
    cases = library("good", about=about())
    shutil.copytree(cases / "heart.case", cases / "Heart.case")
    result = write_catalogue(cases)
    assert result.shown == ("good",)
    assert set(result.refused) == {"heart", "Heart"}
    assert "but for upper and lower case" in result.refused["heart"][0].message
    shutil.rmtree(cases / "Heart.case")
    assert write_catalogue(cases).shown == ("good", "heart")


def test_hostile_texts_are_inert(library):
    texts = {"en": {"title": HOSTILE.replace("\u2028\u2029", ""), "what": HOSTILE, "look_for": HOSTILE}}
    hostile = about(
        licence=HOSTILE[:60], attribution=HOSTILE, texts=texts, diagnoses=[{"name": HOSTILE, "synonyms": [HOSTILE]}]
    )
    label = open_bundle(library("a (b)+c", about=hostile, warnings=[HOSTILE], notice=HOSTILE) / "a (b)+c.case")
    assert label.manifest.about is not None
    cases = label.directory.parent
    (cases / "a (b)+c.report.html").write_text("")
    assert write_catalogue(cases).shown == ("a (b)+c",)
    site = cases / "catalogue"
    for path in files_of(site).values():
        if path.suffix == ".html":
            page = Page(path.read_text())
            assert not page.faults
            assert all({"src", "defer"} == set(script) for script in page.all("script"))
            assert not [name for _, attrs in page.elements for name in attrs if name.startswith("on")]
            assert not [attrs for attrs in page.all("img") if attrs["src"] == "x"]
            assert "style" not in {name for _, attrs in page.elements for name in attrs}
    assert "alert(1)" in Page((site / "cases/a (b)+c.html").read_text()).text
    for name in ("data/index.js", "view/a (b)+c.js"):
        script = (site / name).read_text()
        assert script.isascii()
        assert not set("<>&") & set(script)
    (card,) = handed_over((site / "data/index.js").read_text())
    assert card["diagnoses"][0]["name"] == HOSTILE


@pytest.fixture
def site(library):
    release = {"reference": "R-1", "scope": "public", "date": "2026-01-01"}
    texts = {**about()["texts"], "de": {"title": "Herz", "what": "Was", "look_for": "Wo", "access": "Womit"}}
    library("one", about=about(texts=texts))
    cases = library("two of them", about=about(origin="patient", release=release))
    write_catalogue(cases)
    return cases / "catalogue"


def test_every_link_leads_somewhere(site):
    for path in files_of(site).values():
        if path.suffix != ".html":
            continue
        page = Page(path.read_text())
        ids = {attrs["id"] for _, attrs in page.elements if "id" in attrs}
        links = [
            attrs[name]
            for _, attrs in page.elements
            for name in ("href", "src", "data-case")
            if attrs.get(name) is not None
        ]
        assert links
        for link in links:
            target, _, fragment = link.partition("#")
            if link == "data:,":
                continue
            assert not re.match(r"[a-z]+:|/", target), link
            assert (path.parent / unquote(target)).exists(), link
            assert target or fragment in ids, link
    for card in handed_over((site / "data/index.js").read_text()):
        assert (site / "cases" / f"{card['name']}.html").is_file()
        assert (site / "pictures" / f"{card['name']}.small.webp").is_file()


def test_pages_are_sound_html(site):
    # those of the 3-D view are tried in a browser
    pages = [path for path in files_of(site).values() if path.suffix == ".html" and path.parent.name != "view"]
    assert len(pages) == 4
    for path in pages:
        text = path.read_text()
        page = Page(text)
        assert not page.faults, path
        assert text.startswith("<!DOCTYPE html>")
        assert page.all("html")[0]["lang"] == "en"
        ids = Counter(attrs["id"] for _, attrs in page.elements if "id" in attrs)
        assert not [one for one, count in ids.items() if count > 1]
        labelled = {attrs["for"] for attrs in page.all("label")}
        assert labelled <= set(ids)
        for tag in ("input", "select"):
            assert {attrs["id"] for attrs in page.all(tag)} <= labelled
        assert all("alt" in attrs for attrs in page.all("img"))
        assert all(attrs.get("type") in ("button", "reset") for attrs in page.all("button"))
        for _, attrs in page.elements:
            for name in ("aria-labelledby", "aria-describedby"):
                assert set(attrs.get(name, "").split()) <= set(ids)
            assert attrs.get("data-word", "back") in WORDS
            assert attrs.get("data-word-label", "back") in WORDS
        assert len(page.all("h1")) == len(page.all("main")) == 1
        assert any(attrs.get("class") == "skip" for attrs in page.all("a"))
        policy = next(a["content"] for a in page.all("meta") if a.get("http-equiv") == "Content-Security-Policy")
        assert "unsafe" not in policy


def test_words_are_there_in_both_languages():
    assert all(english and german for english, german in WORDS.values())
    for english, german in WORDS.values():
        assert sorted(re.findall(r"{\w+}", english)) == sorted(re.findall(r"{\w+}", german))
    used = set(re.findall(r'\bword\("(\w+)"', "".join((ASSETS / name).read_text() for name in os.listdir(ASSETS))))
    assert used <= set(WORDS)
    script = words_script(["en", "de", "qaa"])
    assert '["qaa","qaa"]' in script
    assert "\\u" in words_script(["en", "ja"])


def test_a_second_run_writes_nothing_and_a_changed_case_is_made_again(library, site):
    cases = site.parent
    before = {name: path.stat().st_mtime_ns for name, path in files_of(site).items()}
    result = write_catalogue(cases)
    assert (result.made, result.removed) == ((), ())
    assert {name: path.stat().st_mtime_ns for name, path in files_of(site).items()} == before
    library("one", about=about(licence="CC-BY-4.0"))
    assert write_catalogue(cases).made == ("one",)
    assert "CC-BY-4.0" in (site / "cases/one.html").read_text()
    after = {name: path.stat().st_mtime_ns for name, path in files_of(site).items()}
    changed = {name for name in before if after[name] != before[name]}
    assert "cases/one.html" in changed
    assert not [name for name in changed if "two of them" in name or name.startswith(("assets/", "index"))]
    (site / "view/one.js").unlink()
    assert write_catalogue(cases).made == ("one",)
    assert (site / "view/one.js").is_file()


def test_pages_of_cases_that_are_gone_go_and_nothing_else_does(site):
    cases = site.parent
    (site / "cases/notes.html").write_text("mine")
    (site / "pictures/two of them.front.webp").write_bytes(b"mine, too")
    shutil.rmtree(cases / "two of them.case")
    result = write_catalogue(cases)
    assert (result.shown, result.removed) == (("one",), ("two of them",))
    left = files_of(site)
    assert "cases/two of them.html" not in left
    assert "view/two of them.js" not in left
    assert left["cases/notes.html"].read_text() == "mine"
    assert left["pictures/two of them.front.webp"].read_bytes() == b"mine, too"
    assert "two of them" not in left["data/index.js"].read_text()


def test_what_somebody_else_wrote_is_not_written_over(library, tmp_path):
    cases = library("one", about=about())
    (tmp_path / "web").mkdir()
    (tmp_path / "web/index.html").write_text("mine")
    with pytest.raises(UsageError, match="did not write"):
        write_catalogue(cases, tmp_path / "web")
    site = tmp_path / "site"
    write_catalogue(cases, site)
    (site / "cases/two.html").write_text("mine")
    library("two", about=about())
    result = write_catalogue(cases, site)
    assert result.shown == ("one",)
    assert "move it away" in result.refused["two"][0].message
    assert (site / "cases/two.html").read_text() == "mine"
    assert "../../library/one.case/" in (site / "cases/one.html").read_text()


def test_an_interrupted_run_goes_on_where_it_stopped(library, monkeypatch):
    library("one", about=about())
    cases = library("two", about=about())
    from heartcase.studio.catalogue import site

    whole = site.case_page

    def stopped(entry, **options):
        if entry.name == "two":
            raise KeyboardInterrupt
        return whole(entry, **options)

    monkeypatch.setattr(site, "case_page", stopped)
    with pytest.raises(KeyboardInterrupt):
        write_catalogue(cases)
    monkeypatch.undo()
    result = write_catalogue(cases)
    assert (result.shown, result.made) == (("one", "two"), ("two",))


def test_a_ledger_that_somebody_changed_does_no_harm(site, tmp_path):
    (tmp_path / "precious").write_text("mine")
    path = site / ".heartcase-catalogue" / "one.json"
    sound = json.loads(path.read_text())
    far = {**sound["files"], "../../../precious": "0" * 64, "/etc/hosts": "0" * 64}
    for damage in ("{", "[]", json.dumps({**sound, "files": far}), json.dumps({**sound, "card": {"name": 3}})):
        path.write_text(damage)
        shutil.rmtree(site / "cases")
        assert write_catalogue(site.parent).shown == ("one", "two of them")
        assert (site / "cases/one.html").is_file()
        assert (tmp_path / "precious").read_text() == "mine"


def test_odd_figures_of_other_versions_do_not_stop_a_page(library):
    odd = {"surface": {"distance_p99_mm": "far", "triangle_count": {"x": {"y": 1}}}, "grid": 7, "volumes_ml": [1]}
    odd["openings"] = [3, {"between": ["a"]}, {"between": ["a", "b"], "area_mm2": 10**30, "verdict": "stated"}]
    cases = library("one", about=about(), quality=odd)
    assert write_catalogue(cases).shown == ("one",)
    (card,) = handed_over((cases / "catalogue/data/index.js").read_text())
    assert card["p99"] is None


def test_openings_and_rings_are_told_in_a_students_words(library):
    pair = {"between": ["left ventricle", "right ventricle"], "area_mm2": 110.0, "verdict": "stated"}
    openings = [pair | {"stated_by": "edits[1]"}, pair | {"stated_by": "the landmark 'VSD'"}]
    ring = {"name": "mid muscular defect", "kind": "ring", "points_mm": [[0, 0, 0]], "axis": [0, 0, 1], "radius_mm": 6}
    drawn = {"name": "drawn", "kind": "ring", "points_mm": [[3, 0, 0], [0, 3, 0], [-3, 0, 0], [0, -3, 0]]}
    cases = library("one", about=about(), quality={"openings": openings}, landmarks=[ring, drawn])
    write_catalogue(cases)
    text = Page((cases / "catalogue/cases/one.html").read_text()).text
    assert "edits[" not in text
    assert "meant here: the hole was made in the model" in text
    assert "meant here: the landmark 'VSD'" in text
    assert "ring, ⌀ 12 mm" in text
    assert "ring, ⌀ 6 mm" in text


def test_folders_without_cases_are_refused(tmp_path, capsys):
    assert main(["library", "catalogue", str(tmp_path / "none")]) == 1
    assert main(["library", "catalogue", str(tmp_path)]) == 2
    assert "no case in this folder" in capsys.readouterr().err


def test_a_case_without_a_surface_has_a_page(library):
    cases = library("one", about=about())
    case = cases / "one.case"
    data = json.loads((case / "case.json").read_text())
    data["files"] = [file for file in data["files"] if file["role"] in ("grid", "labels")]
    (case / "case.json").write_text(json.dumps(data))
    assert write_catalogue(cases).shown == ("one",)
    page = Page((cases / "catalogue/cases/one.html").read_text())
    assert not page.faults
    assert not page.all("img")
    assert WORDS["no_surface"][0] in page.text
    (card,) = handed_over((cases / "catalogue/data/index.js").read_text())
    assert not card["picture"]


def test_a_case_whose_surface_is_tied_to_nothing_is_shown_in_pictures_alone(library):
    cases = library("one", about=about())
    case = cases / "one.case"
    data = json.loads((case / "case.json").read_text())
    data["files"] = [file for file in data["files"] if not file["role"].startswith("mapping")]
    (case / "case.json").write_text(json.dumps(data))
    assert write_catalogue(cases).shown == ("one",)
    site = cases / "catalogue"
    assert not (site / "view").exists()
    page = Page((site / "cases/one.html").read_text())
    assert len(page.all("img")) == 2
    assert WORDS["no_map"][0] in page.text
    assert not [attrs for attrs in page.all("a") if attrs.get("id") == "open-view"]


def test_a_tour_that_is_wrong_is_told_in_every_run_and_its_case_is_shown(library, capsys):
    cases = library("one", about=about())
    wrong = TOUR.replace("heartcase_tour = 1", "heartcase_tour = 1\ncolour = 3")
    (cases / "one.tour.md").write_text(wrong)
    first = write_catalogue(cases)
    assert first.made == ("one",)
    assert ["colour" in str(one) for one in first.warnings["one"]] == [True]
    again = write_catalogue(cases)
    assert (again.made, again.warnings) == ((), first.warnings)
    main(["library", "catalogue", str(cases)])
    assert "one: warning: " in capsys.readouterr().err
    (cases / "one.tour.md").unlink()
    assert write_catalogue(cases).warnings == {}


def test_all_cases_share_one_viewer(library):
    library("one", about=about())
    cases = library("two", about=about())
    write_catalogue(cases)
    site = cases / "catalogue"
    for name in ("one", "two"):
        page = Page((site / f"view/{name}.html").read_text())
        assert [attrs["src"] for attrs in page.all("script")] == ["../assets/viewer.js"]
        assert page.all("body")[0]["data-case"] == f"{name}.js"
        opened = next(
            attrs
            for attrs in Page((site / f"cases/{name}.html").read_text()).all("a")
            if attrs.get("id") == "open-view"
        )
        assert opened["href"] == f"../view/{name}.html"
    assert (site / "view/one.js").read_bytes() != b""


def test_texts_in_other_languages_are_offered_or_left_out(library):
    text = about()["texts"]["en"]
    texts = {"en": text, "fr": {**text, "title": "Un coeur", "access": "Par ici"}, "ja": {**text, "title": "Kokoro"}}
    cases = library("one", about=about(texts=texts))
    site = cases / "catalogue"
    write_catalogue(cases)
    words = (site / "assets/words.js").read_text()
    assert [code for code in ("en", "de", "fr", "ja") if f'["{code}",' in words] == ["en", "de", "fr", "ja"]
    page = Page((site / "cases/one.html").read_text())
    assert [attrs["data-only"] for _, attrs in page.elements if "data-only" in attrs] == ["fr"]
    assert {attrs["data-text"] for _, attrs in page.elements if "data-text" in attrs} == {"en", "fr", "ja"}
    assert all(attrs["lang"] == attrs["data-text"] for _, attrs in page.elements if "data-text" in attrs)
    shown = [attrs["data-text"] for _, attrs in page.elements if "data-text" in attrs and "hidden" not in attrs]
    assert set(shown) == {"en"}
    assert write_catalogue(cases, languages=["fr"]).made == ("one",)
    assert "Kokoro" not in (site / "cases/one.html").read_text()
    assert '["ja",' not in (site / "assets/words.js").read_text()


TABLE = LabelTable(
    labels=(
        *default_label_table().with_walls(),
        Label(value=40, name="pulmonary vein", role=Role.VESSEL_LUMEN),
        Label(value=41, name="left atrial appendage", role=Role.BLOOD),
        Label(value=42, name="patch", role=Role.DEVICE),
    )
)
LV, RV, LA, RA, AO, PA, SVC, IVC, LVM = range(1, 10)
PV, LAA, PATCH = 40, 41, 42
NORMAL = [(LV, LA), (LV, AO), (RV, RA), (RV, PA), (RA, SVC), (RA, IVC), (LA, PV)]


def blood(pairs, *, verdict="stated", without=()):
    openings = [{"labels": list(pair), "verdict": verdict} for pair in pairs if pair not in without]
    found = oxygenation(TABLE, openings)
    names = {LV: "LV", RV: "RV", LA: "LA", RA: "RA", AO: "AO", PA: "PA"}
    return {name: found.of_label[value].value for value, name in names.items()}, found


def test_blood_of_a_normal_heart():
    held, found = blood(NORMAL, verdict="expected")
    assert held == {"LV": "rich", "LA": "rich", "AO": "rich", "RV": "poor", "RA": "poor", "PA": "poor"}
    assert found.is_from_openings
    assert not found.joined
    assert found.of_label[LVM] is found.of_label[LAA] is Oxygen.RICH
    assert found.of_label[PATCH] is Oxygen.UNKNOWN
    assert found.of_label[TABLE.wall_value(PA)] is Oxygen.POOR


def test_blood_of_malformed_hearts():
    # Transposition: the great arteries arise from the other ventricles.
    held, _ = blood([*NORMAL, (LV, PA), (RV, AO)], without=[(LV, AO), (RV, PA)])
    assert (held["AO"], held["PA"], held["LV"]) == ("poor", "rich", "rich")
    # Discordant at both levels, as in the corrected kind: the aorta has rich blood, from the right ventricle.
    pairs = [(RA, LV), (LV, PA), (LA, RV), (RV, AO), (RA, SVC), (LA, PV)]
    held, _ = blood(pairs)
    assert (held["LV"], held["RV"], held["AO"], held["PA"]) == ("poor", "rich", "rich", "poor")
    # A ventricular septal defect joins two that both have a way out.
    held, found = blood([*NORMAL, (LV, RV)])
    assert (held["LV"], held["RV"], held["AO"], held["PA"]) == ("mixed", "mixed", "rich", "poor")
    assert found.joined == ((TABLE[LV].name, TABLE[RV].name),)
    # Tricuspid atresia: all blood of the right atrium must cross to the left.
    held, found = blood([*NORMAL, (LA, RA), (LV, RV)], without=[(RV, RA)])
    assert held == {"RA": "poor", "LA": "mixed", "LV": "mixed", "AO": "mixed", "RV": "mixed", "PA": "mixed"}
    assert not found.joined
    # An aorta above both ventricles.
    held, _ = blood([*NORMAL, (LV, RV), (RV, AO)])
    assert held["AO"] == "mixed"
    # All pulmonary veins to the right atrium.
    held, _ = blood([*NORMAL, (RA, PV), (LA, RA)], without=[(LA, PV)])
    assert set(held.values()) == {"mixed"}
    # Pulmonary atresia: the artery is fed from the aorta.
    held, _ = blood([*NORMAL, (AO, PA)], without=[(RV, PA)])
    assert (held["PA"], held["AO"], held["RV"]) == ("rich", "rich", "poor")
    # And with a ventricular septal defect: the right ventricle has no other way out.
    held, _ = blood([*NORMAL, (LV, RV), (AO, PA)], without=[(RV, PA)])
    assert (held["RV"], held["LV"], held["AO"], held["PA"]) == ("poor", "mixed", "mixed", "mixed")


@pytest.mark.parametrize(
    "openings",
    [None, 7, "text", [], [3, {}], [{"labels": [1]}], [{"labels": ["a", "b"], "verdict": "stated"}],
     [{"labels": [1, 200], "verdict": "expected"}], [{"labels": [1, 2], "verdict": "unexpected"}], {"labels": [1, 2]}],
)  # fmt: skip
def test_without_sound_openings_blood_goes_by_structure(openings):
    found = oxygenation(TABLE, openings)
    assert not found.is_from_openings
    assert (found.of_label[AO], found.of_label[PA]) == (Oxygen.RICH, Oxygen.POOR)


NODE = """
const finder = require(process.argv[1] + "/finder.js");
const assert = require("assert");
const card = {name: "x", titles: {en: "H\\u00e9art"}, 
  diagnoses: [{name: "Tetralogy", more: ["TOF"], codes: ["LA88.2"]}], origin: "patient", doubtful: 1};
card.haystack = finder.haystack(card);
const fits = (words, more) => finder.fits(card, {words: words, diagnosis: "", origin: "", clean: false, ...more});
assert(fits(["heart"]) && fits(["tof", "la88"]) && !fits(["asd"]));
assert(fits([], {diagnosis: "tetralogy", origin: "patient"}) && !fits([], {clean: true}));
"""


@pytest.mark.skipif(shutil.which("node") is None, reason="there is no node on this machine")
def test_the_scripts_by_themselves():
    for name in sorted(os.listdir(ASSETS)):
        if name.endswith(".js"):
            subprocess.run(["node", "--check", str(ASSETS / name)], check=True)
    subprocess.run(["node", "-e", NODE, str(ASSETS)], check=True)
