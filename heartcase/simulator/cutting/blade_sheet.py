"""The sheet that a blade sweeps, at rest: triangles with whole-number corners, so that no question about it is open.

A cut is decided in rest space. There the tissue is sampled at SAMPLES points along each edge of a cell, and what the
sheet does is one list for each axis: the links between two neighbouring samples that it crosses. A sample that lies on
the sheet counts as moved by less than any number, first along y, then z, then x (simulation of simplicity: Edelsbrunner
and Muecke, ACM Trans. Graph. 9, 1990): every link is crossed or not, and a closed sheet parts inside from outside.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any, cast

import numpy as np
import numpy.typing as npt

from heartcase.schemas.arrays import Float64, Int64
from heartcase.schemas.base import Vector3
from heartcase.schemas.bundle.lattice import lattice_keys
from heartcase.schemas.errors import Problem, SimulationError
from heartcase.simulator.cutting.bit_masks.touched import begun_among, places_of_links, samples_of_places
from heartcase.simulator.cutting.crossings import QUANTA, SAMPLES, crossing_keys
from heartcase.simulator.cutting.sheet_kernels import refine, step_lengths, strips_beyond, triangles_of
from heartcase.simulator.lattice.model import LatticeModel

__all__ = ["Links", "Poses", "Sheet", "blade_points", "checked_poses", "crossed_links", "key_indices", "touched_places"]

Links = tuple[Int64, Int64, Int64]
"""Keys of links along x, y and z."""
Poses = npt.ArrayLike | Sequence[Sequence[Vector3 | None]]
"""Points of a blade at each pose, shape (pose_count, point_count, 3); at rest, None or NaN where it met no tissue."""

_BEYOND = 2.0
"""How far a sheet is continued [cells]: through any cell that it ends in."""
_FURTHEST = 2.0**16
"""How far from the origin a point may lie [cells]."""
_FINE = 0.75
"""Longest step between points of a swept sheet, along the blade and from pose to pose [cells]; cut faces bend there."""
_FAR = 256.0
"""Where a step is longer [cells], it is divided as if it were so long."""
_LONGEST = 128
"""Extent of a triangle along any axis [cells], so that products of three differences fit into 64 bits."""
_ANYWHERE: tuple[Int64, Int64] = (np.full(3, -(1 << 60)), np.full(3, 1 << 60))
_NOWHERE = (np.nan, np.nan, np.nan)


@dataclass(frozen=True)
class Sheet:
    """Triangles of a swept blade at rest."""

    triangles: Int64
    """Corners in QUANTA to a cell, in the frame of the nodes (x, y, z along i, j, k), shape (triangle_count, 3, 3)."""
    beyond: Int64 = field(default_factory=lambda: np.zeros((0, 3, 3), np.int64))
    """The sheet's continuation beyond its edges, which tells where the cut goes in cells that it ends in, the same."""
    flat: Float64 | None = None
    """Place of each corner on the sheet laid out flat [cells], shape (triangle_count, 3, 2), where it was swept."""

    def laid_out(self) -> Float64:
        """Place of each corner on the sheet laid out flat [cells]: each triangle by itself where it was not swept."""
        if self.flat is not None:
            return self.flat
        p, q, r = np.moveaxis(self.triangles / QUANTA, 1, 0)
        along = np.linalg.norm(q - p, axis=1)
        way = np.divide(q - p, along[:, None], out=np.zeros_like(p), where=along[:, None] > 0)
        share = np.einsum("tx,tx->t", r - p, way)
        across = np.linalg.norm(r - p - share[:, None] * way, axis=1)
        nothing = np.zeros_like(along)
        flat = np.stack([nothing, nothing, along, nothing, share, across], axis=1)
        return flat.reshape(-1, 3, 2)

    @cached_property
    def links(self) -> Links:
        """Links along x, y and z that the sheet crosses, ascending."""
        return _crossed(self.triangles)

    @cached_property
    def links_beyond(self) -> Links:
        """Links that its continuation crosses in the cells that the sheet itself comes to, ascending."""
        touched = places_of_links(*self.links)
        box = samples_of_places(touched)
        found = [begun_among(touched, crossing_keys(self.beyond, axis, *box)) for axis in range(3)]
        for keys in found:
            keys.sort()
        return found[0], found[1], found[2]

    @classmethod
    def swept(cls, poses: npt.ArrayLike) -> Sheet:
        """What a polyline sweeps from pose to pose.

        Parameters
        ----------
        poses
            Points of the blade at each pose, at rest, in the frame of the nodes [cells], shape (pose_count,
            point_count, 3), at least two of each. For a line drawn on tissue: the line, and the line at its depth.
            NaN where the blade met no tissue: the sheet has a hole there.

        Raises
        ------
        SimulationError
            Too few poses or points, numbers that are not finite, or a sheet that reaches too far.
        """
        points = checked_poses(poses, "blade", may_be_open=True)
        limits = QUANTA, _FURTHEST, _LONGEST
        ways = step_lengths(points)
        places = [np.append(0.0, np.cumsum(_mean(way, axis=1 - axis))) for axis, way in enumerate(ways)]
        triangles, flat, is_near = triangles_of(refine(points, *ways, *places, _FINE, _FAR), *limits)
        parts = [triangles_of(strip, *limits) for strip in strips_beyond(points, _BEYOND)]
        if is_near and all(part[2] for part in parts):
            return cls(triangles, np.concatenate([part[0] for part in parts]), flat)
        return _swept_in_parts(points)

    @classmethod
    def of_triangles(cls, triangles: npt.ArrayLike) -> Sheet:
        """Any triangles, in the frame of the nodes [cells], shape (triangle_count, 3, 3).

        Raises
        ------
        SimulationError
            Numbers that are not finite, or a triangle that reaches too far.
        """
        corners = np.asarray(triangles, dtype=np.float64).reshape(-1, 3, 3)
        if not (np.isfinite(corners).all() and (np.abs(corners) < _FURTHEST).all()):
            raise SimulationError([Problem("blade", "every point must be three finite numbers within the lattice")])
        while len(corners) and np.ptp(corners, axis=1).max() > _LONGEST:
            corners = _quartered(corners)
        return cls(np.round(corners * QUANTA).astype(np.int64))


def crossed_links(triangles: Int64, axis: int) -> Int64:
    """Links between samples along an axis that triangles cross, as often as they do, ascending.

    Returns
    -------
    ndarray
        The key (:func:`heartcase.schemas.bundle.lattice.lattice_keys`) of each link's lower sample. Sample (i, j, k)
        lies (i + 1/2) / SAMPLES cells along x, and so on. int64, shape (count,).
    """
    links: Int64 = crossing_keys(triangles, axis, *_ANYWHERE)
    links.sort()
    return links


def _swept_in_parts(points: Float64) -> Sheet:
    """What a polyline sweeps, where triangles must be divided or are too far away; else the same."""
    Sheet.of_triangles(_triangles(points))  # refuses what is too far away
    fine, places = _refined(points)
    both = _triangles(np.concatenate([fine, places], axis=-1))
    sheet, flat = Sheet.of_triangles(both[..., :3]), both[..., 3:5]
    if len(flat) == len(sheet.triangles):
        sheet = replace(sheet, flat=flat)
    longer = np.concatenate([_continued(points[:2], 0)[:1], points, _continued(points[-2:], 0)[1:]])
    ahead = np.concatenate([_continued(longer[:, :2], 1)[:, :1], longer, _continued(longer[:, -2:], 1)[:, 1:]], axis=1)
    strips = (ahead[:2], ahead[-2:], ahead[:, :2], ahead[:, -2:])
    beyond = [Sheet.of_triangles(_triangles(strip)).triangles for strip in strips]
    return replace(sheet, beyond=np.concatenate(beyond))


def _crossed(triangles: Int64) -> Links:
    return crossed_links(triangles, 0), crossed_links(triangles, 1), crossed_links(triangles, 2)


def key_indices(keys: Int64) -> Int64:
    """Index (i, j, k) of each key, shape (count, 3)."""
    mask = (1 << 21) - 1
    return np.stack([keys & mask, keys >> 21 & mask, keys >> 42 & mask], axis=-1) - (1 << 20)


def touched_places(links: Links) -> Int64:
    """Keys of the cells' places that a crossed link begins or ends in, ascending."""
    ends = []
    for axis, keys in enumerate(links):
        lower = key_indices(keys)
        ends += [lower, lower + np.eye(3, dtype=np.int64)[axis]]
    return np.unique(lattice_keys(np.concatenate(ends) // SAMPLES))


def blade_points(model: LatticeModel, poses_mm: Poses, name: str = "blade", *, may_be_open: bool = False) -> Float64:
    """Points of a blade at each pose, LPS mm, in the frame of the nodes [cells], (pose_count, point_count, 3).

    Where it may be open, as at rest, a point that is None or NaN is NaN: the blade met no tissue there.

    Raises
    ------
    SimulationError
        Too few poses or points, numbers that are not finite, or a blade that reaches too far.
    """
    poses = checked_poses(poses_mm, name, may_be_open=may_be_open)
    points: Float64 = np.asarray(model.geometry.world_to_index(poses.reshape(-1, 3))).reshape(poses.shape) + 0.5
    if (np.abs(points) >= _FURTHEST).any():
        raise SimulationError("every point must lie within the lattice or near it", place=name)
    return points


def checked_poses(poses: Poses, name: str, *, may_be_open: bool) -> Float64:
    """Points of a blade at each pose, shape (pose_count, point_count, 3).

    Where it may be open, a point that is None or NaN is NaN: the blade met no tissue there.

    Raises
    ------
    SimulationError
        Too few poses or points, or numbers that are not finite.
    """
    problem = "a blade needs two points or more in two poses or more, shape (poses, points, 3)"
    try:
        if may_be_open and not isinstance(poses, np.ndarray):
            poses = [[_NOWHERE if point is None else point for point in pose] for pose in cast(Any, poses)]
        points = np.asarray(poses, dtype=np.float64)
    except (TypeError, ValueError):
        raise SimulationError(problem, place=name) from None
    if points.ndim != 3 or points.shape[2] != 3 or min(points.shape[:2]) < 2:
        raise SimulationError(problem, place=name)
    is_open = np.isnan(points).all(axis=2) if may_be_open else np.zeros(points.shape[:2], np.bool_)
    if not np.isfinite(points[~is_open]).all():
        raise SimulationError("every point of a blade must be three finite numbers", place=name)
    return points


def _triangles(points: Float64) -> Float64:
    """Two triangles for each four points that are neighbours and all there, shape (count, 3, any)."""
    a, b, c, d = points[:-1, :-1], points[:-1, 1:], points[1:, :-1], points[1:, 1:]
    is_whole = np.isfinite(a + b + c + d).all(axis=-1)
    return np.concatenate([np.stack(t, axis=2)[is_whole] for t in ((a, b, c), (c, b, d))])


def _refined(points: Float64) -> tuple[Float64, Float64]:
    """Points and poses at most _FINE apart, and where they are on the sheet laid out flat (third number 0)."""
    place = np.zeros_like(points)
    ways = [np.linalg.norm(np.diff(points, axis=axis), axis=-1) for axis in (0, 1)]
    # Blade and way are laid out by the means of their lengths: along a ruled sheet neither has one alone.
    place[..., 0] = np.append(0.0, np.cumsum(_mean(ways[0], axis=1)))[:, None]
    place[..., 1] = np.append(0.0, np.cumsum(_mean(ways[1], axis=0)))
    ways = [np.nan_to_num(way) for way in ways]
    both = np.concatenate([points, place], axis=-1)
    for axis, way in enumerate(ways):
        counts = np.maximum(np.ceil(np.minimum(way.max(axis=1 - axis), _FAR) / _FINE), 1).astype(int)
        parts = []
        for n, count in enumerate(counts.tolist()):
            start, stop = (np.take(both, [at], axis=axis).swapaxes(0, axis)[0] for at in (n, n + 1))
            parts.append(np.linspace(start, stop, count, endpoint=False))
        both = np.concatenate([*parts, np.take(both, [-1], axis=axis).swapaxes(0, axis)]).swapaxes(0, axis)
    return both[..., :3], both[..., 3:]


def _mean(lengths: Float64, axis: int) -> Float64:
    """Mean of the lengths that are known along an axis, 0 where none is."""
    if not np.isnan(lengths).any():
        mean: Float64 = lengths.mean(axis=axis)
        return mean
    is_known = np.isfinite(lengths)
    total: Float64 = np.where(is_known, lengths, 0.0).sum(axis=axis) / np.maximum(is_known.sum(axis=axis), 1)
    return total


def _continued(pair: Float64, axis: int) -> Float64:
    """Two rows of points, moved apart along the lines through both by _BEYOND."""
    first, second = np.moveaxis(pair, axis, 0)
    way = second - first
    length = np.linalg.norm(way, axis=-1, keepdims=True)
    # What ends beside a hole is not continued there.
    step = np.divide(way, length, out=np.where(np.isnan(way), np.nan, 0.0), where=length > 0) * _BEYOND
    return np.stack([first - step, second + step], axis=axis)


def _quartered(corners: Float64) -> Float64:
    a, b, c = np.moveaxis(corners, 1, 0)
    ab, bc, ca = (a + b) / 2, (b + c) / 2, (c + a) / 2
    return np.concatenate([np.stack(t, axis=1) for t in ((a, ab, ca), (ab, b, bc), (ca, bc, c), (ab, bc, ca))])
