"""What commands that run a session share: their options, the script they run, the bar that shows how far it is."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any, TypeVar, get_args

import click
from rich.console import Console
from rich.progress import BarColumn, Progress, SpinnerColumn, TextColumn, TimeElapsedColumn, TimeRemainingColumn

from heartcase.cli.shared.output import compiling_told
from heartcase.schemas.errors import UsageError
from heartcase.schemas.scripts.script import SimulationScript
from heartcase.simulator.engine.backends import Backend
from heartcase.simulator.incisions.stitch_limits import MEASURED, beside_measured
from heartcase.simulator.lattice.moduli import RATIO_MAX, RATIO_MIN, ForceLaw, LawName
from heartcase.simulator.load import Case
from heartcase.simulator.patching.templates import TEMPLATE_FORMATS, write_template
from heartcase.simulator.session.script import SessionSummary, default_script, with_positions
from heartcase.simulator.simulation import SLEEP_MM, Simulation

__all__ = [
    "check_numbers",
    "completed_script",
    "law_options",
    "needs_tissue",
    "operation_lines",
    "require_case",
    "require_folder",
    "session_bar",
    "session_options",
    "sews",
    "simulation_of",
    "stitch_lines",
    "stitches_over_measured",
    "template_files",
    "with_law",
]

F = TypeVar("F", bound=Callable[..., Any])

_TIED_PART = 0.9
"""Part of the tension that was asked for with which a stitch may be tied without a word."""
_BESIDE = ("aortic-cut-in-weakest", "aortic-tear-out-weakest")
"""Measured forces that those in stitches are put beside."""
DEFAULT_SECONDS = 2.0

_SCRIPT_OPTIONS = (
    click.option(
        "--script", "script_path", type=click.Path(path_type=Path, readable=False), help="What the hands do (TOML)."
    ),
    click.option(
        "--seconds",
        type=click.FloatRange(min=0.0, max=3600.0, min_open=True),
        help="Simulated time; the script's, or 2 without a script.",
    ),
    click.option(
        "--step",
        "step_s",
        type=click.FloatRange(min=0.0, max=1.0, min_open=True),
        help="Time step in s; the case's default when left out.",
    ),
)
_LAW_OPTIONS = (
    click.option("--backend", type=click.Choice(get_args(Backend)), default="cpu", help="Which kernel steps."),
    click.option("--law", type=click.Choice(get_args(LawName)), default="springs", help="What resists deformation."),
    click.option(
        "--poissons-ratio",
        type=click.FloatRange(RATIO_MIN, RATIO_MAX),
        default=RATIO_MIN,
        help="How little volume changes; the closer to 1/2, the more steps.",
    ),
    click.option(
        "--sleep-mm",
        type=click.FloatRange(0.0, 10.0),
        default=SLEEP_MM,
        show_default=True,
        help="Movement in mm below which tissue rests and is not worked out (CPU); 0 works out all.",
    ),
)


def session_options(function: F) -> F:
    """Add the options of a command that runs a script on a case."""
    for option in reversed((*_SCRIPT_OPTIONS, *_LAW_OPTIONS)):
        function = option(function)
    return function


def law_options(function: F) -> F:
    """Add the options that say how tissue moves, and what works it out."""
    for option in reversed(_LAW_OPTIONS):
        function = option(function)
    return function


def check_numbers(**numbers: float | None) -> None:
    """UsageError where an option is not a number, which click takes for one; by the names of the arguments."""
    wrong = [name for name, number in numbers.items() if number is not None and math.isnan(number)]
    if wrong:
        names = ", ".join(f"--{name.removesuffix('_s').replace('_', '-')}" for name in wrong)
        raise UsageError("must be numbers", place=names)


def require_folder(path: Path) -> None:
    """UsageError where the folder of a file that shall be written does not exist."""
    if not path.absolute().parent.is_dir():
        raise UsageError(f"the folder of {path.name} does not exist: make it first")


def with_law(case: Case, law: LawName, poissons_ratio: float) -> Case:
    """The case under a force law."""
    return replace(case, model=case.model.with_law(ForceLaw(law, poissons_ratio)))


def completed_script(
    script: SimulationScript | None, case: Case, seconds: float | None, step_s: float | None
) -> SimulationScript:
    """The script, or the default pull, with its landmarks found and what the command line changes."""
    if script is None:
        script = default_script(case.model, case.surface, seconds=seconds or DEFAULT_SECONDS)
    require_case(script, case)
    script = with_positions(script, case.manifest.landmarks)
    changes = {"seconds": seconds, "step_s": step_s}
    return script.model_copy(update={key: value for key, value in changes.items() if value is not None})


def simulation_of(case: Case, script: SimulationScript, *, backend: Backend, sleep_mm: float) -> Simulation:
    """A simulation of a case, set as a script says."""
    return Simulation(
        case.model,
        surface=case.surface,
        tissue=case.tissue,
        step_s=script.step_s,
        damping_per_s=script.damping_per_s,
        gravity_m_s2=script.gravity_m_s2,
        backend=backend,
        sleep_mm=sleep_mm,
    )


def needs_tissue(script: SimulationScript) -> bool:
    """Whether a script cuts or sews: what blades and threads meet is the case's own tissue."""
    return bool(script.cuts or script.scissors or script.excisions) or sews(script)


def sews(script: SimulationScript) -> bool:
    """Whether a script sews: the places of stitches are ones of the surface."""
    return bool(script.stitches or script.stitch_rows or script.patches)


def require_case(script: SimulationScript | None, case: Case) -> None:
    """UsageError where a script is for another case."""
    if script is not None and script.case is not None and script.case.lower() != case.manifest.name.lower():
        message = (
            f"this script is for the case {script.case}, and this is {case.manifest.name}: give it that case, or take "
            "the line case = ... out of the script"
        )
        raise UsageError(message, place="--script")


def operation_lines(summary: SessionSummary) -> Iterator[str]:
    """What was cut and taken out, and what of that, and of tensions, is not as it was asked for, in plain words."""
    for name, area in summary.cut_mm2.items():
        if area > 0.0:
            yield f"Cut        {name}: {area:,.0f} mm2"
        else:
            yield f"Warning    {name} cut nothing: there is no tissue in its way, or it was cut there before"
    for name, volume in summary.excised_ml.items():
        yield f"Excision   {name}: {volume:.2f} ml taken out"
    for name, (tied, asked) in summary.stitch_tied_n.items():
        if tied < _TIED_PART * asked:
            yield (
                f"Warning    {name} was tied with {tied:.2g} N, not the {asked:.3g} N that were asked for: its ends "
                "met first, or its thread is as stiff as the time step allows; draw it with less, for longer, "
                "or with a smaller step"
            )


def template_files(simulation: Simulation, folder: Path) -> Iterator[Path]:
    """Write the templates of all patches that are sewn on, as SVG and PDF; gives the files."""
    for patch in simulation.patches:
        for suffix in TEMPLATE_FORMATS:
            path = folder / f"{patch.name}{suffix}"
            write_template(path, simulation.template(patch), patch.name)
            yield path


def stitches_over_measured(summary: SessionSummary) -> dict[str, dict[str, float]]:
    """The force in each stitch, and the highest in each patch's rim, over the mean of each that was measured [1]."""
    forces = summary.stitch_end_force_n | {name: max(rim) for name, rim in summary.patch_end_force_n.items()}
    return {
        name: {one.key: beside_measured((force,), one.key)[0].part_of_mean for one in MEASURED}
        for name, force in forces.items()
    }


def stitch_lines(summary: SessionSummary) -> Iterator[str]:
    """The force in each stitch beside forces that were measured, and in the rims of patches, in plain words."""
    cut_in, tear_out = (next(one for one in MEASURED if one.key == key) for key in _BESIDE)

    def beside(force_n: float) -> str:
        parts = [beside_measured((force_n,), one.key)[0].part_of_mean for one in (cut_in, tear_out)]
        return f"{100 * parts[0]:.2g}% of what cuts in, {100 * parts[1]:.2g}% of what tears out"

    for name, force in summary.stitch_end_force_n.items():
        yield f"Stitch     {name}: {force:.3g} N, at most {summary.stitch_peak_force_n[name]:.3g} N; {beside(force)}"
    for name, rim in summary.patch_end_force_n.items():
        yield (
            f"Patch      {name}: {len(rim)} stitches of {min(rim):.3g} to {max(rim):.3g} N, "
            f"at most {summary.patch_peak_force_n[name]:.3g} N; {beside(max(rim))}"
        )
    if summary.stitch_end_force_n or summary.patch_end_force_n:
        yield (
            f"Measured   {cut_in.tissue}: {cut_in.event} at {cut_in.mean_n:.3g} +- {cut_in.deviation_n:.3g} N, "
            f"{tear_out.event} at {tear_out.mean_n:.4g} +- {tear_out.deviation_n:.3g} N "
            f"({cut_in.source}). None is of a child's heart"
        )


@contextmanager
def session_bar(words: str, seconds: float) -> Iterator[Callable[[float], None]]:
    """A progress bar in simulated time, shown from the start; what it gives is told the time in s.

    The first steps may wait for kernels to be compiled, which a line says then.
    """
    console = Console(stderr=True)
    progress = Progress(
        SpinnerColumn(),
        TextColumn(words),
        BarColumn(),
        TextColumn("{task.completed:.2f} of {task.total:.2f} s"),
        TimeElapsedColumn(),
        TimeRemainingColumn(),
        console=console,
        transient=True,
        disable=not console.is_terminal,
    )
    task = progress.add_task("", total=seconds)
    with progress, compiling_told(console):
        yield lambda time_s: progress.update(task, completed=time_s)
