"""Parting a lattice by one more sheet: what lies away from it is taken over from the cut before.

All arrays are those that :func:`heartcase.simulator.cutting.parted_lattice.part` and
:func:`heartcase.simulator.cutting.descent.descent_of` give for all sheets at once, to the byte.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from heartcase.schemas.arrays import Int32, Int64
from heartcase.simulator.cutting.bit_masks.inheriting import changed_nodes, heaviest_nodes, inherit_nodes
from heartcase.simulator.cutting.bit_masks.rows import copy_numbers
from heartcase.simulator.cutting.bit_masks.shares import (
    merge_near_springs,
    near_rows,
    near_springs,
    share_cells,
    share_masses,
    write_corners,
)
from heartcase.simulator.cutting.blade_sheet import Sheet
from heartcase.simulator.cutting.descent import Descent
from heartcase.simulator.cutting.further_pieces import Further, find_further
from heartcase.simulator.cutting.parted_lattice import PartedLattice
from heartcase.simulator.cutting.piece_frequency import bounded_moments
from heartcase.simulator.cutting.tissue_samples import SAMPLE_PLACES, SAMPLE_VARIANCE, TissueSamples
from heartcase.simulator.lattice.model import CELL_SPRINGS, LatticeModel

__all__ = ["part_further"]


def part_further(
    uncut: LatticeModel, tissue: TissueSamples, before: PartedLattice | None, sheet: Sheet
) -> tuple[PartedLattice, Descent, Int64] | None:
    """Part a lattice by one more sheet; None where it must be done for all sheets at once.

    Parameters
    ----------
    uncut, tissue
        The uncut lattice, and its samples.
    before
        What was made of it before; None where nothing was cut.
    sheet
        The sheet.

    Returns
    -------
    tuple
        What is made of it now, where its nodes come from, and the heaviest node that comes from each
        (:func:`heartcase.simulator.cutting.descent.nodes_now`).
    """
    if before is not None and before.found is None:
        return None
    found, further = find_further(uncut, tissue, None if before is None else before.found, sheet)
    around, stemmed, pieces, first = found.around, found.stemmed, found.pieces, found.first
    corners, cell_count, node_count = uncut.cell_corners, uncut.cell_count, uncut.node_count
    counts, node_copies = pieces.counts, found.node_copies
    numbers, origins = copy_numbers(node_copies)
    added = np.empty(int(first[-1]) - len(counts), np.int64)
    new_corners = np.empty((cell_count + len(added), 8), np.int32)
    new_corners[:cell_count] = corners
    write_corners(around, counts, first, pieces.copies, corners, numbers, cell_count, new_corners, added)

    def with_pieces(values: Any) -> Any:
        return np.concatenate([values, values[added]])

    node_origin = np.concatenate([np.arange(node_count, dtype=np.int32), origins])
    cell_origin = np.concatenate([np.arange(cell_count, dtype=np.int32), added.astype(np.int32)])
    coverage, moments = with_pieces(uncut.cell_coverage), with_pieces(uncut.cell_moments)
    model_before = uncut if before is None else before.model
    first_before = first if before is None or before.found is None else before.found.first
    changed, changed_moments = share_cells(
        around,
        stemmed,
        counts,
        first,
        further.is_same,
        further.of_known,
        first_before,
        cell_count,
        SAMPLE_PLACES,
        SAMPLE_VARIANCE,
        (model_before.cell_coverage, model_before.cell_moments),
        (uncut.cell_coverage, uncut.cell_moments),
        (coverage, moments),
    )
    moments[changed] = bounded_moments(uncut.law, changed_moments)
    stiffness, density = with_pieces(uncut.cell_stiffness), with_pieces(uncut.cell_density)
    rows = near_rows(around, counts, first, corners, node_copies, cell_count)
    mass = np.concatenate([uncut.node_mass, uncut.node_mass[origins]])
    share_masses(rows, new_corners, coverage, density, node_copies, numbers, mass)
    keys, weights = near_springs(rows, new_corners, coverage, stiffness, node_origin, node_copies, CELL_SPRINGS)
    room = uncut.spring_count + len(keys)
    springs = np.empty((room, 2), np.int32), np.empty(room, np.int8), np.empty(room, np.float32)
    spring_count = merge_near_springs(
        (_as_one(uncut.spring_nodes), uncut.spring_direction, uncut.spring_weight),
        uncut.first_springs,
        node_origin,
        node_copies,
        keys,
        weights,
        (_as_one(springs[0]), *springs[1:]),
    )
    shares = np.zeros((len(coverage), 8), np.float32)
    if uncut.law.has_shared_strain:
        shares = with_pieces(uncut.cell_shares)
    model = replace(
        uncut,
        cells=with_pieces(uncut.cells),
        cell_corners=new_corners,
        cell_coverage=coverage,
        cell_stiffness=stiffness,
        cell_density=density,
        cell_moments=moments,
        cell_shares=shares,
        cell_is_whole=np.ones(len(cell_origin), np.bool_),
        node_index=np.concatenate([uncut.node_index, uncut.node_index[origins]]),
        node_mass=mass,
        node_is_fixed=np.concatenate([uncut.node_is_fixed, uncut.node_is_fixed[origins]]),
        spring_nodes=springs[0][:spring_count],
        spring_direction=springs[1][:spring_count],
        spring_weight=springs[2][:spring_count],
    )
    parted = PartedLattice(model, node_origin, cell_origin, pieces, found)
    descent = _descent(uncut, before, parted, further)
    origins_before = origins[:0] if before is None else before.node_origin[node_count:]
    heaviest = heaviest_nodes(mass, node_origin, origins_before, descent.node_before, node_count)
    return parted, descent, heaviest


def _as_one(pairs: Int32) -> Int64:
    """Both numbers of each pair as one, the first in its lower half."""
    as_one: Int64 = pairs.reshape(-1).view("<i8")
    return as_one


def _descent(uncut: LatticeModel, before: PartedLattice | None, now: PartedLattice, further: Further) -> Descent:
    """Where the nodes come from."""
    if before is None:
        nothing = np.zeros(0, np.int64)
        return Descent(now.node_origin, nothing, nothing, np.zeros(0))
    found, known = now.found, before.found
    assert found is not None
    assert known is not None
    counts, first, copies = found.pieces.counts, found.first, found.pieces.copies
    is_changed = changed_nodes(
        found.around,
        counts,
        first,
        copies,
        further.is_same,
        further.of_known,
        known.first,
        known.pieces.copies,
        uncut.cell_corners,
        uncut.node_count,
    )
    return Descent(
        *inherit_nodes(
            (found.around, found.stemmed, counts, first, now.model.cell_corners),
            (known.around, known.stemmed, known.pieces.counts, known.first, before.model.cell_corners),
            further.of_known,
            is_changed,
            now.model.cell_coverage,
            now.model.cell_density,
            now.node_origin,
            before.node_origin[uncut.node_count :],
            uncut.cell_count,
        )
    )
