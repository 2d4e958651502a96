"""Samples of the tissue at rest: which of a cell's SAMPLES^3 points lie in it."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from hashlib import sha256

import numpy as np
import numpy.typing as npt

from heartcase.schemas.arrays import Bool, Float64, Int32, Int64
from heartcase.simulator.cutting.bit_masks.touched import tissue_bits
from heartcase.simulator.cutting.blade_sheet import crossed_links
from heartcase.simulator.cutting.crossings import QUANTA, SAMPLES

__all__ = ["SAMPLE_PLACES", "SAMPLE_VARIANCE", "TissueSamples", "samples_of"]

_INDICES: Int64 = np.stack(np.meshgrid(*[np.arange(SAMPLES)] * 3, indexing="ij"), axis=-1)[..., ::-1].reshape(-1, 3)
"""Index (i, j, k) of each sample in its cell, by k, j, i, shape (SAMPLES^3, 3)."""
SAMPLE_PLACES: Float64 = (_INDICES + 0.5) / SAMPLES - 0.5
"""Where the samples of a cell lie, from its centre [edges], by k, j, i, shape (SAMPLES^3, 3)."""
SAMPLE_VARIANCE = 1.0 / 12.0 / SAMPLES**2
"""Of the tissue that a sample stands for, along each axis [edges squared]."""


@dataclass(frozen=True)
class TissueSamples:
    """The tissue by the closed surface around it; all of space where there is none."""

    entries: Int64 | None
    """Links along x that the surface crosses (:func:`heartcase.simulator.cutting.blade_sheet.crossed_links`)."""

    @cached_property
    def sha256(self) -> str | None:
        """Hash of the samples; None where tissue fills its cells."""
        return None if self.entries is None else sha256(np.ascontiguousarray(self.entries).tobytes()).hexdigest()

    @classmethod
    def everywhere(cls) -> TissueSamples:
        """Tissue that fills its cells."""
        return cls(None)

    @classmethod
    def inside(cls, vertices: npt.ArrayLike, triangles: npt.ArrayLike) -> TissueSamples:
        """Tissue inside a closed surface at rest.

        Parameters
        ----------
        vertices
            In the frame of the nodes [cells], shape (vertex_count, 3).
        triangles
            Vertex numbers, shape (triangle_count, 3); each edge in two triangles.
        """
        corners = np.round(np.asarray(vertices, dtype=np.float64) * QUANTA).astype(np.int64)
        return cls(crossed_links(corners[np.asarray(triangles)], axis=0))

    def of_cells(self, cells: Int32, moments: npt.ArrayLike) -> Bool:
        """Which samples of some cells are tissue, shape (count, SAMPLES^3); in each cell one at least.

        Parameters
        ----------
        cells
            Index (i, j, k) of each, shape (count, 3).
        moments
            Of the tissue in each, as of :class:`heartcase.simulator.lattice.model.LatticeModel`, shape (count, 9).
        """
        rows = self.bits_of(cells, moments).astype("<i8").view(np.uint8)
        is_tissue: Bool = np.unpackbits(rows, axis=1, bitorder="little").view(np.bool_)
        return is_tissue

    def bits_of(self, cells: Int32, moments: npt.ArrayLike) -> Int64:
        """The same as bits, shape (count, SAMPLES): :mod:`heartcase.simulator.cutting.bit_masks.sample_bits`."""
        bits = np.full((len(cells), SAMPLES), -1, np.int64)
        if self.entries is not None and len(cells):
            tissue_bits(self.entries, cells, bits)
            empty = np.flatnonzero(~bits.any(axis=1))
            layer, place = np.divmod(_nearest_samples(moments, empty), SAMPLES**2)
            bits[empty, layer] = np.left_shift(1, place)
        return bits


def _nearest_samples(moments: npt.ArrayLike, cells: Int64) -> Int64:
    """Samples nearest to the middle of the tissue in some of all cells, shape (count,)."""
    away = SAMPLE_PLACES - np.asarray(moments, dtype=np.float64)[cells, None, :3]
    nearest: Int64 = (away**2).sum(axis=2).argmin(axis=1)
    return nearest


def samples_of(cells: npt.ArrayLike) -> Int64:
    """Index (i, j, k) of the samples of some cells, shape (count, SAMPLES^3, 3)."""
    return SAMPLES * np.asarray(cells, dtype=np.int64)[:, None, :] + _INDICES
