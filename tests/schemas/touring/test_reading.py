"""Tours as they are written, and what is wrong with them."""

from __future__ import annotations

import pytest

from heartcase.schemas.errors import ScriptError
from heartcase.schemas.touring.names import tour_problems
from heartcase.schemas.touring.reading import SIZE_MAX, load_tour, parse_tour, read_tour
from heartcase.schemas.touring.text import plain
from heartcase.schemas.touring.tour import PatchOver, SessionAct, Wait
from tests.hollow_case import hollow_case
from tests.simulator.touring.hollow_tour import TOUR

HEAD = '+++\nheartcase_tour = 1\ncase = "hollow"\n+++\n'
SMALL = HEAD + "# Title\n\n## Step\n\nWords.\n"


def problems(text):
    with pytest.raises(ScriptError) as caught:
        parse_tour(text)
    return [str(problem) for problem in caught.value.problems]


def test_a_tour_is_read_as_it_is_written():
    tour = parse_tour(TOUR)
    assert (tour.head.case, tour.head.language, tour.title) == ("hollow", "en", "Two rooms")
    assert [piece.strong for piece in tour.blocks[0].pieces] == [False, True, False]
    assert len(tour.steps) == 6
    assert TOUR.splitlines()[tour.steps[1].line - 1] == "## The hole"
    question = tour.steps[1].question
    assert [plain(one.pieces) for one in question.choices] == ["Three", "Four"]
    assert [one.is_right for one in question.choices] == [False, True]
    assert question.choices[1].reason[0][1].emphasis
    assert isinstance(tour.steps[4].acts[0], PatchOver)


def test_a_tag_that_is_opened_and_closed_is_told_once():
    assert [one for one in problems(SMALL.replace("Words.", "Some <b>words</b>")) if "HTML" in one] == [
        "line 9 (step 1): HTML is not shown in a tour"
    ]


def test_text_is_pieces_and_nothing_in_it_is_markup():
    tour = parse_tour(SMALL.replace("Words.", "A &lt;b&gt; `<i>` 5 < 6 **a *b* c**\n\n1. one\n2. *two*"))
    first, second = tour.steps[0].blocks
    assert plain(first.pieces) == "A <b> <i> 5 < 6 a b c"
    assert [(one.text, one.strong, one.emphasis) for one in first.pieces[1:]] == [
        ("a ", True, False),
        ("b", True, True),
        (" c", True, False),
    ]
    assert second.is_numbered
    assert [plain(item) for item in second.items] == ["one", "two"]


@pytest.mark.parametrize(
    ("text", "line", "words"),
    [
        ("<script>alert(1)</script>", 11, "HTML is not shown"),
        ("Some <b>words</b>", 11, "HTML is not shown"),
        ("A [link](https://example.org)", 11, "a link is not shown"),
        ("![alt](picture.png)", 11, "a picture is not shown"),
        ("> quoted", 11, "a quotation is not shown"),
        ("- one\n  - two", 11, "lists within lists"),
        ("#### Deep", 11, "headings are"),
        ("# Again", 11, "one title"),
        ("```python\nprint()\n```", 11, "not of TOML"),
        ("```toml\nview = 1\n```", 12, "view"),
        ("```toml\n[view]\nfrom = [0, 0, 0]\n```", 13, "view.from"),
        ("```toml\n[view]\nsqare = true\n```", 13, "did you mean 'square'"),
        ("```toml\nshow = ['a']\nhide = ['b']\n```", 12, "either show or hide"),
        ("```toml\nshow = [\n```", 12, "not valid TOML"),
        ("```toml\n[[do]]\nkind = 'wait'\nseconds = 0\n```", 14, "do[1].seconds"),
        ("```toml\n[[do]]\nkind = 'undo'\n```", 13, "no act of this kind"),
        ("```toml\n[[do]]\nkind = 'close_grab'\nname = 'h'\ncenter_mm = { near = 'apex' }\n```", 15, "towards"),
        ("```toml\n[[do]]\nkind = 'close_grab'\nname = 'h'\n```", 12, "center_mm: is missing"),
        ("### A question?", 11, "two answers or more"),
        ("### A question?\n\n- [ ] a\n- [ ] b", 11, "none of the answers is right"),
        ("### A question?\n\n- [x] a\n- [ ] b", 11, "say why"),
        ("### A question?\n\n- [x] a\n  - why\n- b", 15, "begins with [x]"),
    ],
)
def test_what_is_wrong_is_told_with_its_line(text, line, words):
    found = problems(SMALL + "\n" + text + "\n")
    assert any(f"line {line} (step 1)" in one and words in one for one in found), found


def test_all_problems_are_told_at_once():
    found = problems('+++\nheartcase_tour = 9\ncase = "x"\n+++\n## One\n\n<br>\n\n## Two\n')
    assert len(found) == 5
    assert "line 2" in found[0]
    assert "versions up to 1" in found[0]
    assert "no title" in " ".join(found)
    assert "this step says nothing" in " ".join(found)
    assert "line 1" in problems("# No head\n")[0]


def test_a_file_that_is_no_tour_is_refused(tmp_path):
    path = tmp_path / "a.tour.md"
    with pytest.raises(ScriptError, match="no such file"):
        load_tour(path)
    path.write_bytes(b"\xff\xfe")
    with pytest.raises(ScriptError, match="UTF-8"):
        load_tour(path)
    path.write_bytes(b" " * (SIZE_MAX + 1))
    with pytest.raises(ScriptError, match="larger than"):
        load_tour(path)


def test_places_may_be_names_in_commands_of_a_session():
    step = """
```toml
[[do]]
kind = "close_grab"
name = "hand"
center_mm = "lid"

[[do]]
kind = "lead_grab"
name = "hand"
offset_mm = { near = "lid", towards = "hole", by_mm = 4 }

[[do]]
kind = "wait"
seconds = 0.1
```
"""
    acts = parse_tour(SMALL + step).steps[0].acts
    assert isinstance(acts[0], SessionAct)
    assert isinstance(acts[2], Wait)
    manifest = hollow_case().manifest
    assert tour_problems(parse_tour(SMALL + step), manifest.landmarks, manifest.labels) == ()
    wrong = parse_tour(SMALL + step.replace('"lid"', '"lit"'))
    found = [str(one) for one in tour_problems(wrong, manifest.landmarks, manifest.labels)]
    assert len(found) == 2
    assert "do[1].center_mm" in found[0]
    assert "did you mean 'lid'?" in found[0]
    assert "do[2].offset_mm.near" in found[1]


def test_a_case_that_lacks_what_a_tour_names_is_told_so():
    manifest = hollow_case().manifest
    assert tour_problems(parse_tour(TOUR), manifest.landmarks, manifest.labels) == ()
    rest = [one for one in manifest.landmarks if one.name != "hole"]
    found = [str(one) for one in tour_problems(parse_tour(TOUR), rest, manifest.labels)]
    line = 1 + TOUR.splitlines().index("## The hole")
    assert any(f"line {line} (step 2): view.at" in one for one in found)
    assert any("cut_plane.through.near" in one for one in found)
    assert any("do[1].landmark: the case has no ring 'hole'" in one for one in found)
    assert tour_problems(parse_tour(TOUR.replace('"hole"', '"vessel"')), manifest.landmarks, manifest.labels)


@pytest.mark.parametrize(
    ("scene", "wrong", "lacking"),
    [
        (
            'show = ["no"]\n[view]\nat = { near = "nowhere" }',
            {"view.at.towards", "view.at.by_mm"},
            {"show", "view.at.near"},
        ),
        ('show = ["no", 3]', {"show[2]"}, {"show"}),
        ('hide = ["a/b", "no", "aorta"]', {"hide[1]"}, {"hide"}),
        ('show = ["no"]\nhide = ["nor this"]', {""}, {"show", "hide"}),
        ('show = "no"\n[view]\nat = "nowhere"', {"show"}, {"view.at"}),
        (
            'show = ["no"]\n[cut_plane]\nthrough = "nowhere"',
            {"cut_plane.removes"},
            {"show", "cut_plane.through"},
        ),
        ('[cut_plane]\nthrough = "nowhere"\nremoves = 3', {"cut_plane.removes"}, {"cut_plane.through"}),
        (
            '[cut_plane]\nthrough = { towards = "nowhere", by_mm = 2 }\nremoves = "no way"',
            {"cut_plane.through.near"},
            {"cut_plane.through.towards", "cut_plane.removes"},
        ),
        # square needs a landmark: it says nothing against where the eye is
        ('[view]\nsquare = true\nfrom = "nowhere"', {"view"}, {"view.from"}),
        ('view = 3\nshow = ["no"]', {"view"}, {"show"}),
        ('[[view]]\nat = "hole"\n[cut_plane]\nthrough = "nowhere"\nremoves = "front"', {"view"}, {"cut_plane.through"}),
        # the step has no view at all, and that its list is wrong does not hide it
        ('show = [3]\n[cut_plane]\nremoves = "front"', {"show[1]"}, {"cut_plane.through"}),
        # what is misspelt or wrong may be what says where the plane lies
        ('[veiw]\nat = "hole"\n[cut_plane]\nremoves = "front"', {"veiw"}, set()),
        ('[cut_plane]\ntrough = "hole"\nremoves = "front"', {"cut_plane.trough"}, set()),
        ('[cut_plane]\nthrough = 3\nremoves = "front"', {"cut_plane.through"}, set()),
    ],
)
def test_what_is_wrong_in_a_scene_hides_nothing_that_the_case_lacks(tmp_path, scene, wrong, lacking):
    path = tmp_path / "a.tour.md"
    path.write_text(f"{SMALL}\n```toml\n{scene}\n```\n")
    read, manifest = read_tour(path), hollow_case().manifest

    def places(problems):
        return [one.place.partition(": ")[2] for one in problems]

    assert sorted(places(read.problems)) == sorted(wrong)
    assert sorted(places(tour_problems(read, manifest.landmarks, manifest.labels))) == sorted(lacking)
    assert all(one.place.startswith("line ") for one in read.problems)
