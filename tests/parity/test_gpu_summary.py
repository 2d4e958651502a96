"""The page of ``make gpu``: what failed and what is missing is told."""

from __future__ import annotations

import json

from tests.parity.gpu_summary import summary
from tests.stress.many_violent_scripts import summary as violence_summary

XML = """<testsuites><testsuite tests="3" skipped="1" time="12.3">
<testcase classname="a" name="one"/><testcase classname="a" name="two"><failure/></testcase>
<testcase classname="a" name="three"><skipped/></testcase></testsuite></testsuites>"""


def test_what_failed_and_what_is_missing_is_told(tmp_path):
    (tmp_path / "tests.xml").write_text(XML)
    whole = {"left": 0, "most": 3, "settled_s": 0.1, "hurried": 0, "is_finite": True}
    outcomes = [
        {"law": "springs", "seed": 0} | whole,
        {"law": "springs", "seed": 1} | whole | {"left": 2, "settled_s": 0.9},
        {"law": "springs", "seed": 2, "error": "ValueError: no"},
        {"law": "element", "seed": 0} | whole | {"hurried": 1},
    ]
    (tmp_path / "violence.json").write_text(json.dumps({"laws": violence_summary(outcomes)}))
    page = summary(tmp_path, "A device.")
    assert "A device." in page
    assert "1 of 3 passed, 1 skipped, in 12 s." in page
    assert "- failed: `a.two`" in page
    assert "| springs | 3 | 1 | in 1 | 2 | 0.10 s | 0 |" in page
    assert "- failed: springs, script 2" in page
    assert "| element | 1 | 0 | in 0 | 0 | 0.10 s | 1 |" in page
    assert "`bench.json` is missing" in page
    record = {"case": "c", "method": "m", "seconds": 0.25, "errors": {"off [mm]": 1.5}}
    (tmp_path / "bench.json").write_text(json.dumps([record]))
    page = summary(tmp_path, "")
    assert "| c | m | 0.25 | off [mm]: 1.5 |" in page
    assert "missing" not in page
