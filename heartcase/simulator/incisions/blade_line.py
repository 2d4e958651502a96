"""The incision that a blade left, from its way alone: its line on the tissue, and the defects that lie behind it."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from heartcase.schemas.arrays import Bool, Float64
from heartcase.schemas.errors import Problem, SimulationError
from heartcase.schemas.landmarks import Landmark
from heartcase.schemas.scripts.incision_plans import PlannedCut
from heartcase.simulator.incisions.held_open import Incision, ShownHeart
from heartcase.simulator.incisions.planned import DrawnLine, drawn_line
from heartcase.simulator.incisions.rim import defect_rim
from heartcase.simulator.incisions.segments import touches

__all__ = ["incision_of_blade", "line_of_blade", "planned_line"]

_ON_MM = 1e-6
"""How far a landmark's points may be from a blade that was led along it, mm."""
_HALVINGS = 20
_APART_MM = 0.01
"""Points of a line that are nearer to one another are one, mm."""


def incision_of_blade(
    name: str, poses_mm: npt.ArrayLike, whole: ShownHeart, landmarks: Sequence[Landmark]
) -> tuple[Incision, list[Problem]]:
    """What a blade cut, as an incision that is looked through; and the defects of which no rim was found, with why.

    Parameters
    ----------
    name
        The blade's name: the incision's too, where it is not along a planned one.
    poses_mm
        Points of its edge at each pose at rest, LPS mm, shape (pose_count, point_count, 3).
    whole
        The surface before anything was cut, at rest.
    landmarks
        Landmarks of the case: planned incisions, and rings, which are its defects.
    """
    poses = np.asarray(poses_mm, dtype=float)
    planned = planned_line(poses, whole, landmarks)
    name, line = planned or (name, line_of_blade(poses, whole))
    entry = poses.mean(axis=(0, 1)) if line is None else line.at(0.5)[0]
    rims, problems = [], []
    for landmark in landmarks:
        if landmark.kind == "ring":
            try:
                rims.append(defect_rim(whole.tree, landmark, entry))
            except SimulationError as error:
                problems += [Problem(landmark.name, problem.message) for problem in error.problems]
    curve = poses[:, -1] if line is None else line.points_mm
    return Incision(name, curve, line, entry, tuple(rims), len(whole.rest_mm)), problems


def planned_line(poses: Float64, whole: ShownHeart, landmarks: Sequence[Landmark]) -> tuple[str, DrawnLine] | None:
    """Name and line of the planned incision along which a blade was led, pose by pose; None where it was not.

    Parameters
    ----------
    poses, whole, landmarks
        As of :func:`incision_of_blade`.
    """
    for one in landmarks:
        points = np.asarray(one.points_mm, dtype=float)
        if one.kind != "polyline" or one.is_vessel or len(points) != len(poses):
            continue
        start, way = poses[:, 0], poses[:, -1] - poses[:, 0]
        along = ((points - start) * way).sum(axis=1) / np.maximum((way**2).sum(axis=1), 1e-12)
        off = np.linalg.norm(start + along[:, None] * way - points, axis=1)
        if (off < _ON_MM).all() and (along > 0.0).all() and (along < 1.0).all():
            cut = PlannedCut(name=one.name, landmark=one.name)
            line = drawn_line(cut, tuple(landmarks), whole.tree, whole.rest_mm, whole.normals)
            assert line is not None
            return one.name, line
    return None


def line_of_blade(poses: Float64, whole: ShownHeart) -> DrawnLine | None:
    """Where a blade met the outside of the tissue; None where it has no such line.

    A blade stands across its line and is led along it, or lies along it and is led into the tissue: of both the one
    along which it met the more tissue.

    Parameters
    ----------
    poses, whole
        As of :func:`incision_of_blade`.
    """
    lines = [one for stabs in (poses, poses.swapaxes(0, 1)) if (one := _line_of_stabs(stabs, whole)) is not None]
    return max(lines, key=lambda one: one.length_mm, default=None)


def _line_of_stabs(stabs: Float64, whole: ShownHeart) -> DrawnLine | None:
    """The line of stabs beside one another, each from outside into the tissue, shape (stab_count, point_count, 3)."""
    starts, ends = stabs[:, 0], stabs[:, -1]
    length = np.linalg.norm(ends - starts, axis=1)
    meets = touches(whole.tree, starts, ends) & (length > 0.0)
    first, last = _longest_run(meets)
    if last - first < 2:
        return None
    starts, ends, length = starts[first:last], ends[first:last], length[first:last]
    free, hit = np.zeros(len(starts)), np.ones(len(starts))
    for _ in range(_HALVINGS):
        half = 0.5 * (free + hit)
        is_hit = touches(whole.tree, starts, starts + half[:, None] * (ends - starts))
        free, hit = np.where(is_hit, free, half), np.where(is_hit, half, hit)
    points = starts + hit[:, None] * (ends - starts)
    kept = [0]
    for number in range(1, len(points)):
        if np.linalg.norm(points[number] - points[kept[-1]]) > _APART_MM:
            kept.append(number)
    if len(kept) < 2:
        return None
    points = points[kept]
    outward = ((starts - ends) / length[:, None])[kept]
    across = np.cross(outward, np.gradient(points, axis=0))
    size = np.linalg.norm(across, axis=1, keepdims=True)
    # led along its own edge it leaves no line
    return None if (size <= 0.0).any() else DrawnLine(points, outward, across / size)


def _longest_run(values: Bool) -> tuple[int, int]:
    """Start and end + 1 of the longest run of what is true."""
    edges = np.flatnonzero(np.diff(np.concatenate([[0], values.astype(np.int8), [0]])))
    if not len(edges):
        return 0, 0
    runs = edges.reshape(-1, 2)
    first, last = runs[int(np.argmax(runs[:, 1] - runs[:, 0]))].tolist()
    return first, last
