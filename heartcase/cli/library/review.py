"""``heartcase library check`` and ``diff``: cases against the truth, and against those of another build."""

from __future__ import annotations

from pathlib import Path

import click

from heartcase.cli.shared.output import echo_json, print_table, working
from heartcase.pipeline.warnings import counted
from heartcase.schemas.errors import UsageError

__all__ = ["check", "diff"]

_LEGEND = (
    "Dice: 1 where case and truth agree in all voxels, 0 where they share none. Tissue: muscle and all walls together. "
    "Worst label: the least of the structures that were segmented, mostly cavities, so it may be above the tissue's. "
    "Surface: mean distance from the true one, and what 95% keep to. Holes: true diameter, error, how far off."
)


@click.command()
@click.argument("directory", metavar="DIR", type=click.Path(path_type=Path, readable=False))
@click.option(
    "--out", type=click.Path(path_type=Path, readable=False), default=Path("library"), show_default=True,
    help="Where the cases are.",
)  # fmt: skip
@click.option(
    "--dice", "least_dice", type=float, default=0.85, show_default=True, help="Dice below which the tissue is told."
)
@click.option("--surface-mm", type=float, default=1.0, show_default=True, help="How far 95% of the surface may be off.")
@click.option("--hole-mm", type=float, default=2.0, show_default=True, help="How far a hole's diameter may be off.")
@click.option("--json", "as_json", is_flag=True, help="Print the result as JSON.")
def check(directory: Path, out: Path, least_dice: float, surface_mm: float, hole_mm: float, as_json: bool) -> None:
    """Compare the cases of DIR's recipes whose scans are synthetic with the hearts that they were made from.

    Exits with 1 where a case is missing, other cavities are connected or open to each other than in truth, or an error
    is more than allowed.
    """
    from heartcase.library.check import check_case, problems_of
    from heartcase.library.plan import plan_library
    from heartcase.schemas.errors import HeartcaseError, RecipeError
    from heartcase.schemas.recipe.recipe import load_recipe

    rows, found, wrong = [], [], 0
    for planned in plan_library(directory):
        try:
            recipe = load_recipe(planned.recipe)
            if recipe.scan.phantom is None:
                continue
            if planned.problems:
                raise RecipeError(planned.problems)
            with working(f"checking {planned.name}"):
                result = check_case(out / f"{planned.name}.case", recipe.scan.phantom)
        except HeartcaseError as error:
            wrong += 1
            found.append({"name": planned.name, "problems": [str(one) for one in error.problems]})
            rows.append((planned.name, "", "", "", "", "", str(error.problems[0])))
            continue
        problems = problems_of(result, least_dice=least_dice, surface_mm=surface_mm, diameter_mm=hole_mm)
        wrong += bool(problems)
        found.append(result.as_dict() | {"problems": list(problems)})
        holes = [
            f"{one.kind} {one.diameter_mm:.1f}"
            + (
                ""
                if one.diameter_error_mm is None
                else f"{one.diameter_error_mm:+.1f}, off {one.position_error_mm:.1f}"
            )
            for one in result.defects
        ]
        rows.append(
            (
                result.name,
                f"{result.tissue_dice:.3f}",
                f"{min(result.dice.values()):.3f}" if result.dice else "",
                f"{result.surface.mean_mm:.2f}",
                f"{result.surface.percentile_95_mm:.2f}",
                "; ".join(holes),
                "; ".join(problems),
            )
        )
    if as_json:
        echo_json({"cases": found, "wrong_count": wrong})
    else:
        columns = (
            "case",
            "Dice of tissue",
            "Dice of worst label",
            "surface mm",
            "95%",
            "holes mm",
            "worse than allowed",
        )
        print_table(columns, rows, right=("Dice of tissue", "Dice of worst label", "surface mm", "95%"))
        click.echo(_LEGEND)
        click.echo(f"{counted(len(rows), 'case')} compared with the truth, {wrong} to be looked at")
    if wrong:
        raise click.exceptions.Exit(1)


@click.command()
@click.argument("old", type=click.Path(path_type=Path, readable=False))
@click.argument("new", type=click.Path(path_type=Path, readable=False))
@click.option("--surface-mm", type=float, default=0.5, show_default=True, help="How far the surface may move.")
@click.option("--volume-percent", type=float, default=1.0, show_default=True, help="How much any volume may change.")
@click.option("--node-percent", type=float, default=2.0, show_default=True, help="How much the number of nodes may.")
@click.option("--json", "as_json", is_flag=True, help="Print the result as JSON.")
def diff(old: Path, new: Path, surface_mm: float, volume_percent: float, node_percent: float, as_json: bool) -> None:
    """Say what changed between two builds, OLD and NEW, of a library.

    Exits with 1 where something changed by more than is allowed, a case is gone or has new warnings.
    """
    from heartcase.library.diff import Tolerances, diff_libraries

    for value, name in ((surface_mm, "surface-mm"), (volume_percent, "volume-percent"), (node_percent, "node-percent")):
        if not value >= 0.0:
            raise UsageError("give 0 or more", place=f"--{name}")
    with working("comparing"):
        changes = diff_libraries(old, new, Tolerances(surface_mm, volume_percent, node_percent))
    beyond = [change for change in changes if change.beyond]
    if as_json:
        echo_json({"cases": [change.as_dict() for change in changes], "beyond_count": len(beyond)})
    else:
        rows = [
            (
                change.name,
                change.kind,
                "" if change.surface_most_mm is None else f"{change.surface_most_mm:.3f}",
                "" if change.volume_percent is None else f"{change.volume_percent:.2f}",
                "" if change.node_count is None else f"{change.node_count[1] - change.node_count[0]:+,}",
                ", ".join(change.stages),
                "; ".join((*change.beyond, *change.new_warnings)),
            )
            for change in changes
            if change.kind != "same"
        ]
        if rows:
            columns = ("case", "is", "surface mm", "volume %", "nodes", "stages that differ", "more than is allowed")
            print_table(columns, rows, right=("surface mm", "volume %", "nodes"))
        for change in changes:
            for warning in change.changed_warnings:
                click.echo(f"{change.name}: a warning has other numbers now: {warning}")
        count = {kind: sum(change.kind == kind for change in changes) for kind in ("same", "changed", "added")}
        click.echo(
            f"{counted(len(changes), 'case')}: {count['same']} the same to the byte, {count['changed']} changed, "
            f"{count['added']} added, {len(beyond)} to be looked at"
        )
    if beyond:
        raise click.exceptions.Exit(1)
