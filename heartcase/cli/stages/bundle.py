"""``heartcase bundle``: write a case from the outputs of the stages."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import click

from heartcase.cli.shared.output import echo_warnings, working
from heartcase.cli.shared.output_path import OutputPath
from heartcase.cli.shared.stage_io import scan_options
from heartcase.cli.stages.run import stage_run
from heartcase.schemas.errors import UsageError

__all__ = ["command"]


@click.command()
@click.argument("grid", type=click.Path(path_type=Path, readable=False))
@click.argument("output", type=OutputPath(is_case=True))
@click.option(
    "--scan",
    type=click.Path(path_type=Path, readable=False),
    required=True,
    help="The scan that the case was made from.",
)
@click.option("--surface", type=click.Path(path_type=Path, readable=False), help="Output of 'heartcase surface'.")
@click.option("--map", "grid_map", type=click.Path(path_type=Path, readable=False), help="Output of 'heartcase map'.")
@click.option(
    "--structures",
    type=click.Path(path_type=Path, readable=False),
    help="Output of 'walls' or 'edit': adds the labels, the openings and what the scan cuts off.",
)
@click.option(
    "--filtered",
    type=click.Path(path_type=Path, readable=False),
    help="Output of 'heartcase filter': adds the slices, where the recipe's parts name 'scan'.",
)
@click.option(
    "--recipe",
    type=click.Path(path_type=Path, readable=False),
    help="Materials, landmarks, diagnoses and parts from a recipe.",
)
@scan_options
@working("writing the case")
def command(
    grid: Path,
    output: Path,
    scan: Path,
    surface: Path | None,
    grid_map: Path | None,
    structures: Path | None,
    filtered: Path | None,
    recipe: Path | None,
    choice: dict[str, Any],
) -> None:
    """Write the case OUTPUT (NAME.case) from GRID and the other stages' outputs.

    Warnings, figures and provenance of all stages are those that 'heartcase build' gives: outputs carry them on.
    """
    from heartcase.pipeline.building.lock import check_lock
    from heartcase.pipeline.bundle.assembly import StageResults, assemble_case
    from heartcase.pipeline.bundle.write_bundle import write_bundle
    from heartcase.pipeline.data import GridMap, Scan, SimulationGrid, Structures, Surface
    from heartcase.pipeline.stages.resolve import case_id_of
    from heartcase.pipeline.warnings import CaseWarning
    from heartcase.schemas.recipe.recipe import Part

    work = stage_run(recipe)
    cells, mesh, tied, fields, smooth = work.take(
        {
            "GRID": (grid, SimulationGrid),
            "--surface": (surface, Surface),
            "--map": (grid_map, GridMap),
            "--structures": (structures, Structures),
            "--filtered": (filtered, Scan),
        }
    )
    history, is_known = work.history, work.is_known
    volume = work.take_scan(scan, choice)
    if fields is not None and not fields.geometry.matches(volume.geometry):
        raise UsageError(
            "lie on another lattice than the scan: give the scan, and the recipe, that they were made from",
            place="--structures",
        )
    parts = work.recipe.parts
    if work.has_recipe and Part.SCAN in parts and smooth is None:
        raise UsageError("the recipe's parts name 'scan': give the output of 'heartcase filter'", place="--filtered")
    name = output.name.removesuffix(".case")
    told = dict(history.told)
    told["lock"] = check_lock(work.recipe, work.work.directory, volume)
    if not is_known:
        unknown = "an output of a stage does not say how it came about, so what was told on the way is not known here"
        told["unknown"] = (*told.get("unknown", ()), CaseWarning(unknown))
    assembled = assemble_case(
        work.recipe,
        StageResults(
            scan=volume,
            grid=cells,
            structures=fields,
            surface=mesh,
            grid_map=tied,
            filtered=smooth,
            whole=work.outputs.whole,
            stages=history.stages,
            told=told,
        ),
        name=name,
        case_id=case_id_of(work.recipe, volume, name=name),
    )
    write_bundle(output, assembled.content)
    echo_warnings(assembled.warnings)
    click.echo(f"wrote {output}", err=True)
