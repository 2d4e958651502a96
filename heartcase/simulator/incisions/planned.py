"""A planned incision on a case: the blade's way along its line, the hands at its lips, and the lips as they are now."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
import numpy.typing as npt

from heartcase.schemas.arrays import Float64
from heartcase.schemas.errors import Problem, SimulationError
from heartcase.schemas.landmarks import Landmark
from heartcase.schemas.scripts.incision_plans import LipHands, PlannedCut
from heartcase.schemas.scripts.script import GrabAction, Waypoint
from heartcase.schemas.scripts.tool_actions import RetractorAction
from heartcase.simulator.incisions.segments import touches
from heartcase.simulator.incisions.triangle_tree import TriangleTree

__all__ = ["DrawnLine", "blade_poses", "drawn_line", "lip_hands", "lip_retractors", "lips", "problems_of_cut"]

_FAR_MM = 400.0
_OUTSIDE_MM = 3.0
_PAST_CELLS = 2.0
"""So far a blade goes past the wall on either side: cells around a node of the wall's last ones reach there."""
_NEAR_MM = 4.0
"""Vertices of one side that are no farther than this from the nearest one say which way the surface faces."""


@dataclass(frozen=True)
class DrawnLine:
    """A line along the outside of the tissue at rest."""

    points_mm: Float64
    """Its points, LPS mm, shape (count, 3)."""
    outward: Float64
    """Out of the tissue, unit length, shape (count, 3)."""
    across: Float64
    """Along the surface, at right angles to the line, unit length, shape (count, 3)."""

    @property
    def places_mm(self) -> Float64:
        """Length along the line up to each point, mm, shape (count,)."""
        steps = np.linalg.norm(np.diff(self.points_mm, axis=0), axis=1)
        return np.concatenate([[0.0], np.cumsum(steps)])

    @property
    def length_mm(self) -> float:
        """Its length, mm."""
        return float(self.places_mm[-1])

    def at(self, part: float) -> tuple[Float64, Float64, Float64]:
        """Point, outward and across at a part of the length [1], each shape (3,)."""
        place = part * self.length_mm
        point, outward, across = (
            np.array([np.interp(place, self.places_mm, values[:, axis]) for axis in range(3)])
            for values in (self.points_mm, self.outward, self.across)
        )
        return point, outward / np.linalg.norm(outward), across / np.linalg.norm(across)


def problems_of_cut(cut: PlannedCut, landmarks: tuple[Landmark, ...], place: str) -> list[Problem]:
    """What is wrong with a cut on a case."""
    if cut.landmark is None:
        return []
    found = _named(landmarks, cut.landmark)
    lines = ", ".join(one.name for one in landmarks if one.kind == "polyline" and not one.is_vessel) or "none"
    if found is None:
        message = f"the case has no landmark {cut.landmark!r}; its planned incisions: {lines}"
        return [Problem(f"{place}.landmark", message)]
    if found.kind != "polyline" or found.is_vessel:
        return [Problem(f"{place}.landmark", f"{found.name} is no planned incision; the case's: {lines}")]
    if found.depth_mm is None and cut.depth_mm is None:
        return [Problem(f"{place}.depth_mm", f"{found.name} says no depth: give one")]
    return []


def drawn_line(
    cut: PlannedCut, landmarks: tuple[Landmark, ...], tree: TriangleTree, rest_mm: npt.ArrayLike, normals: npt.ArrayLike
) -> DrawnLine | None:
    """The line of a cut on the tissue at rest; None where the blade's way is given instead.

    Which way the surface faces is the mean of the vertices around each point, and of its neighbours along the line. On
    a thin wall they may be those of its inside: out is where fewer of the points see tissue.

    Parameters
    ----------
    cut
        The cut; :func:`problems_of_cut` finds nothing wrong with it.
    landmarks
        Landmarks of the case.
    tree
        The tissue's surface at rest.
    rest_mm, normals
        Its vertices, mm, and their unit normals, shape (vertex_count, 3).

    Raises
    ------
    SimulationError
        Points of the line follow each other without a distance.
    """
    if cut.poses_mm is not None:
        return None
    given = cut.curve_mm if cut.landmark is None else _found(landmarks, cut.landmark).points_mm
    points = np.asarray(given, dtype=float)
    if (np.linalg.norm(np.diff(points, axis=0), axis=1) <= 0.0).any():
        raise SimulationError("two points of the line that follow each other are the same", place=cut.name)
    facing = np.stack([_facing(point, np.asarray(rest_mm, float), np.asarray(normals, float)) for point in points])
    # The sides of a wall are told apart by their neighbours along the line first.
    for number in range(1, len(facing)):
        if facing[number] @ facing[number - 1] < 0.0:
            facing[number] *= -1.0
    padded = np.concatenate([facing[:1], facing, facing[-1:]])
    outward = _unit(padded[:-2] + padded[1:-1] + padded[2:])
    ahead, behind = (
        touches(tree, points + sign * outward, points + sign * _FAR_MM * outward).sum() for sign in (1.0, -1.0)
    )
    if ahead > behind:
        outward = -outward
    along = _unit(np.gradient(points, axis=0))
    across = _unit(np.cross(outward, along))
    return DrawnLine(points, outward, across)


def blade_poses(
    cut: PlannedCut, line: DrawnLine | None, landmarks: tuple[Landmark, ...], *, cell_mm: float
) -> tuple[tuple[tuple[float, float, float], ...], ...]:
    """Points of the blade's edge at each pose, LPS mm at rest: outside and inside the tissue at each point of the line.

    Parameters
    ----------
    cut
        The cut.
    line
        Its line, None where it has none.
    landmarks
        Landmarks of the case.
    cell_mm
        Edge of a cell, mm.
    """
    if line is None:
        assert cut.poses_mm is not None
        return cut.poses_mm
    depth = cut.depth_mm
    if depth is None and cut.landmark is not None:
        depth = _found(landmarks, cut.landmark).depth_mm
    assert depth is not None
    outside = max(_OUTSIDE_MM, _PAST_CELLS * cell_mm) if cut.outside_mm is None else cut.outside_mm
    inside = depth + (_PAST_CELLS * cell_mm if cut.deeper_mm is None else cut.deeper_mm)
    ends = [line.points_mm + outside * line.outward, line.points_mm - inside * line.outward]
    poses = np.stack(ends, axis=1).tolist()
    return tuple(tuple((x, y, z) for x, y, z in pose) for pose in poses)


def lip_hands(
    hands: LipHands, line: DrawnLine, rest_mm: npt.ArrayLike, *, cell_mm: float, open_s: float
) -> tuple[GrabAction, ...]:
    """Hands on both lips of a line, which lead them apart.

    Parameters
    ----------
    hands
        How many, how far and how large.
    line
        The incision's line.
    rest_mm
        Vertices of the surface at rest, mm, shape (vertex_count, 3): a hand closes around the nearest one of its side.
    cell_mm
        Edge of a cell, mm.
    open_s
        Time that it takes, s.
    """
    radius = hands.radius_mm or max(0.2 * line.length_mm, 1.5 * cell_mm)
    distance = hands.distance_mm or radius
    made = []
    for side, words in ((1.0, "one lip"), (-1.0, "other lip")):
        for number in range(hands.hands_per_lip):
            point, outward, across = line.at((number + 1) / (hands.hands_per_lip + 1))
            wanted = point + side * distance * across
            held = _nearest(np.asarray(rest_mm, dtype=float), wanted, point, side * across)
            made.append(
                GrabAction(
                    name=_hand_name(hands, words, number),
                    position_mm=_point(held),
                    radius_mm=radius,
                    path=(Waypoint(time_s=open_s, offset_mm=_way(hands, line, outward, side * across)),),
                )
            )
    return tuple(made)


def lip_retractors(
    hands: LipHands, line: DrawnLine, sides: tuple[Float64, Float64], *, cell_mm: float, open_s: float
) -> tuple[RetractorAction, ...]:
    """Retractors along both lips of a line that was cut, which lead them apart.

    Parameters
    ----------
    hands
        How many, how far and how deep.
    line
        The incision's line.
    sides
        Where both lips are now: :func:`lips`.
    cell_mm
        Edge of a cell, mm.
    open_s
        Time that it takes, s.
    """
    made = []
    for side, lip, words in ((1.0, sides[0], "one lip"), (-1.0, sides[1], "other lip")):
        edges = 0.5 + hands.part * (np.arange(hands.hands_per_lip + 1) / hands.hands_per_lip - 0.5)
        for number, (start, end) in enumerate(pairwise(edges.tolist())):
            _, outward, across = line.at(0.5 * (start + end))
            inner = (line.places_mm > start * line.length_mm) & (line.places_mm < end * line.length_mm)
            places = [start * line.length_mm, *line.places_mm[inner], end * line.length_mm]
            along = np.stack([np.interp(places, line.places_mm, lip[:, axis]) for axis in range(3)], axis=1)
            pads = {} if hands.stiffness_n_mm2 is None else {"stiffness_n_mm2": hands.stiffness_n_mm2}
            made.append(
                RetractorAction(
                    **pads,
                    name=_hand_name(hands, words, number),
                    line_mm=tuple(_point(point) for point in along),
                    side=_point(side * across),
                    depth_mm=hands.depth_mm or 1.5 * cell_mm,
                    path=(Waypoint(time_s=open_s, offset_mm=_way(hands, line, outward, side * across)),),
                )
            )
    return tuple(made)


def _way(hands: LipHands, line: DrawnLine, outward: Float64, apart: Float64) -> tuple[float, float, float]:
    """How far a lip is led, mm."""
    spread = hands.spread_mm or 0.25 * line.length_mm
    lift = 0.2 * line.length_mm if hands.lift_mm is None else hands.lift_mm
    return _point(spread * apart + lift * outward)


def _hand_name(hands: LipHands, words: str, number: int) -> str:
    return words if hands.hands_per_lip == 1 else f"{words} {number + 1}"


def lips(line: DrawnLine, rest_mm: npt.ArrayLike, now_mm: npt.ArrayLike) -> tuple[Float64, Float64]:
    """Where both lips of a cut along a line are now: each point goes the way of the nearest vertex of its side.

    Parameters
    ----------
    line
        The line.
    rest_mm, now_mm
        Vertices of the surface before it was cut, at rest and now, mm, shape (vertex_count, 3): without those of the
        lips, which are of both sides at rest.
    """
    rest, now = np.asarray(rest_mm, dtype=float), np.asarray(now_mm, dtype=float)
    sides = []
    for side in (1.0, -1.0):
        nearest = [
            _nearest_number(rest, point, point, side * across)
            for point, across in zip(line.points_mm, line.across, strict=True)
        ]
        sides.append(line.points_mm + now[nearest] - rest[nearest])
    return sides[0], sides[1]


def _nearest_number(vertices: Float64, wanted: Float64, point: Float64, side: Float64) -> int:
    """Number of the vertex nearest to a place, of those on one side of a point."""
    distance = ((vertices - wanted) ** 2).sum(axis=1)
    distance[(vertices - point) @ side <= 0.0] = np.inf
    return int(np.argmin(distance))


def _nearest(vertices: Float64, wanted: Float64, point: Float64, side: Float64) -> Float64:
    found: Float64 = vertices[_nearest_number(vertices, wanted, point, side)]
    return found


def _facing(point: Float64, rest: Float64, normals: Float64) -> Float64:
    """Mean normal around a point, of the side of the wall that the nearest vertex is of."""
    distance = np.linalg.norm(rest - point, axis=1)
    nearest = int(np.argmin(distance))
    near = (distance <= distance[nearest] + _NEAR_MM) & (normals @ normals[nearest] > 0.5)
    facing: Float64 = _unit(normals[near].mean(axis=0)[None])[0]
    return facing


def _unit(vectors: Float64) -> Float64:
    unit: Float64 = vectors / np.maximum(np.linalg.norm(vectors, axis=1, keepdims=True), 1e-12)
    return unit


def _named(landmarks: tuple[Landmark, ...], name: str) -> Landmark | None:
    return next((one for one in landmarks if one.name.lower() == name.lower()), None)


def _found(landmarks: tuple[Landmark, ...], name: str) -> Landmark:
    found = _named(landmarks, name)
    assert found is not None
    return found


def _point(values: Float64) -> tuple[float, float, float]:
    x, y, z = values.tolist()
    return x, y, z
