"""Kernels compiled ahead in other processes: races leave a sound cache, and no process stays behind."""

import json
import os
import signal
import subprocess
import sys
import threading
import time

import numpy as np
import pytest

from heartcase.compiling import compile_ahead
from heartcase.compiling.compile_ahead import Called, compiled_ahead
from heartcase.compiling.kernel import kernel
from heartcase.compiling.signatures import as_json, from_json
from tests.compiling import test_calls


@kernel
def _tripled(values):
    total = values.dtype.type(0)
    for value in values:
        total += value
    return 3 * total


DTYPES = ("float32", "float64", "int16", "int64")

RACE = """
import sys, time
import numpy as np
from heartcase.compiling.kernel import _StampedIndex
read = _StampedIndex._load_index
def slowly(self):
    found = read(self)
    time.sleep(0.2)
    return found
_StampedIndex._load_index = slowly
from tests.compiling.test_compile_ahead import _tripled
print("ready", flush=True)
sys.stdin.readline()
print(_tripled(np.arange(10, dtype=sys.argv[1])))
"""


def environment(folder):
    return os.environ | {"NUMBA_CACHE_DIR": str(folder)}


def test_processes_that_compile_one_kernel_for_different_types_leave_each_its_own_code(tmp_path):
    """numba alone lets all of them choose the same file, and the next process finds code for other types in it."""
    racers = [
        subprocess.Popen(
            [sys.executable, "-c", RACE, dtype],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            env=environment(tmp_path),
            text=True,
        )
        for dtype in DTYPES
    ]
    for racer in racers:
        assert racer.stdout.readline() == "ready\n"
    for racer in racers:
        racer.stdin.write("\n")
        racer.stdin.flush()
    for racer in racers:
        assert float(racer.communicate(timeout=120)[0]) == 135.0
        assert racer.returncode == 0
    code = (
        "import sys, numpy as np; from tests.compiling.test_compile_ahead import _tripled as f;"
        "print(*[float(f(np.arange(10, dtype=one))) for one in sys.argv[1:]], sum(f.stats.cache_misses.values()))"
    )
    found = subprocess.run(
        [sys.executable, "-c", code, *DTYPES], env=environment(tmp_path), capture_output=True, text=True, check=True
    )
    assert found.stdout.split() == ["135.0"] * len(DTYPES) + ["0"]
    assert len(list(tmp_path.rglob("*_tripled*.nbc"))) == len(DTYPES)


AHEAD = """
import json, sys
import numpy as np
from heartcase.compiling.compile_ahead import Called, compiled_ahead
from tests.compiling import test_calls as t
wanted = [Called(one["module"], one["name"], tuple(one["types"]), 1.0) for one in json.loads(sys.argv[1])]
heard = []
with compiled_ahead(wanted, processes=int(sys.argv[2]), told=heard.append):
    out = np.empty(50)
    t._all(t.outer(), out)
    values = [out.sum(), t._twice_at(t.outer(), 9), t._four_times_at(t.outer(), 9)]
    import time
    end = time.monotonic() + 100
    while heard and heard[-1].done < len(wanted) and time.monotonic() < end:
        time.sleep(0.05)
print(*values, len(heard), sum(sum(f.stats.cache_misses.values()) for f in (t._all, t._twice_at, t._four_times_at)))
"""


def listed():
    """Kernels of :mod:`tests.compiling.test_calls`, which share functions that are called by place."""
    import numba

    outer = numba.typeof(test_calls.outer())
    whole = numba.int64
    calls = {
        "_four_times_at": (outer, whole),
        "_twice_at": (outer, whole),
        "_all": (outer, numba.typeof(np.empty(1))),
        "_at": (outer, whole),
    }
    return [
        {"module": test_calls.__name__, "name": name, "types": [as_json(one) for one in types]}
        for name, types in calls.items()
    ]


def test_kernels_that_share_functions_are_raced_for_and_sound_in_every_process_after(tmp_path):
    """Four processes compile them while this one calls them; then nothing is left to do, and none is started."""
    printed = []
    for processes in (4, 4, 0):
        done = subprocess.run(
            [sys.executable, "-c", AHEAD, json.dumps(listed()), str(processes)],
            env=environment(tmp_path),
            capture_output=True,
            text=True,
            check=False,
        )
        assert done.returncode == 0, done.stderr
        printed.append(done.stdout.split())
    values = ["3675.0", "240.0", "480.0"]
    assert [line[:3] for line in printed] == [values] * 3
    assert printed[0][3] == "5"
    assert [line[3:] for line in printed[1:]] == [["0", "0"]] * 2


def endless(tmp_path, monkeypatch):
    """Processes that never answer."""
    started = []

    def start(unfinished, *, is_behind):
        started.append(
            subprocess.Popen(
                [sys.executable, "-c", "import time; time.sleep(600)"],
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                text=True,
            )
        )
        return started[-1]

    monkeypatch.setattr(compile_ahead, "_start", start)
    monkeypatch.setattr(compile_ahead, "_note", lambda: tmp_path / "note")
    return started


def test_an_interrupted_build_leaves_no_process_behind(tmp_path, monkeypatch):
    started = endless(tmp_path, monkeypatch)

    def interrupted():
        with compiled_ahead([Called("a", "b", (), 1.0)] * 3, processes=2):
            end = time.monotonic() + 30
            while len(started) < 2 and time.monotonic() < end:
                time.sleep(0.01)
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        interrupted()
    assert [one.poll() is None for one in started] == [False, False]
    assert not (tmp_path / "note").exists()


def test_what_cannot_be_compiled_ahead_is_left_to_its_caller(tmp_path, monkeypatch):
    """A process is started again by the next build, as not everything is in the cache."""
    monkeypatch.setattr(compile_ahead, "_note", lambda: tmp_path / "note")
    heard = []
    with compiled_ahead([Called("heartcase.nowhere", "gone", (), 2.0)], processes=1, told=heard.append):
        end = time.monotonic() + 60
        while len(heard) < 2 and time.monotonic() < end:
            time.sleep(0.01)
    assert [(one.done, one.total) for one in heard] == [(0, 1), (0, 1)]
    assert heard[0].seconds_left == 2.0
    assert not heard[0].is_measured
    assert not (tmp_path / "note").exists()


def test_without_processes_or_with_a_full_cache_none_is_started(tmp_path, monkeypatch):
    started = endless(tmp_path, monkeypatch)
    with compiled_ahead([Called("a", "b", (), 1.0)], processes=0):
        pass
    wanted = [Called("a", name, (), 1.0) for name in "bcd"]
    (tmp_path / "note").write_text("\n".join(compile_ahead._lines_of(wanted)))
    for some in (wanted, wanted[1:], wanted[::-1]):
        with compiled_ahead(some, processes=2):
            time.sleep(0.1)
    assert started == []
    heard = []
    with compiled_ahead([*wanted, Called("a", "b", ("int64",), 1.0)], processes=2, told=heard.append):
        time.sleep(0.1)
    assert [one.total for one in heard] == [1]
    assert len(started) == 1


def test_what_was_compiled_until_a_build_ended_is_not_asked_for_again(tmp_path, monkeypatch):
    monkeypatch.setattr(compile_ahead, "_note", lambda: tmp_path / "note")
    first, other = (Called(one["module"], one["name"], tuple(one["types"]), 1.0) for one in listed()[:2])
    gone = Called("heartcase.nowhere", "gone", (), 1.0)
    monkeypatch.setattr(compile_ahead, "_ask", lambda _, one: "failed" if one is gone else "done")
    for wanted, total in (((first, gone), 2), ((first, other, gone), 2), ((other, first), 0)):
        heard = []
        with compiled_ahead(wanted, processes=1, told=heard.append):
            end = time.monotonic() + 60
            while heard and len(heard) < 1 + total and time.monotonic() < end:
                time.sleep(0.01)
        assert [one.total for one in heard[:1]] == [total][: bool(total)]


@pytest.mark.skipif(os.name != "posix", reason="sends SIGKILL")
def test_a_killed_build_leaves_no_process_behind(tmp_path):
    unfinished = tmp_path / "unfinished"
    unfinished.mkdir()
    code = """
import sys, time
from heartcase.compiling import compile_ahead
process = compile_ahead._start(sys.argv[1])
print(process.pid, flush=True)
time.sleep(600)
"""
    parent = subprocess.Popen([sys.executable, "-c", code, str(unfinished)], stdout=subprocess.PIPE, text=True)
    child = int(parent.stdout.readline())
    parent.send_signal(signal.SIGKILL)
    parent.communicate()
    end = time.monotonic() + 60
    while _lives(child) and time.monotonic() < end:
        time.sleep(0.05)
    assert not _lives(child)
    assert not unfinished.exists()


SLOWLY = """
import sys, time
from heartcase.compiling import compile_ahead
from heartcase.compiling.kernel import _StampedIndex
dump = _StampedIndex._dump
def slowly(self, what):
    if sys.argv[2]:
        with self._open_for_write(self._index_path) as file:
            file.write(b"half")
            file.flush()
            print("writing", file=sys.stderr, flush=True)
            time.sleep(600)
    return dump(self, what)
_StampedIndex._dump = slowly
compile_ahead.serve(sys.argv[2])
"""


def test_what_a_killed_process_was_writing_goes_and_what_others_write_stays(tmp_path, monkeypatch):
    """The cache is shared: only a file of the process that was ended may be removed."""
    cache = tmp_path / "cache"
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(cache))
    writing = []

    def start(unfinished, *, is_behind):
        process = subprocess.Popen(
            [sys.executable, "-c", SLOWLY, "", unfinished],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            env=environment(cache),
            text=True,
        )
        writing.append(process)
        return process

    cache.mkdir()
    monkeypatch.setattr(compile_ahead, "_start", start)
    monkeypatch.setattr(compile_ahead, "_note", lambda: cache / "note")
    one = listed()[3]
    other = cache / "of-another.nbc.tmp.0123456789abcdef"
    other.write_bytes(b"another process writes this")
    with compiled_ahead([Called(one["module"], one["name"], tuple(one["types"]), 1.0)], processes=1):
        end = time.monotonic() + 60
        while not writing and time.monotonic() < end:
            time.sleep(0.01)
        assert writing[0].stderr.readline() == "writing\n"
        (half,) = (path for path in cache.rglob("*") if path.is_file() and path.read_bytes() == b"half")
        assert half.parent != other.parent
    writing[0].stderr.close()
    left = [path for path in cache.rglob("*") if path.is_file() and path.suffix != ".lock"]
    assert left == [other]
    assert not list(cache.glob("heartcase-unfinished-*"))


def test_the_note_lies_with_what_was_compiled_of_this_installation():
    """Elsewhere it would tell other installations that their kernels are there."""
    folder = compile_ahead._note().parent
    assert "compiling" in (folder.name.rpartition("_")[0], folder.parent.name), folder


@pytest.mark.parametrize("starts", [True, False])
def test_what_a_process_that_died_had_in_hand_counts_as_failed(tmp_path, monkeypatch, starts):
    """So that who waits for all does not wait for ever."""

    def start(unfinished, *, is_behind):
        if not starts:
            raise OSError("no room for a process")
        command = [sys.executable, "-c", "raise SystemExit(9)"]
        return subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)

    monkeypatch.setattr(compile_ahead, "_start", start)
    monkeypatch.setattr(compile_ahead, "_note", lambda: tmp_path / "note")
    told, is_over = [], threading.Event()

    def hear(progress):
        told.append(progress)
        if progress.done + progress.failed == progress.total:
            is_over.set()

    with compiled_ahead([Called("a", "b", (), 1.0)] * 3, processes=2, told=hear):
        assert is_over.wait(30.0)
    assert (told[-1].done, told[-1].failed, told[-1].total) == (0, 3, 3)


def _lives(process):
    try:
        os.kill(process, 0)
    except ProcessLookupError:
        return False
    try:
        with open(f"/proc/{process}/stat") as file:
            return file.read().rpartition(")")[2].split()[0] != "Z"
    except OSError:
        return True


def test_types_come_back_from_json():
    import numba

    values = np.zeros((2, 3), np.float32)
    frozen = np.zeros(3)
    frozen.setflags(write=False)
    given = (values, values[:, ::2], frozen, np.asfortranarray(values), np.zeros(2, bool), 1, 1.5, True, None)
    kinds = [numba.typeof(one) for one in (*given, (1, 2), (1, 2.0), (values, (1, True)), test_calls.outer())]
    kinds += [numba.typeof(_tripled), numba.types.Omitted(0.5), numba.types.Omitted(None)]
    for kind in kinds:
        assert from_json(json.loads(json.dumps(as_json(kind)))) == kind
    with pytest.raises(ValueError, match="cannot be listed"):
        as_json(numba.types.unicode_type)
    with pytest.raises(ValueError, match="no type"):
        from_json(["nothing"])
