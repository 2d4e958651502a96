"""Rows of stitches: filled in between chosen ones, and running threads that slip until one tension is in all of them.

A thread that runs through the tissue without friction has one tension all along. While it is drawn with a tension every
stitch pulls with that. Once its length is held, that length is shared out among its stitches anew after every row of
steps, so that all pull alike: of all ways to share a length out this has the least energy, so slipping never adds any.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise

import numpy as np
import numpy.typing as npt

from heartcase.schemas.arrays import Float64
from heartcase.schemas.errors import SimulationError
from heartcase.simulator.lattice.model import LatticeModel
from heartcase.simulator.lattice.tethers import NO_LIMIT, Tethers
from heartcase.simulator.suturing.places import Place
from heartcase.simulator.suturing.stitches import Stitch

__all__ = ["CROSSINGS_MAX", "filled_in", "rest_point", "running_pairs", "running_threads", "shared_lengths", "slip"]

CROSSINGS_MAX = 500
"""Stitches of a row at most."""


def rest_point(place: Place, uncut: LatticeModel) -> Float64:
    """Where a place lies at rest [cells, frame of the nodes], shape (3,)."""
    point: Float64 = uncut.cells[place.cell].astype(np.float64) + np.array(place.local)
    return point


def filled_in(chosen: npt.ArrayLike, spacing: float, *, name: str = "row") -> tuple[Float64, list[bool]]:
    """Both points of every stitch of a row, evenly between chosen ones.

    Between two of them, each side is divided into equal parts along the straight line; there are as many as bring the
    mean of both sides' parts nearest to the spacing.

    Parameters
    ----------
    chosen
        Both points of each chosen stitch in their order along the row, shape (chosen_count, 2, 3).
    spacing
        Distance between neighbouring stitches, in the unit of the points.
    name
        Name in messages.

    Returns
    -------
    points
        Shape (stitch_count, 2, 3).
    is_chosen
        Which of them were given.

    Raises
    ------
    SimulationError
        Fewer than two were chosen, or it would be more than CROSSINGS_MAX.
    """
    ends = np.asarray(chosen, dtype=np.float64)
    if len(ends) < 2:
        raise SimulationError("a row lies between two chosen stitches at least", place=name)
    ways = np.linalg.norm(np.diff(ends, axis=0), axis=2).mean(axis=1)
    parts = np.maximum(np.round(ways / spacing), 1).astype(np.int64)
    if parts.sum() + 1 > CROSSINGS_MAX:
        raise SimulationError(
            f"this row would have {int(parts.sum()) + 1:,} stitches; {CROSSINGS_MAX} are the most: space them wider",
            place=name,
        )
    points, is_chosen = [ends[0]], [True]
    for start, end, count in zip(ends[:-1], ends[1:], parts.tolist(), strict=True):
        points += [start + number / count * (end - start) for number in range(1, count)]
        points.append(end)
        is_chosen += [False] * (count - 1) + [True]
    return np.array(points), is_chosen


def running_pairs(crossings: Sequence[tuple[Place, Place]]) -> list[tuple[Place, Place]]:
    """Pairs of places of a running thread that come between its crossings: from each to the next one's first place."""
    return [(one[1], other[0]) for one, other in pairwise(crossings)]


def shared_lengths(distances: npt.ArrayLike, stiffness: npt.ArrayLike, length: float) -> Float64:
    """Lengths at which stitches of one thread pull alike, shape (count,); they add up to its length.

    With the one tension T each is |d| - T/k, and none below zero: a stitch whose places are nearer than that pulls with
    k |d| alone. Of a slack thread each has its share of the slack.

    Parameters
    ----------
    distances
        How far the places of each are apart [cells], shape (count,).
    stiffness
        Of each [k], shape (count,).
    length
        Length of all of the thread [cells].
    """
    apart, k = np.asarray(distances, dtype=np.float64), np.asarray(stiffness, dtype=np.float64)
    slack = length - apart.sum()
    if slack >= 0.0:
        return np.asarray(apart + slack / len(apart))
    # Sorted by the tension at which each has no length left; below that, the lengths fall evenly with the tension.
    order = np.argsort(k * apart, kind="stable")
    tension = 0.0
    for number in range(len(order)):
        left = order[number:]
        tension = (apart[left].sum() - length) / (1.0 / k[left]).sum()
        if tension <= k[order[number]] * apart[order[number]]:
            break
    return np.maximum(apart - tension / k, 0.0)


def running_threads(stitches: Sequence[Stitch]) -> list[list[Stitch]]:
    """The stitches of each running thread, in their order."""
    threads: dict[str, list[Stitch]] = {}
    for stitch in stitches:
        if stitch.is_running:
            threads.setdefault(stitch.row, []).append(stitch)
    return list(threads.values())


def slip(thread: Sequence[Stitch], tethers: Tethers, displacement: npt.ArrayLike) -> None:
    """Share out the length of a running thread, where it is held by its length; what it is drawn to goes along.

    Parameters
    ----------
    thread
        Its stitches.
    tethers
        The same as the engines take them.
    displacement
        Displacement of the nodes [cells], shape (node_count, 3).
    """
    if any(stitch.tension_most != NO_LIMIT for stitch in thread):
        return
    apart = np.linalg.norm(tethers.vectors(displacement), axis=1)
    for now, target in (("length", False), ("length_target", True)):
        length = sum(float(getattr(stitch, now)) for stitch in thread)
        if target and length == sum(stitch.length for stitch in thread):
            for stitch in thread:
                stitch.length_target = stitch.length
            return
        shared = shared_lengths(apart, tethers.stiffness, length)
        for stitch, own in zip(thread, shared.tolist(), strict=True):
            setattr(stitch, now, float(np.float32(own)))
