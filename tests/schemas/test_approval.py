"""Approvals: who approved which bytes, and what undoes it."""

import json
import multiprocessing
import re
from datetime import UTC, datetime, timedelta, timezone

import pytest

from heartcase.pipeline.bundle.write_bundle import write_bundle
from heartcase.schemas.bundle.approval import Approval, approval_log, approval_state, approve_case, bundle_sha256
from heartcase.schemas.bundle.role_words import looks_like_a_name
from heartcase.schemas.errors import BundleError, UsageError
from tests.crash import Crash, crash_after
from tests.factories import block_case

ROLE = "consultant cardiologist"
NOW = datetime(2026, 3, 4, 5, 6, 7, tzinfo=UTC)


@pytest.fixture
def case(tmp_path):
    directory = tmp_path / "block.case"
    write_bundle(directory, block_case())
    return directory


def approved(case, **options):
    return approve_case(case, role=ROLE, now=NOW, **options)


def lines(case):
    return [json.loads(line) for line in approval_log(case).read_text().splitlines()]


def test_a_new_case_is_a_draft_and_approving_it_says_who_when_and_what(case):
    assert approval_state(case) == Approval("draft")
    before = {path.name: path.read_bytes() for path in case.iterdir()}
    state = approve_case(
        case, role=ROLE, note="wall of the aorta checked", now=NOW.astimezone(timezone(timedelta(hours=9)))
    )
    assert state == approval_state(case)
    assert state.state == "approved"
    done = "approved by consultant cardiologist on 2026-03-04"
    unseen = "which cannot show whether later ones, such as a withdrawal, were deleted"
    assert state.words == f"{done} (1 entry in its log, {unseen})"
    (line,) = lines(case)
    assert line["time"] == "2026-03-04T05:06:07Z"
    assert line["bundle_sha256"] == bundle_sha256(case)
    assert line["note"] == "wall of the aorta checked"
    # The log is beside the case, whose bytes stay.
    assert approval_log(case) == case.parent / "block.approvals.jsonl"
    assert {path.name: path.read_bytes() for path in case.iterdir()} == before


def test_a_changed_byte_anywhere_makes_it_a_draft(case):
    approved(case)
    for path in sorted(case.iterdir()):
        content = path.read_bytes()
        for at in {0, len(content) // 2, len(content) - 1}:
            path.write_bytes(content[:at] + bytes([content[at] ^ 1]) + content[at + 1 :])
            state = approval_state(case)
            assert state.state == "changed since approval", (path.name, at)
            assert state.words.startswith("draft: the case was changed since it was approved")
        path.unlink()
        assert approval_state(case).state == "changed since approval"
        path.write_bytes(content)
    assert approval_state(case).state == "approved"


def test_the_same_bytes_built_again_stay_approved_and_others_do_not(case):
    approved(case)
    write_bundle(case, block_case(size=(4, 2, 2)))
    assert approval_state(case).state == "changed since approval"
    write_bundle(case, block_case())
    assert approval_state(case).state == "approved"


def test_withdrawing_makes_it_a_draft_until_it_is_approved_again(case):
    approved(case)
    assert approved(case, withdraw=True).words.startswith("draft: the approval was withdrawn by consultant")
    with pytest.raises(UsageError, match="no approval of this case"):
        approved(case, withdraw=True)
    assert approved(case).state == "approved"
    assert [line["action"] for line in lines(case)] == ["approve", "withdraw", "approve"]


def test_withdrawing_needs_no_sound_case_and_approving_does(case):
    approved(case)
    part = next(path for path in case.iterdir() if path.name.startswith("grid"))
    content = part.read_bytes()
    part.write_bytes(content[:-1] + bytes([content[-1] ^ 1]))
    with pytest.raises(BundleError, match="was changed"):
        approved(case)
    approved(case, withdraw=True)
    part.write_bytes(content)
    assert approval_state(case).state == "draft"
    with pytest.raises(BundleError, match="nothing at this path"):
        approved(case.parent / "no.case", withdraw=True)


def test_a_case_that_changed_while_it_was_looked_at_is_not_approved(case):
    seen = bundle_sha256(case)
    write_bundle(case, block_case(size=(4, 2, 2)))
    with pytest.raises(UsageError, match="changed while you looked"):
        approved(case, expected_sha256=seen)
    assert not approval_log(case).exists()


TAMPERED = {
    "role": (lambda text: text.replace("surgeon", "student", 1), "line 2 was changed"),
    "case": (lambda text: text.replace('"approve"', '"withdraw"', 1), "line 1 was changed"),
    "space": (lambda text: text.replace(',"note"', ', "note"', 1), "line 1 was changed"),
    "key": (lambda text: text.replace('{"action"', '{"a":1,"action"', 1), "line 1 was changed"),
    "first": (lambda text: text.split("\n", 1)[1], "before line 1"),
    "middle": (lambda text: "\n".join(text.split("\n")[:1] + text.split("\n")[2:]), "before line 2"),
    "swap": (lambda text: "\n".join([*text.split("\n")[1::-1], *text.split("\n")[2:]]), "before line 1"),
    "twice": (lambda text: text.split("\n")[0] + "\n" + text, "before line 2"),
    "cut": (lambda text: text[:-20], "cut off"),
    "blank": (lambda text: text + "\n", "line 4 was changed"),
    "junk": (lambda text: text + "[1, 2]\n", "line 4 was changed"),
    "deep": (lambda text: text + "[" * 100_000 + "\n", "line 4 was changed"),
}


@pytest.mark.parametrize("name", TAMPERED)
def test_a_log_that_was_tampered_with_is_reported_and_approves_nothing(case, name):
    approved(case)
    approve_case(case, role="surgeon", now=NOW)
    approve_case(case, role="imaging specialist", now=NOW)
    change, words = TAMPERED[name]
    log = approval_log(case)
    text = change(log.read_text())
    log.write_text(text)
    state = approval_state(case)
    assert state.state == "draft"
    assert words in state.problems[0]
    assert "cannot be trusted" in state.words
    with pytest.raises(UsageError, match="move the log away"):
        approved(case)
    assert log.read_text() == text


def test_a_log_that_is_no_text_or_a_link_is_not_followed(case, tmp_path):
    approval_log(case).write_bytes(b"\xff\xfe")
    assert "UTF-8" in approval_state(case).words
    approval_log(case).unlink()
    approval_log(case).symlink_to(tmp_path / "elsewhere")
    assert "no plain file" in approval_state(case).words


def test_a_line_of_a_newer_heartcase_may_say_more(case):
    import hashlib

    approved(case)
    (line,) = lines(case)
    del line["sha256"]
    line["country"] = "Denmark"
    compact = json.dumps(line, sort_keys=True, separators=(",", ":"))
    line["sha256"] = hashlib.sha256(compact.encode()).hexdigest()
    written = json.dumps(line, sort_keys=True, separators=(",", ":"))
    approval_log(case).write_text(written + "\n")
    assert approval_state(case).state == "approved"
    approved(case)
    assert approval_log(case).read_text().startswith(written + "\n")
    assert approval_state(case).entry_count == 2


@pytest.mark.parametrize("role", ["", "   ", "\u200b", "--", "a\nb", "x" * 101, "\x1b[31mred", "abc\u202edef"])
def test_a_role_is_a_line_of_plain_text(case, role):
    with pytest.raises(UsageError, match="role"):
        approve_case(case, role=role, now=NOW)
    assert not approval_log(case).exists()


def test_spaces_around_a_role_are_taken_off(case):
    assert approve_case(case, role="  surgeon \t").entry.role == "surgeon"


def test_roles_of_other_languages_are_fine(case):
    assert "Oberärztin der Kinderkardiologie" in approve_case(case, role="Oberärztin der Kinderkardiologie").words


@pytest.mark.parametrize("role", [
    "Dr. John Smith", "dr smith", "Prof. Dr. med. Anna Schmidt", "Mrs Jones", "John Smith", "J. Smith", "Smith, John",
    "Anna von der Heide", "Dr.Smith Jones", "John Dr Smith", "María López-García", "Edward Smith", "Dr. Edward Smith",
    "Howard Stark", "Dr. Howard", "John Headley", "Dr. Engin Yilmaz", "Peter Leitner", "Anatole France",
    "Łukasz Kowalski",
])  # fmt: skip
def test_a_name_is_no_role(case, role):
    with pytest.raises(UsageError, match="looks like a person's name"):
        approve_case(case, role=role, now=NOW)
    assert not approval_log(case).exists()


@pytest.mark.parametrize("role", [
    "consultant cardiologist", "Consultant Cardiologist", "PhD student", "MD", "surgeon", "Head of MRI",
    "Prof. of cardiology",
    "Professor of Paediatric Cardiology", "Leitender Oberarzt", "Fachärztin Kinderkardiologie", "chirurgien cardiaque",
    "MRI CT", "Clinical Lead", "Chief Resident", "Doctor", "Attending Physician",
    "pediatric nurse", "Research Fellow", "radiographer", "Imaging Scientist", "Prof. Cardiology", "Perfusionist",
    "Ward Doctor", "Intern", "Test User", "Team Lead", "Kinderkardiologe", "Herzchirurg", "Anatomy Teacher",
])  # fmt: skip
def test_what_is_no_name_is_a_role(role):
    assert not looks_like_a_name(role)


def _approve_five_times(case, barrier):
    barrier.wait()
    for _ in range(5):
        approve_case(case, role=ROLE)


def test_two_processes_lose_no_line(case):
    context = multiprocessing.get_context("spawn")
    barrier = context.Barrier(2)
    workers = [context.Process(target=_approve_five_times, args=(case, barrier)) for _ in range(2)]
    for worker in workers:
        worker.start()
    for worker in workers:
        worker.join(60)
        assert worker.exitcode == 0
    state = approval_state(case)
    assert (state.state, state.entry_count, state.problems) == ("approved", 10, ())


def test_a_crash_at_any_moment_leaves_the_log_before_or_after(case):
    approved(case)
    before = approval_log(case).read_bytes()
    seen = set()
    for limit in range(200):
        crashed = False
        try:
            with crash_after(limit):
                approved(case)
        except Crash:
            crashed = True
        after = approval_log(case).read_bytes()
        seen.add(after == before)
        assert after.startswith(before)
        state = approval_state(case)
        assert (state.state, state.problems) == ("approved", ())
        assert re.fullmatch(rb"(.+\n)+", after)
        approval_log(case).write_bytes(before)
        if not crashed:
            break
    assert not crashed
    assert seen == {True, False}


# Which file is whose.


def test_a_listed_file_that_is_a_link_is_no_file_of_the_case(case, tmp_path):
    approved(case)
    part = next(case.glob("picking-*"))
    outside = tmp_path / "outside"
    part.rename(outside)
    part.symlink_to(outside)  # the same bytes, today
    with pytest.raises(BundleError, match="missing or was changed"):
        bundle_sha256(case)
    assert approval_state(case).state == "changed since approval"


def test_a_manifest_that_is_a_link_is_not_approved(case, tmp_path):
    approved(case)
    (case / "case.json").rename(tmp_path / "m.json")
    (case / "case.json").symlink_to(tmp_path / "m.json")
    assert approval_state(case).state == "changed since approval"
    for withdraw in (False, True):
        with pytest.raises(BundleError, match="is a link"):
            approved(case, withdraw=withdraw)


@pytest.mark.parametrize("name", ["../out.bin", "./flow.bin", "grid/../flow.bin", "FLOW.bin", ".flow.bin", 7, None])
def test_a_name_that_is_no_plain_file_name_is_never_hashed(case, tmp_path, name):
    import hashlib

    for place in (tmp_path / "out.bin", case / "flow.bin", case / "FLOW.bin", case / ".flow.bin"):
        place.write_bytes(b"abc")
    (case / "grid").mkdir()
    manifest = json.loads((case / "case.json").read_text()) | {"format_version": "1.99"}
    entry = {"role": "flow", "name": name, "size": 3, "sha256": hashlib.sha256(b"abc").hexdigest()}
    manifest["files"].append(entry)
    (case / "case.json").write_text(json.dumps(manifest))
    with pytest.raises(BundleError):
        bundle_sha256(case)
    entry["name"] = "flow.bin"
    (case / "case.json").write_text(json.dumps(manifest))
    assert len(bundle_sha256(case)) == 64


def test_what_is_approved_is_what_is_validated_roles_of_newer_versions_too(case):
    import hashlib

    manifest = json.loads((case / "case.json").read_text()) | {"format_version": "1.99"}
    manifest["files"].append(
        {"role": "flow", "name": "flow-0.bin", "size": 3, "sha256": hashlib.sha256(b"abc").hexdigest()}
    )
    (case / "case.json").write_text(json.dumps(manifest))
    for content in (None, b"abd", b"abc"):
        if content is not None:
            (case / "flow-0.bin").write_bytes(content)
        if content == b"abc":
            assert approved(case).state == "approved"
        else:
            with pytest.raises(BundleError, match=r"files\.flow"):
                approved(case)


def test_one_case_has_one_log_by_whatever_way_it_is_reached(case, tmp_path, monkeypatch):
    link = tmp_path / "link.case"
    link.symlink_to(case)
    assert approval_log(link) == approval_log(case)
    approved(link)
    assert approval_state(case).state == "approved"
    approved(case, withdraw=True)
    assert approval_state(link).words.startswith("draft: the approval was withdrawn")
    monkeypatch.chdir(case)
    assert approval_log(".") == approval_log("../link.case") == approval_log(case)


def test_two_folders_never_share_a_log(tmp_path):
    folders = [
        tmp_path / name for name in ("x", "x.case", "x.case.case", "x.folder", "x.folder.case", "x.folder-", ".case")
    ]
    assert len({approval_log(folder) for folder in folders}) == len(folders)


def test_a_build_waits_until_the_line_is_written(case, monkeypatch):
    """The locks of the case and of its folder are held from the hash to the line."""
    import fcntl
    import os

    from heartcase.schemas.bundle import approval

    def is_held(directory):
        descriptor = os.open(directory, os.O_RDONLY)
        try:
            fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            return True
        finally:
            os.close(descriptor)
        return False

    held = {}
    for name in ("bundle_sha256", "atomic_write"):
        real = getattr(approval, name)

        def spied(*arguments, real=real, name=name):
            held.setdefault(name, [is_held(case), is_held(case.parent)])
            return real(*arguments)

        monkeypatch.setattr(approval, name, spied)
    approved(case)
    assert held == {"bundle_sha256": [True, True], "atomic_write": [True, True]}
    assert not is_held(case)


def test_what_is_no_text_and_no_date_is_told_at_once(case):
    with pytest.raises(UsageError) as found:
        approve_case(case, role=3, note=4, now="yesterday")
    assert [problem.place for problem in found.value.problems] == ["role", "note", "now"]
    assert not approval_log(case).exists()
