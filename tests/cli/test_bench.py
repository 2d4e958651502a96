"""``heartcase bench``: that of the repository that it is run in, or that heartcase lies in."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

import heartcase
from heartcase.cli.commands import bench
from heartcase.cli.main import main

ROOT = Path(heartcase.__file__).parents[1]


@pytest.mark.parametrize("folder", [ROOT, ROOT / "docs", Path(ROOT.anchor)])
def test_the_repository_is_found(folder, monkeypatch, capsys):
    monkeypatch.chdir(folder)
    assert main(["bench", "--list", "filter-6.4m"]) == 0
    assert capsys.readouterr().out.startswith("filter-6.4m-voxels ")


def test_options_and_help_are_those_of_the_runner(capsys):
    assert main(["bench", "-h"]) == 0
    assert "Usage: heartcase bench [OPTIONS] [NAMES]" in capsys.readouterr().out
    assert main(["bench", "--no-such"]) == 2
    assert "--no-such" in capsys.readouterr().err


def test_the_module_of_the_repository_is_run_the_same():
    run = [sys.executable, "-m", "benchmarks", "--list", "filter-6.4m"]
    done = subprocess.run(run, cwd=ROOT, capture_output=True, text=True, check=True, timeout=120)
    assert done.stdout.startswith("filter-6.4m-voxels ")


def test_where_there_is_none_one_line_says_so(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(bench, "_PACKAGE", tmp_path / "site-packages" / "heartcase")
    for arguments in ([], ["--list"], ["--help"]):
        assert main(["bench", *arguments]) == 2
        said = capsys.readouterr()
        assert said.out == ""
        assert said.err == (
            "heartcase: the benchmarks are not installed with heartcase: run this in a checkout of its repository\n"
        )


def test_the_repository_s_own_runner_is_taken_where_another_package_is_called_benchmarks(tmp_path):
    other = tmp_path / "benchmarks"
    other.mkdir()
    (other / "__init__.py").write_text("raise RuntimeError('another one')\n")
    paths = os.pathsep.join([str(tmp_path), str(ROOT)])
    run = [sys.executable, "-m", "heartcase", "bench", "--list", "filter-6.4m"]
    environment = os.environ | {"PYTHONPATH": paths}
    done = subprocess.run(run, cwd=tmp_path, env=environment, capture_output=True, text=True, check=False, timeout=120)
    assert done.returncode == 0, done.stderr
    assert done.stdout.startswith("filter-6.4m-voxels ")
