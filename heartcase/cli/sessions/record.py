"""``heartcase record``: a scripted session on a case, kept as a recording."""

from __future__ import annotations

from pathlib import Path

import click

from heartcase.cli.shared.output import echo_json, working
from heartcase.cli.shared.output_path import OutputPath
from heartcase.cli.shared.recordings import recorded_into
from heartcase.cli.shared.sessions import (
    check_numbers,
    completed_script,
    require_folder,
    session_bar,
    session_options,
    sews,
    simulation_of,
    with_law,
)
from heartcase.schemas.recording.reader import open_recording
from heartcase.simulator.engine.backends import Backend
from heartcase.simulator.lattice.moduli import LawName
from heartcase.simulator.load import Need, load_case
from heartcase.simulator.session.operating_session import OperatingSession
from heartcase.simulator.session.recorder import STATE_EVERY_S, Recorder
from heartcase.simulator.session.script import load_script, run_script

__all__ = ["command"]


@click.command()
@click.argument("case", type=click.Path(path_type=Path, readable=False))
@click.option(
    "-o",
    "--out",
    "output",
    type=OutputPath(),
    required=True,
    help="The folder to record into, NAME.recording; nothing may be there yet.",
)
@session_options
@click.option(
    "--state-every",
    "state_every_s",
    type=click.FloatRange(min=0.0, max=3600.0, min_open=True),
    default=STATE_EVERY_S,
    show_default=True,
    help="Simulated time in s between stored states, from which a replay is checked and may begin.",
)
@click.option("--json", "as_json", is_flag=True, help="Print one JSON object about the recording.")
def command(
    case: Path,
    output: Path,
    script_path: Path | None,
    seconds: float | None,
    step_s: float | None,
    backend: Backend,
    law: LawName,
    poissons_ratio: float,
    sleep_mm: float,
    state_every_s: float,
    as_json: bool,
) -> None:
    """Run a scripted session on CASE and record it: every command with its step, and states now and then.

    'heartcase replay' repeats it to the same bytes, and goes on from any moment; 'heartcase export --recording' makes
    an animation of it. Without --script a hand pulls as in 'heartcase simulate'. Where Ctrl-C or an error ends it
    early, what was recorded by then is kept.
    """
    check_numbers(
        seconds=seconds, step_s=step_s, poissons_ratio=poissons_ratio, sleep_mm=sleep_mm, state_every_s=state_every_s
    )
    require_folder(output)
    script = load_script(script_path) if script_path is not None else None
    # The surface says where the default script pulls; nothing else needs it.
    needs: tuple[Need, ...] = ("grid",) if script else ("surface",)
    if script is not None and (script.cuts or script.scissors):
        needs = ("grid", "tissue")
    if script is not None and sews(script):
        needs = ("surface", "tissue")
    with working("reading the case"):
        loaded = with_law(load_case(case, needs=needs), law, poissons_ratio)
        script = completed_script(script, loaded, seconds, step_s)
        session = OperatingSession(simulation_of(loaded, script, backend=backend, sleep_mm=sleep_mm))
    recorder = Recorder(session, output, case=loaded.manifest, state_every_s=state_every_s)
    with recorded_into(recorder), session_bar("recording", script.seconds) as tell:
        run_script(session, script, on_frame=lambda _, time_s: tell(time_s))
    recording = open_recording(output)
    if as_json:
        echo_json(
            {
                "case": loaded.manifest.name,
                "case_id": loaded.manifest.case_id,
                "step_s": session.simulation.step_s,
                "step_count": session.step_count,
                "seconds": recording.seconds,
                "entry_count": len(recording.entries),
                "state_count": len(recording.states),
                "log_hash": recording.log_hash,
            }
        )
    else:
        click.echo(
            f"recorded {recording.seconds:.3f} s, {session.step_count:,} steps, {len(recording.entries):,} entries and "
            f"{len(recording.states):,} states in {output}"
        )
