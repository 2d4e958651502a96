"""What instruments cost the adult's moving heart: frames of 1/30 s with its surface, without them and with them.

``nothing`` pulls at the heart, so that nothing sleeps; ``probe far`` and ``probe`` have a ball of 6 mm besides, 30 mm
away and pushed 11 mm into the front; ``stitches`` ten threads across the front, drawn with 0.1 N; ``patch`` a round one
of 8 mm. Each is what a frame takes at the median of 60, over the time that it simulates, with steps as long as the pace
allows and with steps as they are; beside it how far 20 steps from there are from the reference's, and cells inside out.

    HEARTCASE_CASE=out/adult-phantom.case python -m benchmarks.instrument_steps
"""

from __future__ import annotations

import os
from pathlib import Path
from time import perf_counter

import numpy as np

from benchmarks.frame import FRAME_S, built_case
from heartcase.schemas.arrays import Float64
from heartcase.simulator.engine.backends import make_engine
from heartcase.simulator.lattice.moduli import ForceLaw
from heartcase.simulator.load import Case, load_case
from heartcase.simulator.simulation import Simulation

WARM_UP, FRAMES, COMPARED = 5, 60, 20
ADULT = {"size": "adult", "spacing_mm": 1.75}
"""The case that is built where ``HEARTCASE_CASE`` names none."""
WHAT = ("nothing", "probe far", "probe", "stitches", "patch")


def moving(case: Case, law: str, pace: float | None) -> tuple[Simulation, Float64]:
    """The heart, pulled at the apex, and the place at its front, LPS mm."""
    simulation = Simulation(
        case.model.with_law(ForceLaw(law)), surface=case.surface, tissue=case.tissue, pace=pace, sleep_mm=0.0
    )
    simulation.prepare()
    assert case.surface is not None
    surface = case.surface.rest_mm.astype(np.float64)
    front = surface[surface[:, 1].argmin()]
    hand = simulation.grab(surface[surface[:, 2].argmin()], 6.0)
    simulation.lead(hand, (3.0, 0.0, -4.0))
    return simulation, front


def frame_times(simulation: Simulation, front: Float64, what: str) -> list[float]:
    """What each frame takes, s."""
    probe = None
    steps = round(FRAME_S / simulation.step_s)
    if what.startswith("probe"):
        probe = simulation.probe(front + np.array([0.0, -30.0 if what == "probe far" else -7.0, 0.0]), 6.0)
    if what == "stitches":
        for number in range(10):
            ends = front + np.array([[-4.0, 0.0, 4.0 * number - 20.0], [4.0, 0.0, 4.0 * number - 20.0]])
            places = [surface_place(simulation, point) for point in ends]
            thread = simulation.stitch(places, name=f"stitch {number}")
            simulation.draw(thread, tension_n=0.1)
    if what == "patch":
        turns = np.linspace(0.0, 2.0 * np.pi, 24, endpoint=False)
        ring = front + 8.0 * np.stack([np.cos(turns), np.zeros(24), np.sin(turns)], axis=1)
        simulation.patch([surface_place(simulation, point) for point in ring])
    times = []
    for number in range(WARM_UP + FRAMES):
        if probe is not None and what == "probe":
            simulation.move(probe, front + np.array([0.0, min(-7.0 + 0.6 * number, 5.0), 0.0]))
        start = perf_counter()
        simulation.step(steps)
        simulation.surface_now()
        times.append(perf_counter() - start)
    return times[WARM_UP:]


def surface_place(simulation: Simulation, point: Float64) -> Float64:
    """The vertex of the surface now that is nearest to a point, LPS mm."""
    vertices = simulation.surface_now().vertices_mm.astype(np.float64)
    nearest: Float64 = vertices[np.linalg.norm(vertices - point, axis=1).argmin()]
    return nearest


def difference(simulation: Simulation) -> float:
    """Largest difference to the reference after some more steps [cells]."""
    ends = []
    for backend in ("cpu", "reference"):
        engine = make_engine(simulation.model, backend)
        engine.set_tethers(simulation._strung())
        engine.load(simulation.state)
        rows = [probe.row(COMPARED) for probe in simulation.probes]
        engine.advance(COMPARED, simulation.verlet, *([np.stack(rows)] if rows else []))
        ends.append(engine.read().displacement.astype(np.float64))
    return float(np.abs(ends[0] - ends[1]).max())


def main() -> None:
    """Print a row for each."""
    path = Path(os.environ["HEARTCASE_CASE"]) if "HEARTCASE_CASE" in os.environ else built_case(ADULT)
    case = load_case(path, needs=("surface", "tissue"))
    assert case.surface is not None
    print(f"{case.model.node_count:,} nodes, {len(case.surface.triangles):,} triangles")
    print(
        "law       with        pace   ms a frame   real-time factor   at a pace of 1   difference [cells]   inside out"
    )
    for law in ("springs", "element"):
        for what in WHAT:
            found = []
            for pace in (None, 1.0):
                simulation, front = moving(case, law, pace)
                seconds = float(np.median(frame_times(simulation, front, what)))
                simulated = round(FRAME_S / simulation.step_s) * simulation.step_s
                found.append((simulation._paced.pace, seconds, simulated / seconds))
                if pace is None:
                    off, turned = difference(simulation), simulation.inverted_cell_count()
            (used, seconds, factor), (_, _, plain) = found
            print(
                f"{law:10}{what:12}{used:4.2f}{1e3 * seconds:13.1f}{factor:19.2f}{plain:17.2f}{off:13.1e}{turned:13d}"
            )


if __name__ == "__main__":
    main()
