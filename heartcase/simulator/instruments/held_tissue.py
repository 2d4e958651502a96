"""Which tissue an instrument takes hold of: by where the tissue of each cell lies, and on one side of all incisions.

Nodes alone do not tell the sides of an incision apart. A piece of a cell that was cut has copies of nodes that lie
beyond the cut, in the same places as the nodes of the other lip. Where the piece's own tissue lies does tell.
"""

from __future__ import annotations

import numpy as np

from heartcase.schemas.arrays import Bool, Float, Float64, Int64, Intp
from heartcase.schemas.bundle.lattice import CORNER_OFFSETS
from heartcase.simulator.instruments.grab import DETOUR_MAX, along_springs
from heartcase.simulator.lattice.loose_nodes import loose_first
from heartcase.simulator.lattice.model import LatticeModel

__all__ = [
    "cells_at_nodes",
    "is_across",
    "nodes_reached",
    "on_own_side",
    "on_side_at",
    "tissue_at_rest",
    "tissue_now",
]

_DETOUR_MORE = 1.0
"""How much longer a way along springs may be beside that [cells]: walls lie in steps along the grid."""


def tissue_at_rest(model: LatticeModel) -> Float64:
    """Middle of the tissue of each cell at rest [cells, frame of the nodes], shape (cell_count, 3)."""
    middle: Float64 = model.cells + 0.5 + model.cell_moments[:, :3].astype(float)
    return middle


def tissue_now(model: LatticeModel, displacement: Float) -> Float64:
    """Middle of the tissue of each cell now [cells, frame of the nodes], shape (cell_count, 3)."""
    corner = CORNER_OFFSETS - 0.5
    middle = model.cell_moments[:, :3].astype(float)
    weight = (0.5 + 2.0 * middle[:, None, :] * corner).prod(axis=2)
    moved: Float64 = np.einsum("ca,cax->cx", weight, displacement[model.cell_corners].astype(float))
    return tissue_at_rest(model) + moved


def is_across(sheets: Float64, start: Float64, end: Float64) -> Bool:
    """Whether the straight way between two places at rest meets what blades swept, shape (count,).

    Parameters
    ----------
    sheets
        Triangles of all that was cut, at rest [cells, frame of the nodes], shape (triangle_count, 3, 3).
    start, end
        Places at rest [cells, frame of the nodes], shape (count, 3).
    """
    met = np.zeros(len(start), dtype=bool)
    low, high = np.minimum(start, end).min(axis=0, initial=np.inf), np.maximum(start, end).max(axis=0, initial=-np.inf)
    near = ((sheets.max(axis=1) >= low) & (sheets.min(axis=1) <= high)).all(axis=1)
    for triangle in sheets[near]:
        met |= _meets(triangle, start, end)
    return met


def _meets(triangle: Float64, start: Float64, end: Float64) -> Bool:
    """Whether ways go through a triangle, its rim included (Moeller and Trumbore, J. Graphics Tools 2, 1997)."""
    way = end - start
    first, second = triangle[1] - triangle[0], triangle[2] - triangle[0]
    across = np.cross(way, second)
    scale = across @ first
    has_side = np.abs(scale) > 1e-12
    scale = np.where(has_side, scale, 1.0)
    there = start - triangle[0]
    u = (there * across).sum(axis=1) / scale
    turned = np.cross(there, first)
    v = (way * turned).sum(axis=1) / scale
    at = turned @ second / scale
    slack = 1e-9
    in_triangle = (u >= -slack) & (v >= -slack) & (u + v <= 1.0 + slack)
    meets: Bool = has_side & in_triangle & (at >= -slack) & (at <= 1.0 + slack)
    return meets


def nodes_reached(model: LatticeModel, cells: Intp, starts: Intp) -> Intp:
    """Nodes of some cells that can be reached from others of these cells along springs between them, ascending.

    The way to a node may not be longer than in uncut tissue, so that it does not lead around the end of an incision.

    Parameters
    ----------
    model
        The lattice, without the springs that were cut.
    cells
        The cells.
    starts
        Cells of these at which ways begin.
    """
    inside = np.zeros(model.node_count, dtype=bool)
    inside[model.cell_corners[cells]] = True
    first = np.unique(model.cell_corners[starts])
    nodes = np.flatnonzero(inside)
    straight = np.full(len(nodes), np.inf)
    for node in first:
        straight = np.minimum(straight, np.linalg.norm(model.node_index[nodes] - model.node_index[node], axis=1))
    reach = np.zeros(model.node_count)
    reach[nodes] = DETOUR_MAX * straight + _DETOUR_MORE
    return along_springs(model, inside, starts=first.tolist(), reach=reach)


def cells_at_nodes(model: LatticeModel, nodes: Intp) -> tuple[Intp, Intp]:
    """Cells that have some of these nodes as corners, and the place of that node among those given: pairs, (count,)."""
    number = np.full(model.node_count, -1)
    number[nodes] = np.arange(len(nodes))
    place = number[model.cell_corners]
    cell, corner = np.nonzero(place >= 0)
    return cell, place[cell, corner]


def on_own_side(model: LatticeModel, sheets: Float64, nodes: Int64, roots: Float64) -> Bool:
    """Which nodes belong to no tissue across an incision from where an instrument took hold, shape (count,).

    Parameters
    ----------
    model
        The lattice.
    sheets
        Triangles of all that was cut of it, as of :func:`is_across`.
    nodes
        Nodes, shape (count,).
    roots
        Where the instrument has hold of each, at rest [cells, frame of the nodes], shape (count, 3).
    """
    cell, place = cells_at_nodes(model, nodes)
    across = is_across(sheets, roots[place], tissue_at_rest(model)[cell])
    is_own = np.ones(len(nodes), dtype=bool)
    is_own[place[across]] = False
    return is_own


def on_side_at(model: LatticeModel, displacement: Float, place: Float64, radius: float, sheets: Float64) -> Bool | None:
    """Which nodes a hand at a place may hold, shape (node_count,).

    Those in its ball that belong to no tissue across an incision from that nearest its centre; None, for all, where
    nothing was cut or nothing would be left.

    Parameters
    ----------
    model
        The lattice.
    displacement
        Displacement of the nodes [cells, grid axes], shape (node_count, 3).
    place
        The ball's centre now [cells, frame of the nodes], shape (3,).
    radius
        Its radius [cells].
    sheets
        Triangles of all that was cut of it, as of :func:`is_across`.
    """
    away = np.linalg.norm(model.node_index + displacement - place, axis=1)
    away[loose_first(model) :] = np.inf
    nodes = np.flatnonzero(away <= radius)
    if not (len(sheets) and len(nodes)):
        return None
    cells = np.unique(cells_at_nodes(model, nodes)[0])
    now = tissue_now(model, displacement)[cells]
    root = tissue_at_rest(model)[cells[np.linalg.norm(now - place, axis=1).argmin()]]
    own = nodes[on_own_side(model, sheets, nodes, np.tile(root, (len(nodes), 1)))]
    if not len(own):
        return None
    is_own = np.zeros(model.node_count, dtype=bool)
    is_own[own] = True
    return is_own
