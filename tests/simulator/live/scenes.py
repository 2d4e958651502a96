"""A small case on disk, and a live session on it."""

from __future__ import annotations

import threading
import time

from heartcase.pipeline.bundle.write_bundle import write_bundle
from heartcase.simulator.live.live import Live
from heartcase.simulator.load import load_case
from heartcase.simulator.session.operating_session import OperatingSession
from heartcase.simulator.simulation import Simulation
from tests.factories import block_case


def write_case(folder, **options):
    """A block of 8 x 5 x 4 cells of 3 mm on a fixed base, at 10, -20, 30 mm."""
    path = folder / "block.case"
    write_bundle(path, block_case(size=(8, 5, 4), **options))
    return path


def load(path, *more):
    return load_case(path, needs=("surface", "structures", "tissue", *more))


def live_on(case):
    simulation = Simulation(case.model, surface=case.surface, tissue=case.tissue, damping_per_s=30.0)
    return Live(OperatingSession(simulation), manifest=case.manifest)


def until(condition, *, seconds=60.0):
    """Wait for something that a thread does."""
    end = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < end, "it did not come to that"
        time.sleep(0.005)


def threads():
    """Threads that run, but those that work out a simulation's cuts, which end with it, and those that loops share."""
    own = ("heartcase-cuts", "heartcase-loop")
    return sorted(one.name for one in threading.enumerate() if not one.name.startswith(own))


def bytes_of(simulation):
    return simulation.model.node_count, simulation.state.displacement.tobytes(), simulation.state.velocity.tobytes()
