"""The pieces that one more sheet leaves: only places that it comes to are looked at, and the rest is taken over.

What the samples of a place hang together in follows from the links that are crossed there, and which copy of a node a
piece has, from the eight places around it. So the pieces are those that
:func:`heartcase.simulator.cutting.pieces.find_pieces` finds for all sheets at once, to the byte, in whatever order they
came.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from heartcase.schemas.arrays import Bool, Int32, Int64
from heartcase.schemas.bundle.lattice import CORNER_OFFSETS
from heartcase.simulator.cutting.bit_masks.labelling import Places, find_stems, label_places
from heartcase.simulator.cutting.bit_masks.rows import is_as_before, number_pieces, write_samples
from heartcase.simulator.cutting.bit_masks.sharing import Around, Stemmed, share_nodes, with_stems
from heartcase.simulator.cutting.bit_masks.touched import (
    found_among,
    mark,
    merged,
    next_places,
    places_around,
    places_of_links,
    taken_over,
)
from heartcase.simulator.cutting.blade_sheet import Sheet
from heartcase.simulator.cutting.pieces import Pieces
from heartcase.simulator.cutting.tissue_samples import SAMPLE_PLACES, TissueSamples
from heartcase.simulator.lattice.model import LatticeModel

__all__ = ["FoundPieces", "find_further"]

_NEAREST: Int64 = np.argsort(
    (((CORNER_OFFSETS - 0.5)[:, None] - SAMPLE_PLACES) ** 2).sum(axis=2), axis=1, kind="stable"
)
"""Samples of a cell from each corner on, shape (8, SAMPLES^3)."""


@dataclass(frozen=True)
class FoundPieces:
    """Pieces, and what those after a further sheet follow from."""

    pieces: Pieces
    """The pieces."""
    first: Int64
    """First piece of each cell, and the last end, shape (cell_count + 1,)."""
    places: Places
    """Places that links are crossed in."""
    around: Around
    """The cells there and beside."""
    stemmed: Stemmed
    """Pieces at each place, with stems."""
    node_copies: Int32
    """How many nodes each node of the uncut lattice became, shape (node_count,)."""


@dataclass(frozen=True)
class Further:
    """What changed from one cut to the next."""

    of_known: Int64
    """Row before of each cell around the sheets, or -1, shape (count,)."""
    is_same: Bool
    """Whether its pieces are the same, shape (count,)."""


def find_further(
    model: LatticeModel, tissue: TissueSamples, known: FoundPieces | None, sheet: Sheet
) -> tuple[FoundPieces, Further]:
    """Part the tissue of a lattice by one more sheet.

    Parameters
    ----------
    model, tissue
        The uncut lattice, and its samples.
    known
        What was found for the sheets before; None where there were none.
    sheet
        The sheet.
    """
    if known is None:
        known = _nothing(model.node_count)
    changed = places_of_links(*sheet.links)
    near = places_around(changed)
    cell_keys, by_key = model.cells_in_order
    cells_near = _cells_at(near, cell_keys, by_key)
    keys, of_known, of_changed = merged(known.places.keys, changed)
    cells, cell_of_known, _ = merged(known.around.cells, np.sort(cells_near[cells_near >= 0]))

    bits = taken_over(known.around.tissue, cell_of_known)
    new = np.flatnonzero(cell_of_known < 0)
    bits[new] = tissue.bits_of(model.cells[cells[new]], model.cell_moments[cells[new]])
    is_changed = of_changed >= 0
    crossed = taken_over(known.places.crossed.reshape(-1, 24), of_known).reshape(-1, 3, 8)
    beyond = taken_over(known.places.beyond.reshape(-1, 24), of_known).reshape(-1, 3, 8)
    mark(keys, *sheet.links, crossed)
    mark(keys, *sheet.links_beyond, beyond)

    cell_rows = found_among(_cells_at(keys, cell_keys, by_key), cells)
    place_rows = np.full(len(cells), -1)
    place_rows[cell_rows[cell_rows >= 0]] = np.flatnonzero(cell_rows >= 0)
    closed, first_piece, pieces, first_space, spaces = label_places(
        known.places, of_known, is_changed, bits, crossed, beyond, cell_rows
    )
    next_place = next_places(keys)
    stems = find_stems(known.places, of_known, is_changed, bits, crossed, closed, cell_rows, first_piece, next_place)
    places = Places(keys, cell_rows, crossed, beyond, closed, first_piece, pieces, first_space, spaces, stems)
    around = Around(cells, bits, place_rows, np.zeros(1, np.int64), np.zeros((0, 8), np.int32))
    near_rows, near_cells = found_among(near, keys), found_among(cells_near, cells)
    first_of, shared = share_nodes(places, known.around, cell_of_known, is_changed, around, near, near_rows, near_cells)
    around = around._replace(first=first_of, copies=shared)
    stemmed = with_stems(places, around, next_place, _NEAREST)

    counts, copies, node_copies = number_pieces(around, stemmed, model.cell_corners, model.node_count)
    before = known.pieces
    is_same = is_as_before(around, stemmed, counts, known.around, known.stemmed, before.counts, cell_of_known)
    samples = np.empty((len(cells), 512), np.int32)
    write_samples(around, stemmed, counts, is_same, cell_of_known, before.samples, samples)
    first = np.append(0, np.cumsum(counts))
    found = FoundPieces(Pieces(cells, samples, counts, copies), first, places, around, stemmed, node_copies)
    return found, Further(cell_of_known, is_same)


def _cells_at(places: Int64, cell_keys: Int64, by_key: Int64) -> Int64:
    """Cell at each place, or -1."""
    at = found_among(places, cell_keys)
    cells: Int64 = np.where(at >= 0, by_key[at], -1)
    return cells


def _nothing(node_count: int) -> FoundPieces:
    none, ends = np.zeros(0, np.int64), np.zeros(1, np.int64)
    sets, marks, corners = np.zeros((0, 8), np.int64), np.zeros((0, 3, 8), np.int64), np.zeros((0, 8), np.int32)
    return FoundPieces(
        Pieces(none, np.zeros((0, 512), np.int32), none, np.zeros((0, 8), np.int64)),
        ends,
        Places(none, none, marks, marks, marks, ends, sets, ends, sets, np.zeros((0, 4, 8), np.int64)),
        Around(none, sets, none, ends, corners),
        Stemmed(none, none, sets, corners),
        np.ones(node_count, np.int32),
    )
