"""A case as the studio moves it: one place for what its server, its pages without a server and checks of tours run."""

from __future__ import annotations

from heartcase.simulator.load import Case
from heartcase.simulator.simulation import SLEEP_MM, Simulation

__all__ = ["DAMPING_PER_S", "simulation_of_case"]

DAMPING_PER_S = 30.0
"""Damping of all movement, 1/s."""


def simulation_of_case(case: Case) -> Simulation:
    """A simulation of a case as it was built.

    Parameters
    ----------
    case
        The case, loaded with surface and tissue.
    """
    return Simulation(
        case.model, surface=case.surface, tissue=case.tissue, damping_per_s=DAMPING_PER_S, sleep_mm=SLEEP_MM
    )
