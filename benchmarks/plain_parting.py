"""Virtual nodes in plain NumPy over whole arrays: what ``cut-adult-stroke`` measures ours beside.

It gives the same bytes, and is the oracle of the kernels that work near the sheets alone
(``tests/simulator/cutting/test_plain_parting.py``).
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from heartcase.schemas.arrays import Bool, Float32, Float64, Int8, Int32, Int64
from heartcase.schemas.bundle.lattice import CORNER_OFFSETS, lattice_keys
from heartcase.simulator.cutting.blade_sheet import key_indices
from heartcase.simulator.cutting.crossings import SAMPLES
from heartcase.simulator.cutting.parted_lattice import PartedLattice
from heartcase.simulator.cutting.piece_frequency import bounded_moments
from heartcase.simulator.cutting.piece_kernels import SAMPLE_COUNT, Labels
from heartcase.simulator.cutting.pieces import Block, Pieces
from heartcase.simulator.cutting.pieces import _places_of as places_of
from heartcase.simulator.cutting.tissue_samples import SAMPLE_PLACES, samples_of
from heartcase.simulator.lattice.model import CELL_SPRINGS, LatticeModel

STRIDES = np.array([1, SAMPLES, SAMPLES**2])
_SAMPLE_VARIANCE = 1.0 / 12.0 / SAMPLES**2


def plain_tissue(entries: Int64, cells: Int32) -> Bool:
    """Which samples of some cells lie in the tissue, where links along x are crossed, shape (count, SAMPLES^3)."""
    samples = samples_of(cells)
    row_start = lattice_keys(np.concatenate([np.full((*samples.shape[:2], 1), -(1 << 20)), samples[..., 1:]], axis=2))
    before = np.searchsorted(entries, lattice_keys(samples)) - np.searchsorted(entries, row_start)
    return before % 2 == 1


def plain_nodes_now(uncut: LatticeModel, before: PartedLattice | None, now: PartedLattice, node_before: Int32) -> Int64:
    """The heaviest of the nodes now that come from each node before."""
    origin = np.arange(uncut.node_count) if before is None else before.node_origin
    lightest_first = np.argsort(now.model.node_mass, kind="stable")
    heaviest = np.zeros(uncut.node_count, np.int64)
    heaviest[now.node_origin[lightest_first]] = lightest_first
    result = heaviest[origin]
    result[node_before[lightest_first]] = lightest_first
    return result


def plain_parted(model: LatticeModel, pieces: Pieces) -> PartedLattice:
    """The lattice that pieces make."""
    is_first = np.zeros(pieces.counts.sum(), np.bool_)
    is_first[pieces.first] = True
    of_cell = np.repeat(pieces.cells, pieces.counts)
    # The first piece keeps the cell's number, and the first copy the node's.
    cell_origin = np.concatenate([np.arange(model.cell_count), of_cell[~is_first]])
    corners = model.cell_corners[cell_origin].astype(np.int64)
    rows = np.concatenate([of_cell[is_first], model.cell_count + np.arange((~is_first).sum())])
    copies = np.zeros_like(corners)
    copies[rows] = np.concatenate([pieces.copies[is_first], pieces.copies[~is_first]])
    is_copied = copies > 0
    made, number = np.unique(np.stack([corners[is_copied], copies[is_copied]], axis=1), axis=0, return_inverse=True)
    corners[is_copied] = model.node_count + number.ravel()
    node_origin = np.concatenate([np.arange(model.node_count), made[:, 0]])

    coverage, moments = _shares(model, pieces)
    cell_coverage = model.cell_coverage[cell_origin]
    cell_moments = model.cell_moments[cell_origin]
    order = np.concatenate([np.flatnonzero(is_first), np.flatnonzero(~is_first)])
    is_parted = np.repeat(pieces.counts > 1, pieces.counts)[order]
    cell_coverage[rows[is_parted]] = coverage[order[is_parted]]
    cell_moments[rows[is_parted]] = bounded_moments(model.law, moments[order[is_parted]])

    stiffness, density = model.cell_stiffness[cell_origin], model.cell_density[cell_origin]
    corners = corners.astype(np.int32)
    springs = _springs(model, node_origin, corners, cell_coverage.astype(np.float64) * stiffness)
    parted = replace(
        model,
        cells=model.cells[cell_origin],
        cell_corners=corners,
        cell_coverage=cell_coverage,
        cell_stiffness=stiffness,
        cell_density=density,
        cell_moments=cell_moments,
        cell_shares=model.cell_shares[cell_origin],
        cell_is_whole=np.ones(len(cell_origin), np.bool_),
        node_index=model.node_index[node_origin],
        node_mass=_masses(model, node_origin, corners, cell_coverage.astype(np.float64) * density),
        node_is_fixed=model.node_is_fixed[node_origin],
        spring_nodes=springs[0],
        spring_direction=springs[1],
        spring_weight=springs[2],
    )
    return PartedLattice(parted, node_origin.astype(np.int32), cell_origin.astype(np.int32), pieces)


def _shares(model: LatticeModel, pieces: Pieces) -> tuple[Float32, Float64]:
    """Coverage and moments of each piece: those of its cell, shared out as its samples are."""
    piece = pieces.samples + pieces.first[:, None]
    is_tissue = pieces.samples >= 0
    number = piece[is_tissue]
    piece_count = int(pieces.counts.sum())
    place = np.broadcast_to(SAMPLE_PLACES, (*piece.shape, 3))[is_tissue]
    x, y, z = place.T
    terms = (x, y, z, x * x + _SAMPLE_VARIANCE, y * y + _SAMPLE_VARIANCE, z * z + _SAMPLE_VARIANCE, y * z, x * z, x * y)
    sizes = np.bincount(number, minlength=piece_count)
    sums = np.stack([np.bincount(number, term, minlength=piece_count) for term in terms], axis=1)
    of_cell = np.repeat(np.arange(len(pieces.cells)), pieces.counts)
    cell_sizes = np.bincount(of_cell, sizes, minlength=len(pieces.cells))
    cell_sums = np.stack([np.bincount(of_cell, column, minlength=len(pieces.cells)) for column in sums.T], axis=1)
    coverage = model.cell_coverage[pieces.cells[of_cell]] * (sizes / cell_sizes[of_cell])
    # What the samples say of the whole cell is a little off: each piece is moved by as much.
    known = model.cell_moments[pieces.cells].astype(np.float64)
    moments = sums / sizes[:, None] + (known - cell_sums / cell_sizes[:, None])[of_cell]
    return coverage.astype(np.float32), _possible(moments)


def _possible(moments: Float64) -> Float64:
    """Moments of tissue that lies in its cell and has a shape."""
    first = np.clip(moments[:, :3], -0.5, 0.5)
    second = np.clip(moments[:, 3:6], first**2 + _SAMPLE_VARIANCE, 0.5)
    return np.concatenate([first, second, np.clip(moments[:, 6:], -0.5, 0.5)], axis=1)


def _masses(model: LatticeModel, node_origin: Int64, corners: Int32, cell_mass: Float64) -> Float32:
    """Mass of each node: that of the uncut lattice's, shared out among its copies."""
    of_node = np.bincount(corners.ravel(), np.repeat(cell_mass, 8), minlength=len(node_origin))
    whole = np.bincount(node_origin, of_node)[node_origin]
    return (model.node_mass[node_origin] * (of_node / whole)).astype(np.float32)


def _springs(
    model: LatticeModel, node_origin: Int64, corners: Int32, stiffness: Float64
) -> tuple[Int32, Int8, Float32]:
    """Both nodes, direction and stiffness of each spring, by lower node, then direction.

    They are those of the uncut lattice, shared out among their copies.
    """
    pairs, share, direction = CELL_SPRINGS
    node_count = len(node_origin)
    # Where no node has a copy all stays as it was.
    has_copies = np.zeros(model.node_count, np.bool_)
    has_copies[node_origin[model.node_count :]] = True
    near = has_copies[node_origin[corners]].any(axis=1)
    ends = corners[near][:, pairs].astype(np.int64)
    keys = ((ends[..., 0] * 9 + direction) * node_count + ends[..., 1]).ravel()
    shares = (stiffness[near, None] * share).ravel()
    is_shared = has_copies[node_origin[ends]].any(axis=2).ravel()
    used, number = np.unique(keys[is_shared], return_inverse=True)
    weight = np.bincount(number.ravel(), shares[is_shared])
    uncut = model.spring_nodes[:, 0].astype(np.int64) * 9 + model.spring_direction
    origin = np.searchsorted(uncut, node_origin[used // (9 * node_count)] * 9 + used // node_count % 9)
    whole = np.bincount(origin, weight)[origin]
    shared = model.spring_weight[origin] * (weight / whole)

    kept = ~has_copies[model.spring_nodes].any(axis=1)
    kept_keys = uncut[kept] * node_count + model.spring_nodes[kept, 1]
    keys = np.concatenate([kept_keys, used])
    order = np.argsort(keys, kind="stable")
    keys = keys[order]
    nodes = np.stack([keys // (9 * node_count), keys % node_count], axis=1)
    weights = np.concatenate([model.spring_weight[kept], shared.astype(np.float32)])[order]
    return nodes.astype(np.int32), (keys // node_count % 9).astype(np.int8), weights


def plain_stems(block: Block, labels: Labels, is_cut: Bool, is_beyond: Bool, copies: Int64) -> Int64:
    """Give tissue beside a sheet's continuation a piece of its own; its corners are those of the sides they lie on.

    Pieces and counts of the labels are changed; the copies of all pieces' corners are returned.
    """
    first = np.cumsum(labels.piece_count) - labels.piece_count
    rows = np.split(copies, first[1:]) if len(first) else []
    was_whole = labels.piece_count == 1
    on_face = [np.arange(SAMPLE_COUNT) // stride % SAMPLES == SAMPLES - 1 for stride in STRIDES]
    inside = ~np.array(on_face)
    is_parted = (labels.piece_count > 1) & (is_beyond & inside).any(axis=(1, 2))
    for place in map(int, np.flatnonzero(is_parted)):
        at_cut = places_of(is_cut[place])
        rows[place] = _with_stem(labels, place, at_cut, places_of(is_beyond[place]), rows[place], None)
    # Where a sheet ends on the face between two cells, tissue of the further one holds on to the nearer.
    for axis in range(3):
        next_keys = lattice_keys(key_indices(block.keys) + np.eye(3, dtype=np.int64)[axis])
        for place in map(int, np.flatnonzero(is_beyond[:, axis, on_face[axis]].any(axis=1) & was_whole)):
            there = int(np.searchsorted(block.keys, next_keys[place]))
            if labels.piece_count[there] != 1:
                continue
            on = np.zeros((3, SAMPLE_COUNT), np.bool_)
            on[axis] = on_face[axis]
            shift = np.eye(3)[axis]
            at_cut, at_stem = (places_of(marks[place] & on) - shift for marks in (is_cut, is_beyond))
            corners = np.arange(8)
            near = corners >> axis & 1 == 0
            stem = np.where(near, rows[place][0][corners | 1 << axis], rows[there][0])
            rows[there] = _with_stem(labels, there, at_cut, at_stem, rows[there], stem)
    return np.concatenate(rows) if rows else copies


def _with_stem(labels: Labels, place: int, at_cut: Float64, at_stem: Float64, rows: Int64, stem: Int64 | None) -> Int64:
    """Split the stem, with given copies at its corners or those of the sides they lie on, from a cell's pieces."""
    piece = labels.piece[place]
    tissue = piece >= 0
    away_from_cut = _distances(SAMPLE_PLACES, at_cut) if len(at_cut) else np.full(SAMPLE_COUNT, np.inf)
    is_stem = tissue & (_distances(SAMPLE_PLACES, at_stem) < away_from_cut)
    if not is_stem.any():
        return rows
    if stem is None:
        away = ((CORNER_OFFSETS - 0.5)[:, None] - SAMPLE_PLACES) ** 2
        side = piece[np.where(tissue, away.sum(axis=2), np.inf).argmin(axis=1)]
        stem = rows[side, np.arange(8)]
    kept = np.unique(piece[tissue & ~is_stem])
    number = np.full(len(rows), -1)
    number[kept] = np.arange(len(kept))
    labels.piece[place] = np.where(is_stem, len(kept), number[piece])
    labels.piece[place][~tissue] = -1
    labels.piece_count[place] = len(kept) + 1
    return np.concatenate([rows[kept], stem[None]])


def _distances(points: Float64, others: Float64) -> Float64:
    """Squared distance of each point to the nearest of others."""
    return ((points[:, None] - others) ** 2).sum(axis=2).min(axis=1)
