"""What commands for forceps, retractors and scissors do to a simulation."""

from __future__ import annotations

from heartcase.schemas.arrays import Float64
from heartcase.schemas.base import Vector3
from heartcase.schemas.errors import SimulationError
from heartcase.schemas.recording.commands import Act, Done, OpenGrab, WithdrawProbe
from heartcase.schemas.recording.tool_commands import (
    BringScissors,
    CloseForceps,
    CloseRetractor,
    PlaceScissors,
    Snip,
    SqueezeForceps,
    WithdrawScissors,
)
from heartcase.simulator.instruments.forceps import Forceps
from heartcase.simulator.instruments.grab import Grab
from heartcase.simulator.instruments.scissors import Scissors
from heartcase.simulator.instruments.wrench import Instrument
from heartcase.simulator.simulation import Simulation

__all__ = ["as_poses", "perform_tool", "resolved_snip", "withdrawal_of"]


def resolved_snip(simulation: Simulation, command: Snip) -> Snip:
    """A snip that states what it cuts of the tissue at rest.

    Raises
    ------
    SimulationError
        There are no such scissors, or they do not close so.
    """
    if command.rest_poses_mm is not None:
        return command
    poses = simulation.snip_poses_mm(_scissors(simulation, command.name), command.angle_deg)
    return command if poses is None else command.model_copy(update={"rest_poses_mm": as_poses(poses)})


def as_poses(poses: Float64) -> tuple[tuple[Vector3 | None, ...], ...]:
    """Poses of a blade at rest, shape (pose_count, point_count, 3), as commands hold them: None where it is NaN."""
    return tuple(tuple((x, y, z) if x == x else None for x, y, z in pose) for pose in poses.tolist())


def perform_tool(simulation: Simulation, command: Done) -> None:
    """Do what one of these commands says.

    Raises
    ------
    SimulationError
        It cannot be done, and nothing has changed.
    """
    match command:
        case CloseForceps():
            simulation.forceps(**command.model_dump(exclude={"kind"}))
        case SqueezeForceps():
            found = next((one for one in simulation.grabs if one.name == command.name), None)
            if not isinstance(found, Forceps):
                raise SimulationError("no forceps of this name hold tissue: close them first", place=command.name)
            simulation.squeeze(found, command.gap_mm)
        case CloseRetractor():
            simulation.retractor(**command.model_dump(exclude={"kind"}))
        case BringScissors():
            simulation.scissors(**command.model_dump(exclude={"kind"}))
        case PlaceScissors():
            scissors = _scissors(simulation, command.name)
            simulation.place_scissors(scissors, command.hinge_mm, command.direction, command.closing)
        case Snip():
            scissors = _scissors(simulation, command.name)
            simulation.snip(scissors, command.angle_deg, rest_poses_mm=command.rest_poses_mm)
        case WithdrawScissors():
            simulation.withdraw_scissors(_scissors(simulation, command.name))


def withdrawal_of(instrument: Instrument) -> Act:
    """The command with which an instrument lets go, or is taken away."""
    if isinstance(instrument, Grab):
        return OpenGrab(name=instrument.name)
    if isinstance(instrument, Scissors):
        return WithdrawScissors(name=instrument.name)
    return WithdrawProbe(name=instrument.name)


def _scissors(simulation: Simulation, name: str) -> Scissors:
    found = next((one for one in simulation.open_scissors if one.name == name), None)
    if found is None:
        raise SimulationError("there are no scissors of this name: bring them in first", place=name)
    return found
