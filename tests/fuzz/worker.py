"""Reads damaged inputs one after the other, each kind in a process of its own, under limits of time and memory.

``python -m tests.fuzz.worker COUNT SEED KIND...`` prints a JSON object a kind: how many were read, how many refused,
and what went wrong. An input that takes more than ten seconds ends its kind with the traceback of where it hangs.
"""

from __future__ import annotations

import faulthandler
import hashlib
import json
import multiprocessing
import resource
import shutil
import sys
import tempfile
import traceback
import warnings
from multiprocessing.connection import Connection
from pathlib import Path

import numpy as np

from heartcase.schemas.errors import HeartcaseError
from tests.fuzz.corpus import read, write_sound
from tests.fuzz.mutate import mutated

SECONDS_MAX = 10.0
MEMORY_MAX = 2 << 30
LINE_MAX = 2000
"""Longest line that an error may print."""


def fuzz(kind: str, count: int, seed: int) -> dict[str, object]:
    """Read ``count`` damaged copies of a sound input."""
    findings: list[str] = []
    outcome = {"read": 0, "refused": 0}
    with tempfile.TemporaryDirectory() as name:
        sound = Path(name) / "sound"
        sound.mkdir()
        source = write_sound(kind, sound)
        read(kind, source)
        before = _tree(sound)
        start_mib = _peak()
        _limit_memory()
        for number in range(count):
            rng = np.random.default_rng([seed, number])
            copy = _damaged(source, Path(name) / "damaged", rng)
            given = _tree(copy.parent)
            faulthandler.dump_traceback_later(SECONDS_MAX, exit=True)
            try:
                read(kind, copy)
                outcome["read"] += 1
            except HeartcaseError as error:
                outcome["refused"] += 1
                findings += [f"{number}: {fault}" for fault in _faults_of(error)]
            except BaseException:
                findings.append(f"{number}: {traceback.format_exc()}")
            finally:
                faulthandler.cancel_dump_traceback_later()
            if _tree(copy.parent) != given:
                findings.append(f"{number}: reading changed the input")
        if _tree(sound) != before:
            findings.append("the sound input was changed")
        grown = _peak() - start_mib
        if grown > MEMORY_MAX:
            findings.append(f"memory grew by {grown >> 20} MiB")
    return {**outcome, "grown_mib": grown >> 20, "findings": findings}


def _damaged(source: Path, folder: Path, rng: np.random.Generator) -> Path:
    """A copy of the input in which one file, or sometimes several, is damaged."""
    shutil.rmtree(folder, ignore_errors=True)
    folder.mkdir()
    whole = source.is_dir()
    shutil.copytree(source if whole else source.parent, folder / source.name if whole else folder, dirs_exist_ok=True)
    copy = folder / source.name
    files = sorted(path for path in (copy if whole else folder).rglob("*") if path.is_file())
    wanted = len(files) if rng.random() < 0.1 else 1
    # The manifest or header decides most, so it is hit more often.
    chosen = [files[n] for n in rng.permutation(len(files))[:wanted]]
    headers = [path for path in files if path.name in ("case.json", "recording.json", source.name)]
    if headers and rng.random() < 0.5:
        chosen = headers
    for path in chosen:
        if rng.random() < 0.03:
            path.unlink()
        else:
            path.write_bytes(mutated(path.read_bytes(), rng))
    return copy


def _faults_of(error: HeartcaseError) -> list[str]:
    faults = []
    if not error.problems:
        faults.append("refused without a word")
    for problem in error.problems:
        line = str(problem)
        if not line.strip() or len(line) > LINE_MAX or any(not character.isprintable() for character in line):
            faults.append(f"not a line to show: {line[:200]!r}")
    return faults


def _tree(folder: Path) -> dict[str, str]:
    return {
        str(path.relative_to(folder)): hashlib.sha256(path.read_bytes()).hexdigest()
        for path in sorted(folder.rglob("*"))
        if path.is_file()
    }


def _peak() -> int:
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss << 10


def _limit_memory() -> None:
    """Room for what is allowed and for the address space that libraries reserve without using it."""
    pages = int(Path("/proc/self/statm").read_text().split()[0])
    room = pages * resource.getpagesize() + 2 * MEMORY_MAX
    resource.setrlimit(resource.RLIMIT_AS, (room, room))


def _apart(kind: str, count: int, seed: int) -> dict[str, object]:
    """The same in a fork of this process, whose modules are imported by then."""
    fork = multiprocessing.get_context("fork")
    receiver, sender = fork.Pipe(duplex=False)
    process = fork.Process(target=_send, args=(sender, kind, count, seed))
    process.start()
    sender.close()
    try:
        result = receiver.recv()
    except EOFError:
        result = None
    process.join()
    if result is None or process.exitcode:
        result = {"read": 0, "refused": 0, "findings": [f"ended with {process.exitcode} before its end"]}
    return {"kind": kind, **result}


def _send(sender: Connection, kind: str, count: int, seed: int) -> None:
    faulthandler.enable()
    warnings.simplefilter("error")
    sender.send(fuzz(kind, count, seed))


if __name__ == "__main__":
    for kind in sys.argv[3:]:
        print(json.dumps(_apart(kind, int(sys.argv[1]), int(sys.argv[2]))), flush=True)
