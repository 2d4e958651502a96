"""From one cut to the next: which node each node of a lattice comes from that was cut further."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from heartcase.schemas.arrays import Bool, Float64, Int32, Int64
from heartcase.simulator.cutting.parted_lattice import PartedLattice
from heartcase.simulator.cutting.piece_kernels import SAMPLE_COUNT
from heartcase.simulator.lattice.model import LatticeModel

__all__ = ["Descent", "cells_of_samples", "descent_of", "nodes_now"]


@dataclass(frozen=True)
class Descent:
    """Where the nodes of a lattice come from that was cut further."""

    node_before: Int32
    """Node of the lattice before that each node now lies with, shape (node_count,): of the copies that its node had,
    the one to which most of its tissue hung."""
    mixed: Int64
    """Nodes whose tissue hung to several copies, each as often as it has such, ascending, shape (count,)."""
    mixed_before: Int64
    """These copies, shape (count,)."""
    mixed_share: Float64
    """Share of the node's mass that each had, shape (count,); of each node they add up to 1."""


def descent_of(uncut: LatticeModel, before: PartedLattice | None, now: PartedLattice) -> Descent:
    """Where the nodes of a lattice come from.

    Parameters
    ----------
    uncut
        The lattice before any cut.
    before
        What was made of it before; None where nothing had been cut.
    now
        What is made of it now.
    """
    nothing = np.zeros(0, np.int64)
    if before is None:
        return Descent(now.node_origin, nothing, nothing, np.zeros(0))
    result = now.node_origin.copy()
    was_copied = np.zeros(uncut.node_count, np.bool_)
    was_copied[before.node_origin[uncut.node_count :]] = True
    new, old, size = _overlaps(uncut, before, now, was_copied)
    new_node, old_node = now.model.cell_corners[new].ravel(), before.model.cell_corners[old].ravel()
    asks = was_copied[now.node_origin[new_node]]
    pairs = new_node[asks].astype(np.int64) * before.model.node_count + old_node[asks]
    keys, number = np.unique(pairs, return_inverse=True)
    votes = np.bincount(number, np.repeat(size, 8)[asks])
    node, choice = keys // before.model.node_count, keys % before.model.node_count
    order = np.lexsort((choice, -votes, node))
    first = order[np.diff(node[order], prepend=-1) != 0]
    result[node[first]] = choice[first]
    # Where a sheet ends in a cell, some of its tissue goes over to another side when the next comes near.
    is_mixed = np.bincount(node, minlength=now.model.node_count)[node] > 1
    mass = size * (now.model.cell_coverage * now.model.cell_density.astype(np.float64))[new]
    mass /= np.bincount(new, size)[new]
    masses = np.bincount(number, np.repeat(mass, 8)[asks])[is_mixed]
    mixed = node[is_mixed]
    share = masses / np.bincount(mixed, masses)[mixed] if len(mixed) else np.zeros(0)
    return Descent(result, mixed, choice[is_mixed], share)


def nodes_now(uncut: LatticeModel, before: PartedLattice | None, now: PartedLattice, node_before: Int32) -> Int64:
    """The heaviest of the nodes now that come from each node before, shape (node count before,).

    Where none does, the heaviest of the copies that its node has now.
    """
    origin = np.arange(uncut.node_count) if before is None else before.node_origin
    # Where a node has no copies, before or now, it is the only one.
    has_copies = np.zeros(uncut.node_count, np.bool_)
    has_copies[now.node_origin[uncut.node_count :]] = True
    has_copies[origin[uncut.node_count :]] = True
    asked = np.flatnonzero(has_copies[now.node_origin])
    lightest_first = asked[np.argsort(now.model.node_mass[asked], kind="stable")]
    heaviest = np.arange(uncut.node_count)
    heaviest[now.node_origin[lightest_first]] = lightest_first
    result: Int64 = heaviest[origin]
    result[node_before[lightest_first]] = lightest_first
    return result


def _overlaps(
    uncut: LatticeModel, before: PartedLattice, now: PartedLattice, was_copied: Bool
) -> tuple[Int64, Int64, Int64]:
    """Pairs of a cell now and a cell before in one place, and how many samples they have in common."""
    cells = np.flatnonzero(was_copied[uncut.cell_corners].any(axis=1))
    new, old = cells_of_samples(uncut, now, cells), cells_of_samples(uncut, before, cells)
    both = (new >= 0) & (old >= 0)
    keys, size = np.unique(new[both] * before.model.cell_count + old[both], return_counts=True)
    return keys // before.model.cell_count, keys % before.model.cell_count, size


def cells_of_samples(uncut: LatticeModel, parted: PartedLattice, cells: Int64) -> Int64:
    """Cell of a lattice that each sample of some uncut cells lies in, -1 where there is no tissue, (count, SAMPLES^3).

    All samples of cells that no sheet came near count as tissue.
    """
    pieces = parted.pieces
    result = np.repeat(cells[:, None], SAMPLE_COUNT, axis=1)
    place = np.minimum(np.searchsorted(pieces.cells, cells), len(pieces.cells) - 1)
    known = np.flatnonzero(pieces.cells[place] == cells) if len(pieces.cells) else np.zeros(0, np.int64)
    row = place[known]
    samples = pieces.samples[row].astype(np.int64)
    # The first piece has the number of its cell; those of further pieces follow all uncut cells.
    further = uncut.cell_count + (pieces.first[row] - row)[:, None] + samples - 1
    result[known] = np.where(samples > 0, further, np.where(samples == 0, cells[known, None], -1))
    return result
