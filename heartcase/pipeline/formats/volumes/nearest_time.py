"""Choosing the time of a scan that is nearest to a given one."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from heartcase.pipeline.warnings import CaseWarning
from heartcase.schemas.errors import ScanError

__all__ = ["listed_times", "nearest_time"]

TIMES_SHOWN = 40
"""How many times an error lists."""
SINGLE_TIME_PART = 0.05
"""Part of a time by which a given one may differ from the only one that is stated; see SINGLE_TIME_FLOOR_MS."""
SINGLE_TIME_FLOOR_MS = {"trigger": 5.0, "echo": 0.05}
"""What a given time may differ from the only one that is stated in any case, ms."""
FAR_MS = 50.0
"""A heart moves little in this time: a trigger time that is farther off than this is told."""
TIE_MS = 1e-6
"""Times that differ by less are the same: rounded digits."""


def nearest_time(times: Sequence[float | None], wanted: float, what: str, notes: list[CaseWarning]) -> float:
    """The time that is meant.

    Parameters
    ----------
    times
        Those that are stated, ms; None for what states none.
    wanted
        The given one, ms. It may be off by half the median step between those that are stated; where one is, by 5% of
        it, or by 5 ms (trigger time) or 0.05 ms (echo time) where that is more.
    what
        ``trigger`` or ``echo``.
    notes
        Gets a line where two are as near: then the earlier is taken; and where the trigger time is far off.

    Raises
    ------
    ScanError
        None is stated, or none is near: it lists what there is.
    """
    stated = sorted({time for time in times if time is not None})
    option, key = f"--{what}-time", f"{what}_time_ms"
    if not stated:
        raise ScanError(
            f"no image states its {what} time: leave {option} out ({key} in the recipe's [scan]), and choose with "
            "--series, or series there"
        )
    nearest = min(stated, key=lambda time: (abs(time - wanted), time))
    reach = float(np.median(np.diff(stated))) / 2.0 if len(stated) > 1 else SINGLE_TIME_PART * stated[0]
    if len(stated) == 1:
        reach = max(reach, SINGLE_TIME_FLOOR_MS[what])
    if abs(nearest - wanted) > reach + TIE_MS:
        there = f"they are {listed_times(stated)} ms" if len(stated) > 1 else f"the only one is {stated[0]:g} ms"
        remedy = "choose one of them with" if len(stated) > 1 else "give this one, or none, with"
        raise ScanError(
            f"no {what} time is near {wanted:g} ms, {there}: {remedy} {option} MS, or {key} in the recipe's [scan]"
        )
    if what == "trigger" and abs(nearest - wanted) > FAR_MS:
        notes.append(
            CaseWarning(
                f"the given trigger time is {wanted:g} ms, and the nearest one that can be taken, {nearest:g} ms, "
                "shows the heart at another moment"
            )
        )
    as_near = [time for time in stated if abs(abs(time - wanted) - abs(nearest - wanted)) <= TIE_MS]
    if len(as_near) > 1:
        notes.append(
            CaseWarning(
                f"the {what} times {as_near[0]:g} and {as_near[-1]:g} ms are as near to the given {wanted:g} ms: the "
                "earlier one was taken"
            )
        )
    return as_near[0]


def listed_times(times: Sequence[float]) -> str:
    """Times as an error lists them."""
    shown = ", ".join(f"{time:g}" for time in times[:TIMES_SHOWN])
    return shown + (f" ... {times[-1]:g}" if len(times) > TIMES_SHOWN else "")
