"""Warnings: the worst first, each once, and what they are about survives the cache."""

import dataclasses
import itertools
import json
import re
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import heartcase
from heartcase.pipeline.artifacts.serialise import History, artifact_from_bytes, artifact_to_bytes
from heartcase.pipeline.data import Scan
from heartcase.pipeline.vessel_ends.cut_ends import closed_vessels
from heartcase.pipeline.warnings import (
    CaseWarning,
    WarningGrade,
    WarningParts,
    anatomy,
    counted,
    grouped,
    note,
    of_edit,
    warning_from_json,
    warning_to_json,
    worst_first,
)
from heartcase.pipeline.watershed.segment_scan import segmentation_warnings
from heartcase.schemas.errors import StageError
from tests.pipeline.report.analytic_heart import make_heart

warnings = st.builds(CaseWarning, st.sampled_from("abcdef"), st.sampled_from(WarningGrade))
coordinates = st.floats(-500.0, 500.0).map(lambda value: round(value, 1))
any_warnings = st.builds(
    CaseWarning,
    st.sampled_from(("a wall", "aorta: edits[2] is near", 'with "quotes" and mm²')),
    st.sampled_from(WarningGrade),
    st.sampled_from(("", "wall-gap")),
    places_mm=st.lists(st.tuples(coordinates, coordinates, coordinates), max_size=2).map(tuple),
    listed=st.lists(st.sampled_from(("one", "other")), max_size=3).map(tuple),
    has_stated_grade=st.booleans(),
) | st.builds(of_edit, st.integers(1, 40), st.sampled_from(("odd", "edits[3]: no")), st.sampled_from(WarningGrade))


def scan_with(*told):
    heart = make_heart(spacing_mm=(8.0, 8.0, 8.0))
    return Scan(heart.scan.values, heart.scan.geometry, "CT", warnings=told)


@settings(deadline=None)
@given(st.lists(st.lists(warnings, max_size=6), max_size=4))
def test_the_worst_come_first_each_once_with_its_worst_grade(sources):
    result = worst_first(*sources)
    every = [warning for source in sources for warning in source]
    texts = [warning.text for warning in every]
    assert sorted(warning.text for warning in result) == sorted(set(texts))
    assert all(a.grade.rank <= b.grade.rank for a, b in itertools.pairwise(result))
    for warning in result:
        assert warning.grade.rank == min(other.grade.rank for other in every if other.text == warning.text)
    # Those that matter alike keep the order in which they came.
    for a, b in itertools.pairwise(result):
        if a.grade == b.grade:
            assert texts.index(a.text) < texts.index(b.text)


def test_what_a_warning_is_about_stays_with_it_when_it_is_sorted():
    place = (1.0, 2.0, 3.0)
    first, second = anatomy("a gap", code="wall-gap", places_mm=[place]), of_edit(3, "odd", WarningGrade.NOTE)
    worse = of_edit(3, "odd", WarningGrade.LOOK)
    assert worst_first([second], [first], [worse]) == (first, worse)


def test_a_warning_is_something_to_look_at_where_nothing_else_is_said():
    assert CaseWarning("x").grade is WarningGrade.LOOK
    assert [str(one) for one in worst_first([CaseWarning("info"), note("n"), anatomy("a")])] == ["a", "info", "n"]


def test_a_warning_cannot_be_changed_and_is_no_text():
    warning = anatomy("a wall")
    with pytest.raises(dataclasses.FrozenInstanceError):
        warning.text = "another"
    assert not isinstance(warning, str)


@given(any_warnings)
def test_a_warning_is_written_and_read_back_whole(warning):
    written = json.loads(json.dumps(warning_to_json(warning)))
    back = warning_from_json(written)
    assert back == warning
    assert warning_to_json(back) == warning_to_json(warning)


def test_what_stages_wrote_before_is_written_alike():
    """The JSON of stage outputs of known versions: changing it would change hashes of outputs that stay the same."""
    assert warning_to_json(CaseWarning("plain")) == "plain"
    assert warning_to_json(CaseWarning("look", has_stated_grade=True)) == {"severity": "LOOK", "text": "look"}
    assert warning_to_json(anatomy("a wall")) == {"severity": "ANATOMY", "text": "a wall"}
    assert warning_to_json(note("a speck")) == {"severity": "NOTE", "text": "a speck"}
    edited = {"severity": "NOTE", "text": "edits[3]: 'cavity' is one piece"}
    assert warning_to_json(of_edit(3, "'cavity' is one piece", WarningGrade.NOTE)) == edited
    assert warning_to_json(of_edit(1, "odd", WarningGrade.LOOK)) == "edits[1]: odd"


def test_the_number_of_an_edit_is_found_again_in_what_was_written():
    assert warning_from_json({"severity": "NOTE", "text": "edits[3]: 'cavity' is one piece"}).edit == 3
    assert warning_from_json("edits[12]: odd").edit == 12
    assert warning_from_json("the opening lies at edits[3]").edit is None
    assert warning_from_json("strokes[3]: outside").edit is None


def test_warnings_survive_the_cache_and_the_history():
    told = (
        CaseWarning("plain"),
        anatomy("a wall", code="wall-gap", places_mm=((1.04, -0.01, 3.0),)),
        note("a speck"),
        of_edit(2, "odd", WarningGrade.NOTE),
    )
    scan = scan_with(*told)
    back = artifact_from_bytes(artifact_to_bytes(scan), Scan).warnings
    assert back == told
    assert back[1].places_mm == ((1.0, 0.0, 3.0),)
    assert artifact_to_bytes(scan) == artifact_to_bytes(scan_with(*back))
    assert History.from_json(History(told={"scan": told}).as_json()).told == {"scan": told}


@pytest.mark.parametrize(
    "damage",
    [
        b'{"severity": "WORSE", "text": "x"}',
        b'{"severity": "NOTE", "text": "x", "places_mm": [[1, 2]]}',
        b'{"severity": "NOTE", "text": "x", "places_mm": [[1, 2, "z"]]}',
        b"7",
        b"[]",
        b"null",
    ],
)
def test_damaged_warnings_are_refused(damage):
    content = artifact_to_bytes(scan_with(CaseWarning("xyzzy")))
    escaped = b'\\\\\\"xyzzy\\\\\\"'
    assert content.count(escaped) == 1
    quoted = damage.replace(b'"', b'\\\\\\"')
    head = int.from_bytes(content[:8], "little") + len(quoted) - len(escaped)
    with pytest.raises(StageError, match="another version"):
        artifact_from_bytes(head.to_bytes(8, "little") + content[8:].replace(escaped, quoted), Scan)


def test_groups_are_headed_in_plain_words_worst_first():
    groups = grouped([note("it is small"), CaseWarning("the 'x' looks odd"), anatomy("a wall has a hole: mend it.")])
    assert [group.title for group in groups] == ["The anatomy may be wrong", "Look at this", "For your information"]
    assert [group.lines for group in groups] == [
        ("A wall has a hole: mend it.",),
        ("The 'x' looks odd.",),
        ("It is small.",),
    ]
    assert grouped([]) == ()


def test_what_a_warning_lists_can_be_shown_as_a_list():
    one = CaseWarning("these touch: a and b; c and d. Say so", listed=("a and b", "c and d"))
    assert one.parts == WarningParts("These touch:", ("a and b", "c and d"), "Say so.")
    assert one.sentence == "These touch: a and b; c and d. Say so."
    # one thing is no list, and neither is what the text does not have
    assert CaseWarning("these touch: a and b. Say so", listed=("a and b",)).parts == WarningParts(
        "These touch: a and b. Say so."
    )
    assert CaseWarning("odd", listed=("a", "b")).parts == WarningParts("Odd.")


def test_an_aorta_without_an_end_outranks_a_loose_piece():
    heart = make_heart(spacing_mm=(4.0, 4.0, 4.0))
    labels = heart.segmentation.labels.copy()
    labels[0, 0, 0] = 9
    segmentation = type(heart.segmentation)(labels, heart.segmentation.geometry, heart.table)
    found = worst_first(segmentation_warnings(segmentation), closed_vessels(segmentation, ()))
    assert "the aorta ends in a closed sac" in found[0].text
    assert found[0].grade is WarningGrade.ANATOMY
    pieces = next(warning for warning in found if "pieces" in warning.text)
    assert pieces.grade is WarningGrade.LOOK
    assert np.prod(heart.segmentation.geometry.spacing_mm) == pytest.approx(64.0)
    assert "0.064 ml near (-62, -62, -62) mm" in pieces.text


def test_things_are_counted_in_words():
    assert [counted(number, "piece") for number in (0, 1, 2)] == ["0 pieces", "1 piece", "2 pieces"]


def test_no_message_leaves_the_plural_to_the_reader():
    sources = list(Path(heartcase.__file__).parent.rglob("*.py"))
    assert len(sources) > 100
    assert [path.name for path in sources if re.search(r"\} \w+\(s\)", path.read_text(encoding="utf-8"))] == []
