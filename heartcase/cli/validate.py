"""``heartcase validate``: every problem of a case, a recipe or a simulation script."""

from __future__ import annotations

import re
from pathlib import Path

import click

from heartcase.cli.output import echo_json, working
from heartcase.schemas.approval import approval_state
from heartcase.schemas.bundle_check import check_bundle
from heartcase.schemas.errors import HeartcaseError, Problem
from heartcase.schemas.recipe import Recipe, load_recipe
from heartcase.schemas.script import SimulationScript

__all__ = ["command"]


@click.command()
@click.argument("path", type=click.Path(path_type=Path, readable=False))
@click.option("--json", "as_json", is_flag=True, help="Print the result as JSON.")
@click.pass_context
@working("checking")
def command(ctx: click.Context, path: Path, as_json: bool) -> None:
    """Check PATH, a case directory, a recipe (.toml) or a simulation script (.toml), and list every problem.

    Of a case the hash of every file and every value is checked; of a recipe also that the files it names are there,
    and that its strokes mark background and tissue where no file or program marks anything.
    Exit code 0: sound; 1: problems were found.
    """
    problems = _problems(path)
    approval = approval_state(path) if path.is_dir() else None
    if as_json:
        found = [{"place": problem.place, "message": problem.message} for problem in problems]
        stated = {"approval": approval.as_dict()} if approval else {}
        echo_json({"valid": not problems, "problems": found, **stated})
    else:
        for problem in problems:
            click.echo(str(problem))
        click.echo(f"{len(problems)} problem{'s' * (len(problems) != 1)} found" if problems else "sound")
        if approval is not None:
            click.echo(approval.words)
    if problems:
        ctx.exit(1)


def _problems(path: Path) -> tuple[Problem, ...]:
    if path.suffix == ".toml" and not path.exists():
        return (Problem("PATH", "there is nothing at this path: check its spelling"),)
    if path.suffix != ".toml" or not path.is_file():
        return check_bundle(path)
    try:
        if _is_script(path):
            from heartcase.simulator.script import load_script

            load_script(path)
            return ()
        recipe = load_recipe(path)
    except HeartcaseError as error:
        return error.problems
    problems = (*recipe.missing_files(path.parent), *_stroke_problems(recipe))
    if recipe.lock is None:
        return problems
    from heartcase.pipeline.lock import changed_files

    return (*problems, *changed_files(recipe, path.parent))


def _stroke_problems(recipe: Recipe) -> tuple[Problem, ...]:
    try:
        from heartcase.pipeline.stages import stroke_problems

        return stroke_problems(recipe)
    except ImportError:
        # without the libraries that build, the recipe is still checked for all else
        return ()


def _is_script(path: Path) -> bool:
    """Whether a TOML file is meant as a simulation script: by its version key, or by what only scripts have."""
    keys = set(re.findall(r"^\s*\[{0,2}\s*(\w+)", path.read_text(encoding="utf-8", errors="replace"), re.M))
    if {"heartcase_recipe", "heartcase_script"} & keys:
        return "heartcase_recipe" not in keys
    only_recipe, only_script = set(Recipe.model_fields), set(SimulationScript.model_fields)
    return len(keys & only_script) > len(keys & only_recipe)
