"""What a build of a library shows while it runs, and of warnings at its end."""

from __future__ import annotations

import io
import time

import pytest
from rich.console import Console

from heartcase.cli.library.library import warning_words
from heartcase.cli.library.progress import LibraryProgress
from heartcase.library.build import Workers, build_cases, connected
from heartcase.library.plan import CaseRecord, plan_library, read_record, write_record
from heartcase.library.progress import MAKING_THE_SCAN, StageNews, TellingListener, heard
from heartcase.schemas.bundle.format import WarningGrade
from tests.library.test_build import QUICK, make_library


def told(stage: str, is_finished: bool, case: str = "a", **more: float | bool) -> StageNews:
    return StageNews(case, "s", stage, is_finished, **more)


def test_a_log_gets_a_line_for_every_stage_that_is_finished():
    text = io.StringIO()
    shown = LibraryProgress(Console(file=text, force_terminal=False), 2, 1)
    with shown.progress:
        shown.hear(told(MAKING_THE_SCAN, False, seconds_expected=15.0))
        shown.hear(told(MAKING_THE_SCAN, True, seconds=12.25))
        shown.hear(told("filter", True, seconds=3.0, reused=True))
    lines = text.getvalue().splitlines()
    assert len(lines) == 2
    assert lines[0].split() == ["a", "making", "the", "scan", "12.2", "s"]
    assert lines[1].endswith("unchanged")


def test_a_terminal_shows_the_stage_that_runs_and_how_long_all_may_take():
    text = io.StringIO()
    shown = LibraryProgress(Console(file=text, force_terminal=True, width=120), 4, 2)
    assert shown.ends_s() is None
    with shown.progress:
        for case in ("a", "b"):
            shown.hear(told("filter", False, case, seconds_expected=10.0, seconds_after=30.0))
        # Two of 40 s run, two of 40 s wait, two at a time.
        now = shown.running["a"].began_s
        assert shown.ends_s() - now == pytest.approx(80.0, abs=5.0)
        assert len(shown.progress.tasks) == 3
        shown.hear(told("segment", False, "a", seconds_expected=10.0, seconds_after=10.0))
        assert len(shown.progress.tasks) == 3
        shown.progress.refresh()
        shown.case_done("a", 20.0)
        assert [task.completed for task in shown.progress.tasks if task.fields["is_all"]] == [1]
        assert set(shown.running) == {"b"}
    assert "a: " in text.getvalue()
    assert "about" in text.getvalue()


@pytest.mark.usefixtures("plain_workers")
def test_workers_tell_of_their_stages(tmp_path):
    cases = plan_library(make_library(tmp_path / "library", 1, parts=QUICK))
    heard: list[StageNews] = []
    with connected(Workers(1, 1, 3000), None) as client:
        (record,) = build_cases(cases, client, out=tmp_path / "out", hear=heard.append)
    assert not record.problems
    finished = [news.stage for news in heard if news.is_finished]
    # The last ones may come after the record.
    assert finished[:4] == list(record.stage_seconds)[:4]
    assert {news.case for news in heard} == {"ball-0"}
    assert any(not news.is_finished and news.seconds_expected > 0.0 for news in heard)
    assert len(record.warning_grades) == len(record.warnings)


def test_warnings_are_told_by_grade(tmp_path):
    grades = (WarningGrade.ANATOMY, WarningGrade.NOTE, WarningGrade.NOTE)
    record = CaseRecord("a", "s", warnings=("w", "x", "y"), warning_grades=grades)
    assert warning_words(record) == "1 the anatomy may be wrong, 2 for information"
    write_record(record, tmp_path)
    assert read_record("a", tmp_path) == record
    assert warning_words(CaseRecord("a", "s", warnings=("w",))) == "1 to look at"


def _tell() -> None:
    TellingListener("a", "s").stage_started("filter", seconds_expected=1.0, seconds_after=2.0)


def test_what_a_worker_tells_is_heard():
    with connected(Workers(1, 1, 3000), None) as client, heard(client) as news:
        client.submit(_tell).result()
        found: list[StageNews] = []
        deadline = time.monotonic() + 30.0
        while not found and time.monotonic() < deadline:
            found += news()
            time.sleep(0.05)
    assert found == [StageNews("a", "s", "filter", False, seconds_expected=1.0, seconds_after=2.0)]
