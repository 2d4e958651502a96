"""``python -m benchmarks``: sweeps, methods that are left out, pictures and the page."""

from __future__ import annotations

import functools
import json
import os
import signal
import subprocess
import sys
from itertools import product
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import settings as hypothesis_settings
from hypothesis import strategies as st
from PIL import Image

from benchmarks.runner.cases import BenchmarkCase, BenchmarkRecord, load_cases
from benchmarks.runner.command import command
from benchmarks.runner.plots import as_error, drawn_errors, write_plots
from benchmarks.runner.report import write_report
from heartcase.cli.main import main
from heartcase.schemas.errors import UsageError

ROOT = Path(__file__).parents[2]
MODULE = """
from benchmarks.runner.cases import MethodSkipped

def prepare(params):
    return params

def heartcase(inputs):
    return 1.0 / inputs["strokes"]

def peer(inputs):
    return 2.0 / inputs["strokes"]

def absent(inputs):
    raise MethodSkipped("it needs a package: pip install package")

METHODS = {"heartcase": heartcase, "peer": peer, "absent": absent}

def errors(inputs, output):
    return {"all labels mean distance [mm]": output}
"""
CASES = """
[[case]]
name = "toy-one"
module = "toy"
methods = ["heartcase", "peer"]
repeats = 1
params = { strokes = 4 }

[[case]]
name = "toy-many"
module = "toy"
methods = ["heartcase", "peer", "absent"]
repeats = 1
sweep = { noise = [29.0, 7.25], strokes = [1, 10] }
"""


def write_cases(directory: Path, text: str = CASES) -> Path:
    (directory / "cases.toml").write_text(text)
    (directory / "toy.py").write_text(MODULE)
    return directory


def bench(arguments: list[str]) -> int:
    return main(arguments, command=command, name="python -m benchmarks")


def record(method: str, *, strokes: int = 1, noise: float = 14.5, seconds: float = 1.0, **errors: float):
    named = {
        {"dice": "all labels Dice [1]", "mean": "all labels mean distance [mm]", "one": "aorta Dice [1]"}[key]: value
        for key, value in errors.items()
    }
    return BenchmarkRecord(
        case=f"table-noise{noise}-strokes{strokes}",
        group="table",
        swept=("noise", "strokes"),
        method=method,
        seconds=seconds,
        errors=named,
        params={"noise": noise, "strokes": strokes},
        repeats=1,
        peak_memory_mb=10.0,
        machine="a machine",
        version="1.0",
    )


def test_a_sweep_is_one_case_for_each_combination(tmp_path):
    cases = load_cases(write_cases(tmp_path))
    assert [case.name for case in cases] == [
        "toy-one",
        "toy-many-noise29.0-strokes1",
        "toy-many-noise29.0-strokes10",
        "toy-many-noise7.25-strokes1",
        "toy-many-noise7.25-strokes10",
    ]
    assert cases[0].group is None
    assert {case.group for case in cases[1:]} == {"toy-many"}
    assert cases[3].params == {"noise": 7.25, "strokes": 1}


@hypothesis_settings(deadline=None, max_examples=30)
@given(
    st.dictionaries(
        st.sampled_from(["noise", "strokes", "spacing_mm"]),
        st.lists(st.integers(0, 50), min_size=1, max_size=4, unique=True),
        min_size=1,
    )
)
def test_no_combination_is_lost_or_measured_twice(sweep):
    entry = BenchmarkCase(name="a", module="a", methods=("heartcase",), sweep={k: tuple(v) for k, v in sweep.items()})
    cases = entry.expanded()
    assert [tuple(case.params[key] for key in sweep) for case in cases] == list(product(*sweep.values()))
    assert len({case.name for case in cases}) == len(cases)
    assert all(BenchmarkCase.model_validate(case.model_dump()) == case for case in cases if not set(case.params) - {""})


@pytest.mark.parametrize(
    ("text", "words"),
    [
        (CASES.replace("toy-many", "toy-one").replace("sweep", "params"), "more than once"),
        (CASES.replace("params = { strokes = 4 }", "params = { noise = 1 }\nsweep = { noise = [1] }"), "in sweep"),
        (CASES.replace("[29.0, 7.25]", "[]"), "noise"),
    ],
)
def test_wrong_cases_are_refused_in_words(tmp_path, text, words):
    with pytest.raises(UsageError, match=words):
        load_cases(write_cases(tmp_path, text))


def test_the_repository_s_own_cases_are_sound():
    cases = load_cases(ROOT / "benchmarks")
    assert {case.module for case in cases} <= {path.stem for path in (ROOT / "benchmarks").glob("*.py")}
    table = [case for case in cases if case.module == "accuracy" and case.name.startswith("accuracy-")]
    # the table itself, and the child that nothing was chosen on
    assert len(table) == 4 * 3 * 5 + 2 * 3 * 3
    assert {tuple(case.methods) for case in table} == {("heartcase", "skimage", "growcut", "randomwalker")}
    # three sizes in MR and CT, two stacks of flat voxels and the real CT
    assert len([case for case in cases if case.group == "accuracy-default"]) == (3 * 5 + 2 + 1) * 3


@pytest.mark.thorough
def test_a_run_goes_on_without_a_method_that_cannot_run(tmp_path, capsys):
    write_cases(tmp_path)
    out = tmp_path / "out"
    options = ["--dir", str(tmp_path), "--json", str(out / "a.json"), "--plots", str(out), "--report", str(out)]
    assert bench(["toy-m", *options]) == 0
    printed = capsys.readouterr().out
    assert printed.count("left out: it needs a package: pip install package") == 4
    records = json.loads((out / "a.json").read_text())
    assert {(r["method"], r["params"]["strokes"]): r["errors"]["all labels mean distance [mm]"] for r in records} == {
        ("heartcase", 1): 1.0,
        ("heartcase", 10): 0.1,
        ("peer", 1): 2.0,
        ("peer", 10): 0.2,
    }
    names = {path.name for path in out.glob("*.png")}
    assert names == {f"toy-many-noise{noise}-{kind}.png" for noise in (29.0, 7.25) for kind in ("strokes", "time")}
    page = (out / "benchmarks.md").read_text()
    assert "- absent, 4 cases" in page
    assert all(f"]({name})" in page for name in names)


def test_outputs_that_cannot_be_written_are_refused_before_the_run(tmp_path, capsys):
    write_cases(tmp_path)
    file = tmp_path / "file"
    file.write_text("mine")
    before = sorted(tmp_path.rglob("*"))
    wrong = ["--json", str(file / "deep" / "a.json"), "--plots", str(file / "plots"), "--report", str(file / "report")]
    assert bench(["toy-one", "--dir", str(tmp_path), *wrong]) == 2
    said = capsys.readouterr()
    assert said.out == ""
    assert [line.split(":")[1].strip() for line in said.err.splitlines()] == ["--json", "--plots", "--report"]
    assert said.err.count("cannot be written to (not a directory): choose another place") == 3
    assert bench(["toy-one", "--dir", str(tmp_path), "--json", str(tmp_path)]) == 2
    assert "--json: is a folder" in capsys.readouterr().err
    right = ["--json", str(tmp_path / "new" / "a.json"), "--report", str(tmp_path / "new" / "report")]
    assert bench(["toy-one", "--dir", str(tmp_path), *wrong[:2], *right[2:]]) == 2
    assert sorted(tmp_path.rglob("*")) == before


def stopping(how: str) -> str:
    """A module whose second method does something in its process."""
    return MODULE.replace('    return 2.0 / inputs["strokes"]', f"    import os, signal, time\n    {how}")


def test_what_was_measured_until_a_case_fails_is_written(tmp_path, capsys):
    write_cases(tmp_path)
    (tmp_path / "toy.py").write_text(stopping("raise OSError(5, 'Input/output error')"))
    out = tmp_path / "out"
    options = ["--dir", str(tmp_path), "--json", str(out / "a.json"), "--report", str(out)]
    assert bench([*options]) == 1
    said = capsys.readouterr().err
    assert "stopped early: 1 of 14 measurements were written" in said
    assert "input/output error" in said
    assert [one["method"] for one in json.loads((out / "a.json").read_text())] == ["heartcase"]
    assert "toy-one" in (out / "benchmarks.md").read_text()
    assert bench([*options[:2]]) == 1
    assert "stopped early" not in capsys.readouterr().err


@pytest.mark.skipif(os.name != "posix", reason="sends a signal")
@pytest.mark.parametrize("measured", [0, 1])
@pytest.mark.thorough
def test_what_was_measured_until_somebody_stops_it_is_written(tmp_path, measured):
    write_cases(tmp_path)
    if measured == 0:
        swapped = CASES.replace('methods = ["heartcase", "peer"]', 'methods = ["peer", "heartcase"]')
        (tmp_path / "cases.toml").write_text(swapped)
    (tmp_path / "toy.py").write_text(stopping("os.kill(os.getppid(), signal.SIGINT); time.sleep(300.0)"))
    out = tmp_path / "a.json"
    run = [sys.executable, "-m", "benchmarks", "--dir", str(tmp_path), "--json", str(out)]
    # What runs in the background of a shell ignores this signal, and so would its children.
    heeds = functools.partial(signal.signal, signal.SIGINT, signal.SIG_DFL)
    done = subprocess.run(run, capture_output=True, text=True, timeout=120, check=False, preexec_fn=heeds, cwd=ROOT)
    assert done.returncode == 130, done.stderr
    assert "Traceback" not in done.stderr
    assert "heartcase: interrupted" in done.stderr
    assert ("stopped early: 1 of 14 measurements were written" in done.stderr) == (measured == 1)
    assert out.exists() == (measured == 1)
    if measured:
        assert [one["method"] for one in json.loads(out.read_text())] == ["heartcase"]


def test_names_select_by_prefix_and_a_sweep_is_one_line_of_the_list(tmp_path, capsys):
    write_cases(tmp_path)
    assert bench(["--list", "--dir", str(tmp_path)]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert [line.split()[0] for line in lines] == ["toy-one", "toy-many"]
    assert "4 cases: noise, strokes" in lines[1]
    assert bench(["--list", "toy-many-noise7", "--dir", str(tmp_path)]) == 0
    assert "2 cases" in capsys.readouterr().out
    assert bench(["nothing", "--dir", str(tmp_path)]) == 2
    assert "no case starts with nothing" in capsys.readouterr().err


def test_pictures_are_pictures_and_the_same_each_time(tmp_path):
    records = [
        record(method, strokes=n, seconds=s, dice=0.9, mean=1.0 / n, one=0.5)
        for method, s in (("heartcase", 0.1), ("peer", 10.0))
        for n in (1, 10)
    ]
    assert drawn_errors(records) == ["all labels Dice [1]", "all labels mean distance [mm]"]
    first = write_plots(records, tmp_path / "a")
    second = write_plots(records, tmp_path / "b")
    assert [path.name for path in first] == ["table-noise14.5-strokes.png", "table-noise14.5-time.png"]
    for one, other in zip(first, second, strict=True):
        assert one.read_bytes() == other.read_bytes()
        pixels = np.asarray(Image.open(one).convert("RGB")).reshape(-1, 3)
        colours = {tuple(colour) for colour in np.unique(pixels, axis=0).tolist()}
        assert {(0x00, 0x72, 0xB2), (0xD5, 0x5E, 0x00)} <= colours


@pytest.mark.thorough
def test_a_method_has_its_colour_also_where_another_is_missing(tmp_path):
    records = [
        record(method, strokes=n, seconds=s, dice=0.9, mean=1.0 / n, one=0.5)
        for method, s in (("heartcase", 0.1), ("a peer", 10.0), ("peer", 10.0))
        for n in (1, 10)
    ]
    records += [
        one.model_copy(update={"case": f"other-{one.case}", "group": "other"})
        for one in records
        if one.method != "a peer"
    ]
    for path in write_plots(records, tmp_path):
        pixels = np.asarray(Image.open(path).convert("RGB")).reshape(-1, 3)
        colours = {tuple(colour) for colour in np.unique(pixels, axis=0).tolist()}
        assert (0x00, 0x9E, 0x73) in colours  # of "peer", the third by name
        assert ((0xD5, 0x5E, 0x00) in colours) == (not path.name.startswith("other"))


def test_an_overlap_is_drawn_as_what_is_missing():
    assert as_error("aorta Dice [1]", 0.75) == ("aorta 1 - Dice", 0.25)
    assert as_error("aorta mean distance [mm]", 0.75) == ("aorta mean distance [mm]", 0.75)


def test_the_page_says_where_a_peer_is_better_and_only_there(tmp_path):
    records = [
        record("heartcase", strokes=1, dice=0.80, mean=1.0),
        record("peer", strokes=1, dice=0.85, mean=1.05),
        record("heartcase", strokes=2, dice=0.900, mean=1.0),
        record("peer", strokes=2, dice=0.905, mean=0.95),
        record("heartcase", strokes=3, dice=0.95, mean=2.0),
        record("peer", strokes=3, dice=0.90, mean=0.5),
    ]
    page = write_report(records, [], tmp_path).read_text()
    assert "in 4." in page
    lost = [line for line in page.splitlines() if line.startswith("| table-")]
    assert lost == [
        "| table-noise14.5-strokes1 | all labels 1 - Dice | 0.2 | 0.15 | peer |",
        "| table-noise14.5-strokes3 | all labels mean distance [mm] | 2 | 0.5 | peer |",
    ]
    assert "| 14.5 | 1 | 0.8 / 1 | **0.85 / 1.05** |" in page


def test_a_page_of_nothing_but_left_out_methods(tmp_path):
    page = write_report([], [("a", "peer", "it is not there")], tmp_path).read_text()
    assert "- peer, 1 cases from a to a: it is not there" in page
