"""A moment of a session as bytes for a page: the surface as it hangs on the nodes, and where the nodes are.

A binary message is the length of its header (uint32, little-endian), the header (JSON, filled up with spaces so that
what follows begins at a multiple of four), and arrays one after another, little-endian.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from heartcase.schemas.arrays import Float32, Float64, Int16, Int32, UInt8
from heartcase.simulator.live.live_frame import LiveFrame
from heartcase.simulator.live.shapes import CUT_FACES
from heartcase.simulator.surface.deform import SurfaceModel
from heartcase.studio.operating.scene.coarser import CoarseLevel
from heartcase.studio.operating.scene.normal_map import NormalMap

__all__ = [
    "BLOCK_NODES",
    "SCALE_LEAST",
    "Rounded",
    "coarse_message",
    "frame_message",
    "moved_blocks",
    "packed",
    "picture_message",
    "stretch_bytes",
    "topology_message",
]

BLOCK_NODES = 32
"""Nodes that are sent together: a block is sent where one of them moved."""
SCALE_LEAST = 2.0**-10
"""Displacements are whole multiples of so many cells: 0.003 mm in cells of 3 mm."""
IN_CELL = 2
"""Curvature of a vertex that follows the corners of a cell."""
_INT16_MAX = 32767


@dataclass(frozen=True)
class Rounded:
    """Displacements of nodes as they are sent."""

    steps: Int16
    """Displacement over ``scale``, shape (node_count, 3)."""
    scale: float
    """Cells for a step; a power of two."""

    @classmethod
    def of(cls, displacement: Float32, scale: float = SCALE_LEAST) -> Rounded:
        """Displacements [cells], rounded to steps of a scale, or of a larger one where they are too large for it."""
        most = float(np.abs(displacement).max(initial=0.0))
        while most > _INT16_MAX * scale:
            scale *= 2.0
        return cls(np.rint(displacement * np.float32(1.0 / scale)).astype(np.int16), scale)


def moved_blocks(now: Rounded, before: Rounded | None) -> npt.NDArray[np.uint32]:
    """Numbers of the blocks of nodes that are to be sent, ascending; all where nothing was sent before.

    Parameters
    ----------
    now
        Where the nodes are.
    before
        Where the page has them; None where it has none of this lattice.
    """
    count = len(now.steps)
    if before is None or before.scale != now.scale:
        return np.arange(-(-count // BLOCK_NODES), dtype=np.uint32)
    moved = (now.steps != before.steps).any(axis=1)
    starts = np.arange(0, count, BLOCK_NODES)
    return np.flatnonzero(np.logical_or.reduceat(moved, starts)).astype(np.uint32)


def frame_message(
    header: Mapping[str, Any],
    now: Rounded,
    before: Rounded | None,
    more: Mapping[str, npt.NDArray[Any]],
) -> bytes:
    """A frame: what is said of it, and the nodes that moved.

    Parameters
    ----------
    header
        What is said of it.
    now, before
        As of :func:`moved_blocks`.
    more
        Further arrays, by name.
    """
    blocks = moved_blocks(now, before)
    padded = np.zeros((-(-len(now.steps) // BLOCK_NODES) * BLOCK_NODES, 3), np.int16)
    padded[: len(now.steps)] = now.steps
    arrays: dict[str, npt.NDArray[Any]] = {"blocks": blocks, "steps": padded.reshape(-1, BLOCK_NODES, 3)[blocks]}
    own = {"scale": now.scale, "block_nodes": BLOCK_NODES}
    return packed({"kind": "frame"} | dict(header) | own, arrays | dict(more))


def topology_message(
    number: int,
    live: LiveFrame,
    structures: Int32,
    normal_map: NormalMap | None = None,
    cell_labels: UInt8 | None = None,
) -> bytes:
    """The surface as it hangs on the nodes: what a page's vertex shader needs to place it, as of eq. 9.9.

    A vertex on the border of two structures, or of two charts of the normal map, is sent once for each.

    Parameters
    ----------
    number
        Number of this topology; frames name it.
    live
        The moment.
    structures
        Structure of each triangle, shape (triangle_count,).
    normal_map
        That of the uncut surface, where the case has one: it is shown on what is whole.
    cell_labels
        Tissue label of each cell now, shape (cell_count,): with it goes what a page needs to show walls that a plane
        cuts open in their structures' colours.
    """
    surface, model = live.surface, live.frame.model
    drawn = surface.triangles
    if normal_map is not None:
        # vertices of the surface come behind those of the map, for triangles that the map does not fit any more
        charted = normal_map.corners_now(surface, live.triangle_origin)
        map_count = len(normal_map.uv)
        drawn = np.where(charted >= 0, charted, map_count + surface.triangles)
    arrays, chart = _drawn(surface, drawn, structures)
    if normal_map is not None:
        is_charted, at = chart < map_count, np.minimum(chart, map_count - 1)
        arrays["uv"] = np.where(is_charted[:, None], normal_map.uv[at], np.float32(-1.0))
        arrays["tangent"] = np.where(is_charted[:, None], normal_map.tangent[at], np.float32(0.0))
    if cell_labels is not None:
        arrays |= {"cells": model.cells.astype(np.int16), "cell_label": cell_labels}
        arrays["cell_corners"] = model.cell_corners.astype(np.uint32)
    header = {
        "kind": "topology",
        "topology": number,
        "node_count": model.node_count,
        "cut_faces": CUT_FACES,
        "cell_mm": model.cell_mm,
        "origin_mm": model.geometry.index_to_world(np.zeros(3)).tolist(),
        "direction": model.geometry.direction_matrix.tolist(),
    }
    return packed(header, arrays)


def picture_message(normal_map: NormalMap) -> bytes:
    """The picture of a normal map, as a page takes it."""
    return packed({"kind": "normal_map"}, {"png": np.frombuffer(normal_map.png, np.uint8)})


def coarse_message(number: int, coarse: CoarseLevel) -> bytes:
    """The surface at a coarser level of detail, without a normal map, as :func:`topology_message` has the finest.

    Parameters
    ----------
    number
        Number of the topology that it stands for.
    coarse
        The surface.
    """
    arrays, _ = _drawn(coarse.surface, coarse.surface.triangles, coarse.structures)
    header = {"kind": "coarse_topology", "topology": number, "level": coarse.level, "cut_faces": CUT_FACES}
    return packed(header, arrays)


def _drawn(
    surface: SurfaceModel, drawn: Int32, structures: Int32
) -> tuple[dict[str, npt.NDArray[Any]], npt.NDArray[np.int64]]:
    """Arrays of a surface whose vertices are told apart by structure and by the number that ``drawn`` has at corners.

    That number comes second, for each vertex.
    """
    corners, owners = drawn.ravel().astype(np.int64), np.repeat(structures.astype(np.int64), 3)
    pairs, first, triangles = np.unique(corners << 9 | owners, return_index=True, return_inverse=True)
    vertex = surface.triangles.ravel()[first].astype(np.int64)
    arrays: dict[str, npt.NDArray[Any]] = {
        "triangles": triangles.astype(np.uint32).reshape(-1, 3),
        "structure": (pairs & 511).astype(np.uint16),
        "vertex": vertex.astype(np.uint32),
        **_hung(surface, vertex),
        **_springs(surface),
    }
    return arrays, pairs >> 9


def _hung(surface: SurfaceModel, vertex: npt.NDArray[np.int64]) -> dict[str, npt.NDArray[Any]]:
    """What is constant of some vertices, by the names of :class:`heartcase.simulator.surface.deform.SurfaceModel`.

    A graphics card takes no more than 16 attributes. So a vertex that follows the corners of a cell, curvature
    :data:`IN_CELL`, has these in ``nodes``, ``normal_number`` and the first two numbers of ``offset``, its place in the
    cell in ``edge_one``, what is beyond in ``edge_two``, and its normal along the grid's axes in ``normal``.
    """
    found: dict[str, npt.NDArray[Any]] = {
        "nodes": surface.triangle_nodes[vertex],
        "weights": surface.weights[vertex],
        "edge_one": surface.edges[vertex, 0],
        "edge_two": surface.edges[vertex, 1],
        "curvature": surface.curvature[vertex],
        "offset": surface.offset[vertex],
        "normal": surface.normal[vertex],
        "normal_number": surface.normal_number[vertex],
        "rest_mm": surface.rest_mm[vertex],
        "rest_turn": surface.rest_turn[vertex],
    }
    cells, row_of = surface.in_cells, np.full(surface.vertex_count, -1)
    row_of[cells.vertices] = np.arange(len(cells.vertices))
    at = np.flatnonzero(row_of[vertex] >= 0)
    rows = row_of[vertex[at]]
    found["curvature"][at] = IN_CELL
    found["nodes"][at], found["normal_number"][at] = cells.corners[rows, :3], cells.corners[rows, 3:6]
    # Whole numbers up to 2^24 are exact in float32.
    found["offset"][at, :2] = cells.corners[rows, 6:]
    found["edge_one"][at], found["edge_two"][at] = cells.local[rows], cells.beyond[rows]
    found["normal"][at] = cells.normal[rows]
    return found


def _springs(surface: SurfaceModel) -> dict[str, npt.NDArray[Any]]:
    springs = surface.normals_of
    return {
        "normal_nodes": springs.nodes,
        "spring_first": springs.first,
        "spring_neighbours": springs.neighbours,
        "spring_offset": springs.offset,
    }


def stretch_bytes(stretch: Float64, shown: tuple[float, float]) -> UInt8:
    """Stretch around each node in 8 bit, shape (node_count,): 0 and 255 are the ends of what colours show."""
    low, high = shown
    found: UInt8 = np.rint(255.0 * np.clip((stretch - low) / (high - low), 0.0, 1.0)).astype(np.uint8)
    return found


def packed(header: Mapping[str, Any], arrays: Mapping[str, npt.NDArray[Any]]) -> bytes:
    """A binary message: the header, with a table of the arrays, and the arrays."""
    table, parts, at = {}, [], 0
    for name, array in arrays.items():
        data = np.ascontiguousarray(array).astype(array.dtype.newbyteorder("<"), copy=False).tobytes()
        table[name] = {"dtype": array.dtype.name, "shape": array.shape, "at": at}
        parts += [data, b"\0" * (-len(data) % 4)]
        at += len(data) + -len(data) % 4
    head = json.dumps(dict(header) | {"encoding": "raw", "arrays": table}, allow_nan=False).encode()
    head += b" " * (-len(head) % 4)
    return b"".join([len(head).to_bytes(4, "little"), head, *parts])
