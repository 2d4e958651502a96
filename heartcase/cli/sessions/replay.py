"""``heartcase replay``: repeat a recording, and go on from any moment of it."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any, get_args

import click

from heartcase.cli.shared.output import echo_json, working
from heartcase.cli.shared.output_path import OutputPath
from heartcase.cli.shared.recordings import recorded_into
from heartcase.cli.shared.sessions import check_numbers, require_case, require_folder, session_bar
from heartcase.schemas.errors import Problem, UsageError
from heartcase.schemas.recording.reader import Recording, open_recording
from heartcase.schemas.scripts.script import SimulationScript
from heartcase.simulator.engine.backends import Backend
from heartcase.simulator.load import Case, load_case
from heartcase.simulator.session.operating_session import OperatingSession
from heartcase.simulator.session.perform_tools import withdrawal_of
from heartcase.simulator.session.recorder import Recorder
from heartcase.simulator.session.replay import load_session, refuse_deviation
from heartcase.simulator.session.script import load_script, run_script, with_positions

__all__ = ["command"]

_PATH = click.Path(path_type=Path, readable=False)


@click.command()
@click.argument("recording", type=_PATH)
@click.option("--case", type=_PATH, required=True, help="The case that was recorded.")
@click.option(
    "--to",
    "to_s",
    type=click.FloatRange(min=0.0),
    help="Simulated time since the recording's start at which to end, s; its end when left out.",
)
@click.option(
    "--take-over", "script_path", type=_PATH, help="A script (TOML) that goes on from there; its times begin there."
)
@click.option("--let-go", is_flag=True, help="With --take-over: first all instruments of the recording let go.")
@click.option(
    "-o", "--out", "output", type=OutputPath(), help="With --take-over: the folder to record into, NAME.recording."
)
@click.option("--partial", is_flag=True, help="Take what is whole of a recording that was cut short or damaged.")
@click.option(
    "--backend",
    type=click.Choice(get_args(Backend)),
    help="Which kernel steps; that of the recording when left out. Another one repeats it nearly: how near is told.",
)
@click.option("--json", "as_json", is_flag=True, help="Print one JSON object.")
def command(
    recording: Path,
    case: Path,
    to_s: float | None,
    script_path: Path | None,
    let_go: bool,
    output: Path | None,
    partial: bool,
    backend: Backend | None,
    as_json: bool,
) -> None:
    """Repeat RECORDING, and check that it comes to the same bytes as when it was recorded.

    With --take-over and --out, a script goes on from the end or from --to, and all of it is a new recording, which
    says of which one it is a branch, and from which step on.
    """
    check_numbers(to=to_s)
    _check_options(script_path, let_go, output)
    opened = open_recording(recording, partial=partial)
    script = load_script(script_path) if script_path is not None else None
    with working("reading the case"):
        loaded = load_case(case, needs=("grid", "tissue") if opened.header.tissue_sha256 else ("grid",))
        session = load_session(opened, loaded.model, tissue=loaded.tissue, backend=backend)
    is_same_backend = session.simulation.backend == opened.header.backend
    to_step = _step_at(opened, session, to_s)
    with session_bar("replaying", max(to_step - session.start_step, 1) * session.simulation.step_s) as tell:
        if script is None:
            for frame in session.play(to_step):
                tell((frame.step - session.start_step) * session.simulation.step_s)
        else:
            session.go_to(to_step)
    if is_same_backend:
        refuse_deviation(session)
    result = _Result(opened, session, to_step)
    if script is not None and output is not None:
        _take_over(result, loaded, script, output, let_go=let_go)
    if as_json:
        echo_json(result.facts(output))
    else:
        for line in result.lines(output):
            click.echo(line)


@dataclass(frozen=True)
class _Result:
    """What a replay came to."""

    recording: Recording
    session: OperatingSession
    to_step: int

    @property
    def seconds(self) -> float:
        """Simulated time that was repeated."""
        return (self.to_step - self.session.start_step) * self.session.simulation.step_s

    @property
    def states_met(self) -> int:
        """Stored states up to where it ended."""
        return sum(state.step <= self.to_step for state in self.recording.states.values())

    def facts(self, output: Path | None) -> dict[str, Any]:
        """For --json."""
        header = self.recording.header
        deviations = self.session.deviations
        return {
            "case": header.case_name,
            "case_id": header.case_id,
            "recorded_by": header.software_version,
            "backend": self.session.simulation.backend,
            "is_whole": self.recording.is_whole,
            "seconds": self.seconds,
            "step": self.to_step,
            "state_count": self.states_met,
            "deviation_mm": max((deviation.distance_mm for deviation in deviations), default=0.0),
            "marks": [{"name": name, "step": step} for name, step in self.recording.marks],
            "parent": header.parent,
            "branch": None if output is None else {"step": self.to_step, "end_step": self.session.step_count},
        }

    def lines(self, output: Path | None) -> Iterator[str]:
        """In plain words."""
        header, simulation = self.recording.header, self.session.simulation
        if not self.recording.is_whole:
            yield "Recording  cut short or damaged: this is what is whole of it"
        yield f"Case       {header.case_name or 'without a name'}" + (f" ({header.case_id})" if header.case_id else "")
        yield (
            f"Replayed   {self.seconds:.3f} of {self.recording.seconds:.3f} s, up to step {self.to_step:,}, on "
            f"{simulation.backend}"
        )
        for name, step in self.recording.marks:
            yield f"Mark       {name}: step {step:,}"
        if self.session.deviations:
            most = max(deviation.distance_mm for deviation in self.session.deviations)
            yield f"Deviation  up to {most:.3g} mm from {self.states_met:,} stored states: another backend"
        elif output is None:
            yield f"Checked    {self.states_met:,} stored states: the same bytes"
        if output is not None:
            more = (self.session.step_count - self.to_step) * simulation.step_s
            yield f"Taken over at step {self.to_step:,}: {more:.3f} s more in {output}"


def _check_options(script: Path | None, let_go: bool, output: Path | None) -> None:
    problems = []
    if script is not None and output is None:
        problems.append(Problem("--out", "is missing: say where to record what --take-over does"))
    if script is None and output is not None:
        problems.append(Problem("--out", "nothing is recorded without --take-over: leave it out"))
    if script is None and let_go:
        problems.append(Problem("--let-go", "serves only with --take-over: leave it out"))
    if problems:
        raise UsageError(problems)
    if output is not None:
        require_folder(output)


def _step_at(recording: Recording, session: OperatingSession, to_s: float | None) -> int:
    """The step at a time since the start."""
    if to_s is None:
        return session.end_step
    if to_s > recording.seconds + 0.5 * recording.header.step_s:
        raise UsageError(f"the recording lasts {recording.seconds:.3f} s: give at most that", place="--to")
    return session.start_step + round(to_s / recording.header.step_s)


def _take_over(result: _Result, case: Case, script: SimulationScript, output: Path, *, let_go: bool) -> None:
    """Go on by a script, and record all of it."""
    session, header = result.session, result.recording.header
    settings = {name: getattr(header, name) for name in ("step_s", "damping_per_s", "gravity_m_s2")}
    others = [name for name in settings if name in script.model_fields_set and getattr(script, name) != settings[name]]
    if others:
        told = ", ".join(others)
        raise UsageError(f"the recording goes on as it was set: leave {told} out of the script", place="--take-over")
    require_case(script, case)
    script = with_positions(script, case.manifest.landmarks)
    session.forget_ahead()
    parent = result.recording.branch_at(result.to_step)
    recorder = Recorder(session, output, case=case.manifest, parent=parent)
    with recorded_into(recorder):
        if let_go:
            _release_all(session)
        with session_bar("recording", script.seconds) as tell:
            run_script(session, script, on_frame=_telling(tell))


def _release_all(session: OperatingSession) -> None:
    for instrument in session.simulation.instruments:
        session.do(withdrawal_of(instrument))


def _telling(tell: Callable[[float], None]) -> Callable[[object, float], None]:
    def on_frame(_: object, time_s: float) -> None:
        tell(time_s)

    return on_frame
