"""A library's build compiles ahead, once, what its recipes need; a case that Python builds does only when asked."""

from __future__ import annotations

import contextlib

import pytest

from heartcase.cli.main import main
from heartcase.compiling.compile_ahead import Progress
from heartcase.library import build
from heartcase.library import kernels_ahead as module
from heartcase.library.build import Workers
from heartcase.library.kernels_ahead import library_kernels_ahead
from heartcase.library.plan import LibraryCase
from heartcase.pipeline.building import run
from heartcase.pipeline.building.kernels_ahead import kernels_needed
from heartcase.schemas.recipe.recipe import load_recipe
from tests.ball import write_ball_recipe, write_ball_scan
from tests.pipeline.building.kernels_called import sample_recipe


@pytest.fixture
def asked(monkeypatch):
    """Kernels and number of processes that were asked for."""
    calls = []

    def compiled_ahead(wanted, *, processes, told):
        calls.append(([(one.module, one.name, str(one.types)) for one in wanted], processes))
        return contextlib.nullcontext()

    monkeypatch.setattr(module, "compiled_ahead", compiled_ahead)
    return calls


def keys(path, *, makes_scan):
    return [(one.module, one.name, str(one.types)) for one in kernels_needed(load_recipe(path), makes_scan=makes_scan)]


def case(path):
    return LibraryCase(path.stem, path, "0" * 64)


def test_what_one_of_the_recipes_needs_is_compiled_and_nothing_else(tmp_path, asked):
    bare = write_ball_recipe(tmp_path / "scan.nii.gz", tmp_path / "bare.toml", parts="parts = []")
    surface = write_ball_recipe(tmp_path / "scan.nii.gz", tmp_path / "surface.toml", parts='parts = ["surface"]')
    phantom = sample_recipe(tmp_path)
    broken = tmp_path / "broken.toml"
    broken.write_text("name = ")
    ofs = [keys(bare, makes_scan=False), keys(surface, makes_scan=False), keys(phantom, makes_scan=True)]
    assert set(ofs[0]) < set(ofs[1]) < set(ofs[2])
    for paths, needed in (
        ([bare, broken], ofs[0]),
        ([bare, broken, surface], ofs[1]),
        ([bare, phantom], ofs[2]),
        ([broken, tmp_path / "gone.toml"], []),
    ):
        with library_kernels_ahead(map(case, paths), processes=3):
            pass
        wanted, processes = asked[-1]
        assert set(wanted) == set(needed)
        assert len(wanted) == len(set(wanted))
        # In the order of the stages, as in a build of one case that takes all of them.
        assert wanted == [one for one in ofs[2] if one in set(needed)]
        assert processes == 3
    with library_kernels_ahead([], processes=99):
        pass
    assert asked[-1] == ([], 8)


@pytest.mark.parametrize(("options", "processes"), [([], 6), (["--scheduler", "tcp://127.0.0.1:1"], 0)])
def test_there_are_as_many_processes_as_the_workers_have_threads_and_none_where_they_are_elsewhere(
    tmp_path, monkeypatch, capsys, options, processes
):
    write_ball_scan(tmp_path / "scan.nii.gz")
    write_ball_recipe(tmp_path / "scan.nii.gz", tmp_path / "ball.toml")
    seen = []

    class Client:
        dashboard_link = ""

        def nthreads(self):
            return {"a": 1}

    @contextlib.contextmanager
    def kernels_ahead(cases, *, processes, told):
        seen.append(([one.name for one in cases], processes))
        told(Progress(0, 0, 7, 5.0))
        told(Progress(7, 0, 7, 0.0))
        yield
        seen.append("ended")

    def builds(*_, **__):
        assert len(seen) == 1
        return iter(())

    monkeypatch.setattr(module, "library_kernels_ahead", kernels_ahead)
    monkeypatch.setattr(build, "connected", lambda *_, **__: contextlib.nullcontext(Client()))
    monkeypatch.setattr(build, "build_cases", builds)
    monkeypatch.setattr(build, "default_workers", lambda *_: Workers(3, 2, 1000))
    assert main(["library", "build", str(tmp_path), "--out", str(tmp_path / "out"), *options]) == 0
    assert seen == [(["ball"], processes), "ended"]
    assert "compiling 7 kernels meanwhile" in capsys.readouterr().err


@pytest.mark.parametrize("given", [{}, {"compile_processes": 2}])
def test_a_case_that_python_builds_starts_processes_only_where_asked_to(tmp_path, monkeypatch, given):
    write_ball_scan(tmp_path / "scan.nii.gz")
    recipe = load_recipe(write_ball_recipe(tmp_path / "scan.nii.gz", tmp_path / "ball.toml"))
    seen = []

    def kernels_ahead(recipe, *, until, processes):
        seen.append((recipe.name, until, processes))
        return contextlib.nullcontext()

    monkeypatch.setattr(run, "kernels_ahead", kernels_ahead)
    run.build_case(recipe, directory=tmp_path, out=tmp_path / "out", until="read", **given)
    assert seen == [("ball", "read", given.get("compile_processes", 0))]
