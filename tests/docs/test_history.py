"""Docs say how it is now; what was measured once lies in ``benchmarks/results/``, with its command and commit."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from tests.docs.pages import PAGES, ROOT

RESULTS = sorted((ROOT / "benchmarks" / "results").glob("*.md"))
FILES = [file for top in ("heartcase", "tests", "benchmarks", "docs") for file in (ROOT / top).rglob("*.py")]
_COMMIT = re.compile(r"\b(?=[0-9a-f]*[a-f])(?=[0-9a-f]*[0-9])[0-9a-f]{7}\b")
_COMMAND = re.compile(r"`(?:heartcase|pytest|make|python)\b")


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_pages_name_no_commits(page: Path) -> None:
    assert _COMMIT.findall(page.read_text(encoding="utf-8")) == []


@pytest.mark.parametrize("page", RESULTS, ids=lambda page: page.name)
def test_results_name_what_made_them(page: Path) -> None:
    """Each part names the command and the commit."""
    start, *parts = re.split(r"^## ", page.read_text(encoding="utf-8"), flags=re.M)
    for part in parts or [start]:
        title = part.partition("\n")[0]
        assert _COMMAND.search(part), title
        assert _COMMIT.search(part), title


@pytest.mark.parametrize("page", [*PAGES, *RESULTS], ids=lambda page: page.name)
def test_modules_that_a_page_names_are_there(page: Path) -> None:
    known = [file.relative_to(ROOT).as_posix() for file in FILES]
    for named in re.findall(r"`([\w/]+\.py)`", page.read_text(encoding="utf-8")):
        assert any(f"/{path}".endswith(f"/{named}") for path in known), named


def test_there_are_results() -> None:
    assert RESULTS
