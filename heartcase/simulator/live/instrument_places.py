"""Where the instruments of a simulation are, in mm, for those who lead and show them."""

from __future__ import annotations

import numpy as np

from heartcase.schemas.arrays import Float64
from heartcase.simulator.live.tool import Held, Turn
from heartcase.simulator.simulation import Simulation

__all__ = ["held_by", "places_mm", "probe_axes_mm"]


def places_mm(simulation: Simulation) -> dict[str, Float64]:
    """Offset of each hand and centre of each probe, LPS mm, by name."""
    model = simulation.model
    places = {grab.name: model.to_mm(grab.pose.offset) for grab in simulation.grabs}
    for probe in simulation.probes:
        places[probe.name] = model.geometry.index_to_world(probe.centre - 0.5)
    return places


def held_by(simulation: Simulation) -> tuple[Held, ...]:
    """What holds tissue."""
    model = simulation.model
    to_world = model.geometry.direction_matrix
    found = []
    for grab in simulation.grabs:
        centre_mm = model.geometry.index_to_world(grab.centre_at(grab.pose, model) - 0.5)
        turn: Turn | None = None
        if not np.array_equal(grab.pose.turn, np.eye(3)):
            x, y, z = (to_world @ grab.pose.turn @ to_world.T).tolist()
            turn = ((x[0], x[1], x[2]), (y[0], y[1], y[2]), (z[0], z[1], z[2]))
        found.append(Held(grab.name, centre_mm, model.to_mm(grab.pose.offset), turn))
    return tuple(found)


def probe_axes_mm(simulation: Simulation) -> dict[str, Float64]:
    """Name of each probe -> its semi-axes in columns, then half of the line it is swept along; LPS mm, shape (3, 4)."""
    model = simulation.model
    to_mm = model.geometry.direction_matrix * model.cell_mm
    return {
        probe.name: to_mm @ np.column_stack([probe.turn * probe.semi_axes, probe.half_axis])
        for probe in simulation.probes
    }
