"""What each command does to a simulation, and to the lattice alone.

A command that is refused changes nothing: each of these either does the whole of it or raises.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from heartcase.schemas.errors import SimulationError
from heartcase.schemas.recording.commands import (
    AddSprings,
    Advance,
    BringProbe,
    BringScissors,
    CloseForceps,
    CloseGrab,
    CloseRetractor,
    Cut,
    Done,
    DrawStitch,
    Excise,
    Halt,
    LeadGrab,
    Mark,
    MoveProbe,
    OpenGrab,
    PlacePatch,
    PlaceRow,
    PlaceStitch,
    RemoveSprings,
    Snip,
    TakeOutPatch,
    TakeOutStitch,
    TieStitch,
    WithdrawProbe,
)
from heartcase.simulator.cutting.blade_sheet import blade_points
from heartcase.simulator.cutting.cuts import Cuts, cut_further
from heartcase.simulator.dynamics.joining import join
from heartcase.simulator.instruments.grab import Grab
from heartcase.simulator.instruments.probe import Probe
from heartcase.simulator.instruments.wrench import Instrument
from heartcase.simulator.lattice.model import LatticeModel
from heartcase.simulator.session.perform_sutures import patched_lattice, perform_suture, place_of, resolved_suture
from heartcase.simulator.session.perform_tools import as_poses, perform_tool, resolved_snip
from heartcase.simulator.simulation import Simulation
from heartcase.simulator.tissue.excised_tissue import excised_lattice

__all__ = ["changed_lattice", "instrument_named", "perform", "refuse_others", "resolved"]


def refuse_others(given: Any, kinds: tuple[type, ...]) -> None:
    """SimulationError where what was given as a command is none of these kinds: all of them, or cuts alone."""
    if isinstance(given, kinds):
        return
    found = "None" if given is None else type(given).__name__
    message = "give a Cut" if kinds == (Cut,) else "give a command, such as Undo(), or what parse_command makes of JSON"
    raise SimulationError(f"{message} (found {found})", place="command")


def resolved(simulation: Simulation, command: Done) -> Done:
    """The command with all stated that it would take from this moment: what then stands in a history.

    So the lattice of any moment follows from the commands before it, without the motion between them.
    """
    if isinstance(command, AddSprings) and command.rest_length_mm is None:
        model = simulation.model
        if max(map(max, command.nodes)) < model.node_count:
            ends = (model.node_index + simulation.state.displacement.astype(float))[np.array(command.nodes)]
            length = np.linalg.norm(ends[:, 1] - ends[:, 0], axis=1) * model.cell_mm
            return command.model_copy(update={"rest_length_mm": tuple(length.tolist())})
    if isinstance(command, Cut) and not command.at_rest:
        poses = simulation.rest_poses_mm(command.poses_mm, name=command.name)
        return command.model_copy(update={"poses_mm": as_poses(poses), "at_rest": True})
    if isinstance(command, Snip):
        return resolved_snip(simulation, command)
    return resolved_suture(simulation, command)


def perform(simulation: Simulation, command: Done) -> None:
    """Do what a command says.

    Raises
    ------
    SimulationError
        It cannot be done, and nothing has changed; or of steps, the simulation broke down: the state before them was
        restored, and instruments stay where they were.
    """
    match command:
        case CloseGrab():
            _refuse_known(simulation, command.name)
            simulation.grab(command.center_mm, command.radius_mm, name=command.name)
        case LeadGrab():
            simulation.lead(_grab(simulation, command.name), command.offset_mm, command.turn)
        case OpenGrab():
            simulation.release(_grab(simulation, command.name))
        case BringProbe():
            _refuse_known(simulation, command.name)
            shape = (command.center_mm, command.semi_axes_mm)
            simulation.probe(*shape, turn=command.turn, axis_mm=command.axis_mm, name=command.name)
        case MoveProbe():
            simulation.move(_probe(simulation, command.name), command.center_mm)
        case WithdrawProbe():
            simulation.withdraw(_probe(simulation, command.name))
        case AddSprings():
            simulation.add_springs(command.nodes, command.stiffness_n_m, command.rest_length_mm)
        case RemoveSprings():
            simulation.remove_explicit_springs(_chosen(simulation.model, command))
        case Cut():
            simulation.cut(command.poses_mm, at_rest=command.at_rest, name=command.name)
        case Excise():
            bound = command.bound
            place = command.place_mm if bound is None else place_of(bound)
            simulation.excise(place, at_rest=command.at_rest, name=command.name)
        case PlaceStitch() | PlaceRow() | DrawStitch() | TieStitch() | TakeOutStitch() | PlacePatch() | TakeOutPatch():
            perform_suture(simulation, command)
        case Advance():
            _go_part_of_the_way(simulation, command.steps / (command.of or command.steps))
            simulation.step(command.steps)
        case Halt():
            _go_part_of_the_way(simulation, 0.0)
        case Mark():
            pass
        case _:
            if isinstance(command, CloseForceps | CloseRetractor | BringScissors):
                _refuse_known(simulation, command.name)
            perform_tool(simulation, command)


def changed_lattice(model: LatticeModel, cuts: Cuts, command: Done, *, step_s: float) -> tuple[LatticeModel, Cuts]:
    """The lattice, and what was cut of it, after a command as :func:`resolved` gave it.

    The same one where the command leaves it alone.

    Raises
    ------
    SimulationError
        It cannot be done with this lattice.
    """
    poses_mm = command.poses_mm if isinstance(command, Cut) else None
    if isinstance(command, Snip):
        poses_mm = command.rest_poses_mm
    if isinstance(command, Cut | Snip) and poses_mm is not None:
        cut, cuts, _ = cut_further(model, cuts, blade_points(model, poses_mm, command.name, may_be_open=True))
        return cut, cuts
    if isinstance(command, Excise) and command.bound is not None:
        left, without, _ = excised_lattice(model, cuts, place_of(command.bound), name=command.name)
        return left, without
    return _joined(patched_lattice(model, cuts, command, step_s=step_s), command, step_s=step_s), cuts


def _joined(model: LatticeModel, command: Done, *, step_s: float) -> LatticeModel:
    if isinstance(command, AddSprings):
        still = np.zeros((model.node_count, 3), np.float32)
        lengths = command.rest_length_mm
        return join(model, still, command.nodes, command.stiffness_n_m, lengths, step_s=step_s)
    if isinstance(command, RemoveSprings):
        return replace(model, explicit=model.explicit.without(_chosen(model, command)))
    return model


def instrument_named(simulation: Simulation, name: str) -> Instrument | None:
    """The instrument of this name that is in the tissue."""
    return next((one for one in simulation.instruments if one.name == name), None)


def _grab(simulation: Simulation, name: str) -> Grab:
    found = next((grab for grab in simulation.grabs if grab.name == name), None)
    if found is None:
        raise SimulationError("no hand of this name holds tissue: close it first", place=name)
    return found


def _probe(simulation: Simulation, name: str) -> Probe:
    found = next((probe for probe in simulation.probes if probe.name == name), None)
    if found is None:
        raise SimulationError("there is no probe of this name: bring it in first", place=name)
    return found


def _refuse_known(simulation: Simulation, name: str) -> None:
    if instrument_named(simulation, name) is not None:
        raise SimulationError("an instrument of this name is in the tissue: take another name", place=name)


def _chosen(model: LatticeModel, command: RemoveSprings) -> np.ndarray:
    """True for each explicit spring that a command names."""
    count = model.explicit.count
    if max(command.numbers) >= count:
        raise SimulationError(f"there are {count} explicit springs, from 0: name one of them", place="numbers")
    is_chosen = np.zeros(count, dtype=bool)
    is_chosen[list(command.numbers)] = True
    return is_chosen


def _go_part_of_the_way(simulation: Simulation, share: float) -> None:
    """Lead each instrument so far towards where it is led.

    The nodes of a hand go in straight lines, and are there in the same way with a turn that is no rotation.
    """
    if share == 1.0:
        return

    for grab in simulation.grabs:
        grab.lead_part(share)
    for probe in simulation.probes:
        probe.target = probe.centre + share * (probe.target - probe.centre)
    simulation.draw_part_of_the_way(share)
