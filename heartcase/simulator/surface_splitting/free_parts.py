"""What a cut sets free: parts of a lattice that hang together by no node, and surfaces without some."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import numpy.typing as npt

from heartcase.schemas.arrays import Int32
from heartcase.simulator.lattice.model import LatticeModel
from heartcase.simulator.surface.deform import PickingModel, make_picking
from heartcase.simulator.surface_splitting.gluing import number_parts
from heartcase.simulator.surface_splitting.split_surface import SplitSurface

__all__ = ["cut_picking", "parts_of_lattice", "triangles_of_parts", "without_excised"]

_FACES = np.array([(0, 4, 6, 2), (1, 3, 7, 5), (0, 1, 5, 4), (2, 6, 7, 3), (0, 2, 3, 1), (4, 5, 7, 6)])
"""Corners of a cell's faces, counter-clockwise from outside."""


def parts_of_lattice(model: LatticeModel) -> Int32:
    """Number of what each cell hangs together with by common nodes, by the first cell of each, shape (cell_count,)."""
    found: Int32 = number_parts(model.cell_corners, model.node_count)
    return found


def triangles_of_parts(model: LatticeModel, split: SplitSurface) -> Int32:
    """Part of the lattice (:func:`parts_of_lattice`) that each triangle of a split surface follows, int32."""
    of_node = np.zeros(model.node_count, np.int32)
    of_node[model.cell_corners] = parts_of_lattice(model)[:, None]
    found: Int32 = of_node[split.surface.triangle_nodes[split.surface.triangles[:, 0], 0]]
    return found


def without_excised(split: SplitSurface, excised: npt.ArrayLike) -> SplitSurface:
    """A split surface without the triangles that follow excised nodes; its vertices keep their numbers.

    What is left is closed as before: parts that were cut free share no edge with others.

    Parameters
    ----------
    split
        The surface.
    excised
        True for each node of its lattice that was excised, shape (node_count,).
    """
    surface = split.surface
    kept = ~np.asarray(excised)[surface.triangle_nodes[surface.triangles[:, 0], 0]]
    of_triangles = ("triangle_origin", "triangle_sheet", "triangle_part")
    return replace(
        split,
        surface=replace(surface, triangles=surface.triangles[kept]),
        **{name: getattr(split, name)[kept] for name in of_triangles},
    )


def cut_picking(model: LatticeModel, excised: npt.ArrayLike | None = None) -> PickingModel:
    """The one-to-one surface of a cut lattice: a vertex for each node of a face that one cell alone has.

    It is closed, each edge passed as often one way as the other, and goes into the cut on both sides. Cells of nodes
    that were excised, True in ``excised``, shape (node_count,), have none.
    """
    corners = model.cell_corners
    if excised is not None:
        corners = corners[~np.asarray(excised)[corners[:, 0]]]
    faces = corners[:, _FACES].reshape(-1, 4).astype(np.int64)
    is_far = np.tile(np.array([False, True] * 3), len(corners))
    # Faces with the same nodes are seen from both sides by the two cells that they are between.
    a, b, c, d = np.sort(faces, axis=1).T
    _, low = np.unique(a << 31 | b, return_inverse=True)
    _, high = np.unique(c << 31 | d, return_inverse=True)
    _, number = np.unique(low * len(faces) + high, return_inverse=True)
    net = np.bincount(number, np.where(is_far, 1, -1)).astype(np.int64)
    sign = np.where(is_far, 1, -1)
    # Of faces of one name as many stay as there are more of one side than of the other.
    by_name = np.lexsort((np.arange(len(faces)), sign != np.sign(net)[number], number))
    first = np.flatnonzero(np.diff(number[by_name], prepend=-1))
    rank = np.arange(len(faces)) - np.repeat(first, np.diff(np.append(first, len(faces))))
    kept = np.sort(by_name[rank < np.abs(net)[number[by_name]]])
    quads = faces[kept]
    halves = np.stack([quads[:, [0, 1, 2]], quads[:, [0, 2, 3]]], axis=1).reshape(-1, 3)
    nodes, triangles = np.unique(halves, return_inverse=True)
    return make_picking(model, nodes.astype(np.int32), triangles.reshape(-1, 3).astype(np.int32))
