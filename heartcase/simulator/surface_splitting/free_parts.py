"""What a cut sets free: parts of a lattice that hang together by no node, and lattices and surfaces without some."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from heartcase.schemas.arrays import Int32, Int64
from heartcase.schemas.errors import SimulationError
from heartcase.simulator.lattice.model import LatticeModel
from heartcase.simulator.lattice.sub_lattice import sub_lattice
from heartcase.simulator.surface.deform import PickingModel, make_picking
from heartcase.simulator.surface_splitting.gluing import number_parts
from heartcase.simulator.surface_splitting.split_surface import SplitSurface

__all__ = ["Excision", "cut_picking", "excise", "parts_of_lattice", "triangles_of_parts"]

_FACES = np.array([(0, 4, 6, 2), (1, 3, 7, 5), (0, 1, 5, 4), (2, 6, 7, 3), (0, 2, 3, 1), (4, 5, 7, 6)])
"""Corners of a cell's faces, counter-clockwise from outside."""


@dataclass(frozen=True)
class Excision:
    """A lattice without some of its parts."""

    model: LatticeModel
    """What is left."""
    nodes: Int64
    """Nodes that are left, ascending: what node each of the model was, shape (node_count,)."""
    cells: Int64
    """Cells that are left, ascending, shape (cell_count,)."""


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


def excise(model: LatticeModel, removed: npt.ArrayLike) -> Excision:
    """Take parts out of a lattice: their cells, nodes and springs.

    Parameters
    ----------
    model
        A lattice that was cut.
    removed
        Numbers of the parts (:func:`parts_of_lattice`) to take out.

    Raises
    ------
    SimulationError
        Nothing would be left, or explicit springs are there: they must be taken out first.
    """
    kept = ~np.isin(parts_of_lattice(model), np.asarray(removed))
    if not kept.any():
        raise SimulationError("every part of the tissue would be removed: leave one", place="excision")
    if len(model.explicit.nodes):
        raise SimulationError("explicit springs hold this lattice: take them out before an excision", place="excision")
    cells = np.flatnonzero(kept)
    left, nodes = sub_lattice(model, cells)
    return Excision(left, nodes, cells)


def cut_picking(model: LatticeModel) -> PickingModel:
    """The one-to-one surface of a cut lattice: a vertex for each node of a face that one cell alone has.

    It is closed, each edge passed as often one way as the other, and goes into the cut on both sides.
    """
    faces = model.cell_corners[:, _FACES].reshape(-1, 4).astype(np.int64)
    is_far = np.tile(np.array([False, True] * 3), model.cell_count)
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
