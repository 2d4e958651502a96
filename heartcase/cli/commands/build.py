"""``heartcase build``: from a recipe to a case."""

from __future__ import annotations

import time
from pathlib import Path

import click
from rich.console import Console
from rich.progress import Progress as RowsOfProgress
from rich.progress import TaskID, TimeElapsedColumn

from heartcase.cli.shared.clock import INTERRUPTED, command_seconds
from heartcase.cli.shared.compiling import Compiling
from heartcase.cli.shared.output import echo_json, echo_warnings, working
from heartcase.cli.shared.output_path import OutputPath
from heartcase.cli.shared.stage_bars import TimedBar, TimeLeft, stage_result
from heartcase.schemas.recipe.recipe import load_recipe

__all__ = ["command"]


def _title(stage: str) -> str:
    """What a stage or the report does; the pipeline is loaded by then, and not for a page of help."""
    from heartcase.pipeline.stages.table import step_named

    return step_named(stage).title


class _Bar:
    """Shows on standard error which stage runs, for how long, and how long the build may still take."""

    def __init__(self, console: Console) -> None:
        columns = ("{task.description}", TimedBar(24), TimeElapsedColumn(), TimeLeft())
        self.progress = RowsOfProgress(*columns, console=console, transient=True, disable=not console.is_terminal)
        self.console = console
        self.task: TaskID | None = None

    def stage_started(self, stage: str, *, seconds_expected: float, seconds_after: float) -> None:
        words = _title(stage)
        self.task = self.progress.add_task(words, total=max(seconds_expected, 0.1), seconds_after=seconds_after)

    def stage_finished(self, stage: str, *, seconds: float, reused: bool) -> None:
        if self.task is not None:
            self.progress.remove_task(self.task)
            self.task = None
        words = _title(stage)
        self.console.print(f"  {words:<28} {stage_result(seconds, reused=reused)}", highlight=False)


@click.command()
@click.argument("recipe", type=click.Path(path_type=Path, readable=False))
@click.option(
    "--out",
    type=OutputPath(is_folder=True),
    default=Path(),
    help="Where the case goes; here by default.",
)
@click.option("--cache", type=OutputPath(is_folder=True), help="Directory of the cache; OUT/.heartcase-cache.")
@click.option("--force", is_flag=True, help="Compute every stage anew.")
@click.option(
    "--until",
    metavar="STAGE",
    help="Stop after this stage: read, markers, filter, segment, walls, edit, grid, surface or map.",
)
@click.option("--accept-inputs", is_flag=True, help="Build a locked recipe with another scan or other markers.")
@click.option("--replace", is_flag=True, help="Replace a case of this name that was made from another scan.")
@click.option(
    "--key-file",
    type=OutputPath(),
    help="Add a line that says whose case it is to this file. Patient data: keep it where that may be.",
)
@click.option("--json", "as_json", is_flag=True, help="Print the result as JSON.")
def command(
    recipe: Path,
    out: Path,
    cache: Path | None,
    force: bool,
    until: str | None,
    accept_inputs: bool,
    replace: bool,
    key_file: Path | None,
    as_json: bool,
) -> None:
    """Build the case that RECIPE describes: OUT/NAME.case and OUT/NAME.report.html.

    Only what changed is computed again. Interrupt it at any moment: the old case stays whole, and the next run goes
    on where this one stopped.
    """
    from heartcase.library.scans import ensure_scan, scan_is_made
    from heartcase.pipeline.building.kernels_ahead import kernels_ahead
    from heartcase.pipeline.building.run import build_case
    from heartcase.pipeline.bundle.case_id import add_to_key_file, check_key_file

    loaded = load_recipe(recipe)
    if key_file is not None:
        check_key_file(key_file, out / f"{loaded.name}.case")
    makes_scan = not scan_is_made(loaded.scan, recipe.parent)
    console = Console(stderr=True)
    bar = _Bar(console)
    compiling = Compiling(console, bar.progress)
    console.print(f"Building {loaded.name}", highlight=False)
    start = time.perf_counter()
    try:
        with kernels_ahead(loaded, makes_scan=makes_scan, until=until, told=compiling):
            if loaded.scan.phantom is not None:
                with working("making the scan"):
                    ensure_scan(loaded.scan, recipe.parent)
                # A case from the scan that was made before is an older one of the same heart.
                replace = True
            with bar.progress:
                result = build_case(
                    loaded,
                    directory=recipe.parent,
                    out=out,
                    cache=cache,
                    listener=bar,
                    force=force,
                    until=until,
                    accept_inputs=accept_inputs,
                    replace=replace,
                )
    except KeyboardInterrupt:
        click.echo(f"heartcase: interrupted; {INTERRUPTED}", err=True)
        raise click.exceptions.Exit(130) from None
    seconds = time.perf_counter() - start
    if key_file is not None and result.manifest is not None and result.manifest.case_id is not None:
        from heartcase.pipeline.formats.dicom_identity import identity_of

        identity = identity_of(recipe.parent / loaded.scan.path, **loaded.scan.choice)
        add_to_key_file(key_file, result.manifest.case_id, identity)
    if as_json:
        echo_json(
            {
                "case": str(result.case) if result.case else None,
                "report": str(result.report) if result.report else None,
                "changed": result.changed,
                "seconds": round(seconds, 2),
                "stage_seconds": {stage: round(value, 3) for stage, value in result.seconds.items()},
                "reused": list(result.reused),
                "warnings": [warning.text for warning in result.warnings],
                "warning_grades": [warning.grade for warning in result.warnings],
                "simulation": result.manifest.simulation.model_dump(mode="json") if result.manifest else None,
                "quality": result.manifest.quality if result.manifest else None,
            }
        )
        return
    echo_warnings(result.warnings)
    if result.manifest is None:
        click.echo(f"Stopped after {until}; its output is in the cache. {seconds:.1f} s.")
        return
    figures = result.manifest.simulation
    click.echo(f"Case    {result.case}" + ("" if result.changed else "  (unchanged)"))
    click.echo(f"Report  {result.report}")
    click.echo(
        f"Grid    {figures.node_count:,} nodes, {figures.cell_count:,} cells of {figures.cell_mm:.2f} mm,"
        f" {figures.fixed_node_count:,} nodes fixed, {figures.tissue_volume_ml:.1f} ml of tissue in the cells"
    )
    surface = result.manifest.quality.get("surface", {})
    if "triangle_count" in surface:
        levels = [f"{one['surface']['triangle_count']:,}" for one in result.manifest.quality.get("levels", ())]
        coarser = f"; coarser level{'s' * (len(levels) > 1)} of {' and '.join(levels)}" if levels else ""
        click.echo(f"Surface {surface['triangle_count']:,} triangles{coarser}")
    click.echo(f"Step    {figures.step_default_s * 1e3:.3f} ms ({figures.steps_per_second:,.0f} steps per second)")
    computed = sum(value for stage, value in result.seconds.items() if stage not in result.reused)
    click.echo(
        f"Time    {command_seconds():.1f} s from start to end of the command; the stages that were computed add up to "
        f"{computed:.1f} s (in the report {sum(result.seconds.values()):.1f} s, with those from the cache)"
    )
    click.echo(result.manifest.notice)
