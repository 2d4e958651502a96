"""What commands for stitches and patches do to a simulation, and patches to the lattice alone."""

from __future__ import annotations

from heartcase.schemas.errors import SimulationError
from heartcase.schemas.recording.commands import (
    BoundPlace,
    Done,
    DrawStitch,
    Excise,
    PlacePatch,
    PlaceRow,
    PlaceStitch,
    TakeOutPatch,
    TakeOutStitch,
    TieStitch,
)
from heartcase.simulator.cutting.cuts import Cuts
from heartcase.simulator.lattice.model import LatticeModel
from heartcase.simulator.patching.flat_sheets import flat_sheet
from heartcase.simulator.patching.patches import Patch, with_patch, without_patch
from heartcase.simulator.simulation import Simulation
from heartcase.simulator.suturing.places import Place
from heartcase.simulator.suturing.stitches import Stitch

__all__ = [
    "patch_named",
    "patched_lattice",
    "perform_suture",
    "place_of",
    "resolved_suture",
    "stitch_named",
    "stitches_named",
]


def resolved_suture(simulation: Simulation, command: Done) -> Done:
    """The command with the places that it finds in this moment."""
    if isinstance(command, PlaceStitch) and command.bound is None:
        first, second = command.places_mm
        places = (simulation.place(point, at_rest=command.at_rest, name=command.name) for point in (first, second))
        return command.model_copy(update={"bound": tuple(map(_bound, places))})
    if isinstance(command, Excise) and command.bound is None:
        found = simulation.place(command.place_mm, at_rest=command.at_rest, name=command.name)
        return command.model_copy(update={"bound": _bound(found)})
    if isinstance(command, PlaceRow) and command.bound is None:
        chosen = [stitch_named(simulation, name) for name in command.between or ()] or command.places_mm or ()
        row = simulation.row_places(chosen, spacing_mm=command.spacing_mm, at_rest=command.at_rest, name=command.name)
        return command.model_copy(update={"bound": tuple((_bound(one), _bound(other)) for one, other in row)})
    if isinstance(command, PlacePatch) and (command.bound is None or command.rim_mm is None):
        rim, rim_mm = simulation.outline_places(
            command.outline_mm, spacing_mm=command.spacing_mm, at_rest=command.at_rest, name=command.name
        )
        return command.model_copy(
            update={"bound": tuple(map(_bound, rim)), "rim_mm": tuple(map(tuple, rim_mm.tolist()))}
        )
    if isinstance(command, TakeOutPatch) and command.nodes is None:
        patch = patch_named(simulation, command.name)
        return command.model_copy(update={"nodes": (patch.first, patch.node_count)})
    return command


def perform_suture(simulation: Simulation, command: Done) -> None:
    """Do what a command for stitches says.

    Raises
    ------
    SimulationError
        It cannot be done, and nothing has changed.
    """
    match command:
        case PlaceStitch():
            if any(command.name in (stitch.name, stitch.row) for stitch in simulation.stitches):
                raise SimulationError("there is a stitch of this name: take another name", place=command.name)
            places = command.places_mm if command.bound is None else tuple(map(place_of, command.bound))
            stiffness = command.stiffness_n_m
            simulation.stitch(places, at_rest=command.at_rest, stiffness_n_m=stiffness, name=command.name)
        case PlaceRow():
            row = resolved_suture(simulation, command)
            assert isinstance(row, PlaceRow)
            pairs = [(place_of(one), place_of(other)) for one, other in row.bound or ()]
            simulation.stitch_row(
                pairs, is_running=command.running, stiffness_n_m=command.stiffness_n_m, name=command.name
            )
        case DrawStitch():
            for stitch in stitches_named(simulation, command.name):
                simulation.draw(stitch, length_mm=command.length_mm, tension_n=command.tension_n)
        case TieStitch():
            for stitch in stitches_named(simulation, command.name):
                simulation.tie(stitch)
        case TakeOutStitch():
            for stitch in stitches_named(simulation, command.name):
                simulation.take_out(stitch)
        case PlacePatch():
            patch = resolved_suture(simulation, command)
            assert isinstance(patch, PlacePatch)
            assert patch.rim_mm is not None
            simulation.sew_on(
                tuple(map(place_of, patch.bound or ())),
                patch.rim_mm,
                stiffness_n_m=command.stiffness_n_m,
                thickness_mm=command.thickness_mm,
                scale=command.scale,
                name=command.name,
            )
        case TakeOutPatch():
            simulation.take_out_patch(patch_named(simulation, command.name))


def patched_lattice(model: LatticeModel, cuts: Cuts, command: Done, *, step_s: float) -> LatticeModel:
    """The lattice after a command for a patch as :func:`resolved_suture` gave it; the same one after others.

    Raises
    ------
    SimulationError
        There cannot be such a patch.
    """
    if isinstance(command, PlacePatch) and command.rim_mm is not None:
        sheet = flat_sheet(command.rim_mm, scale=command.scale, name=command.name)
        return with_patch(model, cuts.uncut, sheet, command.stiffness_n_m, command.thickness_mm, step_s)
    if isinstance(command, TakeOutPatch) and command.nodes is not None:
        if sum(command.nodes) > model.loose_count:
            raise SimulationError("there is no such patch", place=command.name)
        return without_patch(model, *command.nodes)
    return model


def patch_named(simulation: Simulation, name: str) -> Patch:
    """The patch of a name.

    Raises
    ------
    SimulationError
        There is none.
    """
    found = next((patch for patch in simulation.patches if patch.name == name), None)
    if found is None:
        raise SimulationError("there is no patch of this name: sew it on first", place=name)
    return found


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


def stitches_named(simulation: Simulation, name: str) -> list[Stitch]:
    """The stitch of a name, or all of a row.

    Raises
    ------
    SimulationError
        There is none.
    """
    row = [stitch for stitch in simulation.stitches if stitch.row == name]
    return row or [stitch_named(simulation, name)]


def _bound(place: Place) -> BoundPlace:
    return BoundPlace(cell=place.cell, sample=place.sample, local=place.local)


def place_of(bound: BoundPlace) -> Place:
    """A place as a command states it."""
    return Place(bound.cell, bound.sample, bound.local)
