"""``heartcase library``: many cases from a folder of recipes."""

from __future__ import annotations

import os
import time
from collections import Counter
from collections.abc import Callable, Iterable
from pathlib import Path

import click

from heartcase.cli.library.progress import LibraryProgress
from heartcase.cli.library.review import check, diff
from heartcase.cli.shared.clock import INTERRUPTED, command_seconds
from heartcase.cli.shared.output import echo_json, error_console, print_table, working
from heartcase.cli.shared.output_path import OutputPath
from heartcase.library.plan import CaseRecord, LibraryCase, read_record, skipped_words
from heartcase.pipeline.warnings import WarningGrade, counted
from heartcase.schemas.bundle.placing import refuse_inside_case
from heartcase.schemas.errors import Problem, UsageError, how_to_install

__all__ = ["command"]


@click.group(name="library")
def command() -> None:
    """Many cases from a folder of recipes."""


command.add_command(check)
command.add_command(diff)


@command.command()
@click.argument("directory", metavar="DIR", type=click.Path(path_type=Path, readable=False))
@click.option("--out", type=OutputPath(is_folder=True), default=Path("library"), show_default=True)
@click.option("--cache", type=OutputPath(is_folder=True), help="Folder of the cache; OUT/.heartcase-cache.")
@click.option("--workers", type=int, help="Processes on this machine; left out: as cores and memory allow.")
@click.option(
    "--memory-mb", type=int, help="Memory beyond which a worker is stopped; left out: its share of what there is."
)
@click.option("--scheduler", metavar="ADDRESS", help="Use the workers of this Dask scheduler, tcp://HOST:PORT.")
@click.option("--force", is_flag=True, help="Look at every case, also those that nothing changed for.")
@click.option("--json", "as_json", is_flag=True, help="Print the result as JSON.")
def build(
    directory: Path,
    out: Path,
    cache: Path | None,
    workers: int | None,
    memory_mb: int | None,
    scheduler: str | None,
    force: bool,
    as_json: bool,
) -> None:
    """Build the case of every recipe in DIR and below, several at a time.

    Only what changed is built. A case that fails is listed, and does not stop the others; what was interrupted goes on
    from there when the library is built again. Exits with 1 where a case failed.
    """
    from heartcase.library.build import (
        build_cases,
        connected,
        default_workers,
        has_dashboard,
        make_folders,
        stale_cases,
    )
    from heartcase.library.kernels_ahead import library_kernels_ahead
    from heartcase.library.plan import plan_library

    if scheduler is not None and (workers is not None or memory_mb is not None):
        raise UsageError(
            "the scheduler's workers are as they were started: leave this out", place="--workers, --memory-mb"
        )
    if scheduler is not None and not scheduler.strip():
        raise UsageError("no address is given: leave the option out to use this machine", place="--scheduler")
    start = time.perf_counter()
    local = default_workers(workers, memory_mb) if scheduler is None else None
    skipped: list[str] = []
    cases = plan_library(directory, skip=skipped.append)
    stale = stale_cases(cases, out, force=force)
    console = error_console()

    def say(line: str) -> None:
        console.print(line, markup=False, soft_wrap=True)

    failed = [case for case in cases if case.problems]
    say(f"{counted(len(cases), 'recipe')}: {len(stale)} to build, {len(cases) - len(stale) - len(failed)} unchanged")
    if skipped:
        say(skipped_words(skipped))
    for case in failed:
        _say_failed(say, case.name, case.problems)
    planned_s = time.perf_counter() - start
    records: list[CaseRecord] = []
    if stale:
        make_folders(out, cache)
        try:
            with connected(local, scheduler, say=say) as client:
                if local is not None:
                    each = (
                        f"{local.thread_count} thread{'s' * (local.thread_count > 1)} and {local.memory_mb:,} MB each"
                    )
                    say(f"{local.count} worker{'s' * (local.count > 1)}, {each}")
                if has_dashboard():
                    say(f"dashboard: {client.dashboard_link}")
                else:
                    say(f"no dashboard: it needs bokeh: {how_to_install('library')}")
                shown = LibraryProgress(console, len(stale), local.count if local else sum(client.nthreads().values()))
                # Elsewhere, each worker compiles in its own cache what it needs.
                processes = local.count * local.thread_count if local is not None else 0
                with shown.progress, library_kernels_ahead(stale, processes=processes, told=shown.compiling()):
                    for record in build_cases(stale, client, out=out, cache=cache, hear=shown.hear):
                        records.append(record)
                        shown.case_done(record.name, record.seconds)
                        if record.problems:
                            _say_failed(say, record.name, [Problem(*one) for one in record.problems])
                        else:
                            memory = f", {record.memory_peak_mb:,.0f} MB" if record.memory_peak_mb else ""
                            say(f"  {record.name:<32} {record.seconds:7.1f} s{memory}")
        except KeyboardInterrupt:
            say(f"heartcase: interrupted; {INTERRUPTED}")
            raise click.exceptions.Exit(130) from None
    _tell(cases, failed, skipped, records, planned_s, command_seconds(), out, as_json=as_json)
    if failed or any(record.problems for record in records):
        raise click.exceptions.Exit(1)


def _say_failed(say: Callable[[str], None], name: str, problems: Iterable[Problem]) -> None:
    say(f"  {name}: failed")
    for problem in problems:
        say(f"    {problem}")


_UNCHANGED_SHOWN_MAX = 30
"""Unchanged cases with warnings that are listed, the worst first."""
_SHORT = {
    WarningGrade.ANATOMY: "the anatomy may be wrong",
    WarningGrade.LOOK: "to look at",
    WarningGrade.NOTE: "for information",
}


def warning_words(record: CaseRecord) -> str:
    """How many warnings of a case there are of which grade, the worst first."""
    count = _grade_counts(record)
    return ", ".join(f"{count[one]} {words}" for one, words in _SHORT.items() if count[one])


def _grade_counts(record: CaseRecord) -> Counter[WarningGrade]:
    # A record of before says not how much they matter: then each is worth a look.
    return Counter(record.warning_grades or (WarningGrade.LOOK,) * len(record.warnings))


def _worst_first(record: CaseRecord) -> tuple[int, int, str]:
    count = _grade_counts(record)
    return -count[WarningGrade.ANATOMY], -count[WarningGrade.LOOK], record.name


def _computed_s(built: Iterable[CaseRecord]) -> float:
    return sum(
        seconds
        for record in built
        for stage, seconds in (record.stage_seconds or {}).items()
        if stage not in record.reused
    )


def _tell(
    cases: tuple[LibraryCase, ...],
    failed: list[LibraryCase],
    skipped: list[str],
    records: list[CaseRecord],
    planned_s: float,
    seconds: float,
    out: Path,
    *,
    as_json: bool,
) -> None:
    built = [record for record in records if not record.problems]
    looked_at = {record.name for record in records} | {case.name for case in failed}
    left = [case.name for case in cases if case.name not in looked_at]
    unchanged = [record for name in left if (record := read_record(name, out)) is not None]
    wrong: dict[str, list[list[str]]] = {}
    for case in failed:
        # Recipes of one name are each listed.
        wrong.setdefault(case.name, []).extend([one.place, one.message] for one in case.problems)
    for record in records:
        if record.problems:
            wrong[record.name] = [list(one) for one in record.problems]
    failed_count = len(failed) + len(records) - len(built)
    if as_json:
        echo_json(
            {
                "out": str(out),
                "case_count": len(cases),
                "unchanged": len(cases) - len(failed) - len(records),
                "built": [
                    {
                        "name": record.name,
                        "seconds": record.seconds,
                        "stage_seconds": record.stage_seconds,
                        "reused": record.reused,
                        "memory_peak_mb": record.memory_peak_mb,
                        "warning_count": len(record.warnings),
                        "warning_grades": record.warning_grades,
                    }
                    for record in sorted(built, key=lambda record: record.name)
                ],
                "unchanged_warning_counts": {
                    record.name: len(record.warnings) for record in unchanged if record.warnings
                },
                "failed": wrong,
                "skipped": skipped,
                "planning_seconds": round(planned_s, 3),
                "seconds": round(seconds, 2),
            }
        )
        return
    if built:
        rows = [
            (
                record.name,
                f"{record.seconds:.1f}",
                f"{record.memory_peak_mb:,.0f}" if record.memory_peak_mb else "",
                ", ".join(stage for stage in record.stage_seconds or {} if stage not in record.reused),
                warning_words(record),
            )
            for record in sorted(built, key=lambda record: record.name)
        ]
        columns = ("case", "s", "peak MB", "stages computed", "warnings")
        print_table(columns, rows, title="Built", right=("s", "peak MB"))
    warned = sorted((record for record in unchanged if record.warnings), key=_worst_first)
    if warned:
        shown = [(record.name, warning_words(record)) for record in warned[:_UNCHANGED_SHOWN_MAX]]
        print_table(("case", "warnings"), shown, title="Unchanged, with warnings")
        if len(warned) > len(shown):
            click.echo(f"... and {counted(len(warned) - len(shown), 'more unchanged case')} with warnings")
    if warned or any(record.warnings for record in built):
        click.echo(f"Warnings are told in full in the reports, {out}{os.sep}NAME.report.html")
    rate = f", {len(built) / seconds * 3600:,.0f} cases an hour" if built else ""
    click.echo(
        f"{counted(len(cases), 'recipe')}: {len(built)} built, {failed_count} failed, "
        f"{len(cases) - len(failed) - len(records)} unchanged, in {seconds:.1f} s from start to end{rate}; "
        f"the stages that were computed add up to {_computed_s(built):.1f} s; cases are in {out}"
    )


@command.command()
@click.argument("recipes", nargs=-1, required=True, type=click.Path(path_type=Path, readable=False))
@click.option("--check", is_flag=True, help="Write nothing; exit with 1 where a recipe would change.")
def draw(recipes: tuple[Path, ...], check: bool) -> None:
    """Draw the markers of RECIPES whose scans are synthetic.

    What [scan.phantom] says of the heart decides where strokes, vessel ends, planned incisions and other landmarks are;
    they replace what stands below the line that says so. The rest of the recipe stays as it is.
    """
    from heartcase.library.draw import draw_recipe

    changed = 0
    for path in () if check else recipes:
        refuse_inside_case(path, place=path.name)
    for path in recipes:
        with working(f"drawing {path.name}"):
            changes = draw_recipe(path, write=not check)
        changed += changes
        click.echo(f"{path}: {('would change' if check else 'drawn') if changes else 'unchanged'}")
    if check and changed:
        raise click.exceptions.Exit(1)


@command.command()
@click.argument("out", type=OutputPath())
@click.option("--to", type=OutputPath(is_folder=True), help="Folder of the site; OUT/catalogue.")
@click.option(
    "--language", "languages", metavar="CODE", multiple=True, help="Offer only this language, and English; repeatable."
)
@click.option("--json", "as_json", is_flag=True, help="Print the result as JSON.")
def catalogue(out: Path, to: Path | None, languages: tuple[str, ...], as_json: bool) -> None:
    """Write a website that shows the cases in OUT; open its index.html in a browser, from the folder.

    A case without [about] in its recipe is refused, and so is a patient's without a recorded release. Exits with 1
    where a case was refused.
    """
    from heartcase.studio.catalogue.site import write_catalogue

    refuse_inside_case(to or out / "catalogue", place="--to")
    console = error_console()
    result = write_catalogue(
        out, to, languages=languages, say=lambda name: console.print(f"  {name}", markup=False, soft_wrap=True)
    )
    if as_json:
        echo_json(
            {
                "index": str(result.index),
                "shown": result.shown,
                "made": result.made,
                "removed": result.removed,
                "refused": {name: [[one.place, one.message] for one in why] for name, why in result.refused.items()},
                "warnings": {name: [[one.place, one.message] for one in why] for name, why in result.warnings.items()},
                "seconds": round(result.seconds, 2),
            }
        )
    else:
        for name, problems in result.warnings.items():
            for problem in problems:
                click.echo(f"{name}: warning: {problem}", err=True)
        for name, problems in result.refused.items():
            click.echo(f"{name}: refused", err=True)
            for problem in problems:
                click.echo(f"  {problem}", err=True)
        click.echo(
            f"{counted(len(result.shown), 'case')} shown: {len(result.made)} made, "
            f"{len(result.shown) - len(result.made)} unchanged; {len(result.removed)} removed, "
            f"{len(result.refused)} refused, in {result.seconds:.1f} s; open {result.index}"
        )
    if result.refused:
        raise click.exceptions.Exit(1)
