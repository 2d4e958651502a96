"""Warnings: the worst first, each once, and their weight survives the cache."""

import itertools
import re
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import heartcase
from heartcase.pipeline.artifacts.serialise import artifact_from_bytes, artifact_to_bytes
from heartcase.pipeline.data import Scan
from heartcase.pipeline.ends.cut_ends import closed_vessels
from heartcase.pipeline.warnings import CaseWarning, Severity, anatomy, counted, grouped, note, worst_first
from heartcase.pipeline.watershed.segment_scan import segmentation_warnings
from heartcase.schemas.errors import StageError
from tests.pipeline.report.analytic_heart import make_heart

lines = st.builds(CaseWarning, st.sampled_from("abcdef"), st.sampled_from(Severity))


@settings(deadline=None)
@given(st.lists(st.lists(lines | st.sampled_from("abcdef"), max_size=6), max_size=4))
def test_the_worst_come_first_each_once_with_its_worst_weight(sources):
    result = worst_first(*sources)
    every = [line for source in sources for line in source]
    assert sorted(map(str, result)) == sorted({str(line) for line in every})
    assert all(a.severity <= b.severity for a, b in itertools.pairwise(result))
    for line in result:
        assert line.severity == min(other.severity for other in every if other == line)
    # Those that matter alike keep the order in which they came.
    order = [str(line) for line in every]
    for a, b in itertools.pairwise(result):
        if a.severity == b.severity:
            assert order.index(a) < order.index(b)


def test_a_plain_line_is_something_to_look_at():
    assert "x".severity is Severity.LOOK
    assert worst_first(["info", note("n"), anatomy("a")]) == ("a", "info", "n")


def test_weights_survive_the_cache():
    heart = make_heart(spacing_mm=(8.0, 8.0, 8.0))
    given_lines = ("plain", anatomy("a wall"), note("a speck"), CaseWarning("look"))
    scan = Scan(heart.scan.values, heart.scan.geometry, "CT", warnings=given_lines)
    back = artifact_from_bytes(artifact_to_bytes(scan), Scan).warnings
    assert back == given_lines
    assert [line.severity for line in back] == [line.severity for line in given_lines]
    assert artifact_to_bytes(scan) == artifact_to_bytes(Scan(scan.values, scan.geometry, "CT", warnings=back))


@pytest.mark.parametrize("damage", [b'{"severity": "WORSE", "text": "x"}', b"7", b"[]", b"null"])
def test_damaged_warnings_are_refused(damage):
    heart = make_heart(spacing_mm=(8.0, 8.0, 8.0))
    content = artifact_to_bytes(Scan(heart.scan.values, heart.scan.geometry, "CT", warnings=("xyzzy",)))
    escaped = b'\\\\\\"xyzzy\\\\\\"'
    assert content.count(escaped) == 1
    quoted = damage.replace(b'"', b'\\\\\\"')
    head = int.from_bytes(content[:8], "little") + len(quoted) - len(escaped)
    with pytest.raises(StageError, match="another version"):
        artifact_from_bytes(head.to_bytes(8, "little") + content[8:].replace(escaped, quoted), Scan)


def test_groups_are_headed_in_plain_words_worst_first():
    groups = grouped([note("it is small"), "the 'x' looks odd", anatomy("a wall has a hole: mend it.")])
    assert [group.title for group in groups] == ["The anatomy may be wrong", "Look at this", "For your information"]
    assert [group.lines for group in groups] == [
        ("A wall has a hole: mend it.",),
        ("The 'x' looks odd.",),
        ("It is small.",),
    ]
    assert grouped([]) == ()


def test_an_aorta_without_an_end_outranks_a_loose_piece():
    heart = make_heart(spacing_mm=(4.0, 4.0, 4.0))
    labels = heart.segmentation.labels.copy()
    labels[0, 0, 0] = 9
    segmentation = type(heart.segmentation)(labels, heart.segmentation.geometry, heart.table)
    found = worst_first(segmentation_warnings(segmentation), closed_vessels(segmentation, ()))
    assert "the aorta ends in a closed sac" in found[0]
    assert found[0].severity is Severity.ANATOMY
    pieces = next(line for line in found if "pieces" in line)
    assert pieces.severity is Severity.LOOK
    assert np.prod(heart.segmentation.geometry.spacing_mm) == pytest.approx(64.0)
    assert "0.064 ml near (-62, -62, -62) mm" in pieces


def test_things_are_counted_in_words():
    assert [counted(number, "piece") for number in (0, 1, 2)] == ["0 pieces", "1 piece", "2 pieces"]


def test_no_message_leaves_the_plural_to_the_reader():
    sources = list(Path(heartcase.__file__).parent.rglob("*.py"))
    assert len(sources) > 100
    assert [path.name for path in sources if re.search(r"\} \w+\(s\)", path.read_text(encoding="utf-8"))] == []
