"""``heartcase validate``: every problem of a case, a recipe or a simulation script."""

from __future__ import annotations

from pathlib import Path

import click

from heartcase.cli.output import echo_json, working
from heartcase.schemas.approval import approval_state
from heartcase.schemas.bundle_check import check_bundle
from heartcase.schemas.errors import HeartcaseError, Problem
from heartcase.schemas.recipe import load_recipe

__all__ = ["command"]


@click.command()
@click.argument("path", type=click.Path(path_type=Path))
@click.option("--json", "as_json", is_flag=True, help="Print the result as JSON.")
@click.pass_context
@working("checking")
def command(ctx: click.Context, path: Path, as_json: bool) -> None:
    """Check PATH, a case directory, a recipe (.toml) or a simulation script (.toml), and list every problem.

    Of a case the hash of every file and every value is checked; of a recipe also that the files it names are there.
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
    if path.suffix == ".toml" and path.is_file():
        try:
            if "heartcase_recipe" in path.read_text(encoding="utf-8", errors="replace"):
                return load_recipe(path).missing_files(path.parent)
            from heartcase.simulator.script import load_script

            load_script(path)
        except HeartcaseError as error:
            return error.problems
        return ()
    return check_bundle(path)
