"""Fixed nodes: those that the region of interest, an end marker or a pin fixes, and pieces that nothing fixes."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from heartcase.pipeline.cells.sampling import CellSamples
from heartcase.pipeline.data import Structures
from heartcase.pipeline.kernels.topology import components
from heartcase.pipeline.warning_words import sentence
from heartcase.pipeline.warnings import CaseWarning, counted
from heartcase.schemas.arrays import Bool, Int32, UInt8
from heartcase.schemas.errors import Problem, StageError
from heartcase.schemas.geometry import Geometry
from heartcase.schemas.recipe.settings import Pin

__all__ = ["fixed_nodes", "floating_pieces"]


def fixed_nodes(
    structures: Structures,
    samples: CellSamples,
    tissue: Bool,
    nodes: Int32,
    corners: Int32,
    pins: Sequence[Pin],
) -> UInt8:
    """Find the nodes that are held.

    Those of every tissue cell that a face of the region of interest or an end marker's disc cuts (or that ends within
    a quarter of a cell before the disc, where the sliver beyond makes no cell of its own), and those inside a pin.

    Parameters
    ----------
    structures
        For its end markers.
    samples
        The fields in the cells.
    tissue
        Tissue cells, ``[k, j, i]``.
    nodes, corners
        From :func:`heartcase.schemas.bundle.lattice.cell_nodes`.
    pins
        Balls of tissue, world mm.

    Returns
    -------
    uint8, shape (node_count,)
        1 where the node is held.

    Raises
    ------
    StageError
        A pin holds no tissue, or nothing is held at all.
    """
    geometry = samples.geometry
    held = _cut_by_region(samples, tissue)[tissue]
    centres = geometry.index_to_world(np.argwhere(tissue)[:, ::-1])
    for point, axis, radius in structures.fixed_planes:
        normal = np.asarray(axis, dtype=float) / np.linalg.norm(axis)
        reach = 0.5 * samples.cell_mm * float(np.abs(geometry.direction_matrix.T @ normal).sum())
        away = centres - np.asarray(point)
        height = away @ normal
        aside = np.linalg.norm(away - height[:, None] * normal, axis=1)
        held |= (height >= -reach - 0.25 * samples.cell_mm) & (height <= reach) & (aside <= radius)
    fixed = np.zeros(len(nodes), np.uint8)
    fixed[corners[held]] = 1
    positions = geometry.index_to_world(nodes - 0.5)
    problems = []
    for n, pin in enumerate(pins, start=1):
        inside = np.linalg.norm(positions - np.array(pin.position_mm), axis=1) <= pin.radius_mm
        if not inside.any():
            message = "no node of the grid lies within its radius: move it onto the tissue or make it larger"
            problems.append(Problem(f"pins[{n}]", message))
        fixed[inside] = 1
    if problems:
        raise StageError(problems)
    if not fixed.any():
        raise StageError(
            "nothing holds the heart: no tissue touches the region of interest or an end marker; add a [[pins]]",
            place="grid",
        )
    return fixed


def floating_pieces(geometry: Geometry, tissue: Bool, corners: Int32, fixed: UInt8) -> list[CaseWarning]:
    """A warning for the pieces of tissue that hang on nothing and would fly away."""
    labels, count = components(tissue, 26)
    of_cell = labels[tissue]
    is_held = np.zeros(count + 1, np.bool_)
    is_held[of_cell[fixed[corners].any(axis=1)]] = True
    loose = np.flatnonzero(~is_held[1:]) + 1
    if len(loose) == 0:
        return []
    sizes = np.bincount(of_cell, minlength=count + 1)[loose]
    largest = loose[np.argmax(sizes)]
    x, y, z = geometry.index_to_world(np.argwhere(labels == largest)[:, ::-1].mean(axis=0))
    cells = counted(int(sizes.sum()), "cell")
    return [
        CaseWarning(sentence("floating-tissue", count=len(loose), cells=cells, place=f"({x:.1f}, {y:.1f}, {z:.1f})"))
    ]


def _cut_by_region(samples: CellSamples, tissue: Bool) -> Bool:
    """Tissue cells at the faces of the region of interest, where the tissue itself touches the face."""
    cut = np.zeros(tissue.shape, np.bool_)
    s = samples.factor
    # A sample that is tissue in part touches the face too.
    fine = samples.inside_mask & (samples.tissue_mm < 0.5 * samples.cell_mm / s)
    for axis in range(3):
        used = np.flatnonzero(samples.inside[axis] > 0.0)
        for at, inward in ((used[0], 1), (used[-1], -1)):
            touches = np.take(fine, at, axis=axis)
            rows, columns = (n // s for n in touches.shape)
            wanted = touches.reshape(rows, s, columns, s).any(axis=(1, 3))
            layer = np.moveaxis(cut, axis, 0)
            cells = np.moveaxis(tissue, axis, 0)
            first = at // s
            layer[first] |= wanted & cells[first]
            # The last cell may hold too thin a slice of the volume to exist: then the one before it is cut.
            second = first + inward
            if 0 <= second < len(cells):
                layer[second] |= wanted & ~cells[first] & cells[second]
    return cut
