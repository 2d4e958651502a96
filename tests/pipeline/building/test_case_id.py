"""Identifiers of cases, and the key file."""

from __future__ import annotations

import json
import re
import threading
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st
from pydantic import TypeAdapter

from heartcase.pipeline.bundle.case_id import add_to_key_file, check_key_file, made_up_case_id
from heartcase.schemas.base import CaseId
from heartcase.schemas.errors import UsageError

HASHES = st.text("0123456789abcdef", min_size=64, max_size=64)


@given(st.text(max_size=64), HASHES)
def test_an_identifier_is_well_formed_and_always_the_same(name: str, scan: str) -> None:
    made = made_up_case_id(name, scan)
    assert TypeAdapter(CaseId).validate_python(made) == made
    assert re.fullmatch(r"HC(-[0-9A-HJKMNP-TV-Z]{4}){3}", made)
    assert made == made_up_case_id(name, scan)


def test_other_cases_have_other_identifiers() -> None:
    made = {made_up_case_id(f"case {n}", f"{n % 7:064x}") for n in range(5000)}
    assert len(made) == 5000


def test_lines_are_added_once_and_the_others_stay(tmp_path: Path) -> None:
    key = tmp_path / "keys.jsonl"
    key.write_text('{"case_id": "OLD-1"}')
    assert add_to_key_file(key, "HC-1", {"patient_id": "Ä 17"})
    assert not add_to_key_file(key, "HC-1", {"patient_id": "Ä 17"})
    assert add_to_key_file(key, "HC-2", {"patient_id": "Ä 17"})
    lines = [json.loads(line) for line in key.read_text(encoding="utf-8").splitlines()]
    assert [line["case_id"] for line in lines] == ["OLD-1", "HC-1", "HC-2"]
    assert lines[1]["patient_id"] == "Ä 17"
    assert key.stat().st_mode & 0o077 == 0


def test_builds_at_the_same_time_lose_no_line(tmp_path: Path) -> None:
    key = tmp_path / "keys.jsonl"
    threads = [
        threading.Thread(target=add_to_key_file, args=(key, f"HC-{n}", {"patient_id": str(n)})) for n in range(16)
    ]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert {json.loads(line)["case_id"] for line in key.read_text().splitlines()} == {f"HC-{n}" for n in range(16)}


def test_the_key_is_never_kept_in_the_case(tmp_path: Path) -> None:
    case = tmp_path / "heart.case"
    case.mkdir()
    for inside in (case / "keys.jsonl", tmp_path / "x" / ".." / "heart.case" / "keys.jsonl"):
        with pytest.raises(UsageError, match="inside the case"):
            check_key_file(inside, case)
    with pytest.raises(UsageError, match="directory"):
        check_key_file(tmp_path, case)
    with pytest.raises(UsageError, match="does not exist"):
        check_key_file(tmp_path / "gone" / "keys.jsonl", case)
    check_key_file(tmp_path / "keys.jsonl", case)
