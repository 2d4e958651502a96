"""``heartcase view``: operate on a case in a window."""

from __future__ import annotations

from pathlib import Path
from typing import get_args

import click

from heartcase.cli.shared.output import working
from heartcase.cli.shared.output_path import OutputPath
from heartcase.cli.shared.sessions import check_numbers, require_folder, with_law
from heartcase.schemas.bundle.reader import open_bundle
from heartcase.schemas.errors import RecordingError, UsageError
from heartcase.schemas.recording.reader import open_recording
from heartcase.simulator.engine.backends import Backend
from heartcase.simulator.lattice.moduli import RATIO_MAX, RATIO_MIN, LawName
from heartcase.simulator.load import Need, load_case
from heartcase.simulator.session.operating_session import OperatingSession
from heartcase.simulator.session.replay import load_session
from heartcase.simulator.simulation import SLEEP_MM, Simulation

__all__ = ["command"]


@click.command()
@click.argument("case", type=click.Path(path_type=Path, readable=False))
@click.option(
    "--recording",
    "recording_path",
    type=click.Path(path_type=Path, readable=False),
    help="A recording of this case: play it, and take over at any moment.",
)
@click.option(
    "--record",
    "output",
    type=OutputPath(),
    help="Record into this folder, NAME.recording, from the start; nothing may be there yet.",
)
@click.option("--level", type=click.IntRange(0, 8), default=0, help="Level of detail of the surface; 0 is the finest.")
@click.option("--backend", type=click.Choice(get_args(Backend)), default="cpu", help="Which kernel steps.")
@click.option("--law", type=click.Choice(get_args(LawName)), default="springs", help="What resists deformation.")
@click.option(
    "--poissons-ratio",
    type=click.FloatRange(RATIO_MIN, RATIO_MAX),
    default=RATIO_MIN,
    help="How little volume changes; the closer to 1/2, the more steps.",
)
@click.option(
    "--damping",
    "damping_per_s",
    type=click.FloatRange(0.0, 1000.0),
    default=30.0,
    show_default=True,
    help="Damping of all movement, 1/s.",
)
@click.option(
    "--size",
    type=(click.IntRange(200, 8192), click.IntRange(200, 8192)),
    default=(1280, 900),
    show_default=True,
    help="Width and height of the window in pixels.",
)
def command(
    case: Path,
    recording_path: Path | None,
    output: Path | None,
    level: int,
    backend: Backend,
    law: LawName,
    poissons_ratio: float,
    damping_per_s: float,
    size: tuple[int, int],
) -> None:
    """Operate on CASE in a window: grab, probe, cut, hold open, stitch, go back, record.

    H in the window lists its keys. Closing it, or Ctrl-C, ends all; what is recorded is finished. Recordings that W
    begins are put into the current folder. With --recording, law, step and damping are those that were recorded.
    """
    from heartcase.simulator.live.live import Live
    from heartcase.window.window import HeartWindow, require_display

    check_numbers(poissons_ratio=poissons_ratio, damping_per_s=damping_per_s)
    if output is not None:
        require_folder(output)
        if output.exists():
            raise RecordingError("there is something at this path already: take another name", place="--record")
    manifest = open_bundle(case).manifest
    recording = None if recording_path is None else open_recording(recording_path)
    if recording is not None and output is not None:
        raise UsageError("give --recording alone: W records what comes of it", place="--record")
    require_display()
    needs: tuple[Need, ...] = ("surface", "structures", "tissue")
    if manifest.scan_values is not None:
        needs = (*needs, "scan")
    with working("reading the case"):
        loaded = with_law(load_case(case, needs=needs, level=level), law, poissons_ratio)
    with working("making ready"):
        if recording is not None:
            session = load_session(recording, loaded.model, surface=loaded.surface, tissue=loaded.tissue)
        else:
            simulation = Simulation(
                loaded.model,
                surface=loaded.surface,
                tissue=loaded.tissue,
                damping_per_s=damping_per_s,
                backend=backend,
                sleep_mm=SLEEP_MM,
            )
            session = OperatingSession(simulation)
        session.simulation.prepare()
        session.simulation.prepare_cuts()
    live = Live(session, manifest=loaded.manifest)
    window = HeartWindow(loaded, live, size=size)
    try:
        if output is not None:
            live.record(output)
        if recording is not None:
            live.play()
        live.start()
        window.run()
    finally:
        window.close()
    for said in live.take_messages():
        click.echo(str(said))
    click.echo(loaded.manifest.notice)
