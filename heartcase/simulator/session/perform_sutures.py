"""What commands for stitches do to a simulation."""

from __future__ import annotations

from heartcase.schemas.errors import SimulationError
from heartcase.schemas.recording.commands import BoundPlace, Done, DrawStitch, PlaceStitch, TakeOutStitch, TieStitch
from heartcase.simulator.simulation import Simulation
from heartcase.simulator.suturing.places import Place
from heartcase.simulator.suturing.stitches import Stitch

__all__ = ["perform_suture", "resolved_suture", "stitch_named"]


def resolved_suture(simulation: Simulation, command: Done) -> Done:
    """The command with the places that it finds in this moment."""
    if isinstance(command, PlaceStitch) and command.bound is None:
        first, second = command.places_mm
        places = (simulation.place(point, at_rest=command.at_rest, name=command.name) for point in (first, second))
        bound = tuple(BoundPlace(cell=one.cell, sample=one.sample, local=one.local) for one in places)
        return command.model_copy(update={"bound": bound})
    return command


def perform_suture(simulation: Simulation, command: PlaceStitch | DrawStitch | TieStitch | TakeOutStitch) -> None:
    """Do what a command for stitches says.

    Raises
    ------
    SimulationError
        It cannot be done, and nothing has changed.
    """
    match command:
        case PlaceStitch():
            if any(stitch.name == command.name for stitch in simulation.stitches):
                raise SimulationError("there is a stitch of this name: take another name", place=command.name)
            places = command.places_mm if command.bound is None else _places(command)
            stiffness = command.stiffness_n_m
            simulation.stitch(places, at_rest=command.at_rest, stiffness_n_m=stiffness, name=command.name)
        case DrawStitch():
            stitch = stitch_named(simulation, command.name)
            simulation.draw(stitch, length_mm=command.length_mm, tension_n=command.tension_n)
        case TieStitch():
            simulation.tie(stitch_named(simulation, command.name))
        case TakeOutStitch():
            simulation.take_out(stitch_named(simulation, command.name))


def stitch_named(simulation: Simulation, name: str) -> Stitch:
    """The stitch of a name.

    Raises
    ------
    SimulationError
        There is none.
    """
    found = next((stitch for stitch in simulation.stitches if stitch.name == name), None)
    if found is None:
        raise SimulationError("there is no stitch of this name: place it first", place=name)
    return found


def _places(command: PlaceStitch) -> tuple[Place, ...]:
    assert command.bound is not None
    return tuple(Place(one.cell, one.sample, one.local) for one in command.bound)
