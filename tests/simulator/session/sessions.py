"""Sessions for the tests: a small block, random commands, and fingerprints of what a session came to."""

from __future__ import annotations

from hashlib import sha256

import numpy as np
from hypothesis import strategies as st

from heartcase.schemas.recording.commands import (
    AddSprings,
    Advance,
    BringProbe,
    CloseGrab,
    GoTo,
    Halt,
    LeadGrab,
    Mark,
    MoveProbe,
    OpenGrab,
    Redo,
    RemoveSprings,
    Rewind,
    Undo,
    WithdrawProbe,
)
from heartcase.simulator.instruments.grab import Grab
from heartcase.simulator.lattice.moduli import ForceLaw
from heartcase.simulator.session.operating_session import OperatingSession
from heartcase.simulator.simulation import Simulation
from tests.simulator.lattices import block

CELL_MM = 2.0
SIZE = (6, 4, 4)
QUARTER = ((0.0, -1.0, 0.0), (1.0, 0.0, 0.0), (0.0, 0.0, 1.0))
NAMES = st.sampled_from(["left", "tip"])


def block_model(law: str = "springs", size=SIZE):
    return block(*size, fix_base=True, cell_mm=CELL_MM).with_law(ForceLaw(law))


def block_simulation(law: str = "springs", *, backend="cpu", sleep_mm: float = 0.0, size=SIZE, **options) -> Simulation:
    return Simulation(block_model(law, size), backend=backend, sleep_mm=sleep_mm, **options)


def fingerprint(simulation: Simulation) -> str:
    """All that goes on into the future: state, instruments, springs."""
    state, model = simulation.state, simulation.model
    digest = sha256(repr(state.step_count).encode())
    for value in vars(state).values():
        digest.update(np.asarray(value).tobytes())
    for one in simulation.instruments:
        digest.update(one.name.encode())
        if isinstance(one, Grab):
            parts = [one.nodes, one.closed_at, one.arms]
            parts += [part for pose in (one.pose, one.target) for part in (pose.offset, pose.turn)]
        else:
            parts = [one.semi_axes, one.turn, one.centre, one.target]
        for part in parts:
            digest.update(np.ascontiguousarray(part).tobytes())
    for part in (model.spring_weight, model.explicit.nodes, model.explicit.stiffness, model.explicit.rest_length):
        digest.update(np.ascontiguousarray(part).tobytes())
    return digest.hexdigest()


def operate(session: OperatingSession) -> None:
    """A little of everything, in 300 steps."""
    session.do(CloseGrab(name="left", center_mm=(2, 4, 8), radius_mm=3))
    session.do(LeadGrab(name="left", offset_mm=(0, 1, 2), turn=QUARTER))
    session.advance(60)
    session.do(BringProbe(name="tip", center_mm=(9, 4, 11), semi_axes_mm=(2.5, 2.5, 2.5)))
    session.do(MoveProbe(name="tip", center_mm=(9, 4, 9)))
    session.advance(45)
    session.do(AddSprings(nodes=((3, 120), (8, 90)), stiffness_n_m=0.5))
    session.do(Mark(name="joined"))
    session.advance(75)
    session.do(OpenGrab(name="left"))
    session.do(RemoveSprings(numbers=(0,)))
    session.advance(60)
    session.do(WithdrawProbe(name="tip"))
    session.advance(60)


def points(low: float = -2.0, high: float = 14.0):
    return st.tuples(*[st.floats(low, high, width=32)] * 3)


def commands(node_count: int = 7 * 5 * 5):
    """Commands that may be done, or refused."""
    node = st.integers(0, node_count)
    inside = st.tuples(st.sampled_from([2.0, 6.0, 10.0]), st.sampled_from([2.0, 6.0]), st.sampled_from([5.0, 8.0]))
    motion = st.one_of(
        st.builds(LeadGrab, name=st.just("left"), offset_mm=points(-2.0, 2.0), turn=st.sampled_from([None, QUARTER])),
        st.builds(MoveProbe, name=NAMES, center_mm=points(0.0, 12.0)),
        st.builds(Advance, steps=st.integers(1, 30)),
        st.builds(Advance, steps=st.integers(1, 30)),
        st.builds(Advance, steps=st.integers(1, 10), of=st.integers(10, 20)),
        st.builds(Mark, name=NAMES),
        st.just(Halt()),
    )
    acts = st.one_of(
        st.builds(CloseGrab, name=NAMES, center_mm=inside, radius_mm=st.floats(1.5, 4.0)),
        st.builds(CloseGrab, name=st.just("left"), center_mm=inside | points(), radius_mm=st.floats(1.5, 4.0)),
        st.builds(OpenGrab, name=NAMES),
        st.builds(BringProbe, name=st.just("tip"), center_mm=points(), semi_axes_mm=st.just((1.5, 2.0, 1.5))),
        st.builds(WithdrawProbe, name=NAMES),
        st.builds(
            AddSprings,
            nodes=st.lists(st.tuples(node, node), min_size=1, max_size=3).map(tuple),
            stiffness_n_m=st.sampled_from([0.05, 1.0, 1e5]),
            rest_length_mm=st.none(),
        ),
        st.builds(RemoveSprings, numbers=st.sampled_from([(0,), (1,), (0, 2)])),
    )
    navigation = st.one_of(
        st.just(Undo()),
        st.just(Redo()),
        st.builds(Rewind, seconds=st.floats(1e-4, 0.03)),
        st.builds(GoTo, step=st.integers(0, 300)),
    )
    return st.one_of(motion, motion, acts, acts, navigation)
