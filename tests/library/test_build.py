"""Libraries built by worker processes: the same bytes as one by one, whatever fails or is killed."""

from __future__ import annotations

import contextlib
import json
import os
import signal
import socket
import subprocess
import sys
import threading
import time
from pathlib import Path

import pytest

from heartcase import __version__
from heartcase.cli.main import main
from heartcase.library.build import (
    Workers,
    _check_versions,
    build_cases,
    connected,
    default_workers,
    stale_cases,
)
from heartcase.library.plan import CaseRecord, LibraryCase, plan_library, read_record
from heartcase.pipeline.building.run import build_case
from heartcase.schemas.errors import UsageError
from heartcase.schemas.recipe.recipe import load_recipe
from tests.ball import write_ball_recipe, write_ball_scan

pytestmark = pytest.mark.usefixtures("plain_reports")
QUICK = 'parts = ["surface"]'
NO_TISSUE = """
[[edits]]
kind = "remove"
label = "muscle"
radius_mm = 60.0
points_mm = [[0, 0, 0]]
into = "background"
"""


def make_library(folder: Path, count: int, *, parts: str = "") -> Path:
    folder.mkdir(exist_ok=True)
    write_ball_scan(folder / "scan.nii.gz")
    for number in range(count):
        path = write_ball_recipe(folder / "scan.nii.gz", folder / f"{number}.toml", parts=parts, cell_mm=4.0 + number)
        path.write_text(path.read_text().replace('name = "ball"', f'name = "ball-{number}"'))
    return folder


def contents(out: Path) -> dict[str, bytes]:
    files = [path for folder in out.glob("*.case") for path in folder.rglob("*") if path.is_file()]
    return {path.relative_to(out).as_posix(): path.read_bytes() for path in files}


def run(capsys, *arguments: object) -> tuple[int, dict[str, object]]:
    code = main(["library", "build", *map(str, arguments), "--json"])
    return code, json.loads(capsys.readouterr().out)


@pytest.mark.usefixtures("plain_workers")
def test_two_workers_make_what_one_by_one_makes_and_a_failure_stops_nobody(tmp_path, capsys):
    library, out = make_library(tmp_path / "library", 2, parts=QUICK), tmp_path / "out"
    path = write_ball_recipe(library / "scan.nii.gz", library / "bad.toml", more=NO_TISSUE)
    path.write_text(path.read_text().replace('name = "ball"', 'name = "bad"'))
    code, result = run(capsys, library, "--out", out, "--workers", 2)
    assert code == 1
    assert [one["name"] for one in result["built"]] == ["ball-0", "ball-1"]
    assert list(result["failed"]) == ["bad"]
    assert "tissue" in result["failed"]["bad"][0][1]
    assert all(one["memory_peak_mb"] is None or 50 < one["memory_peak_mb"] < 3000 for one in result["built"])
    alone = tmp_path / "alone"
    for number in range(2):
        recipe = library / f"{number}.toml"
        build_case(load_recipe(recipe), directory=library, out=alone)
    assert contents(alone) == contents(out)

    path.unlink()
    code, result = run(capsys, library, "--out", out)
    assert (code, result["unchanged"], result["built"], result["failed"]) == (0, 2, [], {})

    recipe = library / "1.toml"
    recipe.write_text(recipe.read_text().replace("triangle_count = 2000", "triangle_count = 1500"))
    code, result = run(capsys, library, "--out", out, "--workers", 1)
    assert (code, result["unchanged"]) == (0, 1)
    (built,) = result["built"]
    assert built["name"] == "ball-1"
    computed = set(built["stage_seconds"]) - set(built["reused"])
    assert {"surface", "map"} <= computed
    assert not computed & {"filter", "segment", "walls", "grid"}


@pytest.mark.usefixtures("plain_workers")
def test_a_killed_worker_costs_what_it_was_building(tmp_path):
    library, out = make_library(tmp_path / "library", 2, parts=QUICK), tmp_path / "out"
    cases = plan_library(library)
    with connected(Workers(1, 1, 3000), None) as client:

        def kill() -> None:
            while not any(client.processing().values()):
                time.sleep(0.02)
            time.sleep(0.3)
            for process in client.run(os.getpid).values():
                os.kill(process, signal.SIGKILL)

        killer = threading.Thread(target=kill)
        killer.start()
        records = list(build_cases(cases, client, out=out))
        killer.join()
    assert sorted(record.name for record in records) == ["ball-0", "ball-1"]
    assert not any(record.problems for record in records), records
    assert not stale_cases(cases, out)


@pytest.mark.thorough
def test_a_case_that_kills_every_worker_is_listed(tmp_path, monkeypatch):
    library, out = make_library(tmp_path / "library", 1), tmp_path / "out"
    with connected(Workers(1, 1, 3000), None) as client:
        monkeypatch.setattr("heartcase.library.build._build_one", _die)
        (record,) = build_cases(plan_library(library), client, out=out)
    assert "3 workers were killed" in record.problems[0][1]
    assert read_record("ball-0", out) == record
    assert len(stale_cases(plan_library(library), out)) == 1


def test_an_output_folder_that_takes_no_records_ends_the_build(tmp_path):
    library, out = make_library(tmp_path / "library", 1), tmp_path / "out"
    (case,) = plan_library(library)
    out.mkdir()
    (out / ".heartcase-library").write_text("no folder")
    (out / ".heartcase-cache").write_text("no folder")
    with connected(Workers(1, 1, 3000), None) as client, pytest.raises(OSError, match="heartcase-library"):
        list(build_cases((case,), client, out=out))


def test_a_build_beside_another_starts_without_complaint():
    """Warnings are errors here, and Dask gives one where the port of its pages is taken."""
    with socket.socket() as other:
        other.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        with contextlib.suppress(OSError):  # taken by another build already, which serves as well
            other.bind(("", 8787))
            other.listen()
        with connected(Workers(1, 1, 3000), None) as client:
            assert client.submit(int, "3").result() == 3


def test_workers_leave_interrupts_to_the_main_process():
    """Each would print where it was."""
    with connected(Workers(2, 1, 3000), None) as client:
        handlers = client.run(signal.getsignal, signal.SIGINT)
        assert list(handlers.values()) == [signal.SIG_IGN] * 2


@pytest.mark.skipif(os.name != "posix", reason="a terminal's processes get Ctrl-C together on POSIX")
def test_an_interrupt_while_workers_start_is_one_line_and_leaves_nothing(tmp_path):
    """A process that is still importing cannot have been told to leave Ctrl-C to the main one."""
    psutil = pytest.importorskip("psutil")
    # enough that it is not done before, where this process has to wait for a core
    folder = make_library(tmp_path / "recipes", 12)
    command = [sys.executable, "-m", "heartcase", "library", "build", str(folder), "--out", str(tmp_path / "out")]
    with subprocess.Popen(
        [*command, "--workers", "1"],
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        start_new_session=True,
    ) as process:
        main_one = psutil.Process(process.pid)
        starting = []
        deadline = time.monotonic() + 120.0
        while not starting and process.poll() is None and time.monotonic() < deadline:
            starting = [one for one in main_one.children() if "spawn_main" in " ".join(one.cmdline())]
            time.sleep(0.01)
        assert starting
        time.sleep(0.3)
        started = main_one.children(recursive=True)
        os.killpg(process.pid, signal.SIGINT)
        said, _ = process.communicate(timeout=120)
    assert process.returncode == 130, said
    assert "Traceback" not in said
    assert "Error" not in said
    assert len([line for line in said.splitlines() if line.startswith("heartcase: interrupted")]) == 1
    psutil.wait_procs(started, timeout=20)
    assert not [one for one in started if one.is_running() and one.status() != psutil.STATUS_ZOMBIE]


@pytest.mark.parametrize("answers", [{"w": "0.0.9"}, {"w": "0.0.9", "v": __version__}, None])
def test_workers_with_another_heartcase_are_refused(answers):
    class Client:
        def run(self, _):
            if answers is None:
                raise ModuleNotFoundError("heartcase")
            return answers

    with pytest.raises(UsageError, match="install the same"):
        _check_versions(Client())


def _die(*_: object) -> None:
    os.kill(os.getpid(), signal.SIGKILL)


def test_no_case_waits_behind_another_while_a_worker_is_idle(tmp_path, monkeypatch):
    cases = tuple(LibraryCase(name, tmp_path / f"{name}.toml", "s") for name in ("long", *"abcdef"))
    with connected(Workers(2, 1, 3000), None) as client:
        monkeypatch.setattr("heartcase.library.build._build_one", _wait_for_the_short)
        records = []
        for record in build_cases(cases, client, out=tmp_path / "out"):
            records.append(record)
            # None is assigned in advance: a worker that computes cannot hand on what stands behind it.
            assert max(map(len, client.processing().values())) <= 1
    built_by = {record.name: record.problems[0][1] for record in records}
    assert len(built_by) == 7
    assert len({built_by[name] for name in "abcdef"}) == 1
    assert built_by["a"] != built_by["long"]


def _wait_for_the_short(case: LibraryCase, *_: object) -> CaseRecord:
    """Tells the process; the long one ends after the six short ones, or after a minute where one stands behind it."""
    folder, end = case.recipe.parent, time.monotonic() + 60
    if case.name == "long":
        while len(list(folder.glob("*.done"))) < 6 and time.monotonic() < end:
            time.sleep(0.02)
    else:
        time.sleep(0.2)
        (folder / f"{case.name}.done").touch()
    return CaseRecord(case.name, case.stamp, (("", str(os.getpid())),))


@pytest.mark.parametrize(
    "arguments", [("--workers", "0"), ("--memory-mb", "1"), ("--scheduler", "tcp://x", "--workers", "2")]
)
def test_numbers_that_make_no_sense_are_refused(tmp_path, arguments):
    library = make_library(tmp_path / "library", 1)
    assert main(["library", "build", str(library), "--out", str(tmp_path / "out"), *arguments]) == 2


def test_recipes_of_one_name_each_count_as_failed(tmp_path, capsys):
    library = make_library(tmp_path / "library", 1)
    (library / "twin.toml").write_text((library / "0.toml").read_text())
    assert main(["library", "build", str(library), "--out", str(tmp_path / "out")]) == 1
    assert "2 recipes: 0 built, 2 failed, 0 unchanged" in capsys.readouterr().out
    code, result = run(capsys, library, "--out", tmp_path / "out")
    assert (code, len(result["failed"]["ball-0"]), result["unchanged"]) == (1, 2, 0)


def test_workers_are_as_many_as_cores_and_memory_allow(monkeypatch):
    monkeypatch.setattr("heartcase.library.build._memory_mb", lambda: 10_000)
    monkeypatch.setattr(os, "sched_getaffinity", lambda _: set(range(8)), raising=False)
    assert default_workers() == Workers(3, 2, 3333)
    assert default_workers(8) == Workers(8, 1, 1250)
    assert default_workers(None, 1000) == Workers(8, 1, 1000)
    monkeypatch.setattr("heartcase.library.build._memory_mb", lambda: 1000)
    assert default_workers() == Workers(1, 8, 1000)
    with pytest.raises(UsageError):
        default_workers(0)


@pytest.mark.slow
def test_a_scheduler_and_two_workers_over_tcp_make_the_same(tmp_path, capsys):
    library = make_library(tmp_path / "library", 3)
    assert run(capsys, library, "--out", tmp_path / "local", "--workers", 1)[0] == 0
    file = tmp_path / "scheduler.json"
    start = [sys.executable, "-m", "distributed.cli.dask_scheduler", "--port", "0", "--no-dashboard"]
    processes = [subprocess.Popen([*start, "--scheduler-file", str(file)], stderr=subprocess.DEVNULL)]
    try:
        until = time.monotonic() + 60
        while not file.exists() and time.monotonic() < until:
            time.sleep(0.1)
        address = json.loads(file.read_text())["address"]
        worker = [sys.executable, "-m", "distributed.cli.dask_worker", address, "--nthreads", "1", "--no-dashboard"]
        processes += [subprocess.Popen(worker, stderr=subprocess.DEVNULL) for _ in range(2)]
        code, result = run(capsys, library, "--out", tmp_path / "tcp", "--scheduler", address)
        assert (code, len(result["built"])) == (0, 3)
        assert contents(tmp_path / "tcp") == contents(tmp_path / "local")
        # Without a scheduler the rest is listed as not built, and built the next time.
        late = make_library(tmp_path / "late", 4)
        stopper = threading.Timer(8.0, processes[0].kill)
        stopper.start()
        code, result = run(capsys, late, "--out", tmp_path / "lost", "--scheduler", address)
        stopper.join()
        assert code == 1
        assert "lost" in json.dumps(result["failed"])
    finally:
        for process in processes:
            process.kill()
    code, again = run(capsys, late, "--out", tmp_path / "lost", "--workers", 1)
    assert (code, again["failed"]) == (0, {})
    assert again["unchanged"] == len(result["built"])
