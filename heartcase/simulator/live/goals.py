"""Where instruments are and shall be, and the way there: no faster than a hand goes and tissue stands."""

from __future__ import annotations

import numpy as np

from heartcase.schemas.arrays import Float64
from heartcase.schemas.recording.commands import Done, LeadGrab, MoveProbe
from heartcase.simulator.live.tool import Held, Turn
from heartcase.simulator.simulation import Simulation

__all__ = ["HAND_SPEED_MM_S", "SOFT_SPEED_MM_S", "Goals", "held_by", "places_mm", "probe_axes_mm"]

HAND_SPEED_MM_S = 150.0
"""How fast an instrument goes to where the mouse has gone at most, mm for each simulated second. A choice: surgeons'
hands are slower most of the time, and a mouse leaps."""
SOFT_SPEED_MM_S = 30.0
"""How fast an instrument that nobody leads any more is brought back before it lets go, mm for each simulated second."""


class Goals:
    """Where each instrument shall be by the mouse, until it is there."""

    def __init__(self) -> None:
        self._wanted: dict[str, tuple[LeadGrab | MoveProbe, float]] = {}

    def __contains__(self, name: str) -> bool:
        return name in self._wanted

    def set(self, command: LeadGrab | MoveProbe, speed_mm_s: float = HAND_SPEED_MM_S) -> None:
        """An instrument shall be led there; what was wanted of it before is not any more.

        Parameters
        ----------
        command
            Where to.
        speed_mm_s
            How fast at most, mm for each simulated second.
        """
        self._wanted[command.name] = command, speed_mm_s

    def drop(self, name: str | None = None) -> None:
        """Nothing is wanted of an instrument any more; of all where no name is given."""
        if name is None:
            self._wanted.clear()
        else:
            self._wanted.pop(name, None)

    def commands(self, places_mm: dict[str, Float64], seconds: float) -> list[Done]:
        """What leads all instruments on during the next steps.

        Parameters
        ----------
        places_mm
            Where each instrument in the tissue is now, as its commands say it: the offset of what holds, the centre of
            a probe; LPS mm, shape (3,) each. What is wanted of others is dropped.
        seconds
            Simulated time of the next steps, s.
        """
        given: list[Done] = []
        for name, (wanted, speed) in list(self._wanted.items()):
            if name not in places_mm:
                del self._wanted[name]
                continue
            goal = np.array(wanted.offset_mm if isinstance(wanted, LeadGrab) else wanted.center_mm)
            way = goal - places_mm[name]
            size, most = float(np.linalg.norm(way)), speed * seconds
            if size <= most:
                del self._wanted[name]
                given.append(wanted)
                continue
            x, y, z = (places_mm[name] + way * (most / size)).tolist()
            field = "offset_mm" if isinstance(wanted, LeadGrab) else "center_mm"
            given.append(wanted.model_copy(update={field: (x, y, z)}))
        return given


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
