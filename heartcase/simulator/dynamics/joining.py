"""Joining nodes by explicit springs: from N/m and mm, and never stiffer than the time step allows."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import numpy.typing as npt

from heartcase.schemas.arrays import Float32, Integer
from heartcase.schemas.errors import Problem, SimulationError
from heartcase.simulator.dynamics.step_size import default_step, explicit_rate_limit
from heartcase.simulator.lattice.explicit_springs import ExplicitSprings
from heartcase.simulator.lattice.model import LatticeModel

__all__ = ["join"]


def join(
    model: LatticeModel,
    displacement: Float32,
    nodes: npt.ArrayLike,
    stiffness_n_m: npt.ArrayLike,
    rest_length_mm: npt.ArrayLike | None,
    *,
    step_s: float,
    thread_rate: float = 0.0,
) -> LatticeModel:
    """The lattice with more explicit springs.

    Parameters
    ----------
    model
        The lattice.
    displacement
        Displacement of the nodes now [cells], shape (node_count, 3).
    nodes
        Two different nodes each, shape (count, 2).
    stiffness_n_m
        Stiffness, N/m, above zero; one number or shape (count,).
    rest_length_mm
        Length at rest, mm; the distance now when left out; one number or shape (count,).
    step_s
        Time step, s.
    thread_rate
        What threads that hang on it add to omega^2 at most [1 / unit of time^2].

    Raises
    ------
    SimulationError
        With everything that is wrong: nodes that there are not, numbers out of range, springs that are too stiff.
    """
    pairs = np.asarray(nodes)
    if not pairs.size:
        return model
    if pairs.ndim != 2 or pairs.shape[1] != 2:
        raise SimulationError("give two nodes for each spring, shape (count, 2)", place="nodes")
    problems = _problems(model, pairs)
    stiffness, rest = np.zeros(len(pairs)), np.zeros(len(pairs))
    if _fits(stiffness_n_m, len(pairs)):
        stiffness = np.broadcast_to(np.asarray(stiffness_n_m, dtype=float), len(pairs))
    if not (np.isfinite(stiffness) & (stiffness > 0)).all():
        problems.append(Problem("stiffness_n_m", "give one stiffness above zero, or one for each spring"))
    if rest_length_mm is not None:
        rest = np.full(len(pairs), -1.0)
        if _fits(rest_length_mm, len(pairs)):
            rest = np.broadcast_to(np.asarray(rest_length_mm, dtype=float) / model.cell_mm, len(pairs))
        if not (np.isfinite(rest) & (rest >= 0)).all():
            problems.append(Problem("rest_length_mm", "give one length at rest not below zero, or one for each spring"))
    elif not problems:
        ends = (model.node_index + displacement.astype(float))[pairs]
        rest = np.linalg.norm(ends[:, 1] - ends[:, 0], axis=1)
    if problems:
        raise SimulationError(problems)
    unit = model.units.force_n / model.units.length_m
    more = ExplicitSprings(pairs.astype(np.int32), (stiffness / unit).astype(np.float32), rest.astype(np.float32))
    explicit = model.explicit.with_more(more)
    rate, limit = explicit.rate_bound(model.inverse_mass) + thread_rate, explicit_rate_limit(model, step_s)
    if limit == 0.0:
        most = default_step(replace(model, explicit=ExplicitSprings.none()))
        raise SimulationError(
            f"a step of {step_s:.6g} s leaves nothing for explicit springs: give {most:.6g} s or less", place="step_s"
        )
    if rate > limit:
        raise SimulationError(
            f"the explicit springs are {rate / limit:.3g} times as stiff as a step of {step_s:.6g} s allows: give less "
            "stiffness, spread it over more nodes, or give a smaller step",
            place="stiffness_n_m",
        )
    return replace(model, explicit=explicit)


def _fits(values: npt.ArrayLike, count: int) -> bool:
    """Whether it is one number or one for each."""
    return np.shape(values) in ((), (1,), (count,))


def _problems(model: LatticeModel, pairs: Integer) -> list[Problem]:
    is_whole = np.issubdtype(pairs.dtype, np.integer)
    if not is_whole or not ((pairs >= 0) & (pairs < model.node_count)).all():
        return [Problem("nodes", f"every node must be a whole number from 0 to {model.node_count - 1}")]
    if (pairs[:, 0] == pairs[:, 1]).any():
        return [Problem("nodes", "a spring must join two different nodes")]
    return []
