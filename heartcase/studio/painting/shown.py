"""What a page was sent of labels that are worked out bit by bit: the slices that it shows first, the rest later."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from heartcase.pipeline.markers.session import SegmentationSession
from heartcase.pipeline.watershed.forest import Box
from heartcase.pipeline.watershed.painting import TILE
from heartcase.schemas.arrays import Bool, Float64, Int64, UInt8
from heartcase.schemas.geometry import Geometry
from heartcase.studio.messages import boxes_message
from heartcase.studio.painting.requests import SeenPlane

__all__ = ["Plane", "Shown", "planes_in_voxels"]

SETTLED_AT_ONCE = 96
"""Tiles that are worked out for one request, at most: a few ms."""
SENT_AT_ONCE = 32
"""Tiles that are sent for one request, at most."""
_STRAIGHT = 1e-6
_EDGE = 1e-3
"""Voxels; a plane this near to a voxel's face is drawn with either of the two."""


@dataclass(frozen=True)
class Plane:
    """Where normal @ voxel == offset, for voxel indices (i, j, k)."""

    normal: Float64
    """Shape (3,)."""
    offset: float


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


class Shown:
    """What one page looks at, and what it has still to be sent. It has all labels of this moment, none of them put off.

    Parameters
    ----------
    session
        What is painted on.
    """

    def __init__(self, session: SegmentationSession) -> None:
        self._session = session
        self._planes: tuple[Plane, ...] = ()
        self._unsent = np.zeros_like(session.put_off_tiles)
        self._sent = session.tile_stamps

    @property
    def has_rest(self) -> bool:
        """Whether labels may differ from what the page was sent, off the planes that it looks at."""
        return bool(self._unsent.any())

    def look(self, planes: tuple[Plane, ...]) -> None:
        """The page looks at these planes from now on."""
        self._planes = planes

    def note(self, tiles: Bool) -> None:
        """Labels in these tiles may have changed."""
        self._unsent |= tiles

    def in_sight(self) -> tuple[bytes, ...]:
        """What the planes show of tiles that were not sent yet; these stay so."""
        boxes: list[Box] = []
        shape = self._session.geometry.shape
        for plane in self._planes:
            thin = _slab(plane, shape)
            if thin is None:
                away, reach = self._distances(plane)
                boxes += [_tile_box(tile, shape) for tile in np.argwhere(self._unsent & (away <= reach))]
            elif (cropped := self._cropped(thin)) is not None:
                boxes.append(cropped)
        return self._messages(boxes, self._session.labels_of_boxes(boxes))

    def rest(self) -> tuple[bytes, ...]:
        """Some of what was not sent yet, the nearest to the planes first."""
        session = self._session
        tiles = np.argwhere(self._unsent)
        away = np.full(self._unsent.shape, np.inf)
        for plane in self._planes:
            away = np.minimum(away, self._distances(plane)[0])
        tiles = tiles[np.argsort(away[self._unsent], kind="stable")][:SETTLED_AT_ONCE]
        boxes = [_tile_box(tile, session.geometry.shape) for tile in tiles]
        labels, stamps = session.labels_of_boxes(boxes), session.tile_stamps
        sent: list[Box] = []
        parts: list[UInt8] = []
        for tile, box, part in zip(tiles, boxes, labels, strict=True):
            at = tuple(tile)
            if stamps[at] > self._sent[at]:
                if len(sent) == SENT_AT_ONCE:
                    continue
                sent.append(box)
                parts.append(part)
            self._unsent[at] = False
            self._sent[at] = stamps[at]
        return self._messages(sent, parts)

    def _messages(self, boxes: Sequence[Box], parts: Sequence[UInt8]) -> tuple[bytes, ...]:
        return (boxes_message(boxes, parts),) if boxes else ()

    def _cropped(self, box: Box) -> Box | None:
        """The part of a box around the tiles in it that were not sent yet."""
        k, j, i = (slice(one.start // TILE, (one.stop - 1) // TILE + 1) for one in box)
        found: Int64 = np.argwhere(self._unsent[k, j, i])
        if not len(found):
            return None
        low, high = found.min(axis=0), found.max(axis=0) + 1
        parts = (
            slice(max(one.start, (tiles.start + a) * TILE), min(one.stop, (tiles.start + b) * TILE))
            for one, tiles, a, b in zip(box, (k, j, i), low.tolist(), high.tolist(), strict=True)
        )
        k, j, i = parts
        return k, j, i

    def _distances(self, plane: Plane) -> tuple[Float64, float]:
        """How far the middle of each tile is from a plane, and up to which distance the plane meets it."""
        middles = [TILE * np.arange(n) + 0.5 * (TILE - 1) for n in self._unsent.shape]
        k, j, i = np.meshgrid(*middles, indexing="ij", sparse=True)
        a, b, c = plane.normal
        length = float(np.linalg.norm(plane.normal))
        reach = (0.5 * TILE + _EDGE) * float(np.abs(plane.normal).sum())
        return np.abs(a * i + b * j + c * k - plane.offset) / length, reach / length


def _slab(plane: Plane, shape: tuple[int, ...]) -> Box | None:
    """The voxels that a plane along the voxels' axes shows; None where it lies obliquely."""
    size = np.abs(plane.normal)
    axis = int(size.argmax())
    if (np.delete(size, axis) > _STRAIGHT * size[axis]).any():
        return None
    box = [slice(0, n) for n in shape]
    at, count = plane.offset / plane.normal[axis], shape[2 - axis]
    first, last = (int(np.clip(np.floor(at + 0.5 + edge), 0, count - 1)) for edge in (-_EDGE, _EDGE))
    box[2 - axis] = slice(first, last + 1)
    k, j, i = box
    return k, j, i


def _tile_box(tile: Int64, shape: tuple[int, ...]) -> Box:
    k, j, i = (slice(int(at) * TILE, min((int(at) + 1) * TILE, n)) for at, n in zip(tile, shape, strict=True))
    return k, j, i
