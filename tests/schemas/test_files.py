"""Atomic writing, leftovers and locks."""

import os
import subprocess
import sys

import pytest

from heartcase.schemas.files import TEMPORARY_PREFIX, atomic_write, exclusive, remove_leftovers, sha256_of_file
from tests.crash import Crash, crash_after


def test_a_file_is_replaced_whole_or_not_at_all(tmp_path):
    path = tmp_path / "a"
    for limit in range(20):
        path.write_bytes(b"old")
        try:
            with crash_after(limit):
                atomic_write(path, b"new content")
        except Crash:
            assert path.read_bytes() in (b"old", b"new content")
            continue
        break
    assert path.read_bytes() == b"new content"
    assert 3 <= limit <= 8


def test_an_interrupted_write_leaves_nothing_behind(tmp_path, monkeypatch):
    def interrupted(_descriptor):
        raise KeyboardInterrupt

    monkeypatch.setattr(os, "fsync", interrupted)
    with pytest.raises(KeyboardInterrupt):
        atomic_write(tmp_path / "a", b"x")
    assert not list(tmp_path.iterdir())


def test_leftovers_of_the_dead_go_and_those_of_the_living_stay(tmp_path):
    process = subprocess.Popen([sys.executable, "-c", "pass"])
    process.wait()
    dead = tmp_path / f"{TEMPORARY_PREFIX}{process.pid}-a"
    living = tmp_path / f"{TEMPORARY_PREFIX}{os.getppid()}-a"
    odd = tmp_path / f"{TEMPORARY_PREFIX}odd"
    for path in (dead, living, odd):
        path.write_bytes(b"x")
    remove_leftovers(tmp_path)
    assert {path.name for path in tmp_path.iterdir()} == {living.name}


def test_a_lock_keeps_another_process_waiting(tmp_path):
    script = (
        "import sys, time; from heartcase.schemas.files import exclusive\n"
        "with exclusive(sys.argv[1]): print('in', flush=True)"
    )
    with exclusive(tmp_path):
        process = subprocess.Popen([sys.executable, "-c", script, str(tmp_path)], stdout=subprocess.PIPE)
        with pytest.raises(subprocess.TimeoutExpired):
            process.wait(timeout=1.5)
    assert process.communicate(timeout=30)[0].strip() == b"in"


def test_the_hash_is_sha256(tmp_path):
    (tmp_path / "a").write_bytes(b"abc")
    assert sha256_of_file(tmp_path / "a") == "ba7816bf8f01cfea414140de5dae2223b00361a396177a9cb410ff61f20015ad"


def test_a_link_that_lies_in_wait_is_not_written_through(tmp_path, monkeypatch):
    victim, folder = tmp_path / "victim", tmp_path / "folder"
    victim.write_bytes(b"mine")
    folder.mkdir()
    # every name that can be guessed, and the one that is drawn
    monkeypatch.setattr("heartcase.schemas.files.secrets.token_hex", lambda size: "0" * 2 * size)
    for name in (f"{os.getpid()}-a", f"{os.getpid()}-00000000-a"):
        (folder / f"{TEMPORARY_PREFIX}{name}").symlink_to(victim)
    with pytest.raises(FileExistsError):
        atomic_write(folder / "a", b"new")
    assert victim.read_bytes() == b"mine"


def test_what_this_process_writes_is_no_leftover(tmp_path, monkeypatch):
    seen = []

    def look(_descriptor):
        remove_leftovers(tmp_path)
        seen.append(list(tmp_path.glob(f"{TEMPORARY_PREFIX}*")))

    monkeypatch.setattr(os, "fsync", look)
    atomic_write(tmp_path / "a", b"x")
    assert len(seen[0]) == 1
    assert (tmp_path / "a").read_bytes() == b"x"
