"""``heartcase simulate``: a scripted session on a case."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path

import click
import numpy as np

from heartcase.cli.shared.film import (
    Filmer,
    Seen,
    check_animation_name,
    check_picture_name,
    write_animation,
    write_picture,
)
from heartcase.cli.shared.output import echo_json, working
from heartcase.cli.shared.output_path import OutputPath
from heartcase.cli.shared.sessions import (
    check_numbers,
    completed_script,
    needs_tissue,
    operation_lines,
    require_folder,
    session_bar,
    session_options,
    simulation_of,
    stitch_lines,
    stitches_over_measured,
    template_files,
    with_law,
)
from heartcase.schemas.arrays import Float64, UInt8
from heartcase.schemas.bundle.approval import approval_state
from heartcase.schemas.bundle.format import LEVEL_MAX
from heartcase.schemas.errors import UsageError
from heartcase.schemas.scripts.script import SimulationScript
from heartcase.simulator.engine.backends import Backend
from heartcase.simulator.lattice.loose_nodes import tissue_displacement
from heartcase.simulator.lattice.moduli import LawName
from heartcase.simulator.load import Case, Need, load_case
from heartcase.simulator.session.script import SessionSummary, load_script, run_script
from heartcase.simulator.simulation import Simulation
from heartcase.simulator.surface.write_surface import SURFACE_FORMATS, write_surface

__all__ = ["command"]

FILM_FRAMES_PER_SECOND = 15.0
"""An animation takes up no more than this."""
_OUT = OutputPath(dir_okay=False)


@click.command()
@click.argument("case", type=click.Path(path_type=Path, readable=False))
@session_options
@click.option(
    "--level", type=click.IntRange(0, LEVEL_MAX), default=0, help="Level of detail of the surface; 0 is the finest."
)
@click.option("--surface", "surface_out", type=_OUT, help="Write the final surface here (.ply, .stl, .obj).")
@click.option("--animation", type=_OUT, help="Write an animation here (.gif, .mp4).")
@click.option("--picture", type=_OUT, help="Write a picture of start and furthest deformation (.png).")
@click.option(
    "--near-cuts", is_flag=True, help="Look at the script's cuts from close by, from where the blade came from."
)
@click.option(
    "--templates",
    type=OutputPath(is_folder=True),
    help="Write the outline of each patch here, flat and to scale (NAME.svg, NAME.pdf).",
)
@click.option("--json", "as_json", is_flag=True, help="Print the summary as JSON.")
def command(
    case: Path,
    script_path: Path | None,
    seconds: float | None,
    step_s: float | None,
    backend: Backend,
    law: LawName,
    poissons_ratio: float,
    sleep_mm: float,
    level: int,
    surface_out: Path | None,
    animation: Path | None,
    picture: Path | None,
    near_cuts: bool,
    templates: Path | None,
    as_json: bool,
) -> None:
    """Run a scripted session on CASE and say what came of it.

    Without --script a hand pulls the tissue that is farthest from the fixed nodes outward by 10 mm, and lets go.
    """
    check_numbers(seconds=seconds, step_s=step_s, poissons_ratio=poissons_ratio, sleep_mm=sleep_mm)
    _check_names(surface_out, animation, picture)
    script = load_script(script_path) if script_path is not None else None
    blades_mm = _blades(script, near_cuts, is_drawn=animation is not None or picture is not None)
    curvature = script.curvature if script else "flagged"
    needs: tuple[Need, ...] = ("surface", "colours")
    if script is not None and needs_tissue(script):
        needs = (*needs, "tissue")
    if templates is not None:
        require_folder(templates / "template.svg")
    with working("reading the case"):
        loaded = load_case(case, needs=needs, curvature=curvature, level=level)
        loaded = with_law(loaded, law, poissons_ratio)
        script = completed_script(script, loaded, seconds, step_s)
        simulation = simulation_of(loaded, script, backend=backend, sleep_mm=sleep_mm)
    case_id, approval = loaded.manifest.case_id, approval_state(case)
    film_every = max(1, round(script.frames_per_second / FILM_FRAMES_PER_SECOND)) if animation is not None else 0
    camera = _filmer(loaded, blades_mm) if animation is not None or picture is not None else None
    with session_bar("simulating", script.seconds) as tell:
        audience = _Audience(
            camera,
            loaded.triangle_colours,
            tell,
            film_every=film_every,
            wants_picture=picture is not None,
            title=_title(loaded.manifest.name, case_id),
        )
        summary = run_script(simulation, script, on_frame=audience.watch)
        shot = audience.furthest_picture()
    comment = f"heartcase {case_id}" if case_id else "heartcase"
    if animation is not None and camera is not None:
        speed = script.frames_per_second / film_every
        write_animation(animation, camera.frames, frames_per_second=speed, comment=comment)
    if picture is not None and shot is not None:
        write_picture(picture, shot, comment=comment)
    if surface_out is not None and loaded.triangle_colours is not None:
        seen = Seen.now(simulation, loaded.triangle_colours)
        end = seen.surface
        write_surface(
            surface_out,
            end.vertices_mm,
            end.normals,
            seen.triangles,
            colours=seen.colours,
            case_id=case_id,
        )
    written = list(template_files(simulation, templates)) if templates is not None else []
    if as_json:
        named = {"case": loaded.manifest.name, "case_id": case_id, "approval": approval.state, "backend": backend}
        beside = {"stitches_over_measured": stitches_over_measured(summary)}
        echo_json({**named, "law": law, "poissons_ratio": poissons_ratio, **summary.to_dict(), **beside})
    else:
        click.echo(f"Approval   {approval.words}")
        for line in _lines(loaded, summary):
            click.echo(line)
        for what, path in (("picture", picture), ("animation", animation), ("surface", surface_out)):
            if path is not None:
                click.echo(f"wrote the {what} to {path}")
        for path in written:
            click.echo(f"wrote the template to {path}")


class _Audience:
    """What looks on while the session runs: the progress bar, the film, the picture of the furthest deformation."""

    def __init__(
        self,
        camera: Filmer | None,
        colours: UInt8 | None,
        tell: Callable[[float], None],
        *,
        film_every: int,
        wants_picture: bool,
        title: str,
    ) -> None:
        self.camera = camera
        self.colours = np.zeros((0, 3), np.uint8) if colours is None else colours
        self.tell = tell
        self.title = title
        self.film_every = film_every
        self.wants_picture = wants_picture
        self.frame_number = 0
        self.furthest = -1.0
        self.furthest_seen: Seen | None = None
        self.furthest_time_s = 0.0
        self.rest_seen: Seen | None = None
        self.sewn_seen: Seen | None = None
        self.sewn_time_s = 0.0

    def watch(self, simulation: Simulation, time_s: float) -> None:
        """Look at a frame."""
        self.tell(time_s)
        if self.camera is not None:
            if self.film_every and self.frame_number % self.film_every == 0:
                self.camera.film(Seen.now(simulation, self.colours))
            moved = float(np.abs(tissue_displacement(simulation.model, simulation.state.displacement)).max())
            if self.wants_picture and moved >= self.furthest:
                self.furthest = moved
                self.furthest_seen = Seen.now(simulation, self.colours)
                self.furthest_time_s = time_s
            if self.wants_picture and self.rest_seen is None:
                self.rest_seen = Seen.now(simulation, self.colours)
            if self.wants_picture and (simulation.stitches or simulation.patches):
                self.sewn_seen, self.sewn_time_s = Seen.now(simulation, self.colours), time_s
        self.frame_number += 1

    def furthest_picture(self) -> np.ndarray | None:
        """The start, the furthest deformation and what was sewn side by side, if a picture was wanted."""
        if self.camera is None or self.furthest_seen is None or self.rest_seen is None:
            return None
        from heartcase.pipeline.report.montage import montage

        pictures = {
            f"{self.title}, at the start": self.camera.take(self.rest_seen),
            f"at {self.furthest_time_s:.2f} s, moved furthest": self.camera.take(self.furthest_seen),
        }
        if self.sewn_seen is not None:
            pictures[f"at {self.sewn_time_s:.2f} s, sewn"] = self.camera.take(self.sewn_seen)
        return montage(pictures, columns=len(pictures))


_NAME_LONGEST = 30
"""Letters of a case's name above a picture."""
_INVERTED_MANY = 2
"""Cells that may turn on the way without a word."""


def _check_names(surface: Path | None, animation: Path | None, picture: Path | None) -> None:
    """Refuse what cannot be written before any work is done."""
    if surface is not None and surface.suffix.lower() not in SURFACE_FORMATS:
        raise UsageError(f"a surface is written as {', '.join(SURFACE_FORMATS)}", place="--surface")
    if animation is not None:
        check_animation_name(animation)
    if picture is not None:
        check_picture_name(picture)
    for path in (surface, animation, picture):
        if path is not None:
            require_folder(path)


def _blades(script: SimulationScript | None, near_cuts: bool, *, is_drawn: bool) -> list[Float64]:
    """Where the blades of a script go, LPS mm, each (pose_count, point_count, 3), if they are to be looked at.

    Raises
    ------
    UsageError
        They are, and nothing is drawn or nothing is cut.
    """
    if not near_cuts:
        return []
    if not is_drawn:
        raise UsageError("there is nothing to look at: give --animation or --picture too", place="--near-cuts")
    if script is None or not script.cuts:
        raise UsageError("needs a --script with [[cuts]]", place="--near-cuts")
    return [np.asarray(cut.poses_mm, dtype=float) for cut in script.cuts]


def _title(name: str, case_id: str | None) -> str:
    """What stands above the first picture: the case's name, shortened where it is long, and its identifier."""
    short = name if len(name) <= _NAME_LONGEST else f"{name[: _NAME_LONGEST - 1]}\u2026"
    return f"{short} ({case_id})" if case_id else short


def _filmer(case: Case, blades_mm: list[Float64]) -> Filmer:
    assert case.surface is not None
    return Filmer(case.surface.rest_mm, blades_mm=blades_mm)


def _lines(case: Case, summary: SessionSummary) -> Iterator[str]:
    """The summary in plain words."""
    yield f"Case       {case.manifest.name}" + (f" ({case.manifest.case_id})" if case.manifest.case_id else "")
    yield (
        f"Lattice    {summary.node_count:,} nodes, {summary.spring_count:,} springs, "
        f"cells of {summary.cell_mm:.2f} mm, {int(case.model.node_is_fixed.sum()):,} nodes fixed"
    )
    yield f"Law        {case.model.law.name}, Poisson's ratio {case.model.law.poissons_ratio:g}"
    yield f"Surface    {summary.triangle_count:,} triangles"
    yield (
        f"Step       {summary.step_s * 1e3:.4f} ms "
        f"(this lattice at rest is stable up to {summary.step_limit_s * 1e3:.4f} ms), {summary.step_count:,} steps"
        + (f", taken in up to {summary.step_s * summary.pace * 1e3:.4f} ms at once" if summary.pace > 1.0 else "")
    )
    yield (
        f"Time       {summary.seconds:.2f} s simulated in {summary.wall_seconds:.2f} s: "
        f"{summary.step_count / summary.wall_seconds:,.0f} steps per second, "
        f"real-time factor {summary.real_time_factor:.2f}"
    )
    yield (
        f"Movement   at most {summary.displacement_max_mm:.2f} mm from rest, "
        f"{summary.displacement_end_mm:.2f} mm at the end"
    )
    for name, force in summary.peak_force_n.items():
        held = f" on {summary.held_node_count[name]:,} nodes" if name in summary.held_node_count else ""
        yield f"Force      {name}: at most {force:.3g} N{held}"
    yield from operation_lines(summary)
    yield from stitch_lines(summary)
    if summary.inverted_cell_count_max > max(summary.inverted_cell_count_end, _INVERTED_MANY):
        yield (
            f"Warning    {summary.inverted_cell_count_max:,} cells were turned inside out on the way: what was felt "
            "then, and the largest stretch, mean nothing; lead it less far, or slower"
        )
    if summary.inverted_cell_count_end:
        count = summary.inverted_cell_count_end
        are = "cell is" if count == 1 else "cells are"
        yield (
            f"Warning    {count:,} {are} turned inside out at the end, and may stay so and hold tissue away from rest: "
            "let it come to rest for longer, pull less far, or with a larger radius"
        )
    yield case.manifest.notice
