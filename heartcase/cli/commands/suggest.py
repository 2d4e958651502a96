"""``heartcase suggest``: where one more stroke is worth most, and when to stop; and where vessels end."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import click

from heartcase.cli.shared.output import echo_json, print_table, working
from heartcase.cli.shared.output_path import OutputPath
from heartcase.schemas.bundle.placing import refuse_inside_case
from heartcase.schemas.errors import UsageError

if TYPE_CHECKING:
    pass

__all__ = ["command"]


@click.command()
@click.argument("recipe", type=click.Path(path_type=Path, readable=False))
@click.option(
    "--out",
    type=OutputPath(is_folder=True),
    default=Path(),
    help="Where the case goes, with the build's cache; here by default.",
)
@click.option("--count", type=click.IntRange(1, 100), default=5, show_default=True, help="Places to name, at most.")
@click.option("--ends", is_flag=True, help="Find where vessels end instead, and propose the discs that cut them open.")
@click.option("--write", is_flag=True, help="With --ends: write the discs at the end of RECIPE.")
@click.option("--json", "as_json", is_flag=True, help="Print the result as JSON.")
def command(recipe: Path, out: Path, count: int, ends: bool, write: bool, as_json: bool) -> None:
    """Name the places of RECIPE's segmentation where one more stroke is worth most.

    Look at each in the scan. Where its label is wrong, paint the right one there: a dab of a brush narrower than the
    radius given changes exactly the volume given, or in smooth blood of a CT at least that. Where it is right, nothing
    need be done.

    With --ends, name the places where vessels end that no entry of 'ends' cuts, with the lines to put into RECIPE.
    --write puts them there; the rest of it stays, but for ends = "automatic", which they take the place of.
    """
    if ends:
        if write:
            refuse_inside_case(recipe, place="RECIPE")
        _suggest_ends(recipe, out, write=write, as_json=as_json)
        return
    if write:
        raise UsageError("goes with --ends: strokes are for you to paint", place="--write")
    from heartcase.pipeline.building.session_file import open_session
    from heartcase.pipeline.markers.load_markers import check_markers

    with working("segmenting"):
        opened = open_session(recipe, out=out)
        table = opened.session.table
        check_markers(opened.session.markers(), table, automatic=opened.recipe.segment.automatic)
        found = opened.session.suggest(count=count)
    if as_json:
        echo_json(found.as_json(table))
        return
    if not found.places:
        click.echo("No place is unsure enough to be worth a stroke.")
        return
    rows = [
        (
            ", ".join(f"{x:.1f}" for x in place.position_mm),
            table[place.label].name,
            table[place.rival].name,
            f"{place.change_ml:.2f}",
            f"{place.radius_mm:.1f}",
            f"{place.confidence:.2f}",
        )
        for place in found.places
    ]
    right = ("changes,\nml", "brush\nbelow, mm", "confidence")
    # Narrow, so that the table fits where lines have 100 characters.
    print_table(
        ("at (LPS), mm", "is now", "could be", *right),
        rows,
        right=right,
        width_max=dict.fromkeys(("is now", "could be"), 19),
    )
    click.echo(
        f"The best place after these is worth {found.rest_ml:.2f} ml (what it changes, at most 5 ml, times "
        "1 - confidence):\nwhen that is less than you care for, and these are right, stop."
    )


def _suggest_ends(recipe: Path, out: Path, *, write: bool, as_json: bool) -> None:
    from heartcase.pipeline.building.recipe_ends import propose_ends

    with working("segmenting, and looking for the ends of vessels"):
        proposed = propose_ends(recipe, out=out)
        saved = proposed.save() if write else 0
    if as_json:
        echo_json(
            {
                "ends": [end._asdict() for end in proposed.ends],
                "without": list(proposed.dropped),
                "problems": [{"place": one.place, "message": one.message} for one in proposed.problems],
                "written": saved,
            }
        )
        return
    for problem in proposed.problems:
        click.echo(f"in the recipe now: {problem}", err=True)
    for line in proposed.dropped:
        click.echo(f"note: {line}", err=True)
    if not proposed.ends:
        click.echo("No vessel ends anywhere else than where the recipe cuts it.")
        return
    right = ("radius, mm", "lumen's radius, mm")
    rows = [
        (
            end.label,
            ", ".join(f"{v:.1f}" for v in end.position_mm),
            ", ".join(f"{v:.2f}" for v in end.axis),
            "" if end.is_open else f"{end.radius_mm:.1f}",
            f"{end.lumen_radius_mm:.1f}",
            "open at the face: needs no disc" if end.is_open else "to be cut",
        )
        for end in proposed.ends
    ]
    print_table(("vessel", "at (LPS), mm", "axis out of the heart", *right, ""), rows, right=right)
    if write:
        click.echo(f"wrote {saved} entries of 'ends' at the end of {recipe}")
    elif proposed.toml:
        click.echo(f"These lines in the recipe cut them (--write puts them there):\n\n{proposed.toml}", nl=False)
