"""Forceps, retractors and scissors of a stored moment, as arrays and back."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import numpy.typing as npt

from heartcase.simulator.instruments.forceps import Forceps
from heartcase.simulator.instruments.grab import Grab
from heartcase.simulator.instruments.retractor import Retractor
from heartcase.simulator.instruments.scissors import Scissors
from heartcase.simulator.instruments.wrench import Instrument

__all__ = ["holding_from", "kind_of", "scissors_from", "tool_arrays"]

Taken = Callable[..., npt.NDArray[Any]]
"""Gives an array of an instrument by its name, type and shape; ValueError where it is another, KeyError for none."""


def kind_of(instrument: Instrument) -> str:
    """The word for an instrument's kind."""
    if isinstance(instrument, Forceps):
        return "forceps"
    if isinstance(instrument, Retractor):
        return "retractor"
    if isinstance(instrument, Scissors):
        return "scissors"
    return "grab" if isinstance(instrument, Grab) else "probe"


def tool_arrays(instrument: Instrument) -> dict[str, npt.NDArray[Any]]:
    """What forceps, retractors and scissors have beside what a grab has; nothing of others."""
    if isinstance(instrument, Forceps):
        jaws = [*instrument.axis, *instrument.span, instrument.gap, instrument.gap_target]
        return {"roots": instrument.roots.astype(float), "jaws": np.array(jaws, dtype=float)}
    if isinstance(instrument, Retractor):
        numbers = [
            instrument.length,
            instrument.stiffness,
            instrument.limit,
            *instrument.resistance,
            instrument.settle,
            instrument.row_share,
        ]
        return {
            "roots": instrument.roots.astype(float),
            "along": instrument.along.astype(float),
            "give": instrument.give.astype(float),
            "pads": np.array(numbers, dtype=float),
        }
    if isinstance(instrument, Scissors):
        numbers = [instrument.length, instrument.opening, instrument.angle]
        return {"place": np.vstack([instrument.hinge, instrument.axes, numbers]).astype(float)}
    return {}


def scissors_from(of: Taken, name: str) -> Scissors:
    """Scissors from their arrays.

    Raises
    ------
    ValueError, KeyError
        The arrays are not theirs.
    """
    rows = of("place", np.float64, 5, 3)
    length, opening, angle = rows[4].tolist()
    return Scissors(rows[0], rows[1:4], length, opening, angle, name)


def holding_from(kind: str, of: Taken, count: int, **held: Any) -> Grab:
    """A hand, forceps or a retractor from its arrays and what it shares with a grab.

    Raises
    ------
    ValueError, KeyError
        The arrays are not theirs, or there is no such kind.
    """
    if kind == "forceps":
        jaws = of("jaws", np.float64, 7)
        low, high, gap, gap_target = jaws[3:].tolist()
        roots = of("roots", np.float64, count, 3)
        return Forceps(**held, axis=jaws[:3], roots=roots, span=(low, high), gap=gap, gap_target=gap_target)
    if kind == "retractor":
        length, stiffness, limit, together, alone, settle, row_share = of("pads", np.float64, 7).tolist()
        return Retractor(
            **held,
            roots=of("roots", np.float64, count, 3),
            along=of("along", np.float64, count),
            length=length,
            stiffness=stiffness,
            limit=limit,
            resistance=(together, alone),
            settle=settle,
            give=of("give", np.float64, count, 3),
            row_share=row_share,
        )
    if kind != "grab":
        raise ValueError(kind)
    return Grab(**held)
