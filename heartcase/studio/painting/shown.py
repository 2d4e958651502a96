"""What a page was sent of labels that are worked out bit by bit: the slices that it shows first, the rest later."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from heartcase.pipeline.markers.session import SegmentationSession
from heartcase.pipeline.watershed.boxes import Box
from heartcase.pipeline.watershed.painting import TILE
from heartcase.pipeline.watershed.sight import Sight
from heartcase.schemas.arrays import Bool, Float64, Int64
from heartcase.schemas.geometry import Geometry
from heartcase.studio.messages import boxes_message
from heartcase.studio.painting.requests import SeenPlane

__all__ = ["Plane", "Shown", "planes_in_voxels"]

SETTLED_AT_ONCE = 48
"""Tiles that are worked out and sent for one request, at most."""
_GROUP = 4
"""Tiles that are worked out together."""
_LONG_S = 0.003
"""With a request for the rest no more is begun after so long: a stroke may be waiting."""


@dataclass(frozen=True)
class Plane:
    """Where normal @ voxel == offset, for voxel indices (i, j, k)."""

    normal: Float64
    """Shape (3,)."""
    offset: float

    def is_same(self, other: Plane) -> bool:
        """Whether both show the same."""
        return self.offset == other.offset and bool((self.normal == other.normal).all())


def planes_in_voxels(planes: Sequence[SeenPlane], geometry: Geometry) -> tuple[Plane, ...]:
    """Planes of patient positions as planes of voxel indices.

    Parameters
    ----------
    planes
        A point and a normal each, LPS mm.
    geometry
        The scan's lattice.
    """
    found = []
    for plane in planes:
        normal = geometry.affine[:3, :3].T @ np.array(plane.normal)
        through = geometry.world_to_index(np.array([plane.point_mm]))[0]
        found.append(Plane(normal, float(normal @ through)))
    return tuple(found)


@dataclass
class _View:
    """A plane that a page looks at."""

    plane: Plane
    sight: Sight
    """What it shows."""
    sent: Int64
    """Stamp of each tile when that was sent last; 0 for never."""
    settled: int = -1
    """How often labels had been put off when what it shows was worked out last."""


class Shown:
    """What one page looks at, and what it has still to be sent.

    It has all labels of this moment, none of them put off, and no flat is being divided.

    Parameters
    ----------
    session
        What is painted on.
    """

    def __init__(self, session: SegmentationSession) -> None:
        self._session = session
        self._views: tuple[_View, ...] = ()
        self._unsent = np.zeros_like(session.put_off_tiles)
        # what a tile holds is what the page has, unless its stamp is a later one
        self._sent = session.tile_stamps
        self._seen_at = time.perf_counter()

    @property
    def has_rest(self) -> bool:
        """Whether labels may differ from what the page was sent, off the planes that it looks at."""
        # somebody else may have had them worked out
        self._unsent |= self._session.tile_stamps > self._sent
        return bool(self._unsent.any())

    @property
    def seconds_since_seen(self) -> float:
        """Seconds since :meth:`in_sight` was asked last."""
        return time.perf_counter() - self._seen_at

    def look(self, planes: tuple[Plane, ...]) -> None:
        """The page looks at these planes from now on."""
        known = {n: view for n, plane in enumerate(planes) for view in self._views if view.plane.is_same(plane)}
        self._views = tuple(known[n] if n in known else self._view(plane) for n, plane in enumerate(planes))

    def _view(self, plane: Plane) -> _View:
        return _View(plane, self._session.in_sight(plane.normal, plane.offset), np.zeros_like(self._sent))

    def note(self, tiles: Bool) -> None:
        """Labels in these tiles may have changed."""
        self._unsent |= tiles

    def in_sight(self) -> tuple[bytes, ...]:
        """What the planes show of tiles in which labels are others than those that were sent."""
        self._seen_at = time.perf_counter()
        if not self.has_rest:
            return ()
        session = self._session
        boxes: list[Box] = []
        for view in self._views:
            # other changes were written to all labels, and sent to all pages
            if view.settled != session.put_off_times:
                session.settle_sight(view.sight)
                view.settled = session.put_off_times
            stamps = session.tile_stamps
            fresh = view.sight.tiles & (stamps > np.maximum(self._sent, view.sent))
            view.sent[fresh] = stamps[fresh]
            boxes += _boxes_of(view.sight, fresh)
        # off the planes a box may hold labels of before: so has the page, and its tile is not sent yet
        return (boxes_message(boxes, session.labels_so_far(boxes)),) if boxes else ()

    def rest(self) -> tuple[bytes, ...]:
        """Some of what was not sent yet, the nearest to the planes first."""
        session = self._session
        if not self.has_rest:
            return ()
        tiles = np.argwhere(self._unsent)
        away = np.full(self._unsent.shape, np.inf)
        for view in self._views:
            away = np.minimum(away, _distances(view.plane, self._unsent.shape))
        tiles = tiles[np.argsort(away[self._unsent], kind="stable")][:SETTLED_AT_ONCE]
        fresh: list[Box] = []
        start = time.perf_counter()
        for first in range(0, len(tiles), _GROUP):
            group = tiles[first : first + _GROUP]
            boxes = [_tile_box(tile, session.geometry.shape) for tile in group]
            session.settle_boxes(boxes)
            stamps = session.tile_stamps
            for tile, box in zip(group, boxes, strict=True):
                at = tuple(tile)
                if stamps[at] > self._sent[at]:
                    fresh.append(box)
                self._unsent[at] = False
                self._sent[at] = stamps[at]
            if time.perf_counter() - start > _LONG_S:
                break
        return (boxes_message(fresh, session.labels_so_far(fresh)),) if fresh else ()


def _boxes_of(sight: Sight, tiles: Bool) -> list[Box]:
    """Boxes around what a plane shows of some tiles: one where it lies along the scan's axes."""
    low, high = sight.low[tiles], sight.high[tiles]
    if sight.is_box and len(low):
        low, high = low.min(axis=0, keepdims=True), high.max(axis=0, keepdims=True)
    return [
        (slice(k0, k1), slice(j0, j1), slice(i0, i1))
        for (k0, j0, i0), (k1, j1, i1) in zip(low.tolist(), high.tolist(), strict=True)
    ]


def _distances(plane: Plane, tile_counts: tuple[int, ...]) -> Float64:
    """How far the middle of each tile is from a plane."""
    middles = [TILE * np.arange(n) + 0.5 * (TILE - 1) for n in tile_counts]
    k, j, i = np.meshgrid(*middles, indexing="ij", sparse=True)
    a, b, c = plane.normal
    away: Float64 = np.abs(a * i + b * j + c * k - plane.offset) / np.linalg.norm(plane.normal)
    return away


def _tile_box(tile: Int64, shape: tuple[int, ...]) -> Box:
    k, j, i = (slice(int(at) * TILE, min((int(at) + 1) * TILE, n)) for at, n in zip(tile, shape, strict=True))
    return k, j, i
