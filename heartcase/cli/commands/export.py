"""``heartcase export``: write parts of a case in the formats of other programs."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path

import click

from heartcase.cli.shared.exported_files import (
    ENDINGS,
    ERROR_MM,
    FRAMES_PER_SECOND,
    MIN_THICKNESS_MM,
    MODELS,
    PAGE,
    PRINTED,
    RECORDED_FORMATS,
    SITE,
    TOUR_PLACES,
    WITH_SCAN,
    WRITERS,
    CaseExport,
    ExportedFile,
    model_file,
    page_file,
    recorded_file,
)
from heartcase.cli.shared.output import echo_json, error_console, file_size, working
from heartcase.cli.shared.output_path import OutputPath
from heartcase.schemas.bundle.format import LEVEL_MAX
from heartcase.schemas.errors import Problem, UsageError
from heartcase.schemas.files import atomic_write

__all__ = ["command"]


def _write_site(
    cases: Sequence[Path],
    recordings: Sequence[Path],
    out: Path,
    level: int | None,
    rate: float | None,
    *,
    tours: bool,
    is_partial: bool,
    as_json: bool,
) -> None:
    """Write a site, and say so."""
    from heartcase.pipeline.warnings import counted
    from heartcase.studio.offline.exported import site_of

    rate = FRAMES_PER_SECOND if rate is None else rate
    console = error_console()
    try:
        made = site_of(
            cases, recordings, out, level=level, frames_per_second=rate, tours=tours, is_partial=is_partial,
            say=lambda name: console.print(f"  {name}", markup=False, soft_wrap=True),
        )  # fmt: skip
    except OSError as error:
        raise _cannot_be_written(error) from None
    for warning in made.warnings:
        click.echo(f"warning: {warning}", err=True)
    if as_json:
        facts = {"format": "site", "index": str(made.index), "cases": made.names, "bytes": made.byte_count}
        echo_json(facts | ({"tours": made.tours} if tours else {}) | {"warnings": made.warnings})
    else:
        size = file_size(made.byte_count)
        click.echo(f"wrote a site of {counted(len(cases), 'case')} to {out}, {size}; open {made.index}")
        for name, titles in made.tours.items():
            click.echo(f"guided tours of {name}: {'; '.join(titles)}")
        if tours and not made.tours:
            click.echo(f"no guided tour is in it: {TOUR_PLACES}")


def _cannot_be_written(error: OSError) -> UsageError:
    reason = (error.strerror or "the system gives no reason").lower()
    words = f"cannot be written: {reason}; give a place in a folder that is there and may be written"
    return UsageError(words, place="--out")


def _suffix_of(name: str, is_recorded: bool) -> str:
    """The ending of a file name that says its format.

    Raises
    ------
    UsageError
        It says none.
    """
    endings = RECORDED_FORMATS if is_recorded else ENDINGS
    for ending in endings:
        if name.lower() == ending:
            raise UsageError(f"is an ending alone: put a name before it, such as heart{ending}", place="--out")
        if name.lower().endswith(ending):
            return ending
    raise UsageError(
        f"the file must end in one of: {', '.join(endings)}; a site, which is a folder, needs --web", place="--out"
    )


def _problems(
    suffix: str,
    model: str | None,
    scan: Path | None,
    series: str | None,
    min_thickness_mm: float | None,
    level: int,
) -> list[Problem]:
    """Options that do not go with the ending or with each other."""
    problems = []
    if series is not None and scan is None:
        problems.append(Problem("--series", "says which series of --scan: give that too, or leave it out"))
    if level and (model or "hollow" if suffix in (*MODELS["hollow"], PAGE, SITE) else None) != "hollow":
        problems.append(Problem("--level", "only the hollow model has levels of detail: leave it out"))
    if scan is not None and suffix not in WITH_SCAN:
        problems.append(Problem("--scan", f"serves only for {' and '.join(WITH_SCAN)}: leave it out"))
    if model is not None and suffix in (PAGE, SITE):
        problems.append(Problem("--model", "a page shows the hollow model: leave it out"))
    elif model is not None and suffix not in MODELS[model]:
        held = [name for name, endings in MODELS.items() if suffix in endings]
        holds = ", ".join(held) if held else "labels, and no model: leave it out"
        problems.append(Problem("--model", f"{suffix} holds {holds}; {model} is written as {', '.join(MODELS[model])}"))
    if min_thickness_mm is not None and suffix not in PRINTED:
        problems.append(Problem("--min-thickness-mm", f"serves only for {', '.join(PRINTED)}: leave it out"))
    return problems


def _motion_problems(
    suffix: str,
    model: str | None,
    recordings: Sequence[Path],
    rate: float | None,
    error_mm: float | None,
    *,
    is_partial: bool,
) -> list[Problem]:
    """Options that do not go with showing a recording."""
    problems = []
    if recordings and model is not None:
        problems.append(Problem("--model", "a recording shows the hollow model: leave it out"))
    if len(recordings) > 1 and suffix not in (PAGE, SITE):
        problems.append(Problem("--recording", f"only {PAGE} and a site show several: give one"))
    if not recordings and is_partial:
        problems.append(Problem("--partial", "serves only with --recording: leave it out"))
    if not recordings and rate is not None:
        problems.append(Problem("--frames-per-second", "serves only with --recording: leave it out"))
    if error_mm is not None and (not recordings or suffix != ".glb"):
        problems.append(Problem("--error-mm", "serves only with --recording and .glb: leave it out"))
    for place, number in (("--frames-per-second", rate), ("--error-mm", error_mm)):
        if number is not None and math.isnan(number):
            problems.append(Problem(place, "must be a number"))
    return problems


def _site_problems(cases: Sequence[Path], output: Path, is_web: bool) -> list[Problem]:
    """What keeps a site from being written, as far as the command line tells."""
    problems = []
    ending = next((one for one in (*ENDINGS, *RECORDED_FORMATS) if output.name.lower().endswith(one)), None)
    if ending is not None:
        several = "several cases make a site, which is a folder" if len(cases) > 1 else "a site is a folder"
        problems.append(Problem("--out", f"{several}: give a name without {ending}"))
    if not is_web and len(cases) > 1 and ending is None and output.suffix:
        problems.append(Problem("--out", "several cases make a site: add --web if this is its folder"))
    return problems


@click.command()
@click.argument("cases", metavar="CASE...", nargs=-1, required=True, type=click.Path(path_type=Path, readable=False))
@click.option(
    "-o",
    "--out",
    "output",
    type=OutputPath(),
    required=True,
    help="The file to write; of several CASEs, or with --web, the folder. Labels: .seg.nrrd"
    " or .dcm (DICOM SEG) with names, colours and codes; .nii.gz or .nrrd "
    "with the label values alone. For printing: .stl, .ply, .3mf. To look at: .glb, or .html, a page "
    "that any browser opens without a server. For ParaView: .vtu, .vtk. "
    "For finite elements: .inp (Abaqus), .msh (Gmsh 2.2).",
)
@click.option(
    "--web",
    "is_web",
    is_flag=True,
    help="Write a site into the folder --out: an index and a page for each CASE, for a folder or any web server. A "
    "site that is there is replaced whole; a folder with other files is refused.",
)
@click.option(
    "--model",
    type=click.Choice(list(MODELS)),
    help="hollow: the tissue, with open chambers. solid: the blood, as a cast. vessels: landmarks that are vessels, "
    "such as coronary arteries, as tubes. cells: the simulation grid as hexahedra. Left out, it is hollow, and cells "
    "for .inp and .msh.",
)
@click.option(
    "--min-thickness-mm",
    type=click.FloatRange(0.01, 20.0),
    help="The thinnest that the printer prints; where the model is thinner, a warning says how much of it and where. "
    f"{MIN_THICKNESS_MM:g} mm when left out: two lines of the usual 0.4 mm nozzle, and a margin.",
)
@click.option(
    "--level",
    type=click.IntRange(0, LEVEL_MAX),
    help="Level of detail of the hollow model; left out, it is 0, the finest, and of a site the middle one.",
)
@click.option(
    "--scan",
    type=click.Path(path_type=Path, readable=False),
    help="The DICOM folder that the case was made from, so that the labels open on it; a scan with other values is "
    "refused. A .dcm then holds the scan's own study, series, image and frame of reference UIDs, which lead back to "
    "the patient.",
)
@click.option(
    "--series",
    help="Which series of --scan, where the same scan is there twice: by its number or code in 'heartcase info'.",
)
@click.option(
    "--recording",
    "recordings",
    multiple=True,
    type=click.Path(path_type=Path, readable=False),
    help="A recording of CASE to show in motion, as .glb, .html, .gif or .mp4; repeatable for .html and a site.",
)
@click.option(
    "--partial",
    "is_partial",
    is_flag=True,
    help="With --recording: take what is whole of one that was cut short or damaged.",
)
@click.option(
    "--frames-per-second",
    type=click.FloatRange(0.1, 120.0),
    help=f"With --recording: frames in a second of simulated time; {FRAMES_PER_SECOND:g} when left out.",
)
@click.option(
    "--error-mm",
    type=click.FloatRange(1e-4, 10.0),
    help=f"With --recording and .glb: how far a vertex may be off in a frame, mm; {ERROR_MM:g} when left out. "
    "The less, the larger the file.",
)
@click.option(
    "--no-tours",
    is_flag=True,
    help="Of .html and sites: leave out the guided tours, which in .html take time to be done.",
)
@click.option("--json", "as_json", is_flag=True, help="Print one JSON object about the file.")
@working("exporting")
def command(
    cases: tuple[Path, ...],
    output: Path,
    is_web: bool,
    model: str | None,
    min_thickness_mm: float | None,
    level: int | None,
    scan: Path | None,
    series: str | None,
    recordings: tuple[Path, ...],
    frames_per_second: float | None,
    error_mm: float | None,
    is_partial: bool,
    no_tours: bool,
    as_json: bool,
) -> None:
    """Write the labels of CASE, a model to print, a mesh, or a recording in motion, for another program.

    Several CASEs make a site for a browser.

    The ending of the file says what is written; positions are patient LPS in mm. A model that is not closed is refused;
    all else that may disturb its print is a warning.

    Nothing of the patient is in the file: the case's made-up identifier takes the place of name and number, and dates
    are empty or fixed. Only with --scan are UIDs of the scan written.
    """
    from heartcase.schemas.bundle.reader import open_bundle

    is_site = is_web or len(cases) > 1
    wrong = _site_problems(cases, output, is_web) if is_site else []
    suffix = SITE if is_site else _suffix_of(output.name, bool(recordings))
    problems = wrong + _motion_problems(suffix, model, recordings, frames_per_second, error_mm, is_partial=is_partial)
    problems += _problems(suffix, model, scan, series, min_thickness_mm, 0 if recordings else level or 0)
    if problems:
        raise UsageError(problems)
    if is_site:
        _write_site(
            cases,
            recordings,
            output,
            level,
            frames_per_second,
            tours=not no_tours,
            is_partial=is_partial,
            as_json=as_json,
        )
        return
    (case,) = cases
    export = CaseExport(case, open_bundle(case), scan, series, level or 0)
    if level:
        export.bundle.surface_role(level, place="--level")
    if suffix == PAGE:
        made = page_file(export, recordings, frames_per_second, tours=not no_tours, is_partial=is_partial)
    elif recordings:
        made = recorded_file(
            case, recordings[0], suffix, export.level, frames_per_second, error_mm, is_partial=is_partial
        )
    elif suffix in WRITERS:
        made = ExportedFile(WRITERS[suffix](export), "the labels")
    else:
        model = model or next(name for name, endings in MODELS.items() if suffix in endings)
        made = model_file(export, model, suffix, min_thickness_mm or MIN_THICKNESS_MM)
    try:
        atomic_write(output, made.content)
    except OSError as error:
        raise _cannot_be_written(error) from None
    for warning in made.warnings:
        click.echo(f"warning: {warning}", err=True)
    if as_json:
        named = {} if model is None else {"model": model}
        facts = {"format": suffix, "bytes": len(made.content)} | named | made.facts
        echo_json(facts | ({"warnings": made.warnings} if model or suffix == PAGE or recordings else {}))
    else:
        click.echo(f"wrote {made.what} to {output}, {file_size(len(made.content))}")
        for line in made.more:
            click.echo(line)
