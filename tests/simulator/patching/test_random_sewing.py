"""Random sewing: whatever is sewn, cut and taken out in any order stays finite, and goes back and on to the byte."""

from __future__ import annotations

from contextlib import suppress

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from heartcase.schemas.errors import SimulationError
from heartcase.schemas.recording.commands import (
    CloseGrab,
    Cut,
    DrawStitch,
    LeadGrab,
    OpenGrab,
    PlacePatch,
    PlaceRow,
    PlaceStitch,
    TakeOutPatch,
    TakeOutStitch,
    TieStitch,
)
from heartcase.simulator.session.operating_session import OperatingSession
from tests.examples import few_and_many
from tests.simulator.patching.test_patches import slab

SEEDS = st.integers(0, 2**32 - 1)


def random_command(rng):
    """A command, some of which cannot be done at the moment."""
    name = str(rng.choice(["a", "b"]))

    def point():
        return tuple(float(x) for x in rng.uniform((1, 1, 3.5), (23, 23, 4.5)))

    kind = rng.integers(11)
    if kind == 0:
        angle = np.arange(9) / 9 * 2 * np.pi
        wave = rng.uniform(2.5, 8.0) * (1 + 0.3 * rng.uniform(-1, 1) * np.cos(2 * angle + rng.uniform(0, 6)))
        middle = rng.uniform(6, 18, 2)
        around = middle + wave[:, None] * np.stack([np.cos(angle), np.sin(angle)], axis=1)
        outline = tuple((x, y, 4.0) for x, y in around.tolist())
        how = {"scale": float(rng.uniform(0.7, 1.1)), "stiffness_n_m": float(10 ** rng.uniform(0, 3))}
        return PlacePatch(name=name, outline_mm=outline, spacing_mm=float(rng.uniform(2, 5)), **how)
    if kind == 1:
        return TakeOutPatch(name=name)
    if kind == 2:
        return PlaceStitch(name=name, places_mm=(point(), point()))
    if kind == 3:
        places = ((point(), point()), (point(), point()))
        return PlaceRow(name=f"row {name}", places_mm=places, spacing_mm=4.0, running=bool(rng.integers(2)))
    drawn = name if rng.integers(2) else f"row {name}"
    if kind == 4:
        return DrawStitch(name=drawn, tension_n=float(rng.uniform(0, 0.05)))
    if kind == 5:
        return DrawStitch(name=drawn, length_mm=float(rng.uniform(0, 8)))
    if kind == 6:
        return (TieStitch if rng.integers(2) else TakeOutStitch)(name=drawn)
    if kind == 7:
        x, slope = rng.uniform(4, 20), rng.uniform(-8, 8)
        poses = (((x, -2, 9), (x + slope, 26, 9)), ((x, -2, -4), (x + slope, 26, -4)))
        return Cut(poses_mm=poses, at_rest=bool(rng.integers(2)))
    if kind == 8:
        return CloseGrab(name=name, center_mm=point(), radius_mm=3.0)
    if kind == 9:
        return LeadGrab(name=name, offset_mm=tuple(float(x) for x in rng.uniform(-3, 3, 3)))
    return OpenGrab(name=name)


def all_of(simulation):
    """Bytes of the state and of all that is sewn."""
    parts = [vars(simulation.state)[name] for name in ("displacement", "velocity")]
    parts += [vars(simulation._strung())[name] for name in ("nodes", "shares", "stiffness", "length", "tension_most")]
    parts += [simulation.model.node_mass, simulation.model.explicit.nodes, simulation.model.explicit.stiffness]
    return b"".join(np.ascontiguousarray(part).tobytes() for part in parts)


def check_sewing(seed, command_count=14):
    """Do commands at random, and go back and on to every act."""
    rng = np.random.default_rng(seed)
    session = OperatingSession(slab(law="element" if seed % 2 else "springs", damping_per_s=40.0))
    done, moments = 0, {}
    for _ in range(command_count):
        with suppress(SimulationError):
            session.do(random_command(rng))
            done += 1
        simulation = session.simulation
        assert simulation._thread_rate() <= simulation._thread_rate_limit(simulation.model, simulation.cuts) * 1.001
        frame = session.take([], steps=int(rng.integers(1, 40)))
        # What pulls tissue to shreds may be stopped, and says so.
        assert frame.breakdown is None or "broke down" in frame.breakdown
        assert np.isfinite(session.simulation.state.displacement).all()
        assert np.abs(session.simulation.displacement_mm()[: -simulation.model.loose_count or None]).max() < 100.0
        moments[session.position] = all_of(session.simulation)
        for patch in frame.patches.values():
            assert np.isfinite(patch.vertices_mm).all()
            assert (patch.forces_n >= 0).all()
    end = session.position
    steps = session.step_count
    for position in sorted(moments, reverse=True):
        session._go_to(position)
        assert all_of(session.simulation) == moments[position]
    session.go_to(steps)
    assert session.position == end
    assert all_of(session.simulation) == moments[end]
    return done


@few_and_many(4, 150)
def test_any_sewing_stays_finite_and_goes_back_and_on_to_the_byte(count):
    done = []
    settings(max_examples=count, deadline=None)(given(SEEDS)(lambda seed: done.append(check_sewing(seed))))()
    assert np.mean(done) > 3


@pytest.mark.parametrize("seed", [3, 64])
def test_sewing_of_old(seed):
    """Seeds in which something was wrong once, or much is done."""
    assert check_sewing(seed, 20) > 5
