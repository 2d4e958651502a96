"""Nothing is written into the folder of a case: a file more would make it unsound, and end its approval."""

from __future__ import annotations

import shutil
from collections.abc import Iterator
from pathlib import Path

import click
import pytest

from heartcase.cli.main import COMMANDS, cli, main
from heartcase.cli.shared.output_path import OutputPath
from heartcase.schemas.bundle.check import check_bundle
from heartcase.schemas.bundle.placing import refuse_inside_case
from heartcase.schemas.errors import UsageError
from heartcase.simulator.load import load_case
from heartcase.simulator.session.operating_session import OperatingSession
from heartcase.simulator.session.recorder import Recorder
from heartcase.simulator.simulation import Simulation
from tests.golden.make import CASE

REFUSED = "this is the folder of a case, or lies in one"
READ_ONLY = {
    "arguments", "case", "cases", "choice", "directory", "edits", "filtered", "grid", "grid_map", "labels", "markers",
    "new", "old", "path", "plans", "recipe", "recipes", "recording", "recording_path", "recordings", "scan",
    "script_path", "structures", "surface",
}  # fmt: skip
"""Arguments that say what is read."""


@pytest.fixture
def case(tmp_path: Path) -> Path:
    return Path(shutil.copytree(CASE, tmp_path / "x.case"))


def contents(folder: Path) -> dict[str, bytes]:
    return {path.relative_to(folder).as_posix(): path.read_bytes() for path in folder.rglob("*") if path.is_file()}


@pytest.mark.parametrize("command", [
    "export {case} --out {case}/render.glb", "export {case} --out {case}/x.stl", "export {case} --web --out {case}",
    "record {case} --out {case}/r.recording", "view {case} --record {case}/r.recording",
    "replay r.recording --case {case} --take-over s.toml --out {case}/r.recording",
    "simulate {case} --picture {case}/p.png", "simulate {case} --surface {case}/p.ply",
    "simulate {case} --animation {case}/p.gif", "simulate {case} --templates {case}",
    "preview {case} --out {case}/q.png", "compare-incisions {case} p.toml --page {case}/p.html",
    "compare-incisions {case} p.toml --recordings {case}", "phantom {case}/deep", "schema --out {case}/deep/er",
    "build r.toml --out {case}", "build r.toml --cache {case}/cache", "lock {case}/r.toml",
    "new scan.nii.gz --out {case}/r.toml", "library build recipes --out {case}/lib", "library draw {case}/r.toml",
    "library catalogue {case}", "paint {case}/r.toml", "upgrade {case}/r.toml --write",
    "suggest {case}/r.toml --ends --write", "studio {case} --out {case}", "studio scan.nii.gz --recipe {case}/r.toml",
    "filter scan.nii.gz {case}/f.nii.gz", "surface w.safetensors s.safetensors --glb {case}/s.glb",
    "bundle g.safetensors {case}/y.case --scan scan.nii.gz",
])  # fmt: skip
def test_no_command_writes_into_a_case(case, monkeypatch, capsys, command):
    recipe = 'heartcase_recipe = 1\nname = "a"\n[scan]\npath = "s.nii.gz"\n'
    is_beside = "{case}/r.toml" in command and "--out" not in command and "--recipe" not in command
    if is_beside:
        (case / "r.toml").write_text(recipe)
    (case.parent / "r.toml").write_text(recipe)
    monkeypatch.chdir(case.parent)
    before = contents(case.parent)
    render = next(case.glob("render-*.glb")).name
    assert main(command.replace("render.glb", render).replace("{case}", str(case)).split()) == 2
    said = capsys.readouterr().err.splitlines()
    assert len([line for line in said if REFUSED in line]) == 1
    assert [line for line in said if line.startswith("heartcase:")] == said[-1:]
    assert contents(case.parent) == before
    assert is_beside or check_bundle(case) == ()


def test_links_into_a_case_and_in_one_are_followed(case, tmp_path):
    (tmp_path / "link").symlink_to(case)
    (tmp_path / "file.stl").symlink_to(case / "x.stl")
    (case / "out.stl").symlink_to(tmp_path / "elsewhere.stl")
    for path in (tmp_path / "link" / "x.stl", tmp_path / "file.stl", case / "out.stl", case / "a" / ".." / "b.stl"):
        with pytest.raises(UsageError, match="choose another place"):
            refuse_inside_case(path, place="--out")
    refuse_inside_case(case.parent / "y.stl", place="--out")
    refuse_inside_case(case, place="OUTPUT", is_case=True)


def test_the_present_folder_may_be_that_of_a_case(case, monkeypatch, capsys):
    monkeypatch.chdir(case)
    assert main(["new", "../scan.nii.gz"]) == 2
    assert f"--out: {REFUSED}" in capsys.readouterr().err


def test_a_recorder_refuses_it_too(case):
    loaded = load_case(case, needs=("grid",))
    with pytest.raises(UsageError, match="choose another place"):
        Recorder(OperatingSession(Simulation(loaded.model)), case / "r.recording")
    assert check_bundle(case) == ()


def paths_of(command: click.Command, name: str) -> Iterator[tuple[str, click.Parameter]]:
    if isinstance(command, click.Group):
        for inner, one in command.commands.items():
            yield from paths_of(one, f"{name} {inner}")
    for param in command.params:
        if isinstance(param.type, click.Path):
            yield name, param


def test_every_path_that_is_written_to_is_an_output_path():
    context = click.Context(cli)
    commands = [(name, cli.get_command(context, name)) for name in COMMANDS]
    found = [one for name, command in commands if command for one in paths_of(command, name)]
    unsaid = [
        f"{name} {param.name}"
        for name, param in found
        if not isinstance(param.type, OutputPath)
        and (param.name not in READ_ONLY or {"--out", "--recordings"} & {*param.opts})
    ]
    # it looks at what was built there
    assert unsaid == ["library check out"]
    assert len(found) - len(unsaid) > 60
