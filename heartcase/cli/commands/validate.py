"""``heartcase validate``: every problem of a case, a recipe, a simulation script, a recording or a guided tour."""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path

import click

from heartcase.cli.shared.output import echo_json, working
from heartcase.cli.shared.tours import tour_findings
from heartcase.pipeline.warnings import CaseWarning
from heartcase.schemas.bundle.approval import approval_state
from heartcase.schemas.bundle.check import check_bundle
from heartcase.schemas.bundle.format import MANIFEST_NAME
from heartcase.schemas.errors import HeartcaseError, Problem, RecipeError, UsageError
from heartcase.schemas.recipe.recipe import Recipe, load_recipe, parse_recipe, read_recipe_text
from heartcase.schemas.recording.reader import check_recording, is_recording
from heartcase.schemas.scripts.script import SimulationScript
from heartcase.schemas.touring.reading import is_tour

__all__ = ["command"]


_NO_KIND = (
    "this file is neither a recipe nor a script (.toml) nor a tour (.tour.md): give one, or the folder of a case or "
    "of a recording; for a scan, take info"
)


@click.command()
@click.argument("path", type=click.Path(path_type=Path, readable=False))
@click.option("--json", "as_json", is_flag=True, help="Print the result as JSON.")
@click.option("--case", type=click.Path(path_type=Path), help="Of a tour: the case or the recipe that it is for.")
@click.option("--run", is_flag=True, help="Of a tour: do on the built case of --case all that it does.")
@click.pass_context
@working("checking")
def command(ctx: click.Context, path: Path, as_json: bool, case: Path | None, run: bool) -> None:
    """Check PATH, a case directory, a recipe, a script (.toml), a recording or a tour (.tour.md); list every problem.

    Of a case the hash of every file and every value is checked; of a recipe also that the files it names are there and
    can be read, that its markers lie on the scan and mark background and tissue, and that none of its strokes is still
    the example of a starter recipe. What overlaps or is cut off is told as a warning.
    Of a recording every line of its log and the hash of every state is checked.
    Of a guided tour also that its case has what it names: the recipe of that name beside it, or --case, a case or a
    recipe. On a built case, --run does all that it does, step by step.
    Exit code 0: sound; 1: problems were found.
    """
    is_case = (path / MANIFEST_NAME).is_file()
    if is_tour(path) and not is_case:
        found = _Findings(*tour_findings(path, case, run=run))
    elif case is not None or run:
        raise UsageError("--case and --run are for guided tours (.tour.md)", place="PATH")
    else:
        found = _findings(path)
    problems = found.problems
    approval = approval_state(path) if is_case and not is_recording(path) else None
    if as_json:
        listed = [{"place": problem.place, "message": problem.message} for problem in problems]
        stated = {"approval": approval.as_dict()} if approval else {}
        told = {"warnings": [warning.text for warning in found.warnings]} if found.warnings else {}
        echo_json({"valid": not problems, "problems": listed, **told, **stated})
    else:
        for problem in problems:
            click.echo(str(problem))
        for warning in found.warnings:
            click.echo(f"warning: {warning}")
        click.echo(f"{len(problems)} problem{'s' * (len(problems) != 1)} found" if problems else "sound")
        if approval is not None:
            click.echo(approval.words)
    if problems:
        ctx.exit(1)


@dataclass(frozen=True)
class _Findings:
    """What is to be said of a path."""

    problems: tuple[Problem, ...] = ()
    warnings: tuple[CaseWarning, ...] = ()


def _findings(path: Path) -> _Findings:
    if path.suffix == ".toml" and not path.exists():
        return _Findings((Problem("PATH", "there is nothing at this path: check its spelling"),))
    if is_recording(path):
        return _Findings(tuple(check_recording(path)))
    if path.is_file() and path.suffix != ".toml":
        return _Findings((Problem("PATH", _NO_KIND),))
    if path.is_dir() and path.suffix == ".toml" and not (path / MANIFEST_NAME).is_file():
        return _Findings((Problem("PATH", "this is a folder, and recipes and scripts are files: give the .toml file"),))
    if path.suffix != ".toml" or not path.is_file():
        return _Findings(check_bundle(path))
    try:
        if _is_script(path):
            from heartcase.simulator.session.script import load_script

            load_script(path)
            return _Findings()
        recipe = load_recipe(path)
    except RecipeError as error:
        return _Findings((*error.problems, *_missing_beside(path)))
    except HeartcaseError as error:
        return _Findings(error.problems)
    inputs = _input_findings(recipe, path.parent)
    problems = (*recipe.missing_files(path.parent), *inputs.problems)
    if recipe.lock is None:
        return _Findings(problems, inputs.warnings)
    from heartcase.pipeline.building.lock import changed_files

    return _Findings((*problems, *changed_files(recipe, path.parent)), inputs.warnings)


def _missing_beside(path: Path) -> tuple[Problem, ...]:
    """Files that are not there, of a recipe that is wrong; none where it lacks more than markers."""
    try:
        return parse_recipe(read_recipe_text(path), needs_markers=False).missing_files(path.parent)
    except RecipeError:
        return ()


def _input_findings(recipe: Recipe, directory: Path) -> _Findings:
    try:
        from heartcase.pipeline.building.input_check import check_inputs
    except ImportError:
        # without the libraries that build, the recipe is still checked for all else
        return _Findings()
    checked = check_inputs(recipe, directory)
    return _Findings(checked.problems, checked.warnings)


def _is_script(path: Path) -> bool:
    """Whether a TOML file is meant as a simulation script: by its version key, or by what only scripts have."""
    keys = set(re.findall(r"^\s*\[{0,2}\s*(\w+)", path.read_text(encoding="utf-8", errors="replace"), re.M))
    if {"heartcase_recipe", "heartcase_script"} & keys:
        return "heartcase_recipe" not in keys
    only_recipe, only_script = set(Recipe.model_fields), set(SimulationScript.model_fields)
    return len(keys & only_script) > len(keys & only_recipe)
